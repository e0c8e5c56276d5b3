//! Image pyramid of the region in both images: full size and repeatedly halved.
//!
//! Every level has a fixed grid: pixel `X` of the grid of scale `s` covers the rectified pixels `s X .. s X + s`, so its centre
//! is at `s (X + 0.5) - 0.5`. Windows start on the grid of the coarsest level. The rows of the right image are moved by the
//! pair's [`RowOffset`] when they are loaded. Equal grid rows then correspond on every level, up to the error of the row
//! offset.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::region::{PixelBox, RegionMask};
use pb3dp_estimation_core::wide::wide;

use super::colour_planes::{ColourPlanes, UNSEEN, Wanted};
use super::disparity_plane::{DisparityPlane, DisparityRange};
use super::front_end::{HalvingScratch, Side, StereoFrontEnd};
use super::image_plane::PixelWindow;
use super::reach;
use super::row_shift::shift_rows;
use crate::front_end::halve_planes;
use pb3dp_estimation_core::row_offset::RowOffset;

/// Largest number of levels. Chosen by hand, not varied: on the sixth level, a region of 6 million pixels has
/// `direct.search.quick_area_max_px` (6000).
pub const LEVELS_MAX: usize = 6;
/// A level is halved if its part of the region has more pixels than this. Chosen by hand, not varied: a halved level keeps
/// more than 150 px of the region.
const HALVED_FROM_PX: usize = 600;
/// Margin of the windows around the region, pixels of the search level: half a patch, 7 px, and 3 px for a filter.
const MARGIN_PX: u32 = 10;

/// Disparities beyond this do not occur in images, pixels.
const DISPARITY_MAX_PX: f64 = 1e9;

/// Input of a pyramid.
#[derive(Clone, Copy, Debug)]
pub struct PyramidSource<'a> {
    /// Raw left image.
    pub left: ImageView<'a>,
    /// Raw right image.
    pub right: ImageView<'a>,
    /// The region in the rectified left image.
    pub region: &'a RegionMask,
    /// Disparities that the right window must cover, pixels: lowest and highest.
    pub disparity_px: DisparityRange,
    /// Known row offset.
    pub rows: RowOffset,
    /// Channels to compute.
    pub wanted: Wanted,
    /// The search runs on the first level on which the region has at most this many pixels.
    pub search_area_px: usize,
}

/// One level.
#[derive(Clone, Debug, Default)]
pub struct RegionLevel {
    /// Rectified pixels per pixel of this level: 1, 2, 4, ...
    pub scale: usize,
    /// The left image; its `window` is in pixels of this level's grid.
    pub left: ColourPlanes,
    /// The right image; its `window` is in pixels of this level's grid.
    pub right: ColourPlanes,
    /// Per pixel of the left window: 1 if it belongs to the region.
    pub region: Vec<u8>,
    /// Per pixel of the left window: bit 0 is set if the pixel is used for refinement. Initially the region; the search
    /// updates it.
    pub support: Vec<u8>,
    /// Number of pixels of the region.
    pub area_px: usize,
}

/// A disparity plane in pixels of one level: left pixel `(x, y)` of the window corresponds to the right pixel
/// `(x - (c + a x + b y), y + row)` of the right window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelPlane {
    /// Slope along columns, pixel per pixel.
    pub a: f64,
    /// Slope along rows, pixel per pixel.
    pub b: f64,
    /// Shift at the left window's first pixel, pixels of the level.
    pub c: f64,
    /// First row of the left window minus first row of the right one, pixels of the level.
    pub row: i32,
}

impl RegionLevel {
    /// Converts a position in the left window to a rectified left pixel.
    #[inline]
    pub fn full_from_level(&self, at: &Vector2<f64>) -> Vector2<f64> {
        let origin = Vector2::new(f64::from(self.left.window.x), f64::from(self.left.window.y));
        ((at + origin).add_scalar(0.5) * self.scale as f64).add_scalar(-0.5)
    }

    /// Converts a rectified left pixel to a position in the left window.
    #[inline]
    pub fn level_from_full(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let origin = Vector2::new(f64::from(self.left.window.x), f64::from(self.left.window.y));
        (pixel.add_scalar(0.5) / self.scale as f64).add_scalar(-0.5) - origin
    }

