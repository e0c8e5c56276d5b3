//! Runs the bodies of the arm's fuzz targets (`tests/fuzz`) on random bytes with a fixed seed, and on the inputs that fuzzing found.
//!
//! `tests/data/*.hex` holds the inputs that reached different code, one per line, out of 10 million for each target.
//! A test of xtask fails if a fuzz target has no call of `survives_seeded_bytes` here or in another test.

#![allow(clippy::expect_used, reason = "helpers of tests")]

use pb3dp_arm_pa10_test_support::codec_abuse as abuse;
use pb3dp_arm_pa10_test_support::gateway_abuse;
use pb3dp_test_support::sweep;
use proptest::prelude::*;
use proptest::test_runner::{Config, RngSeed, TestRunner};

/// Chosen: any value works; a fixed value gives the same inputs in every run. `PROPTEST_RNG_SEED` replaces it.
const SEED: u64 = 20_260;

/// Cases per check.
fn cases() -> u32 {
    sweep(2_000, 20_000)
}

/// Scenarios of a gateway take longer.
fn plays() -> u32 {
    sweep(200, 2_000)
}

/// Bytes in which the letters, numbers and sync bytes of the protocols are frequent.
fn bytes(length: std::ops::Range<usize>) -> impl Strategy<Value = Vec<u8>> {
    let likely = proptest::sample::select(b"SCEAR\x00\x01\x02\x03\x08\x10\x20\xA5\x5A\xFE\xFF".to_vec());
    prop::collection::vec(prop_oneof![2 => any::<u8>(), 3 => likely], length)
}

/// Runs the body of a fuzz target on seeded random bytes.
fn survives_seeded_bytes(target: &str, cases: u32, length: std::ops::Range<usize>, body: fn(&[u8])) {
    let config = Config { failure_persistence: None, ..Config::with_cases(cases) };
    let seed = if config.rng_seed == RngSeed::Random { RngSeed::Fixed(SEED) } else { config.rng_seed };
    let mut runner = TestRunner::new(Config { rng_seed: seed, ..config });
    let result = runner.run(&bytes(length), |bytes| {
        body(&bytes);
        Ok(())
    });
    assert_eq!(result, Ok(()), "fuzz target {target}, PROPTEST_RNG_SEED={seed}");
}

/// Inputs, one per line as hexadecimal digits.
fn check_kept(lines: &str, survives: fn(&[u8])) {
    let digit = |pair: &[u8]| std::str::from_utf8(pair).ok().and_then(|pair| u8::from_str_radix(pair, 16).ok());
    let mut inputs = 0;
    for line in lines.lines() {
        let input: Option<Vec<u8>> = line.as_bytes().chunks(2).map(digit).collect();
        survives(&input.expect("pairs of hexadecimal digits"));
        inputs += 1;
    }
    assert!(inputs > 50, "{inputs} inputs");
}

#[test]
fn what_the_fuzzer_found_is_survived() {
    check_kept(include_str!("data/arm_codec.hex"), abuse::codecs_survive);
    check_kept(include_str!("data/arm_gateway_frame.hex"), abuse::gateway_frame_survives);
    check_kept(include_str!("data/arm_gateway_stream.hex"), abuse::gateway_stream_survives);
    check_kept(include_str!("data/arm_gateway_core.hex"), gateway_abuse::gateway_core_survives);
}

#[test]
fn the_codecs_survive_any_bytes() {
    survives_seeded_bytes("arm_codec", cases(), 0..90, abuse::codecs_survive);
}

#[test]
fn the_gateway_protocol_survives_any_stream() {
    survives_seeded_bytes("arm_gateway_stream", cases(), 0..400, abuse::gateway_stream_survives);
}

#[test]
fn a_gateway_survives_any_play() {
    survives_seeded_bytes("arm_gateway_core", plays(), 0..200, gateway_abuse::gateway_core_survives);
}

#[test]
fn the_gateway_messages_survive_any_payload() {
    survives_seeded_bytes("arm_gateway_frame", cases(), 0..140, abuse::gateway_frame_survives);
}
