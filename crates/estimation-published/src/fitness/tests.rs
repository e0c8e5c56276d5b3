//! The published fitness: votes as in the paper, with every kernel, and refused hypotheses.

use image::{Rgb, RgbImage};
use nalgebra::Vector2;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_test_support::naive::{self, Naive};
use pb3dp_estimation_test_support::scene;
use pb3dp_geometry::{ImageSize, StereoRig};
use proptest::prelude::*;

use super::*;
use crate::hue::{Hue, HueConfig};
use crate::photo_model::ModelPoint;

const SIZE: ImageSize = ImageSize { width: 320, height: 240 };
/// Gates with an exact integer form, so that the reference can apply them in floating point.
const GATE: HueConfig = HueConfig { saturation_min: 0.25, value_min: 0.2 };

fn range(tilt_max_rad: f64) -> SearchRange {
    SearchRange::new(0.35, 0.65, tilt_max_rad).expect("range")
}

/// Coarse random patches: hues of neighbours are independent, a fifth of the pixels is grey.
fn random_image(seed: u64) -> RgbImage {
    let mut rng = SplitMix64::new(seed);
    RgbImage::from_fn(SIZE.width, SIZE.height, |_, _| {
        let bits = rng.next_u64();
        match bits % 5 {
            0 => Rgb([128, 130, (125 + bits % 7) as u8]),
            1 | 2 => Rgb([200, (bits >> 8) as u8, 40]),
            _ => Rgb([(bits >> 8) as u8, (bits >> 16) as u8, (bits >> 24) as u8]),
        }
    })
}

/// A model with random points around a centre and random hues.
fn random_model(seed: u64, centre_px: Vector2<f64>, radius: i32, counts: (usize, usize)) -> PhotoModel {
    let mut rng = SplitMix64::new(seed);
    let mut points = |count| {
        let mut points: Vec<ModelPoint> = (0..count)
            .map(|_| {
                let mut offset = || rng.below(2 * radius as u32 + 1) as i32 - radius;
                let (u, v) = (centre_px.x as i32 + offset(), centre_px.y as i32 + offset());
                let (u, v) = (u.clamp(0, SIZE.width as i32 - 1), v.clamp(0, SIZE.height as i32 - 1));
                ModelPoint { u, v, hue: Hue::from_degrees(f64::from(rng.below(36_000)) / 100.0) }
            })
            .collect();
        points.sort_by_key(|p| (p.v, p.u));
        points
    };
    let inner = points(counts.0);
    PhotoModel::from_points(centre_px, inner, points(counts.1))
}

fn random_hypotheses(seed: u64, range: &SearchRange, count: usize) -> Vec<PlaneHypothesis> {
    let mut rng = SplitMix64::new(seed);
    let mut within = |low: f64, high: f64| low + (high - low) * f64::from(rng.below(1025)) / 1024.0;
    let tilt = range.tilt_max_rad;
    (0..count)
        .map(|_| PlaneHypothesis {
            z_m: within(range.z_min_m, range.z_max_m),
            theta_x_rad: within(-tilt, tilt),
            theta_y_rad: within(-tilt, tilt),
        })
        .collect()
}

fn naive<'a>(rig: &'a StereoRig, right: &'a RgbImage, model: &PhotoModel) -> Naive<'a> {
    let points = |points: &[ModelPoint]| {
        let point = |p: &ModelPoint| naive::Point { u: p.u.into(), v: p.v.into(), hue_deg: p.hue.degrees() };
        points.iter().map(point).collect()
    };
    Naive {
        rig,
        right,
        centre_px: model.centre_px(),
        inner: points(model.inner()),
        outer: points(model.outer()),
        saturation_min: GATE.saturation_min,
        value_min: GATE.value_min,
    }
}

fn rigs() -> [StereoRig; 2] {
    [scene::rectified_rig(SIZE), scene::general_rig(SIZE)]
}