    /// First column of the left window minus first column of the right window, pixels of the level. Subtracted from a grid
    /// disparity it gives a shift between the windows.
    #[inline]
    pub fn column_shift(&self) -> i32 {
        self.left.window.x - self.right.window.x
    }

    /// Converts a plane to this level's pixels.
    #[inline]
    pub fn level_plane(&self, plane: &DisparityPlane) -> LevelPlane {
        let at_origin = plane.at(&self.full_from_level(&Vector2::zeros()));
        LevelPlane {
            a: plane.slope.x,
            b: plane.slope.y,
            c: at_origin / self.scale as f64 - f64::from(self.column_shift()),
            row: self.left.window.y - self.right.window.y,
        }
    }

    /// Converts a plane from this level's pixels, with reference pixel `centre_px`.
    #[inline]
    pub fn full_plane(&self, plane: &LevelPlane, centre_px: Vector2<f64>) -> DisparityPlane {
        let d0_px = (plane.c + f64::from(self.column_shift())) * self.scale as f64;
        let centre = self.full_from_level(&Vector2::zeros());
        DisparityPlane { centre_px: centre, d0_px, slope: Vector2::new(plane.a, plane.b) }.centred_at(centre_px)
    }

    /// Marks the pixels that are marked in another level of the same size; its windows may be smaller or larger.
    pub fn take_support(&mut self, other: &Self) {
        let (from, to) = (other.left.window, self.left.window);
        let end = |window: PixelWindow| window.x + window.width as i32;
        let (first, last) = (from.x.max(to.x), end(from).min(end(to)));
        self.support.fill(0);
        if first >= last {
            return;
        }
        for y in from.y.max(to.y)..(from.y + from.height as i32).min(to.y + to.height as i32) {
            let part = |window: PixelWindow| {
                let row = (y - window.y) as usize * window.width;
                row + (first - window.x) as usize..row + (last - window.x) as usize
            };
            self.support[part(to)].copy_from_slice(&other.support[part(from)]);
        }
    }

    /// Marks the whole region for refinement again.
    pub fn reset_support(&mut self) {
        self.support.clone_from(&self.region);
    }
}

/// The levels of one region of one pair, the finest first. Allocates only for a region larger than all previous ones.
#[derive(Clone, Debug, Default)]
pub struct RegionPyramid {
    levels: Vec<RegionLevel>,
    used: usize,
    search_level: usize,
    centroid_px: Vector2<f64>,
    area_px: usize,
    box_px: PixelBox,
    /// Levels on which the region has more pixels are omitted, if a limit is set.
    area_max_px: Option<usize>,
    loaded: ColourPlanes,
    halved: HalvingScratch,
    regions: [Vec<u8>; 2],
    /// Whether the resampled colours of both windows are kept for the refinement.
    keeps_colours: bool,
    /// Width of the surroundings that are loaded at full size, pixels; 0: what the search on all levels needs.
    surroundings_px: u32,
    colours: [ColourPlanes; 2],
    colour_scale: usize,
}

impl RegionPyramid {
    /// A pyramid without the levels on which the region has more than `area_max_px` pixels: its finest level may already be
    /// reduced.
    pub fn up_to(area_max_px: usize) -> Self {
        Self { area_max_px: Some(area_max_px), ..Self::default() }
    }

    /// Keeps the colours of both windows if the images are resampled, so that a refinement need not resample them again.
    #[must_use]
    pub fn keeping_colours(self) -> Self {
        Self { keeps_colours: true, ..self }
    }

    /// The full size only, with the surroundings of the region up to this distance, pixels.
    pub fn surrounded(reach_px: usize) -> Self {
        let surroundings_px = (reach_px.min(reach::REACH_MAX_PX) + reach::MARGIN_PX) as u32;
        Self { surroundings_px, ..Self::default() }.keeping_colours()
    }

    /// Rectified pixels per pixel of the kept colours along rows and columns.
    pub fn colour_scale(&self) -> usize {
        self.colour_scale.max(1)
    }

    /// Red, green and blue of a window, if the images were resampled and the colours are kept; see [`Self::colour_scale`].
    pub fn colours(&self, side: Side) -> Option<&ColourPlanes> {
        let colours = &self.colours[side as usize];
        (self.used > 0 && !colours.flags.is_empty()).then_some(colours)
    }

