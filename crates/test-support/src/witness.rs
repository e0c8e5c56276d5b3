//! Measures the lateness of the machine itself: threads that only sleep, and bytes that only pass through a pseudo-terminal.
//!
//! On each processor one thread repeatedly sleeps for a millisecond, in the scheduling class of the test. Whatever delays this
//! thread (another program, the kernel, the hypervisor) also delays the product. In the class SCHED_FIFO the witness has a
//! priority one above the test, so that the product's own computing is never counted as lateness of the machine.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Barrier};
use std::thread::{Builder, JoinHandle, available_parallelism};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::scheduling::{Policy, run_on};

/// Interval between wake-ups.
pub const PERIOD: Duration = Duration::from_millis(1);
/// A machine that is later than this does not meet the cycles of an arm (10 ms, of which an exchange may take half).
pub const TOO_LATE: Duration = Duration::from_millis(5);
/// Delays below this are not recorded.
const WORTH_RECORDING: Duration = Duration::from_millis(1);
/// Maximum number of delays recorded by a thread; the worst one is always kept.
const ROOM: usize = 1 << 14;

/// One delay: a thread or a byte was due earlier and came at this time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delay {
    /// Time of arrival.
    pub at: Instant,
    /// Delay.
    pub late: Duration,
}

impl Delay {
    /// Whether both delays overlap in time.
    pub fn overlaps(&self, other: &Self) -> bool {
        let begin = |delay: &Self| delay.at.checked_sub(delay.late).unwrap_or(delay.at);
        begin(self) <= other.at && begin(other) <= self.at
    }
}

/// The observations of the witnesses of a test.
#[derive(Clone, Debug, Default)]
pub struct Testimony {
    /// The delays worth recording, of all witnesses.
    pub delays: Vec<Delay>,
    /// The longest.
    pub worst: Duration,
}

impl Testimony {
    fn see(&mut self, due: Instant, at: Instant) {
        let late = at.saturating_duration_since(due);
        self.worst = self.worst.max(late);
        // Without heap allocation: tests count allocations.
        if late >= WORTH_RECORDING && self.delays.len() < self.delays.capacity() {
            self.delays.push(Delay { at, late });
        }
    }

    fn with_room() -> Self {
        Self { delays: Vec::with_capacity(ROOM), worst: Duration::ZERO }
    }

    fn join(mut self, other: Self) -> Self {
        self.delays.extend(other.delays);
        self.worst = self.worst.max(other.worst);
        self
    }
}

/// Threads that record their wake-up delay.
#[derive(Debug)]
pub struct Witness {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Testimony>>,
    policy: Policy,
}

impl Witness {
    /// Starts witnesses with this policy, if granted. All of them run when this returns, and make no heap allocations until they
    /// end.
    ///
    /// # Errors
    /// The system provides no thread or no pseudo-terminal.
    pub fn start(policy: Policy) -> io::Result<Self> {
        let mut witness = Self { is_over: Arc::default(), threads: Vec::new(), policy };
        for cpu in 0..available_parallelism()?.get() {
            witness.spawn(move |testimony, is_over| {
                run_on(cpu);
                sleep_and_see(testimony, is_over);
            })?;
        }
        let (near, far) = open_line()?;
        witness.spawn(move |testimony, is_over| echo(near, far, testimony, is_over))?;
        Ok(witness)
    }

    fn spawn(&mut self, watch: impl FnOnce(&mut Testimony, &AtomicBool) + Send + 'static) -> io::Result<()> {
        let is_over = Arc::clone(&self.is_over);
        let runs = Arc::new(Barrier::new(2));
        let begun = Arc::clone(&runs);
        let policy = self.policy;
        let thread = Builder::new().name("witness".to_owned()).spawn(move || {
            // Not granted: the witness competes with all other programs, as the test does.
            policy.enter();
            let mut testimony = Testimony::with_room();
            begun.wait();
            watch(&mut testimony, &is_over);
            testimony
        })?;
        runs.wait();
        self.threads.push(thread);
        Ok(())
    }

