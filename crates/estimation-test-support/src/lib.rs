//! Shared support code for tests of several estimation crates.
#![allow(clippy::expect_used, reason = "support code of tests, with inputs that are valid")]

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use pb3dp_estimation_core::cpu::{KernelSet, Kernels};

#[allow(missing_docs, reason = "names say it")]
pub mod naive;
#[allow(missing_docs, reason = "names say it")]
pub mod scene;

/// Every family of kernels supported by this processor, for the running test, which compares them. A missing family is reported
/// as not checked: if all are missing the portable code is compared with itself.
pub fn every_kernel() -> impl Iterator<Item = Kernels> {
    static REPORTED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    // The test harness names the thread of a test after the test.
    let test = std::thread::current().name().unwrap_or("kernels").to_owned();
    let missing = KernelSet::ALL.into_iter().filter(|set| !set.is_available()).map(KernelSet::name);
    let missing: Vec<&str> = missing.collect();
    // A test that calls this repeatedly reports once.
    if !missing.is_empty() && REPORTED.lock().unwrap_or_else(PoisonError::into_inner).insert(test.clone()) {
        pb3dp_test_support::not_checked(&test, &format!("this processor has no {}", missing.join(", no ")));
    }
    Kernels::available()
}