    /// The levels, finest first.
    pub fn levels(&self) -> &[RegionLevel] {
        &self.levels[..self.used]
    }

    /// The levels, finest first.
    pub fn levels_mut(&mut self) -> &mut [RegionLevel] {
        &mut self.levels[..self.used]
    }

    /// Index of the level for the search over all disparities.
    pub fn search_level(&self) -> usize {
        self.search_level
    }

    /// Centroid of the region, rectified left pixels.
    pub fn centroid_px(&self) -> Vector2<f64> {
        self.centroid_px
    }

    /// Pixels of the region in the rectified left image.
    pub fn area_px(&self) -> usize {
        self.area_px
    }

    /// The region's box in the rectified left image.
    pub fn box_px(&self) -> PixelBox {
        self.box_px
    }

    /// Loads the region from a pair of images. Returns `false`, with no levels, if the rectified region is empty or the right
    /// image covers none of the disparities.
    pub fn update(&mut self, front_end: &StereoFrontEnd, source: &PyramidSource<'_>) -> bool {
        self.used = 0;
        let (Some(box_px), Some(centroid_px)) = (source.region.bbox(), source.region.centroid_px()) else {
            return false;
        };
        (self.box_px, self.centroid_px, self.area_px) = (box_px, centroid_px, source.region.area_px());
        let halvings = |limit: usize| (0..LEVELS_MAX - 1).take_while(|&i| self.area_px >> (2 * i) > limit).count();
        let finest = self.area_max_px.map_or(0, halvings).min(halvings(source.search_area_px));
        self.search_level = halvings(source.search_area_px) - finest;
        let count = match self.surroundings_px {
            0 => 1 + halvings(HALVED_FROM_PX).max(finest + self.search_level) - finest,
            _ => 1,
        };
        if self.levels.len() < count {
            self.levels.resize_with(count, RegionLevel::default);
        }
        let [left, right] = self.windows(front_end, source, finest, count);
        self.load(front_end, source, left, right, finest);
        let first = &self.levels[0];
        if first.area_px == 0 || first.right.flags.is_empty() {
            return false;
        }
        for i in 1..count {
            let (finer, coarser) = self.levels.split_at_mut(i);
            coarser[0].halve(&finer[i - 1], front_end.kernels());
        }
        self.used = (1..count).find(|&i| self.levels[i].area_px == 0).unwrap_or(count);
        self.search_level = self.search_level.min(self.used - 1);
        true
    }

    /// Windows of both images, aligned to the coarsest grid.
    fn windows(
        &self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        finest: usize,
        count: usize,
    ) -> [PixelWindow; 2] {
        let margin = match self.surroundings_px {
            0 => i64::from(MARGIN_PX << (finest + self.search_level)),
            surroundings_px => i64::from(surroundings_px),
        };
        let grid = 1_i64 << (finest + count - 1);
        let b = self.box_px;
        let size = front_end.size(Side::Left);
        let rows = size.height.min(front_end.size(Side::Right).height);
        let span = |first: i64, last: i64, limit: u32| {
            let start = (first.clamp(0, i64::from(limit)) / grid) * grid;
            (start as i32, (last.min(i64::from(limit) - 1) - start + 1).max(0) as usize)
        };
        let (left, right) = (i64::from(b.x) - margin, i64::from(b.x + b.width) - 1 + margin);
        let (y, height) = span(i64::from(b.y) - margin, i64::from(b.y + b.height) - 1 + margin, rows);
        let (x, width) = span(left, right, size.width);
        // Far outside any image, so that sums cannot overflow.
        let whole = |px: f64| px.clamp(-DISPARITY_MAX_PX, DISPARITY_MAX_PX) as i64;
        let (low, high) = (whole(source.disparity_px.lowest.floor()), whole(source.disparity_px.highest.ceil()));
        let (x_right, width_right) = span(left - high, right - low, front_end.size(Side::Right).width);
        [PixelWindow { x, y, width, height }, PixelWindow { x: x_right, y, width: width_right, height }]
    }

