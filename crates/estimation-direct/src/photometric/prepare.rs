//! Preparation of the channels of one image: red, green and blue of the required part, smoothed, as coefficients of cubic
//! splines along the rows.
//!
//! The channels are those of the sensor: each has its own gain and noise, which a rotation of the colour space would mix. An
//! image with three equal channels is treated as one channel.
//! A cubic spline (Unser, "Splines: a perfect fit for signal and image processing", 1999) costs as much per point as cubic
//! convolution, but its phase errors and the variation of its noise between pixels are far smaller. If a whole region has the
//! same sub-pixel fraction, as on a plane that faces the cameras, these errors do not cancel.

use std::ops::Range;

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::{ImageView, RgbRows};
use pb3dp_estimation_core::wide::wide;

use super::kernel::{CHANNELS_MAX, UNUSABLE};
use super::level_rows::{Grid, ImageRows, average_bytes, average_colours, average_values};
use pb3dp_estimation_core::row_offset::RowOffset;
use pb3dp_estimation_views::ReducedImage;
use pb3dp_estimation_views::colour_planes::{ColourPlanes, SATURATED, SATURATED_FROM, UNSEEN, Wanted};
use pb3dp_estimation_views::filters::{PixelRows, Smoother, Taps};
use pb3dp_estimation_views::front_end::{Side, StereoFrontEnd};
use pb3dp_estimation_views::image_plane::{ImagePlane, PixelWindow};
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionLevel};
use pb3dp_estimation_views::row_shift::BLOCK;

/// In a pixel with a saturated channel, channels from this value on are not used either, grey levels: interpolation may
/// have reduced the brightness. Chosen by hand, not varied: with more, clipped values count; with less, bright pixels
/// beside saturated ones are lost.
const NEARLY_SATURATED_GREY: u8 = 240;

/// The channels of one image of one level.
#[derive(Clone, Debug, Default)]
pub(super) struct CameraChannels {
    /// Part of the level's window covered by the planes.
    pub part: PixelWindow,
    /// Spline coefficients along rows, one plane per channel; [`UNUSABLE`] where a channel is unusable.
    pub planes: [ImagePlane; CHANNELS_MAX],
}

/// Prepares channels; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Preparation {
    smoother: Smoother,
    scratch: Scratch,
    /// The only channel of a grey image.
    grey: Vec<u8>,
    /// Means over the pixels of the level.
    means: ImagePlane,
    /// Whether a row of the image has saturated pixels.
    flagged: Vec<bool>,
    /// Per channel: 1 for unusable pixels, otherwise 0; and one row of them.
    unusable: [Vec<u8>; CHANNELS_MAX],
    unusable_row: Vec<u8>,
    /// Subtracted from the channels of both images to keep sums small, grey levels.
    middle: [f32; CHANNELS_MAX],
}

/// The required part of an image, if it is not in the image itself.
#[derive(Clone, Debug, Default)]
struct Scratch {
    /// Resampled.
    loaded: ColourPlanes,
    reduced: ReducedImage,
    /// Converted to 8-bit colour.
    converted: Vec<u8>,
}

/// The pair from which the channels are prepared.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub front_end: &'a StereoFrontEnd,
    pub source: &'a PyramidSource<'a>,
    /// Colours of the left and right window of the pyramid, if the images were resampled for it.
    pub colours: [Option<&'a ColourPlanes>; 2],
    /// Side of the squares of image pixels that are read, pixels: 1 if the images are not resampled.
    pub unit: usize,
}

/// The required part of an image.
#[derive(Clone, Copy)]
enum Source<'a> {
    Resampled(Resampled<'a>),
    /// The rows that are read, of an image that is used unchanged.
    Unchanged(RgbRows<'a>),
}

/// The required part of a resampled image.
#[derive(Clone, Copy)]
struct Resampled<'a> {
    planes: &'a ColourPlanes,
    /// Its first column and row in the planes.
    first: (usize, usize),
    /// Its columns and rows.
    size: (usize, usize),
}

