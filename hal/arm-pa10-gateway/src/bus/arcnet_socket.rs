//! Frames through an ARCNET card of this computer.
//!
//! Linux provides an ARCNET interface as a packet socket of the protocol `ETH_P_ARCNET`, which carries complete frames of
//! [`pb3dp_arm_pa10_protocol::arcnet`].

use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};

use rustix::io::Errno;
use rustix::net::netdevice::name_to_index;
use rustix::net::{
    AddressFamily, Protocol, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, recv, send, socket_with,
};

use super::{BusDown, BusPort, FRAME_ROOM, judge};

/// `ETH_P_ARCNET` of `linux/if_ether.h`.
const ETH_P_ARCNET: u16 = 0x001A;

/// Why an ARCNET interface cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ArcnetError {
    /// There is no such interface.
    #[error(
        "there is no network interface {name}; load the card's driver (usually com20020_pci) and arc_rawmode, and find the \
         name with `ip link`"
    )]
    Missing {
        /// Its name.
        name: String,
    },
    /// The interface is of another kind.
    #[error(
        "network interface {name} is of type {got}, not ARCNET (7); choose the one that `ip link` shows as link/arcnet"
    )]
    OtherKind {
        /// Its name.
        name: String,
        /// The type reported by the system.
        got: u16,
    },
    /// The interface is down.
    #[error("network interface {name} is down; bring it up: ip link set {name} up")]
    Down {
        /// Its name.
        name: String,
    },
    /// Another program uses it.
    #[error("network interface {name} is in use by another program or arm; end that one, or correct the name")]
    InUse {
        /// Its name.
        name: String,
    },
    /// Not permitted.
    #[error(
        "this user may not open packet sockets; run as root, or grant the capabilities: setcap \
         cap_net_raw,cap_sys_nice,cap_ipc_lock+ep PROGRAM"
    )]
    Permission,
    /// Another error of the operating system.
    #[error("network interface {name}: {error}")]
    Os {
        /// Its name.
        name: String,
        /// Error of the system.
        error: Errno,
    },
}

/// An ARCNET interface.
#[derive(Debug)]
pub struct ArcnetSocket {
    socket: OwnedFd,
    name: String,
    /// Lock against other programs of ours on this bus.
    _claim: OwnedFd,
}

impl ArcnetSocket {
    /// Opens an interface by name.
    ///
    /// # Errors
    /// If there is no such interface, it is no ARCNET interface, it is down, another program uses it, or the user lacks the
    /// permission.
    pub fn open(interface: &str) -> Result<Self, ArcnetError> {
        let name = || interface.to_owned();
        let os = |error| ArcnetError::Os { name: name(), error };
        let about = About::ask(interface).map_err(|error| match error {
            Errno::NODEV | Errno::INVAL => ArcnetError::Missing { name: name() },
            other => os(other),
        })?;
        if about.kind != libc::ARPHRD_ARCNET {
            return Err(ArcnetError::OtherKind { name: name(), got: about.kind });
        }
        if !about.is_up {
            return Err(ArcnetError::Down { name: name() });
        }
        let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
        let protocol = Protocol::from_raw(u32::from(ETH_P_ARCNET.to_be()).try_into().map_err(|_| os(Errno::INVAL))?);
        let socket = socket_with(AddressFamily::PACKET, SocketType::RAW, flags, Some(protocol));
        let socket = socket.map_err(|error| match error {
            Errno::PERM | Errno::ACCESS => ArcnetError::Permission,
            other => os(other),
        })?;
        let claim = claim(interface).map_err(|error| match error {
            Errno::ADDRINUSE => ArcnetError::InUse { name: name() },
            other => os(other),
        })?;
        bind(&socket, about.index).map_err(os)?;
        Ok(Self { socket, name: format!("ARCNET interface {interface}"), _claim: claim })
    }

