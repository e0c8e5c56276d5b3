//! Front end: from raw images to channels of the rectified pair.
//!
//! Images of a rectified rig are used unchanged. Images of any other rig are resampled, window by window, with a cubic kernel
//! (Keys 1981, a = -1/2), which loses less sharpness than a linear one. The cost depends on the window, not on the image.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::{EstimationError, check_image_sizes};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::region::{Coverage, PixelBox, RegionMask};
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::frames::{CamLeft, CamLeftRect};
use pb3dp_geometry::maps::{PixelMap, RemapError};
use pb3dp_geometry::{Camera, ImageSize, Pinhole, Pose, StereoRig};

use super::colour_planes::{ColourPlanes, Wanted};
use super::disparity_plane::RectifiedGeometry;
use super::image_plane::PixelWindow;
use super::resample::{CELL, REDUCTION_MAX, ReducedImage, for_each_cell, resample, resample_reduced};

/// Creates windows of the rectified pair from raw images.
#[derive(Clone, Debug)]
pub struct StereoFrontEnd {
    raw: StereoRig,
    geometry: RectifiedGeometry,
    size: [ImageSize; 2],
    middle: PixelWindow,
    cam_left_rect_from_cam_left: Pose<CamLeftRect, CamLeft>,
    /// Maps to the left and the right raw image, if the rig is not rectified.
    maps: Option<[PixelMap; 2]>,
    kernels: Kernels,
}

/// Buffers for halved images.
#[derive(Clone, Debug, Default)]
pub(super) struct HalvingScratch {
    finer: ColourPlanes,
    coarser: ColourPlanes,
    reduced: ReducedImage,
}

impl HalvingScratch {
    /// The buffer for reduced raw images.
    pub fn reduced(&mut self) -> &mut ReducedImage {
        &mut self.reduced
    }
}

/// Selects a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The left camera.
    Left,
    /// The right camera.
    Right,
}

