//! From the windows of a level to smooth channels.

use super::super::filters::{Smoother, Taps};
use super::super::image_plane::{ImagePlane, PixelWindow};
use super::super::region_pyramid::RegionLevel;
use super::kernel::{CHANNELS_MAX, UNUSABLE};
use crate::cpu::Kernels;

/// What a channel is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Luminance, lightly smoothed.
    Luminance,
    /// Luminance, lightly smoothed, minus a smoother copy: free of shading.
    Detail,
    /// Red against green and blue, smoothed.
    ChromaA,
    /// Green against blue, smoothed.
    ChromaB,
}

/// How channels are smoothed, pixels of the level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Smoothing {
    /// Standard deviation of the light smoothing.
    pub light_px: f64,
    /// Standard deviation of what is taken off for [`Channel::Detail`], on top of the light one.
    pub wide_px: f64,
}

impl Smoothing {
    /// Pixels around a point that take part in it.
    pub fn reach_px(&self) -> usize {
        Taps::gaussian(self.light_px, 0.5).radius() + Taps::gaussian(self.wide_px, 0.0).radius()
    }
}

/// The channels of one eye of one level.
#[derive(Clone, Debug, Default)]
pub(super) struct EyeChannels {
    /// Part of the level's window that the planes hold.
    pub part: PixelWindow,
    /// A plane per channel, in the order asked for.
    pub planes: [ImagePlane; CHANNELS_MAX],
}

/// Makes channels; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Preparation {
    smoother: Smoother,
    raw: ImagePlane,
    light: ImagePlane,
    wide: ImagePlane,
}

/// Which eye, which part of it, and how.
pub(super) struct Wish<'a> {
    pub right: bool,
    /// Part of the level's window.
    pub part: PixelWindow,
    /// The planes show what the window shows this many rows further down (at most half a pixel is meant).
    pub row_shift: f64,
    pub channels: &'a [Channel],
    /// Taken off Y, A, B'.
    pub levels: [f32; 3],
    pub smoothing: Smoothing,
}

impl Preparation {
    /// Fills the channels of one eye.
    pub fn prepare(&mut self, level: &RegionLevel, wish: &Wish<'_>, kernels: Kernels, out: &mut EyeChannels) {
        let eye = if wish.right { &level.right } else { &level.left };
        out.part = wish.part;
        let rows = Taps::gaussian(wish.smoothing.light_px, 0.0);
        let columns = Taps::gaussian(wish.smoothing.light_px, wish.row_shift);
        let wide = Taps::gaussian(wish.smoothing.wide_px, 0.0);
        let mut light_is_luminance = false;
        for (channel, plane) in wish.channels.iter().zip(&mut out.planes) {
            let source = match channel {
                Channel::Luminance | Channel::Detail => 0,
                Channel::ChromaA => 1,
                Channel::ChromaB => 2,
            };
            if source != 0 || !light_is_luminance {
                crop(&eye.planes[source], &wish.part, wish.levels[source], &mut self.raw);
                self.smoother.smooth(&self.raw, &rows, &columns, &mut self.light, kernels);
                light_is_luminance = source == 0;
            }
            plane.resize(wish.part.width, wish.part.height);
            plane.values_mut().copy_from_slice(self.light.values());
            if *channel == Channel::Detail {
                self.smoother.smooth(&self.light, &wide, &wide, &mut self.wide, kernels);
                for (value, smooth) in plane.values_mut().iter_mut().zip(self.wide.values()) {
                    *value -= smooth;
                }
            }
        }
        if wish.right {
            mark_unusable(&eye.flags, eye.window.width, &wish.part, &mut out.planes[0]);
        }
    }
}

fn crop(source: &ImagePlane, part: &PixelWindow, level: f32, out: &mut ImagePlane) {
    out.resize(part.width, part.height);
    for y in 0..part.height {
        let row = &source.row(part.y as usize + y)[part.x as usize..][..part.width];
        for (out, value) in out.row_mut(y).iter_mut().zip(row) {
            *out = value - level;
        }
    }
}

/// Pixels with a flag, and their neighbours, which smoothing has touched.
fn mark_unusable(flags: &[u8], stride: usize, part: &PixelWindow, plane: &mut ImagePlane) {
    let (width, height) = (part.width, part.height);
    for y in 0..height {
        let row = &flags[(part.y as usize + y) * stride + part.x as usize..][..width];
        if row.iter().all(|&flag| flag == 0) {
            continue;
        }
        for (x, _) in row.iter().enumerate().filter(|(_, flag)| **flag != 0) {
            for v in y.saturating_sub(1)..(y + 2).min(height) {
                plane.row_mut(v)[x.saturating_sub(1)..(x + 2).min(width)].fill(UNUSABLE);
            }
        }
    }
}
