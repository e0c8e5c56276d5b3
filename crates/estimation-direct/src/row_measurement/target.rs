//! Rows of a target whose place in the right image is known but for errors of the rig.

use nalgebra::{Vector2, Vector3, Vector6};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::region::{Region, RegionConfig, RegionMask};
use pb3dp_estimation_core::rig_errors::{OFFSET, ROLL, RigErrors, SCALE};
use pb3dp_estimation_core::row_offset::RowOffset;
use pb3dp_estimation_views::colour_planes::Wanted;
use pb3dp_estimation_views::disparity_plane::{DisparityRange, RectifiedGeometry};
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionPyramid};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, CamLeftRect};

use super::{RowMatch, RowMeter, SPREAD_DOUBT_PX, fit, median};

/// Searches on a target, of which the one with the most points counts: the level, and the rows of this level on either side of the expected one.
/// Chosen by hand, not varied: patches are small enough for few to cross the edge of the target.
const SEARCHES: [(usize, i64); 2] = [(1, 4), (0, 4)];
/// How far the disparity of a point may be from that of the target's plane, pixels, and share of the disparity. Chosen by hand, not varied: wide
/// enough for targets that are no plane, and less than the period of most patterns.
const NEAR_PX: f64 = 4.0;
const NEAR_SHARE: f64 = 0.05;
/// Depths of a region, as shares of the known one; the level of its search, and rows of this level on either side; matches that it needs; and the
/// smallest standard deviation of its row offset, pixels. Chosen by hand, not varied: 20 px of rows are 40 ms at 300 mm/s and 0.5 m.
const DEPTH_SHARES: [f64; 2] = [0.8, 1.3];
const REGION_SEARCH: (usize, i64) = (1, 10);
const REGION_MATCHES_MIN: usize = 6;
const REGION_SIGMA_MIN_PX: f64 = 0.02;

/// A target, as an estimate knows it.
#[derive(Clone, Copy, Debug)]
pub struct KnownTarget<'a> {
    /// Its pixels in the raw left image.
    pub region: &'a Region,
    /// Its plane in `cam_left`: 1/depth on a ray `d` (third component 1) is `q . d`, 1/m.
    pub inverse_depth_plane: Vector3<f64>,
    /// Where its rows are believed to be in the rectified pair, apart from its motion: right row minus left row, pixels.
    pub row_offset_px: f64,
    /// Its motion from the left exposure to the right one.
    pub cam_left_later_from_cam_left: Pose<CamLeft, CamLeft>,
    /// How well that is known.
    pub motion_sigmas: MotionSigmas,
}

/// Standard deviations of a motion by what it does to the rows of a target: like an error of the rig. Tangents of angles, radians, and a ratio.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionSigmas {
    offset: f64,
    turn: f64,
    scale: f64,
}

impl MotionSigmas {
    /// Of an unknown motion `[rho; phi]` (metres, radians; axes of `cam_left`) of a target at a depth.
    pub fn of(motion: &Vector6<f64>, depth_m: f64) -> Self {
        let [_, y, z, _, _, turn] = (*motion).into();
        Self { offset: y / depth_m, turn, scale: z / depth_m }
    }

    fn added_to(self, errors: RigErrors) -> RigErrors {
        let mut covariance = errors.covariance;
        for (index, sigma) in [(OFFSET, self.offset), (ROLL, self.turn), (SCALE, self.scale)] {
            covariance[(index, index)] += sigma * sigma;
        }
        RigErrors { covariance, ..errors }
    }
}

/// Row offset of a part of the image, tangents of angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionRows {
    /// Right row minus left row.
    pub offset: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// Where a target should be in the rectified right image.
struct Expected {
    geometry: RectifiedGeometry,
    /// Inverse depth plane, and motion until the right exposure, in the rectified left camera.
    plane: Vector3<f64>,
    later_from_now: Pose<CamLeftRect, CamLeftRect>,
}

impl Expected {
    /// The right pixel of a left one; `None` if the target is not in front of the cameras there.
    fn right_px(&self, left_px: &Vector2<f64>) -> Option<Vector2<f64>> {
        let g = &self.geometry;
        let ray = g.left_ray(left_px);
        let inverse_depth = self.plane.dot(&ray);
        let later = self.later_from_now.transform_point(&(ray / inverse_depth).into());
        let pixel = (later.xy().coords / later.z).component_mul(&g.focal_px) + g.left_principal_px;
        let is_visible = inverse_depth > 0.0 && later.z > 0.0;
        is_visible.then(|| pixel - Vector2::new(g.disparity_px(later.z), 0.0))
    }

    /// Disparities of a point, pixels.
    fn near(&self, left_px: &Vector2<f64>) -> Option<DisparityRange> {
        let disparity_px = left_px.x - self.right_px(left_px)?.x;
        let reach = NEAR_PX.max(NEAR_SHARE * (disparity_px + self.geometry.disparity_offset_px).abs());
        Some(DisparityRange { lowest: disparity_px - reach, highest: disparity_px + reach })
    }

