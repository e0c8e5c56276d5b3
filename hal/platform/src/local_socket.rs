//! Sockets of the file system, between programs of one computer. Only programs of the same user, and of root, connect.

use std::fs::{Permissions, metadata, remove_file, set_permissions, symlink_metadata};
use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use rustix::io::Errno;
use rustix::net::sockopt::socket_peercred;
use rustix::process::geteuid;

use super::transport::{ByteLink, ConnectError, Connector, SocketLink};

/// Users other than the owner may not write into the folder of a socket: they could put their own in its place.
const WRITABLE_BY_OTHERS: u32 = 0o022;

/// A connection between two programs of this computer.
pub type LocalLink = SocketLink<UnixStream>;

/// The socket at which a program of this computer listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LocalConfig {
    /// Path of the socket.
    pub path: PathBuf,
}

/// Why a socket cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LocalSocketError {
    /// Nobody listens.
    #[error("no program listens at the socket {}; check that the gateway runs and that this is its path", path.display())]
    Nobody {
        /// Path of the socket.
        path: PathBuf,
    },
    /// The folder of the socket is missing.
    #[error(
        "socket {}: its folder {} does not exist: make it, `sudo install -d -m 755 -o USER {}` with the user of the gateway; the service \
         makes /run/pb3dp", path.display(), folder.display(), folder.display()
    )]
    NoFolder {
        /// Path of the socket.
        path: PathBuf,
        /// Its folder.
        folder: PathBuf,
    },
    /// The path leads to something else.
    #[error(
        "{} is no socket of a gateway but {found}: write the path that follows `local:` in host.line of the gateway's file", path.display()
    )]
    OtherKind {
        /// The path.
        path: PathBuf,
        /// What is there.
        found: &'static str,
    },
    /// The system does not let this user connect.
    #[error("socket {}: this user may not open it: run both programs as the same user", path.display())]
    NotPermitted {
        /// Path of the socket.
        path: PathBuf,
    },
    /// Another program listens.
    #[error("another program listens at the socket {}; end it, or choose another path", path.display())]
    InUse {
        /// Path of the socket.
        path: PathBuf,
    },
    /// Other users could replace the socket.
    #[error(
        "socket {}: its folder must belong to root or to user {user}, and nobody else may write into it (its mode is {mode:04o}, its owner \
         is user {owner}): use one with mode 0755 or less, for instance /run/pb3dp", path.display()
    )]
    Folder {
        /// Path of the socket.
        path: PathBuf,
        /// Mode of the folder.
        mode: u32,
        /// User that owns the folder.
        owner: u32,
        /// User of this program.
        user: u32,
    },
    /// The other program belongs to another user.
    #[error("socket {}: the other program runs as user {other}, this one as user {user}: run both as the same user", path.display())]
    OtherUser {
        /// Path of the socket.
        path: PathBuf,
        /// User of the other program.
        other: u32,
        /// User of this program.
        user: u32,
    },
    /// Another error of the operating system.
    #[error("socket {}", path.display())]
    System {
        /// Path of the socket.
        path: PathBuf,
        /// The error.
        #[source]
        source: std::io::Error,
    },
}

/// A listener at a socket, which vanishes with it.
#[derive(Debug)]
pub struct LocalListener {
    listener: UnixListener,
    path: PathBuf,
}

impl LocalConfig {
    /// Connects to the program that listens.
    ///
    /// # Errors
    /// If nobody listens, or a program of another user does.
    pub fn connect_link(&self) -> Result<LocalLink, LocalSocketError> {
        let path = || self.path.clone();
        check_kind(&self.path)?;
        let stream = UnixStream::connect(&self.path).map_err(|source| match source.kind() {
            ErrorKind::NotFound | ErrorKind::ConnectionRefused => LocalSocketError::Nobody { path: path() },
            ErrorKind::PermissionDenied => LocalSocketError::NotPermitted { path: path() },
            _ if source.raw_os_error() == Some(Errno::PROTOTYPE.raw_os_error()) => LocalSocketError::OtherKind {
                path: path(),
                found: "a socket of packets, like the bus of an emulated controller",
            },
            _ => LocalSocketError::System { path: path(), source },
        })?;
        check_user(&stream, &self.path)?;
        link(stream, &self.path)
    }
}

