//! Expected accuracy of a stereo rig from its geometry alone, for choosing cameras, lenses and baseline before buying them.
//!
//! The rig has two equal, parallel cameras without distortion, side by side. The target is a flat square that faces the
//! cameras, midway between their axes. docs/rig.md derives the formulas. [`plane_sigma`] propagates disparity errors to depth
//! and normal, as for measured planes.

use nalgebra::{Matrix3, Vector2};
use pb3dp_estimation_direct::cramer_rao::{
    PlaneSigma, calibration_covariance, pixel_disparity_sigma, plane_sigma, rectangle_information,
};
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, RectifiedGeometry};
use pb3dp_geometry::ImageSize;

/// A stereo rig of two equal, parallel cameras with centred principal points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoHead {
    /// Distance between the optical centres, metres.
    pub baseline_m: f64,
    /// Focal length, pixels.
    pub focal_px: f64,
    /// Size of each image.
    pub size: ImageSize,
}

/// Standard deviation of the disparity of a single pixel, from its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PixelNoise {
    /// Derived from noise and texture of the images.
    Image {
        /// Standard deviation of a pixel of each image, grey levels.
        noise_grey: f64,
        /// Root mean square of the gradient along rows, all channels together, grey levels per pixel.
        gradient_grey_per_px: f64,
    },
    /// Given by a measurement.
    Disparity {
        /// Standard deviation of one pixel's disparity, independent of its neighbours, pixels.
        sigma_px: f64,
    },
}

impl PixelNoise {
    /// Standard deviation of the disparity of one pixel, pixels.
    pub fn disparity_sigma_px(&self) -> f64 {
        match *self {
            Self::Image { noise_grey, gradient_grey_per_px } => pixel_disparity_sigma(noise_grey, gradient_grey_per_px),
            Self::Disparity { sigma_px } => sigma_px,
        }
    }
}

/// Target, noise and timing of the planned view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Side of the square target, metres.
    pub target_m: f64,
    /// Noise of one pixel's disparity.
    pub noise: PixelNoise,
    /// Residual calibration error, pixels of disparity: at the target's centre and, as a slope, over half its side.
    pub calibration_px: f64,
    /// Speed of the target relative to the cameras, along the baseline, metres per second.
    pub speed_m_per_s: f64,
    /// Exposure time, seconds.
    pub exposure_s: f64,
    /// Time between the mid-exposures of the two cameras, seconds.
    pub skew_s: f64,
}

/// Focus of a lens (thin-lens model).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Pixel pitch of the sensor, metres.
    pub pixel_m: f64,
    /// f-number: focal length over the diameter of the aperture.
    pub f_number: f64,
    /// Focus distance, metres from the lens.
    pub focused_at_m: f64,
}

impl Lens {
    /// Focal length of the lens, metres, for a focal length in pixels. The focal length in pixels gives the distance from the
    /// lens to the sensor, which is longer than the focal length of the lens by the focus extension.
    pub fn focal_m(&self, focal_px: f64) -> f64 {
        let to_sensor_m = focal_px * self.pixel_m;
        to_sensor_m * self.focused_at_m / (to_sensor_m + self.focused_at_m)
    }

    /// Diameter of the blur disc of a point at this depth, pixels.
    pub fn defocus_px(&self, focal_px: f64, z_m: f64) -> f64 {
        let aperture_m = self.focal_m(focal_px) / self.f_number;
        focal_px * aperture_m * (1.0 / z_m - 1.0 / self.focused_at_m).abs()
    }
}

/// Standard deviations of depth and normal of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedErrors {
    /// Lower bound from the image noise.
    pub noise: PlaneSigma,
    /// Contribution of the calibration error: identical in all images of one pose.
    pub calibration: PlaneSigma,
    /// Image noise and calibration combined.
    pub both: PlaneSigma,
}

/// Expected accuracy of the rig at one distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedView {
    /// The distance, metres.
    pub z_m: f64,
    /// Left column minus right column, pixels.
    pub disparity_px: f64,
    /// Depth change per pixel of disparity, metres.
    pub depth_per_px_m: f64,
    /// Share of one camera's field of view at this distance that the other camera sees as well, 0 to 1.
    pub overlap_share: f64,
    /// Side of the target, pixels.
    pub target_px: f64,
    /// Errors of the target's pose; `None` if the target is not entirely in both images.
    pub errors: Option<PlannedErrors>,
    /// Motion blur: motion of the target during the exposure, pixels.
    pub blur_px: f64,
    /// Exposure time during which the target moves by one pixel, seconds; infinite if it is stationary.
    pub one_pixel_exposure_s: f64,
    /// Motion between the two exposures, pixels: of disparity along the baseline, of rows across it.
    pub skew_px: f64,
    /// Depth error due to this motion, metres.
    pub skew_depth_m: f64,
}

