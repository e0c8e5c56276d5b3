//! Serial ports.
//!
//! The port is tokio-serial's, because its writes never block: the plain port of serialport waits in the kernel until a full buffer
//! has space, for any time-out. [`wait`](pb3dp_hal_platform::transport::wait) does the waiting, because tokio's timers count whole
//! milliseconds.

mod discovery;
mod latency;

use std::io::{Read, Write};
use std::os::fd::{AsRawFd, BorrowedFd, OwnedFd};
use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{LineTooSlow, check_line};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_hal_platform::transport::{ByteLink, ConnectError, Connector, Unplugged, judge, wait_for_hangup};
use rustix::fs::{FlockOperation, Mode, OFlags, flock};
use rustix::io::Errno;
use tokio_serial::{ClearBuffer, DataBits, FlowControl, Parity, SerialPort, SerialStream, StopBits};

pub use discovery::{PortDescription, PortKind, ports};
pub use latency::Latency;

/// Tolerance of the baud rate, as a share: receivers with 10 bits per byte accept it.
const BAUD_TOLERANCE: f64 = 0.02;

/// The kernel removes a disconnected port within milliseconds, unless a user keeps it open.
const HANGUP_MAX: Duration = Duration::from_secs(1);

/// Path, speed and purpose of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SerialConfig {
    /// `/dev/ttyUSB0`; better a name in `/dev/serial/by-id`, which stays with the adapter.
    pub path: String,
    /// Bits per second.
    pub baud: u32,
    /// Time between two commands.
    pub cycle: Duration,
}

impl SerialConfig {
    /// The port at `path` with `baud` bits per second, for this link.
    pub fn of_link(path: String, baud: u32, link: &GatewayLinkConfig) -> Self {
        Self { path, baud, cycle: link.cycle }
    }
}

/// Why a port cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SerialError {
    /// The line is too slow for a command and its answer.
    #[error("serial port {port}")]
    TooSlow {
        /// Its path.
        port: String,
        /// Configured rate.
        #[source]
        source: LineTooSlow,
    },
    /// Another program uses it.
    #[error("serial port {port} is in use by another program or arm; end that one, or correct the path")]
    InUse {
        /// Its path.
        port: String,
    },
    /// It does not exist.
    #[error("serial port {port} does not exist; plug it in, or correct the path ({present})")]
    Missing {
        /// Its path.
        port: String,
        /// Existing ports.
        present: String,
    },
    /// Not permitted.
    #[error("this user may not open serial port {port}; on most systems members of the group dialout may")]
    Permission {
        /// Its path.
        port: String,
    },
    /// Opening failed for another reason.
    #[error("serial port {port} cannot be opened with {baud} baud; check that it is a serial port")]
    Open {
        /// Its path.
        port: String,
        /// The requested rate.
        baud: u32,
        /// Error of the system.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The port runs at another rate than requested.
    #[error(
        "serial port {port} was set to {asked} baud but runs at {got}; choose a supported rate, or another adapter"
    )]
    Baud {
        /// Its path.
        port: String,
        /// Requested rate.
        asked: u32,
        /// Actual rate.
        got: u32,
    },
}

/// An open serial port, 8N1, without flow control, locked for this program.
#[derive(Debug)]
pub struct SerialLink {
    // Dropped before the runtime, which must outlive it.
    stream: SerialStream,
    _runtime: tokio::runtime::Runtime,
    path: String,
    baud: u32,
    latency: Latency,
    /// A read or write has failed.
    is_gone: bool,
}

