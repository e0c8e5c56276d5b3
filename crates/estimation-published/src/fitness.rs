//! The published fitness: every model point votes on whether it finds its own hue in the right image (eqs (8) to (10)).
//!
//! ```text
//! inner: +2 if |H_M - H_I| <= 20 degrees, else -1         (8)
//! outer: +0.1 if |H_M - H_I| <= 20 degrees, else -2       (9)
//! F = (sum inner + sum outer) / (2 N_in + 0.1 N_out)      (10)
//! ```
//! Votes are counted in tenths, so every score is an exact integer. Every point reads the pixel nearest to its projection: its
//! address is computed in fixed point for rectified pairs, in single-precision IEEE arithmetic with a defined order for general
//! ones. All kernels therefore give bit-identical results; [`Kernels`] selects one.
//!
//! [`HueFitness`] holds the memory. [`HueFitness::prepare`] loads one frame and returns a [`PreparedFitness`], which scores any
//! number of hypotheses from any number of threads.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, PlaneHypothesis, SearchRange};
use pb3dp_geometry::ranges;

use crate::hue::HuePlane;
use crate::photo_model::PhotoModel;
use crate::search::{PlaneScore, REFUSED};

mod kernel;
mod projection;

use kernel::{Points, count};
use projection::Projector;

/// Largest image side that the fixed-point addresses support, pixels.
const IMAGE_SIDE_MAX_PX: u32 = 8192;

/// Vote of a point outside the right image or on a pixel without hue. The paper does not define it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Unseen {
    /// Counts as a mismatch: a hypothesis gains nothing by moving points out of the image. The default.
    #[default]
    Mismatch,
    /// No vote; the normalisation of eq. (10) does not change.
    Abstain,
}

/// Parameters that the paper leaves open in eqs (8) to (10).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitnessConfig {
    /// Largest hue difference of a match, degrees of 360, 0 to 180. The paper's 20 has no unit; default 20 degrees. Hues are
    /// stored in steps of 0.011 degrees: a difference of up to the tolerance always matches, one larger by 0.02 degrees never
    /// does.
    pub hue_tolerance_deg: f64,
    /// Vote of points that are outside the image or on a pixel without hue.
    pub unseen: Unseen,
}

impl Default for FitnessConfig {
    fn default() -> Self {
        Self { hue_tolerance_deg: 20.0, unseen: Unseen::Mismatch }
    }
}

impl FitnessConfig {
    ranges! {
        pub fn validate "fitness ";
        hue_tolerance_deg, HUE_TOLERANCE_DEG: f64 = 0.0..=180.0;
    }

    /// The tolerance in steps of 1/65536 turn. Both hues are rounded to 1/32768 turn, so the tolerance includes one such step.
    fn tolerance_steps(&self) -> u16 {
        let half_steps = (self.hue_tolerance_deg / 360.0 * 32768.0 + 1.0).floor().clamp(0.0, 16384.0);
        (half_steps as u16) << 1
    }
}

/// The votes of one hypothesis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Votes {
    /// Inner points that match.
    pub inner_matches: u32,
    /// Outer points that match.
    pub outer_matches: u32,
    /// Inner points on a pixel with a hue.
    pub inner_visible: u32,
    /// Outer points on a pixel with a hue.
    pub outer_visible: u32,
}

/// Memory of the fitness, kept between frames: nothing is allocated after the largest frame.
#[derive(Clone, Debug)]
pub struct HueFitness {
    config: FitnessConfig,
    kernels: Kernels,
    inner: Points,
    outer: Points,
}