impl<'a> Resampled<'a> {
    fn new(planes: &'a ColourPlanes, part: &PixelWindow) -> Option<Self> {
        let whole = &planes.window;
        let first = (usize::try_from(part.x - whole.x).ok()?, usize::try_from(part.y - whole.y).ok()?);
        let size = (part.width, part.height);
        (first.0 + size.0 <= whole.width && first.1 + size.1 <= whole.height).then_some(Self { planes, first, size })
    }

    /// Rows of one channel.
    fn rows(&self, channel: usize) -> impl Iterator<Item = &'a [f32]> {
        let Self { planes, first, size } = *self;
        (first.1..first.1 + size.1).map(move |y| &planes.planes[channel].row(y)[first.0..first.0 + size.0])
    }

    fn flags(&self, y: usize) -> &'a [u8] {
        let start = (self.first.1 + y) * self.planes.window.width + self.first.0;
        &self.planes.flags[start..start + self.size.0]
    }

    fn is_grey(&self) -> bool {
        self.rows(0).zip(self.rows(1)).zip(self.rows(2)).all(|((red, green), blue)| red == green && green == blue)
    }

    fn mean(&self, channel: usize) -> f32 {
        let step = (self.size.0 * self.size.1 / MIDDLE_OF).max(1);
        let step = (step as f64).sqrt().ceil() as usize;
        mean(self.rows(channel).step_by(step).flat_map(|row| row.iter().step_by(step).copied()))
    }
}

/// Requested part of an image and its smoothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ChannelRequest {
    /// Part of the level's window.
    pub part: PixelWindow,
    /// First required row of the part, and one past the last: only these are filled.
    pub rows: (usize, usize),
    /// Standard deviation of the smoothing, pixels of the level.
    pub smoothing_px: f64,
}

/// Radius of the neighbourhood that contributes to a point, pixels.
pub(super) fn reach_px(smoothing_px: f64) -> usize {
    Taps::spline(smoothing_px).radius()
}

/// The part of a box (relative to a window) inside the window.
pub(super) fn inside(part: &PixelWindow, window: &PixelWindow) -> PixelWindow {
    part.clipped(window.width as u32, window.height as u32)
}

/// The rows that a part has in common with a box moved down by `shift`: the first, and one past the last.
pub(super) fn rows_of(bounds: &PixelWindow, shift: i32, part: &PixelWindow) -> (usize, usize) {
    let first = bounds.y + shift - part.y;
    let row = |row: i32| row.clamp(0, part.height as i32) as usize;
    (row(first), row(first + bounds.height as i32))
}

/// Input for the channels of one image.
struct Job<'a> {
    front_end: &'a StereoFrontEnd,
    side: Side,
    image: ImageView<'a>,
    request: &'a ChannelRequest,
    grid: Grid,
    /// Side of the squares that are read, pixels: they are the pixels of the grid.
    unit: usize,
    /// Row of the part at which the grid begins.
    first_row: usize,
    /// Number of image rows, and range of those that are read, without the last one.
    height: i32,
    read: (i32, i32),
    smoothing: [Taps; 2],
}

impl<'a> Job<'a> {
    fn new(
        pair: &Pair<'a>,
        side: Side,
        window: &PixelWindow,
        scale: usize,
        request: &'a ChannelRequest,
        rows: Option<RowOffset>,
    ) -> Self {
        let smoothing = [Taps::spline(request.smoothing_px), Taps::gaussian(request.smoothing_px)];
        let (part, reach) = (&request.part, smoothing[1].radius());
        let (first_row, end) = (request.rows.0.saturating_sub(reach), (request.rows.1 + reach).min(part.height));
        let scale = scale / pair.unit;
        let rows = rows.map(|rows| if pair.unit > 1 { rows.at_scale(pair.unit as f64) } else { rows });
        let s = scale as i32;
        let first = ((window.x + part.x) * s, (window.y + part.y + first_row as i32) * s);
        let grid = Grid { scale, first, size: (part.width, end.saturating_sub(first_row)), rows };
        let height = pair.front_end.size(side).height as i32 / pair.unit as i32;
        let (from, to) = grid.rows_read();
        let from = from.clamp(0, height - 1);
        let image = if side == Side::Left { pair.source.left } else { pair.source.right };
        Self {
            front_end: pair.front_end,
            side,
            image,
            request,
            grid,
            unit: pair.unit,
            first_row,
            height,
            read: (from, to.clamp(from + 1, height)),
            smoothing,
        }
    }

