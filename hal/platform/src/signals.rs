//! Termination signals as events to wait for.

use std::os::fd::{AsFd, BorrowedFd, FromRawFd, OwnedFd};

use rustix::io::Errno;

/// SIGINT, SIGTERM and SIGHUP do not end the program; a thread waits for them here.
#[derive(Debug)]
pub struct StopSignals {
    fd: OwnedFd,
}

/// Blocks these signals in threads that `start` creates. Use it for threads that exist before [`StopSignals::take_over`], so that
/// the signals keep their default action for the rest of the program.
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
    // SAFETY: all zeros are valid storage for a set, which the next calls initialise with three members.
    unsafe {
        let mut set: libc::sigset_t = std::mem::zeroed();
        libc::sigemptyset(&raw mut set);
        for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
            libc::sigaddset(&raw mut set, signal);
        }
        set
    }
}

/// Changes the signal mask of this thread.
fn mask(how: libc::c_int, set: &libc::sigset_t) -> std::io::Result<libc::sigset_t> {
    // SAFETY: both sets are initialised, and the call writes only the second one.
    unsafe {
        let mut before: libc::sigset_t = std::mem::zeroed();
        match libc::pthread_sigmask(how, &raw const *set, &raw mut before) {
            0 => Ok(before),
            error => Err(std::io::Error::from_raw_os_error(error)),
        }
    }
}

/// A received termination signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StopSignal(u32);

impl StopSignals {
    /// Takes over the signals for this thread and all threads that it creates later: call it before any other thread starts.
    ///
    /// # Errors
    /// If the operating system refuses.
    pub fn take_over() -> std::io::Result<Self> {
        let set = stop_signals();
        mask(libc::SIG_BLOCK, &set)?;
        // SAFETY: the set is initialised.
        let fd = unsafe { libc::signalfd(-1, &raw const set, libc::SFD_NONBLOCK | libc::SFD_CLOEXEC) };
        if fd < 0 {
            return Err(std::io::Error::last_os_error());
        }
        // SAFETY: the descriptor is new and has no other owner.
        Ok(Self { fd: unsafe { OwnedFd::from_raw_fd(fd) } })
    }

    /// A received signal, if there is one.
    ///
    /// # Errors
    /// If the operating system returns an error.
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
