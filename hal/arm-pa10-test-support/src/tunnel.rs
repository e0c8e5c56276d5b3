//! A TUN device that the kernel treats as an ARCNET card: what is sent on its interface is read here, and the reverse.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;

use pb3dp_arm_pa10_gateway::bus::{BusDown, BusPort, FRAME_ROOM};
use pb3dp_hal_platform::transport::Symptom;
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketType, socket};

/// The device puts flags and protocol before each frame.
const ENVELOPE: [u8; 4] = [0, 0, 0, libc::ETH_P_ARCNET as u8];

/// The far end of an ARCNET interface.
pub struct Tunnel {
    file: File,
    control: OwnedFd,
    interface: String,
    name: String,
}

/// The request for an interface with these flags.
fn request(interface: &str, flags: libc::c_int) -> libc::ifreq {
    // SAFETY: all zeros are a valid request.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    for (place, byte) in request.ifr_name.iter_mut().zip(interface.bytes()) {
        *place = byte.cast_signed();
    }
    request.ifr_ifru.ifru_flags = flags as libc::c_short;
    request
}

impl Tunnel {
    /// Makes the interface, which is down. The caller needs the right to administer its network.
    ///
    /// # Errors
    /// If the system refuses one of the steps.
    pub fn open(name: &str) -> Result<Self> {
        let file = File::options().read(true).write(true).custom_flags(libc::O_NONBLOCK).open("/dev/net/tun")?;
        let request = request(name, libc::IFF_TUN);
        let tunnel = |call: libc::c_ulong, argument: *const libc::c_void| {
            // SAFETY: the tunnel is open and the argument has the type of this call: a request, or a number.
            let result = unsafe { libc::ioctl(file.as_raw_fd(), call as _, argument) };
            if result == 0 { Ok(()) } else { Err(Error::last_os_error()) }
        };
        tunnel(libc::TUNSETIFF as libc::c_ulong, (&raw const request).cast())?;
        let kind = usize::from(libc::ARPHRD_ARCNET);
        tunnel(libc::TUNSETLINK as libc::c_ulong, std::ptr::without_provenance(kind))?;
        let control = socket(AddressFamily::INET, SocketType::DGRAM, None)?;
        Ok(Self { file, control, interface: name.to_owned(), name: format!("far end of {name}") })
    }

    /// Sets the interface up or down.
    ///
    /// # Errors
    /// If the system refuses it.
    pub fn switch(&self, on: bool) -> Result<()> {
        let request = request(&self.interface, if on { libc::IFF_UP | libc::IFF_RUNNING } else { 0 });
        // SAFETY: the socket is open and the request is initialised.
        let result = unsafe { libc::ioctl(self.control.as_raw_fd(), libc::SIOCSIFFLAGS as _, &raw const request) };
        if result == 0 { Ok(()) } else { Err(Error::last_os_error()) }
    }
}

/// Nothing there, or an interface that is down: as on a bus, a frame is lost.
fn is_lost(error: &Error) -> bool {
    error.kind() == ErrorKind::WouldBlock || error.raw_os_error() == Some(Errno::IO.raw_os_error())
}

fn down(error: &Error) -> BusDown {
    BusDown { symptom: Symptom::Other(error.kind()) }
}

impl BusPort for Tunnel {
    fn name(&self) -> &str {
        &self.name
    }

    fn try_send(&mut self, frame: &[u8]) -> std::result::Result<bool, BusDown> {
        match self.file.write(&[&ENVELOPE, frame].concat()) {
            Ok(_) => Ok(true),
            Err(error) if is_lost(&error) => Ok(false),
            Err(error) => Err(down(&error)),
        }
    }

    fn try_receive(&mut self, buffer: &mut [u8; FRAME_ROOM]) -> std::result::Result<Option<usize>, BusDown> {
        let mut enclosed = [0; ENVELOPE.len() + FRAME_ROOM];
        loop {
            match self.file.read(&mut enclosed) {
                Ok(count) if count > ENVELOPE.len() && enclosed.starts_with(&ENVELOPE) => {
                    let frame = &enclosed[ENVELOPE.len()..count];
                    buffer[..frame.len()].copy_from_slice(frame);
                    return Ok(Some(frame.len()));
                }
                // Of another protocol, which the kernel tries on every interface.
                Ok(_) => {}
                Err(error) if is_lost(&error) => return Ok(None),
                Err(error) => return Err(down(&error)),
            }
        }
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}
