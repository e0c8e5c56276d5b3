//! Real-time services for a thread with a cycle of 2 ms: clock, precise sleep, scheduling policy, locked memory.

use pb3dp_geometry::MonotonicTime;
use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, geteuid, getrlimit};
use rustix::thread::{ClockId, CpuSet, Timespec, clock_nanosleep_absolute, sched_setaffinity};
use rustix::time::clock_gettime;

/// Monotonic time since the start of the computer: the clock of [`sleep_until`].
pub fn now() -> MonotonicTime {
    let time = clock_gettime(ClockId::Monotonic);
    // Neither part is negative on this clock.
    let (seconds, nanos) = (time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs());
    MonotonicTime::from_nanos(seconds.saturating_mul(1_000_000_000).saturating_add(nanos))
}

/// Sleeps until a time, if it has not passed. A signal may end the sleep early.
pub fn sleep_until(at: MonotonicTime) {
    let nanos = at.as_nanos();
    let request = Timespec {
        tv_sec: i64::try_from(nanos / 1_000_000_000).unwrap_or(i64::MAX),
        // Below 1e9.
        tv_nsec: (nanos % 1_000_000_000) as i64,
    };
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &request);
}

/// Real-time request of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Realtime {
    /// Priority of SCHED_FIFO, 1 to 99; `None` for normal scheduling.
    pub priority: Option<u8>,
    /// Whether all memory of the program is locked.
    pub locks_memory: bool,
    /// Processor of the thread; `None` for any.
    pub cpu: Option<usize>,
}

/// A request that was refused, with the remedy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Shortfall {
    /// The scheduling policy is not available.
    #[error(
        "SCHED_FIFO with priority {priority} is not available ({error}): other programs will delay the cycle. Run as root, \
         give the program CAP_SYS_NICE (setcap cap_sys_nice+ep PROGRAM), or permit it to the user: `@realtime - rtprio 99` \
         in /etc/security/limits.conf"
    )]
    Policy {
        /// The requested priority.
        priority: u8,
        /// Error of the system.
        error: Errno,
    },
    /// The memory cannot be locked.
    #[error(
        "memory cannot be locked ({error}): page faults will delay the cycle. Run as root, give the program CAP_IPC_LOCK, or \
         permit it to the user: `@realtime - memlock unlimited` in /etc/security/limits.conf"
    )]
    Memory {
        /// Error of the system.
        error: Errno,
    },
    /// The processor is not available.
    #[error("processor {cpu} is not available ({error}); choose one that /proc/cpuinfo lists and this program may use")]
    Processor {
        /// The requested processor.
        cpu: usize,
        /// Error of the system.
        error: Errno,
    },
}

/// Applies the request to the calling thread. Returns what was refused; the thread continues without it.
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
    // With a limit on locked memory all later allocations would have to fit into it.
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