/// The votes of every kernel are within the bounds of the reference for address errors of a hundredth of a pixel.
#[test]
fn votes_are_those_of_the_paper() {
    let right_rgb = random_image(3);
    let right = HuePlane::from_rgb(&right_rgb, &GATE);
    for rig in rigs() {
        let pair = PinholePair::from_rig(&rig).expect("pair");
        let model = random_model(8, Vector2::new(171.3, 117.8), 45, (150, 50));
        let reference = naive(&rig, &right_rgb, &model);
        let range = range(0.7);
        let mut exact = 0;
        let psis = random_hypotheses(17, &range, 400);
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let mut fitness = HueFitness::new(FitnessConfig::default(), kernels).expect("config");
            let frame = fitness.prepare(&pair, &model, &right, &range).expect("frame");
            for psi in &psis {
                let votes = frame.votes(psi).expect("accepted");
                let [inner, outer] = reference.match_bounds(psi.z_m, psi.theta_x_rad, psi.theta_y_rad, 0.01);
                assert!((inner.0..=inner.1).contains(&votes.inner_matches), "{votes:?} {inner:?} for {psi:?}");
                assert!((outer.0..=outer.1).contains(&votes.outer_matches), "{votes:?} {outer:?} for {psi:?}");
                let mut score = [0];
                frame.score(&[*psi], &mut score);
                let expected = reference.fitness(psi.z_m, psi.theta_x_rad, psi.theta_y_rad);
                exact += usize::from((frame.fitness(score[0]).expect("scored") - expected).abs() < 1e-12);
            }
        }
        // Address rounding affects few hypotheses.
        assert!(exact * 10 > 9 * psis.len() * Kernels::available().count(), "{exact} exactly equal");
    }
}

/// The complete comparison: many hypotheses, narrow and wide ranges, both kinds of rig.
#[test]
fn kernels_agree_on_many_hypotheses() {
    let right = HuePlane::from_rgb(&random_image(4), &GATE);
    for (seed, (near_m, far_m, tilt)) in [(0.48, 0.52, 0.3), (0.35, 0.65, 0.9), (0.1, 3.0, 1.2)].into_iter().enumerate()
    {
        for rig in rigs() {
            let pair = PinholePair::from_rig(&rig).expect("pair");
            let range = SearchRange::new(near_m, far_m, tilt).expect("range");
            let model = random_model(seed as u64, Vector2::new(150.0, 121.0), 40, (240, 79));
            let psis = random_hypotheses(seed as u64 + 40, &range, 4000);
            assert!(check_kernels(&pair, &model, &right, &range, &psis) > 1000, "few hypotheses are accepted");
        }
    }
}

/// Small enough for the interpreter Miri (`cargo xtask miri`), with points at the border of the image and outside it.
#[test]
fn kernels_agree_on_a_small_image() {
    const SMALL: ImageSize = ImageSize { width: 40, height: 30 };
    let right_rgb = RgbImage::from_fn(SMALL.width, SMALL.height, |x, y| Rgb([200, (x * 37 + y * 91) as u8, 40]));
    let right = HuePlane::from_rgb(&right_rgb, &GATE);
    let hue = Hue::from_degrees(30.0);
    let points = |step: usize| (0..30).step_by(step).map(|k| ModelPoint { u: k + 5, v: k % 30, hue }).collect();
    let model = PhotoModel::from_points(Vector2::new(20.2, 14.8), points(1), points(4));
    let range = SearchRange::new(0.3, 0.7, 0.4).expect("range");
    let psis = random_hypotheses(3, &range, 20);
    for rig in [scene::rectified_rig(SMALL), scene::general_rig(SMALL)] {
        let pair = PinholePair::from_rig(&rig).expect("pair");
        assert!(check_kernels(&pair, &model, &right, &range, &psis) > 10, "few hypotheses are accepted");
    }
}