impl StereoFrontEnd {
    /// Creates the front end of a calibrated rig.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn new(rig: &StereoRig, kernels: Kernels) -> Result<Self, EstimationError> {
        if rig.is_rectified() {
            return Ok(Self {
                raw: *rig,
                geometry: RectifiedGeometry::of_rectified(rig),
                size: [rig.left().size(), rig.right().size()],
                middle: whole(rig.left().size()),
                cam_left_rect_from_cam_left: Pose::coincident(),
                maps: None,
                kernels,
            });
        }
        let middle = rig.rectify()?;
        let rectification = middle.covering_field()?;
        let growth = |of: fn(&Pinhole) -> f64| {
            (of(rectification.rig.left().pinhole()) - of(middle.rig.left().pinhole())).round() as i32
        };
        let middle = PixelWindow { x: growth(|p| p.cx), y: growth(|p| p.cy), ..whole(middle.rig.left().size()) };
        Ok(Self {
            raw: *rig,
            geometry: RectifiedGeometry::of_rectified(&rectification.rig),
            size: [rectification.rig.left().size(), rectification.rig.right().size()],
            middle,
            cam_left_rect_from_cam_left: rectification.cam_left_rect_from_cam_left,
            maps: Some([rectification.left, rectification.right]),
            kernels,
        })
    }

    /// The calibration of the raw images.
    pub fn raw_rig(&self) -> &StereoRig {
        &self.raw
    }

    /// Geometry of the rectified pair.
    pub fn geometry(&self) -> &RectifiedGeometry {
        &self.geometry
    }

    /// Size of the rectified image of a camera.
    pub fn size(&self, side: Side) -> ImageSize {
        self.size[side as usize]
    }

    /// The part of the rectified images that [`StereoRig::rectify`] gives: all of it if images are used unchanged.
    pub fn middle(&self) -> PixelWindow {
        self.middle
    }

    /// The rotation from the left camera to the rectified left camera.
    pub fn cam_left_rect_from_cam_left(&self) -> &Pose<CamLeftRect, CamLeft> {
        &self.cam_left_rect_from_cam_left
    }

    /// The kernels in use.
    pub fn kernels(&self) -> Kernels {
        self.kernels
    }

    /// Rejects raw images with a size other than the calibration's.
    ///
    /// # Errors
    /// An error with the camera and both sizes.
    pub fn check(&self, left: ImageView<'_>, right: ImageView<'_>) -> Result<(), EstimationError> {
        check_image_sizes(&self.raw, left, right)
    }

    /// Maps a region of the raw left image to the rectified left image; uses the memory of `buffer`.
    ///
    /// # Errors
    /// A mask with a size other than the left image's.
    pub fn rectified_region<'a>(
        &self,
        raw: &'a RegionMask,
        buffer: &'a mut RegionMask,
    ) -> Result<&'a RegionMask, EstimationError> {
        let Some([map, _]) = &self.maps else { return Ok(raw) };
        if raw.size() != map.source_size() {
            return Err(RemapError::SourceSize { actual: raw.size(), expected: map.source_size() }.into());
        }
        buffer.reset(map.size());
        if let Some(window) = raw.bbox().map(|bounds| rectified_window(map, &bounds)) {
            map_region(map, raw, &window, self.kernels, buffer);
        }
        Ok(buffer)
    }

    /// Maps a raw left pixel to the rectified left image.
    ///
    /// # Errors
    /// A pixel without a ray.
    pub fn rectified_left_pixel(&self, raw_px: &Vector2<f64>) -> Result<Vector2<f64>, EstimationError> {
        if self.maps.is_none() {
            return Ok(*raw_px);
        }
        let ray = self.cam_left_rect_from_cam_left.transform_vector(&self.raw.left().unproject(raw_px)?);
        let g = &self.geometry;
        Ok((ray.xy() / ray.z).component_mul(&g.focal_px) + g.left_principal_px)
    }

    /// Whether raw images are resampled or used unchanged.
    pub fn resamples(&self) -> bool {
        self.maps.is_some()
    }

    /// Loads the channels of the part of `window` (rectified pixels) inside the rectified image of a camera. `raw` is the
    /// unmodified image, with the size verified by [`Self::check`].
    pub fn load(&self, side: Side, raw: ImageView<'_>, window: PixelWindow, wanted: Wanted, out: &mut ColourPlanes) {
        match &self.maps {
            None => out.update(raw, window, wanted, self.kernels),
            Some(maps) => resample(&maps[side as usize], raw, window, wanted, self.kernels, out),
        }
    }

    /// As [`Self::load`] at the full size halved `halvings` times: `window` is in full-size pixels and starts on the grid of the
    /// halved ones.
    #[allow(clippy::too_many_arguments, reason = "image, window, channels and buffers")]
    pub(super) fn load_halved(
        &self,
        side: Side,
        raw: ImageView<'_>,
        window: PixelWindow,
        halvings: usize,
        wanted: Wanted,
        scratch: &mut HalvingScratch,
        out: &mut ColourPlanes,
    ) {
        let HalvingScratch { finer, coarser, reduced } = scratch;
        // The first image, and how often it remains to be halved.
        let (first, remaining) = if self.maps.is_some() {
            let unit = self.unit(halvings);
            let size = self.size(side);
            let window = window.clipped(size.width, size.height).reduced(unit);
            if unit == 1 << halvings {
                return self.load_reduced(side, raw, window, unit, wanted, reduced, out);
            }
            self.load_reduced(side, raw, window, unit, wanted, reduced, finer);
            (finer, halvings - unit.ilog2() as usize)
        } else if wanted == Wanted::Luminance {
            if halvings == 1 {
                return out.update_halved(raw, window, self.kernels);
            }
            finer.update_halved(raw, window, self.kernels);
            (finer, halvings - 1)
        } else {
            finer.update(raw, window, wanted, self.kernels);
            (finer, halvings)
        };
        for _ in 1..remaining {
            halve_planes(first, self.kernels, coarser);
            std::mem::swap(first, coarser);
        }
        halve_planes(first, self.kernels, out);
    }

    /// Side of the squares of raw pixels, of which images that are halved so often are resampled.
    pub(super) fn unit(&self, halvings: usize) -> usize {
        if self.maps.is_some() { REDUCTION_MAX.min(1 << halvings) } else { 1 }
    }

    /// Resamples means over squares of `unit` x `unit` pixels; `window` is in such squares. Only for images that are resampled.
    #[allow(clippy::too_many_arguments, reason = "image, window, channels and buffers")]
    pub fn load_reduced(
        &self,
        side: Side,
        raw: ImageView<'_>,
        window: PixelWindow,
        unit: usize,
        wanted: Wanted,
        reduced: &mut ReducedImage,
        out: &mut ColourPlanes,
    ) {
        match &self.maps {
            Some(maps) if unit > 1 => {
                let map = maps[side as usize].reduced(unit as u32);
                resample_reduced(&map, raw, window, unit, wanted, self.kernels, reduced, out);
            }
            _ => self.load(side, raw, window, wanted, out),
        }
    }

    /// A raw camera.
    pub fn raw_camera(&self, side: Side) -> &Camera {
        match side {
            Side::Left => self.raw.left(),
            Side::Right => self.raw.right(),
        }
    }
}

