//! The driver's link with the bytes under it.

use std::os::fd::BorrowedFd;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;

use crate::driver::{Activity, Driver, Transmit};
use crate::gateway_protocol::{FrameBytes, HelloReply, ParserCounters};
use crate::io::transport::{ByteLink, Ready, Unplugged, wait};
use crate::link::{GatewayLink, GatewayLinkConfig, HEARTBEAT_INTERVAL, HELLO_TIMEOUT, HelloError, LinkError};

/// HELLO is said again after this long: one may get lost.
const HELLO_AGAIN: Duration = Duration::from_millis(200);

/// A gateway that answers no heartbeat for this long is gone.
const SILENCE_MAX: Duration = HEARTBEAT_INTERVAL.saturating_mul(4);

/// Reads of one turn; what is left is read in the next one, so a flood of bytes holds nothing else up.
const READS_MAX: usize = 8;

/// A link to a gateway.
pub(super) struct GatewayPort {
    link: GatewayLink,
    bytes: Box<dyn ByteLink>,
    gone: Option<Unplugged>,
    /// A frame that is on its way, and how much of it has gone.
    pending: FrameBytes,
    written: usize,
    frames_unsent: u64,
    greeting: Option<Greeting>,
    last_received: MonotonicTime,
}

/// HELLO was said.
#[derive(Clone, Copy)]
struct Greeting {
    since: MonotonicTime,
    again: MonotonicTime,
}

/// How greeting a gateway goes.
pub(super) enum Greeted {
    /// It has not answered yet.
    Waiting,
    /// It is the one of the configuration.
    Done,
    /// It is another one.
    Refused(HelloError),
    /// It does not answer.
    Silent,
}

impl GatewayPort {
    pub fn new(config: GatewayLinkConfig, bytes: Box<dyn ByteLink>) -> Self {
        Self {
            link: GatewayLink::new(config),
            bytes,
            gone: None,
            pending: FrameBytes::EMPTY,
            written: 0,
            frames_unsent: 0,
            greeting: None,
            last_received: MonotonicTime::ZERO,
        }
    }

    /// Goes on with other bytes, after those before are gone.
    pub fn replace(&mut self, bytes: Box<dyn ByteLink>) {
        self.bytes = bytes;
        self.gone = None;
        (self.pending, self.written) = (FrameBytes::EMPTY, 0);
    }

    /// Why the link is gone, if it is.
    pub fn gone(&self) -> Option<Unplugged> {
        self.gone
    }

    pub fn hello(&self) -> Option<&HelloReply> {
        self.link.hello()
    }

    pub fn counters(&self) -> &ParserCounters {
        self.link.counters()
    }

    pub fn frames_unsent(&self) -> u64 {
        self.frames_unsent
    }

    /// Says HELLO.
    pub fn greet(&mut self, now: MonotonicTime) {
        self.link.open(now);
        self.greeting = Some(Greeting { since: now, again: now + HELLO_AGAIN });
        self.last_received = now;
    }

    /// Whether the gateway has answered; says HELLO again where it has not.
    pub fn greeted(&mut self, now: MonotonicTime) -> Greeted {
        if self.link.hello().is_some() {
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

    /// Hands what has come to the driver.
    ///
    /// # Errors
    /// If the link is gone: told once.
    pub fn receive(&mut self, now: MonotonicTime, driver: &mut Driver) -> Result<(), Unplugged> {
        if self.gone.is_some() {
            return Ok(());
        }
        let mut buffer = [0; 512];
        for _ in 0..READS_MAX {
            match self.bytes.try_read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => {
                    self.last_received = now;
                    self.link.handle_bytes(now, &buffer[..count], driver);
                }
                Err(gone) => return self.lose(gone),
            }
        }
        self.link.handle_timeout(now, driver);
        Ok(())
    }

    /// Takes a message of the driver.
    pub fn send(&mut self, now: MonotonicTime, transmit: &Transmit, activity: Activity) -> Result<(), LinkError> {
        self.link.send(now, transmit, activity)
    }

    /// Writes what is to be written, as far as the line takes it. A frame that no byte of was written yet gives way to a newer one.
    ///
    /// # Errors
    /// If the link is gone: told once.
    pub fn flush(&mut self, now: MonotonicTime) -> Result<(), Unplugged> {
        if self.gone.is_some() {
            while self.link.poll_output(now).is_some() {}
            return Ok(());
        }
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
            match self.bytes.try_write(&self.pending[self.written..]) {
                Ok(0) => return Ok(()),
                Ok(count) => self.written += count,
                Err(gone) => return self.lose(gone),
            }
            if self.written == self.pending.len() {
                (self.pending, self.written) = (FrameBytes::EMPTY, 0);
            }
        }
    }

    /// A gateway that should answer and has not for a long time: for how many heartbeats.
    pub fn silence(&self, now: MonotonicTime) -> Option<u32> {
        let silent = now.saturating_since(self.last_received);
        let expected = self.gone.is_none() && self.link.hello().is_some();
        (expected && silent >= SILENCE_MAX).then(|| (silent.as_millis() / HEARTBEAT_INTERVAL.as_millis()) as u32)
    }

    /// When this wants to be asked again.
    pub fn next_deadline(&self) -> Option<MonotonicTime> {
        if self.gone.is_some() {
            return None;
        }
        let greeting = self.greeting.map(|greeting| greeting.again.min(greeting.since + HELLO_TIMEOUT));
        [self.link.next_deadline(), greeting].into_iter().flatten().min()
    }

    /// Waits for bytes, for room if a frame waits for it, for the waker, or for this long.
    pub fn wait(&self, waker: BorrowedFd<'_>, timeout: Duration) -> Ready {
        let link = if self.gone.is_some() { None } else { Some(self.bytes.as_ref()) };
        wait(link, !self.pending.is_empty(), Some(waker), timeout)
    }

    fn lose(&mut self, gone: Unplugged) -> Result<(), Unplugged> {
        self.gone = Some(gone);
        self.greeting = None;
        (self.pending, self.written) = (FrameBytes::EMPTY, 0);
        Err(gone)
    }
}
