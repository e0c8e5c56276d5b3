//! Interface of the thread of an arm to its link: a gateway, or the servo controller itself.

use std::os::fd::BorrowedFd;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{HelloReply, ParserCounters};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::transport::{ConnectError, Unplugged};

use crate::driver::{Activity, Driver, Sample, Transmit};
use crate::link::HelloError;

/// State of a greeting.
pub(super) enum Greeted {
    /// No answer yet.
    Waiting,
    /// It is the configured one, or one that cannot answer.
    Done,
    /// It is another one.
    Refused(HelloError),
    /// It does not answer.
    Silent,
}

/// A link with its transport. Only [`Self::wait`] and [`Self::reopen`] block.
pub(super) trait HostPort: Send {
    /// Opens it again after a loss.
    ///
    /// # Errors
    /// If it cannot be opened.
    fn reopen(&mut self) -> Result<(), ConnectError>;

    /// Warnings of the link.
    fn warning(&self) -> Option<String>;

    /// Cause of the loss, if it is lost.
    fn gone(&self) -> Option<Unplugged>;

    /// Identification of the gateway, if there is one.
    fn hello(&self) -> Option<&HelloReply>;

    /// First state that the gateway reported at the greeting.
    fn found(&self) -> Option<&HelloReply>;

    /// Last measurement of an arm that its gateway had stopped before the greeting, if available.
    fn shown(&self) -> Option<&Sample> {
        None
    }

    /// Counters of the bytes.
    fn line(&self) -> ParserCounters;

    /// Frames that the line did not accept.
    fn frames_unsent(&self) -> u64;

    /// Greets the other side.
    fn greet(&mut self, now: MonotonicTime);

    /// Greets a busy gateway again.
    fn greet_again(&mut self, now: MonotonicTime);

    /// State of the greeting; greets again if there is no answer.
    fn greeted(&mut self, now: MonotonicTime) -> Greeted;

    /// Passes received messages to the driver.
    ///
    /// # Errors
    /// If the link is lost: reported once.
    fn receive(&mut self, now: MonotonicTime, driver: &mut Driver) -> Result<(), Unplugged>;

    /// Sends a message of the driver. One that cannot be sent gets no answer, which the driver counts.
    fn send(&mut self, now: MonotonicTime, transmit: &Transmit, activity: Activity);

    /// Writes the pending bytes that the line accepts.
    ///
    /// # Errors
    /// If the link is lost: reported once.
    fn flush(&mut self, now: MonotonicTime) -> Result<(), Unplugged>;

    /// Number of missing signs of life of a peer that sends them without a request, if there are too many.
    fn silence(&self, now: MonotonicTime) -> Option<u32>;

    /// Time of the next required call.
    fn next_deadline(&self) -> Option<MonotonicTime>;

    /// Waits for input, for output space if something is pending, for the waker, or for this time.
    fn wait(&self, waker: Option<BorrowedFd<'_>>, timeout: Duration);
}
