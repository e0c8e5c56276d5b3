//! A target whose texture repeats: whether it moved as found, or by a period more or less.
//!
//! An alignment of a chessboard that moved by a whole number of squares fits as well as one that did not. Two things tell them apart:
//! the images, if the outline of the board or a mark on it is part of the model, and the motion, if the found pose is far nearer to the
//! predicted one than the displaced poses are. If neither does, the pose may be off by a period, in this frame and in all later ones,
//! until the images tell.

use nalgebra::{Vector2, Vector3};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, so3};

use super::{Frame, Target, VARIANCE_SLACK};
use crate::align::{Aligner, AlignmentPlan, Problem, StartLevel};
use crate::judge::Fit;
use crate::normal::{Free, NormalEquations};
use crate::periods::{PeriodSearch, find};

/// A displaced pose is ruled out by the motion if it is this many times as far from the prediction as the found one, where the error of
/// the prediction is usual. Chosen: with half, a jump by two thirds of a period is taken for one by a third.
const FARTHER: f64 = 4.0;
/// The same where the error is unusual: a jerk, or the first frame. Jerks have no scale; if their density falls with the cube of their
/// length, one that is eight times as long, in any of four directions, is 100 times less likely.
const UNUSUALLY_FARTHER: f64 = 8.0;
/// Largest factor on both by frames without the target. Chosen: the chance that a jump by any distance ends that near to a whole number
/// of periods is 1 in 2000 on a chessboard.
const LOST_MAX: f64 = 10.0;
/// Half a period must be three times the usual error of the prediction.
const ERRORS_IN_A_PERIOD: f64 = 6.0;
/// An error of the prediction is usual if it is at most this many times the root mean square of the earlier ones, or this share of a
/// period. Then the displaced poses are not compared at all.
const USUAL_ERRORS: f64 = 4.0;
const USUAL_PHASE: f64 = 0.05;
/// Number of frames over which the usual error is averaged.
const ERROR_FRAMES: f64 = 20.0;
/// A fit is worse than another one if its quality is below this share. Chosen: equal fits of noisy chessboards differ by up to 4 %; a
/// twentieth of the points that shows something else is the least that is noticed.
pub(super) const WORSE: f64 = 0.9;
/// Largest number of periods by which a frame corrects the pose.
const HOPS_MAX: usize = 8;
/// Steps per level for a displaced pose, which starts within a pixel of its best fit.
const STEPS: usize = 3;
/// Margin of the windows beyond the longest period, pixels, and the largest margin.
const MARGIN_PX: f64 = 16.0;
const MARGIN_MAX_PX: f64 = 120.0;

/// Largest number of each of two periods in a displacement. Chosen by hand, not varied: a board of 9 squares has no more.
const PERIODS_MAX: i32 = 8;
/// Largest distance from a whole number of periods, shortest periods. Chosen by hand, not varied: an alignment ends nearer.
const OFF_PERIOD: f64 = 0.15;

/// Whether a displacement is a sum of whole numbers of up to two periods.
fn is_sum_of(shifts_m: &[Vector2<f64>], displacement_m: &Vector3<f64>) -> bool {
    let zero = Vector2::zeros();
    let (first, second) = (shifts_m.first().unwrap_or(&zero), shifts_m.get(1).unwrap_or(&zero));
    let Some(shortest_m) = shifts_m.iter().map(|shift| shift.norm()).reduce(f64::min) else { return false };
    let numbers = || (-PERIODS_MAX..=PERIODS_MAX).map(f64::from);
    numbers()
        .flat_map(|i| numbers().map(move |j| first * i + second * j))
        .any(|sum| (displacement_m - Vector3::new(sum.x, sum.y, 0.0)).norm() <= OFF_PERIOD * shortest_m)
}

/// What is known about the periods of a target.
#[derive(Clone, Debug)]
pub(super) struct Periodic {
    /// The shortest periods, metres along x and y of `model`.
    shifts_m: Vec<Vector2<f64>>,
    /// Aligns displaced poses, so that the buffers of the found one stay.
    rival: Aligner,
    /// Mean squared error of the prediction, periods, and the number of frames in it.
    squared_error: f64,
    frames: f64,
    /// Whether the pose may be off by a period.
    in_doubt: bool,
    /// Whether an earlier frame had no time to compare the poses.
    is_open: bool,
}

/// Result of the comparison with the displaced poses.
enum Compared {
    /// All others fit worse.
    Alone,
    /// Another one may be the target.
    Alike,
    /// Another one is the target.
    Other(Pose<CamLeft, Model>),
}

impl Periodic {
    /// Largest component of a displacement along a period, periods.
    fn phase(&self, in_plane: &Vector2<f64>) -> f64 {
        self.shifts_m.iter().map(|shift| in_plane.dot(shift).abs() / shift.norm_squared()).fold(0.0, f64::max)
    }