    /// Number of image columns that are read.
    fn width(&self) -> usize {
        self.grid.size.0 * self.grid.scale
    }

    /// Number of image rows that are read.
    fn rows(&self) -> usize {
        (self.read.1 - self.read.0) as usize
    }

    /// The required part of the image. Of images that are resampled it is in the colours of the pyramid, or resampled into `loaded`.
    fn source<'b>(&self, pair: &Pair<'b>, scratch: &'b mut Scratch) -> Source<'b>
    where
        'a: 'b,
    {
        let part = PixelWindow { x: self.grid.first.0, y: self.read.0, width: self.width(), height: self.rows() };
        if !pair.front_end.resamples() {
            return Source::Unchanged(self.image.rgb(part.columns(), part.rows(), &mut scratch.converted));
        }
        let kept = pair.colours[self.side as usize].and_then(|colours| Resampled::new(colours, &part));
        Source::Resampled(kept.unwrap_or_else(|| {
            let Scratch { loaded, reduced, .. } = scratch;
            self.front_end.load_reduced(self.side, self.image, part, self.unit, Wanted::Rgb, reduced, loaded);
            Resampled { size: (loaded.window.width, loaded.window.height), planes: loaded, first: (0, 0) }
        }))
    }

    /// The image row that corresponds to row `row` of the full image in a block of columns, if it exists.
    fn nearest(&self, row: i32, block: usize) -> Option<i32> {
        let (first, step) = self.grid.offsets(f64::from(row));
        let nearest = f64::from(row) + (first + step * block as f64).round();
        (0.0..f64::from(self.height)).contains(&nearest).then_some(nearest as i32)
    }
}

impl Preparation {
    /// Fills the channels of the left image and returns their number.
    pub fn left(
        &mut self,
        pair: &Pair<'_>,
        level: &RegionLevel,
        request: &ChannelRequest,
        out: &mut CameraChannels,
    ) -> usize {
        let job = Job::new(pair, Side::Left, &level.left.window, level.scale, request, None);
        let kernels = pair.front_end.kernels();
        let mut scratch = std::mem::take(&mut self.scratch);
        let source = job.source(pair, &mut scratch);
        let grey = match &source {
            Source::Resampled(resampled) => resampled.is_grey(),
            Source::Unchanged(rgb) => (0..job.rows()).all(|y| !has_colour(kernels, rgb.row(y))),
        };
        let channels = if grey { 1 } else { CHANNELS_MAX };
        self.find_middle(&job, &source, channels);
        self.fill(&job, &source, channels, out);
        self.scratch = scratch;
        channels
    }

    /// Fills the channels of the right image, with its rows moved by the pair's row offset plus `row_px`.
    pub fn right(
        &mut self,
        pair: &Pair<'_>,
        level: &RegionLevel,
        request: &ChannelRequest,
        row_px: f64,
        channels: usize,
        out: &mut CameraChannels,
    ) {
        let rows = RowOffset { offset_px: pair.source.rows.offset_px + row_px, ..pair.source.rows };
        let rows = (!rows.is_zero()).then_some(rows);
        let job = Job::new(pair, Side::Right, &level.right.window, level.scale, request, rows);
        let mut scratch = std::mem::take(&mut self.scratch);
        let source = job.source(pair, &mut scratch);
        self.fill(&job, &source, channels, out);
        self.scratch = scratch;
    }

    /// The mean of every channel, from a sample of rows and columns.
    fn find_middle(&mut self, job: &Job<'_>, source: &Source<'_>, channels: usize) {
        for c in 0..channels {
            self.middle[c] = match source {
                Source::Resampled(resampled) => resampled.mean(c),
                Source::Unchanged(rgb) => {
                    let step = (job.rows() as f64 * job.width() as f64 / MIDDLE_OF as f64).sqrt().ceil() as usize;
                    let some = (0..job.rows()).step_by(step.max(1));
                    mean(some.flat_map(|y| rgb.row(y)[c..].iter().step_by(3 * step.max(1)).map(|&v| f32::from(v))))
                }
            };
        }
    }

