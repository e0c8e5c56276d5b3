//! What a thread needs that must act every 2 ms: the clock, a sleep to a moment, a policy that goes before others, memory that stays.

use pb3dp_geometry::MonotonicTime;
use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, geteuid, getrlimit};
use rustix::thread::{ClockId, CpuSet, Timespec, clock_nanosleep_absolute, sched_setaffinity};
use rustix::time::clock_gettime;

/// Monotonic time of the machine, from its start on: the clock of [`sleep_until`].
pub fn now() -> MonotonicTime {
    let time = clock_gettime(ClockId::Monotonic);
    // Neither part is negative on this clock.
    let (seconds, nanos) = (time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs());
    MonotonicTime::from_nanos(seconds.saturating_mul(1_000_000_000).saturating_add(nanos))
}

/// Sleeps to a moment, if it has not passed. A signal may end it early.
pub fn sleep_until(at: MonotonicTime) {
    let nanos = at.as_nanos();
    let request = Timespec {
        tv_sec: i64::try_from(nanos / 1_000_000_000).unwrap_or(i64::MAX),
        // Below 1e9.
        tv_nsec: (nanos % 1_000_000_000) as i64,
    };
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &request);
}

/// What a thread asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Realtime {
    /// Of the policy SCHED_FIFO, 1 to 99; none to stay among all the others.
    pub priority: Option<u8>,
    /// Whether all memory of the program stays where it is.
    pub locks_memory: bool,
    /// The processor to run on; none for any.
    pub cpu: Option<usize>,
}

/// What was asked for and is not to be had, and what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Shortfall {
    /// The policy is not to be had.
    #[error(
        "SCHED_FIFO with priority {priority} is not to be had ({error}): other programs will delay the cycle. Run as root, give the \
         program CAP_SYS_NICE (setcap cap_sys_nice+ep PROGRAM), or let the user have it: `@realtime - rtprio 99` in \
         /etc/security/limits.conf"
    )]
    Policy {
        /// The priority asked for.
        priority: u8,
        /// What the system says.
        error: Errno,
    },
    /// The memory is not to be locked.
    #[error(
        "memory cannot be locked ({error}): a page that was taken away will delay the cycle. Run as root, give the program \
         CAP_IPC_LOCK, or let the user have it: `@realtime - memlock unlimited` in /etc/security/limits.conf"
    )]
    Memory {
        /// What the system says.
        error: Errno,
    },
    /// The processor is not to be had.
    #[error("processor {cpu} is not to be had ({error}); choose one that /proc/cpuinfo lists and this program may use")]
    Processor {
        /// The one asked for.
        cpu: usize,
        /// What the system says.
        error: Errno,
    },
}

/// Asks for all of it, for the thread that calls. What is not to be had comes back; the thread goes on without.
pub fn enter(wanted: &Realtime) -> Vec<Shortfall> {
    let policy = wanted
        .priority
        .and_then(|priority| set_fifo(priority).err().map(|error| Shortfall::Policy { priority, error }));
    let memory = wanted.locks_memory.then(lock_memory);
    let memory = memory.and_then(Result::err).map(|error| Shortfall::Memory { error });
    let processor = wanted.cpu.and_then(|cpu| run_on(cpu).err().map(|error| Shortfall::Processor { cpu, error }));
    [policy, memory, processor].into_iter().flatten().collect()
}

fn lock_memory() -> Result<(), Errno> {
    let all = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE;
    // With a limit on locked memory everything that is allocated later would have to fit into it.
    let is_limited = getrlimit(Resource::Memlock).current.is_some() && !geteuid().is_root();
    mlockall(if is_limited { MlockAllFlags::CURRENT } else { all })
}

fn set_fifo(priority: u8) -> Result<(), Errno> {
    let parameters = libc::sched_param { sched_priority: libc::c_int::from(priority) };
    // SAFETY: the parameters live through the call, which changes nothing but the policy of this thread (0).
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    if result == 0 {
        return Ok(());
    }
    Err(Errno::from_io_error(&std::io::Error::last_os_error()).unwrap_or(Errno::PERM))
}

fn run_on(cpu: usize) -> Result<(), Errno> {
    if cpu >= CpuSet::MAX_CPU {
        return Err(Errno::INVAL);
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    sched_setaffinity(None, &set)
}
