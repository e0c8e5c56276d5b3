//! Runs the trackers over a sequence.

use anyhow::Context;
use image::RgbImage;
use nalgebra::Vector6;
use pb3dp_estimation::estimator::{FramePrior, Method, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_sim::raster::StereoRenderer;

use super::cell::RegionKind;
use super::conditions;
use super::random::hash_of;
use super::scenes::{SceneStore, rigs, sensor};
use super::sequence_summary::{Run, SequenceRow, Tracked};
use super::sequences::{SEARCH, SequenceSpec, model_in_first_frame};
use super::trial::rectangle_around;
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
        Ok(Self { spec, renderer, rig: rigs.stated })
    }

    /// Renders a frame.
    ///
    /// # Errors
    /// If the simulator rejects the condition of the cameras.
    pub fn render(&mut self, frame: usize, left: &mut RgbImage, right: &mut RgbImage) -> anyhow::Result<()> {
        conditions::render(self.spec, frame, &mut self.renderer, left, right)
    }

    /// The region that the operator marks in the first frame.
    ///
    /// # Errors
    /// If the target is not in front of the camera.
    pub fn outline_px(&self) -> anyhow::Result<Vec<nalgebra::Vector2<f64>>> {
        let outline = self.renderer.target_outline_px(&self.spec.poses(0));
        let outline =
            outline.with_context(|| format!("the target of {} is not in front of the camera", self.spec.name))?;
        Ok(if self.spec.setup.region == RegionKind::Rectangle { rectangle_around(&outline) } else { outline })
    }
}

/// Runs every method over a sequence.
///
/// # Errors
/// If a part rejects the setup.
pub fn follow(spec: &SequenceSpec, methods: &[Method], seed: u32, scenes: &mut SceneStore) -> anyhow::Result<Run> {
    let mut frames = Frames::new(spec, seed, scenes)?;
    let mut config = super::measure::config();
    config.track.rolling_shutter_millis = spec.condition.rolling_shutter_millis();
    let mut trackers =
        methods.iter().map(|method| Tracker::new(*method, &frames.rig, &config)).collect::<Result<Vec<_>, _>>()?;
    let region = Region::Polygon { vertices_px: frames.outline_px()? };
    let first_judged = spec.condition.first_judged();
    let prior = FramePrior { dt_s: Some(1.0 / spec.rate_hz), ..FramePrior::of_skew(spec.condition.skew_s()) };
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    let mut judges = vec![Judge::new(spec); trackers.len()];
    let mut tracked = vec![Vec::with_capacity(spec.frames); trackers.len()];
    for frame in 0..spec.frames {
        frames.render(frame, &mut left, &mut right)?;
        for ((tracker, tracked), judge) in trackers.iter_mut().zip(&mut tracked).zip(&mut judges) {
            let (answer, cpu_millis) = timed(|| match frame {
                0 => tracker
                    .estimate(EstimateRequest::new_target(&left, &right, &region, &SEARCH).with_skew(prior.skew_s)),
                _ => tracker.estimate(EstimateRequest::next_frame(&left, &right, &prior)),
            });
            let judged = judge.judge(frame, answer.ok(), cpu_millis);
            tracked.extend((frame >= first_judged).then_some(judged));
        }
    }
    let truth = (first_judged..spec.frames).map(|frame| spec.cam_left_from_target(frame).relabel()).collect();
    let names = trackers.iter().map(|tracker| tracker.method().name());
    Ok(Run { tracked: names.zip(tracked).collect(), truth })
}

/// Runs every method over a sequence, and summarises each.
///
/// # Errors
/// If a part rejects the setup.
pub fn run_sequence(
    spec: &SequenceSpec,
    methods: &[Method],
    seed: u32,
    scenes: &mut SceneStore,
) -> anyhow::Result<Vec<SequenceRow>> {
    let run = follow(spec, methods, seed, scenes)?;
    Ok(run.tracked.iter().map(|(method, tracked)| SequenceRow::of(spec, method, tracked, &run.truth)).collect())
}

/// Judges the answers of one tracker to one sequence.
#[derive(Clone, Copy)]
struct Judge<'a> {
    spec: &'a SequenceSpec,
    /// Pose of the target in the first frame, and the first answer.
    first: Pose<CamLeft, Target>,
    answered: Option<Pose<CamLeft, Model>>,
    /// The frame since which the motion is judged, and its answer.
    since: usize,
    answered_since: Option<Pose<CamLeft, Model>>,
}

impl<'a> Judge<'a> {
    fn new(spec: &'a SequenceSpec) -> Self {
        let since = spec.condition.first_judged();
        Self { spec, first: spec.cam_left_from_target(0), answered: None, since, answered_since: None }
    }

    fn judge(&mut self, frame: usize, answer: Option<TrackEstimate>, cpu_millis: f64) -> Tracked {
        let Some(estimate) = answer else { return Tracked::without_answer(cpu_millis) };
        if frame == 0 {
            self.answered = estimate.cam_left_from_model;
        }
        if frame == self.since {
            self.answered_since = estimate.cam_left_from_model;
        }
        let moved_since = |frame_before: usize| {
            self.spec.cam_left_from_target(frame) * self.spec.cam_left_from_target(frame_before).inverse()
        };
        let error = |truth: Option<Pose<CamLeft, Model>>| {
            let (pose, covariance) = estimate.cam_left_from_model.zip(estimate.covariance)?;
            // true = estimate * exp(xi), xi = [rho; phi] in the model's axes.
            let xi: Vector6<f64> = (pose.inverse() * truth?).log();
            Some(xi.dot(&covariance.cholesky()?.solve(&xi)) / 6.0)
        };
        let then = self.answered_since.filter(|_| frame > self.since);
        let of_motion = error(then.map(|then| moved_since(self.since) * then));
        Tracked {
            status: estimate.status,
            pose: estimate.cam_left_from_model,
            normalised_error: if self.spec.setup.is_planar() {
                error(self.model().map(|model| moved_since(0) * model))
            } else {
                of_motion
            },
            normalised_motion_error: of_motion,
            turn_observed: estimate.rotation_about_normal_observed,
            cpu_millis,
        }
    }

    /// The true pose of the model in the first frame of a plane, with its origin on the ray of the first answer: that of the
    /// region's centroid, or of the part that the tracker follows.
    fn model(&self) -> Option<Pose<CamLeft, Model>> {
        Some(model_in_first_frame(&self.first, &self.answered?.translation_m()))
    }
}
