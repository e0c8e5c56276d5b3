//! What the thread of an arm needs of a link: to a gateway, or to the servo controller itself.

use std::os::fd::BorrowedFd;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{HelloReply, ParserCounters};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::transport::{ConnectError, Unplugged};

use crate::driver::{Activity, Driver, Sample, Transmit};
use crate::link::HelloError;

/// How greeting the other side goes.
pub(super) enum Greeted {
    /// It has not answered yet.
    Waiting,
    /// It is the one of the configuration, or none that would answer.
    Done,
    /// It is another one.
    Refused(HelloError),
    /// It does not answer.
    Silent,
}

/// A link with what it goes over. Nothing but [`Self::wait`] and [`Self::reopen`] takes time.
pub(super) trait HostPort: Send {
    /// Opens it again, after it was gone.
    ///
    /// # Errors
    /// If it cannot be opened.
    fn reopen(&mut self) -> Result<(), ConnectError>;

    /// What the operator should know of it.
    fn warning(&self) -> Option<String>;

    /// Why it is gone, if it is.
    fn gone(&self) -> Option<Unplugged>;

    /// What the gateway said of itself, if there is one.
    fn hello(&self) -> Option<&HelloReply>;

    /// What it said first when it was greeted, before anybody waited for it.
    fn found(&self) -> Option<&HelloReply>;

    /// The last measurement of an arm that its gateway had stopped before it was greeted, if it shows it.
    fn shown(&self) -> Option<&Sample> {
        None
    }

    /// What happened to bytes.
    fn line(&self) -> ParserCounters;

    /// Frames that the line did not take.
    fn frames_unsent(&self) -> u64;

    /// Greets the other side.
    fn greet(&mut self, now: MonotonicTime);

    /// Greets one that needed time.
    fn greet_again(&mut self, now: MonotonicTime);

    /// Whether it has answered; greets it again where it has not.
    fn greeted(&mut self, now: MonotonicTime) -> Greeted;

    /// Hands what has come to the driver.
    ///
    /// # Errors
    /// If the link is gone: told once.
    fn receive(&mut self, now: MonotonicTime, driver: &mut Driver) -> Result<(), Unplugged>;

    /// Takes a message of the driver. One that cannot be sent gets no answer, which the driver counts.
    fn send(&mut self, now: MonotonicTime, transmit: &Transmit, activity: Activity);

    /// Writes the pending bytes that the line accepts.
    ///
    /// # Errors
    /// If the link is gone: told once.
    fn flush(&mut self, now: MonotonicTime) -> Result<(), Unplugged>;

    /// How many signs of life are missing of a peer that gives them by itself, if these are too many.
    fn silence(&self, now: MonotonicTime) -> Option<u32>;

    /// When this wants to be asked again.
    fn next_deadline(&self) -> Option<MonotonicTime>;

    /// Waits for something from the line, for room if something waits for it, for the waker, or for this long.
    fn wait(&self, waker: Option<BorrowedFd<'_>>, timeout: Duration);
}
