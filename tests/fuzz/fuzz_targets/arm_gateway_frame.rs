//! Decodes messages of the gateway protocol from fuzzer input.
#![no_main]

use pb3dp_arm_pa10_test_support::codec_abuse as abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::gateway_frame_survives(bytes));
