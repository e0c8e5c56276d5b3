//! Relief from the first stereo pair.

use nalgebra::Vector3;
use pb3dp_estimation_core::wide::LANES;

use super::align::{Aligner, AlignmentPlan, Estimate, Problem, StartLevel};
use super::kernels::SHAPE;
use super::normal::Free;
use super::relief::patches_of;
use crate::kernels::Correlation;

/// Step between candidate offsets, pixels of disparity, and their range in standard deviations. Chosen by hand, not varied:
/// half of a pixel, and 7.5 px with the default relief; time grows with range over step.
const STEP_PX: f64 = 0.5;
const REACH_SIGMAS: f64 = 5.0;
/// Levels with points that contribute to the choice between candidates. Chosen by hand, not varied: coarser levels mix
/// neighbouring patches.
const LEVELS_USED: usize = 2;
/// Largest number of refinement rounds. Chosen: five ended 0.2 degrees from where more of them lead.
const ROUNDS: usize = 40;
/// Convergence limit of a round (root mean square over the patches), pixels. Chosen by hand, not varied: with more, plane and
/// relief stop earlier; with less, a start takes longer.
const MOVE_DONE_PX: f64 = 0.003;

/// Selects the relief among candidates, then refines plane and patches alternately. The pose is fixed, because it defines the
/// frame `model`.
pub(super) fn find(aligner: &mut Aligner, problem: &mut Problem<'_>, estimate: &mut Estimate, sigma_px: f64) {
    if sigma_px > 0.0 {
        choose(aligner, problem, estimate, sigma_px);
    } else {
        problem.surface.relief.hold_flat();
    }
    for _ in 0..ROUNDS {
        let Some(aligned) = aligner.align(
            problem,
            estimate,
            0..=0,
            AlignmentPlan { start: StartLevel::Coarsest, free: Free::Surface, steps_max: 1 },
            &mut || true,
        ) else {
            return;
        };
        let step: Vector3<f64> = aligned.last.unknowns.fixed_rows::<3>(SHAPE).into_owned();
        problem.surface.plane += step;
        problem.surface.rebuild();
        let Some(equations) = aligner.examine(problem, estimate, &estimate.variance, false) else { return };
        let Some(equations) = equations.inverse(&problem.prior(estimate), Free::Row) else { return };
        let surface = &mut *problem.surface;
        surface.restart_shape();
        surface.shape.read(&equations, &aligner.scores, surface.relief.inverse_depth_per_px());
        if !surface.shape.learn_all() {
            return;
        }
        surface.take_shape();
        if surface.shape.moved_px() < MOVE_DONE_PX {
            return;
        }
    }
}

fn choose(aligner: &mut Aligner, problem: &mut Problem<'_>, estimate: &Estimate, sigma_px: f64) {
    let count = (REACH_SIGMAS * sigma_px / STEP_PX).ceil() as i32;
    let candidates_px: Vec<f64> = (-count..=count).map(|i| f64::from(i) * STEP_PX).collect();
    let patches = problem.surface.relief.patches();
    let patch_of_lane: [Vec<usize>; LEVELS_USED] = std::array::from_fn(|level| {
        let places = problem.surface.levels[level].places.iter();
        let pixels = places.flat_map(|place| (0..LANES).map(move |i| place.pixel.map(|x| f64::from(x.0[i]))));
        patches_of(&problem.surface.relief, pixels)
    });
    let mut correlations = vec![vec![Correlation::default(); candidates_px.len()]; patches];
    for (index, &offset_px) in candidates_px.iter().enumerate() {
        problem.surface.relief.set_all(offset_px);
        problem.surface.rebuild();
        for level in 0..LEVELS_USED {
            if aligner.look(problem, estimate, level, &estimate.photometry()).is_none() {
                continue;
            }
            let weight = if level == 0 { 1.0 } else { 2.0 };
            let groups = aligner.sampled[level].iter().zip(&problem.view.levels[level]);
            for ((sampled, view), patch_of_lane) in groups.zip(patch_of_lane[level].chunks_exact(LANES)) {
                for (i, &patch) in patch_of_lane.iter().enumerate() {
                    if patch < patches && sampled[1].valid.0[i] * view.valid.0[i] > 0.0 {
                        let (kept, now) = (view.value.map(|v| v.0[i]), sampled[1].value.map(|v| v.0[i]));
                        correlations[patch][index].add(weight, kept, now);
                    }
                }
            }
        }
    }
    let costs: Vec<Vec<f64>> = correlations.iter().map(|patch| patch.iter().map(Correlation::cost).collect()).collect();
    problem.surface.relief.take_best(&candidates_px, &costs, sigma_px);
    problem.surface.rebuild();
}