/// Compares all kernels, in batches and one by one, mismatching and abstaining; returns the number of scored hypotheses.
fn check_kernels(
    pair: &PinholePair,
    model: &PhotoModel,
    right: &HuePlane,
    range: &SearchRange,
    psis: &[PlaneHypothesis],
) -> usize {
    let mut scored = 0;
    for unseen in [Unseen::Mismatch, Unseen::Abstain] {
        let config = FitnessConfig { unseen, ..FitnessConfig::default() };
        let mut expected = vec![0; psis.len()];
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let mut fitness = HueFitness::new(config, kernels).expect("config");
            let frame = fitness.prepare(pair, model, right, range).expect("frame");
            let mut scores = vec![7; psis.len()];
            frame.score(psis, &mut scores);
            if kernels.set() == pb3dp_estimation_core::cpu::KernelSet::Scalar {
                expected.clone_from(&scores);
                scored = scores.iter().filter(|score| **score != REFUSED).count();
            }
            assert!(scores == expected, "{} differs from scalar", kernels.set().name());
            let mut single = [0];
            frame.score(&psis[psis.len() - 1..], &mut single);
            assert_eq!(single[0], expected[psis.len() - 1], "the place in the batch matters");
        }
    }
    scored
}

/// A one-coloured right image.
fn plain(colour: [u8; 3]) -> HuePlane {
    HuePlane::from_rgb(&RgbImage::from_pixel(SIZE.width, SIZE.height, Rgb(colour)), &HueConfig::default())
}

/// A small model of one hue near the image's centre, which all hypotheses of the range keep inside the image.
fn plain_model(hue: Hue, inner: usize, outer: usize) -> PhotoModel {
    let point = |k: usize| ModelPoint { u: 190 + (k % 7) as i32, v: 110 + (k / 7) as i32, hue };
    PhotoModel::from_points(
        Vector2::new(193.0, 112.0),
        (0..inner).map(point).collect(),
        (0..outer).map(point).collect(),
    )
}

fn fitness_of(model: &PhotoModel, right: &HuePlane, config: FitnessConfig, psi: PlaneHypothesis) -> [f64; 2] {
    rigs().map(|rig| {
        let pair = PinholePair::from_rig(&rig).expect("pair");
        let mut fitness = HueFitness::new(config, Kernels::best()).expect("config");
        let frame = fitness.prepare(&pair, model, right, &range(0.5)).expect("frame");
        let mut score = [0];
        frame.score(&[psi], &mut score);
        frame.fitness(score[0]).expect("scored")
    })
}

const STRAIGHT: PlaneHypothesis = PlaneHypothesis { z_m: 0.5, theta_x_rad: 0.0, theta_y_rad: 0.0 };

fn check_threshold(colour: [u8; 3], matches: bool) {
    // 30 inner and 10 outer points; the model is pure red, hue 0.
    let model = plain_model(Hue::from_degrees(0.0), 30, 10);
    let expected = if matches { 1.0 } else { -(30.0 + 20.0) / (60.0 + 1.0) };
    for value in fitness_of(&model, &plain(colour), FitnessConfig::default(), STRAIGHT) {
        assert!((value - expected).abs() < 1e-12, "{colour:?}: F = {value}");
    }
}

#[test]
fn twenty_degrees_match_and_more_do_not() {
    check_threshold([255, 85, 0], true); // 20 degrees exactly
    check_threshold([255, 86, 0], false); // 20.2 degrees
    check_threshold([255, 0, 85], true); // -20 degrees: across the wrap
    check_threshold([255, 0, 86], false);
    check_threshold([128, 128, 128], false); // no hue
}

/// Two hues 20 degrees apart, whatever their rounding.
#[test]
fn the_tolerance_is_inclusive_at_every_hue() {
    let tolerance = f64::from(FitnessConfig::default().tolerance_steps()) * 360.0 / 65536.0;
    for tenth in 0..3600 {
        let (a, b) = (f64::from(tenth) / 10.0, f64::from(tenth) / 10.0 + 20.0);
        assert!(Hue::from_degrees(a).distance_deg(Hue::from_degrees(b)) <= tolerance, "{a}");
        assert!(Hue::from_degrees(a).distance_deg(Hue::from_degrees(b + 0.02)) > tolerance, "{a}");
    }
}

