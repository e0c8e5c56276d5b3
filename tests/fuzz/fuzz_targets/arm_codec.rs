//! Decodes packets of both wire formats of the PA-10 from fuzzer input.
#![no_main]

use pb3dp_arm_pa10_test_support::codec_abuse as abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::codecs_survive(bytes));
