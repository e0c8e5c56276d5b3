//! Runs the methods on every pose of a configuration.

use anyhow::Context;
use image::RgbImage;
use nalgebra::{Matrix3, Vector3};
use pb3dp_benchmarks::parallel::in_parallel;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;
use pb3dp_estimation_core::region::RegionConfig;
use pb3dp_estimation_core::status::Status;
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::Scene;

use super::bound::BoundMaker;
use super::cell::{Cell, Question};
use super::random::hash_of;
use super::scenes::{Rigs, SceneStore, rigs, sensor};
use super::trial::{PlaneErrors, Trial, plane_errors, trial};
use pb3dp_hal_platform::cpu_time::timed;

/// Answer of one method for one pose.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Its status.
    pub status: Status,
    /// Errors of the plane; `None` without a plane.
    pub errors: Option<PlaneErrors>,
    /// Squared error, normalised by the method's covariance, over its expected value 3; `None` without a covariance.
    pub normalised_error: Option<f64>,
    /// CPU time, milliseconds.
    pub cpu_millis: f64,
}

/// One pose.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The Cramér-Rao bound as a covariance of (depth, two tilts); `None` if the scene does not determine the plane.
    pub bound: Option<Matrix3<f64>>,
    /// One outcome per method.
    pub outcomes: Vec<Outcome>,
}

/// Options of a measurement.
#[derive(Clone, Debug)]
pub struct Options {
    /// The methods.
    pub methods: Vec<Method>,
    /// Seed of poses and noise.
    pub seed: u32,
    /// Number of threads.
    pub threads: usize,
    /// Poses per configuration; replaces the configuration's own number.
    pub poses: Option<usize>,
    /// Fewer poses.
    pub quick: bool,
}

impl Options {
    /// Number of poses of a configuration.
    pub fn pose_count(&self, cell: &Cell) -> usize {
        self.poses.unwrap_or_else(|| cell.pose_count(self.quick))
    }
}

/// Renderers and estimators of one thread for a configuration.
pub struct Worker<'a> {
    cell: &'a Cell,
    seed: u32,
    rigs: Rigs,
    renderer: StereoRenderer,
    bounds: BoundMaker,
    estimators: Vec<Estimator>,
}

/// A rendered pose.
pub struct Rendered {
    /// The scene, and the truth.
    pub trial: Trial,
    /// The left image.
    pub left: RgbImage,
    /// The right image.
    pub right: RgbImage,
}

/// The methods as configured for exactly calibrated cameras: the direct method's allowance for calibration and lens
/// errors of real rigs is zero, because rendered pairs have none.
pub fn config() -> EstimatorConfig {
    let mut config = EstimatorConfig::default();
    config.direct.cold_start.refine.calibration_sigma_px = 0.0;
    config.direct.cold_start.refine.blur_sigma_px2 = 0.0;
    config
}

impl<'a> Worker<'a> {
    /// Prepares renderers and estimators.
    ///
    /// # Errors
    /// If simulator, geometry or an estimator rejects the setup.
    pub fn new(cell: &'a Cell, scene: &Scene, seed: u32, methods: &[Method]) -> anyhow::Result<Self> {
        let rigs = rigs(&cell.setup)?;
        let renderer = StereoRenderer::new(scene.clone(), rigs.real, &sensor(&cell.setup), seed ^ hash_of(&cell.name))?
            .with_defocus_px(0.0, cell.setup.defocus_px)?;
        // For errors in millimetres, thousandths of a pixel do not matter.
        let renderer = if cell.question == Question::Accuracy { renderer.with_fine_sampling()? } else { renderer };
        let config = config();
        let estimators =
            methods.iter().map(|method| Estimator::new(*method, &rigs.stated, &config)).collect::<Result<_, _>>()?;
        let bounds = BoundMaker::new(&cell.setup, scene, &rigs.stated)?;
        Ok(Self { cell, seed, rigs, renderer, bounds, estimators })
    }