    /// The row offsets around a left pixel that the motion makes.
    fn moved_rows(&self, left_px: Vector2<f64>) -> Option<RowOffset> {
        let row_offset_px = |by: Vector2<f64>| {
            let at = left_px + by;
            Some((self.right_px(&at)?, self.right_px(&at)?.y - at.y))
        };
        let (centre_px, offset_px) = row_offset_px(Vector2::zeros())?;
        let slope = Vector2::new(row_offset_px(Vector2::x())?.1, row_offset_px(Vector2::y())?.1).add_scalar(-offset_px);
        Some(RowOffset { centre_px, offset_px, slope })
    }
}

impl RowMeter {
    /// What the rows of a target show of the rig, with its motion between both exposures taken out. Without enough points as
    /// [`Self::measure`].
    pub fn measure_target(&self, images: (ImageView<'_>, ImageView<'_>), target: &KnownTarget<'_>) -> RigErrors {
        self.target_matches(images, target).map_or(self.nothing, |matches| {
            let found = fit(&matches, self.front_end.geometry(), self.nothing);
            if found.spread_px > SPREAD_DOUBT_PX { self.nothing } else { target.motion_sigmas.added_to(found) }
        })
    }

    fn target_matches(
        &self,
        images: (ImageView<'_>, ImageView<'_>),
        target: &KnownTarget<'_>,
    ) -> Option<Vec<RowMatch>> {
        let geometry = *self.front_end.geometry();
        let rect_from_left = self.front_end.cam_left_rect_from_cam_left();
        let expected = Expected {
            geometry,
            plane: rect_from_left.transform_vector(&target.inverse_depth_plane),
            later_from_now: *rect_from_left * target.cam_left_later_from_cam_left * rect_from_left.inverse(),
        };
        let mut buffer = RegionMask::default();
        let raw = target.region.rasterize(images.0, &RegionConfig::default()).ok()?;
        let region = self.front_end.rectified_region(&raw, &mut buffer).ok()?;
        let bounds = region.bbox()?;
        let first = Vector2::new(f64::from(bounds.x), f64::from(bounds.y));
        let last = first + Vector2::new(f64::from(bounds.width - 1), f64::from(bounds.height - 1));
        let moved = expected.moved_rows(0.5 * (first + last))?;
        let corners = [first, Vector2::new(last.x, first.y), Vector2::new(first.x, last.y), last];
        let ranges = || corners.iter().filter_map(|corner| expected.near(corner));
        let disparity_px = DisparityRange {
            lowest: ranges().map(|range| range.lowest).fold(f64::INFINITY, f64::min),
            highest: ranges().map(|range| range.highest).fold(f64::NEG_INFINITY, f64::max),
        };
        let rows = RowOffset { offset_px: moved.offset_px + target.row_offset_px, ..moved };
        let source = source_of_region(images, region, disparity_px, rows);
        let mut pyramid = RegionPyramid::default();
        pyramid.update(&self.front_end, &source);
        let mut matches = Vec::new();
        for search in SEARCHES {
            let (found, _) = self.matches(&rows, |px| expected.near(px), search, &pyramid);
            if found.len() > matches.len() {
                matches = found;
            }
        }
        // The motion has moved them.
        matches.retain_mut(|found| {
            let expected_px = expected.right_px(&found.left_px);
            found.right_px.y -= expected_px.map_or(0.0, |px| px.y - found.left_px.y);
            expected_px.is_some()
        });
        Some(matches)
    }

    /// The row offset of a part of the left image at a known depth. `None` if too few points are found.
    pub fn measure_region(
        &self,
        images: (ImageView<'_>, ImageView<'_>),
        outline_px: &[Vector2<f64>],
        depth_m: f64,
    ) -> Option<RegionRows> {
        let (front_end, geometry) = (&self.front_end, self.front_end.geometry());
        front_end.check(images.0, images.1).ok()?;
        let region = Region::Polygon { vertices_px: outline_px.to_vec() };
        let raw = region.rasterize(images.0, &RegionConfig::default()).ok()?;
        let mut buffer = RegionMask::default();
        let region = front_end.rectified_region(&raw, &mut buffer).ok()?;
        let [near, far] = DEPTH_SHARES.map(|share| geometry.disparity_px(depth_m * share));
        let disparity_px = DisparityRange { lowest: far, highest: near };
        let rows = RowOffset::default();
        let mut pyramid = RegionPyramid::default();
        pyramid.update(front_end, &source_of_region(images, region, disparity_px, rows));
        let (matches, _) = self.matches(&rows, |_| Some(disparity_px), REGION_SEARCH, &pyramid);
        let focal_px = geometry.focal_px.y;
        let offsets = || matches.iter().map(|found| found.offset_px() / focal_px);
        let offset = median(offsets().collect());
        let spread = 1.4826 * median(offsets().map(|own| (own - offset).abs()).collect());
        // The median of a normal distribution has pi / 2 times the variance of the mean.
        let sigma = (std::f64::consts::FRAC_PI_2 / matches.len() as f64).sqrt() * spread;
        (matches.len() >= REGION_MATCHES_MIN)
            .then_some(RegionRows { offset, sigma: sigma.max(REGION_SIGMA_MIN_PX / focal_px) })
    }
}

fn source_of_region<'a>(
    (left, right): (ImageView<'a>, ImageView<'a>),
    region: &'a RegionMask,
    disparity_px: DisparityRange,
    rows: RowOffset,
) -> PyramidSource<'a> {
    PyramidSource { left, right, region, disparity_px, rows, wanted: Wanted::Luminance, search_area_px: usize::MAX }
}
