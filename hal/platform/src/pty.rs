//! A pseudo-terminal: a serial line without hardware whose other end is in this process.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::transport::{ByteLink, Unplugged, judge};

/// The master end of a pseudo-terminal. A program that opens [`Self::path`] as a serial port is connected to it.
///
/// The line is raw from the start, so bytes that arrive before a program opens it are kept and not echoed. The line survives when
/// the other side closes and opens it again, as a cable does; dropping this end unplugs it.
#[derive(Debug)]
pub struct Pty {
    master: File,
    /// Keeps the line alive while no other program has it open.
    _line: OwnedFd,
    path: PathBuf,
    name: String,
}

impl Pty {
    /// Creates a pseudo-terminal.
    ///
    /// # Errors
    /// If the operating system provides none.
    pub fn open() -> std::io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?.to_string_lossy().into_owned();
        let path = PathBuf::from(&name);
        let line =
            rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?;
        let mut settings = tcgetattr(&line)?;
        settings.make_raw();
        tcsetattr(&line, OptionalActions::Now, &settings)?;
        rustix::io::ioctl_fionbio(&master, true)?;
        Ok(Self { master: File::from(master), _line: line, path, name })
    }

    /// Device path for the other side.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl ByteLink for Pty {
    fn name(&self) -> &str {
        &self.name
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        judge(self.master.read(buffer), !buffer.is_empty())
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        judge(self.master.write(bytes), false)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        Some(self.master.as_fd())
    }
}