    /// Means over the pixels of a level, smoothed.
    fn fill(&mut self, job: &Job<'_>, source: &Source<'_>, channels: usize, out: &mut CameraChannels) {
        out.part = job.request.part;
        let (kernels, top, rows) = (job.front_end.kernels(), job.read.0, job.rows());
        match source {
            Source::Resampled(Resampled { planes, first, size }) => {
                let is_as_wanted = job.grid.scale == 1 && job.grid.rows.is_none() && *size == job.grid.size;
                let stride = planes.window.width;
                for c in 0..channels {
                    let values = &planes.planes[c].values()[first.1 * stride..];
                    let mut pixels = (&values[first.0..], stride);
                    if !is_as_wanted {
                        let source = ImageRows { values, stride, start: first.0, top, rows: size.1 };
                        average_values(kernels, &source, &job.grid, &mut self.means);
                        pixels = (self.means.values(), self.means.width());
                    }
                    smooth(&mut self.smoother, job, pixels, &self.middle[c..], &mut out.planes[c..=c]);
                }
            }
            Source::Unchanged(rgb) if channels == 1 => {
                self.take_grey(job, rgb);
                let source = ImageRows { values: self.grey.as_slice(), stride: job.width(), start: 0, top, rows };
                average_bytes(kernels, &source, &job.grid, &mut self.means);
                let means = (self.means.values(), self.means.width());
                smooth(&mut self.smoother, job, means, &self.middle, &mut out.planes[..1]);
            }
            Source::Unchanged(rgb) => {
                let source = ImageRows { values: rgb.bytes(), stride: rgb.stride(), start: 0, top, rows };
                average_colours(kernels, &source, &job.grid, &mut self.means);
                let means = (self.means.values(), self.means.width());
                smooth(&mut self.smoother, job, means, &self.middle, &mut out.planes);
            }
        }
        if self.find_unusable(job, source, channels) {
            for (plane, unusable) in out.planes.iter_mut().zip(&self.unusable).take(channels) {
                mark_unusable(unusable, &mut self.unusable_row, job.request.rows.0..job.request.rows.1, plane, kernels);
            }
        }
    }

    /// Copies the first channel of the required part.
    fn take_grey(&mut self, job: &Job<'_>, rgb: &RgbRows<'_>) {
        let (width, rows) = (job.width(), job.rows());
        // The last row needs room for a whole block too.
        self.grey.resize(width * rows + BLOCK, 0);
        for (y, out) in (0..rows).zip(self.grey.chunks_exact_mut(width)) {
            first_of_three(job.front_end.kernels(), rgb.row(y), out);
        }
    }

    /// Finds the unusable pixels per channel; returns whether there are any.
    fn find_unusable(&mut self, job: &Job<'_>, source: &Source<'_>, channels: usize) -> bool {
        let (read, kernels) = (job.read, job.front_end.kernels());
        self.flagged.clear();
        match source {
            Source::Resampled(resampled) => {
                self.flagged.extend((0..resampled.size.1).map(|y| any_flag(resampled.flags(y))));
            }
            Source::Unchanged(rgb) => {
                self.flagged.extend((0..job.rows()).map(|y| highest(kernels, rgb.row(y)) >= SATURATED_FROM));
            }
        }
        let s = job.grid.scale;
        let rows = (job.grid.first.1, job.grid.first.1 + (job.grid.size.1 * s) as i32);
        let blocks = job.width().div_ceil(BLOCK);
        // If its four corners are inside the image, the whole part is.
        let corners =
            [rows.0, rows.1 - 1].map(|row| [0, blocks.saturating_sub(1)].map(|block| job.nearest(row, block)));
        if !self.flagged.contains(&true) && corners.as_flattened().iter().all(Option::is_some) {
            return false;
        }
        let part = &job.request.part;
        for (c, unusable) in self.unusable.iter_mut().enumerate() {
            unusable.clear();
            unusable.resize(if c < channels { part.width * part.height } else { 0 }, 0);
        }
        for (row, block) in (rows.0..rows.1).flat_map(|row| (0..blocks).map(move |block| (row, block))) {
            let nearest = job.nearest(row, block);
            if nearest.is_some_and(|row| !self.flagged.get((row - read.0) as usize).copied().unwrap_or(false)) {
                continue;
            }
            let columns = block * BLOCK..((block + 1) * BLOCK).min(job.width());
            let first = (job.first_row + (row - rows.0) as usize / s) * part.width;
            let squares = first + columns.start / s..first + columns.end.div_ceil(s);
            let [a, b, c] = self.unusable.each_mut().map(|all| all.get_mut(squares.clone()).unwrap_or_default());
            let Some(row) = nearest else {
                [a, b, c].into_iter().for_each(|all| all.fill(1));
                continue;
            };
            let y = (row - read.0) as usize;
            match source {
                Source::Resampled(resampled) => mark_resampled(resampled, y, columns, s, [a, b, c]),
                Source::Unchanged(rgb) => {
                    mark_saturated(kernels, &rgb.row(y)[3 * columns.start..3 * columns.end], s, [a, b, c]);
                }
            }
        }
        true
    }
}

