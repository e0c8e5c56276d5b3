//! The link to the servo controller over an ARCNET card of this computer.

use std::os::fd::BorrowedFd;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::arcnet::Frame;
use pb3dp_arm_pa10_protocol::codec::{SequenceModulus, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{HelloReply, ParserCounters};
use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::transport::{ConnectError, Unplugged, wait_for};

use super::port::{Greeted, HostPort};
use super::trace::{Direction, Tracer};
use crate::bus::{self, BusDown, BusPort, FRAME_ROOM};
use crate::driver::{Activity, Driver, Transmit};
use crate::link::BusLink;

/// Maximum number of frames per turn; the rest is read in the next one.
const FRAMES_MAX: usize = 16;

/// A link to a controller.
pub(super) struct ControllerPort {
    link: BusLink,
    target: BusTarget,
    /// `None` after it went down.
    bus: Option<Box<dyn BusPort>>,
    gone: Option<Unplugged>,
    pending: Option<Frame>,
    frames_unsent: u64,
    tracer: Tracer,
}

impl ControllerPort {
    /// Opens the bus.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn open(
        format: WireFormat,
        modulus: SequenceModulus,
        target: BusTarget,
        tracer: Tracer,
    ) -> Result<Self, ConnectError> {
        let bus = Some(bus::open(&target)?);
        let link = BusLink::new(format, modulus);
        Ok(Self { link, target, bus, gone: None, pending: None, frames_unsent: 0, tracer })
    }

    fn lose(&mut self, down: BusDown) -> Result<(), Unplugged> {
        let gone = Unplugged { symptom: down.symptom };
        self.bus = None;
        self.gone = Some(gone);
        self.pending = None;
        Err(gone)
    }
}

impl HostPort for ControllerPort {
    fn reopen(&mut self) -> Result<(), ConnectError> {
        self.bus = Some(bus::open(&self.target)?);
        self.gone = None;
        Ok(())
    }

    fn warning(&self) -> Option<String> {
        None
    }

    fn gone(&self) -> Option<Unplugged> {
        self.gone
    }

    fn hello(&self) -> Option<&HelloReply> {
        None
    }

    fn found(&self) -> Option<&HelloReply> {
        None
    }

    fn line(&self) -> ParserCounters {
        ParserCounters::default()
    }

    fn frames_unsent(&self) -> u64 {
        self.frames_unsent
    }

    /// A controller is greeted by reading the state of the arm.
    fn greet(&mut self, _now: MonotonicTime) {}

    fn greet_again(&mut self, _now: MonotonicTime) {}

    fn greeted(&mut self, _now: MonotonicTime) -> Greeted {
        Greeted::Done
    }

    fn receive(&mut self, now: MonotonicTime, driver: &mut Driver) -> Result<(), Unplugged> {
        let mut buffer = [0; FRAME_ROOM];
        for _ in 0..FRAMES_MAX {
            let Some(bus) = &mut self.bus else { return Ok(()) };
            match bus.try_receive(&mut buffer) {
                Ok(None) => break,
                Ok(Some(length)) => {
                    self.tracer.record(now, Direction::In, &buffer[..length]);
                    // The driver counts undecodable frames.
                    let _ = self.link.handle_frame(now, &buffer[..length], driver);
                }
                Err(down) => return self.lose(down),
            }
        }
        Ok(())
    }

    fn send(&mut self, _now: MonotonicTime, transmit: &Transmit, _activity: Activity) {
        // A message that cannot be encoded gets no answer, which the driver counts.
        self.pending = self.link.send(transmit).ok();
    }

    /// As on a bus: a frame without space is lost.
    fn flush(&mut self, now: MonotonicTime) -> Result<(), Unplugged> {
        let (Some(frame), Some(bus)) = (self.pending.take(), &mut self.bus) else { return Ok(()) };
        match bus.try_send(&frame) {
            Ok(sent) => {
                self.tracer.record(now, Direction::Out, &frame);
                self.frames_unsent += u64::from(!sent);
                Ok(())
            }
            Err(down) => self.lose(down),
        }
    }

    /// A controller sends nothing without a request.
    fn silence(&self, _now: MonotonicTime) -> Option<u32> {
        None
    }

    fn next_deadline(&self) -> Option<MonotonicTime> {
        None
    }

    fn wait(&self, waker: Option<BorrowedFd<'_>>, timeout: Duration) {
        wait_for(self.bus.as_ref().map(|bus| bus.fd()), false, waker, timeout);
    }
}
