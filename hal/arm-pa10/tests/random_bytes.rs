//! What the fuzz targets in `tests/fuzz` do with more patience: random bytes, and again what they found to be different.
//!
//! `tests/data/*.hex` holds the inputs that reached different code, one per line, out of 10 million for each target.

#![allow(clippy::expect_used, reason = "helpers of tests")]

#[path = "support/abuse.rs"]
mod abuse;
#[path = "support/gateway_abuse.rs"]
mod gateway_abuse;

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

/// Cases per check; with the three checks and their sizes a second or two.
const CASES: u32 = 20_000;

/// Plays of a gateway take longer.
const PLAYS: u32 = 2_000;

/// Bytes in which the letters, numbers and sync bytes of the protocols are frequent.
fn bytes(length: std::ops::Range<usize>) -> impl Strategy<Value = Vec<u8>> {
    let likely = proptest::sample::select(b"SCEAR\x00\x01\x02\x03\x08\x10\x20\xA5\x5A\xFE\xFF".to_vec());
    prop::collection::vec(prop_oneof![2 => any::<u8>(), 3 => likely], length)
}

fn check(length: std::ops::Range<usize>, survives: fn(&[u8])) {
    check_cases(CASES, length, survives);
}

fn check_cases(cases: u32, length: std::ops::Range<usize>, survives: fn(&[u8])) {
    let mut runner = TestRunner::new(Config { failure_persistence: None, ..Config::with_cases(cases) });
    let result = runner.run(&bytes(length), |bytes| {
        survives(&bytes);
        Ok(())
    });
    assert_eq!(result, Ok(()));
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
    check(0..90, abuse::codecs_survive);
}

#[test]
fn the_gateway_protocol_survives_any_stream() {
    check(0..400, abuse::gateway_stream_survives);
}

#[test]
fn a_gateway_survives_any_play() {
    check_cases(PLAYS, 0..200, gateway_abuse::gateway_core_survives);
}

#[test]
fn the_gateway_messages_survive_any_payload() {
    check(0..140, abuse::gateway_frame_survives);
}
