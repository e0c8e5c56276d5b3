//! Hue: golden values, the gate for grey, and kernels that agree bit for bit.

use image::{Rgb, RgbImage};
use pb3dp_estimation_test_support::every_kernel;
use proptest::prelude::*;

use super::*;

const OPEN: HueConfig = HueConfig { saturation_min: 0.0, value_min: 0.0 };

fn plane_of(pixels: &[[u8; 3]], config: &HueConfig) -> HuePlane {
    let image = RgbImage::from_fn(pixels.len() as u32, 1, |x, _| Rgb(pixels[x as usize]));
    HuePlane::from_rgb(&image, config)
}

fn hue_of(pixel: [u8; 3]) -> Hue {
    plane_of(&[pixel], &OPEN).at(0, 0).expect("coloured")
}

/// Golden values of Python's `colorsys.rgb_to_hsv`, times 360.
fn valid_count(plane: &HuePlane) -> usize {
    plane.padded().iter().filter(|bits| **bits & 1 == 1).count()
}

#[test]
fn agrees_with_golden_hues() {
    let golden = [
        ([255, 0, 0], 0.0),
        ([255, 85, 0], 20.0),
        ([255, 254, 0], 59.764706),
        ([255, 255, 0], 60.0),
        ([0, 255, 0], 120.0),
        ([12, 200, 199], 179.680851),
        ([0, 255, 255], 180.0),
        ([33, 34, 60], 237.777778),
        ([0, 0, 255], 240.0),
        ([1, 0, 255], 240.235294),
        ([90, 40, 130], 273.333333),
        ([255, 0, 255], 300.0),
        ([200, 31, 77], 343.668639),
        ([255, 0, 4], 359.058824),
        ([250, 128, 114], 6.176471),
    ];
    for (pixel, degrees) in golden {
        let hue = hue_of(pixel);
        let error = (hue.degrees() - degrees + 180.0).rem_euclid(360.0) - 180.0;
        assert!(error.abs() < 0.006, "{pixel:?}: {} instead of {degrees}", hue.degrees());
    }
}

#[test]
fn distance_wraps_around() {
    let (below, above) = (hue_of([255, 0, 4]), hue_of([255, 4, 0]));
    assert!((below.distance_deg(above) - 2.0 * 0.941176).abs() < 0.012);
    assert!((hue_of([255, 0, 0]).distance_deg(hue_of([0, 255, 255])) - 180.0).abs() < 1e-9);
    assert!((Hue::from_degrees(-1.0).distance_deg(Hue::from_degrees(361.0)) - 2.0).abs() < 0.012);
}

#[test]
fn the_hue_gate_accepts_its_stated_range() {
    let config = HueConfig { saturation_min: 0.25, value_min: 0.2 };
    // Saturation 0.25 exactly and one step below; value 51 = 0.2 exactly and one step below; pure grey; black.
    let pixels = [[200, 150, 160], [200, 151, 160], [51, 0, 9], [50, 0, 9], [120, 120, 120], [0, 0, 0]];
    let plane = plane_of(&pixels, &config);
    let has_hue: Vec<bool> = (0..6).map(|u| plane.at(u, 0).is_some()).collect();
    assert_eq!(has_hue, [true, false, true, false, false, false]);
    assert_eq!(valid_count(&plane), 2);
    assert_eq!((plane.at(-1, 0), plane.at(6, 0), plane.at(0, 1)), (None, None, None));
}

#[test]
fn grey_never_has_a_hue() {
    let plane = plane_of(&[[0; 3], [7; 3], [255; 3]], &OPEN);
    assert_eq!(valid_count(&plane), 0);
}

#[test]
fn gates_out_of_range_are_refused() {
    for config in [HueConfig { saturation_min: 1.5, ..OPEN }, HueConfig { value_min: f64::NAN, ..OPEN }] {
        assert!(config.validate().is_err(), "{config:?}");
    }
    assert!(HueConfig::default().validate().is_ok());
}

/// Every colour of 8-bit RGB on a lattice with a prime step, and the channel extremes.
#[test]
fn kernels_agree_on_a_lattice_of_all_colours() {
    let levels: Vec<u8> = (0..=255).step_by(7).chain([1, 2, 127, 128, 254, 255]).collect();
    let mut bytes = Vec::new();
    for r in &levels {
        for g in &levels {
            for b in &levels {
                bytes.extend([*r, *g, *b]);
            }
        }
    }
    check_kernels(&bytes, &HueConfig::default());
    check_kernels(&bytes, &OPEN);
}

fn check_kernels(bytes: &[u8], config: &HueConfig) {
    let pixels = bytes.len() / 3;
    let mut expected = vec![0; pixels];
    convert_kernel(bytes, config.gate(), &mut expected);
    for kernels in every_kernel() {
        let mut got = vec![0xAAAA; pixels];
        convert(kernels, bytes, config.gate(), &mut got);
        assert!(got == expected, "{} differs from scalar", kernels.set().name());
    }
}

proptest! {
    #[test]
    fn kernels_agree_bit_for_bit(
        bytes in proptest::collection::vec(any::<u8>(), 0..900),
        saturation_min in 0.0..=1.0,
        value_min in 0.0..=1.0,
    ) {
        check_kernels(&bytes[..bytes.len() / 3 * 3], &HueConfig { saturation_min, value_min });
    }

    #[test]
    fn agrees_with_the_definition_in_double_precision(r: u8, g: u8, b: u8) {
        let (max, min) = (r.max(g).max(b), r.min(g).min(b));
        prop_assume!(max != min);
        let [rf, gf, bf] = [r, g, b].map(f64::from);
        let delta = f64::from(max - min);
        let sixths = if max == r { (gf - bf) / delta } else if max == g { 2.0 + (bf - rf) / delta } else { 4.0 + (rf - gf) / delta };
        let error = (hue_of([r, g, b]).degrees() - 60.0 * sixths + 180.0).rem_euclid(360.0) - 180.0;
        prop_assert!(error.abs() < 0.0056, "error {error} degrees");
    }
}
