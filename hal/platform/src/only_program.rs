//! A name of which only one program of a computer can be the holder, for what must not be done by two programs at once.

use std::io;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// The holder of a name. The kernel frees the name when this is dropped or its process ends, in whatever way.
///
/// The name is the address of a socket in the abstract namespace of Linux (unix(7)): there is no file that a crash leaves behind. Programs
/// in different network namespaces, such as containers, do not see each other.
#[derive(Debug)]
pub struct OnlyProgram {
    _socket: UnixDatagram,
}

impl OnlyProgram {
    /// Becomes the holder of a name, of at most 107 bytes.
    ///
    /// # Errors
    /// [`io::ErrorKind::AddrInUse`] if another holder lives; other kinds if the name is too long, or the system has no such sockets.
    pub fn take(name: &str) -> io::Result<Self> {
        let address = SocketAddr::from_abstract_name(name)?;
        Ok(Self { _socket: UnixDatagram::bind_addr(&address)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_has_one_holder_until_it_is_dropped() {
        let name = format!("pb3dp-test-{}", std::process::id());
        let holder = OnlyProgram::take(&name).unwrap();
        assert_eq!(OnlyProgram::take(&name).unwrap_err().kind(), io::ErrorKind::AddrInUse);
        let _other = OnlyProgram::take(&format!("{name}-other")).unwrap();
        drop(holder);
        OnlyProgram::take(&name).unwrap();
    }
}
