//! Observability: peaks, ridges and flat landscapes, and what each says of the estimate.

use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_geometry::ranges::OutOfRange;

use super::survey::{Survey, candidates};
use super::*;
use crate::search::{PlaneScore, REFUSED};

/// A landscape given by a formula, so that the probe's result can be computed by hand.
#[derive(Clone, Copy)]
struct Formula(Shape);

impl PlaneScore for Formula {
    fn score(&self, hypotheses: &[PlaneHypothesis], scores: &mut [i32]) {
        for (psi, score) in hypotheses.iter().zip(scores) {
            let fitness = (self.0)(psi);
            *score = if fitness.is_nan() { REFUSED } else { (1000.0 * fitness).round() as i32 };
        }
    }

    fn score_max(&self) -> i32 {
        1000
    }
}

const ANSWER: PlaneHypothesis = PlaneHypothesis { z_m: 0.5, theta_x_rad: 0.1, theta_y_rad: -0.2 };

/// Depth in units of 1 % and tilts in units of 10 degrees, relative to the estimate.
fn offsets(psi: &PlaneHypothesis) -> (f64, f64, f64) {
    let tilt = |a: f64, b: f64| (a - b).to_degrees() / 10.0;
    (
        100.0 * (psi.z_m / ANSWER.z_m - 1.0),
        tilt(psi.theta_x_rad, ANSWER.theta_x_rad),
        tilt(psi.theta_y_rad, ANSWER.theta_y_rad),
    )
}

fn peak(psi: &PlaneHypothesis) -> f64 {
    let (z, x, y) = offsets(psi);
    0.9 - 0.1 * (z.abs() + 2.0 * x.abs() + 2.0 * y.abs()).min(8.0)
}

type Shape = fn(&PlaneHypothesis) -> f64;

/// The survey of a score of one shape in all six blocks.
fn survey_of(shape: Shape) -> Landscape {
    survey(&[shape; 6])
}

fn survey(blocks: &[Shape]) -> Landscape {
    let blocks: Vec<_> = blocks.iter().copied().map(Formula).collect();
    let survey = Survey {
        config: &ObservabilityConfig::default(),
        whole: &blocks[0],
        blocks: &blocks,
        answer: ANSWER,
        range: SearchRange::new(0.35, 0.8, 0.7).expect("a range"),
        focal_baseline_px_m: 74.0,
    };
    survey.landscape()
}

#[track_caller]
fn check(landscape: &Landscape, expected: Status) {
    let verdict = landscape.verdict(&ObservabilityConfig::default());
    assert_eq!(verdict.status, expected, "{} {landscape:?}", verdict.reason);
    assert!(!verdict.reason.is_empty());
}

#[test]
fn a_single_peak_on_which_all_blocks_agree_is_sure() {
    let landscape = survey_of(peak);
    assert!((landscape.fitness_highest - 0.9).abs() < 1e-9);
    assert!((landscape.fitness_median - 0.1).abs() < 1e-9, "most of the range is far away");
    assert!(landscape.spread.depth < 0.002 && landscape.spread.tilt_rad < 0.05, "{landscape:?}");
    check(&landscape, Status::Ok);
}

#[test]
fn a_flat_landscape_is_not_observable() {
    let landscape = survey_of(|_| 1.0);
    assert!(landscape.spread.depth > 0.1 && landscape.spread.tilt_rad > 0.4, "{landscape:?}");
    check(&landscape, Status::NotObservable);
}

#[test]
fn a_second_peak_far_away_is_ambiguous() {
    let landscape = survey_of(|psi| {
        let twin = PlaneHypothesis { z_m: psi.z_m - 0.1, ..*psi };
        peak(psi).max(peak(&twin) - 0.05)
    });
    let Found { psi, fitness } = landscape.runner_up.expect("far hypotheses");
    assert!((psi.z_m - 0.6).abs() < 0.01 && fitness > 0.8, "{landscape:?}");
    check(&landscape, Status::Ambiguous);
}

#[test]
fn a_ridge_along_one_tilt_leaves_the_tilt_weak() {
    let landscape = survey_of(|psi| {
        let (z, x, _) = offsets(psi);
        0.9 - 0.1 * (z.abs() + 2.0 * x.abs()).min(8.0)
    });
    assert!(landscape.spread.depth < 0.002 && landscape.spread.tilt_rad > 0.2, "{landscape:?}");
    check(&landscape, Status::WeakTilt);
}

#[test]
fn blocks_that_disagree_in_depth_make_the_answer_unsure() {
    // Half of the blocks have their maximum 2 % nearer, half 2 % farther: the maximum of each resample is in between.
    let near: Shape = |psi| peak(&PlaneHypothesis { z_m: psi.z_m + 0.01, ..*psi });
    let far: Shape = |psi| peak(&PlaneHypothesis { z_m: psi.z_m - 0.01, ..*psi });
    let landscape = survey(&[near, far, near, far, near, far]);
    assert!((0.01..0.03).contains(&landscape.spread.depth), "{landscape:?}");
    check(&landscape, Status::Ambiguous);
}

#[test]
fn refused_hypotheses_do_not_count() {
    let half: Shape = |psi| if psi.z_m > 0.55 { f64::NAN } else { peak(psi) };
    let (whole, cut) = (survey_of(peak), survey_of(half));
    assert!(cut.hypotheses < whole.hypotheses && cut.runner_up.expect("far hypotheses").psi.z_m <= 0.55);
    check(&cut, Status::Ok);
    let none = survey_of(|_| f64::NAN);
    assert_eq!(none.hypotheses, 0);
    check(&none, Status::NotObservable);
}

#[test]
fn candidates_are_the_best_and_an_even_selection_of_ties() {
    let numbered = |k: usize| PlaneHypothesis { z_m: k as f64, ..ANSWER };
    let best = candidates((0..1000).map(|k| (numbered(k), k as i32)).collect(), 100);
    assert_eq!(best, (900..1000).map(numbered).collect::<Vec<_>>());
    let ties = candidates((0..1000).map(|k| (numbered(k), 7)).collect(), 100);
    assert_eq!(ties.len(), 100);
    assert!(ties.windows(2).all(|pair| pair[1].z_m - pair[0].z_m == 10.0));
    assert_eq!(candidates((0..30).map(|k| (numbered(k), 7)).collect(), 100).len(), 30);
}

#[test]
fn bad_parameters_are_refused() {
    let bad = ObservabilityConfig { depth_spread_sure: -0.1, ..ObservabilityConfig::default() };
    let error = bad.validate().expect_err("negative");
    assert!(matches!(error, OutOfRange { name: "probe depth_spread_sure", .. }), "{error}");
}
