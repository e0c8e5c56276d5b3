//! Colours of YUYV: the equations, and vectors that give the bytes of the scalar code.

use super::*;
use proptest::prelude::*;

/// The fastest kernels of this processor. If that is the portable code, the running test compares it with itself, and reports
/// this.
fn vectors() -> YuvKernels {
    static IS_REPORTED: std::sync::Once = std::sync::Once::new();
    let best = YuvKernels::best();
    if best == YuvKernels::SCALAR {
        // Each of these tests reports once, because a property test calls this repeatedly.
        IS_REPORTED.call_once(|| {
            for test in [
                "the_two_pixels_of_a_pair_keep_their_order",
                "vectors_give_the_bytes_of_the_scalar_code",
                "vectors_and_scalar_code_agree_on_every_brightness_and_colour",
            ] {
                let test = format!("pixels::yuyv::tests::{test}");
                pb3dp_test_support::not_checked(&test, "this processor has neither AVX2 nor NEON");
            }
        });
    }
    best
}

const ALL: [(YuvMatrix, YuvRange); 4] = [
    (YuvMatrix::Bt601, YuvRange::Limited),
    (YuvMatrix::Bt601, YuvRange::Full),
    (YuvMatrix::Bt709, YuvRange::Limited),
    (YuvMatrix::Bt709, YuvRange::Full),
];

/// The decimal coefficients derived from ITU-R BT.601-7 and BT.709-6 and JFIF 1.02, calculated by hand.
fn in_floating_point([y, u, v]: [u8; 3], matrix: YuvMatrix, range: YuvRange) -> [f64; 3] {
    let (rv, gu, gv, bu) = match matrix {
        YuvMatrix::Bt601 => (1.402, 0.344136, 0.714136, 1.772),
        YuvMatrix::Bt709 => (1.5748, 0.187324, 0.468124, 1.8556),
    };
    let (y, scale) = match range {
        YuvRange::Limited => ((f64::from(y) - 16.0) * 1.164384, 1.138393),
        YuvRange::Full => (f64::from(y), 1.0),
    };
    let (u, v) = ((f64::from(u) - 128.0) * scale, (f64::from(v) - 128.0) * scale);
    [y + rv * v, y - gu * u - gv * v, y + bu * u].map(|value| value.clamp(0.0, 255.0))
}

#[test]
fn every_colour_is_within_one_step_of_the_equations() {
    let values: Vec<u8> = (0..=255).step_by(3).chain([1, 16, 128, 235, 240, 254]).collect();
    for (matrix, range) in ALL {
        let equations = Equations::of(matrix, range);
        let mut worst = 0.0_f64;
        for y in &values {
            for u in &values {
                for v in &values {
                    let mut rgb = [0; 6];
                    convert_row(&[*y, *u, *y, *v], &mut rgb, &equations, YuvKernels::SCALAR);
                    let expected = in_floating_point([*y, *u, *v], matrix, range);
                    for (found, expected) in rgb.iter().zip(expected) {
                        worst = worst.max((f64::from(*found) - expected).abs());
                    }
                }
            }
        }
        assert!(worst < 0.6, "{matrix:?} {range:?}: error {worst}, rounding alone is 0.5");
    }
}

#[test]
fn black_white_and_primaries_are_exact() {
    // The colour bars of ITU-R BT.601: Y, Cb, Cr of full-scale red, green and blue in 8 bits.
    for (yuv, rgb) in [
        ([16, 128, 128], [0, 0, 0]),
        ([235, 128, 128], [255, 255, 255]),
        ([81, 90, 240], [254, 0, 0]),
        ([145, 54, 34], [0, 255, 1]),
        ([41, 240, 110], [0, 0, 255]),
    ] {
        let mut out = [0; 6];
        let bytes = [yuv[0], yuv[1], yuv[0], yuv[2]];
        let equations = Equations::of(YuvMatrix::Bt601, YuvRange::Limited);
        convert_row(&bytes, &mut out, &equations, YuvKernels::SCALAR);
        assert_eq!(out[..3], rgb, "of {yuv:?}");
    }
}

#[test]
fn the_two_pixels_of_a_pair_keep_their_order() {
    let equations = Equations::of(YuvMatrix::Bt601, YuvRange::Full);
    for kernels in [YuvKernels::SCALAR, vectors()] {
        let (mut source, mut target) = (vec![128; 4 * 24], vec![0; 3 * 48]);
        for (k, pixel) in source.iter_mut().step_by(2).enumerate() {
            *pixel = 5 * k as u8;
        }
        convert_row(&source, &mut target, &equations, kernels);
        let expected: Vec<u8> = (0..48).flat_map(|k| [5 * k; 3]).collect();
        assert_eq!(target, expected, "{}", kernels.name());
    }
}

proptest! {
    #[test]
    fn vectors_give_the_bytes_of_the_scalar_code(
        (pixels, source) in (1_usize..150).prop_flat_map(|n| (Just(n), prop::collection::vec(any::<u8>(), n.div_ceil(2) * 4))),
        which in 0_usize..4,
    ) {
        let equations = Equations::of(ALL[which].0, ALL[which].1);
        let (mut plain, mut vectors) = (vec![0; 3 * pixels], vec![0; 3 * pixels]);
        convert_row(&source, &mut plain, &equations, YuvKernels::SCALAR);
        convert_row(&source, &mut vectors, &equations, self::vectors());
        prop_assert_eq!(plain, vectors);
    }
}

#[test]
fn vectors_and_scalar_code_agree_on_every_brightness_and_colour() {
    for (matrix, range) in ALL {
        let equations = Equations::of(matrix, range);
        for u in 0..=255 {
            let source: Vec<u8> = (0..=255).flat_map(|k: u8| [k, u, 255 - k, k.wrapping_mul(7)]).collect();
            let (mut plain, mut vectors) = (vec![0; 3 * 512], vec![0; 3 * 512]);
            convert_row(&source, &mut plain, &equations, YuvKernels::SCALAR);
            convert_row(&source, &mut vectors, &equations, self::vectors());
            assert_eq!(plain, vectors, "{matrix:?} {range:?}, U {u}");
        }
    }
}
