//! A gateway between a host, a controller and a clock that do whatever the fuzzer makes up.
#![no_main]

#[path = "../../../hal/arm-pa10/tests/support/gateway_abuse.rs"]
mod gateway_abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| gateway_abuse::gateway_core_survives(bytes));