/// Distance of the points on the border of a region's box that are mapped, pixels. Chosen by hand, not varied: between points
/// at this distance, lenses bend a straight line by less than [`BORDER_MARGIN_PX`].
const BORDER_STEP_PX: u32 = 8;
/// Margin around the mapped border, pixels: bending between its points, and rounding.
const BORDER_MARGIN_PX: f64 = 2.0;

/// The window of a whole image.
fn whole(size: ImageSize) -> PixelWindow {
    PixelWindow { x: 0, y: 0, width: size.width as usize, height: size.height as usize }
}

/// A window of the rectified image that contains the mapped `bounds`: the whole image if a part of their border has no
/// rectified pixel.
fn rectified_window(map: &PixelMap, bounds: &PixelBox) -> PixelWindow {
    let size = map.size();
    let (right, bottom) = (bounds.x + bounds.width - 1, bounds.y + bounds.height - 1);
    let along = |first: u32, last: u32| (first..last).step_by(BORDER_STEP_PX as usize).chain([last]);
    let rows = along(bounds.x, right).flat_map(|x| [(x, bounds.y), (x, bottom)]);
    let columns = along(bounds.y, bottom).flat_map(|y| [(bounds.x, y), (right, y)]);
    let (mut low, mut high) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
    for (x, y) in rows.chain(columns) {
        let Some(pixel) = map.destination(&Vector2::new(f64::from(x), f64::from(y))) else {
            return whole(size);
        };
        (low, high) = (low.inf(&pixel), high.sup(&pixel));
    }
    let span = |axis: usize, length: u32| {
        let limit = |px: f64| px.clamp(0.0, f64::from(length));
        let first = limit((low[axis] - BORDER_MARGIN_PX).floor());
        let end = limit((high[axis] + BORDER_MARGIN_PX).ceil() + 1.0);
        (first as i32, (end - first).max(0.0) as usize)
    };
    let ((x, width), (y, height)) = (span(0, size.width), span(1, size.height));
    PixelWindow { x, y, width, height }
}

/// Adds the pixels of `window` whose nearest raw pixel is in `raw`.
fn map_region(map: &PixelMap, raw: &RegionMask, window: &PixelWindow, kernels: Kernels, out: &mut RegionMask) {
    for_each_cell(map, window, kernels, |(x, y), positions| {
        let Some(positions) = positions else { return };
        let size = (CELL.min(window.width - x), CELL.min(window.height - y));
        let [columns, rows] = positions.nearest_box(kernels);
        let coverage = raw.coverage(columns, rows);
        if coverage == Coverage::None {
            return;
        }
        for row in 0..size.1 {
            let mut insert = |first: usize, end: usize| {
                let pixel = |column: usize| i64::from(window.x) + (x + column) as i64;
                out.insert_span(i64::from(window.y) + (y + row) as i64, pixel(first), pixel(end) - 1);
            };
            if coverage == Coverage::All {
                insert(0, size.0);
                continue;
            }
            let [columns, rows] = positions.nearest(row, kernels);
            let mut first = None;
            for column in 0..size.0 {
                match (raw.contains(columns[column], rows[column]), first) {
                    (true, None) => first = Some(column),
                    (false, Some(start)) => {
                        insert(start, column);
                        first = None;
                    }
                    _ => {}
                }
            }
            if let Some(start) = first {
                insert(start, size.0);
            }
        }
    });
}

/// Channels and flags at half the size.
pub(super) fn halve_planes(finer: &ColourPlanes, kernels: Kernels, out: &mut ColourPlanes) {
    let window = finer.window.halved();
    let wanted = if finer.planes[1].width() > 0 { Wanted::Colour } else { Wanted::Luminance };
    out.resize(window, wanted);
    for (finer, out) in finer.planes.iter().zip(&mut out.planes) {
        finer.halve_into(out);
    }
    let fine_width = finer.window.width;
    for (y, out) in out.flags.chunks_exact_mut(window.width.max(1)).enumerate() {
        let (upper, lower) = finer.flags[2 * y * fine_width..(2 * y + 2) * fine_width].split_at(fine_width);
        halve_flags_row(kernels, upper, lower, out);
    }
}

