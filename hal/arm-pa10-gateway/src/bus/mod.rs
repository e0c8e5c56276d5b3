//! The bus of an arm on the gateway's side: ARCNET frames out and in.
//!
//! * [`ArcnetSocket`]: an ARCNET card, through the kernel.
//! * [`FrameSocket`]: a Unix socket with frames, to an emulated controller; [`FrameListener`] is its other end.

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
/// If there is none, or the user lacks the permission.
pub fn open(target: &BusTarget) -> Result<Box<dyn BusPort>, ConnectError> {
    Ok(match target {
        BusTarget::Arcnet(interface) => Box::new(ArcnetSocket::open(interface)?),
        BusTarget::Socket(path) => Box::new(FrameSocket::connect(path)?),
    })
}

/// Size for a frame of the bus, and for one that is longer than allowed.
pub const FRAME_ROOM: usize = pb3dp_arm_pa10_protocol::arcnet::FRAME_LENGTH_MAX + 16;

/// The bus of one arm. No call blocks or allocates.
///
/// # For backend authors
/// * A frame is sent completely or not at all. Without space it is lost, as on a bus: the receiver requests missing data again.
/// * Frames arrive in order, one at a time. A frame longer than the buffer is truncated, and its reader refuses it.
/// * A bus that is down returns an error; it may come back, and is tried again.
/// * The file descriptor is readable when there is a frame, and when the bus goes down.
pub trait BusPort: Send {
    /// Name for messages: `ARCNET interface arc0`.
    fn name(&self) -> &str;

    /// Sends a frame; returns whether there was space for it.
    ///
    /// # Errors
    /// If the bus is down.
    fn try_send(&mut self, frame: &[u8]) -> Result<bool, BusDown>;

    /// Reads the next frame: its length in the buffer.
    ///
    /// # Errors
    /// If the bus is down.
    fn try_receive(&mut self, buffer: &mut [u8; FRAME_ROOM]) -> Result<Option<usize>, BusDown>;

    /// File descriptor to wait for.
    fn fd(&self) -> BorrowedFd<'_>;
}

/// The bus is down: the interface was set down or removed, or the emulated controller ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the bus is down ({symptom}); check the card, its interface and the cable to the controller")]
pub struct BusDown {
    /// The symptom.
    pub symptom: Symptom,
}

/// Waits until the bus has a frame or is down, or `timeout` has passed; returns whether it has. A signal ends the wait early.
pub fn wait(bus: &dyn BusPort, timeout: Duration) -> bool {
    let timeout = Timespec {
        tv_sec: i64::try_from(timeout.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: i64::from(timeout.subsec_nanos()),
    };
    matches!(poll(&mut [PollFd::from_borrowed_fd(bus.fd(), PollFlags::IN)], Some(&timeout)), Ok(1..))
}

/// Interprets the result of a send or receive call; `None` if it would block.
fn judge(result: Result<usize, Errno>) -> Result<Option<usize>, BusDown> {
    match result {
        Ok(count) => Ok(Some(count)),
        Err(Errno::AGAIN | Errno::INTR | Errno::NOBUFS) => Ok(None),
        Err(error) => Err(BusDown { symptom: Symptom::Os(error) }),
    }
}
