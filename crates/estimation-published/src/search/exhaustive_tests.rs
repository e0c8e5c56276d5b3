//! Exhaustive search: the truth at the optimum, ties, and parts that merge.

use image::RgbImage;
use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_test_support::scene::{self, Scene};
use pb3dp_geometry::{ImageSize, StereoRig};

use super::*;
use crate::fitness::{FitnessConfig, HueFitness};
use crate::hue::{HueConfig, HuePlane};
use crate::photo_model::{PhotoModel, PhotoModelConfig};
use crate::search::chromosome::Coding;
use crate::search::rmga::{Population, RmGa, RmGaConfig};

const SIZE: ImageSize = ImageSize { width: 320, height: 240 };
const TRUTH: Scene =
    Scene { centre_px: Vector2::new(183.0, 118.0), z_m: 0.478, theta_x_rad: 0.22, theta_y_rad: -0.17, noise: 4.0 };

fn codec() -> Codec {
    Codec::new(SearchRange::new(0.40, 0.56, 0.5).expect("range"), Coding::Gray)
}

/// The synthetic disc in the images of a rig: its model and the hues of the right image.
fn observed(rig: &StereoRig) -> (PinholePair, PhotoModel, HuePlane, RgbImage) {
    let (left, right) = TRUTH.render(rig);
    let region = RegionMask::from_fn(SIZE, |u, v| TRUTH.sees_disc(rig, u, v));
    let config = HueConfig::default();
    let model = PhotoModel::sample(&HuePlane::from_rgb(&left, &config), &region, &PhotoModelConfig::default());
    (PinholePair::from_rig(rig).expect("pair"), model, HuePlane::from_rgb(&right, &config), right)
}

fn check_finds_the_truth(rig: &StereoRig, z_codes: Range<u32>) {
    let (pair, model, right, _) = observed(rig);
    let codec = codec();
    let mut fitness = HueFitness::new(FitnessConfig::default(), Kernels::best()).expect("config");
    let frame = fitness.prepare(&pair, &model, &right, codec.range()).expect("frame");
    let optimum = optimum_in(&frame, &codec, z_codes);
    let psi = codec.decode(optimum.chromosome);
    // The region's centroid is not the disc's centre: compare the plane at the disc's centre, not psi's depth.
    let depth_m = psi.depth_at_pixel(&pair, &model.centre_px(), &TRUTH.centre_px).expect("in front");
    assert!((depth_m - TRUTH.z_m).abs() < 0.003, "depth {depth_m} m");
    let [x, y] = [psi.theta_x_rad - TRUTH.theta_x_rad, psi.theta_y_rad - TRUTH.theta_y_rad];
    assert!(x.abs() < 0.09 && y.abs() < 0.09, "tilt errors {x} {y} rad");
    assert!(frame.fitness(optimum.score).expect("scored") > 0.8, "score {}", optimum.score);

    for seed in 0..10 {
        let config = RmGaConfig { seed, ..RmGaConfig::default() };
        let mut ga = RmGa::new(config, *codec.range()).expect("config");
        let mut population = Population::random(&config);
        let best = (0..6).map(|_| ga.evolve(&mut population, &frame)).last().expect("frames");
        let code = codec.codes(best.chromosome).z;
        assert!(best.score <= optimum.score, "seed {seed}: {best:?} beats {optimum:?} at depth code {code}");
        let reached = frame.fitness(best.score).expect("scored") / frame.fitness(optimum.score).expect("scored");
        assert!(reached > 0.9, "seed {seed} reaches {reached} of the optimum");
    }
}

/// Depth codes around the truth, a range that includes every good individual: the other depths would only add test time.
const NEAR_TRUTH: Range<u32> = 440..560;

#[test]
fn a_rectified_pair_shows_the_truth_at_the_optimum() {
    check_finds_the_truth(&scene::rectified_rig(SIZE), NEAR_TRUTH);
}

#[test]
fn a_general_pair_shows_the_truth_at_the_optimum() {
    check_finds_the_truth(&scene::general_rig(SIZE), NEAR_TRUTH);
}

/// A score without images: a peak with a flat top of known extent.
struct Box3;

impl PlaneScore for Box3 {
    fn score(&self, hypotheses: &[PlaneHypothesis], scores: &mut [i32]) {
        let codec = codec();
        for (psi, score) in hypotheses.iter().zip(scores) {
            let codes = codec.codes(codec.encode(psi));
            let inside = (300..303).contains(&codes.z) && (20..22).contains(&codes.theta_x) && codes.theta_y < 5;
            *score = if codes.theta_x == 127 { REFUSED } else { i32::from(inside) - 1 };
        }
    }

    fn score_max(&self) -> i32 {
        1
    }
}

#[test]
fn ties_are_counted_and_the_lowest_chromosome_is_named() {
    let codec = codec();
    let whole = optimum_in(&Box3, &codec, 295..310);
    assert_eq!((whole.score, whole.ties), (0, 3 * 2 * 5));
    let lowest = (300..303)
        .flat_map(|z| (20..22).flat_map(move |theta_x| (0..5).map(move |theta_y| Codes { z, theta_x, theta_y })))
        .map(|codes| codec.chromosome(codes))
        .min();
    assert_eq!(Some(whole.chromosome), lowest);
}

#[test]
fn parts_merge_to_the_whole_in_any_order() {
    let codec = codec();
    let whole = optimum_in(&Box3, &codec, 295..310);
    let parts = [295..301, 301..302, 302..310].map(|z_codes| optimum_in(&Box3, &codec, z_codes));
    assert_eq!(parts.into_iter().fold(Optimum::NONE, Optimum::merge), whole);
    assert_eq!(parts.into_iter().rev().fold(Optimum::NONE, Optimum::merge), whole);
}

#[test]
fn nothing_scored_gives_no_optimum() {
    struct Refuse;
    impl PlaneScore for Refuse {
        fn score(&self, _: &[PlaneHypothesis], scores: &mut [i32]) {
            scores.fill(REFUSED);
        }

        fn score_max(&self) -> i32 {
            1
        }
    }
    assert_eq!(optimum_in(&Refuse, &codec(), 5..9), Optimum::NONE);
    assert_eq!(optimum_in(&Box3, &codec(), 9..9), Optimum::NONE);
}