    /// Fills the finest level, which is the full size halved `halvings` times.
    fn load(
        &mut self,
        front: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        left: PixelWindow,
        right: PixelWindow,
        halvings: usize,
    ) {
        let Self { levels, loaded, halved, regions, colours, keeps_colours, colour_scale, .. } = self;
        let level = &mut levels[0];
        level.scale = 1 << halvings;
        let keeps_colours = *keeps_colours
            && front.resamples()
            && source.wanted == Wanted::Luminance
            && front.unit(halvings) == 1 << halvings;
        if !keeps_colours {
            colours.iter_mut().for_each(|colours| colours.resize(PixelWindow::default(), Wanted::Rgb));
        }
        *colour_scale = if keeps_colours { front.unit(halvings) } else { 1 };
        let [left_colours, right_colours] = colours;
        let image = |side, raw| CameraImage { side, raw, wanted: source.wanted, halvings };
        let left_image = image(Side::Left, source.left);
        load_side(front, left_image, left, keeps_colours.then_some(left_colours), halved, &mut level.left);
        let right_image = image(Side::Right, source.right);
        let right_colours = keeps_colours.then_some(right_colours);
        if source.rows.is_zero() {
            load_side(front, right_image, right, right_colours, halved, &mut level.right);
        } else {
            load_side(front, right_image, right, right_colours, halved, loaded);
            shift_rows(loaded, &source.rows.at_scale(level.scale as f64), front.kernels(), &mut level.right);
        }
        let full = left.clipped(front.size(Side::Left).width, front.size(Side::Left).height);
        let first = if halvings == 0 { &mut level.region } else { &mut regions[0] };
        mark_region(source.region, &full, first);
        let (mut width, mut height) = (full.width, full.height);
        for i in 0..halvings {
            let [finer, coarser] = regions;
            let out = if i + 1 == halvings { &mut level.region } else { &mut *coarser };
            halve_region(finer, width, front.kernels(), out);
            regions.swap(0, 1);
            (width, height) = (width / 2, height / 2);
        }
        debug_assert_eq!((width, height), (level.left.window.width, level.left.window.height));
        level.area_px = level.region.iter().map(|&inside| usize::from(inside)).sum();
        level.reset_support();
    }
}

/// A raw image, its camera, and the channels to compute, at the full size halved this many times.
#[derive(Clone, Copy)]
struct CameraImage<'a> {
    side: Side,
    raw: ImageView<'a>,
    wanted: Wanted,
    halvings: usize,
}

/// Rows above and below the right window whose colours are kept too, for row offsets that the refinement finds, pixels of the
/// kept colours. Chosen by hand, not varied: with larger offsets the refinement resamples the image itself.
const COLOUR_ROWS: i32 = 4;

/// The channels of a window (full size) of an image. With `colours`, its colours are kept there.
fn load_side(
    front: &StereoFrontEnd,
    CameraImage { side, raw, wanted, halvings }: CameraImage<'_>,
    window: PixelWindow,
    colours: Option<&mut ColourPlanes>,
    scratch: &mut HalvingScratch,
    out: &mut ColourPlanes,
) {
    let unit = front.unit(halvings);
    match colours {
        Some(colours) if unit == 1 << halvings => {
            let size = front.size(side);
            let own = window.clipped(size.width, size.height).reduced(unit);
            let margin = if side == Side::Right { COLOUR_ROWS } else { 0 };
            let grown = PixelWindow { y: own.y - margin, height: own.height + 2 * margin as usize, ..own };
            front.load_reduced(side, raw, grown, unit, Wanted::Rgb, scratch.reduced(), colours);
            colours.luminance_into(own, front.kernels(), out);
        }
        _ if halvings == 0 => front.load(side, raw, window, wanted, out),
        _ => front.load_halved(side, raw, window, halvings, wanted, scratch, out),
    }
}

/// 1 for every pixel of the window that belongs to the region, else 0.
fn mark_region(region: &RegionMask, window: &PixelWindow, out: &mut Vec<u8>) {
    out.clear();
    out.resize(window.width * window.height, 0);
    region.for_each_run(|y, first, last| {
        let row = i64::from(y) - i64::from(window.y);
        if row < 0 || row >= window.height as i64 {
            return;
        }
        let column = |x: u32| (i64::from(x) - i64::from(window.x)).clamp(0, window.width as i64) as usize;
        out[row as usize * window.width..][column(first)..column(last + 1)].fill(1);
    });
}

