//! Signals that ask a program to end, as something to wait for.

use std::os::fd::{AsFd, BorrowedFd, FromRawFd, OwnedFd};

use rustix::io::Errno;

/// SIGINT, SIGTERM and SIGHUP do not end the program any more: they are waited for here.
#[derive(Debug)]
pub struct StopSignals {
    fd: OwnedFd,
}

/// Threads that `start` starts are left alone by these signals, which so keep their meaning for the rest of the program: for threads
/// that are there before [`StopSignals::take_over`].
///
/// # Errors
/// If the operating system refuses.
pub fn shielded<T>(start: impl FnOnce() -> T) -> std::io::Result<T> {
    let before = mask(libc::SIG_BLOCK, &stop_signals())?;
    let started = start();
    mask(libc::SIG_SETMASK, &before)?;
    Ok(started)
}

fn stop_signals() -> libc::sigset_t {
    // SAFETY: all zeros are storage for a set, which the next calls make an empty one with three members.
    unsafe {
        let mut set: libc::sigset_t = std::mem::zeroed();
        libc::sigemptyset(&raw mut set);
        for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
            libc::sigaddset(&raw mut set, signal);
        }
        set
    }
}

/// Changes which signals this thread takes: those that it did not take before.
fn mask(how: libc::c_int, set: &libc::sigset_t) -> std::io::Result<libc::sigset_t> {
    // SAFETY: both sets are ones, and the call only writes the second.
    unsafe {
        let mut before: libc::sigset_t = std::mem::zeroed();
        match libc::pthread_sigmask(how, &raw const *set, &raw mut before) {
            0 => Ok(before),
            error => Err(std::io::Error::from_raw_os_error(error)),
        }
    }
}

/// A signal that asks to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StopSignal(u32);

impl StopSignals {
    /// Takes the signals over, for this thread and all that it starts from now on: call it before any other thread is started.
    ///
    /// # Errors
    /// If the operating system refuses.
    pub fn take_over() -> std::io::Result<Self> {
        let set = stop_signals();
        mask(libc::SIG_BLOCK, &set)?;
        // SAFETY: the set is one.
        let fd = unsafe { libc::signalfd(-1, &raw const set, libc::SFD_NONBLOCK | libc::SFD_CLOEXEC) };
        if fd < 0 {
            return Err(std::io::Error::last_os_error());
        }
        // SAFETY: the descriptor is new and nobody else has it.
        Ok(Self { fd: unsafe { OwnedFd::from_raw_fd(fd) } })
    }

    /// A signal that has come.
    ///
    /// # Errors
    /// If the operating system does not tell.
    pub fn try_take(&mut self) -> std::io::Result<Option<StopSignal>> {
        let mut record = [0; size_of::<libc::signalfd_siginfo>()];
        match rustix::io::read(&self.fd, &mut record) {
            // The number of the signal comes first.
            Ok(4..) => Ok(Some(StopSignal(u32::from_ne_bytes([record[0], record[1], record[2], record[3]])))),
            Ok(_) | Err(Errno::AGAIN | Errno::INTR) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

impl AsFd for StopSignals {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

impl std::fmt::Display for StopSignal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match i32::try_from(self.0) {
            Ok(libc::SIGINT) => f.write_str("SIGINT"),
            Ok(libc::SIGTERM) => f.write_str("SIGTERM"),
            Ok(libc::SIGHUP) => f.write_str("SIGHUP"),
            _ => write!(f, "signal {}", self.0),
        }
    }
}
