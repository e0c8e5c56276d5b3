//! Estimates with images of any size and form.
#![no_main]

#[allow(dead_code, unused_imports, reason = "the property tests use more of it")]
#[path = "../../../crates/estimation/tests/support/abuse.rs"]
mod abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::images_in_any_form_survive(bytes));
