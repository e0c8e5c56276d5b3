//! Each rule of the clock suite detects a clock that breaks it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::{SystemClock, VirtualClock};
use pb3dp_hal_conformance::clock_suite;

/// Goes back by a microsecond now and then.
#[derive(Default)]
struct FallsBack {
    clock: VirtualClock,
    readings: AtomicU64,
}

impl Clock for FallsBack {
    fn now(&self) -> MonotonicTime {
        let reading = self.readings.fetch_add(1, Ordering::SeqCst);
        let back = if reading % 7 == 6 { Duration::from_micros(1) } else { Duration::ZERO };
        self.clock.now() + Duration::from_millis(1) - back
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        self.clock.sleep_until(deadline);
    }
}

#[test]
fn a_clock_that_falls_back() {
    assert!(clock_suite(FallsBack::default).breaks("never-goes-back"));
}

/// Uses every deadline as the time, past ones as well.
#[derive(Default)]
struct SetByDeadline(AtomicU64);

impl Clock for SetByDeadline {
    fn now(&self) -> MonotonicTime {
        MonotonicTime::from_nanos(self.0.load(Ordering::SeqCst))
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        self.0.store(deadline.as_nanos(), Ordering::SeqCst);
    }
}

#[test]
fn a_clock_that_a_past_deadline_sets_back() {
    let report = clock_suite(SetByDeadline::default);
    assert!(report.breaks("never-goes-back"), "{report}");
    assert!(!report.breaks("sleeps-to-the-deadline"), "{report}");
}

/// Wakes a millisecond early.
#[derive(Default)]
struct WakesEarly(VirtualClock);

impl Clock for WakesEarly {
    fn now(&self) -> MonotonicTime {
        self.0.now()
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        self.0.sleep_until(deadline - Duration::from_millis(1));
    }
}

#[test]
fn a_clock_that_wakes_early() {
    assert!(clock_suite(WakesEarly::default).breaks("sleeps-to-the-deadline"));
}

/// Waits a second of its own time for a deadline that has passed.
#[derive(Default)]
struct WaitsForThePast(VirtualClock);

impl Clock for WaitsForThePast {
    fn now(&self) -> MonotonicTime {
        self.0.now()
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        let past = deadline <= self.0.now();
        self.0.sleep_until(if past { self.0.now() + Duration::from_secs(1) } else { deadline });
    }
}

#[test]
fn a_clock_that_waits_for_the_past() {
    assert!(clock_suite(WaitsForThePast::default).breaks("does-not-wait-for-the-past"));
}

/// Counts separately in each thread.
struct PerThread(SystemClock);

impl Clock for PerThread {
    fn now(&self) -> MonotonicTime {
        let main = std::thread::current().name().is_some();
        let ahead = if main { Duration::ZERO } else { Duration::from_secs(5) };
        self.0.now() + ahead
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        self.0.sleep_until(deadline);
    }
}

#[test]
fn a_clock_that_differs_between_threads() {
    let report = clock_suite(|| PerThread(SystemClock::new()));
    assert!(report.breaks("one-time-for-all-threads"), "{report}");
}
