//! Interface of byte links: serial lines, TCP connections and pseudo-terminals.

use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::realtime::now;

/// A byte link to one peer. Only [`wait`] blocks, for a limited time.
///
/// # For backend authors
/// * A lost link returns an error from every later call, for any symptom: the end of the stream, `EIO`, `EPIPE`, `ENODEV`. It never
///   recovers; open another one instead.
/// * Bytes are delivered in order, in pieces of any size. Accepted bytes may still get lost.
/// * The file descriptor becomes readable when bytes arrive, and when the link breaks.
pub trait ByteLink: Send {
    /// Name for messages: `/dev/ttyUSB0`, `tcp 10.0.0.2:4534`.
    fn name(&self) -> &str;

    /// Reads the available bytes, as many as fit; 0 if there are none.
    ///
    /// # Errors
    /// If the link is lost.
    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged>;

    /// Writes as many bytes as the link accepts; 0 if it accepts none.
    ///
    /// # Errors
    /// If the link is lost.
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged>;

    /// File descriptor for [`wait`]; `None` for simulated time.
    fn fd(&self) -> Option<BorrowedFd<'_>>;

    /// Whether bytes that were received wait inside the link, where no file descriptor reports them. [`wait`] then does not wait.
    fn has_unread(&self) -> bool {
        false
    }

    /// Warnings about this link, found when it was opened.
    fn warning(&self) -> Option<String> {
        None
    }
}

impl<L: ByteLink + ?Sized> ByteLink for Box<L> {
    fn name(&self) -> &str {
        (**self).name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        (**self).try_read(buffer)
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        (**self).try_write(bytes)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        (**self).fd()
    }

    fn has_unread(&self) -> bool {
        (**self).has_unread()
    }

    fn warning(&self) -> Option<String> {
        (**self).warning()
    }
}

/// Opens a link, also again after it was unplugged.
pub trait Connector: Send {
    /// Opens the link in limited time.
    ///
    /// # Errors
    /// Why the link cannot be opened, and the remedy.
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError>;

    /// Name of the other end, for messages.
    fn target(&self) -> String;
}

/// Why a link cannot be opened.
pub type ConnectError = Box<dyn std::error::Error + Send + Sync>;

/// The link is lost: unplugged, closed by the other side, or broken. The symptom is for the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "if the arm moves, press its emergency stop: the link is gone ({symptom}); connect it again, then reset the arm"
)]
pub struct Unplugged {
    /// The symptom.
    pub symptom: Symptom,
}

/// Symptom of a lost link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Symptom {
    /// A read returned the end of the stream.
    #[error("end of the stream")]
    EndOfStream,
    /// An error of the operating system.
    #[error("{0}")]
    Os(Errno),
    /// An error without an error number.
    #[error("{0}")]
    Other(ErrorKind),
    /// The other side sent a record that was forged, repeated or out of order.
    #[error("a record that was forged, repeated or out of order")]
    NotAuthentic,
    /// The other side sent more frames than the line allows.
    #[error("too many frames per second")]
    Flood,
}

/// Interprets the result of a non-blocking call of [`std::io`].
///
/// `end_is_gone`: reading 0 bytes is the end of the stream.
///
/// # Errors
/// If the link is lost. "Would block" and "interrupted" are 0 bytes and no error.
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

/// Result of [`wait`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ready {
    /// The link is readable or lost.
    pub readable: bool,
    /// The link is writable or lost. Only on request.
    pub writable: bool,
    /// The other file descriptor is readable.
    pub woken: bool,
}

/// Waits until the link is readable, or writable if `for_room`, or lost, or `waker` is readable, or `timeout` has passed.
///
/// A signal ends the wait early, with nothing ready.
pub fn wait(link: Option<&dyn ByteLink>, for_room: bool, waker: Option<BorrowedFd<'_>>, timeout: Duration) -> Ready {
    let has_unread = link.is_some_and(ByteLink::has_unread);
    let timeout = if has_unread { Duration::ZERO } else { timeout };
    let ready = wait_for(link.and_then(ByteLink::fd), for_room, waker, timeout);
    Ready { readable: ready.readable || has_unread, ..ready }
}

/// The same for any file descriptor.
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

/// Waits until the kernel has removed a terminal, or `timeout` has passed.
pub fn wait_for_hangup(terminal: BorrowedFd<'_>, timeout: Duration) {
    let end = now() + timeout;
    loop {
        let left = end.saturating_since(now());
        // The kernel reports this without a request.
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

/// Events of each file descriptor; none after the time-out.
fn poll_all<const N: usize>(mut fds: [PollFd<'_>; N], timeout: &Timespec) -> [PollFlags; N] {
    match poll(&mut fds, Some(timeout)) {
        Ok(1..) => fds.map(|fd| fd.revents()),
        Ok(0) | Err(_) => [PollFlags::empty(); N],
    }
}

/// A byte link through a socket.
#[derive(Debug)]
pub struct SocketLink<S> {
    stream: S,
    name: String,
    /// A connection that the other side has closed may still accept bytes for a while: a lost link stays lost.
    gone: Option<Unplugged>,
}

impl<S> SocketLink<S> {
    /// A link through a connection that does not block.
    pub(crate) fn new(stream: S, name: String) -> Self {
        Self { stream, name, gone: None }
    }

    fn unless_gone(&mut self, run: impl FnOnce(&mut S) -> Result<usize, Unplugged>) -> Result<usize, Unplugged> {
        if let Some(gone) = self.gone {
            return Err(gone);
        }
        run(&mut self.stream).inspect_err(|&gone| self.gone = Some(gone))
    }
}

impl<S: Read + Write + AsFd + Send> ByteLink for SocketLink<S> {
    fn name(&self) -> &str {
        &self.name
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        self.unless_gone(|stream| judge(stream.read(buffer), !buffer.is_empty()))
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.unless_gone(|stream| judge(stream.write(bytes), false))
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.stream.as_fd())
    }
}

/// One end of a pair of links in one process.
pub type PairLink = SocketLink<UnixStream>;

/// Creates two links that are each other's peer; dropping one unplugs the other.
///
/// # Errors
/// If the operating system has no more file descriptors.
pub fn pair(name: &str) -> std::io::Result<(PairLink, PairLink)> {
    let (one, other) = UnixStream::pair()?;
    let link = |stream: UnixStream, end: &str| -> std::io::Result<PairLink> {
        stream.set_nonblocking(true)?;
        Ok(SocketLink::new(stream, format!("{name} ({end})")))
    };
    Ok((link(one, "host")?, link(other, "peer")?))
}
