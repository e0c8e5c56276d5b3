//! Measures the lateness of the machine itself: threads that only sleep, and bytes that only pass through a pseudo-terminal.
//!
//! On each processor one thread repeatedly sleeps for a millisecond, in the scheduling class of the test. Whatever delays this
//! thread (another program, the kernel, the hypervisor) also delays the product. In the class SCHED_FIFO the witness has a
//! priority one above the test, so that the product's own computing is never counted as lateness of the machine.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Barrier, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::{Builder, available_parallelism};
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
/// Maximum number of delays kept.
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
    /// The longest, zero if none was worth recording.
    pub worst: Duration,
}

/// What the threads of one policy share.
#[derive(Debug)]
struct Watch {
    is_over: AtomicBool,
    /// The most recent delays, oldest first. With room for all: tests count allocations.
    recent: Mutex<VecDeque<Delay>>,
    /// Of each thread, how often it was awake.
    awake: Vec<AtomicU64>,
}

impl Watch {
    fn see(&self, due: Instant, at: Instant) {
        let late = at.saturating_duration_since(due);
        if late >= WORTH_RECORDING {
            let mut recent = of(&self.recent);
            if recent.len() == ROOM {
                recent.pop_front();
            }
            recent.push_back(Delay { at, late });
        }
    }
}

/// The threads of a policy, which end with their last [`Witness`].
#[derive(Debug)]
struct Threads {
    watch: Arc<Watch>,
    policy: Policy,
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.watch.is_over.store(true, Ordering::Relaxed);
    }
}

/// The threads that run in this process.
static RUNNING: Mutex<Vec<Weak<Threads>>> = Mutex::new(Vec::new());

/// Threads that record their wake-up delay, shared by all tests of the process with the same policy.
#[derive(Debug)]
pub struct Witness {
    threads: Arc<Threads>,
    since: Instant,
}

impl Witness {
    /// Starts witnesses with this policy, if granted. All of them run when this returns, and make no heap allocations until they
    /// end.
    ///
    /// # Errors
    /// The system provides no thread or no pseudo-terminal.
    pub fn start(policy: Policy) -> io::Result<Self> {
        let mut running = of(&RUNNING);
        running.retain(|threads| threads.strong_count() > 0);
        let same = running.iter().filter_map(Weak::upgrade).find(|threads| threads.policy == policy);
        let threads = match same {
            Some(threads) => threads,
            None => {
                let threads = Arc::new(Threads::start(policy)?);
                running.push(Arc::downgrade(&threads));
                threads
            }
        };
        Ok(Self { threads, since: Instant::now() })
    }

    /// The observations since the start. Waits until each witness was awake: one that is held up now counts.
    pub fn end(self) -> Testimony {
        let awake = || self.threads.watch.awake.iter().map(|count| count.load(Ordering::Acquire));
        let before: Vec<u64> = awake().collect();
        while awake().zip(&before).any(|(now, before)| now == *before) {
            std::thread::sleep(PERIOD);
        }
        let recent = of(&self.threads.watch.recent);
        let delays: Vec<Delay> = recent.iter().filter(|delay| delay.at >= self.since).copied().collect();
        Testimony { worst: delays.iter().map(|delay| delay.late).max().unwrap_or_default(), delays }
    }
}

impl Threads {
    fn start(policy: Policy) -> io::Result<Self> {
        let processors = available_parallelism()?.get();
        let watch = Arc::new(Watch {
            is_over: AtomicBool::new(false),
            recent: Mutex::new(VecDeque::with_capacity(ROOM)),
            awake: (0..=processors).map(|_| AtomicU64::new(0)).collect(),
        });
        // Ends those that run already if one cannot be started.
        let threads = Self { watch, policy };
        for cpu in 0..processors {
            threads.spawn(cpu, Some(cpu), move |watch| {
                let due = Instant::now() + PERIOD;
                std::thread::sleep(PERIOD);
                watch.see(due, Instant::now());
            })?;
        }
        let (mut near, mut far) = open_line()?;
        threads.spawn(processors, None, move |watch| {
            echo(&mut near, &mut far, watch);
            std::thread::sleep(PERIOD);
        })?;
        Ok(threads)
    }

