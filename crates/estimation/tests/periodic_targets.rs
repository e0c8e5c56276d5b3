//! Targets that repeat and move by about a period between two frames: a pose that is off by a period is not `ok`.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Pose, so3};

use crate::moving_plane::{plane, rectified_rig};
use crate::painted::{Paint, board, chessboard, grid, pair};

const FPS: f64 = 30.0;

/// A target that repeats.
#[derive(Clone, Copy)]
struct Repeating {
    name: &'static str,
    paint: Paint,
    /// Half of the region, metres.
    half_m: [f64; 2],
    /// The shortest period.
    period_m: f64,
}

const CHESSBOARD: Repeating =
    Repeating { name: "chessboard", paint: chessboard, half_m: [0.029, 0.029], period_m: 0.017 };
const GRID: Repeating = Repeating { name: "grid", paint: grid, half_m: [0.029, 0.029], period_m: 0.015 };
const BOARD: Repeating = Repeating { name: "board", paint: board, half_m: [0.047, 0.041], period_m: 0.017 };

/// Counts of tracked frames after the first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counts {
    frames: u32,
    ok: u32,
    /// `ok`, but off by a quarter of a period or more in the plane.
    wrong: u32,
    ambiguous: u32,
}

/// Tracks the target at positions in its plane, metres.
fn track(target: &Repeating, positions: &[Vector2<f64>]) -> Counts {
    let rig = rectified_rig();
    let at = |position: &Vector2<f64>| -> Pose<CamLeft, Target> {
        let first: Pose<CamLeft, Target> =
            Pose::from_parts(Vector3::new(0.01, -0.005, 0.45), so3::exp(&Vector3::new(0.12, -0.15, 0.05)));
        first * Pose::from_parts(Vector3::new(position.x, position.y, 0.0), so3::exp(&Vector3::zeros()))
    };
    let [x, y] = target.half_m;
    let corners = [(-x, -y), (x, -y), (x, y), (-x, y)].map(|(x, y)| {
        let corner = at(&positions[0]).transform_point(&Point3::new(x, y, 0.0));
        rig.left().project(&corner).expect("in front")
    });
    let region = Region::Polygon { vertices_px: corners.to_vec() };
    let mut tracker =
        DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
    let (mut counts, mut target_from_model) = (Counts::default(), None);
    for (frame, position) in positions.iter().enumerate() {
        let truth = at(position);
        let (left, right) = pair(&rig, &truth, target.paint, frame as u32);
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::default() };
        let estimate = match frame {
            0 => tracker.start_from_plane(&left, &right, &region, &plane(&truth)).expect("start"),
            _ => tracker.estimate(EstimateRequest::next_frame(&left, &right, &prior)).expect("update"),
        };
        let Some(found) = estimate.cam_left_from_model else { continue };
        let fixed = *target_from_model.get_or_insert(truth.inverse() * found);
        let error = ((truth * fixed).inverse() * found).translation_m();
        let is_ok = estimate.status == Status::Ok;
        let is_off = error.xy().norm() > 0.25 * target.period_m;
        if frame > 0 {
            counts.frames += 1;
            counts.ok += u32::from(is_ok);
            counts.wrong += u32::from(is_ok && is_off);
            counts.ambiguous += u32::from(estimate.status == Status::Ambiguous);
            // The doubt comes before what is well determined.
            let doubts = ["the texture repeats every", "found again where it was not expected"];
            let is_doubt_first = doubts.iter().any(|doubt| estimate.reason.starts_with(doubt));
            assert_eq!(estimate.status == Status::Ambiguous, is_doubt_first, "{}", estimate.reason);
        }
    }
    counts
}

/// Stands still, jumps in one of some directions, stands still, and jumps again; lengths in periods.
fn jumps(target: &Repeating, lengths: [f64; 2], directions: f64, seed: u64) -> Vec<Vector2<f64>> {
    let mut random = SplitMix64::new(seed);
    let mut position = Vector2::zeros();
    let mut positions = vec![position; 4];
    for _ in 0..2 {
        let length = lengths[0] + (lengths[1] - lengths[0]) * random.unit();
        let turn = std::f64::consts::TAU * (directions * random.unit()).floor() / directions;
        position += Vector2::new(turn.cos(), turn.sin()) * length * target.period_m;
        positions.extend([position; 3]);
    }
    positions
}

/// Steps at random from frame to frame, as of a target in snapshots.
fn snapshots(target: &Repeating, seed: u64) -> Vec<Vector2<f64>> {
    let mut random = SplitMix64::new(seed);
    let mut position: Vector2<f64> = Vector2::zeros();
    let mut positions = vec![position];
    for _ in 0..8 {
        let step = Vector2::new(random.unit() - 0.5, random.unit() - 0.5) * 3.0 * target.period_m;
        position = (position + step).map(|x| x.clamp(-0.04, 0.04));
        positions.push(position);
    }
    positions
}

/// Swings along a circle with a period of a second: up to half a period of the pattern per frame, but at a steady pace.
fn swing(radius_m: f64) -> Vec<Vector2<f64>> {
    let angle = |frame: u32| std::f64::consts::TAU * (f64::from(frame) / FPS).powi(2).min(4.0 * f64::from(frame) / FPS);
    (0..25).map(|frame| Vector2::new(angle(frame).cos() - 1.0, angle(frame).sin()) * radius_m).collect()
}

fn sum(
    target: &Repeating,
    seeds: std::ops::RangeInclusive<u64>,
    positions: impl Fn(u64) -> Vec<Vector2<f64>>,
) -> Counts {
    let mut all = Counts::default();
    for seed in seeds {
        let Counts { frames, ok, wrong, ambiguous } = track(target, &positions(seed));
        println!(
            "{}, seed {seed}: {frames} frames, {ok} ok, {wrong} of them wrong, {ambiguous} ambiguous",
            target.name
        );
        all = Counts {
            frames: all.frames + frames,
            ok: all.ok + ok,
            wrong: all.wrong + wrong,
            ambiguous: all.ambiguous + ambiguous,
        };
    }
    all
}

#[test]
fn a_board_that_jumps_by_about_a_period_is_found_where_it_is() {
    let jumped = sum(&BOARD, 1..=3, |seed| jumps(&BOARD, [0.33, 1.67], 8.0, seed));
    let stepped = sum(&BOARD, 1..=3, |seed| snapshots(&BOARD, seed));
    for Counts { frames, ok, wrong, .. } in [jumped, stepped] {
        assert_eq!(wrong, 0);
        assert!(10 * ok >= 7 * frames, "{ok} of {frames} are ok");
    }
}

#[test]
fn a_jump_by_most_of_a_period_is_in_doubt_where_nothing_tells() {
    let counts = sum(&GRID, 1..=4, |seed| jumps(&GRID, [0.82, 0.86], 4.0, seed));
    assert_eq!(counts.wrong, 0);
    assert!(counts.ambiguous >= 10, "{counts:?}");
}

#[test]
fn a_steady_motion_tells_the_periods_apart() {
    for target in [CHESSBOARD, GRID] {
        let counts = sum(&target, 1..=1, |_| swing(0.012));
        assert_eq!((counts.frames, counts.ok, counts.wrong), (24, 24, 0), "{}", target.name);
    }
}
