//! Estimates with calibrations of any numbers.
#![no_main]

#[allow(dead_code, unused_imports, reason = "the property tests use more of it")]
#[path = "../../../crates/estimation/tests/support/abuse.rs"]
mod abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::calibrations_with_any_numbers_survive(bytes));