impl SerialLink {
    /// Opens a port and discards earlier input.
    ///
    /// # Errors
    /// If another program uses it, it is too slow for the cycle, or it runs at another rate than requested.
    pub fn open(config: &SerialConfig) -> Result<Self, SerialError> {
        let SerialConfig { path, baud, cycle } = config;
        let port = || path.clone();
        check_line(*baud, *cycle).map_err(|source| SerialError::TooSlow { port: port(), source })?;
        let other =
            |source: Box<dyn std::error::Error + Send + Sync>| SerialError::Open { port: port(), baud: *baud, source };
        let probe = probe(path)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().map_err(|e| other(e.into()))?;
        let builder = tokio_serial::new(path, *baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(StopBits::One)
            .flow_control(FlowControl::None);
        let stream = {
            let _guard = runtime.enter();
            SerialStream::open(&builder).map_err(|error| other(error.into()))?
        };
        // Closed last, so that the port is never without a user: some adapters reset the connected device otherwise.
        drop(probe);
        let got = stream.baud_rate().map_err(|error| other(error.into()))?;
        judge_baud(path, *baud, got)?;
        stream.clear(ClearBuffer::All).map_err(|error| other(error.into()))?;
        let (path, latency) = (path.clone(), Latency::NotUsb);
        let mut link = Self { stream, _runtime: runtime, path, baud: got, latency, is_gone: false };
        link.latency = latency::lower(link.descriptor(), &config.path);
        Ok(link)
    }

    /// The actual rate, bits per second.
    pub fn baud(&self) -> u32 {
        self.baud
    }

    /// Whether the adapter passes bytes on at once.
    pub fn latency(&self) -> &Latency {
        &self.latency
    }
}

impl SerialLink {
    fn descriptor(&self) -> BorrowedFd<'_> {
        // SAFETY: the stream owns the descriptor and is borrowed for as long as the result.
        unsafe { BorrowedFd::borrow_raw(self.stream.as_raw_fd()) }
    }
}

impl ByteLink for SerialLink {
    fn name(&self) -> &str {
        &self.path
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        // A disconnected port returns 0 bytes or an error.
        let read = judge(self.stream.read(buffer), !buffer.is_empty());
        self.is_gone |= read.is_err();
        read
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        let written = judge(self.stream.write(bytes), false);
        self.is_gone |= written.is_err();
        written
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.descriptor())
    }

    fn warning(&self) -> Option<String> {
        self.latency.warning(&self.path)
    }
}

impl Drop for SerialLink {
    fn drop(&mut self) {
        if self.is_gone {
            // A write fails before the kernel removes the port. Closed in between, the port would wait up to 30 s for bytes that
            // cannot be sent, and block its removal: it would not come back earlier when it is connected again.
            wait_for_hangup(self.descriptor(), HANGUP_MAX);
        }
        // Otherwise closing waits up to 30 s for bytes that nobody reads.
        let _ = self.stream.clear(ClearBuffer::Output);
    }
}

impl Connector for SerialConfig {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        Ok(Box::new(SerialLink::open(self)?))
    }

    fn target(&self) -> String {
        format!("serial port {} ({} baud)", self.path, self.baud)
    }
}

/// Checks whether another program uses the port, without disturbing it.
///
/// Opening it by serialport as root would disturb it: closing the refused port clears the kernel's flag of exclusive use, and a
/// third program could open it.
fn probe(path: &str) -> Result<OwnedFd, SerialError> {
    let port = || path.to_owned();
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let probe = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| match error {
        Errno::BUSY => SerialError::InUse { port: port() },
        Errno::NOENT | Errno::NODEV | Errno::NXIO => SerialError::Missing { port: port(), present: discovery::names() },
        Errno::ACCESS | Errno::PERM => SerialError::Permission { port: port() },
        source => SerialError::Open { port: port(), baud: 0, source: source.into() },
    })?;
    flock(&probe, FlockOperation::NonBlockingLockExclusive).map_err(|_| SerialError::InUse { port: port() })?;
    // The port takes the lock itself.
    flock(&probe, FlockOperation::Unlock).map_err(|_| SerialError::InUse { port: port() })?;
    Ok(probe)
}

/// Drivers round the rate to what their chip provides, and some accept any rate and keep their own.
fn judge_baud(port: &str, asked: u32, got: u32) -> Result<(), SerialError> {
    let difference = (f64::from(got) - f64::from(asked)).abs();
    if difference <= BAUD_TOLERANCE * f64::from(asked) {
        return Ok(());
    }
    Err(SerialError::Baud { port: port.to_owned(), asked, got })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_keeps_its_own_rate_is_refused() {
        // As measured on a 16550: 1 Mbaud is accepted and 115200 read back.
        let error = judge_baud("/dev/ttyS0", 1_000_000, 115_200).unwrap_err();
        assert!(error.to_string().contains("set to 1000000 baud but runs at 115200"), "{error}");
        for got in [921_600, 923_076, 909_091] {
            assert!(judge_baud("/dev/ttyUSB0", 921_600, got).is_ok(), "{got}");
        }
        for got in [0, 460_800, 890_000, 950_000, u32::MAX] {
            assert!(judge_baud("/dev/ttyUSB0", 921_600, got).is_err(), "{got}");
        }
    }
}