    /// Stops the witnesses and returns their observations.
    pub fn end(mut self) -> Testimony {
        self.is_over.store(true, Ordering::Relaxed);
        let seen = self.threads.drain(..).filter_map(|thread| thread.join().ok());
        seen.fold(Testimony::default(), Testimony::join)
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

fn sleep_and_see(testimony: &mut Testimony, is_over: &AtomicBool) {
    while !is_over.load(Ordering::Relaxed) {
        let due = Instant::now() + PERIOD;
        std::thread::sleep(PERIOD);
        testimony.see(due, Instant::now());
    }
}

/// Both ends of a pseudo-terminal in raw mode.
fn open_line() -> io::Result<(File, File)> {
    let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&near)?;
    unlockpt(&near)?;
    let name = ptsname(&near, Vec::new())?;
    let path = name.to_str().map_err(|_| io::Error::from(io::ErrorKind::InvalidData))?.to_owned();
    let far = File::options().read(true).write(true).custom_flags(libc::O_NONBLOCK).open(path)?;
    let mut attributes = tcgetattr(&far)?;
    attributes.make_raw();
    tcsetattr(&far, OptionalActions::Now, &attributes)?;
    Ok((File::from(near), far))
}

/// Measures how long a byte takes through the line, which is served by a kernel thread.
fn echo(mut near: File, mut far: File, testimony: &mut Testimony, is_over: &AtomicBool) {
    while !is_over.load(Ordering::Relaxed) {
        let sent = Instant::now();
        // A line error shows nothing. Neither does a lost byte: a program of another test that still looks for its own line may
        // have read it, because the numbers of pseudo-terminals are reused. It may also have changed the line settings, so that a
        // read does not block.
        match near.write_all(&[0x55]).and_then(|()| wait_for_byte(&far)).and_then(|()| far.read(&mut [0])) {
            Ok(0) => {}
            Ok(_) => testimony.see(sent, Instant::now()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(_) => break,
        }
        std::thread::sleep(PERIOD);
    }
}

/// Waits for a byte, for at most a second.
fn wait_for_byte(line: &File) -> io::Result<()> {
    let second = Timespec { tv_sec: 1, tv_nsec: 0 };
    poll(&mut [PollFd::new(line, PollFlags::IN)], Some(&second))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_processor_is_seen() {
        // No thread with a lower or without a priority can delay a witness: the record itself is checked.
        let mut testimony = Testimony::with_room();
        let due = Instant::now();
        testimony.see(due, due + Duration::from_micros(900));
        testimony.see(due, due + Duration::from_millis(7));
        assert_eq!(testimony.worst, Duration::from_millis(7));
        assert_eq!(testimony.delays, [Delay { at: due + Duration::from_millis(7), late: Duration::from_millis(7) }]);
    }

    #[test]
    fn witnesses_watch_until_they_end() {
        let witness = Witness::start(Policy::WITNESS).expect("threads and a line");
        assert_eq!(witness.threads.len(), available_parallelism().expect("a number").get() + 1);
        std::thread::sleep(Duration::from_millis(30));
        let seen = witness.end();
        assert!(seen.worst > Duration::ZERO, "{seen:?}");
    }

    #[test]
    fn a_line_whose_bytes_another_program_takes_does_not_hold_the_witness() {
        let (near, far) = open_line().expect("a line");
        let mut thief = far.try_clone().expect("the same line");
        let is_over = AtomicBool::new(false);
        let begun = Instant::now();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while begun.elapsed() < Duration::from_millis(100) {
                    // The thief finding no byte is not an error.
                    let _ = thief.read(&mut [0; 64]);
                }
                is_over.store(true, Ordering::Relaxed);
            });
            echo(near, far, &mut Testimony::with_room(), &is_over);
        });
        // The reader waits a second for the byte that was taken last.
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    }

    #[test]
    fn delays_overlap_in_time() {
        let zero = Instant::now() + Duration::from_secs(10);
        let delay =
            |at_ms, late_ms| Delay { at: zero + Duration::from_millis(at_ms), late: Duration::from_millis(late_ms) };
        assert!(delay(20, 10).overlaps(&delay(25, 10)) && delay(25, 10).overlaps(&delay(20, 10)));
        assert!(!delay(20, 10).overlaps(&delay(40, 10)) && !delay(40, 10).overlaps(&delay(20, 10)));
    }
}