impl RegionLevel {
    fn halve(&mut self, finer: &Self, kernels: Kernels) {
        self.scale = 2 * finer.scale;
        halve_planes(&finer.left, kernels, &mut self.left);
        halve_planes(&finer.right, kernels, &mut self.right);
        halve_region(&finer.region, finer.left.window.width, kernels, &mut self.region);
        self.area_px = self.region.iter().map(|&inside| usize::from(inside)).sum();
        self.reset_support();
    }
}

/// A half-size pixel belongs to the region if half of its four pixels do.
fn halve_region(finer: &[u8], fine_width: usize, kernels: Kernels, out: &mut Vec<u8>) {
    let (width, height) = (fine_width / 2, finer.len() / fine_width.max(1) / 2);
    out.clear();
    out.resize(width * height, 0);
    for (y, out) in out.chunks_exact_mut(width.max(1)).enumerate() {
        let (upper, lower) = finer[2 * y * fine_width..(2 * y + 2) * fine_width].split_at(fine_width);
        halve_region_row(kernels, upper, lower, out);
    }
}

wide! {
    fn halve_region_row(upper: &[u8], lower: &[u8], out: &mut [u8]) = halve_region_row_kernel;
}

#[inline(always)]
fn halve_region_row_kernel(upper: &[u8], lower: &[u8], out: &mut [u8]) {
    let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
    for (out, (upper, lower)) in out.iter_mut().zip(pairs) {
        *out = u8::from((upper[0] + upper[1]) + (lower[0] + lower[1]) >= 2);
    }
}

/// Whether a pixel with these flags is inside the image.
#[inline]
pub fn is_visible(flags: u8) -> bool {
    flags & UNSEEN == 0
}

#[cfg(test)]
mod tests {
    use image::RgbImage;
    use nalgebra::Vector3;
    use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

    use super::*;

    fn front_end() -> StereoFrontEnd {
        let size = ImageSize { width: 300, height: 200 };
        let camera = |cx| Camera::new(size, Pinhole { fx: 310.0, fy: 305.0, cx, cy: 90.0 }, Distortion::None).unwrap();
        let pose = Pose::from_parts(Vector3::new(-0.1, 0.0, 0.0), nalgebra::UnitQuaternion::identity());
        StereoFrontEnd::new(&StereoRig::new(camera(140.0), camera(152.0), pose).unwrap(), Kernels::best()).unwrap()
    }

    #[test]
    fn marks_are_taken_where_both_windows_overlap() {
        let level = |x, y, width: usize, height: usize, value: u8| {
            let window = PixelWindow { x, y, width, height };
            let left = ColourPlanes { window, ..ColourPlanes::default() };
            RegionLevel { left, support: vec![value; width * height], ..RegionLevel::default() }
        };
        let marked = |mut to: RegionLevel, from: &RegionLevel| {
            to.take_support(from);
            to.support
        };
        assert_eq!(marked(level(3, 5, 4, 3, 7), &level(4, 6, 2, 1, 2)), [0, 0, 0, 0, 0, 2, 2, 0, 0, 0, 0, 0]);
        assert_eq!(marked(level(3, 5, 3, 2, 7), &level(1, 2, 4, 4, 1)), [1, 1, 0, 0, 0, 0]);
        assert_eq!(marked(level(3, 5, 2, 1, 7), &level(9, 5, 4, 4, 1)), [0, 0]);
    }

    /// Sum of channels `3 (0.4 u + 0.3 v)`: luminance is `sqrt 3` times the bracket, up to rounding.
    fn ramp(offset: f64) -> RgbImage {
        RgbImage::from_fn(300, 200, |u, v| {
            image::Rgb([(0.4 * f64::from(u) + 0.3 * (f64::from(v) - offset)).round() as u8; 3])
        })
    }

    fn pyramid(rows: RowOffset, offset: f64) -> RegionPyramid {
        let mut pyramid = RegionPyramid::default();
        fill(&mut pyramid, rows, offset);
        pyramid
    }

    fn fill(pyramid: &mut RegionPyramid, rows: RowOffset, offset: f64) {
        let front_end = front_end();
        let size = front_end.size(Side::Left);
        let region = RegionMask::from_fn(size, |x, y| (121..201).contains(&x) && (50..110).contains(&y) && x + y > 190);
        let (left, right) = (ramp(0.0), ramp(offset));
        let source = PyramidSource {
            left: (&left).into(),
            right: (&right).into(),
            region: &region,
            disparity_px: DisparityRange { lowest: 5.0, highest: 40.0 },
            rows,
            wanted: Wanted::Luminance,
            search_area_px: 2000,
        };
        assert!(pyramid.update(&front_end, &source));
    }

