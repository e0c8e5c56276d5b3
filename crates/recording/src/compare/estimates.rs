//! Estimates and filtered poses of two runs.

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Frame, Model};
use pb3dp_record::metrics::{MotionErrors, Statistics, compare_motion};

use super::matching::{Matching, Stamp};
use super::recorded::{Estimate, Recorded, Step};
use crate::estimates::is_same_estimate;
use crate::exact::{of_pose_if_any, same_bits};

/// Angles below are rounding errors of a product of two rotations, radians: 45 units of the last place of 1.
const ROUNDING_RAD: f64 = 1e-14;

/// Entries of A and B that belong together, and those of them that differ.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Matched {
    /// The partners.
    pub matching: Matching,
    /// Number of partners that are not equal to the bit.
    pub differing: usize,
    /// The first of these: its numbers in A and B, and its time in A since the begin, seconds.
    pub first: Option<([u64; 2], f64)>,
}

impl Matched {
    /// Whether all entries have partners, which are equal to the bit.
    pub fn is_equal(&self) -> bool {
        self.differing == 0 && self.matching.alone == [0, 0]
    }
}

/// Distance and angle between two poses of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// Distance of the origins, millimetres.
    pub distance_mm: f64,
    /// Angle of the rotation from one to the other, degrees.
    pub angle_deg: f64,
}

/// Statistics of offsets.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OffsetStatistics {
    /// Distances, millimetres.
    pub distance_mm: Option<Statistics>,
    /// Angles, degrees.
    pub angle_deg: Option<Statistics>,
}

impl OffsetStatistics {
    fn of(offsets: impl Iterator<Item = Offset>) -> Self {
        let (distances, angles): (Vec<f64>, Vec<f64>) =
            offsets.map(|offset| (offset.distance_mm, offset.angle_deg)).unzip();
        Self { distance_mm: Statistics::of(&distances), angle_deg: Statistics::of(&angles) }
    }
}

/// Two estimates that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimatePair {
    /// Index in the estimates of A and of B.
    pub at: [usize; 2],
    /// Whether they are equal to the bit.
    pub is_equal: bool,
    /// Between the poses of the target in the left camera.
    pub offset: Option<Offset>,
    /// The same of the motions since the first common estimate of the target. Methods that place the model frame differently on the target
    /// have the same motion.
    pub moved: Option<Offset>,
    /// Error of the motion since the first common estimate against the true motion, for A and B.
    pub errors: [Option<Offset>; 2],
}

/// Estimates of two runs.
#[derive(Clone, Debug)]
pub struct EstimateComparison {
    /// Partners.
    pub matched: Matched,
    /// Partners with the same status.
    pub same_status: usize,
    /// Partners of which only A, only B has a pose.
    pub pose_in_one_only: [usize; 2],
    /// All partners.
    pub pairs: Vec<EstimatePair>,
    /// Statistics of [`EstimatePair::offset`].
    pub offset: OffsetStatistics,
    /// Statistics of [`EstimatePair::moved`].
    pub moved: OffsetStatistics,
    /// Statistics of [`EstimatePair::errors`].
    pub errors: [OffsetStatistics; 2],
    /// Wall time of the method, milliseconds, in A, in B, and the magnitude of the difference.
    pub latency_ms: [Option<Statistics>; 3],
}

/// Filtered poses of two runs.
#[derive(Clone, Debug)]
pub struct FilterComparison {
    /// Partners.
    pub matched: Matched,
    /// Partners of which only A, only B has a pose.
    pub pose_in_one_only: [usize; 2],
    /// Indices of both steps, and the offset between the poses of the target in the base.
    pub offsets: Vec<([usize; 2], Option<Offset>)>,
    /// Its statistics.
    pub offset: OffsetStatistics,
}

/// Compares the estimates.
pub fn compare_estimates(runs: [&Recorded; 2]) -> EstimateComparison {
    let [a, b] = runs.map(|run| &run.estimates[..]);
    let [stamps_a, stamps_b] = runs.map(Recorded::estimate_stamps);
    let matching = Matching::new([&stamps_a, &stamps_b]);
    let pair = |&[in_a, in_b]: &[usize; 2]| EstimatePair {
        at: [in_a, in_b],
        is_equal: is_same_estimate(&a[in_a].result, &b[in_b].result),
        offset: a[in_a].cam_left_from_model.zip(b[in_b].cam_left_from_model).map(|(a, b)| offset(&a, &b)),
        moved: None,
        errors: [None, None],
    };
    let mut pairs: Vec<EstimatePair> = matching.partners.iter().map(pair).collect();
    compare_motions(&mut pairs, [a, b]);
    let of_both = |pair: &EstimatePair| [&a[pair.at[0]], &b[pair.at[1]]];
    let differs = pairs.iter().filter(|pair| !pair.is_equal);
    let matched = Matched {
        differing: differs.clone().count(),
        first: differs.map(|pair| first(of_both(pair).map(|estimate| estimate.stamp))).next(),
        matching,
    };
    let latency = |pair: &EstimatePair| of_both(pair).map(|estimate| estimate.result.latency_millis);
    let latencies: Vec<[f64; 2]> = pairs.iter().map(latency).collect();
    let latency_ms = |pick: fn(&[f64; 2]) -> f64| Statistics::of(&latencies.iter().map(pick).collect::<Vec<_>>());
    let has_pose = pairs.iter().map(|pair| of_both(pair).map(|estimate| estimate.cam_left_from_model.is_some()));
    EstimateComparison {
        matched,
        same_status: pairs
            .iter()
            .filter(|pair| {
                let [a, b] = of_both(pair);
                a.result.status == b.result.status
            })
            .count(),
        pose_in_one_only: in_one_only(has_pose),
        offset: OffsetStatistics::of(pairs.iter().filter_map(|pair| pair.offset)),
        moved: OffsetStatistics::of(pairs.iter().filter_map(|pair| pair.moved)),
        errors: [0, 1].map(|run| OffsetStatistics::of(pairs.iter().filter_map(|pair| pair.errors[run]))),
        latency_ms: [
            latency_ms(|both| both[0]),
            latency_ms(|both| both[1]),
            latency_ms(|both| (both[1] - both[0]).abs()),
        ],
        pairs,
    }
}

