//! The vision half of a run: stereo pairs in, observations for the controller out.

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::frames::{Base, CamLeft};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{Clock, FollowedTarget};
use pb3dp_kinematics::JointState;
use pb3dp_servo::JointHistory;
use pb3dp_servo::supervisor::FrameInput;
use pb3dp_setup::setup::{Pace, Setup};

use super::both_arms::error_text;
use super::camera_controls::ControlDesk;
use super::capturing::{Captured, Capturing};
use super::cell::{JOINT_GAP_MAX_S, SimulatedCell};
use super::halves::{CameraArmStep, Estimate};
use super::percept::Percept;
use super::perception::{Perception, TargetSource, VisionInput};
use super::selection::{Choice, Selection, Selections};
use crate::estimate_log::PairEstimate;
use crate::perception::View;
use crate::true_surface::TrueSurface;

/// Camera and estimation: each of the two parts may have its own thread.
pub struct Vision<'a> {
    /// The camera.
    pub capturing: Capturing,
    /// The method that leads the hand.
    pub estimating: Estimating<'a>,
}

impl<'a> Vision<'a> {
    /// A camera whose pairs are not processed yet.
    ///
    /// # Errors
    /// As [`Perception::new`].
    pub fn new(
        setup: &'a Setup,
        (camera, cell, marking): (VisionInput, SimulatedCell, TargetSource),
        clock: &Arc<dyn Clock>,
    ) -> Result<Self> {
        let cameras = Perception::new(setup, &camera, marking)?;
        let surface = cell.scene.as_deref().map(|scene| TrueSurface::new(scene.clone()));
        Ok(Self {
            estimating: Estimating { surface, ..Estimating::new(setup, Arc::clone(clock), cameras) },
            capturing: Capturing::new(setup, camera, cell),
        })
    }
}

/// The method that leads the hand, with the camera motion from the joints.
pub struct Estimating<'a> {
    setup: &'a Setup,
    clock: Arc<dyn Clock>,
    cameras: Perception,
    /// Number of the target: how many were marked so far.
    target: u64,
    /// Targets that an operator selects during the run.
    selections: Option<Selections>,
    /// Controls of real cameras.
    controls: Option<ControlDesk>,
    /// What the operator has selected for the next pair.
    selected: Option<Choice>,
    /// The target is the one that the setup names.
    is_of_setup: bool,
    /// Measured joints of the arm that carries the cameras.
    joints: JointHistory,
    /// Number of control steps whose joints it has.
    steps: u64,
    /// Exposure time of the previous pair, and the camera pose then if the joint history has it.
    previous: Option<(MonotonicTime, Option<Pose<Base, CamLeft>>)>,
    /// Whether the previous estimate was `miscalibrated`, which the log has said then.
    was_miscalibrated: bool,
    /// The true surface, in simulation.
    surface: Option<TrueSurface>,
}

impl<'a> Estimating<'a> {
    /// No pair is processed yet.
    pub fn new(setup: &'a Setup, clock: Arc<dyn Clock>, cameras: Perception) -> Self {
        let joints = JointHistory::new(setup.controller.joint_history_samples, JOINT_GAP_MAX_S);
        Self {
            setup,
            clock,
            cameras,
            target: 0,
            selections: None,
            controls: None,
            selected: None,
            is_of_setup: true,
            joints,
            steps: 0,
            previous: None,
            was_miscalibrated: false,
            surface: None,
        }
    }

    /// The same with targets that an operator selects meanwhile.
    #[must_use]
    pub fn with_selections(self, selections: Option<Selections>) -> Self {
        Self { selections, ..self }
    }

    /// The same with the controls of real cameras.
    #[must_use]
    pub fn with_controls(self, controls: Option<ControlDesk>) -> Self {
        Self { controls, ..self }
    }

    /// Sets how many targets were marked before, in pairs that this estimation has not processed.
    pub fn count_targets(&mut self, target: u64) {
        self.target = target;
    }

    /// Adds a joint measurement of the arm that carries the cameras.
    pub fn push_joints(&mut self, sample: JointState) {
        self.joints.push(sample);
        self.steps += 1;
    }

