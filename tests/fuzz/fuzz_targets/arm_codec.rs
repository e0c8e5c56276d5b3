//! Packets of both wire formats of the PA-10, out of whatever the fuzzer makes up.
#![no_main]

#[allow(dead_code, reason = "the other targets use more of it")]
#[path = "../../../hal/arm-pa10/tests/support/abuse.rs"]
mod abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::codecs_survive(bytes));