/// Compares the filtered poses.
pub fn compare_filters(runs: [&Recorded; 2], matching: &Matching) -> FilterComparison {
    let [a, b] = runs.map(|run| &run.steps[..]);
    let bits = |step: &Step| of_pose_if_any(step.base_from_model.as_ref());
    let differs = matching.partners.iter().filter(|[in_a, in_b]| !same_bits(&bits(&a[*in_a]), &bits(&b[*in_b])));
    let (differing, first_at) = (differs.clone().count(), differs.clone().next());
    let first = first_at.map(|&[in_a, in_b]| first([a[in_a].stamp, b[in_b].stamp]));
    let poses = |&[in_a, in_b]: &[usize; 2]| [a[in_a].base_from_model, b[in_b].base_from_model];
    let pair = |at: &[usize; 2]| {
        let [a, b] = poses(at);
        (*at, a.zip(b).map(|(a, b)| offset(&a, &b)))
    };
    let offsets: Vec<_> = matching.partners.iter().map(pair).collect();
    FilterComparison {
        pose_in_one_only: in_one_only(matching.partners.iter().map(|at| poses(at).map(|pose| pose.is_some()))),
        offset: OffsetStatistics::of(offsets.iter().filter_map(|(_, offset)| *offset)),
        matched: Matched { matching: matching.clone(), differing, first },
        offsets,
    }
}

/// Numbers of both, and the time in A, seconds.
pub fn first([a, b]: [Stamp; 2]) -> ([u64; 2], f64) {
    ([a.number, b.number], a.t_s())
}

fn in_one_only(has: impl Iterator<Item = [bool; 2]>) -> [usize; 2] {
    has.fold([0, 0], |[a, b], has| match has {
        [true, false] => [a + 1, b],
        [false, true] => [a, b + 1],
        _ => [a, b],
    })
}

/// Between two poses of the same frame.
fn offset<A: Frame, B: Frame>(one: &Pose<A, B>, other: &Pose<A, B>) -> Offset {
    let distance_m = (one.translation_m() - other.translation_m()).norm();
    of_radians(distance_m, (one.inverse() * *other).rotation_angle_rad())
}

fn of_radians(distance_m: f64, angle_rad: f64) -> Offset {
    let angle_rad = if angle_rad < ROUNDING_RAD { 0.0 } else { angle_rad };
    Offset { distance_mm: distance_m * 1e3, angle_deg: angle_rad.to_degrees() }
}

/// Compares motions since the first common estimate. A target that is initialised again has a new model frame, and a new first estimate.
fn compare_motions(pairs: &mut [EstimatePair], [a, b]: [&[Estimate]; 2]) {
    let targets = |pair: &EstimatePair| [a[pair.at[0]].result.target, b[pair.at[1]].result.target];
    for same_targets in pairs.chunk_by_mut(|one, next| targets(one) == targets(next)) {
        let [poses_a, poses_b] = [0, 1].map(|run| {
            let of_pair = |pair: &EstimatePair| pair.offset.and([a, b][run][pair.at[run]].cam_left_from_model);
            same_targets.iter().map(of_pair).collect::<Vec<_>>()
        });
        let moved = motion_offsets(&poses_b, &poses_a);
        let errors = [(&poses_a, a), (&poses_b, b)].into_iter().enumerate().map(|(run, (poses, estimates))| {
            let truth = |pair: &EstimatePair| estimates[pair.at[run]].cam_left_from_target.map(|pose| pose.relabel());
            motion_offsets(poses, &same_targets.iter().map(truth).collect::<Vec<_>>())
        });
        let errors: Vec<Vec<Option<Offset>>> = errors.collect();
        for (index, pair) in same_targets.iter_mut().enumerate() {
            pair.moved = moved[index];
            pair.errors = [errors[0][index], errors[1][index]];
        }
    }
}

/// Errors of motions where both poses are known, at the origin of the reference's frame.
fn motion_offsets(
    estimated: &[Option<Pose<CamLeft, Model>>],
    reference: &[Option<Pose<CamLeft, Model>>],
) -> Vec<Option<Offset>> {
    let known: Vec<usize> =
        (0..estimated.len()).filter(|k| estimated[*k].is_some() && reference[*k].is_some()).collect();
    let known_estimated: Vec<_> = known.iter().map(|k| estimated[*k]).collect();
    let known_reference: Vec<_> = known.iter().filter_map(|k| reference[*k]).collect();
    let mut found = vec![None; estimated.len()];
    for (k, errors) in known.into_iter().zip(compare_motion(&known_estimated, &known_reference)) {
        found[k] =
            errors.map(|errors: MotionErrors| of_radians(errors.translation_m.norm(), errors.rotation_rad.norm()));
    }
    found
}