    /// Keeps what the operator has selected so far for the next pair. To be called before each.
    pub fn take_selection(&mut self) {
        if self.selected.is_none() {
            self.selected = self.selections.as_ref().and_then(Selections::take);
        }
    }

    /// Estimates the target pose in a pair.
    ///
    /// # Errors
    /// If the method fails permanently.
    pub fn look(&mut self, captured: Captured) -> Result<PairEstimate> {
        let started = Instant::now();
        let chosen = self.selected.take();
        let (region, estimate, prior) = match chosen.clone() {
            Some(Choice::Marked(selection)) => {
                self.is_of_setup = false;
                let (estimate, prior) = self.select(&selection, &captured);
                (Some(selection.region), estimate, prior)
            }
            Some(Choice::OfSetup) if !(self.is_of_setup && self.cameras.follows()) => self.select_of_setup(&captured),
            // A target of the setup that is followed already stays: its region in the images may show something else by now.
            Some(Choice::OfSetup) | None => {
                let prior = self.prior(&captured.frame);
                let region = self.cameras.region(self.setup, captured.cam_left_from_target.as_ref())?;
                self.target += u64::from(region.is_some());
                let estimate = self.cameras.estimate(&captured.view, region.as_ref(), &prior)?;
                (region, estimate, prior)
            }
        };
        if let Some(controls) = &self.controls {
            controls.note_target(self.followed(&estimate));
        }
        let latency_millis = started.elapsed().as_secs_f64() * 1e3;
        let surface = self.surface.as_mut();
        let target_from_plane = surface.and_then(|surface| surface.see(chosen.as_ref(), region.as_ref(), &captured));
        if region.is_some() {
            for warning in &estimate.warnings {
                tracing::warn!("{warning}");
            }
            let (status, reason) = (estimate.status, &estimate.reason);
            match status.depth_is_sure() {
                true => tracing::info!("target initialised: {status}: {reason}"),
                false => tracing::warn!("the target is not followed: {status}: {reason}"),
            }
        }
        let is_miscalibrated = estimate.status == Status::Miscalibrated;
        if is_miscalibrated && !self.was_miscalibrated && region.is_none() {
            tracing::warn!("{}: {}", estimate.status, estimate.reason);
        }
        self.was_miscalibrated = is_miscalibrated;
        let frames = self.setup.rig.frames;
        let age = match self.setup.pace {
            // In simulated time the setup states the estimation latency.
            Pace::Fast | Pace::RealTime => frames.exposure / 2 + self.setup.estimate_latency,
            Pace::Live => self.clock.now().saturating_since(captured.frame.at),
        };
        let age_millis = age.as_secs_f64() * 1e3;
        let (steps, target) = (self.steps, self.target);
        Ok(PairEstimate {
            captured,
            steps,
            chosen,
            target,
            region,
            prior,
            estimate,
            target_from_plane,
            latency_millis,
            age_millis,
        })
    }

    /// The target, for the exposure of the cameras.
    fn followed(&self, estimate: &TrackEstimate) -> FollowedTarget {
        if !self.cameras.follows() {
            FollowedTarget::Nothing
        } else if estimate.cam_left_from_model.is_some() && estimate.status.depth_is_sure() {
            FollowedTarget::Confident
        } else {
            FollowedTarget::Doubtful
        }
    }

    /// Starts with the target that the setup names, in the present images. If it is not in view, there is no target.
    fn select_of_setup(&mut self, captured: &Captured) -> (Option<Region>, TrackEstimate, FramePrior) {
        let marking = self.selections.as_ref().and_then(Selections::target_of_setup);
        let marked = marking
            .context("the setup names no target")
            .and_then(|marking| marking.region(self.setup, captured.cam_left_from_target.as_ref()));
        match marked {
            Ok(region) => {
                self.is_of_setup = true;
                let selection = Selection { region, drawn_on: None, model: None };
                let (estimate, prior) = self.select(&selection, captured);
                (Some(selection.region), estimate, prior)
            }
            Err(why) => {
                self.target += 1;
                self.cameras.forget();
                let estimate = TrackEstimate::without_pose(Status::NotObservable, format!("{why:#}"));
                (None, estimate, self.prior(&captured.frame))
            }
        }
    }

