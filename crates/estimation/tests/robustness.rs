//! Whatever comes in: no panic, no number that is none, always a reason.

#[path = "support/abuse.rs"]
mod abuse;

use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn every_method_survives_any_pair(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
        abuse::every_method_survives(&bytes);
    }
}

/// The extremes by name, so that no run misses them: every pattern, in pictures of 100, 1, 3 and 16 pixels.
#[test]
fn every_method_survives_the_classics() {
    for pattern in 0..9_u8 {
        for side_choice in [0, 216, 218, 221] {
            let mut bytes = abuse::ordinary_prefix(side_choice);
            // Three frames of one pattern, then shifts.
            bytes.extend([2, pattern, pattern, pattern, pattern, 5, 0, 9, 0, 13, 0]);
            abuse::every_method_survives(&bytes);
        }
    }
}

/// The generator makes what the other tests believe: most abuses are pairs that a method works on.
#[test]
fn most_abuses_reach_the_methods() {
    let mut worked = 0;
    for seed in 0..40_u32 {
        let bytes: Vec<u8> = (0..64_u32).map(|i| ((i ^ (seed << 8)).wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        let Some(abuse) = abuse::Abuse::from_bytes(&bytes) else { continue };
        let (left, right) = &abuse.pairs[0];
        let method = pb3dp_estimation::estimator::Method::Published;
        let estimator = pb3dp_estimation::estimator::Estimator::new(method, &abuse.rig, &Default::default());
        worked +=
            usize::from(estimator.is_ok_and(|mut e| e.estimate(left, right, &abuse.region, &abuse.range).is_ok()));
    }
    assert!(worked >= 8, "{worked} of 40");
}

/// What the fuzzer has found, each with what it was.
#[test]
fn every_method_survives_what_fuzzing_found() {
    let found: [&[u8]; 1] = [
        // Intrinsics that turn the depth range into 10^9 pixels of disparity, for which memory was asked.
        &[
            10, 114, 255, 255, 33, 0, 0, 0, 255, 255, 255, 255, 255, 255, 33, 0, 0, 0, 255, 255, 255, 219, 72, 0, 0, 0,
            219, 218,
        ],
    ];
    for bytes in found {
        abuse::every_method_survives(bytes);
    }
}
