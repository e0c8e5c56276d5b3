//! The link to a gateway with its byte transport. Only [`GatewayPort::wait`] and [`GatewayPort::reopen`] block.

use std::os::fd::BorrowedFd;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{FrameBytes, HelloReply, ParserCounters};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::transport::{ByteLink, ConnectError, Connector, Unplugged, wait};

use super::closer::Closer;
use super::trace::{Direction, Tracer};
use crate::driver::{Activity, Driver, Sample, Transmit};
use crate::link::{GatewayLink, HEARTBEAT_INTERVAL, HELLO_TIMEOUT, HelloError};

/// HELLO is sent again after this time, in case it was lost.
const HELLO_AGAIN: Duration = Duration::from_millis(200);

/// A gateway without an answer to heartbeats for this time is lost.
const SILENCE_MAX: Duration = HEARTBEAT_INTERVAL.saturating_mul(4);

/// Maximum number of reads per turn; the rest is read in the next one, so that a flood of bytes delays nothing else.
const READS_MAX: usize = 8;

/// A link to a gateway.
pub(super) struct GatewayPort {
    link: GatewayLink,
    connector: Box<dyn Connector>,
    closer: Closer,
    /// `None` after it was lost: an open port would block other programs, and this one.
    bytes: Option<Box<dyn ByteLink>>,
    gone: Option<Unplugged>,
    /// A frame that is partly written, and the number of written bytes.
    pending: FrameBytes,
    written: usize,
    frames_unsent: u64,
    greeting: Option<Greeting>,
    found: Option<HelloReply>,
    last_received: MonotonicTime,
    tracer: Tracer,
}

/// State of a greeting.
pub(super) enum Greeted {
    /// No answer yet.
    Waiting,
    /// It is the configured one.
    Done,
    /// It is another one.
    Refused(HelloError),
    /// It does not answer.
    Silent,
}

/// HELLO was sent.
#[derive(Clone, Copy)]
struct Greeting {
    since: MonotonicTime,
    again: MonotonicTime,
}

