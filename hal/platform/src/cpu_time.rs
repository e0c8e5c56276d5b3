//! CPU time of the calling thread: the cost of a computation, independent of other programs.

use rustix::time::{ClockId, clock_gettime};

/// CPU time that this thread has used so far, milliseconds.
pub fn thread_cpu_millis() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 * 1e3 + now.tv_nsec as f64 * 1e-6
}

/// Runs `work` and returns its result with the CPU time that it took on this thread, milliseconds.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = thread_cpu_millis();
    let result = work();
    (result, thread_cpu_millis() - start)
}

/// A check for methods that may be cut short: true until this thread has used another `limit_millis` of CPU time.
/// Always true without a limit.
pub fn within(limit_millis: Option<f64>) -> impl FnMut() -> bool {
    let end = limit_millis.map(|limit| thread_cpu_millis() + limit);
    move || end.is_none_or(|end| thread_cpu_millis() < end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeping_costs_no_cpu_time_and_work_does() {
        let ((), asleep) = timed(|| std::thread::sleep(std::time::Duration::from_millis(30)));
        let (sum, busy) =
            timed(|| (0..2_000_000_u64).fold(0_u64, |a, b| a.wrapping_mul(31).wrapping_add(b ^ (a >> 7))));
        assert!(sum != 0 && asleep < 25.0 && busy > 0.0, "asleep {asleep} ms, busy {busy} ms");
    }
}