wide! {
    fn halve_flags_row(upper: &[u8], lower: &[u8], out: &mut [u8]) = halve_flags_row_kernel;
}

#[inline(always)]
fn halve_flags_row_kernel(upper: &[u8], lower: &[u8], out: &mut [u8]) {
    let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
    for (out, (upper, lower)) in out.iter_mut().zip(pairs) {
        *out = (upper[0] | upper[1]) | (lower[0] | lower[1]);
    }
}

#[cfg(test)]
mod tests {
    use image::RgbImage;
    use nalgebra::Vector3;
    use pb3dp_estimation_test_support::every_kernel;
    use pb3dp_geometry::Distortion;
    use pb3dp_geometry::frames::CamRight;

    use super::super::colour_planes::OPPONENT_FROM_RGB;
    use super::*;

    fn rig(with_turn: bool) -> StereoRig {
        let size = ImageSize { width: 320, height: 240 };
        let camera = |f, cx| Camera::new(size, Pinhole { fx: f, fy: f, cx, cy: 121.0 }, Distortion::None).unwrap();
        let turn = if with_turn { Vector3::new(0.02, -0.05, 0.03) } else { Vector3::zeros() };
        let pose: Pose<CamRight, CamLeft> =
            Pose::from_parts(Vector3::new(-0.1, 0.0, 0.0), pb3dp_geometry::so3::exp(&turn));
        let right = if with_turn { camera(372.0, 150.0) } else { camera(360.0, 150.0) };
        StereoRig::new(camera(360.0, 163.0), right, pose).unwrap()
    }

