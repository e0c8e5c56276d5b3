//! General calibrated pairs: every point is mapped by the homography of the hypothesis, with its own division.

use pb3dp_estimation_core::cpu::Kernels;

use super::batch::{Batch, Counts};
use super::kernels::count_general;
use super::points::PointSet;

use crate::hue::{HuePlane, PAD};

/// The right image as read by the kernels. Pixel (u, v) is element `base + v width + u`; element 0 has no hue and represents
/// everything outside the image.
#[derive(Clone, Copy)]
pub(super) struct PlaneView<'a> {
    pub data: &'a [u16],
    pub base: i32,
    pub width: i32,
    pub height: i32,
}

impl<'a> PlaneView<'a> {
    fn of(plane: &'a HuePlane) -> Self {
        Self { data: plane.padded(), base: PAD as i32, width: plane.width() as i32, height: plane.height() as i32 }
    }
}

/// Counts the matches of every hypothesis of a batch.
pub(super) fn count(
    kernels: Kernels,
    right: &HuePlane,
    tolerance: u16,
    sets: [&PointSet; 2],
    batch: &Batch,
    counts: &mut Counts,
) {
    let view = PlaneView::of(right);
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