impl HueFitness {
    /// Creates a fitness with the given kernels; [`Kernels::best`] is the usual choice.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(config: FitnessConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        config.validate()?;
        Ok(Self { config, kernels, inner: Points::default(), outer: Points::default() })
    }

    /// Loads one frame: the model of the left image and the hues of the right image. Hypotheses outside `range` are rejected.
    ///
    /// # Errors
    /// A right image with a size other than the calibration's or larger than 8192 pixels, a model without points, or an invalid
    /// range.
    pub fn prepare<'a>(
        &'a mut self,
        pair: &PinholePair,
        model: &PhotoModel,
        right: &'a HuePlane,
        range: &SearchRange,
    ) -> Result<PreparedFitness<'a>, EstimationError> {
        range.validate()?;
        check_right_image(pair, right)?;
        let (inner, outer) = (model.inner(), model.outer());
        if inner.is_empty() && outer.is_empty() {
            return Err(EstimationError::EmptyModel { inner: inner.len(), outer: outer.len() });
        }
        let projector = Projector::new(pair, model, *range);
        self.inner.assign(inner, projector.origin());
        self.outer.assign(outer, projector.origin());
        Ok(PreparedFitness { memory: self, projector, right })
    }
}

fn check_right_image(pair: &PinholePair, right: &HuePlane) -> Result<(), EstimationError> {
    let expected = pair.right_size();
    if (right.width(), right.height()) != (expected.width as usize, expected.height as usize) {
        return Err(EstimationError::ImageSize {
            side: "right",
            width: right.width(),
            height: right.height(),
            expected_width: expected.width as usize,
            expected_height: expected.height as usize,
        });
    }
    for (name, side) in [
        ("right image width (px; scale larger images down)", expected.width),
        ("right image height (px; scale larger images down)", expected.height),
    ] {
        ranges::check_range(name, side, 1..=IMAGE_SIDE_MAX_PX)?;
    }
    Ok(())
}

/// The fitness of one frame.
#[derive(Clone, Debug)]
pub struct PreparedFitness<'a> {
    memory: &'a HueFitness,
    projector: Projector,
    right: &'a HuePlane,
}

impl PreparedFitness<'_> {
    /// `F` of eq. (10) from a score; `None` for a rejected hypothesis.
    pub fn fitness(&self, score: i32) -> Option<f64> {
        (score != REFUSED).then(|| f64::from(score) / f64::from(self.score_max()))
    }

    /// The votes of one hypothesis; `None` if it is rejected.
    pub fn votes(&self, psi: &PlaneHypothesis) -> Option<Votes> {
        let HueFitness { config, kernels, inner, outer } = self.memory;
        let projection = self.projector.projection(psi)?;
        let [inner, outer] =
            [inner, outer].map(|points| count(*kernels, self.right, config.tolerance_steps(), points, &projection));
        let ([inner_matches, inner_visible], [outer_matches, outer_visible]) = (inner, outer);
        Some(Votes { inner_matches, outer_matches, inner_visible, outer_visible })
    }

    /// Sum of all votes of eqs (8) and (9) in tenths.
    fn tenths(&self, votes: &Votes) -> i32 {
        let HueFitness { config, inner, outer, .. } = self.memory;
        let (inner_voters, outer_voters) = match config.unseen {
            Unseen::Mismatch => (inner.len() as i32, outer.len() as i32),
            Unseen::Abstain => (votes.inner_visible as i32, votes.outer_visible as i32),
        };
        let (inner_matches, outer_matches) = (votes.inner_matches as i32, votes.outer_matches as i32);
        20 * inner_matches - 10 * (inner_voters - inner_matches) + outer_matches - 20 * (outer_voters - outer_matches)
    }
}

impl PlaneScore for PreparedFitness<'_> {
    fn score(&self, hypotheses: &[PlaneHypothesis], scores: &mut [i32]) {
        for (psi, score) in hypotheses.iter().zip(scores) {
            *score = self.votes(psi).map_or(REFUSED, |votes| self.tenths(&votes));
        }
    }

    /// The score of `F = 1`: the denominator of eq. (10) in tenths.
    fn score_max(&self) -> i32 {
        20 * self.memory.inner.len() as i32 + self.memory.outer.len() as i32
    }
}

#[cfg(test)]
mod tests;
