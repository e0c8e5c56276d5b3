//! TCP connections.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use super::transport::{ByteLink, ConnectError, Connector, Unplugged, judge};

/// Time limit for a gateway to accept.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(500);

/// Address of a gateway. A number and no name: a name lookup has no time limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TcpConfig {
    /// Address and port.
    pub address: SocketAddr,
}

/// Why there is no connection.
#[derive(Debug, thiserror::Error)]
#[error(
    "no connection to {address} within {CONNECT_TIMEOUT:?}; check that the gateway runs and that this is its address"
)]
pub struct TcpError {
    address: SocketAddr,
    #[source]
    source: std::io::Error,
}

/// A TCP connection without send delay.
#[derive(Debug)]
pub struct TcpLink {
    stream: TcpStream,
    name: String,
    /// A connection that the other side has closed still accepts bytes for a while.
    gone: Option<Unplugged>,
}

impl TcpLink {
    /// Connects to a gateway.
    ///
    /// # Errors
    /// If nobody accepts.
    pub fn connect(config: &TcpConfig) -> Result<Self, TcpError> {
        let TcpConfig { address } = *config;
        let connected = TcpStream::connect_timeout(&address, CONNECT_TIMEOUT).and_then(Self::from_stream);
        connected.map_err(|source| TcpError { address, source })
    }

    /// Wraps an existing connection.
    ///
    /// # Errors
    /// If it is closed already.
    pub fn from_stream(stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_nonblocking(true)?;
        let name = format!("tcp {}", stream.peer_addr()?);
        Ok(Self { stream, name, gone: None })
    }
}

impl ByteLink for TcpLink {
    fn name(&self) -> &str {
        &self.name
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        if let Some(gone) = self.gone {
            return Err(gone);
        }
        let read = judge(self.stream.read(buffer), !buffer.is_empty());
        self.gone = read.err();
        read
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        if let Some(gone) = self.gone {
            return Err(gone);
        }
        let written = judge(self.stream.write(bytes), false);
        self.gone = written.err();
        written
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.stream.as_fd())
    }
}

impl Connector for TcpConfig {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        Ok(Box::new(TcpLink::connect(self)?))
    }

    fn target(&self) -> String {
        format!("tcp {}", self.address)
    }
}