impl StereoHead {
    /// The image geometry of this rig.
    pub fn geometry(&self) -> RectifiedGeometry {
        let middle = |pixels: u32| 0.5 * (f64::from(pixels) - 1.0);
        RectifiedGeometry {
            focal_px: Vector2::new(self.focal_px, self.focal_px),
            left_principal_px: Vector2::new(middle(self.size.width), middle(self.size.height)),
            disparity_offset_px: 0.0,
            baseline_m: self.baseline_m,
        }
    }

    /// Fields of view, horizontal and vertical, radians.
    pub fn view_rad(&self) -> [f64; 2] {
        [self.size.width, self.size.height].map(|pixels| 2.0 * (0.5 * f64::from(pixels) / self.focal_px).atan())
    }

    /// Shortest distance at which a square of this side is entirely in both images, midway between the cameras, metres.
    pub fn nearest_in_both_m(&self, target_m: f64) -> f64 {
        let across_m = self.focal_px * (target_m + self.baseline_m) / f64::from(self.size.width);
        let down_m = self.focal_px * target_m / f64::from(self.size.height);
        across_m.max(down_m)
    }

    /// Expected accuracy at a distance. All lengths and times must be positive or zero, and `z_m` positive.
    pub fn at(&self, z_m: f64, conditions: &Conditions) -> PlannedView {
        let geometry = self.geometry();
        let disparity_px = geometry.disparity_px(z_m);
        let target_px = self.focal_px * conditions.target_m / z_m;
        let middle_px = geometry.left_principal_px + Vector2::new(0.5 * disparity_px, 0.0);
        let plane = DisparityPlane { centre_px: middle_px, d0_px: disparity_px, slope: Vector2::zeros() };
        let sigma = |covariance: &Matrix3<f64>| plane_sigma(covariance, &plane, &geometry);
        let depth_of_m = |pixels: f64| {
            let shifted = Matrix3::from_diagonal(&nalgebra::Vector3::new(pixels * pixels, 0.0, 0.0));
            sigma(&shifted).map_or(f64::NAN, |sigma| sigma.depth_m)
        };
        let errors = || {
            let side_px = Vector2::new(target_px, target_px);
            let noise = rectangle_information(&side_px, conditions.noise.disparity_sigma_px()).try_inverse()?;
            let calibration = calibration_covariance(conditions.calibration_px, &(0.5 * side_px));
            Some(PlannedErrors {
                noise: sigma(&noise)?,
                calibration: sigma(&calibration)?,
                both: sigma(&(noise + calibration))?,
            })
        };
        let speed_px_per_s = self.focal_px * conditions.speed_m_per_s / z_m;
        let skew_px = speed_px_per_s * conditions.skew_s;
        PlannedView {
            z_m,
            disparity_px,
            depth_per_px_m: depth_of_m(1.0),
            overlap_share: (1.0 - disparity_px / f64::from(self.size.width)).max(0.0),
            target_px,
            errors: (z_m >= self.nearest_in_both_m(conditions.target_m)).then(errors).flatten(),
            blur_px: speed_px_per_s * conditions.exposure_s,
            one_pixel_exposure_s: 1.0 / speed_px_per_s,
            skew_px,
            skew_depth_m: depth_of_m(skew_px),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const HEAD: StereoHead =
        StereoHead { baseline_m: 0.1, focal_px: 740.0, size: ImageSize { width: 640, height: 480 } };

    fn conditions() -> Conditions {
        Conditions {
            target_m: 0.11,
            noise: PixelNoise::Image { noise_grey: 3.0, gradient_grey_per_px: 8.0 },
            calibration_px: 0.1,
            speed_m_per_s: 0.08,
            exposure_s: 0.004,
            skew_s: 0.001,
        }
    }

    /// The closed forms of docs/method.md and docs/rig.md, and a plane with an error of a tenth of a pixel at its edges, by
    /// hand.
    #[test]
    fn figures_are_those_of_the_closed_forms() {
        let view = HEAD.at(0.5, &conditions());
        let close = |value: f64, expected: f64| assert!((value / expected - 1.0).abs() < 1e-3, "{value}, {expected}");
        close(view.disparity_px, 148.0);
        close(view.depth_per_px_m, 0.25 / 74.0);
        close(view.target_px, 162.8);
        let errors = view.errors.unwrap();
        close(errors.calibration.depth_m, 0.25 / 74.0 * 0.1);
        close(errors.noise.depth_m, 0.25 / 74.0 * (std::f64::consts::SQRT_2 * 3.0 / 8.0) / 162.8);
        // Slope over half the side, times z / b, about both axes.
        let tilt = 0.5 / 0.1 * (0.1 / 81.4);
        assert!((errors.calibration.normal_rad / (tilt * std::f64::consts::SQRT_2) - 1.0).abs() < 0.02);
        close(view.skew_depth_m, 0.5 * 0.08 * 0.001 / 0.1);
        close(view.blur_px, 740.0 * 0.08 * 0.004 / 0.5);
        close(view.one_pixel_exposure_s, 0.004 / view.blur_px);
        close(errors.both.depth_m, errors.noise.depth_m.hypot(errors.calibration.depth_m));
    }

    #[test]
    fn noise_grows_with_the_cube_of_the_distance() {
        let at = |z_m: f64| HEAD.at(z_m, &conditions()).errors.unwrap().noise;
        assert!((at(0.8).depth_m / at(0.4).depth_m - 8.0).abs() < 1e-6);
        assert!((at(0.8).normal_rad / at(0.4).normal_rad - 8.0).abs() < 0.1);
    }

    /// Corners of the square, projected by hand.
    #[test]
    fn the_nearest_distance_is_where_a_corner_leaves_an_image() {
        for (target_m, size) in [(0.11, HEAD.size), (0.11, ImageSize { width: 640, height: 200 })] {
            let head = StereoHead { size, ..HEAD };
            let nearest_m = head.nearest_in_both_m(target_m);
            let is_in_both = |z_m: f64| {
                let corner = |left_m: f64, sx: f64, sy: f64| {
                    let place = Vector3::new(0.05 - left_m + sx * 0.055, sy * 0.055, z_m);
                    let half = Vector2::new(f64::from(size.width), f64::from(size.height)) * 0.5;
                    let at = place.xy() * 740.0 / z_m;
                    at.x.abs() <= half.x && at.y.abs() <= half.y
                };
                [0.0, 0.1].iter().all(|&left| corner(left, -1.0, 1.0) && corner(left, 1.0, -1.0))
            };
            assert!(is_in_both(nearest_m * 1.001) && !is_in_both(nearest_m * 0.999), "{nearest_m}");
            let has_errors = |z_m: f64| head.at(z_m, &conditions()).errors.is_some();
            assert!(has_errors(nearest_m * 1.001) && !has_errors(nearest_m * 0.999));
        }
    }

    #[test]
    fn cameras_too_far_apart_share_nothing() {
        let head = StereoHead { baseline_m: 0.5, ..HEAD };
        let view = head.at(0.5, &conditions());
        assert_eq!((view.overlap_share, view.errors), (0.0, None));
        assert!((HEAD.at(0.5, &conditions()).overlap_share - (1.0 - 148.0 / 640.0)).abs() < 1e-12);
        let view = HEAD.view_rad().map(f64::to_degrees);
        assert!((view[0] - 46.77).abs() < 0.01 && (view[1] - 35.94).abs() < 0.01, "{view:?}");
    }

    #[test]
    fn what_rests_is_sharp() {
        let view = HEAD.at(0.5, &Conditions { speed_m_per_s: 0.0, ..conditions() });
        assert_eq!((view.blur_px, view.skew_depth_m, view.one_pixel_exposure_s), (0.0, 0.0, f64::INFINITY));
    }

    /// A thin lens of 4.8 mm at f/2, traced: the image of a point at z is at f z / (z - f) behind it.
    #[test]
    fn a_point_out_of_focus_is_a_disc() {
        let (focal_m, at_m, z_m) = (4.8e-3, 0.5, 0.3);
        let image_m = |z: f64| focal_m * z / (z - focal_m);
        let lens = Lens { pixel_m: 3e-6, f_number: 2.0, focused_at_m: at_m };
        let focal_px = image_m(at_m) / lens.pixel_m;
        assert!((lens.focal_m(focal_px) - focal_m).abs() < 1e-12);
        let disc_m = (focal_m / 2.0) * (image_m(z_m) - image_m(at_m)).abs() / image_m(z_m);
        let disc_px = disc_m / lens.pixel_m;
        assert!((lens.defocus_px(focal_px, z_m) - disc_px).abs() < 1e-9 * disc_px, "{disc_px}");
        assert_eq!(lens.defocus_px(focal_px, at_m), 0.0);
    }
}