impl GatewayPort {
    /// Opens the transport.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn open(
        config: GatewayLinkConfig,
        mut connector: Box<dyn Connector>,
        closer: Closer,
        tracer: Tracer,
    ) -> Result<Self, ConnectError> {
        Ok(Self {
            link: GatewayLink::new(config),
            bytes: Some(connector.connect()?),
            connector,
            closer,
            gone: None,
            pending: FrameBytes::EMPTY,
            written: 0,
            frames_unsent: 0,
            greeting: None,
            found: None,
            last_received: MonotonicTime::ZERO,
            tracer,
        })
    }

    fn lose(&mut self, gone: Unplugged) -> Result<(), Unplugged> {
        if let Some(bytes) = self.bytes.take() {
            self.closer.close(bytes);
        }
        self.gone = Some(gone);
        self.greeting = None;
        (self.pending, self.written) = (FrameBytes::EMPTY, 0);
        Err(gone)
    }

    /// Opens it again after a loss.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn reopen(&mut self) -> Result<(), ConnectError> {
        self.closer.wait()?;
        self.bytes = Some(self.connector.connect()?);
        self.gone = None;
        (self.pending, self.written) = (FrameBytes::EMPTY, 0);
        Ok(())
    }

    /// Warnings of the link.
    pub fn warning(&self) -> Option<String> {
        self.bytes.as_ref().and_then(|bytes| bytes.warning())
    }

    /// Cause of the loss, if it is lost.
    pub fn gone(&self) -> Option<Unplugged> {
        self.gone
    }

    /// Identification of the gateway, after its answer.
    pub fn hello(&self) -> Option<&HelloReply> {
        self.link.hello()
    }

    /// First state that the gateway reported at the greeting.
    pub fn found(&self) -> Option<&HelloReply> {
        self.found.as_ref()
    }

    /// Last measurement of an arm that its gateway had stopped before the greeting, if available.
    pub fn shown(&self) -> Option<&Sample> {
        self.link.shown()
    }

    /// Counters of the bytes.
    pub fn line(&self) -> ParserCounters {
        *self.link.counters()
    }

    /// Frames that the line did not accept.
    pub fn frames_unsent(&self) -> u64 {
        self.frames_unsent
    }

    /// Greets the gateway.
    pub fn greet(&mut self, now: MonotonicTime) {
        self.found = None;
        self.greet_again(now);
    }

    /// Greets a busy gateway again.
    pub fn greet_again(&mut self, now: MonotonicTime) {
        self.link.open(now);
        self.greeting = Some(Greeting { since: now, again: now + HELLO_AGAIN });
        self.last_received = now;
    }

    /// State of the greeting; greets again if there is no answer.
    pub fn greeted(&mut self, now: MonotonicTime) -> Greeted {
        if let Some(hello) = self.link.hello() {
            self.found.get_or_insert(*hello);
            self.greeting = None;
            return Greeted::Done;
        }
        if let Some(error) = self.link.hello_error() {
            self.greeting = None;
            return Greeted::Refused(*error);
        }
        let Some(Greeting { since, again }) = self.greeting else { return Greeted::Silent };
        if now.saturating_since(since) >= HELLO_TIMEOUT {
            self.greeting = None;
            return Greeted::Silent;
        }
        if now >= again {
            self.link.open(now);
            self.greeting = Some(Greeting { since, again: now + HELLO_AGAIN });
        }
        Greeted::Waiting
    }

    /// Passes received messages to the driver.
    ///
    /// # Errors
    /// If the link is lost: reported once.
    pub fn receive(&mut self, now: MonotonicTime, driver: &mut Driver) -> Result<(), Unplugged> {
        let mut buffer = [0; 512];
        for _ in 0..READS_MAX {
            let Some(bytes) = &mut self.bytes else { return Ok(()) };
            match bytes.try_read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => {
                    self.last_received = now;
                    self.tracer.record(now, Direction::In, &buffer[..count]);
                    self.link.handle_bytes(now, &buffer[..count], driver);
                }
                // A gateway that refuses the host says why, then closes the connection: its reason is the answer.
                Err(gone) if self.link.hello_error().is_some() => return self.lose(gone).or(Ok(())),
                Err(gone) => return self.lose(gone),
            }
        }
        self.link.handle_timeout(now, driver);
        Ok(())
    }

    /// Sends a message of the driver. One that cannot be sent gets no answer, which the driver counts.
    pub fn send(&mut self, now: MonotonicTime, transmit: &Transmit, activity: Activity) {
        // A message that cannot be sent gets no answer, which the driver counts.
        let _ = self.link.send(now, transmit, activity);
    }

    /// Writes the pending bytes that the line accepts. A frame without a written byte is replaced by a newer one.
    ///
    /// # Errors
    /// If the link is lost: reported once.
    pub fn flush(&mut self, now: MonotonicTime) -> Result<(), Unplugged> {
        loop {
            if self.written == 0
                && let Some(newer) = self.link.poll_output(now)
            {
                self.frames_unsent += u64::from(!self.pending.is_empty());
                self.pending = newer;
            }
            if self.pending.is_empty() {
                return Ok(());
            }
            let Some(bytes) = &mut self.bytes else {
                self.pending = FrameBytes::EMPTY;
                continue;
            };
            match bytes.try_write(&self.pending[self.written..]) {
                Ok(0) => return Ok(()),
                Ok(count) => {
                    self.tracer.record(now, Direction::Out, &self.pending[self.written..self.written + count]);
                    self.written += count;
                }
                Err(gone) => return self.lose(gone),
            }
            if self.written == self.pending.len() {
                (self.pending, self.written) = (FrameBytes::EMPTY, 0);
            }
        }
    }

    /// Number of missing heartbeats of the gateway, if there are too many.
    pub fn silence(&self, now: MonotonicTime) -> Option<u32> {
        let silent = now.saturating_since(self.last_received);
        let expected = self.bytes.is_some() && self.link.hello().is_some();
        (expected && silent >= SILENCE_MAX).then(|| (silent.as_millis() / HEARTBEAT_INTERVAL.as_millis()) as u32)
    }

    /// Time of the next required call.
    pub fn next_deadline(&self) -> Option<MonotonicTime> {
        self.bytes.as_ref()?;
        let greeting = self.greeting.map(|greeting| greeting.again.min(greeting.since + HELLO_TIMEOUT));
        [self.link.next_deadline(), greeting].into_iter().flatten().min()
    }

    /// Waits for input, for output space if something is pending, for the waker, or for this time.
    pub fn wait(&self, waker: Option<BorrowedFd<'_>>, timeout: Duration) {
        wait(self.bytes.as_deref(), !self.pending.is_empty(), waker, timeout);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use std::collections::VecDeque;

    use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
    use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, GatewayMessage, Geometry, Holder, HostLimits};
    use pb3dp_hal_platform::transport::Symptom;

    use super::super::trace::Trace;
    use super::*;
    use crate::driver::DriverConfig;
    use crate::link::HeldError;

    /// Answers once, and has ended then.
    struct Answer(VecDeque<Vec<u8>>);

    impl ByteLink for Answer {
        fn name(&self) -> &str {
            "answer"
        }
        fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
            let bytes = self.0.pop_front().ok_or(Unplugged { symptom: Symptom::EndOfStream })?;
            buffer[..bytes.len()].copy_from_slice(&bytes);
            Ok(bytes.len())
        }
        fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
            Ok(bytes.len())
        }
        fn fd(&self) -> Option<BorrowedFd<'_>> {
            None
        }
    }

    impl Connector for Answer {
        fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
            Ok(Box::new(Self(std::mem::take(&mut self.0))))
        }
        fn target(&self) -> String {
            "answer".to_owned()
        }
    }

    /// A gateway closes the connection of a host that it refuses.
    #[test]
    fn what_a_gateway_says_before_it_closes_is_the_answer() {
        let (arm, now) = (ArmId(3), MonotonicTime::from_nanos(1_000_000));
        let holder = Holder { address: std::net::Ipv4Addr::LOCALHOST.into(), port: 0 };
        let held = GatewayMessage::Held(holder).frame(arm, 0, 0).encode();
        let link = GatewayLinkConfig {
            arm,
            format: WireFormat::BigEndian6x10,
            geometry: Geometry::Unknown,
            cycle: Duration::from_millis(10),
            limits: HostLimits::WIDEST,
            signals: StatusSignals::ORCA,
        };
        let mut driver = Driver::new(DriverConfig::with_cycle(link.cycle)).unwrap();
        let answer = Box::new(Answer(VecDeque::from([held.to_vec()])));
        let mut port = GatewayPort::open(link, answer, Closer::at_once(), Tracer::new(Trace::new())).unwrap();
        port.greet(now);
        port.flush(now).unwrap();
        port.receive(now, &mut driver).unwrap();
        let refused = port.greeted(now);
        assert!(matches!(refused, Greeted::Refused(HelloError::Held(HeldError::Held(found))) if found == holder));
        assert!(port.gone().is_some());
    }
}