    /// Starts with a target that the operator has selected. A region that the method refuses does not end the run: there is no target then.
    fn select(&mut self, selection: &Selection, captured: &Captured) -> (TrackEstimate, FramePrior) {
        let Selection { region, drawn_on, model } = selection;
        self.target += 1;
        let mut estimate = match drawn_on {
            Some(pair) => {
                self.cameras.restore(model.as_deref().copied());
                let view = View::Images(Arc::clone(pair));
                self.previous = Some((pair.exposed_at, self.base_from_cam_left_at(pair.exposed_at)));
                self.cameras.estimate(&view, Some(region), &FramePrior::of_skew(pair.skew_s()))
            }
            None => self.cameras.estimate(&captured.view, Some(region), &FramePrior::of_skew(captured.frame.skew_s)),
        };
        let prior = self.prior(&captured.frame);
        let is_drawn_before = drawn_on.as_ref().is_some_and(|pair| pair.sequence != captured.frame.sequence);
        if is_drawn_before && estimate.is_ok() {
            estimate = self.cameras.estimate(&captured.view, None, &prior);
        }
        let estimate = estimate.unwrap_or_else(|refusal| {
            self.cameras.forget();
            TrackEstimate::without_pose(Status::NotObservable, error_text(&refusal))
        });
        (estimate, prior)
    }

    /// Pose of the left camera from the measured joints and the calibrated mounting.
    fn base_from_cam_left_at(&self, at: MonotonicTime) -> Option<Pose<Base, CamLeft>> {
        let position_rad = self.joints.position_at(at).ok()?;
        let controller = &self.setup.controller;
        Some(
            self.setup.rig.arms.vs.chain.forward(&position_rad)
                * controller.flange_from_hand
                * controller.hand_from_cam_left,
        )
    }

    /// Prior information on a new frame from the joints and the clock.
    fn prior(&mut self, frame: &FrameInput) -> FramePrior {
        let FrameInput { at, skew_s, .. } = *frame;
        let base_from_cam_left = self.base_from_cam_left_at(at);
        let previous = self.previous.replace((at, base_from_cam_left));
        let motion = previous.and_then(|(_, prev)| Some(prev?.inverse() * base_from_cam_left?));
        let dt_s = previous.map(|(before, _)| at.seconds_since(before));
        FramePrior { dt_s, skew_s, ..FramePrior::of_motion(motion.as_ref()) }
    }
}

