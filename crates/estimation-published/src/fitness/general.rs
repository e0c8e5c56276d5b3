//! General calibrated pairs: every point goes through the hypothesis' homography, with a division of its own.

use super::batch::{Batch, Counts};
use super::points::{BLOCK, PointSet};
use super::scalar;
#[cfg(target_arch = "x86_64")]
use pb3dp_estimation_core::cpu::{KernelSet, Kernels};

use crate::hue::{HuePlane, PAD};

/// The right image as kernels read it. Pixel (u, v) is element `base + v width + u`; element 0 has no hue and stands for
/// everything outside.
#[derive(Clone, Copy)]
pub(super) struct PlaneView<'a> {
    pub data: &'a [u16],
    pub base: i32,
    pub width: i32,
    pub height: i32,
}

impl<'a> PlaneView<'a> {
    fn of(plane: &'a HuePlane) -> Self {
        let view =
            Self { data: plane.padded(), base: PAD as i32, width: plane.width() as i32, height: plane.height() as i32 };
        // The vector kernels read without further checks what lies inside these bounds.
        assert!(view.data.len() >= PAD + plane.width() * plane.height() && view.data.len() < i32::MAX as usize);
        view
    }
}

/// Addresses and pixels of a block of points, between the passes of a vector kernel: plain loads from computed addresses
/// are faster than the processor's gather instructions, and passes keep them apart from the vector loads of what they read.
pub(super) struct Scratch {
    /// Addresses of pixels: 0, or inside the image of the view they were made for.
    pub places: [i32; BLOCK],
    pub pixels: [u16; BLOCK],
}

impl Scratch {
    fn new() -> Self {
        Self { places: [0; BLOCK], pixels: [0; BLOCK] }
    }

    /// Reads the pixels at the first `count` places.
    ///
    /// # Safety
    /// Each of these places is 0 or `base + v width + u` of `view` with 0 <= u < width and 0 <= v < height.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub unsafe fn read(&mut self, view: &PlaneView<'_>, count: usize) {
        for (pixel, place) in self.pixels.iter_mut().zip(&self.places).take(count) {
            debug_assert!((*place as usize) < view.data.len());
            // SAFETY: the caller's promise; `PlaneView::of` has checked that the data is at least `base + width height` long.
            *pixel = unsafe { *view.data.get_unchecked(*place as usize) };
        }
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
    let mut scratch = Scratch::new();
    for lane in 0..batch.len {
        if batch.refused[lane] {
            continue;
        }
        let homography = &batch.homographies[lane];
        counts.inner[lane] = count_set(kernels, &view, tolerance, inner, homography, &mut scratch);
        counts.outer[lane] = count_set(kernels, &view, tolerance, outer, homography, &mut scratch);
    }
}

fn count_set(
    kernels: Kernels,
    view: &PlaneView<'_>,
    tolerance: u16,
    points: &PointSet,
    homography: &[f32; 8],
    scratch: &mut Scratch,
) -> i32 {
    match kernels.set() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Kernels` exists only for instruction sets that were detected on this processor.
        KernelSet::Avx2 => unsafe { super::avx2::count_general(view, tolerance, points, homography, scratch) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        KernelSet::Avx512 => unsafe { super::avx512::count_general(view, tolerance, points, homography, scratch) },
        _ => scalar::count_general(view, tolerance, points, homography),
    }
}
