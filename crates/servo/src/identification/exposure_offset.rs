//! Delay between the timestamps of images and their exposure, on the clock of the joints.

use nalgebra::{DMatrix, DVector, Vector3};
use pb3dp_geometry::frames::{Base, CamLeft, Flange, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{Chain, JointState};

use super::{BATCHES, Interval, NotIdentified, batch_of};
use crate::joint_history::JointHistory;

const WHAT: &str = "the time between timestamp and exposure";

/// Search range, seconds.
const OFFSET_MAX_S: f64 = 0.2;
/// Minimum number of observations in each piece of the record.
const OBSERVATIONS_MIN: usize = 24 * BATCHES;
/// The velocity of the hand is a central difference over this time to either side, seconds.
const DIFFERENCE_S: f64 = 5e-3;
/// Longest gap between joint samples for interpolation, seconds.
const GAP_MAX_S: f64 = 0.05;
/// Number of steps of the search, and its tolerance, seconds.
const STEPS_MAX: usize = 20;
const ARRIVED_S: f64 = 1e-7;
/// Regressors of the observed target position: constant, path of the hand and its velocity; the last one is common to all
/// directions.
const UNKNOWNS: usize = 3 + 9 + 1;

/// Geometry of the camera on the arm.
#[derive(Clone, Copy, Debug)]
pub struct CameraOnHand<'a> {
    /// The arm.
    pub chain: &'a Chain,
    /// Mounting of the hand.
    pub flange_from_hand: Pose<Flange, Hand>,
    /// Mounting of the left camera.
    pub hand_from_cam_left: Pose<Hand, CamLeft>,
}

/// One observation in `base`.
struct Row {
    at_s: f64,
    target_in_base_m: Vector3<f64>,
    camera_in_base_m: Vector3<f64>,
    /// Rate of the observed position with respect to the time of the joints, m/s.
    rate_m_per_s: Vector3<f64>,
}

/// Offset between the timestamps and the joints, seconds, for which a stationary target is stationary in `base`.
///
/// `poses` are timestamps and poses of the model in the left camera while the target is stationary and the hand moves; `joints`
/// are ordered by time. A part of the observed position that is proportional to the path of the hand and not to its velocity
/// (errors of mounting and scale) is estimated too and does not affect the result.
///
/// # Errors
/// If the record is too short, or the hand did not move.
pub fn exposure_offset(
    poses: &[(MonotonicTime, Pose<CamLeft, Model>)],
    joints: &[JointState],
    rig: &CameraOnHand<'_>,
) -> Result<Interval, NotIdentified> {
    let mut history = JointHistory::new(joints.len(), GAP_MAX_S);
    for sample in joints {
        history.push(*sample);
    }
    let mut offset_s = 0.0;
    for _ in 0..STEPS_MAX {
        let rows = rows(poses, &history, rig, offset_s);
        check_count(rows.len())?;
        let step_s = solve(rows.iter()).ok_or(NotIdentified::NotExcited { what: WHAT })?;
        offset_s += step_s;
        if !(-OFFSET_MAX_S..=OFFSET_MAX_S).contains(&offset_s) {
            return Err(NotIdentified::TooLong { what: WHAT, value_s: offset_s, most_s: OFFSET_MAX_S });
        }
        if step_s.abs() < ARRIVED_S {
            break;
        }
    }
    let rows = rows(poses, &history, rig, offset_s);
    check_count(rows.len())?;
    let span_s = (rows[0].at_s, rows[rows.len() - 1].at_s);
    let mut batches = [0.0; BATCHES];
    for (index, batch) in batches.iter_mut().enumerate() {
        let of_batch = || rows.iter().filter(|row| batch_of(row.at_s, span_s) == index);
        *batch = offset_s + solve(of_batch()).ok_or(NotIdentified::NotExcited { what: WHAT })?;
    }
    Ok(Interval::of_batches(offset_s, &batches))
}