    fn receive(&self, buffer: &mut [u8]) -> Result<usize, Errno> {
        recv(&self.socket, buffer, RecvFlags::empty()).map(|(count, _)| count)
    }
}

impl BusPort for ArcnetSocket {
    fn name(&self) -> &str {
        &self.name
    }

    fn try_send(&mut self, frame: &[u8]) -> Result<bool, BusDown> {
        judge(send(&self.socket, frame, SendFlags::NOSIGNAL)).map(|sent| sent == Some(frame.len()))
    }

    fn try_receive(&mut self, buffer: &mut [u8; FRAME_ROOM]) -> Result<Option<usize>, BusDown> {
        judge(self.receive(buffer))
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// Locks an interface for this program: with an abstract socket name, which only one socket can have. The name is as private to a
/// network namespace as interfaces are, and vanishes with the program.
fn claim(interface: &str) -> Result<OwnedFd, Errno> {
    let claim = socket_with(AddressFamily::UNIX, SocketType::DGRAM, SocketFlags::CLOEXEC, None)?;
    let name = format!("pb3dp owner of ARCNET interface {interface}");
    rustix::net::bind(&claim, &SocketAddrUnix::new_abstract_name(name.as_bytes())?)?;
    Ok(claim)
}

/// Properties of an interface from the kernel.
struct About {
    index: u32,
    /// ARPHRD_ of `linux/if_arp.h`.
    kind: u16,
    is_up: bool,
}

impl About {
    fn ask(interface: &str) -> Result<Self, Errno> {
        let socket = socket_with(AddressFamily::INET, SocketType::DGRAM, SocketFlags::CLOEXEC, None)?;
        let hardware = query(&socket, libc::SIOCGIFHWADDR, interface)?;
        let flags = query(&socket, libc::SIOCGIFFLAGS, interface)?;
        // SAFETY: these calls initialise these parts, and any bits are valid numbers.
        let (kind, flags) = unsafe { (hardware.ifr_ifru.ifru_hwaddr.sa_family, flags.ifr_ifru.ifru_flags) };
        let is_up = libc::c_int::from(flags) & libc::IFF_UP != 0;
        Ok(Self { index: name_to_index(&socket, interface)?, kind, is_up })
    }
}

/// Queries the kernel about an interface.
fn query(socket: &OwnedFd, call: libc::Ioctl, interface: &str) -> Result<libc::ifreq, Errno> {
    // SAFETY: all zeros are a valid request.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    let is_name = !interface.is_empty() && interface.len() < request.ifr_name.len() && !interface.contains('\0');
    if !is_name {
        return Err(Errno::INVAL);
    }
    for (place, byte) in request.ifr_name.iter_mut().zip(interface.bytes()) {
        *place = byte as libc::c_char;
    }
    // SAFETY: the socket is open, and the request is initialised and lives through the call, which only writes to it.
    let result = unsafe { libc::ioctl(socket.as_raw_fd(), call, &raw mut request) };
    if result == 0 { Ok(request) } else { Err(last_error()) }
}

/// Binds a packet socket to an interface, so that sent frames use it.
fn bind(socket: &OwnedFd, index: u32) -> Result<(), Errno> {
    let address = libc::sockaddr_ll {
        sll_family: libc::AF_PACKET as libc::c_ushort,
        sll_protocol: ETH_P_ARCNET.to_be(),
        sll_ifindex: i32::try_from(index).map_err(|_| Errno::INVAL)?,
        sll_hatype: 0,
        sll_pkttype: 0,
        sll_halen: 0,
        sll_addr: [0; 8],
    };
    let length = size_of::<libc::sockaddr_ll>() as libc::socklen_t;
    // SAFETY: the address is a complete sockaddr_ll of this length and lives through the call; the socket is open.
    let result = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) };
    if result == 0 { Ok(()) } else { Err(last_error()) }
}

fn last_error() -> Errno {
    Errno::from_io_error(&std::io::Error::last_os_error()).unwrap_or(Errno::IO)
}
