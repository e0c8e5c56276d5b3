//! The plane that the most patches fit closely.
//!
//! Across a step of a few pixels a tilted plane may cut through two surfaces. Patches near the intersections support it, and
//! single pixels are too coarse to contradict it. But each patch measures its shift to a tenth of a pixel, and between the
//! intersections this shift differs from the plane. Planes are therefore drawn through the shifts of three patches each; if
//! clearly more patches fit one of these planes closely than the evaluated plane, this plane is the surface.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::rng::SplitMix64;

use super::fit::{PatchVotes, improve, weight_near};
use super::kernels::{PeakLimits, RowPeaks};
use crate::surface_choice::SurfaceChoice;

/// Approximate number of sampled patches. Chosen by hand, not varied: a share of 600 independent patches is accurate to 2 %
/// (sqrt(0.25 / 600)); time grows with the number.
const PATCHES: usize = 600;
/// Number of drawn planes. Chosen by hand, not varied: of planes with half of the patches, 24 draws of three miss (7/8)^24
/// = 4 %.
const DRAWS: usize = 24;
/// Number of best drawn planes that are refined. Chosen by hand, not varied: time grows with it.
const IMPROVED: usize = 3;
/// Smallest number of pairs of patches that tell a relief from errors. Chosen by hand, not varied.
const PAIRS_MIN: f64 = 20.0;
/// Number of pairs that count as one. Derived: patches of 15 px that are sampled every 6 px overlap by 60 and 20 % with the next two in each
/// direction, and (1 + 2 0.6 + 2 0.2)^2 = 7; rounded up.
const DEPENDENT: f64 = 8.0;
/// Sampled patches with their shifts, and the total weight.
#[derive(Clone, Debug, Default)]
pub(super) struct Sampled {
    votes: PatchVotes,
    all: f32,
    step: usize,
    /// Shifts without their plane, by place in the grid; NaN without a vote.
    grid: Vec<f32>,
}

impl Sampled {
    /// Removes all patches. Of `area_px` pixels about [`PATCHES`] will be sampled, at regular rows and columns.
    pub(super) fn start(&mut self, area_px: usize, row_step: usize) {
        self.votes.clear();
        self.all = 0.0;
        let step = ((area_px / PATCHES) as f64).sqrt() as usize;
        self.step = step.next_multiple_of(row_step).max(row_step);
    }

    /// Whether patches of a row, counted from the first one, are sampled.
    pub(super) fn takes_row(&self, row: usize) -> bool {
        row.is_multiple_of(self.step)
    }

    /// Samples patches of a row from pixel `(x, y)` on; patches beyond the limits get no vote, but their weight counts.
    pub(super) fn take_row(&mut self, x: usize, y: usize, inside: &[u8], peaks: RowPeaks<'_>, limits: PeakLimits) {
        let RowPeaks { offset, correlation, weight } = peaks;
        for i in (0..inside.len()).step_by(self.step).filter(|&i| inside[i] != 0 && weight[i] > 0.0) {
            self.all += weight[i];
            if offset[i].abs() <= limits.shift_px && correlation[i] >= limits.correlation {
                self.votes.push((x + i) as f32, y as f32, offset[i], weight[i]);
            }
        }
    }

    /// Shifts of a plane that clearly more patches fit closely than the evaluated plane; `None` if there is none.
    pub(super) fn closest(&mut self, choice: &SurfaceChoice, kernels: Kernels) -> Option<[f64; 3]> {
        let count = self.votes.len();
        if count < 3 {
            return None;
        }
        let mut rng = SplitMix64::new(0x5eed_0002);
        self.votes.pad();
        let zero = [0.0; 3];
        let (own, own_share) = self.improved(zero, choice, kernels)?;
        let own_share = own_share.max(self.share(&zero, choice.close_px, kernels));
        if own_share >= choice.closest_decisive_share {
            return None;
        }
        let mut drawn = [(0.0, zero); IMPROVED];
        for _ in 0..DRAWS {
            let Some(plane) = self.votes.through(std::array::from_fn(|_| rng.below(count as u32) as usize)) else {
                continue;
            };
            let share = self.share(&plane, choice.drawn_px, kernels);
            if let Some(at) = drawn.iter().position(|(known, _)| share > *known) {
                drawn[at..].rotate_right(1);
                drawn[at] = (share, plane);
            }
        }
        let improved =
            drawn.iter().filter(|(share, _)| *share > 0.0).filter_map(|(_, p)| self.improved(*p, choice, kernels));
        let (plane, share) = improved.max_by(|a, b| a.1.total_cmp(&b.1))?;
        (share > choice.closest_gain_min * own_share && self.votes.gap(&own, &plane) > choice.closest_apart_px)
            .then_some(plane)
    }

