//! Streams of the gateway's protocol: garbage, sound frames and damaged ones, out of whatever the fuzzer makes up.
#![no_main]

#[allow(dead_code, reason = "the other targets use more of it")]
#[path = "../../../hal/arm-pa10/tests/support/abuse.rs"]
mod abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::gateway_stream_survives(bytes));
