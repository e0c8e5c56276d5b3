//! The plane that the most patches lie on closely.
//!
//! Across a step of a few pixels a tilted plane may run through two surfaces: near to where it meets them patches support it,
//! and single pixels are too coarse to object. But a patch knows its shift to a tenth of a pixel, and between those places
//! its shift is off the plane. So planes are laid through the shifts of three patches each; where clearly more patches lie
//! closely on one of them than on the plane that was looked at, that one is the surface.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::rng::SplitMix64;

use super::fit::{PatchVotes, improve, weight_near};
use super::kernels::{PeakLimits, RowPeaks};

/// Patches that are asked, about. Chosen; no sweep is on record.
const PATCHES: usize = 600;
/// Patches lie closely on a plane if they are off it by clearly less than this, pixels of the level. Chosen; no sweep is on record.
const CLOSE_PX: f64 = 0.35;
/// Drawn planes are counted with this width first, pixels of the level. Chosen; no sweep is on record.
const DRAWN_PX: f64 = 0.5;
/// With this share of the patches' weight closely on the plane that was looked at there is no other. Chosen; no sweep is on record.
const DECISIVE_SHARE: f64 = 0.5;
/// Planes that are drawn. Chosen; no sweep is on record.
const DRAWS: usize = 24;
/// The best ones of these are improved. Chosen; no sweep is on record.
const IMPROVED: usize = 3;
/// Another plane has so many times as much weight close to it. Chosen; no sweep is on record.
const GAIN_MIN: f64 = 1.15;
/// And it is off by so much at a corner of what the patches cover, pixels of the level. Chosen; no sweep is on record.
const APART_PX: f64 = 1.0;

/// Patches with a shift of their own, and the weight of all.
#[derive(Clone, Debug, Default)]
pub(super) struct Sampled {
    votes: PatchVotes,
    all: f32,
    step: usize,
}

impl Sampled {
    /// Forgets all patches; of `area_px` pixels about [`PATCHES`] will be asked, those of one row and column in so many.
    pub(super) fn start(&mut self, area_px: usize, row_step: usize) {
        self.votes.clear();
        self.all = 0.0;
        let step = ((area_px / PATCHES) as f64).sqrt() as usize;
        self.step = step.next_multiple_of(row_step).max(row_step);
    }

    /// Whether patches of a row, counted from the first one, are asked.
    pub(super) fn takes_row(&self, row: usize) -> bool {
        row.is_multiple_of(self.step)
    }

    /// Takes patches of a row from pixel `(x, y)` on; those beyond the limits have no vote, but weight.
    pub(super) fn take_row(&mut self, x: usize, y: usize, inside: &[u8], peaks: RowPeaks<'_>, limits: PeakLimits) {
        let RowPeaks { offset, correlation, weight } = peaks;
        for i in (0..inside.len()).step_by(self.step).filter(|&i| inside[i] != 0 && weight[i] > 0.0) {
            self.all += weight[i];
            if offset[i].abs() <= limits.shift_px && correlation[i] >= limits.correlation {
                self.votes.push((x + i) as f32, y as f32, offset[i], weight[i]);
            }
        }
    }

    /// Shifts of a plane that clearly more patches lie closely on than on the one that was looked at, if there is one.
    pub(super) fn closest(&mut self, kernels: Kernels) -> Option<[f64; 3]> {
        let count = self.votes.len();
        if count < 3 {
            return None;
        }
        let mut rng = SplitMix64::new(0x5eed_0002);
        self.votes.pad();
        let zero = [0.0; 3];
        let (own, own_share) = self.improved(zero, kernels)?;
        let own_share = own_share.max(self.share(&zero, CLOSE_PX, kernels));
        if own_share >= DECISIVE_SHARE {
            return None;
        }
        let mut drawn = [(0.0, zero); IMPROVED];
        for _ in 0..DRAWS {
            let Some(plane) = self.votes.through(std::array::from_fn(|_| rng.below(count as u32) as usize)) else {
                continue;
            };
            let share = self.share(&plane, DRAWN_PX, kernels);
            if let Some(at) = drawn.iter().position(|(known, _)| share > *known) {
                drawn[at..].rotate_right(1);
                drawn[at] = (share, plane);
            }
        }
        let improved = drawn.iter().filter(|(share, _)| *share > 0.0).filter_map(|(_, p)| self.improved(*p, kernels));
        let (plane, share) = improved.max_by(|a, b| a.1.total_cmp(&b.1))?;
        (share > GAIN_MIN * own_share && self.votes.gap(&own, &plane) > APART_PX).then_some(plane)
    }

    fn share(&self, plane: &[f64; 3], width_px: f64, kernels: Kernels) -> f64 {
        weight_near(&self.votes, plane, width_px, kernels) / f64::from(self.all)
    }

    /// A plane put right by the patches near it, with the share of the weight that is close to it then.
    fn improved(&self, plane: [f64; 3], kernels: Kernels) -> Option<([f64; 3], f64)> {
        let mut plane = plane;
        for width_px in [2.0 * CLOSE_PX, 1.5 * CLOSE_PX, CLOSE_PX, CLOSE_PX] {
            plane = improve(&self.votes, &plane, width_px, kernels)?;
        }
        Some((plane, self.share(&plane, CLOSE_PX, kernels)))
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
        sampled.closest(Kernels::best())
    }

    /// The plane that was looked at meets the larger surface at its far end and then, behind a step, the smaller one.
    #[test]
    fn a_plane_that_bridges_a_step_is_told_from_the_surface() {
        let found = closest(|x| if x < 80.0 { 0.018 * (x - 10.0) } else { 0.0 }).unwrap();
        let off = [0.0, 79.0].map(|x| found[0] + found[1] * x - 0.018 * (x - 10.0));
        assert!(off.iter().all(|off| off.abs() < 0.1) && found[2].abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn one_plane_has_no_other() {
        assert_eq!(closest(|_| 0.0), None);
        assert_eq!(closest(|x| 0.002 * (x - 50.0)), None);
        // The larger of two surfaces was looked at, or all of a bent one.
        assert_eq!(closest(|x| if x < 60.0 { 0.0 } else { 1.4 }), None);
        assert_eq!(closest(|x| 3e-4 * (x - 50.0) * (x - 50.0) - 0.3), None);
        assert_eq!(closest(|_| 3.0), None);
    }
}