#[test]
fn mixed_votes_follow_equation_ten() {
    let mut inner = plain_model(Hue::from_degrees(0.0), 30, 0).inner().to_vec();
    inner.iter_mut().take(7).for_each(|p| p.hue = Hue::from_degrees(90.0));
    let mut outer = inner[10..25].to_vec();
    outer.iter_mut().take(4).for_each(|p| p.hue = Hue::from_degrees(200.0));
    let model = PhotoModel::from_points(Vector2::new(193.0, 112.0), inner, outer);
    let expected = (23.0 * 2.0 - 7.0 + 11.0 * 0.1 - 4.0 * 2.0) / (60.0 + 1.5);
    for value in fitness_of(&model, &plain([255, 0, 0]), FitnessConfig::default(), STRAIGHT) {
        assert!((value - expected).abs() < 1e-12, "F = {value}");
    }
}

#[test]
fn unseen_points_vote_as_configured() {
    // Near the left border: a disparity of 74 px puts columns 70 to 76 outside.
    let near_border = |hue| {
        let points = plain_model(hue, 21, 7);
        let moved =
            |points: &[ModelPoint]| points.iter().map(|p| ModelPoint { u: p.u - 170, ..*p }).collect::<Vec<_>>();
        PhotoModel::from_points(Vector2::new(23.0, 112.0), moved(points.inner()), moved(points.outer()))
    };
    let model = near_border(Hue::from_degrees(0.0));
    let right = plain([255, 0, 0]);
    let [mismatch, _] = fitness_of(&model, &right, FitnessConfig::default(), STRAIGHT);
    assert!((mismatch + (21.0 + 14.0) / (42.0 + 0.7)).abs() < 1e-12, "F = {mismatch}");
    let abstain = FitnessConfig { unseen: Unseen::Abstain, ..FitnessConfig::default() };
    assert_eq!(fitness_of(&model, &right, abstain, STRAIGHT)[0], 0.0);
    // Grey pixels count as unseen as well.
    let on_grey = fitness_of(&plain_model(Hue::from_degrees(0.0), 9, 0), &plain([90; 3]), abstain, STRAIGHT);
    assert_eq!(on_grey, [0.0, 0.0]);
}

#[test]
fn hypotheses_out_of_range_or_behind_are_refused() {
    let model = plain_model(Hue::from_degrees(0.0), 30, 0);
    let right = plain([255, 0, 0]);
    for rig in rigs() {
        let pair = PinholePair::from_rig(&rig).expect("pair");
        let mut fitness = HueFitness::new(FitnessConfig::default(), Kernels::best()).expect("config");
        let frame = fitness.prepare(&pair, &model, &right, &range(0.5)).expect("frame");
        let psis = [
            STRAIGHT,
            PlaneHypothesis { z_m: 0.7, ..STRAIGHT },
            PlaneHypothesis { theta_x_rad: 0.51, ..STRAIGHT },
            PlaneHypothesis { theta_y_rad: f64::NAN, ..STRAIGHT },
        ];
        let mut scores = [0; 4];
        frame.score(&psis, &mut scores);
        assert_eq!(scores, [frame.score_max(), REFUSED, REFUSED, REFUSED]);
        assert_eq!(frame.fitness(REFUSED), None);
        assert_eq!(frame.votes(&psis[2]), None);
    }
}

#[test]
fn points_beyond_the_horizon_refuse_the_hypothesis() {
    // A wide model: at 84 degrees of tilt its far side is beyond the plane's horizon.
    let hue = Hue::from_degrees(0.0);
    let inner = vec![ModelPoint { u: 20, v: 100, hue }, ModelPoint { u: 300, v: 100, hue }];
    let model = PhotoModel::from_points(Vector2::new(160.0, 100.0), inner, Vec::new());
    let right = plain([255, 0, 0]);
    for rig in rigs() {
        let pair = PinholePair::from_rig(&rig).expect("pair");
        let mut fitness = HueFitness::new(FitnessConfig::default(), Kernels::best()).expect("config");
        let range = SearchRange::new(0.2, 2.0, 1.48).expect("range");
        let frame = fitness.prepare(&pair, &model, &right, &range).expect("frame");
        let tilted = |theta_y_rad| PlaneHypothesis { z_m: 0.8, theta_x_rad: 0.0, theta_y_rad };
        assert!(frame.votes(&tilted(0.5)).is_some());
        assert!(frame.votes(&tilted(1.479)).is_none());
        assert!(frame.votes(&tilted(-1.479)).is_none());
    }
}