impl<S: CameraArmStep> Estimate<S> for Estimating<'_> {
    type Observed = PairEstimate;

    fn moved(&mut self, step: &S) {
        self.push_joints(*step.camera_arm_joints());
    }

    fn take_selection(&mut self) {
        Estimating::take_selection(self);
    }

    fn look(&mut self, frame: Captured) -> Result<(Option<Percept>, PairEstimate)> {
        let pair_estimate = Estimating::look(self, frame)?;
        Ok((Some(pair_estimate.percept()), pair_estimate))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use image::{Rgb, RgbImage};
    use pb3dp_estimation::estimator::{Method, Tracker};
    use pb3dp_estimation_core::method::KnownModel;
    use pb3dp_hal_api::FramePair;
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_servo::supervisor::FrameInput;
    use pb3dp_setup::setup::read_setup;

    use super::*;
    use crate::follower::Follower;

    /// A textured plane with a disparity of 148 pixels: half a metre away.
    fn captured(setup: &Setup, sequence: u64) -> Captured {
        let size = setup.rig.stereo.left().size();
        let grey = |u: u32, v: u32| {
            // Mixed well: a texture with periods has many matches.
            let place = (u / 4).wrapping_mul(0x9E37_79B1).wrapping_add((v / 4).wrapping_mul(0x85EB_CA77));
            let hash = (place ^ (place >> 15)).wrapping_mul(0x2C1B_3C6D);
            Rgb([((hash ^ (hash >> 12)) >> 8) as u8; 3])
        };
        let image = |shift: u32| RgbImage::from_fn(size.width, size.height, |u, v| grey(u + shift, v));
        let at = MonotonicTime::from_secs_f64(sequence as f64 / 30.0);
        let (left, right) = (image(0), image(148));
        let pair = FramePair {
            sequence,
            exposed_at: at,
            skew_nanos: 0,
            left,
            right,
            delivered: Default::default(),
            exposure: None,
        };
        let frame = FrameInput { sequence, at, skew_s: 0.0 };
        Captured { frame, cam_left_from_target: None, view: View::Images(Arc::new(pair)) }
    }

    fn rectangle(x: i32) -> Region {
        Region::Rectangle { x, y: 180, width: 90, height: 90 }
    }

    fn estimating<'a>(setup: &'a Setup, selections: &Selections) -> Estimating<'a> {
        let tracker = Tracker::new(Method::Direct, &setup.rig.stereo, &setup.estimator).unwrap();
        let cameras = Perception::Images(Box::new(Follower::new(tracker, setup.range)), TargetSource::FromOperator);
        let mut estimating = Estimating::new(setup, Arc::new(VirtualClock::new()), cameras);
        estimating.selections = Some(selections.clone());
        estimating
    }

    fn sim() -> Setup {
        read_setup(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml"))).unwrap()
    }

    /// The plane of these images is half a metre away; the target of before was farther.
    #[test]
    fn a_target_chosen_again_where_another_surface_is_now_is_not_followed() {
        let (setup, selections) = (sim(), Selections::default());
        let mut estimating = estimating(&setup, &selections);
        let mut look = |sequence: u64, choice: Option<Choice>| {
            choice.into_iter().for_each(|choice| selections.give(choice));
            estimating.take_selection();
            estimating.look(captured(&setup, sequence)).unwrap().estimate
        };
        let View::Images(pair) = captured(&setup, 1).view else { panic!("images") };
        let marked = |model: Option<KnownModel>| {
            let (region, drawn_on) = (rectangle(350), Some(Arc::clone(&pair)));
            Some(Choice::Marked(Selection { region, drawn_on, model: model.map(Box::new) }))
        };
        let first = look(1, marked(None));
        let own = first.cam_left_from_model.unwrap();
        let at = |scale: f64| KnownModel {
            cam_left_from_model: Pose::from_parts(scale * own.translation_m(), own.rotation()),
            first_pose_covariance: first.first_pose_covariance.unwrap(),
        };
        let again = look(2, marked(Some(at(1.01))));
        let moved = again.cam_left_from_model.unwrap().translation_m() - at(1.01).cam_left_from_model.translation_m();
        assert!(again.status == Status::Ok && moved.norm() < 1e-4, "{again:?}");
        // Nothing else is begun under its name, also not later.
        for (sequence, choice) in [(3, marked(Some(at(1.2)))), (4, None), (5, None)] {
            let found = look(sequence, choice);
            assert!(found.status == Status::Lost && found.reason.contains("another surface"), "{}", found.reason);
            assert!(found.cam_left_from_model.is_none(), "{found:?}");
        }
    }

    #[test]
    fn a_plain_select_returns_to_the_target_of_the_setup() {
        let (setup, selections) = (sim(), Selections::default());
        selections.set_target_of_setup(&TargetSource::Region(rectangle(200)));
        let mut estimating = estimating(&setup, &selections);
        let mut look = |sequence: u64, choice: Option<Choice>| {
            choice.into_iter().for_each(|choice| selections.give(choice));
            estimating.take_selection();
            let pair_estimate = estimating.look(captured(&setup, sequence)).unwrap();
            let x = pair_estimate.region.map(|region| match region {
                Region::Rectangle { x, .. } => x,
                other => panic!("{other:?}"),
            });
            assert!(
                pair_estimate.target == 0 || pair_estimate.estimate.status == Status::Ok,
                "{:?}",
                pair_estimate.estimate
            );
            (pair_estimate.target, x, pair_estimate.estimate.cam_left_from_model.is_some())
        };
        let other = || Choice::Marked(Selection { region: rectangle(350), drawn_on: None, model: None });
        assert_eq!(look(1, None), (0, None, false), "no target yet");
        assert_eq!(look(2, Some(other())), (1, Some(350), true));
        assert_eq!(look(3, Some(Choice::OfSetup)), (2, Some(200), true));
        // It is followed already.
        assert_eq!(look(4, Some(Choice::OfSetup)), (2, None, true));
        assert_eq!(look(5, Some(other())), (3, Some(350), true));
        assert_eq!(look(6, Some(Choice::OfSetup)), (4, Some(200), true));
    }
}
