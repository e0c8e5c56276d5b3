//! The contract of [`Clock`].

use std::time::{Duration, Instant};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use crate::Report;

const READINGS: usize = 1000;
const THREADS: usize = 4;
const SLEEP: Duration = Duration::from_millis(3);

/// Scheduling delay tolerated on a busy machine for a call that does not wait.
const SCHEDULING_SLACK: Duration = Duration::from_millis(500);

/// Tests a clock against its contract. Takes some milliseconds of the clock's time.
///
/// Rules: `never-goes-back`, `one-time-for-all-threads`, `sleeps-to-the-deadline`, `does-not-wait-for-the-past`.
pub fn clock_suite<C: Clock>(make: impl Fn() -> C) -> Report {
    let mut report = Report::new(std::any::type_name::<C>());
    check_readings(&make(), &mut report);
    check_threads(&make(), &mut report);
    check_sleep(&make(), &mut report);
    check_past_deadline(&make(), &mut report);
    report
}

fn check_readings(clock: &dyn Clock, report: &mut Report) {
    let mut before = clock.now();
    for number in 0..READINGS {
        if number % 100 == 50 {
            clock.sleep_until(before + Duration::from_micros(10));
        }
        let now = clock.now();
        let holds = now >= before;
        if !report.check("never-goes-back", holds, || format!("reading {number} is {now:?} after {before:?}")) {
            return;
        }
        before = now;
    }
}

/// Time read after a thread has ended is not before the time read by that thread, and vice versa.
fn check_threads<C: Clock>(clock: &C, report: &mut Report) {
    for _ in 0..THREADS {
        let before = clock.now();
        let in_thread = std::thread::scope(|scope| {
            let reader = scope.spawn(|| {
                clock.sleep_until(before + Duration::from_micros(50));
                clock.now()
            });
            reader.join().ok()
        });
        let after = clock.now();
        let ordered = in_thread.is_some_and(|in_thread| before <= in_thread && in_thread <= after);
        report.check("one-time-for-all-threads", ordered, || {
            format!("{before:?}, in a thread {in_thread:?}, then {after:?}")
        });
    }
}

fn check_sleep(clock: &dyn Clock, report: &mut Report) {
    for _ in 0..3 {
        let deadline = clock.now() + SLEEP;
        clock.sleep_until(deadline);
        let woke = clock.now();
        report.check("sleeps-to-the-deadline", woke >= deadline, || format!("slept to {deadline:?}, woke at {woke:?}"));
    }
}

fn check_past_deadline(clock: &dyn Clock, report: &mut Report) {
    clock.sleep_until(clock.now() + SLEEP);
    let (before, started) = (clock.now(), Instant::now());
    let mut last = before;
    for past in [MonotonicTime::ZERO, before - Duration::from_millis(1), before] {
        clock.sleep_until(past);
        let now = clock.now();
        report.check("never-goes-back", now >= last, || format!("a sleep to {past:?} led from {last:?} to {now:?}"));
        last = now;
    }
    // A virtual clock must not advance; a real one advances by the duration of the calls.
    let cost = last.saturating_since(before).max(started.elapsed());
    report.check("does-not-wait-for-the-past", cost <= SCHEDULING_SLACK, || format!("waited {cost:?}"));
}
