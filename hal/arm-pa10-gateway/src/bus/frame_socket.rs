//! Frames through a Unix socket (`SOCK_SEQPACKET`) in place of a bus: one frame out is one frame in.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use pb3dp_hal_platform::transport::Symptom;
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, accept_with, bind, connect, listen,
    recv, send, socket_with, socketpair,
};

use super::{BusDown, BusPort, FRAME_ROOM, judge};

/// Why a socket cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameSocketError {
    /// Nobody listens at the path.
    #[error(
        "no program listens at the socket {path}; start the emulated controller first (`pb3dp mock-arm`), or correct the path",
        path = path.display()
    )]
    Nobody {
        /// Its path.
        path: PathBuf,
    },
    /// Another program listens at the path.
    #[error(
        "another program already listens at the socket {path}; end that program, or choose another path",
        path = path.display()
    )]
    InUse {
        /// Its path.
        path: PathBuf,
    },
    /// Another error of the operating system.
    #[error("socket {path}: {error}", path = path.display())]
    Os {
        /// Its path.
        path: PathBuf,
        /// Error of the system.
        error: Errno,
    },
}

/// One end of a connection.
#[derive(Debug)]
pub struct FrameSocket {
    socket: OwnedFd,
    name: String,
}

/// A listener. The path vanishes with it.
#[derive(Debug)]
pub struct FrameListener {
    socket: OwnedFd,
    path: PathBuf,
}

impl FrameSocket {
    /// Connects to an emulated controller.
    ///
    /// # Errors
    /// If nobody listens at the path.
    pub fn connect(path: &Path) -> Result<Self, FrameSocketError> {
        let os = |error| match error {
            Errno::NOENT | Errno::CONNREFUSED => FrameSocketError::Nobody { path: path.to_path_buf() },
            error => FrameSocketError::Os { path: path.to_path_buf(), error },
        };
        let address = SocketAddrUnix::new(path).map_err(os)?;
        let socket = socket().map_err(os)?;
        connect(&socket, &address).map_err(os)?;
        Ok(Self { socket, name: format!("socket {}", path.display()) })
    }

    /// Two connected ends in one process.
    ///
    /// # Errors
    /// If the operating system has no more file descriptors.
    pub fn pair(name: &str) -> std::io::Result<(Self, Self)> {
        let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
        let (one, other) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
        let end = |socket, end: &str| Self { socket, name: format!("{name} ({end})") };
        Ok((end(one, "gateway"), end(other, "controller")))
    }
}

impl FrameListener {
    /// Listens at a path. A stale socket is replaced.
    ///
    /// # Errors
    /// If another program listens there, or the path cannot be created.
    pub fn bind(path: &Path) -> Result<Self, FrameSocketError> {
        let os = |error| FrameSocketError::Os { path: path.to_path_buf(), error };
        let address = SocketAddrUnix::new(path).map_err(os)?;
        match FrameSocket::connect(path) {
            Ok(_) => return Err(FrameSocketError::InUse { path: path.to_path_buf() }),
            Err(FrameSocketError::Nobody { .. }) if is_socket(path) => {
                rustix::fs::unlink(path).map_err(os)?;
            }
            Err(_) => {}
        }
        let socket = socket().map_err(os)?;
        bind(&socket, &address).map_err(os)?;
        listen(&socket, 1).map_err(os)?;
        Ok(Self { socket, path: path.to_path_buf() })
    }

    /// A new connection, if there is one.
    ///
    /// # Errors
    /// If the operating system returns an error.
    pub fn try_accept(&self) -> Result<Option<FrameSocket>, FrameSocketError> {
        match accept_with(&self.socket, SocketFlags::NONBLOCK | SocketFlags::CLOEXEC) {
            Ok(socket) => Ok(Some(FrameSocket { socket, name: format!("socket {}", self.path.display()) })),
            Err(Errno::AGAIN | Errno::INTR | Errno::CONNABORTED) => Ok(None),
            Err(error) => Err(FrameSocketError::Os { path: self.path.clone(), error }),
        }
    }
}

impl AsFd for FrameListener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl Drop for FrameListener {
    fn drop(&mut self) {
        let _ = rustix::fs::unlink(&self.path);
    }
}

impl BusPort for FrameSocket {
    fn name(&self) -> &str {
        &self.name
    }

    fn try_send(&mut self, frame: &[u8]) -> Result<bool, BusDown> {
        judge(send(&self.socket, frame, SendFlags::NOSIGNAL)).map(|sent| sent == Some(frame.len()))
    }

    fn try_receive(&mut self, buffer: &mut [u8; FRAME_ROOM]) -> Result<Option<usize>, BusDown> {
        match judge(recv(&self.socket, &mut buffer[..], RecvFlags::empty()).map(|(count, _)| count))? {
            // A frame is never empty.
            Some(0) => Err(BusDown { symptom: Symptom::EndOfStream }),
            other => Ok(other),
        }
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

fn socket() -> Result<OwnedFd, Errno> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)
}

fn is_socket(path: &Path) -> bool {
    rustix::fs::stat(path).is_ok_and(|stat| rustix::fs::FileType::from_raw_mode(stat.st_mode).is_socket())
}
