//! Front end: from raw images to channels of the rectified pair.
//!
//! Images of a rectified rig are used unchanged. Images of any other rig are resampled, window by window, with a cubic kernel
//! (Keys 1981, a = -1/2), which loses less sharpness than a linear one.

use std::borrow::Cow;

use image::RgbImage;
use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::{EstimationError, check_image_sizes};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::frames::{CamLeft, CamLeftRect};
use pb3dp_geometry::maps::RemapTable;
use pb3dp_geometry::{Camera, ImageSize, Pose, StereoRig};

use super::colour_planes::{ColourPlanes, OPPONENT_FROM_RGB, SATURATED, SATURATED_FROM, UNSEEN, Wanted};
use super::disparity_plane::RectifiedGeometry;
use super::image_plane::PixelWindow;

/// Creates windows of the rectified pair from raw images.
#[derive(Clone, Debug)]
pub struct StereoFrontEnd {
    raw: StereoRig,
    geometry: RectifiedGeometry,
    size: [ImageSize; 2],
    cam_left_rect_from_cam_left: Pose<CamLeftRect, CamLeft>,
    /// Left and right remap table, if the rig is not rectified.
    maps: Option<[RemapTable; 2]>,
    kernels: Kernels,
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
    /// Creates the front end of a calibrated rig. If the rig is not rectified it computes the maps, which takes some tens of
    /// milliseconds.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn new(rig: &StereoRig, kernels: Kernels) -> Result<Self, EstimationError> {
        if rig.is_rectified() {
            return Ok(Self {
                raw: *rig,
                geometry: RectifiedGeometry::of_rectified(rig),
                size: [rig.left().size(), rig.right().size()],
                cam_left_rect_from_cam_left: Pose::coincident(),
                maps: None,
                kernels,
            });
        }
        let rectification = rig.rectify()?;
        Ok(Self {
            raw: *rig,
            geometry: RectifiedGeometry::of_rectified(&rectification.rig),
            size: [rectification.rig.left().size(), rectification.rig.right().size()],
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
    pub fn check(&self, left: &RgbImage, right: &RgbImage) -> Result<(), EstimationError> {
        check_image_sizes(&self.raw, left, right)
    }

    /// Maps a region of the raw left image to the rectified left image.
    ///
    /// # Errors
    /// A mask with a size other than the left image's.
    pub fn rectified_region<'a>(&self, raw: &'a RegionMask) -> Result<Cow<'a, RegionMask>, EstimationError> {
        let Some([map, _]) = &self.maps else { return Ok(Cow::Borrowed(raw)) };
        let (source_size, size) = (raw.size(), map.size());
        let mut source = vec![0; source_size.width as usize * source_size.height as usize];
        raw.for_each(|x, y| source[(y * source_size.width + x) as usize] = 255);
        let mut destination = vec![0; size.width as usize * size.height as usize];
        map.remap_mask(&source, source_size, &mut destination)?;
        Ok(Cow::Owned(RegionMask::from_fn(size, |x, y| destination[(y * size.width + x) as usize] != 0)))
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
    pub fn load(&self, side: Side, raw: &RgbImage, window: PixelWindow, wanted: Wanted, out: &mut ColourPlanes) {
        match &self.maps {
            None => out.update(raw, window, wanted, self.kernels),
            Some(maps) => resample(&maps[side as usize], raw, window, wanted, out),
        }
    }

    /// As [`Self::load`] at half the size: `window` is in full-size pixels and starts at even ones.
    pub fn load_halved(
        &self,
        side: Side,
        raw: &RgbImage,
        window: PixelWindow,
        wanted: Wanted,
        scratch: &mut ColourPlanes,
        out: &mut ColourPlanes,
    ) {
        if self.maps.is_none() && wanted == Wanted::Luminance {
            out.update_halved(raw, window, self.kernels);
        } else {
            self.load(side, raw, window, wanted, scratch);
            halve_planes(scratch, self.kernels, out);
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

/// Rows of the identity, which leaves colours unchanged.
const PLAIN: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn resample(map: &RemapTable, raw: &RgbImage, window: PixelWindow, wanted: Wanted, out: &mut ColourPlanes) {
    let window = window.clipped(map.size().width, map.size().height);
    out.resize(window, wanted);
    let turns = if wanted == Wanted::Rgb { PLAIN } else { OPPONENT_FROM_RGB };
    for y in 0..window.height {
        for x in 0..window.width {
            let source = map.source((window.x as usize + x) as u32, (window.y as usize + y) as u32);
            let (rgb, flag) = source.and_then(|at| cubic(raw, &at)).unwrap_or(([0.0; 3], UNSEEN));
            for (plane, turn) in out.planes.iter_mut().zip(turns).take(wanted.planes()) {
                plane.row_mut(y)[x] = turn[0] * rgb[0] + turn[1] * rgb[1] + turn[2] * rgb[2];
            }
            out.flags[y * window.width + x] = flag;
        }
    }
}

/// The colour at a sub-pixel position, and whether a contributing pixel is saturated. `None` if the kernel extends beyond the
/// border.
fn cubic(raw: &RgbImage, at: &Vector2<f64>) -> Option<([f32; 3], u8)> {
    let (x, y) = (at.x.floor(), at.y.floor());
    let last = (f64::from(raw.width()) - 3.0, f64::from(raw.height()) - 3.0);
    if !(x >= 1.0 && y >= 1.0 && x <= last.0 && y <= last.1) {
        return None;
    }
    let (columns, rows) = (keys((at.x - x) as f32), keys((at.y - y) as f32));
    let stride = raw.width() as usize * 3;
    let start = (y as usize - 1) * stride + (x as usize - 1) * 3;
    let (mut sum, mut highest) = ([0.0_f32; 3], 0_u8);
    for (j, row_weight) in rows.iter().enumerate() {
        let row = &raw.as_raw()[start + j * stride..start + j * stride + 12];
        for (c, sum) in sum.iter_mut().enumerate() {
            let line = (0..4).map(|i| columns[i] * f32::from(row[3 * i + c])).sum::<f32>();
            *sum += row_weight * line;
        }
        highest = row.iter().copied().fold(highest, u8::max);
    }
    Some((sum, if highest >= SATURATED_FROM { SATURATED } else { 0 }))
}

/// Weights of the four neighbours at -1, 0, 1, 2 for a position `t` in 0..1 (Keys, "Cubic convolution interpolation for digital
/// image processing", 1981, a = -1/2).
fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [0.5 * (2.0 * t2 - t - t3), 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0), 0.5 * (4.0 * t2 + t - 3.0 * t3), 0.5 * (t3 - t2)]
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
    use nalgebra::Vector3;
    use pb3dp_geometry::frames::CamRight;
    use pb3dp_geometry::{Distortion, Pinhole};

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
        front.load(Side::Left, &left, window, Wanted::Colour, &mut planes);
        let back = front.cam_left_rect_from_cam_left().inverse();
        let (mut worst, mut seen) = (0.0_f64, 0);
        for (x, y) in (0..120).flat_map(|x| (0..110).map(move |y| (x, y))).filter(|(x, y)| (x + y) % 7 == 0) {
            if planes.flags[y * 120 + x] != 0 {
                continue;
            }
            seen += 1;
            let ray = front.geometry().left_ray(&Vector2::new((x + 90) as f64, (y + 60) as f64));
            let rgb = colour(&back.transform_vector(&ray));
            for (plane, turn) in planes.planes.iter().zip(OPPONENT_FROM_RGB) {
                let expected: f64 = turn.iter().zip(rgb).map(|(m, c)| f64::from(*m) * c).sum();
                worst = worst.max((f64::from(plane.row(y)[x]) - expected).abs());
            }
        }
        assert!(seen > 1500 && worst < 1.0, "{seen} pixels, off by {worst}");
    }

    #[test]
    fn a_rectified_pair_is_used_as_it_is() {
        let rig = rig(false);
        let front = StereoFrontEnd::new(&rig, Kernels::best()).unwrap();
        let left = paint(rig.left(), |ray| *ray);
        let mut planes = ColourPlanes::default();
        let window = PixelWindow { x: 310, y: 10, width: 40, height: 5 };
        front.load(Side::Left, &left, window, Wanted::Luminance, &mut planes);
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
        let mapped = front.rectified_region(&raw).unwrap().centroid_px().unwrap();
        assert!((mapped - centre).norm() < 1.0, "{mapped} {centre}");
    }

    #[test]
    fn the_kernel_interpolates_and_keeps_parabolas() {
        for t in [0.0_f32, 0.3, 0.77] {
            let value: f32 = keys(t).iter().zip([-1.0_f32, 0.0, 1.0, 2.0]).map(|(w, x)| w * (x * x - x + 4.0)).sum();
            assert!((value - (t * t - t + 4.0)).abs() < 1e-5);
        }
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let front = StereoFrontEnd::new(&rig(false), Kernels::best()).unwrap();
        let error = front.check(&RgbImage::new(320, 240), &RgbImage::new(320, 239)).unwrap_err();
        assert!(error.to_string().starts_with("the right image is 320x239"), "{error}");
    }
}
