//! Termination signals as events to wait for.

use std::os::fd::{AsFd, BorrowedFd, FromRawFd, OwnedFd};

use rustix::io::Errno;

/// Signals that would end the program: all that can be caught, without those of a crash (SIGABRT, SIGSEGV and others), which no
/// program survives, and SIGPIPE, which Rust ignores.
const STOP_SIGNALS: [(libc::c_int, &str); 13] = [
    (libc::SIGINT, "SIGINT"),
    (libc::SIGTERM, "SIGTERM"),
    (libc::SIGHUP, "SIGHUP"),
    (libc::SIGQUIT, "SIGQUIT"),
    (libc::SIGUSR1, "SIGUSR1"),
    (libc::SIGUSR2, "SIGUSR2"),
    (libc::SIGALRM, "SIGALRM"),
    (libc::SIGVTALRM, "SIGVTALRM"),
    (libc::SIGPROF, "SIGPROF"),
    (libc::SIGIO, "SIGIO"),
    (libc::SIGPWR, "SIGPWR"),
    (libc::SIGXCPU, "SIGXCPU"),
    (libc::SIGXFSZ, "SIGXFSZ"),
];

/// Signals by which a key or a background job would suspend the program, and an arm would go on without it.
const SUSPEND_SIGNALS: [libc::c_int; 3] = [libc::SIGTSTP, libc::SIGTTIN, libc::SIGTTOU];

/// The signals that would end the program do not end it; a thread waits for them here.
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
    // SAFETY: all zeros are valid storage for a set, which the next calls initialise.
    unsafe {
        let mut set: libc::sigset_t = std::mem::zeroed();
        libc::sigemptyset(&raw mut set);
        for (signal, _) in STOP_SIGNALS {
            libc::sigaddset(&raw mut set, signal);
        }
        // Real-time signals, and the one between them and the others: nobody sends them, and they would end the program too.
        for signal in [libc::SIGSTKFLT].into_iter().chain(libc::SIGRTMIN()..=libc::SIGRTMAX()) {
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
    /// Takes over the signals for this thread and all threads that it creates later: call it before any other thread starts. Ctrl-Z
    /// and the terminal no longer suspend the program: in the background it reads no terminal (EIO).
    ///
    /// # Errors
    /// If the operating system refuses.
    pub fn take_over() -> std::io::Result<Self> {
        for signal in SUSPEND_SIGNALS {
            // SAFETY: no handler is installed.
            if unsafe { libc::signal(signal, libc::SIG_IGN) } == libc::SIG_ERR {
                return Err(std::io::Error::last_os_error());
            }
        }
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
        match STOP_SIGNALS.iter().find(|(signal, _)| u32::try_from(*signal) == Ok(self.0)) {
            Some((_, name)) => f.write_str(name),
            None => write!(f, "signal {}", self.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_ignored(signal: libc::c_int) -> bool {
        // SAFETY: all zeros are valid storage, which the call overwrites; no action is set.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            assert_eq!(libc::sigaction(signal, std::ptr::null(), &raw mut action), 0);
            action.sa_sigaction == libc::SIG_IGN
        }
    }

    /// Each signal that ends a program by default and is not of a crash; SIGKILL cannot be caught.
    #[test]
    fn every_signal_that_would_end_the_program_is_taken_and_no_key_suspends_it() {
        let names = "HUP INT QUIT USR1 USR2 ALRM TERM STKFLT XCPU XFSZ VTALRM PROF IO PWR";
        let numbers = [1, 2, 3, 10, 12, 14, 15, 16, 24, 25, 26, 27, 29, 30];
        let mut signals = StopSignals::take_over().unwrap();
        for (name, number) in
            names.split(' ').zip(numbers).chain([("RTMIN", libc::SIGRTMIN()), ("RTMAX", libc::SIGRTMAX())])
        {
            // SAFETY: the signal is blocked in this thread, or the test fails by its default action.
            assert_eq!(unsafe { libc::pthread_kill(libc::pthread_self(), number) }, 0, "{name}");
            let taken = signals.try_take().unwrap().unwrap();
            assert_eq!(taken, StopSignal(u32::try_from(number).unwrap()), "{name}");
            let is_named = taken.to_string() == format!("SIG{name}");
            assert!(is_named || taken.to_string() == format!("signal {number}"), "{taken}");
        }
        assert_eq!(signals.try_take().unwrap(), None);
        assert!([libc::SIGTSTP, libc::SIGTTIN, libc::SIGTTOU, libc::SIGPIPE].into_iter().all(is_ignored));
    }
}