    /// The rig that the estimators receive.
    pub fn stated_rig(&self) -> &pb3dp_geometry::StereoRig {
        &self.rigs.stated
    }

    /// Renders pose number `index`.
    ///
    /// # Errors
    /// If the target is not in front of the camera.
    pub fn render(&mut self, index: usize) -> anyhow::Result<Rendered> {
        let trial = trial(self.cell, self.seed, index, &mut self.renderer)
            .with_context(|| format!("pose {index} of {} does not show the target", self.cell.name))?;
        let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
        self.renderer.render_pair(&trial.poses, index as u64, &mut left, &mut right);
        Ok(Rendered { trial, left, right })
    }

    fn measure(&mut self, index: usize) -> anyhow::Result<Measured> {
        let Rendered { trial, left, right } = self.render(index)?;
        let mask = trial.region.rasterize(&left, &RegionConfig::default())?;
        let centroid_px = mask.centroid_px().context("the region is empty")?;
        let ray = self.rigs.stated.left().unproject(&centroid_px)?;
        let bound = if self.cell.question == Question::Unobservable {
            None
        } else {
            self.bounds.bound(&trial.poses, &trial.ground_truth, &trial.plane, &ray)
        };
        let search = &self.cell.search;
        let outcomes = self
            .estimators
            .iter_mut()
            .map(|estimator| {
                let (answer, cpu_millis) =
                    timed(|| estimator.estimate(EstimateRequest::new_target(&left, &right, &trial.region, search)));
                match answer {
                    Ok(estimate) => outcome(&estimate, &trial.truth_for(&estimate, &ray), &ray, cpu_millis),
                    Err(_) => Outcome { status: Status::Error, errors: None, normalised_error: None, cpu_millis },
                }
            })
            .collect();
        Ok(Measured { bound, outcomes })
    }
}

fn outcome(estimate: &PlaneEstimate, truth: &Vector3<f64>, ray: &Vector3<f64>, cpu_millis: f64) -> Outcome {
    let errors = estimate.pose.and_then(|pose| plane_errors(&pose.inverse_depth_plane, truth, ray));
    let normalised_error = estimate.pose.zip(errors).and_then(|(pose, errors)| {
        let (covariance, error) = match estimate.plane_covariance {
            Some(covariance) => (covariance, psi(truth, ray)? - psi(&pose.inverse_depth_plane, ray)?),
            // The error of the normal is divided evenly between the two tilts.
            None => {
                let (z, normal) = (estimate.z_sigma_m?, estimate.normal_sigma_rad?);
                let variances = Vector3::new(z * z, 0.5 * normal * normal, 0.5 * normal * normal);
                (Matrix3::from_diagonal(&variances), Vector3::new(errors.z_m, errors.tilt_rad.x, errors.tilt_rad.y))
            }
        };
        Some(error.dot(&covariance.cholesky()?.solve(&error)) / 3.0)
    });
    Outcome { status: estimate.status, errors, normalised_error, cpu_millis }
}

/// Depth on a ray and the two tilts of a plane.
fn psi(plane: &Vector3<f64>, ray: &Vector3<f64>) -> Option<Vector3<f64>> {
    let psi = PlaneHypothesis::from_inverse_depth_plane(plane, ray)?;
    Some(Vector3::new(psi.z_m, psi.theta_x_rad, psi.theta_y_rad))
}

/// Measures all poses of a configuration, in order of their numbers.
///
/// # Errors
/// If a part rejects the setup; the first error of any thread.
pub fn measure_cell(cell: &Cell, options: &Options, scenes: &mut SceneStore) -> anyhow::Result<Vec<Measured>> {
    let scene = scenes.scene(&cell.setup)?;
    let begin = || Worker::new(cell, &scene, options.seed, &options.methods);
    in_parallel(options.pose_count(cell), options.threads, begin, Worker::measure)
        .with_context(|| format!("configuration {}", cell.name))
}
