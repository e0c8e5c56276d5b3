//! Byte links: what serial lines, TCP connections and pseudo-terminals have in common.

use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::realtime::now;

/// A byte link to one peer. Nothing here blocks; [`wait`] does, with a bound.
///
/// # For backend authors
/// * A link that is gone tells so with every call from then on, whatever the symptom: the end of the stream, `EIO`, `EPIPE`,
///   `ENODEV`. It never comes back; another one is opened instead.
/// * Bytes are delivered in order, in pieces of any size. What was taken may still get lost on the way.
/// * The file descriptor becomes readable when there are bytes, and when the link breaks.
pub trait ByteLink: Send {
    /// For messages: `/dev/ttyUSB0`, `tcp 10.0.0.2:4534`.
    fn name(&self) -> &str;

    /// The bytes that are there, as many as fit; 0 if there are none.
    ///
    /// # Errors
    /// If the link is gone.
    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged>;

    /// Hands over as many bytes as there is room for; 0 if there is none.
    ///
    /// # Errors
    /// If the link is gone.
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged>;

    /// What [`wait`] waits for; nothing if nobody can wait for it, as time is simulated.
    fn fd(&self) -> Option<BorrowedFd<'_>>;

    /// What the operator should know about this link, found when it was opened.
    fn warning(&self) -> Option<String> {
        None
    }
}

/// Opens a link, and opens it again when an operator has plugged it in again.
pub trait Connector: Send {
    /// Opens the link, in bounded time.
    ///
    /// # Errors
    /// Why it cannot be opened, and what to do.
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError>;

    /// For messages: where it leads.
    fn target(&self) -> String;
}

/// Why a link cannot be opened.
pub type ConnectError = Box<dyn std::error::Error + Send + Sync>;

/// The link is gone: unplugged, closed by the other side, or broken. The symptom is for the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the link is gone ({symptom}); connect it again, then reset the arm")]
pub struct Unplugged {
    /// How it showed.
    pub symptom: Symptom,
}

/// How it showed that a link is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Symptom {
    /// Reading met the end of the stream.
    #[error("end of the stream")]
    EndOfStream,
    /// An error of the operating system.
    #[error("{0}")]
    Os(Errno),
    /// An error without a number.
    #[error("{0}")]
    Other(ErrorKind),
}

/// What a call of [`std::io`] on a link that does not block says about the link.
///
/// `end_is_gone`: reading 0 bytes is the end of the stream.
///
/// # Errors
/// If the link is gone. "Nothing there", "no room" and "interrupted" are 0 bytes and no error.
pub fn judge(result: std::io::Result<usize>, end_is_gone: bool) -> Result<usize, Unplugged> {
    match result {
        Ok(0) if end_is_gone => Err(Unplugged { symptom: Symptom::EndOfStream }),
        Ok(count) => Ok(count),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
        Err(error) => {
            let symptom = Errno::from_io_error(&error).map_or(Symptom::Other(error.kind()), Symptom::Os);
            Err(Unplugged { symptom })
        }
    }
}

/// What [`wait`] found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ready {
    /// The link has bytes, or is gone.
    pub readable: bool,
    /// The link has room, or is gone. Only where it was asked for.
    pub writable: bool,
    /// The other file descriptor has something.
    pub woken: bool,
}

/// Waits until the link has bytes, or room if `for_room`, or is gone, or `waker` is readable, or `timeout` has passed.
///
/// A signal ends the wait early, with nothing ready.
pub fn wait(link: Option<&dyn ByteLink>, for_room: bool, waker: Option<BorrowedFd<'_>>, timeout: Duration) -> Ready {
    wait_for(link.and_then(ByteLink::fd), for_room, waker, timeout)
}

/// The same for whatever has a file descriptor.
pub fn wait_for(
    link: Option<BorrowedFd<'_>>,
    for_room: bool,
    waker: Option<BorrowedFd<'_>>,
    timeout: Duration,
) -> Ready {
    let interest = if for_room { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
    let of_link = link.map(|link| PollFd::from_borrowed_fd(link, interest));
    let of_waker = waker.map(|waker| PollFd::from_borrowed_fd(waker, PollFlags::IN));
    let timeout = Timespec {
        tv_sec: i64::try_from(timeout.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: i64::from(timeout.subsec_nanos()),
    };
    let (link, waker) = match (of_link, of_waker) {
        (Some(link), Some(waker)) => {
            let [link, waker] = poll_all([link, waker], &timeout);
            (link, waker)
        }
        (Some(link), None) => (poll_all([link], &timeout)[0], PollFlags::empty()),
        (None, Some(waker)) => (PollFlags::empty(), poll_all([waker], &timeout)[0]),
        (None, None) => {
            poll_all([], &timeout);
            (PollFlags::empty(), PollFlags::empty())
        }
    };
    let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
    Ready {
        readable: link.intersects(PollFlags::IN | gone),
        writable: for_room && link.intersects(PollFlags::OUT | gone),
        woken: !waker.is_empty(),
    }
}

/// Waits until the kernel has taken a terminal away, or `timeout` has passed.
pub fn wait_for_hangup(terminal: BorrowedFd<'_>, timeout: Duration) {
    let end = now() + timeout;
    loop {
        let left = end.saturating_since(now());
        // Of this the kernel tells unasked.
        let mut fds = [PollFd::from_borrowed_fd(terminal, PollFlags::empty())];
        let timeout = Timespec {
            tv_sec: i64::try_from(left.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: i64::from(left.subsec_nanos()),
        };
        // A signal ends the wait early.
        if left.is_zero() || poll(&mut fds, Some(&timeout)) == Ok(1) {
            return;
        }
    }
}

/// What each of these has; nothing if the time passes first.
fn poll_all<const N: usize>(mut fds: [PollFd<'_>; N], timeout: &Timespec) -> [PollFlags; N] {
    match poll(&mut fds, Some(timeout)) {
        Ok(1..) => fds.map(|fd| fd.revents()),
        Ok(0) | Err(_) => [PollFlags::empty(); N],
    }
}

/// One end of a pair of links in one process.
#[derive(Debug)]
pub struct PairLink {
    stream: UnixStream,
    name: String,
}

/// Two links that are each other's peer; dropping one unplugs the other.
///
/// # Errors
/// If the operating system has no more file descriptors.
pub fn pair(name: &str) -> std::io::Result<(PairLink, PairLink)> {
    let (one, other) = UnixStream::pair()?;
    let link = |stream: UnixStream, end: &str| -> std::io::Result<PairLink> {
        stream.set_nonblocking(true)?;
        Ok(PairLink { stream, name: format!("{name} ({end})") })
    };
    Ok((link(one, "host")?, link(other, "peer")?))
}

impl ByteLink for PairLink {
    fn name(&self) -> &str {
        &self.name
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        judge(self.stream.read(buffer), !buffer.is_empty())
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        judge(self.stream.write(bytes), false)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.stream.as_fd())
    }
}