impl LocalConfig {
    /// Whether a host can expect to connect: the socket of a gateway that this user trusts is there. Connects to nobody.
    ///
    /// # Errors
    /// What [`Self::connect_link`] would find.
    pub fn check_for_host(&self) -> Result<(), LocalSocketError> {
        let path = || self.path.clone();
        check_kind(&self.path)?;
        let other = symlink_metadata(&self.path).map_err(|_| LocalSocketError::Nobody { path: path() })?.uid();
        let user = geteuid().as_raw();
        if !is_trusted(other) {
            return Err(LocalSocketError::OtherUser { path: path(), other, user });
        }
        Ok(())
    }

    /// Whether a gateway can listen: the folder is there, and only root and this user may write into it.
    ///
    /// # Errors
    /// What [`LocalListener::bind`] would find, but for a program that listens already.
    pub fn check_for_gateway(&self) -> Result<(), LocalSocketError> {
        check_folder(&self.path)?;
        check_kind(&self.path)
    }
}

impl Connector for LocalConfig {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        Ok(Box::new(self.connect_link()?))
    }

    fn target(&self) -> String {
        format!("socket {}", self.path.display())
    }
}

impl LocalListener {
    /// Listens at a path, in a folder into which only root and this user may write. The socket of a program that has ended is replaced.
    ///
    /// # Errors
    /// If another program listens there, other users may write into the folder, or the socket cannot be made.
    pub fn bind(path: &Path) -> Result<Self, LocalSocketError> {
        let system = |source| LocalSocketError::System { path: path.to_owned(), source };
        LocalConfig { path: path.to_owned() }.check_for_gateway()?;
        match UnixStream::connect(path) {
            Ok(_) => return Err(LocalSocketError::InUse { path: path.to_owned() }),
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => remove_file(path).map_err(system)?,
            Err(_) => {}
        }
        let listener = UnixListener::bind(path).map_err(system)?;
        let bound = Self { listener, path: path.to_owned() };
        set_permissions(path, Permissions::from_mode(0o600)).map_err(system)?;
        bound.listener.set_nonblocking(true).map_err(system)?;
        Ok(bound)
    }

    /// Path of the socket.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next program that connects, if any.
    ///
    /// # Errors
    /// If it belongs to another user, or the system refuses it.
    pub fn accept(&self) -> Result<Option<LocalLink>, LocalSocketError> {
        match self.listener.accept() {
            Ok((stream, _)) => check_user(&stream, &self.path).and_then(|()| link(stream, &self.path)).map(Some),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(source) => Err(LocalSocketError::System { path: self.path.clone(), source }),
        }
    }
}

impl AsFd for LocalListener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.listener.as_fd()
    }
}

impl Drop for LocalListener {
    fn drop(&mut self) {
        // A socket that stays is replaced by the next program.
        let _ = remove_file(&self.path);
    }
}

fn link(stream: UnixStream, path: &Path) -> Result<LocalLink, LocalSocketError> {
    let system = |source| LocalSocketError::System { path: path.to_owned(), source };
    stream.set_nonblocking(true).map_err(system)?;
    Ok(SocketLink::new(stream, format!("socket {}", path.display())))
}

/// Nothing, or a socket.
fn check_kind(path: &Path) -> Result<(), LocalSocketError> {
    let Ok(found) = symlink_metadata(path).map(|found| found.file_type()) else { return Ok(()) };
    let found = match (found.is_socket(), found.is_dir(), found.is_symlink()) {
        (true, ..) => return Ok(()),
        (_, true, _) => "a folder",
        (_, _, true) => "a symbolic link",
        _ => "a file",
    };
    Err(LocalSocketError::OtherKind { path: path.to_owned(), found })
}

fn check_folder(path: &Path) -> Result<(), LocalSocketError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let found = metadata(folder).map_err(|source| match source.kind() {
        ErrorKind::NotFound => LocalSocketError::NoFolder { path: path.to_owned(), folder: folder.to_owned() },
        _ => LocalSocketError::System { path: path.to_owned(), source },
    })?;
    let (mode, owner, user) = (found.mode() & 0o7777, found.uid(), geteuid().as_raw());
    if mode & WRITABLE_BY_OTHERS != 0 || !is_trusted(owner) {
        return Err(LocalSocketError::Folder { path: path.to_owned(), mode, owner, user });
    }
    Ok(())
}

/// The kernel states the user that opened the other end.
fn check_user(stream: &UnixStream, path: &Path) -> Result<(), LocalSocketError> {
    let system = |error: Errno| LocalSocketError::System { path: path.to_owned(), source: error.into() };
    let other = socket_peercred(stream).map_err(system)?.uid.as_raw();
    if is_trusted(other) {
        return Ok(());
    }
    Err(LocalSocketError::OtherUser { path: path.to_owned(), other, user: geteuid().as_raw() })
}

