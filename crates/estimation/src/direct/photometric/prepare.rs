//! From raw images to the channels of one eye: red, green and blue of the part that is needed, smoothed, as coefficients of
//! cubic splines along the rows.
//!
//! The channels are those of the sensor: each has a gain and a noise of its own, which a turn of the colours would mix. An
//! image whose three channels are equal has one.
//! A cubic spline (Unser, "Splines: a perfect fit for signal and image processing", 1999) costs as much per point as cubic
//! convolution, but its errors of phase and the change of its noise between pixels are far smaller: where a whole region lies
//! at one fraction of a pixel, as on a plane that faces the cameras, these errors do not cancel.

use super::super::colour_planes::{ColourPlanes, SATURATED, UNSEEN, Wanted};
use super::super::filters::{Smoother, Taps};
use super::super::front_end::{Eye, StereoFrontEnd};
use super::super::image_plane::{ImagePlane, PixelWindow};
use super::super::region_pyramid::{PyramidSource, RegionLevel};
use super::super::row_offset::RowOffset;
use super::super::row_shift::shift_rows;
use super::kernel::{CHANNELS_MAX, UNUSABLE};
use crate::cpu::Kernels;
use crate::wide::wide;

/// Of a pixel with a saturated channel, channels from this value on are not used, grey levels: interpolation may have taken
/// some of the brightness away.
const NEARLY_SATURATED_GREY: f32 = 240.0;

/// The channels of one eye of one level.
#[derive(Clone, Debug, Default)]
pub(super) struct EyeChannels {
    /// Part of the level's window that the planes hold.
    pub part: PixelWindow,
    /// Spline coefficients along rows, one plane per channel; [`UNUSABLE`] where a channel can not be used.
    pub planes: [ImagePlane; CHANNELS_MAX],
}

/// Makes channels; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Preparation {
    smoother: Smoother,
    loaded: ColourPlanes,
    unshifted: ColourPlanes,
    raw: ImagePlane,
    /// 1 for pixels that can not be used, else 0; and a row of them.
    unusable: Vec<u8>,
    unusable_row: Vec<u8>,
    /// Taken off the channels of both eyes to keep sums small, grey levels.
    middle: [f32; CHANNELS_MAX],
}

/// The pair that the channels are made of.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub front_end: &'a StereoFrontEnd,
    pub source: &'a PyramidSource<'a>,
}

/// Which part of an eye, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wish {
    /// Part of the level's window.
    pub part: PixelWindow,
    /// Standard deviation of the smoothing, pixels of the level.
    pub smoothing_px: f64,
}

/// Pixels around a point that take part in it.
pub(super) fn reach_px(smoothing_px: f64) -> usize {
    Taps::spline(smoothing_px).radius()
}

impl Preparation {
    /// Fills the channels of the left eye and returns their number.
    pub fn left(&mut self, pair: &Pair<'_>, level: &RegionLevel, wish: &Wish, out: &mut EyeChannels) -> usize {
        let window = full_window(&level.left.window, &wish.part, level.scale);
        pair.front_end.load(Eye::Left, pair.source.left, window, Wanted::Rgb, &mut self.loaded);
        let [red, green, blue] = &self.loaded.planes;
        let channels = if red == green && green == blue { 1 } else { CHANNELS_MAX };
        for c in 0..channels {
            self.middle[c] = mean(self.loaded.planes[c].values());
        }
        self.fill(level.scale, &window, wish, channels, pair.front_end.kernels(), out);
        channels
    }

    /// Fills the channels of the right eye, its rows moved by the pair's row offset and `row_px` more.
    pub fn right(
        &mut self,
        pair: &Pair<'_>,
        level: &RegionLevel,
        (wish, row_px): (&Wish, f64),
        channels: usize,
        out: &mut EyeChannels,
    ) {
        let (front, image) = (pair.front_end, pair.source.right);
        let window = full_window(&level.right.window, &wish.part, level.scale);
        let rows = RowOffset { offset_px: pair.source.rows.offset_px + row_px, ..pair.source.rows };
        if rows.is_zero() {
            front.load(Eye::Right, image, window, Wanted::Rgb, &mut self.loaded);
        } else {
            // The offset of the pair is small, or the search would not have found anything.
            let margin = rows.magnitude_max_px(image.width(), image.height()).ceil().min(64.0) as u32 + 2;
            let grown =
                PixelWindow { x: window.x, width: window.width, ..window.grown(margin) }.clipped(u32::MAX, u32::MAX);
            front.load(Eye::Right, image, grown, Wanted::Rgb, &mut self.unshifted);
            shift_rows(&self.unshifted, &rows, front.kernels(), &mut self.loaded);
        }
        self.fill(level.scale, &window, wish, channels, front.kernels(), out);
    }

    /// Means over the pixels of a level, smoothed.
    fn fill(
        &mut self,
        scale: usize,
        window: &PixelWindow,
        wish: &Wish,
        channels: usize,
        kernels: Kernels,
        out: &mut EyeChannels,
    ) {
        out.part = wish.part;
        let (along, across) = (Taps::spline(wish.smoothing_px), Taps::gaussian(wish.smoothing_px, 0.0));
        let flagged = any_flag(&self.loaded.flags);
        for c in 0..channels {
            self.average(scale, window, &wish.part, (c, kernels));
            self.smoother.smooth(&self.raw, &along, &across, &mut out.planes[c], kernels);
            if flagged && self.find_unusable(scale, window, &wish.part, (c, kernels)) {
                mark_unusable(&self.unusable, &mut self.unusable_row, &mut out.planes[c], kernels);
            }
        }
    }

