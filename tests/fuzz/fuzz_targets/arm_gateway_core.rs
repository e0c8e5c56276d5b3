//! Runs a gateway with a host, a controller and a clock driven by fuzzer input.
#![no_main]

use pb3dp_arm_pa10_test_support::gateway_abuse as abuse;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| abuse::gateway_core_survives(bytes));