    /// Root mean square of the relief: of what the shifts of patches without a common pixel, next to each other, have in common beyond
    /// their plane of least squares and beyond one standard deviation by chance. The errors of single patches have nothing in common.
    pub(super) fn relief_px(&mut self) -> f64 {
        let Some((columns, lag)) = self.votes.spread_over(self.step, super::SIDE, &mut self.grid) else { return 0.0 };
        let (mut product, mut square, mut pairs) = (0.0, 0.0, 0.0);
        for (i, &shift) in self.grid.iter().enumerate() {
            let right = if i % columns + lag < columns { self.grid.get(i + lag) } else { None };
            for &other in right.into_iter().chain(self.grid.get(i + lag * columns)) {
                // NaN without a vote.
                if (shift * other).is_finite() {
                    product += f64::from(shift * other);
                    square += f64::from(shift * shift + other * other) / 2.0;
                    pairs += 1.0;
                }
            }
        }
        if pairs < PAIRS_MIN {
            return 0.0;
        }
        let chance = square / pairs * (DEPENDENT / pairs).sqrt().min(1.0);
        (product / pairs - chance).max(0.0).sqrt()
    }

    fn share(&self, plane: &[f64; 3], width_px: f64, kernels: Kernels) -> f64 {
        weight_near(&self.votes, plane, width_px, kernels) / f64::from(self.all)
    }

    /// A plane refined on the patches near it, with the share of the weight that then fits it closely.
    fn improved(&self, plane: [f64; 3], choice: &SurfaceChoice, kernels: Kernels) -> Option<([f64; 3], f64)> {
        let mut plane = plane;
        for width_px in [2.0 * choice.close_px, 1.5 * choice.close_px, choice.close_px, choice.close_px] {
            plane = improve(&self.votes, &plane, width_px, kernels)?;
        }
        Some((plane, self.share(&plane, choice.close_px, kernels)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Patches of 100 x 60 pixels with these shifts, and noise of a tenth of a pixel.
    fn closest(shift: impl Fn(f32) -> f32) -> Option<[f64; 3]> {
        let mut sampled = Sampled::default();
        sampled.start(6000, 2);
        for y in (0..60).step_by(2).filter(|&y| sampled.takes_row(y)).collect::<Vec<_>>() {
            let noise = |x: usize| 0.1 * ((x * 7 + y * 13) as f32).sin();
            let offset = (0..100).map(|x| shift(x as f32) + noise(x)).collect::<Vec<_>>();
            let peaks = RowPeaks { offset: &offset, weight: &[1.0; 100], correlation: &[0.9; 100] };
            sampled.take_row(0, y, &[1; 100], peaks, PeakLimits { shift_px: 2.0, correlation: 0.5 });
        }
        sampled.closest(&SurfaceChoice::default(), Kernels::best())
    }

    fn relief_px(shift: impl Fn(f32, f32) -> f32) -> f64 {
        let mut sampled = Sampled::default();
        sampled.start(6000, 2);
        for y in (0..60).step_by(2).filter(|&y| sampled.takes_row(y)).collect::<Vec<_>>() {
            let offset = (0..100).map(|x| shift(x as f32, y as f32)).collect::<Vec<_>>();
            let peaks = RowPeaks { offset: &offset, weight: &[1.0; 100], correlation: &[0.9; 100] };
            sampled.take_row(3, y, &[1; 100], peaks, PeakLimits { shift_px: 2.0, correlation: 0.5 });
        }
        sampled.relief_px()
    }

    /// By hand: the rms of a parabola of height `h` about its mean is `h sqrt(4 / 45)`; patches 16 px apart see most of it in common.
    #[test]
    fn a_relief_is_distinguished_from_the_errors_of_patches() {
        let noise = |x: f32, y: f32| {
            let mut z = (x as u64 * 7919 + y as u64 * 104_729).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            ((z >> 40) as f32 / (1 << 24) as f32 - 0.5) * 12f32.sqrt()
        };
        let plane = |x: f32, y: f32| 0.4 + 0.006 * x - 0.004 * y;
        assert!(relief_px(|x, y| plane(x, y) + 0.3 * noise(x, y)) < 0.1);
        assert!(relief_px(plane) < 1e-6);
        let shell = |x: f32| ((x - 50.0) / 50.0).powi(2) - 0.5;
        let found = relief_px(|x, y| plane(x, y) + shell(x) + 0.1 * noise(x, y));
        assert!((0.15..0.3).contains(&found), "{found}");
        assert_eq!(relief_px(|_, _| 9.0), 0.0);
    }

    /// The evaluated plane meets the larger surface at its far end and, behind a step, the smaller one.
    #[test]
    fn a_plane_that_bridges_a_step_is_distinguished_from_the_surface() {
        let found = closest(|x| if x < 80.0 { 0.018 * (x - 10.0) } else { 0.0 }).unwrap();
        let off = [0.0, 79.0].map(|x| found[0] + found[1] * x - 0.018 * (x - 10.0));
        assert!(off.iter().all(|off| off.abs() < 0.1) && found[2].abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn one_plane_has_no_other() {
        assert_eq!(closest(|_| 0.0), None);
        assert_eq!(closest(|x| 0.002 * (x - 50.0)), None);
        // The larger of two surfaces was evaluated, or all of a curved one.
        assert_eq!(closest(|x| if x < 60.0 { 0.0 } else { 1.4 }), None);
        assert_eq!(closest(|x| 3e-4 * (x - 50.0) * (x - 50.0) - 0.3), None);
        assert_eq!(closest(|_| 3.0), None);
    }
}
