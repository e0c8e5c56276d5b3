//! The bus of an arm as a gateway sees it: ARCNET frames out and in.
//!
//! * [`ArcnetSocket`]: an ARCNET card, through the kernel.
//! * [`FrameSocket`]: a Unix socket that keeps frames apart, to an emulated controller; [`FrameListener`] is its other end.

mod arcnet_socket;
mod frame_socket;

use std::os::fd::BorrowedFd;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_hal_platform::transport::{ConnectError, Symptom};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

pub use arcnet_socket::{ArcnetError, ArcnetSocket};
pub use frame_socket::{FrameListener, FrameSocket, FrameSocketError};

/// Opens a bus.
///
/// # Errors
/// If there is none, or it may not be used.
pub fn open(target: &BusTarget) -> Result<Box<dyn BusPort>, ConnectError> {
    Ok(match target {
        BusTarget::Arcnet(interface) => Box::new(ArcnetSocket::open(interface)?),
        BusTarget::Socket(path) => Box::new(FrameSocket::connect(path)?),
    })
}

/// Room for a frame of the bus, and for one that is longer than allowed.
pub const FRAME_ROOM: usize = pb3dp_arm_pa10_protocol::arcnet::FRAME_LENGTH_MAX + 16;

/// The bus of one arm. Nothing here blocks or allocates.
///
/// # For backend authors
/// * A frame goes out whole or not at all. Without room it is lost, as on a bus: the receiver asks for what it misses.
/// * Frames come in order, one at a time. A frame that is longer than the buffer is cut: its reader refuses it.
/// * A bus that is down tells so; it may come back, and is asked again.
/// * The file descriptor is readable when there is a frame, and when the bus goes down.
pub trait BusPort: Send {
    /// For messages: `ARCNET interface arc0`.
    fn name(&self) -> &str;

    /// Hands over a frame; whether there was room for it.
    ///
    /// # Errors
    /// If the bus is down.
    fn try_send(&mut self, frame: &[u8]) -> Result<bool, BusDown>;

    /// The next frame that is there: its length in the buffer.
    ///
    /// # Errors
    /// If the bus is down.
    fn try_receive(&mut self, buffer: &mut [u8; FRAME_ROOM]) -> Result<Option<usize>, BusDown>;

    /// What is waited for.
    fn fd(&self) -> BorrowedFd<'_>;
}

/// The bus is down: the interface was set down or removed, or the emulated controller ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the bus is down ({symptom}); check the card, its interface and the cable to the controller")]
pub struct BusDown {
    /// How it showed.
    pub symptom: Symptom,
}

/// Waits until the bus has a frame or is down, or `timeout` has passed; whether it has. A signal ends the wait early.
pub fn wait(bus: &dyn BusPort, timeout: Duration) -> bool {
    let timeout = Timespec {
        tv_sec: i64::try_from(timeout.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: i64::from(timeout.subsec_nanos()),
    };
    matches!(poll(&mut [PollFd::from_borrowed_fd(bus.fd(), PollFlags::IN)], Some(&timeout)), Ok(1..))
}

/// What a call to send or receive says of the bus; `None` if it could do nothing now.
fn judge(result: Result<usize, Errno>) -> Result<Option<usize>, BusDown> {
    match result {
        Ok(count) => Ok(Some(count)),
        Err(Errno::AGAIN | Errno::INTR | Errno::NOBUFS) => Ok(None),
        Err(error) => Err(BusDown { symptom: Symptom::Os(error) }),
    }
}