    /// Whether an error of the prediction is as usual, so that nothing needs to be compared.
    fn is_usual(&self, phase: f64) -> bool {
        phase <= (USUAL_ERRORS * self.squared_error.sqrt()).max(USUAL_PHASE)
    }

    /// Whether the motion tells the found pose from displaced ones, after this many frames without the target.
    fn is_determined(&self, phase: f64, lost_frames: f64) -> bool {
        let farther = if self.is_usual(phase) { FARTHER } else { UNUSUALLY_FARTHER };
        let farther = farther * (1.0 + lost_frames).min(LOST_MAX);
        (1.0 + farther) * phase <= 1.0 && ERRORS_IN_A_PERIOD * self.squared_error.sqrt() <= 1.0
    }

    fn learn(&mut self, phase: f64) {
        self.frames = (self.frames + 1.0).min(ERROR_FRAMES);
        self.squared_error += (phase * phase - self.squared_error) / self.frames;
    }
}

impl Target {
    /// Looks for periods in the first left image, which is loaded as a whole.
    pub(crate) fn find_periods(&mut self, frame: &Frame<'_>, region: &RegionMask) {
        let shifts_m = find(&PeriodSearch {
            left: &frame.images[0],
            region,
            camera: frame.rig.left(),
            cam_left_from_model: &self.estimate.cam_left_from_model,
        });
        self.periodic = (!shifts_m.is_empty()).then(|| {
            let rival = self.aligner.another(&self.surface);
            Box::new(Periodic { shifts_m, rival, squared_error: 0.0, frames: 0.0, in_doubt: false, is_open: false })
        });
    }

    /// The shortest period, if the pose may be off by one, metres.
    pub(crate) fn doubtful_period_m(&self) -> Option<f64> {
        let periodic = self.periodic.as_ref().filter(|periodic| periodic.in_doubt)?;
        periodic.shifts_m.iter().map(|shift| shift.norm()).reduce(f64::min)
    }

    /// Whether the estimate is the target at `own`, displaced by some of its periods.
    pub(crate) fn is_copy_of(&self, own: &Pose<CamLeft, Model>) -> bool {
        let apart = (own.inverse() * self.estimate.cam_left_from_model).translation_m();
        self.periodic.as_ref().is_some_and(|periodic| is_sum_of(&periodic.shifts_m, &apart))
    }

    /// The margin that displaced poses need around the predicted target, pixels.
    pub(crate) fn margin_of_periods_px(&self, frame_fx: f64) -> u32 {
        let Some(periodic) = &self.periodic else { return 0 };
        let longest_m = periodic.shifts_m.iter().map(|shift| shift.norm()).fold(0.0, f64::max);
        let z_m = self.estimate.cam_left_from_model.translation_m().z.max(1e-3);
        (longest_m * frame_fx / z_m + MARGIN_PX).min(MARGIN_MAX_PX) as u32
    }

    /// Whether the pose may be off by a period.
    pub(super) fn in_doubt(&self) -> bool {
        self.periodic.as_ref().is_some_and(|periodic| periodic.in_doubt)
    }