    #[test]
    fn places_keep_their_meaning_on_every_level() {
        let pyramid = pyramid(RowOffset::default(), 0.0);
        assert_eq!((pyramid.levels().len(), pyramid.search_level()), (3, 1));
        for (i, level) in pyramid.levels().iter().enumerate() {
            assert_eq!(level.scale, 1 << i);
            let at = Vector2::new(14.0, 11.0);
            let full = level.full_from_level(&at);
            let shown = f64::from(level.left.luminance().row(11)[14]) / 3f64.sqrt();
            assert!((shown - (0.4 * full.x + 0.3 * full.y)).abs() < 0.6, "level {i}: {shown} at {full}");
            assert!((level.level_from_full(&full) - at).norm() < 1e-12);
            let expected = pyramid.area_px() as f64 / (level.scale * level.scale) as f64;
            assert!((level.area_px as f64 / expected - 1.0).abs() < 0.12, "level {i}: {}", level.area_px);
            assert_eq!(level.area_px, level.region.iter().map(|&inside| usize::from(inside)).sum::<usize>());
        }
    }

    #[test]
    fn what_is_halved_at_once_is_what_is_halved_level_by_level() {
        let rows = RowOffset { centre_px: Vector2::new(20.0, 20.0), offset_px: 1.6, slope: Vector2::new(0.001, 0.002) };
        for rows in [RowOffset::default(), rows] {
            let all = pyramid(rows, 1.6);
            let mut some = RegionPyramid::up_to(2000);
            fill(&mut some, rows, 1.6);
            assert_eq!((some.levels().len(), some.levels()[0].scale, some.search_level()), (2, 2, 0));
            for (a, b) in all.levels()[1..].iter().zip(some.levels()) {
                assert_eq!((a.scale, a.area_px, &a.region), (b.scale, b.area_px, &b.region));
                assert_eq!((a.left.window, &a.left.flags), (b.left.window, &b.left.flags));
                let gap = |p: &ColourPlanes, q: &ColourPlanes| {
                    let pairs = p.luminance().values().iter().zip(q.luminance().values());
                    // Rows at the border of the window are moved with replicated rows.
                    let inner = pairs.skip(4 * p.window.width).take((p.window.height - 8) * p.window.width);
                    inner.map(|(p, q)| (p - q).abs()).fold(0.0, f32::max)
                };
                assert!(gap(&a.left, &b.left) < 1e-3 && gap(&a.right, &b.right) < 0.5, "{}", gap(&a.right, &b.right));
            }
        }
    }

    #[test]
    fn a_plane_is_the_same_on_every_level() {
        let plane =
            DisparityPlane { centre_px: Vector2::new(150.0, 70.0), d0_px: 17.3, slope: Vector2::new(0.07, -0.12) };
        for level in pyramid(RowOffset::default(), 0.0).levels() {
            let here = level.level_plane(&plane);
            let (x, y) = (9.0, 13.0);
            let full = level.full_from_level(&Vector2::new(x, y));
            let x_right = x - (here.c + here.a * x + here.b * y);
            let full_right = level.scale as f64 * (x_right + f64::from(level.right.window.x) + 0.5) - 0.5;
            assert!((full.x - full_right - plane.at(&full)).abs() < 1e-9);
            let back = level.full_plane(&here, plane.centre_px);
            assert!((back.parameters() - plane.parameters()).norm() < 1e-9);
        }
    }

    #[test]
    fn known_row_offsets_are_taken_out() {
        let rows = RowOffset { centre_px: Vector2::new(20.0, 20.0), offset_px: 1.6, slope: Vector2::zeros() };
        let pyramid = pyramid(rows, 1.6);
        for level in pyramid.levels() {
            let (left, right) = (level.left.luminance(), level.right.luminance());
            let shift = level.column_shift();
            for y in [4, 8] {
                // The same grid column in both images.
                let (x, x_right) = (20, (20 + shift) as usize);
                assert!((left.row(y)[x] - right.row(y)[x_right]).abs() < 1.0, "{} {y}", level.scale);
            }
        }
    }
}