fn check_count(count: usize) -> Result<(), NotIdentified> {
    let too_few = NotIdentified::TooFew { what: "observations with joint samples", count, needed: OBSERVATIONS_MIN };
    if count >= OBSERVATIONS_MIN { Ok(()) } else { Err(too_few) }
}

/// All observations with known joints.
fn rows(
    poses: &[(MonotonicTime, Pose<CamLeft, Model>)],
    history: &JointHistory,
    rig: &CameraOnHand<'_>,
    offset_s: f64,
) -> Vec<Row> {
    let base_from_cam_left = |at_s: f64| -> Option<Pose<Base, CamLeft>> {
        let position_rad = history.position_at(MonotonicTime::from_secs_f64(at_s)).ok()?;
        Some(rig.chain.forward(&position_rad) * rig.flange_from_hand * rig.hand_from_cam_left)
    };
    let row = |(at, cam_left_from_model): &(MonotonicTime, Pose<CamLeft, Model>)| {
        let at_s = at.as_secs_f64() + offset_s;
        let target_in_base = |at_s: f64| Some((base_from_cam_left(at_s)? * *cam_left_from_model).translation_m());
        let (before, after) = (target_in_base(at_s - DIFFERENCE_S)?, target_in_base(at_s + DIFFERENCE_S)?);
        Some(Row {
            at_s,
            target_in_base_m: target_in_base(at_s)?,
            camera_in_base_m: base_from_cam_left(at_s)?.translation_m(),
            rate_m_per_s: (after - before) / (2.0 * DIFFERENCE_S),
        })
    };
    poses.iter().filter_map(row).collect()
}

/// Remaining offset by least squares; `None` if the motion does not determine it.
fn solve<'a>(rows: impl Iterator<Item = &'a Row> + Clone) -> Option<f64> {
    let count = rows.clone().count();
    let mean = |of: fn(&Row) -> Vector3<f64>| rows.clone().map(of).sum::<Vector3<f64>>() / count.max(1) as f64;
    let (camera, target) = (mean(|row| row.camera_in_base_m), mean(|row| row.target_in_base_m));
    let mut matrix = DMatrix::zeros(3 * count, UNKNOWNS);
    let mut observed = DVector::zeros(3 * count);
    for (index, row) in rows.enumerate() {
        let way = row.camera_in_base_m - camera;
        for axis in 0..3 {
            let line = 3 * index + axis;
            matrix[(line, axis)] = 1.0;
            for other in 0..3 {
                matrix[(line, 3 + 3 * axis + other)] = way[other];
            }
            matrix[(line, UNKNOWNS - 1)] = -row.rate_m_per_s[axis];
            observed[line] = row.target_in_base_m[axis] - target[axis];
        }
    }
    scaled_least_squares(matrix, &observed)?.get(UNKNOWNS - 1).copied()
}

/// Least squares with normalised columns; directions without motion get zero. `None` if the last unknown has no motion.
fn scaled_least_squares(mut matrix: DMatrix<f64>, observed: &DVector<f64>) -> Option<DVector<f64>> {
    /// Share of the largest singular value: the hand moves in a plane, so some directions are zero.
    const EMPTY: f64 = 1e-6;
    let norms: Vec<f64> = matrix.column_iter().map(|column| column.norm()).collect();
    for (mut column, norm) in matrix.column_iter_mut().zip(&norms) {
        if *norm > 0.0 {
            column /= *norm;
        }
    }
    let last = norms.len() - 1;
    // A mean rate below 0.1 mm/s counts as no motion.
    if norms[last] < 1e-4 * (matrix.nrows() as f64).sqrt() {
        return None;
    }
    let mut solution = matrix.svd(true, true).solve(observed, EMPTY).ok()?;
    for (value, norm) in solution.iter_mut().zip(&norms) {
        if *norm > 0.0 {
            *value /= *norm;
        }
    }
    solution.iter().all(|value| value.is_finite()).then_some(solution)
}