    /// Compares the found pose with those displaced by a period. `lost_frames`: number of frames without it. Returns the
    /// equations at the pose that is the target, or may be it.
    pub(super) fn settle(
        &mut self,
        mut equations: NormalEquations,
        predicted: &Pose<CamLeft, Model>,
        lost_frames: f64,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> NormalEquations {
        let Some(mut periodic) = self.periodic.take() else { return equations };
        for hop in 0..=HOPS_MAX {
            let phase = periodic.phase(&self.in_plane(predicted));
            let is_determined = !periodic.in_doubt && !periodic.is_open && periodic.is_determined(phase, lost_frames);
            if is_determined && periodic.is_usual(phase) {
                break;
            }
            if hop == HOPS_MAX || !may_continue() {
                periodic.is_open |= !is_determined;
                break;
            }
            let own = self.estimate.cam_left_from_model;
            match self.compare(&mut periodic, predicted, lost_frames, frame, may_continue) {
                Compared::Alone => {
                    periodic.is_open = !may_continue() && !is_determined;
                    periodic.in_doubt &= periodic.is_open || !self.fits_well();
                    break;
                }
                Compared::Alike => {
                    (periodic.in_doubt, periodic.is_open) = (true, false);
                    break;
                }
                Compared::Other(other) => {
                    let (found, is_there) = self.moved_to(&other, &own, frame, may_continue);
                    equations = found.unwrap_or(equations);
                    if !is_there {
                        periodic.in_doubt = true;
                        break;
                    }
                }
            }
        }
        periodic.learn(periodic.phase(&self.in_plane(predicted)).min(1.0));
        self.periodic = Some(periodic);
        equations
    }

    /// Aligns at a displaced pose, or again at the own one if that fails. The equations there, and whether it is the displaced one.
    fn moved_to(
        &mut self,
        other: &Pose<CamLeft, Model>,
        own: &Pose<CamLeft, Model>,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> (Option<NormalEquations>, bool) {
        let found = self.attempt(other, StartLevel::Resembling, frame, may_continue);
        if found.is_some() && self.fit.misfit(&self.limits(frame.config)).is_none() {
            return (found, true);
        }
        (self.attempt(own, StartLevel::Resembling, frame, may_continue), false)
    }

    /// Displacement of the found pose from the predicted one in the plane of the model, metres.
    fn in_plane(&self, predicted: &Pose<CamLeft, Model>) -> Vector2<f64> {
        (predicted.inverse() * self.estimate.cam_left_from_model).translation_m().xy()
    }

    fn compare(
        &mut self,
        periodic: &mut Periodic,
        predicted: &Pose<CamLeft, Model>,
        lost_frames: f64,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Compared {
        let own = self.estimate.cam_left_from_model;
        let (apart, quality) = (self.in_plane(predicted), self.fit.goodness().max(1e-9));
        let has_doubt = periodic.in_doubt || periodic.is_open;
        let is_determined = !has_doubt && periodic.is_determined(periodic.phase(&apart), lost_frames);
        let limits = self.limits(frame.config);
        let (mut is_alike, mut nearer, mut best) = (false, None, None::<(f64, Pose<CamLeft, Model>)>);
        for index in 0..2 * periodic.shifts_m.len() {
            let shift = periodic.shifts_m[index / 2] * if index % 2 == 0 { 1.0 } else { -1.0 };
            let displaced = own * Pose::from_parts(Vector3::new(shift.x, shift.y, 0.0), so3::exp(&Vector3::zeros()));
            let Some((fit, pose)) = self.fit_at(&mut periodic.rival, &displaced, frame, may_continue) else { continue };
            let ratio = fit.goodness() / quality;
            // An alignment that slides back to the found pose tells nothing.
            let reached = (own.inverse() * pose).translation_m().xy().dot(&shift);
            if reached < 0.5 * shift.norm_squared() || fit.misfit(&limits).is_some() || ratio < WORSE {
                continue;
            }
            let is_better = ratio * WORSE > 1.0;
            if is_determined {
                is_alike |= is_better;
            } else if is_better {
                if best.is_none_or(|(other, _)| ratio > other) {
                    best = Some((ratio, pose));
                }
            } else if !has_doubt && periodic.is_determined(periodic.phase(&(apart + shift)), lost_frames) {
                nearer = Some(pose);
            } else {
                is_alike = true;
            }
        }
        match best.map(|(_, pose)| pose).or(nearer) {
            Some(pose) => Compared::Other(pose),
            None if is_alike => Compared::Alike,
            None => Compared::Alone,
        }
    }

    /// Fit at a displaced pose after a few steps, and the pose reached; `None` if too little of the target is visible there.
    fn fit_at(
        &mut self,
        rival: &mut Aligner,
        pose: &Pose<CamLeft, Model>,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<(Fit, Pose<CamLeft, Model>)> {
        let mut estimate = self.estimate;
        estimate.cam_left_from_model = *pose;
        let points = self.surface.points() as f64;
        let most = self.reference.map(|term| term.map(|v| v * VARIANCE_SLACK));
        let Self { surface, views, view, knowledge, .. } = self;
        let mut problem = Problem { surface, view: &views[*view], images: frame.images, rig: frame.rig, knowledge };
        let plan = AlignmentPlan { start: StartLevel::Coarsest, free: Free::Motion, steps_max: STEPS };
        rival.align(&mut problem, &mut estimate, 0..=1, plan, may_continue)?;
        rival.examine(&problem, &estimate, &most, false)?;
        let view = &self.views[self.view].levels[0];
        let correlations = rival.correlate(view);
        let fit = Fit::measure(&rival.sampled[0], view, &rival.residuals, &correlations, points, &self.reference);
        Some((fit, estimate.cam_left_from_model))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_displacement_is_a_whole_number_of_periods_or_not() {
        let shifts_m = [Vector2::new(0.02, 0.001), Vector2::new(-0.001, 0.03)];
        let sums = [(1.0, 0.0, true), (-2.0, 3.0, true), (0.5, 0.0, false), (1.1, 1.0, true), (1.0, 0.8, false)];
        for (i, j, expected) in sums {
            let at = shifts_m[0] * i + shifts_m[1] * j;
            assert_eq!(is_sum_of(&shifts_m, &Vector3::new(at.x, at.y, 0.0)), expected, "{i}, {j}");
        }
        assert!(!is_sum_of(&shifts_m, &Vector3::new(0.02, 0.001, 0.01)), "nearer to the camera");
        assert!(!is_sum_of(&[], &Vector3::zeros()) && is_sum_of(&shifts_m[..1], &Vector3::new(0.04, 0.002, 0.0)));
    }
}
