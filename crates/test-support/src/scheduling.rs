//! Scheduling of the calling thread.

use rustix::thread::{CpuSet, sched_setaffinity};

/// Priority of the threads of a real-time test: above all threads without such a priority, below every thread of the product that
/// requests one (40 and more).
const TEST: i32 = 1;
/// Priority of a witness: the computing of the test itself must not count as lateness of the machine.
const WITNESS: i32 = 2;

/// Niceness of tests of whole programs, which compute: preferred over all other programs, but not over kernel threads.
const OF_PROGRAMS: i32 = -10;

/// A scheduling policy with its priority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Policy {
    policy: libc::c_int,
    priority: libc::c_int,
}

impl Policy {
    /// Policy of real-time tests.
    pub const TEST: Self = Self { policy: libc::SCHED_FIFO, priority: TEST };
    /// Policy of witnesses.
    pub const WITNESS: Self = Self { policy: libc::SCHED_FIFO, priority: WITNESS };

    /// Policy of the calling thread.
    pub fn current() -> Self {
        let mut parameters = libc::sched_param { sched_priority: 0 };
        // SAFETY: both calls read the calling thread (0) only; the parameters outlive the second call.
        let policy = unsafe { libc::sched_getscheduler(0) };
        unsafe { libc::sched_getparam(0, &raw mut parameters) };
        Self { policy, priority: parameters.sched_priority }
    }

    /// Applies this policy to the calling thread; threads and processes that it starts inherit it. Returns whether the system
    /// grants it.
    pub fn enter(self) -> bool {
        let parameters = libc::sched_param { sched_priority: self.priority };
        // SAFETY: the parameters outlive the call, which only changes the policy of this thread (0).
        unsafe { libc::sched_setscheduler(0, self.policy, &raw const parameters) == 0 }
    }
}

/// The calling thread runs with a policy until this value is dropped.
pub struct Entered {
    before: Policy,
    is_granted: bool,
}

impl Entered {
    /// Enters the policy if the system grants it.
    pub fn new(policy: Policy) -> Self {
        let before = Policy::current();
        Self { before, is_granted: policy.enter() }
    }
}

impl Drop for Entered {
    fn drop(&mut self) {
        if self.is_granted {
            self.before.enter();
        }
    }
}

/// The calling thread is preferred over others of the default policy until this value is dropped, if granted; threads and
/// processes that it starts inherit this.
pub struct Preferred {
    before: i32,
}

impl Preferred {
    /// Enters.
    pub fn new() -> Self {
        // SAFETY: both calls concern the calling thread (0) only.
        let before = unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) };
        unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, OF_PROGRAMS) };
        Self { before }
    }
}

impl Default for Preferred {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Preferred {
    fn drop(&mut self) {
        // SAFETY: as above.
        unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, self.before) };
    }
}

/// Binds the calling thread to one processor, if granted.
pub fn run_on(cpu: usize) {
    let mut set = CpuSet::new();
    if cpu < CpuSet::MAX_CPU {
        set.set(cpu);
        let _ = sched_setaffinity(None, &set);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_is_left_again() {
        std::thread::spawn(|| {
            let before = Policy::current();
            let entered = Entered::new(Policy::TEST);
            assert_eq!(entered.is_granted, Policy::current() == Policy::TEST);
            drop(entered);
            assert_eq!(Policy::current(), before);
        })
        .join()
        .expect("the thread ends");
    }
}
