//! Decodes streams of the gateway protocol from fuzzer input: garbage, valid frames and damaged ones.
#![no_main]

use pb3dp_arm_pa10_test_support::codec_abuse as abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::gateway_stream_survives(bytes));