    /// The means of a channel over squares of `scale` x `scale` pixels, less the middle.
    fn average(
        &mut self,
        scale: usize,
        window: &PixelWindow,
        part: &PixelWindow,
        (channel, kernels): (usize, Kernels),
    ) {
        let loaded = &self.loaded;
        self.raw.resize(part.width, part.height);
        let skipped = ((window.x - loaded.window.x) as usize, (window.y - loaded.window.y) as usize);
        for y in 0..part.height {
            let out = self.raw.row_mut(y);
            out.fill(-self.middle[channel]);
            for v in 0..scale {
                let row = skipped.1 + y * scale + v;
                let values = &loaded.planes[channel].row(row)[skipped.0..][..part.width * scale];
                add_means(kernels, values, scale, out);
            }
        }
    }

    /// Finds the pixels of a channel that can not be used; says whether there are any.
    fn find_unusable(
        &mut self,
        scale: usize,
        window: &PixelWindow,
        part: &PixelWindow,
        (channel, kernels): (usize, Kernels),
    ) -> bool {
        let loaded = &self.loaded;
        let skipped = ((window.x - loaded.window.x) as usize, (window.y - loaded.window.y) as usize);
        self.unusable.clear();
        self.unusable.resize(part.width * part.height, 0);
        self.unusable_row.resize(part.width * scale, 0);
        let mut any = false;
        for y in 0..part.height * scale {
            let row = skipped.1 + y;
            let flags = &loaded.flags[row * loaded.window.width + skipped.0..][..part.width * scale];
            if !any_flag(flags) {
                continue;
            }
            let values = &loaded.planes[channel].row(row)[skipped.0..][..part.width * scale];
            unusable_row(kernels, values, flags, &mut self.unusable_row);
            any = any || any_flag(&self.unusable_row);
            let out = &mut self.unusable[(y / scale) * part.width..][..part.width];
            match scale {
                1 => out.copy_from_slice(&self.unusable_row),
                _ => {
                    for (out, of) in out.iter_mut().zip(self.unusable_row.chunks_exact(scale)) {
                        *out |= of.iter().fold(0, |all, one| all | one);
                    }
                }
            }
        }
        any
    }
}

wide! {
    /// 1 for every pixel of a row that can not be used, else 0.
    fn unusable_row(values: &[f32], flags: &[u8], out: &mut [u8]) = unusable_row_kernel;
}

#[inline(always)]
fn unusable_row_kernel(values: &[f32], flags: &[u8], out: &mut [u8]) {
    for ((out, value), flag) in out.iter_mut().zip(values).zip(flags) {
        let saturated = u8::from(flag & SATURATED != 0) & u8::from(*value >= NEARLY_SATURATED_GREY);
        *out = saturated | u8::from(flag & UNSEEN != 0);
    }
}

/// Whether any of some flags is set.
fn any_flag(flags: &[u8]) -> bool {
    flags.iter().fold(0, |all, flag| all | flag) != 0
}

wide! {
    /// Adds to every value of `out` its share of the mean over a square, from one row of `scale` of them.
    fn add_means(values: &[f32], scale: usize, out: &mut [f32]) = add_means_kernel;
}

#[inline(always)]
fn add_means_kernel(values: &[f32], scale: usize, out: &mut [f32]) {
    let share = 1.0 / (scale * scale) as f32;
    match scale {
        1 => {
            for (out, value) in out.iter_mut().zip(values) {
                *out += value;
            }
        }
        2 => {
            for (out, two) in out.iter_mut().zip(values.as_chunks::<2>().0) {
                *out += share * (two[0] + two[1]);
            }
        }
        _ => {
            for (out, values) in out.iter_mut().zip(values.chunks_exact(scale)) {
                *out += share * values.iter().sum::<f32>();
            }
        }
    }
}

/// A part of a level's window in full pixels.
fn full_window(window: &PixelWindow, part: &PixelWindow, scale: usize) -> PixelWindow {
    let s = scale as i32;
    PixelWindow {
        x: (window.x + part.x) * s,
        y: (window.y + part.y) * s,
        width: part.width * scale,
        height: part.height * scale,
    }
}

fn mean(values: &[f32]) -> f32 {
    let step = (values.len() / 2000).max(1);
    let (sum, count) = values.iter().step_by(step).fold((0.0, 0.0_f32), |(sum, count), v| (sum + v, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Marks pixels that can not be used, and their neighbours, which smoothing has touched.
fn mark_unusable(unusable: &[u8], touched: &mut Vec<u8>, plane: &mut ImagePlane, kernels: Kernels) {
    let (width, height) = (plane.width(), plane.height());
    for y in 0..height {
        touched.clear();
        touched.resize(width + 2, 0);
        // One column further right, with room for both neighbours.
        for row in unusable[y.saturating_sub(1) * width..(y + 2).min(height) * width].chunks_exact(width) {
            for (touched, unusable) in touched[1..].iter_mut().zip(row) {
                *touched |= unusable;
            }
        }
        if any_flag(touched) {
            mark_row(kernels, touched, plane.row_mut(y));
        }
    }
}

wide! {
    /// Marks the values beside a touched column; `touched` begins one column earlier.
    fn mark_row(touched: &[u8], values: &mut [f32]) = mark_row_kernel;
}

#[inline(always)]
fn mark_row_kernel(touched: &[u8], values: &mut [f32]) {
    let beside = touched.iter().zip(&touched[1..]).zip(&touched[2..]);
    for (value, ((before, here), after)) in values.iter_mut().zip(beside) {
        *value = if before | here | after != 0 { UNUSABLE } else { *value };
    }
}