/// Smooths the pixels of a job, given as values and their number per row.
fn smooth(
    smoother: &mut Smoother,
    job: &Job<'_>,
    (values, stride): (&[f32], usize),
    middle: &[f32],
    out: &mut [ImagePlane],
) {
    let (part, [along, across]) = (&job.request.part, &job.smoothing);
    let size = (part.width, part.height);
    let source = PixelRows { size, values, stride, first: job.first_row, wanted: job.request.rows };
    smoother.smooth_pixels(&source, along, across, middle, out, job.front_end.kernels());
}

/// Marks the unusable pixels of a part of a resampled row, square by square.
fn mark_resampled(
    resampled: &Resampled<'_>,
    y: usize,
    columns: Range<usize>,
    scale: usize,
    out: [&mut [u8]; CHANNELS_MAX],
) {
    let (flags, first) = (resampled.flags(y), resampled.first);
    for (plane, out) in resampled.planes.planes.iter().zip(out).filter(|(_, out)| !out.is_empty()) {
        let values = &plane.row(first.1 + y)[first.0..];
        for (i, x) in columns.clone().enumerate() {
            let is_high = flags[x] & SATURATED != 0 && values[x] >= f32::from(NEARLY_SATURATED_GREY);
            out[i / scale] |= u8::from(is_high || flags[x] & UNSEEN != 0);
        }
    }
}

wide! {
    /// Marks the pixels with saturated channels in at most one block of columns, square by square.
    fn mark_saturated(rgb: &[u8], scale: usize, out: [&mut [u8]; CHANNELS_MAX]) = mark_saturated_kernel;
}

#[inline(always)]
fn mark_saturated_kernel(rgb: &[u8], scale: usize, out: [&mut [u8]; CHANNELS_MAX]) {
    if highest_kernel(rgb) < SATURATED_FROM {
        return;
    }
    let mut bytes = [0; 3 * BLOCK];
    bytes[..rgb.len()].copy_from_slice(rgb);
    let mut marks = [[0_u8; BLOCK]; CHANNELS_MAX];
    for i in 0..BLOCK {
        let (r, g, b) = (bytes[3 * i], bytes[3 * i + 1], bytes[3 * i + 2]);
        let saturated = u8::from(r.max(g).max(b) >= SATURATED_FROM);
        marks[0][i] = saturated & u8::from(r >= NEARLY_SATURATED_GREY);
        marks[1][i] = saturated & u8::from(g >= NEARLY_SATURATED_GREY);
        marks[2][i] = saturated & u8::from(b >= NEARLY_SATURATED_GREY);
    }
    for (out, marks) in out.into_iter().zip(&marks) {
        match scale {
            1 => out.iter_mut().zip(marks).for_each(|(out, mark)| *out |= mark),
            _ => {
                for (out, marks) in out.iter_mut().zip(marks.chunks(scale)) {
                    *out |= marks.iter().fold(0, |any, mark| any | mark);
                }
            }
        }
    }
}

