//! TCP connections.

use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use super::transport::{ByteLink, ConnectError, Connector, SocketLink};

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
pub type TcpLink = SocketLink<TcpStream>;

impl SocketLink<TcpStream> {
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
        Ok(Self::new(stream, name))
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
