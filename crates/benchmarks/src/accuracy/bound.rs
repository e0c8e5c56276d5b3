//! The Cramér-Rao bound: the smallest possible variance of an unbiased estimate of a plane from one stereo pair.
//!
//! Model: at a pixel x of the left image on the target, `I_R(W(x; q)) = g I_L(x) + o` but for noise, with the map W of
//! the plane q, gain g and offset o per channel. The left image is as noisy as the right one, so the difference of the two
//! has the variance `s^2 (1 + g^2)`. Then the information about q is
//!
//! ```text
//! A = sum over pixels and channels of  g^2 / (s^2 (1 + g^2))  j j^T,   j = (dI_L/dx)^T (dW/dx)^-1 dW/dq
//! ```
//!
//! minus the part that the unknown gain and offset of each channel take from it (Schur complement). Assumptions: white
//! normal noise of known variance (quantisation included, 1/12), an exact calibration, known target pixels, and
//! information from these pixels alone. Every pixel that shows only the target counts; pixels within 2 px of its outline
//! or of an occluder do not, nor do saturated ones. The outline itself, which could add information, is not used. Both
//! images are equally sharp.
//!
//! The gradient of the noise-free image is exact: the difference of two renderings whose left camera is moved by a
//! quarter of a pixel in either direction.

use anyhow::Context;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix3x2, RowVector3, Vector2, Vector3};
use pb3dp_geometry::{Camera, StereoRig};
use pb3dp_sim::raster::{GroundTruth, StereoRenderer};
use pb3dp_sim::scene::{Scene, ScenePoses};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::part::SceneObject;

use super::cell::{OFFSET_GREY, Setup};
use super::scenes::{moved, sensor};
use super::trial::across;

/// Displacement of the camera in either direction for a gradient, pixels.
const STEP_PX: f64 = 0.25;

/// Pixels closer than this to another object are not used, pixels.
const RIM_PX: usize = 2;

/// Variance of rounding to whole grey levels.
const QUANTISATION: f64 = 1.0 / 12.0;

/// One sample: a pixel of one channel.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Grey level of the left image.
    pub grey: f64,
    /// Derivative of the difference of the images with respect to the three plane parameters, for a gain of 1.
    pub slope: Vector3<f64>,
}

/// The information about the three parameters from one channel with unknown gain and offset; `variance` is that of the
/// noise in either image.
pub fn channel_information(samples: &[Sample], gain: f64, variance: f64) -> Matrix3<f64> {
    let weight = 1.0 / (variance * (1.0 + gain * gain));
    let (mut own, mut mixed, mut nuisance) = (Matrix3::zeros(), Matrix3x2::zeros(), Matrix2::zeros());
    for sample in samples {
        let slope = sample.slope * gain;
        let other = Vector2::new(sample.grey, 1.0);
        own += slope * slope.transpose() * weight;
        mixed += slope * other.transpose() * weight;
        nuisance += other * other.transpose() * weight;
    }
    match nuisance.try_inverse() {
        Some(inverse) => own - mixed * inverse * mixed.transpose(),
        // Without contrast the plane cannot be distinguished from gain and offset.
        None => Matrix3::zeros(),
    }
}

/// Covariance of (depth on `ray` in metres, the two tilts of [`across`] in radians) from that of the inverse-depth plane.
pub fn covariance_of_errors(plane: &Vector3<f64>, covariance: &Matrix3<f64>, ray: &Vector3<f64>) -> Matrix3<f64> {
    let z_m = 1.0 / plane.dot(ray);
    let [a, b] = across(&plane.normalize());
    let length = plane.norm();
    let jacobian = Matrix3::from_rows(&[
        RowVector3::from(-ray.transpose() * (z_m * z_m)),
        RowVector3::from(a.transpose() / length),
        RowVector3::from(b.transpose() / length),
    ]);
    jacobian * covariance * jacobian.transpose()
}

/// Computes the bound for poses of one setup.
pub struct BoundMaker {
    /// Renderers whose left camera is moved by -, + a step along u, and along v where needed.
    moved: Vec<StereoRenderer>,
    images: Vec<Vec<f32>>,
    rig: StereoRig,
    setup: Setup,
}

impl BoundMaker {
    /// For a set-up, its scene and the rig that the estimators receive.
    ///
    /// # Errors
    /// If the simulator rejects the setup.
    pub fn new(setup: &Setup, scene: &Scene, rig: &StereoRig) -> anyhow::Result<Self> {
        let sensor = SensorConfig { read_noise_grey: 0.0, ..sensor(setup) };
        let along_u = [Vector2::new(-STEP_PX, 0.0), Vector2::new(STEP_PX, 0.0)];
        let along_v = [Vector2::new(0.0, -STEP_PX), Vector2::new(0.0, STEP_PX)];
        // The v derivative does not matter if all disparities are horizontal.
        let steps = along_u.iter().chain(if rig.is_rectified() { &[] } else { &along_v[..] });
        let renderer = |by_px: &Vector2<f64>| {
            let left = moved(rig.left(), *by_px)?;
            let rig = StereoRig::new(left, *rig.right(), *rig.cam_right_from_cam_left())?;
            Ok(StereoRenderer::new(scene.clone(), rig, &sensor, 0)?.with_fine_sampling()?)
        };
        let moved = steps.map(renderer).collect::<anyhow::Result<Vec<_>>>().context("the moved cameras")?;
        Ok(Self { images: vec![Vec::new(); moved.len()], moved, rig: *rig, setup: *setup })
    }