    /// A smooth scene painted on the plane at infinity: every ray has a colour.
    fn paint(camera: &Camera, to_world: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> RgbImage {
        RgbImage::from_fn(320, 240, |x, y| {
            let ray = to_world(&camera.unproject(&Vector2::new(f64::from(x), f64::from(y))).unwrap());
            image::Rgb(colour(&ray).map(|c| c.round() as u8))
        })
    }

    fn colour(ray: &Vector3<f64>) -> [f64; 3] {
        let (x, y) = (ray.x / ray.z, ray.y / ray.z);
        [120.0 + 80.0 * (9.0 * x).sin(), 100.0 + 60.0 * (7.0 * y + 3.0 * x).cos(), 90.0 + 200.0 * x * y]
    }

    #[test]
    fn resampled_windows_show_the_scene_at_the_rectified_rays() {
        let rig = rig(true);
        let front = StereoFrontEnd::new(&rig, Kernels::best()).unwrap();
        let left = paint(rig.left(), |ray| *ray);
        let mut planes = ColourPlanes::default();
        let window = PixelWindow { x: 90, y: 60, width: 120, height: 110 };
        front.load(Side::Left, (&left).into(), window, Wanted::Colour, &mut planes);
        let back = front.cam_left_rect_from_cam_left().inverse();
        let (mut worst, mut counted) = (0.0_f64, 0);
        for (x, y) in (0..120).flat_map(|x| (0..110).map(move |y| (x, y))).filter(|(x, y)| (x + y) % 7 == 0) {
            if planes.flags[y * 120 + x] != 0 {
                continue;
            }
            counted += 1;
            let ray = front.geometry().left_ray(&Vector2::new((x + 90) as f64, (y + 60) as f64));
            let rgb = colour(&back.transform_vector(&ray));
            for (plane, turn) in planes.planes.iter().zip(OPPONENT_FROM_RGB) {
                let expected: f64 = turn.iter().zip(rgb).map(|(m, c)| f64::from(*m) * c).sum();
                worst = worst.max((f64::from(plane.row(y)[x]) - expected).abs());
            }
        }
        assert!(counted > 1500 && worst < 1.0, "{counted} pixels, off by {worst}");
    }

    #[test]
    fn a_rectified_pair_is_used_as_it_is() {
        let rig = rig(false);
        let front = StereoFrontEnd::new(&rig, Kernels::best()).unwrap();
        let left = paint(rig.left(), |ray| *ray);
        let mut planes = ColourPlanes::default();
        let window = PixelWindow { x: 310, y: 10, width: 40, height: 5 };
        front.load(Side::Left, (&left).into(), window, Wanted::Luminance, &mut planes);
        assert_eq!(planes.window.width, 10);
        let pixel = left.get_pixel(313, 12).0;
        let sum: f32 = pixel.iter().map(|&c| f32::from(c)).sum();
        assert!((planes.luminance().row(2)[3] - sum / 3f32.sqrt()).abs() < 1e-3);
        assert_eq!(front.geometry().disparity_offset_px, 150.0 - 163.0);
        let at = Vector2::new(7.25, 8.5);
        assert_eq!(front.rectified_left_pixel(&at).unwrap(), at);
    }

    #[test]
    fn regions_and_pixels_go_through_the_same_map() {
        let front = StereoFrontEnd::new(&rig(true), Kernels::best()).unwrap();
        let size = ImageSize { width: 320, height: 240 };
        let raw = RegionMask::from_fn(size, |x, y| (140..190).contains(&x) && (80..121).contains(&y));
        let centre = front.rectified_left_pixel(&raw.centroid_px().unwrap()).unwrap();
        let mut buffer = RegionMask::default();
        let mapped = front.rectified_region(&raw, &mut buffer).unwrap().centroid_px().unwrap();
        assert!((mapped - centre).norm() < 1.0, "{mapped} {centre}");
    }

    /// A ring, a part of which may be outside the image.
    fn ring(centre: (f64, f64), radii: (f64, f64)) -> RegionMask {
        RegionMask::from_fn(ImageSize { width: 320, height: 240 }, |x, y| {
            let radius = (f64::from(x) - centre.0).hypot(f64::from(y) - centre.1);
            (radii.0..radii.1).contains(&radius)
        })
    }

    #[test]
    fn regions_are_those_of_the_map_of_the_whole_image() {
        let size = ImageSize { width: 320, height: 240 };
        let brown = Distortion::BrownConrady5 { coefficients: [-0.24, 0.09, 0.0011, -0.0007, -0.01] };
        let fisheye = Distortion::Equidistant { coefficients: [0.02, -0.011, 0.004, -0.001] };
        for (focal_px, distortion) in [(360.0, brown), (182.0, fisheye), (110.0, fisheye)] {
            let camera =
                |fx: f64| Camera::new(size, Pinhole { fx, fy: 0.98 * fx, cx: 163.0, cy: 117.0 }, distortion).unwrap();
            let turn = pb3dp_geometry::so3::exp(&Vector3::new(0.02, -0.05, 0.03));
            let pose: Pose<CamRight, CamLeft> = Pose::from_parts(Vector3::new(-0.1, 0.003, 0.0), turn);
            let rig = StereoRig::new(camera(focal_px), camera(1.02 * focal_px), pose).unwrap();
            let map = rig.rectify().unwrap().covering_field().unwrap().left.table();
            let mut results = vec![RegionMask::default(); every_kernel().count()];
            for (centre, radii) in
                [((150.0, 110.0), (0.0, 60.0)), ((150.0, 90.0), (9.0, 31.0)), ((300.0, 30.0), (0.0, 45.0))]
            {
                let raw = ring(centre, radii);
                let bytes = (0..240).flat_map(|y| (0..320).map(move |x| (x, y)));
                let bytes: Vec<u8> = bytes.map(|(x, y)| 255 * u8::from(raw.contains(x, y))).collect();
                let mut expected = vec![0; (map.size().width * map.size().height) as usize];
                map.remap_mask(&bytes, size, &mut expected).unwrap();
                let (mut inside, mut other) = (0, 0);
                for (kernels, buffer) in every_kernel().zip(&mut results) {
                    let front = StereoFrontEnd::new(&rig, kernels).unwrap();
                    front.rectified_region(&raw, buffer).unwrap();
                }
                assert!(results.iter().all(|result| *result == results[0]));
                for (i, expected) in expected.iter().enumerate() {
                    let (x, y) = (i as u32 % map.size().width, i as u32 / map.size().width);
                    inside += usize::from(*expected != 0);
                    // The map of the whole image ends at the centres of the outermost pixels.
                    let is_other = results[0].contains(x as i32, y as i32) != (*expected != 0);
                    other += usize::from(is_other && map.source(x, y).is_some());
                }
                // It rounds to 1/256 px.
                assert!(inside > 1000 && other <= 4 + inside / 500, "{focal_px} {centre:?}: {other} of {inside}");
            }
        }
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let front = StereoFrontEnd::new(&rig(false), Kernels::best()).unwrap();
        let error = front.check((&RgbImage::new(320, 240)).into(), (&RgbImage::new(320, 239)).into()).unwrap_err();
        assert!(error.to_string().starts_with("the right image is 320x239"), "{error}");
    }
}