/// Root, and the user of this program.
fn is_trusted(user: u32) -> bool {
    user == 0 || user == geteuid().as_raw()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "helpers of tests")]

    use std::time::Duration;

    use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, socket_with};

    use super::*;
    use crate::transport::{Symptom, wait};

    #[test]
    fn a_folder_that_is_missing_is_named_with_its_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("run");
        let error = LocalListener::bind(&missing.join("arm1.sock")).err().unwrap();
        assert!(matches!(&error, LocalSocketError::NoFolder { folder, .. } if *folder == missing), "{error}");
        assert!(error.to_string().contains(&format!("-o USER {}", missing.display())), "{error}");
    }

    #[test]
    fn two_programs_exchange_bytes_and_learn_of_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arm1.sock");
        let mut config = LocalConfig { path: path.clone() };
        assert!(config.connect().err().unwrap().to_string().contains("no program listens at the socket"));
        let listener = LocalListener::bind(&path).unwrap();
        assert_eq!(metadata(&path).unwrap().mode() & 0o7777, 0o600);
        assert!(listener.accept().unwrap().is_none());
        let mut host = config.connect().unwrap();
        let mut gateway = listener.accept().unwrap().unwrap();
        assert_eq!(host.try_write(&[1, 2, 3]).unwrap(), 3);
        assert!(wait(Some(&gateway), false, None, Duration::from_secs(5)).readable);
        let mut bytes = [0; 8];
        assert_eq!((gateway.try_read(&mut bytes).unwrap(), &bytes[..3]), (3, &[1, 2, 3][..]));
        drop(host);
        assert_eq!(gateway.try_read(&mut bytes).unwrap_err().symptom, Symptom::EndOfStream);
        assert!(gateway.try_write(&[4]).is_err(), "a lost link stays lost");
    }

    #[test]
    fn a_socket_in_use_is_kept_and_one_of_an_ended_program_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arm1.sock");
        let first = LocalListener::bind(&path).unwrap();
        assert!(matches!(LocalListener::bind(&path), Err(LocalSocketError::InUse { .. })));
        assert!(LocalConfig { path: path.clone() }.connect_link().is_ok());
        drop(first);
        // As after a crash: the file stays, and nobody listens.
        drop(UnixListener::bind(folder.path().join("stale")).unwrap());
        let stale = LocalListener::bind(&folder.path().join("stale")).unwrap();
        assert!(LocalConfig { path: stale.path().to_owned() }.connect_link().is_ok());
        std::fs::write(folder.path().join("file"), "mine").unwrap();
        assert!(matches!(LocalListener::bind(&folder.path().join("file")), Err(LocalSocketError::OtherKind { .. })));
        assert_eq!(std::fs::read(folder.path().join("file")).unwrap(), b"mine");
    }

    #[test]
    fn what_is_no_socket_of_a_gateway_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let in_folder = |name: &str| folder.path().join(name);
        std::fs::write(in_folder("file"), "").unwrap();
        std::os::unix::fs::symlink(in_folder("file"), in_folder("link")).unwrap();
        let bus = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None).unwrap();
        rustix::net::bind(&bus, &SocketAddrUnix::new(in_folder("bus")).unwrap()).unwrap();
        rustix::net::listen(&bus, 1).unwrap();
        for (name, found) in [
            ("file", "but a file: "),
            ("link", "but a symbolic link: "),
            (".", "but a folder: "),
            ("bus", "the bus of an emulated controller: "),
        ] {
            let error = LocalConfig { path: in_folder(name) }.connect_link().err().unwrap().to_string();
            assert!(error.contains(found) && error.contains("host.line"), "{error}");
        }
    }

    #[test]
    fn a_folder_into_which_others_may_write_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arm1.sock");
        for mode in [0o770, 0o702, 0o1777] {
            set_permissions(folder.path(), Permissions::from_mode(mode)).unwrap();
            let error = LocalListener::bind(&path).unwrap_err().to_string();
            assert!(error.contains(&format!("mode is {mode:04o}")) && error.contains("arm1.sock"), "{error}");
        }
        set_permissions(folder.path(), Permissions::from_mode(0o755)).unwrap();
        assert!(LocalListener::bind(&path).is_ok());
        assert!(!path.exists(), "the socket vanishes with its listener");
    }
}