/// Number of values for the mean. The mean is subtracted from all values and only keeps sums small, so a sample is enough.
/// Chosen by hand, not varied.
const MIDDLE_OF: usize = 2000;

wide! {
    /// Whether any pixel of a row has channels that differ.
    fn has_colour(rgb: &[u8]) -> bool = has_colour_kernel;
}

#[inline(always)]
fn has_colour_kernel(rgb: &[u8]) -> bool {
    // Each value and the next one of the same pixel.
    const SAME: [u8; 48] = {
        let mut same = [255; 48];
        let mut i = 2;
        while i < 48 {
            same[i] = 0;
            i += 3;
        }
        same
    };
    let mut first = 0;
    while first + 49 <= rgb.len() {
        let (here, next) = (&rgb[first..first + 48], &rgb[first + 1..first + 49]);
        let mut differs = 0;
        for i in 0..48 {
            differs |= (here[i] ^ next[i]) & SAME[i];
        }
        if differs != 0 {
            return true;
        }
        first += 48;
    }
    rgb[first..].as_chunks::<3>().0.iter().any(|[r, g, b]| r != g || g != b)
}

wide! {
    /// The first channel of a row.
    fn first_of_three(rgb: &[u8], out: &mut [u8]) = first_of_three_kernel;
}

#[inline(always)]
fn first_of_three_kernel(rgb: &[u8], out: &mut [u8]) {
    for (out, rgb) in out.iter_mut().zip(rgb.as_chunks::<3>().0) {
        *out = rgb[0];
    }
}

wide! {
    /// The highest of some values.
    fn highest(values: &[u8]) -> u8 = highest_kernel;
}

#[inline(always)]
fn highest_kernel(values: &[u8]) -> u8 {
    values.iter().fold(0, |highest, &value| highest.max(value))
}

/// Whether any of some flags is set.
fn any_flag(flags: &[u8]) -> bool {
    flags.iter().fold(0, |all, flag| all | flag) != 0
}

fn mean(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0, 0.0_f32), |(sum, count), v| (sum + v, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Marks unusable pixels, and their neighbours, which the smoothing has touched.
fn mark_unusable(unusable: &[u8], touched: &mut Vec<u8>, rows: Range<usize>, plane: &mut ImagePlane, kernels: Kernels) {
    let (width, height) = (plane.width(), plane.height());
    for y in rows {
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
    /// Marks the values next to a touched column; `touched` begins one column earlier.
    fn mark_row(touched: &[u8], values: &mut [f32]) = mark_row_kernel;
}

#[inline(always)]
fn mark_row_kernel(touched: &[u8], values: &mut [f32]) {
    let beside = touched.iter().zip(&touched[1..]).zip(&touched[2..]);
    for (value, ((before, here), after)) in values.iter_mut().zip(beside) {
        *value = if before | here | after != 0 { UNUSABLE } else { *value };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_coloured_pixel_counts_with_every_kernel() {
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let mut row: Vec<u8> = (0..70_u8).flat_map(|value| [value; 3]).collect();
            assert!(!has_colour(kernels, &row));
            for i in 0..row.len() {
                row[i] += 1;
                assert!(has_colour(kernels, &row), "{i}");
                row[i] -= 1;
            }
        }
    }

    #[test]
    fn channels_near_a_saturated_one_are_marked_only_if_they_are_high() {
        for (kernels, scale) in
            pb3dp_estimation_test_support::every_kernel().flat_map(|kernels| [1, 2, 4].map(|scale| (kernels, scale)))
        {
            let mut row = [245_u8; 3 * 20];
            row[3 * 9..3 * 10].copy_from_slice(&[SATURATED_FROM, 245, 100]);
            let mut marks = [[0_u8; 20]; 3];
            mark_saturated(kernels, &row, scale, marks.each_mut().map(|marks| &mut marks[..20 / scale]));
            let expected = |c: usize| std::array::from_fn(|x| u8::from(c < 2 && x == 9 / scale));
            assert_eq!(marks, [expected(0), expected(1), expected(2)], "{scale}");
        }
    }
}