    /// The covariance of an ideal estimate, in the form of [`covariance_of_errors`]. `None` if the scene does not
    /// determine the plane.
    pub fn bound(
        &mut self,
        poses: &ScenePoses,
        truth: &GroundTruth,
        plane: &Vector3<f64>,
        ray: &Vector3<f64>,
    ) -> Option<Matrix3<f64>> {
        for (renderer, image) in self.moved.iter_mut().zip(&mut self.images) {
            renderer.ideal_left(poses, image);
        }
        let map = PlaneMap { rig: &self.rig, plane: *plane };
        let mut samples: [Vec<Sample>; 3] = Default::default();
        for index in inner_pixels(truth) {
            let width = truth.size.width as usize;
            let pixel = Vector2::new((index % width) as f64, (index / width) as f64);
            let Some(displacement) = map.left_displacement(&pixel) else { continue };
            for (channel, samples) in samples.iter_mut().enumerate() {
                samples.extend(self.sample(3 * index + channel, channel, &displacement));
            }
        }
        let variance = self.setup.noise_grey * self.setup.noise_grey + QUANTISATION;
        let information: Matrix3<f64> = samples
            .iter()
            .zip(self.setup.gain)
            .map(|(samples, gain)| channel_information(samples, gain, variance))
            .sum();
        let covariance = information.try_inverse().filter(|c| c.iter().all(|x| x.is_finite()) && c[(0, 0)] > 0.0)?;
        Some(covariance_of_errors(plane, &covariance, ray))
    }

    /// The sample at an index of the images; `None` if it is saturated in either of them.
    fn sample(&self, at: usize, channel: usize, displacement: &Matrix2x3<f64>) -> Option<Sample> {
        let value = |k: usize| f64::from(self.images[k][at]);
        let grey = 0.5 * (value(0) + value(1));
        let in_right = grey * self.setup.gain[channel] + OFFSET_GREY[channel];
        if grey.max(in_right) > 252.0 || grey.min(in_right) < 2.0 {
            return None;
        }
        // A camera that moved by + shows the part of the scene on the - side.
        let slope = |minus: f64, plus: f64| (minus - plus) / (2.0 * STEP_PX);
        let along_v = if self.images.len() > 2 { slope(value(2), value(3)) } else { 0.0 };
        let gradient = Vector2::new(slope(value(0), value(1)), along_v);
        Some(Sample { grey, slope: displacement.transpose() * gradient })
    }
}

/// Indices of the pixels that show only the target, including blur.
fn inner_pixels(truth: &GroundTruth) -> Vec<usize> {
    let (width, height) = (truth.size.width as usize, truth.size.height as usize);
    let is_target = |index: usize| truth.object[index] == SceneObject::Target;
    let is_inner = |index: usize| {
        let (column, row) = (index % width, index / width);
        let inside = |at: usize, size: usize| (RIM_PX..size - RIM_PX).contains(&at);
        inside(column, width)
            && inside(row, height)
            && (row - RIM_PX..=row + RIM_PX)
                .all(|r| (column - RIM_PX..=column + RIM_PX).all(|c| is_target(r * width + c)))
    };
    (0..truth.object.len()).filter(|&index| is_target(index) && is_inner(index)).collect()
}

/// The map between the raw images that a plane induces.
struct PlaneMap<'a> {
    rig: &'a StereoRig,
    plane: Vector3<f64>,
}

impl PlaneMap<'_> {
    /// Displacement, with the plane, of the left pixel that corresponds to a fixed right pixel: `(dW/dx)^-1 dW/dq`.
    fn left_displacement(&self, pixel: &Vector2<f64>) -> Option<Matrix2x3<f64>> {
        let ray = self.rig.left().unproject(pixel).ok()?;
        let ray_slopes = ray_slopes(self.rig.left(), pixel)?;
        let inverse_depth = self.plane.dot(&ray);
        if inverse_depth <= 0.0 {
            return None;
        }
        let cam_right_from_cam_left = self.rig.cam_right_from_cam_left();
        let in_right = cam_right_from_cam_left.transform_point(&(ray / inverse_depth).into());
        let (_, projection) = self.rig.right().project_with_jacobian(&in_right)?;
        let turned = projection * cam_right_from_cam_left.rotation_matrix();
        let by_plane = turned * (-ray * ray.transpose() / (inverse_depth * inverse_depth));
        let by_ray =
            Matrix3::identity() / inverse_depth - ray * self.plane.transpose() / (inverse_depth * inverse_depth);
        let by_pixel = turned * by_ray * ray_slopes;
        Some(by_pixel.try_inverse()? * by_plane)
    }
}

/// Derivative of the ray of a pixel with respect to the pixel.
fn ray_slopes(camera: &Camera, pixel: &Vector2<f64>) -> Option<Matrix3x2<f64>> {
    let ray = camera.unproject(pixel).ok()?;
    // The inverse of the projection's Jacobian, on the plane z = 1.
    let (_, projection) = camera.project_with_jacobian(&ray.into())?;
    let inverse = projection.fixed_columns::<2>(0).into_owned().try_inverse()?;
    Some(Matrix3x2::from_rows(&[inverse.row(0).into(), inverse.row(1).into(), [0.0, 0.0].into()]))
}

#[cfg(test)]
#[path = "bound_tests.rs"]
mod tests;
