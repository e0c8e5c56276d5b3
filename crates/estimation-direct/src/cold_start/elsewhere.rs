//! Other depths that explain the region: beyond the searched range, and copies inside and outside of it.

use pb3dp_estimation_views::disparity_plane::DisparityPlane;
use pb3dp_estimation_views::front_end::StereoFrontEnd;
use pb3dp_estimation_views::region_pyramid::PyramidSource;

use super::{ColdStart, ColdStartConfig};
use crate::beyond::{BeyondRange, Examined, is_doubtful};
use crate::outcome::{ColdStartOutcome, support_of};

/// Shortest period of a texture whose repetition may explain the region at another depth, pixels. Chosen by hand, not varied: noise that was
/// filtered correlates over two pixels.
const PERIOD_MIN_PX: f64 = 3.0;

/// A plane at another depth explains the region as well with this share of the score of the answer. Chosen with figures: of 420 rendered rows of
/// identical parts and fences none is `ok` and wrong, and of 227 real cases that were `ok` one is not any more.
pub const COPY_SCORE_MIN: f64 = 0.86;

impl ColdStart {
    /// The best plane beyond the searched disparities, if the result for the last pair is doubtful and the right image shows
    /// such a plane. The other arguments are those of [`Self::run`].
    pub fn look_beyond(
        &mut self,
        outcome: &ColdStartOutcome,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        is_tilt_allowed: impl Fn(&DisparityPlane) -> bool,
    ) -> Option<BeyondRange> {
        if !is_doubtful(outcome, &self.config.choice) {
            return None;
        }
        self.beyond.best(
            front_end,
            source,
            &outcome.first.plane,
            &self.config.search,
            &self.config.patches,
            &self.config.choice,
            is_tilt_allowed,
            self.kernels,
        )
    }

    /// The planes at other depths that explain the region as well as the result for the last pair on the finest level, with the score of each
    /// relative to it.
    pub fn look_elsewhere(
        &mut self,
        outcome: &ColdStartOutcome,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
    ) -> Vec<BeyondRange> {
        let own = support_of(&outcome.finest) * outcome.finest.mean_correlation;
        let infinity_px = front_end.geometry().disparity_offset_px;
        let index = self.finest_level();
        let period_px = self.period_px(index, &outcome.patch_plane, PERIOD_MIN_PX, infinity_px);
        let ColdStartConfig { patches, choice, patch_area_px, .. } = &self.config;
        let limits = Examined { patches, choice, patch_area_px: *patch_area_px };
        let answer = (&outcome.patch_plane, period_px);
        let mut copies = self.beyond.copies(front_end, source, answer, &limits, self.kernels);
        copies.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut found: Vec<BeyondRange> = Vec::new();
        for (plane, score) in copies {
            let score_ratio = score / own.max(1e-9);
            let differs = |known: &DisparityPlane| self.differs_on(index, known, &plane);
            let is_new = differs(&outcome.patch_plane) && found.iter().all(|other| differs(&other.plane));
            if is_new && score_ratio > COPY_SCORE_MIN {
                found.push(BeyondRange { plane, score_ratio });
            }
        }
        found
    }
}
