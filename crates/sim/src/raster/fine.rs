//! Images sampled finer than their pixels.

use pb3dp_geometry::{Camera, Pinhole};

use super::RenderError;
use super::view::View;
use super::visibility::Visibility;
use crate::sensor::spread;

/// Samples per pixel along either axis.
const FINE: usize = 2;

/// The view of a camera with more and smaller pixels, and its visible surfaces.
#[derive(Clone, Debug)]
pub(crate) struct Fine {
    view: View,
    visibility: Visibility,
    light: Vec<u16>,
}

impl Fine {
    /// # Errors
    /// A camera with a pixel that has no ray; the error contains `side`.
    pub(crate) fn new(side: &'static str, camera: &Camera) -> Result<Self, RenderError> {
        let view = finer(camera).and_then(|camera| View::new(&camera));
        let view = view.map_err(|source| RenderError::Camera { side, source })?;
        let pixels = view.width * view.height;
        Ok(Self { view, visibility: Visibility::new(pixels), light: vec![0; 3 * pixels] })
    }

    /// The view, its visible surfaces, and the light on its samples.
    pub(crate) fn parts(&mut self) -> (&View, &mut Visibility, &mut [u16]) {
        (&self.view, &mut self.visibility, &mut self.light)
    }

    /// Blurs the light by a standard deviation in whole pixels, and averages the samples of each pixel.
    pub(crate) fn integrate(&mut self, blur_px: f64, pixels: &mut [u16]) {
        let stride = 3 * self.view.width;
        spread(&mut self.light, stride, blur_px * FINE as f64);
        for (rows, out) in self.light.chunks_exact(2 * stride).zip(pixels.chunks_exact_mut(stride / FINE)) {
            let (upper, lower) = rows.split_at(stride);
            let samples = upper.chunks_exact(6).zip(lower.chunks_exact(6));
            for ((upper, lower), pixel) in samples.zip(out.chunks_exact_mut(3)) {
                for channel in 0..3 {
                    let sum = [upper[channel], upper[channel + 3], lower[channel], lower[channel + 3]];
                    pixel[channel] = ((sum.map(u32::from).iter().sum::<u32>() + 2) / 4) as u16;
                }
            }
        }
    }
}

/// The same camera with more pixels. Pixel centres are at integers, so the first sample of pixel 0 lies at -1/4.
fn finer(camera: &Camera) -> Result<Camera, pb3dp_geometry::CameraError> {
    let (scale, shift) = (FINE as f64, (FINE as f64 - 1.0) / 2.0);
    let coarse = camera.pinhole();
    let pinhole = Pinhole {
        fx: scale * coarse.fx,
        fy: scale * coarse.fy,
        cx: scale * coarse.cx + shift,
        cy: scale * coarse.cy + shift,
    };
    let mut size = camera.size();
    (size.width, size.height) = (size.width * FINE as u32, size.height * FINE as u32);
    Camera::new(size, pinhole, *camera.distortion())
}
