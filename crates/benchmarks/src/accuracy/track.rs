//! Runs the trackers over a sequence.

use anyhow::Context;
use image::RgbImage;
use nalgebra::Vector6;
use pb3dp_estimation::estimator::{FramePrior, Method, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_sim::raster::StereoRenderer;

use super::random::hash_of;
use super::scenes::{SceneStore, rigs, sensor};
use super::sequence_summary::{SequenceSummary, Tracked};
use super::sequences::{SEARCH, SequenceSpec, model_in, model_in_first_frame};
use pb3dp_hal_platform::cpu_time::timed;

/// Renders the frames of a sequence.
pub struct Frames<'a> {
    spec: &'a SequenceSpec,
    renderer: StereoRenderer,
    /// Input of the trackers.
    pub rig: pb3dp_geometry::StereoRig,
}

impl<'a> Frames<'a> {
    /// Prepares the renderer.
    ///
    /// # Errors
    /// If simulator or geometry rejects the setup.
    pub fn new(spec: &'a SequenceSpec, seed: u32, scenes: &mut SceneStore) -> anyhow::Result<Self> {
        let rigs = rigs(&spec.setup)?;
        // An occluder is part of the scene only if a share of the target is to be hidden.
        let setup = super::cell::Setup { occluded_share: if spec.hides { 1.0 } else { 0.0 }, ..spec.setup };
        let scene = scenes.scene(&setup)?;
        let renderer = StereoRenderer::new(scene, rigs.real, &sensor(&setup), seed ^ hash_of(&spec.name))?;
        let renderer = if spec.fine { renderer.with_fine_sampling()? } else { renderer };
        Ok(Self { spec, renderer, rig: rigs.told })
    }

    /// Renders a frame.
    pub fn render(&mut self, frame: usize, left: &mut RgbImage, right: &mut RgbImage) {
        self.renderer.render_pair(&self.spec.poses(frame), frame as u64, left, right);
    }

    /// The region that the operator marks in the first frame.
    ///
    /// # Errors
    /// If the target is not in front of the camera.
    pub fn outline_px(&self) -> anyhow::Result<Vec<nalgebra::Vector2<f64>>> {
        let outline = self.renderer.target_outline_px(&self.spec.poses(0));
        outline.with_context(|| format!("the target of {} is not in front of the camera", self.spec.name))
    }
}

/// Runs every method over a sequence.
///
/// # Errors
/// If a part rejects the setup.
pub fn run_sequence(
    spec: &SequenceSpec,
    methods: &[Method],
    seed: u32,
    scenes: &mut SceneStore,
) -> anyhow::Result<Vec<SequenceSummary>> {
    let mut frames = Frames::new(spec, seed, scenes)?;
    let config = super::measure::config();
    let mut trackers =
        methods.iter().map(|method| Tracker::new(*method, &frames.rig, &config)).collect::<Result<Vec<_>, _>>()?;
    let region = Region::Polygon { vertices_px: frames.outline_px()? };
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    let mut tracked = vec![Vec::with_capacity(spec.frames); trackers.len()];
    let first = spec.cam_left_from_target(0);
    let mut model_first = None;
    for frame in 0..spec.frames {
        frames.render(frame, &mut left, &mut right);
        let model_first = match model_first {
            Some(model) => model,
            None => {
                let mask = region.rasterize(&left, &RegionConfig::default())?;
                let centroid = mask.centroid_px().context("the region is empty")?;
                *model_first.insert(model_in_first_frame(&first, &frames.rig.left().unproject(&centroid)?))
            }
        };
        let truth = model_in(&spec.cam_left_from_target(frame), &first, &model_first);
        for (tracker, tracked) in trackers.iter_mut().zip(&mut tracked) {
            let (answer, cpu_millis) = timed(|| match frame {
                0 => tracker.estimate(EstimateRequest::of_target(&left, &right, &region, &SEARCH)),
                _ => tracker.estimate(EstimateRequest::of_next(&left, &right, &FramePrior::default())),
            });
            // The model frame of a relief is a matter of definition: its absolute pose has no truth.
            let judged = spec.setup.is_planar().then_some(&truth);
            tracked.push(answer_of(answer.ok(), judged, cpu_millis));
        }
    }
    let truth: Vec<_> =
        (0..spec.frames).map(|frame| spec.cam_left_from_target(frame).relabel::<CamLeft, Model>()).collect();
    let rows = trackers.iter().zip(&tracked);
    Ok(rows.map(|(tracker, tracked)| SequenceSummary::of(spec, tracker.method().name(), tracked, &truth)).collect())
}

fn answer_of(answer: Option<TrackEstimate>, truth: Option<&Pose<CamLeft, Model>>, cpu_millis: f64) -> Tracked {
    let Some(estimate) = answer else {
        return Tracked { status: Status::Error, pose: None, normalised_error: None, turn_observed: false, cpu_millis };
    };
    let normalised_error = estimate.cam_left_from_model.zip(estimate.covariance).and_then(|(pose, covariance)| {
        // true = estimate * exp(xi), xi = [rho; phi] in the model's axes.
        let xi: Vector6<f64> = (pose.inverse() * *truth?).log();
        Some(xi.dot(&covariance.cholesky()?.solve(&xi)) / 6.0)
    });
    Tracked {
        status: estimate.status,
        pose: estimate.cam_left_from_model,
        normalised_error,
        turn_observed: estimate.rotation_about_normal_observed,
        cpu_millis,
    }
}
