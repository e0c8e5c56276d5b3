//! The published fitness: every model point votes on whether it finds its own hue in the right image (eqs (8) to (10)).
//!
//! ```text
//! inner: +2 if |H_M - H_I| <= 20 degrees, else -1         (8)
//! outer: +0.1 if |H_M - H_I| <= 20 degrees, else -2       (9)
//! F = (sum inner + sum outer) / (2 N_in + 0.1 N_out)      (10)
//! ```
//! Votes are counted in tenths, so every score is an exact integer. Pixel addresses are rounded to the nearest pixel: in fixed
//! point for rectified pairs, in single-precision IEEE arithmetic with a defined order for general ones. All kernels therefore
//! give bit-identical results; [`Kernels`] selects one.
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

mod batch;
mod general;
mod kernels;
mod points;
mod rectified;

use batch::{BATCH, Counts, Frame};
use points::PointSet;
use rectified::{MatchTable, Window};

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
    pub inner_seen: u32,
    /// Outer points on a pixel with a hue.
    pub outer_seen: u32,
}

/// Memory of the fitness, kept between frames: nothing is allocated after the largest frame.
#[derive(Clone, Debug)]
pub struct HueFitness {
    config: FitnessConfig,
    kernels: Kernels,
    inner: PointSet,
    outer: PointSet,
    matches: MatchTable,
    seen: MatchTable,
}

impl HueFitness {
    /// Creates a fitness with the given kernels; [`Kernels::best`] is the usual choice.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(config: FitnessConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        config.validate()?;
        Ok(Self {
            config,
            kernels,
            inner: PointSet::default(),
            outer: PointSet::default(),
            matches: MatchTable::default(),
            seen: MatchTable::default(),
        })
    }

    /// The parameters.
    pub fn config(&self) -> &FitnessConfig {
        &self.config
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
        let frame = Frame::new(pair, model, *range);
        self.inner.assign(inner, frame.origin());
        self.outer.assign(outer, frame.origin());
        let window = pair.is_rectified().then(|| Window::of(&frame, right.width()));
        if let Some(window) = &window {
            let sets = [&self.inner, &self.outer];
            self.matches.build(self.kernels, window, right, self.config.tolerance_steps(), sets);
            if self.config.unseen == Unseen::Abstain {
                self.seen.build(self.kernels, window, right, SEEN_TOLERANCE, sets);
            }
        }
        Ok(PreparedFitness { memory: self, frame, window, right })
    }
}

/// Every hue is within half a turn of every other: with this tolerance every pixel with a hue matches.
const SEEN_TOLERANCE: u16 = 0x8000;

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
    frame: Frame,
    /// `None` for a pair that is not rectified.
    window: Option<Window>,
    right: &'a HuePlane,
}

impl PreparedFitness<'_> {
    /// The first shift of the window, for rectified pairs.
    fn first_shift(&self) -> Option<i32> {
        self.window.as_ref().map(Window::first_shift)
    }

    /// `F` of eq. (10) from a score; `None` for a rejected hypothesis.
    pub fn fitness(&self, score: i32) -> Option<f64> {
        (score != REFUSED).then(|| f64::from(score) / f64::from(self.score_max()))
    }

    /// The score of `F = 1`: the denominator of eq. (10) in tenths.
    pub fn score_max(&self) -> i32 {
        20 * self.memory.inner.len() as i32 + self.memory.outer.len() as i32
    }

    /// The votes of one hypothesis; `None` if it is rejected. For reports and tests: it allocates, unlike
    /// [`PlaneScore::score`].
    pub fn votes(&self, psi: &PlaneHypothesis) -> Option<Votes> {
        let (mut matches, mut seen) = (Counts::default(), Counts::default());
        let batch = self.frame.batch(std::slice::from_ref(psi), self.first_shift());
        if batch.refused[0] {
            return None;
        }
        self.count(&batch, self.memory.config.tolerance_steps(), &self.memory.matches, &mut matches);
        let mut table = MatchTable::default();
        if let Some(window) = &self.window {
            table.build(
                self.memory.kernels,
                window,
                self.right,
                SEEN_TOLERANCE,
                [&self.memory.inner, &self.memory.outer],
            );
        }
        self.count(&batch, SEEN_TOLERANCE, &table, &mut seen);
        Some(Votes {
            inner_matches: matches.inner[0] as u32,
            outer_matches: matches.outer[0] as u32,
            inner_seen: seen.inner[0] as u32,
            outer_seen: seen.outer[0] as u32,
        })
    }

    fn count(&self, batch: &batch::Batch, tolerance: u16, table: &MatchTable, counts: &mut Counts) {
        let HueFitness { kernels, inner, outer, .. } = self.memory;
        if self.window.is_some() {
            rectified::count(*kernels, table, [inner, outer], batch, counts);
        } else {
            general::count(*kernels, self.right, tolerance, [inner, outer], batch, counts);
        }
    }

    /// Sum of all votes of eqs (8) and (9) in tenths.
    fn tenths(&self, matches: &Counts, seen: Option<&Counts>, lane: usize) -> i32 {
        let (inner_matches, outer_matches) = (matches.inner[lane], matches.outer[lane]);
        let (inner_voters, outer_voters) = match seen {
            Some(seen) => (seen.inner[lane], seen.outer[lane]),
            None => (self.memory.inner.len() as i32, self.memory.outer.len() as i32),
        };
        20 * inner_matches - 10 * (inner_voters - inner_matches) + outer_matches - 20 * (outer_voters - outer_matches)
    }
}

impl PlaneScore for PreparedFitness<'_> {
    fn score(&self, hypotheses: &[PlaneHypothesis], scores: &mut [i32]) {
        let (mut matches, mut seen) = (Counts::default(), Counts::default());
        for (hypotheses, scores) in hypotheses.chunks(BATCH).zip(scores.chunks_mut(BATCH)) {
            let batch = self.frame.batch(hypotheses, self.first_shift());
            self.count(&batch, self.memory.config.tolerance_steps(), &self.memory.matches, &mut matches);
            let abstain = self.memory.config.unseen == Unseen::Abstain;
            if abstain {
                self.count(&batch, SEEN_TOLERANCE, &self.memory.seen, &mut seen);
            }
            for (lane, score) in scores.iter_mut().enumerate().take(hypotheses.len()) {
                *score =
                    if batch.refused[lane] { REFUSED } else { self.tenths(&matches, abstain.then_some(&seen), lane) };
            }
        }
    }
}

#[cfg(test)]
mod tests;
