//! `NV12` images: rows of luminance, and half as many rows of chroma U, V, each for 2x2 pixels.

use super::yuyv::{Equations, YuvKernels, convert_row};

/// Converts rows, with reusable memory.
#[derive(Debug, Default)]
pub(super) struct Rows {
    /// A row as `YUYV`, for which there are vector kernels.
    yuyv: Vec<u8>,
}

impl Rows {
    /// Memory for rows of this width, in pixels.
    pub(super) fn new(width: u32) -> Self {
        Self { yuyv: vec![0; 4 * (width as usize).div_ceil(2)] }
    }

    /// Converts one row of luminance with its row of chroma: each pair of chroma is that of two pixels beside each other, as it is.
    pub(super) fn convert(
        &mut self,
        (luma, chroma): (&[u8], &[u8]),
        target: &mut [u8],
        equations: &Equations,
        kernels: YuvKernels,
    ) {
        let (pairs, odd) = luma.as_chunks::<2>();
        let (groups, chromas) = (self.yuyv.as_chunks_mut::<4>().0, chroma.as_chunks::<2>().0);
        for ((group, [first, second]), [u, v]) in groups.iter_mut().zip(pairs).zip(chromas) {
            *group = [*first, *u, *second, *v];
        }
        if let ([last], Some(group), Some([u, v])) = (odd, groups.last_mut(), chromas.last()) {
            *group = [*last, *u, *last, *v];
        }
        convert_row(&self.yuyv, target, equations, kernels);
    }
}