    /// Repeats `turn` in a thread, on this processor.
    fn spawn(
        &self,
        number: usize,
        cpu: Option<usize>,
        mut turn: impl FnMut(&Watch) + Send + 'static,
    ) -> io::Result<()> {
        let watch = Arc::clone(&self.watch);
        let runs = Arc::new(Barrier::new(2));
        let begun = Arc::clone(&runs);
        let policy = self.policy;
        Builder::new().name("witness".to_owned()).spawn(move || {
            // Not granted: the witness competes with all other programs, as the test does.
            policy.enter();
            cpu.into_iter().for_each(run_on);
            begun.wait();
            while !watch.is_over.load(Ordering::Relaxed) {
                turn(&watch);
                watch.awake[number].fetch_add(1, Ordering::Release);
            }
        })?;
        runs.wait();
        Ok(())
    }
}

/// The contents of a lock, also after a panic of another test.
pub(crate) fn of<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
fn echo(near: &mut File, far: &mut File, watch: &Watch) {
    let sent = Instant::now();
    // A line error shows nothing. Neither does a lost byte: a program of another test that still looks for its own line may
    // have read it, because the numbers of pseudo-terminals are reused. It may also have changed the line settings, so that a
    // read does not block.
    let answered = near.write_all(&[0x55]).and_then(|()| wait_for_byte(far)).and_then(|()| far.read(&mut [0]));
    if answered.is_ok_and(|bytes| bytes > 0) {
        watch.see(sent, Instant::now());
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

    fn watch() -> Watch {
        Watch { is_over: AtomicBool::new(false), recent: Mutex::new(VecDeque::with_capacity(ROOM)), awake: Vec::new() }
    }

    #[test]
    fn a_held_processor_is_detected() {
        // No thread with a lower or without a priority can delay a witness: the record itself is checked.
        let watch = watch();
        let due = Instant::now();
        watch.see(due, due + Duration::from_micros(900));
        let late = |millis| Delay { at: due + Duration::from_millis(millis), late: Duration::from_millis(millis) };
        watch.see(due, due + Duration::from_millis(7));
        assert_eq!(*of(&watch.recent), [late(7)]);
        (0..ROOM).for_each(|_| watch.see(due, due + Duration::from_millis(8)));
        assert_eq!(*of(&watch.recent), [late(8); ROOM]);
    }

    #[test]
    fn witnesses_of_one_policy_are_shared_and_end_with_the_last() {
        let policy = Policy::current();
        let first = Witness::start(policy).expect("threads and a line");
        let threads = Arc::downgrade(&first.threads);
        let watch = Arc::clone(&first.threads.watch);
        watch.see(first.since, first.since + Duration::from_millis(1));
        let second = Witness::start(policy).expect("the same");
        assert!(Arc::ptr_eq(&first.threads, &second.threads));
        assert_eq!(watch.awake.len(), available_parallelism().expect("a number").get() + 1);
        let planted = Delay { at: second.since + Duration::from_secs(60), late: Duration::from_secs(60) };
        watch.see(second.since, planted.at);
        assert_eq!(second.end().worst, planted.late);
        assert!(threads.strong_count() > 0);
        let recent = first.end();
        assert!(recent.delays.len() >= 2 && recent.delays.contains(&planted), "{recent:?}");
        assert!(threads.strong_count() == 0 && watch.is_over.load(Ordering::Relaxed));
    }

    #[test]
    fn a_line_whose_bytes_another_program_takes_does_not_hold_the_witness() {
        let (mut near, mut far) = open_line().expect("a line");
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
            let watch = watch();
            while !is_over.load(Ordering::Relaxed) {
                echo(&mut near, &mut far, &watch);
            }
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