#[test]
fn wrong_inputs_are_refused_with_their_numbers() {
    let right = HuePlane::from_rgb(&RgbImage::new(300, 240), &HueConfig::default());
    let pair = PinholePair::from_rig(&scene::rectified_rig(SIZE)).expect("pair");
    let mut fitness = HueFitness::new(FitnessConfig::default(), Kernels::best()).expect("config");
    let model = plain_model(Hue::from_degrees(0.0), 3, 0);
    let error = fitness.prepare(&pair, &model, &right, &range(0.3)).expect_err("refused");
    assert!(error.to_string().contains("300x240") && error.to_string().contains("320x240"), "{error}");
    let right = plain([255, 0, 0]);
    let error = fitness.prepare(&pair, &PhotoModel::default(), &right, &range(0.3)).expect_err("refused");
    assert_eq!(error, EstimationError::EmptyModel { inner: 0, outer: 0 });
    let config = FitnessConfig { hue_tolerance_deg: 200.0, ..FitnessConfig::default() };
    assert!(HueFitness::new(config, Kernels::best()).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn kernels_agree_bit_for_bit(
        seed: u64, rectified: bool, near_m in 0.05..1.0, span_m in 0.001..2.0, tilt in 0.0..1.45,
        cu in 0.0..320.0, cv in 0.0..240.0, radius in 0..120, inner in 0usize..130, outer in 1usize..70,
    ) {
        let rig = if rectified { scene::rectified_rig(SIZE) } else { scene::general_rig(SIZE) };
        let pair = PinholePair::from_rig(&rig).expect("pair");
        let range = SearchRange::new(near_m, near_m + span_m, tilt).expect("range");
        let centre_px = Vector2::new(f64::min(cu, 319.0), f64::min(cv, 239.0));
        let model = random_model(seed, centre_px, radius, (inner, outer));
        let right = HuePlane::from_rgb(&random_image(seed ^ 5), &GATE);
        check_kernels(&pair, &model, &right, &range, &random_hypotheses(seed ^ 9, &range, 150));
    }

    /// Also at the corners of the search range, where shifts are largest.
    #[test]
    fn votes_are_those_of_the_paper_over_the_whole_range(
        seed: u64, near_m in 0.2..1.0, span_m in 0.001..1.0, tilt in 0.0..1.2,
        cu in 100.0..220.0, cv in 60.0..180.0, radius in 0..60,
    ) {
        let rig = scene::rectified_rig(SIZE);
        let pair = PinholePair::from_rig(&rig).expect("pair");
        let range = SearchRange::new(near_m, near_m + span_m, tilt).expect("range");
        let model = random_model(seed, Vector2::new(cu, cv), radius, (60, 20));
        let right_rgb = random_image(seed ^ 5);
        let right = HuePlane::from_rgb(&right_rgb, &GATE);
        let reference = naive(&rig, &right_rgb, &model);
        let mut fitness = HueFitness::new(FitnessConfig::default(), Kernels::best()).expect("config");
        let frame = fitness.prepare(&pair, &model, &right, &range).expect("frame");
        let mut psis = random_hypotheses(seed ^ 9, &range, 30);
        for (z_m, x, y) in [(range.z_min_m, tilt, tilt), (range.z_min_m, -tilt, tilt), (range.z_max_m, tilt, -tilt), (range.z_max_m, -tilt, -tilt)] {
            psis.push(PlaneHypothesis { z_m, theta_x_rad: x, theta_y_rad: y });
        }
        for psi in &psis {
            let Some(votes) = frame.votes(psi) else { continue };
            let [inner, outer] = reference.match_bounds(psi.z_m, psi.theta_x_rad, psi.theta_y_rad, 0.01);
            prop_assert!((inner.0..=inner.1).contains(&votes.inner_matches), "{:?} {:?} {:?}", votes, inner, psi);
            prop_assert!((outer.0..=outer.1).contains(&votes.outer_matches), "{:?} {:?} {:?}", votes, outer, psi);
        }
    }
}
