//! Both clocks fulfil the contract of their trait.

use std::time::{Duration, Instant};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::{SystemClock, VirtualClock};
use pb3dp_hal_conformance::clock_suite;

#[test]
fn system_clock_keeps_the_contract() {
    clock_suite(SystemClock::new).assert_passed();
}

#[test]
fn virtual_clock_keeps_the_contract() {
    clock_suite(VirtualClock::new).assert_passed();
}

#[test]
fn virtual_time_passes_only_in_sleep() {
    let clock = VirtualClock::new();
    assert_eq!(clock.now(), MonotonicTime::ZERO);
    let hour = MonotonicTime::ZERO + Duration::from_secs(3600);
    clock.sleep_until(hour);
    assert_eq!(clock.now(), hour);
    clock.sleep_until(MonotonicTime::ZERO);
    assert_eq!(clock.now(), hour);
}

#[test]
fn system_clock_runs_with_the_machine() {
    let clock = SystemClock::new();
    // Each reading of one clock lies between two readings of the other, however long a thread waits in between.
    let outer = Instant::now();
    let before = clock.now();
    let inner = Instant::now();
    clock.sleep_until(before + Duration::from_millis(20));
    let inner = inner.elapsed();
    let measured = clock.now().saturating_since(before);
    let outer = outer.elapsed();
    assert!(measured >= Duration::from_millis(20));
    assert!(inner <= measured && measured <= outer, "{inner:?}, {measured:?}, {outer:?}");
}
