//! General calibrated pairs: every point is mapped by the homography of the hypothesis, with its own division.

use pb3dp_estimation_core::cpu::Kernels;

use super::batch::{Batch, Counts};
use super::kernels::{PlaneView, count_general};
use super::points::PointSet;

use crate::hue::{HuePlane, PAD};

/// Counts the matches of every hypothesis of a batch.
pub(super) fn count(
    kernels: Kernels,
    right: &HuePlane,
    tolerance: u16,
    sets: [&PointSet; 2],
    batch: &Batch,
    counts: &mut Counts,
) {
    let view = PlaneView {
        data: right.padded(),
        base: PAD as i32,
        width: right.width() as i32,
        height: right.height() as i32,
    };
    let [inner, outer] = sets;
    for lane in 0..batch.len {
        if batch.refused[lane] {
            continue;
        }
        let homography = &batch.homographies[lane];
        counts.inner[lane] = count_general(kernels, &view, tolerance, inner, homography);
        counts.outer[lane] = count_general(kernels, &view, tolerance, outer, homography);
    }
}
