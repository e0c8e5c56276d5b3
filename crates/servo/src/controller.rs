//! The entry point: computes the command, with its reason, from joints and observations.

mod driving;

use std::fmt;
use std::time::Duration;

use driving::Pace;
use nalgebra::{Matrix6, Vector3};
use pb3dp_geometry::frames::{Base, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{Chain, Damping, EffectiveLimits, JointState, JointVector};

use crate::config::ControllerConfig;
use crate::config_error::ConfigError;
use crate::given_commands::GivenCommands;
use crate::held_directions::HeldDirections;
use crate::joint_history::JointHistory;
use crate::known_target::KnownTarget;
use crate::late_images::{DELAYS_S, LateImages};
use crate::law::pose_based::HandError;
use crate::resolved_rate::{HandJacobian, Limitation};
use crate::search::Search;
use crate::target_filter::{ObservationVerdict, TargetObservation};

/// The longest hold that keeps the target and the measured speed of the hand (a stall), seconds. The target moves on unseen meanwhile: at
/// 100 mm/s by 30 mm, the width of a frame's search. Half of it would lose stalls of 160 ms of a camera, whose pairs are 0.1 s old anyway;
/// twice of it is the age at which a target at 0.5 m may have left the image.
pub(crate) const STALL_MAX_S: f64 = 0.3;

/// Command for the arm until the next step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Joint velocities, rad/s.
    Velocity(JointVector),
    /// Decelerate and hold.
    Hold,
}

/// Mode of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// No target.
    Idle,
    /// A target is observed; more consistent observations are needed before the hand moves.
    Locking,
    /// The hand moves to the desired pose for the first time since the target was initialised.
    Approaching,
    /// The hand follows the target.
    Tracking,
    /// The hand holds, and continues when the reason is gone.
    Holding(HoldReason),
    /// The target is lost; new observations initialise it again, and the hand approaches again.
    Lost,
    /// The target is lost, and the hand searches for it, see [`crate::search`].
    Searching,
}

/// Why the hand holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HoldReason {
    /// No observation was accepted for longer than the time-out.
    ObservationStale {
        /// Time since the exposure of the last one, seconds.
        age_s: f64,
    },
    /// The newest joint sample is too old.
    JointsStale {
        /// Its age, seconds.
        age_s: f64,
    },
    /// A measured joint angle or speed is not finite.
    JointsNotFinite,
    /// The clock stepped back, or the joints have a future time. The target is dropped, and only observations newer than those
    /// before the step are used.
    ClockStepped,
    /// A joint is at its limit and would have to exceed it.
    JointRange {
        /// Index of the joint from the base.
        joint: usize,
    },
    /// The elbow is nearly straight and would have to straighten further: the target is out of reach.
    ElbowStretched,
    /// An image-based law needs the whole target in front of the camera.
    TargetNotBeforeCamera,
    /// The law returned a number that is not finite.
    CommandNotFinite,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Idle => write!(f, "idle: no target observed yet"),
            Self::Locking => write!(f, "locking: waiting for consistent observations"),
            Self::Approaching => write!(f, "approaching"),
            Self::Tracking => write!(f, "tracking"),
            Self::Holding(reason) => write!(f, "holding: {reason}"),
            Self::Lost => write!(f, "lost: the target was not observed for too long"),
            Self::Searching => write!(f, "searching: the hand searches around the pose at which the target was lost"),
        }
    }
}

impl fmt::Display for HoldReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ObservationStale { age_s } => write!(f, "the last accepted observation is {age_s:.3} s old"),
            Self::JointsStale { age_s } => write!(f, "the newest joint sample is {age_s:.3} s old"),
            Self::JointsNotFinite => write!(f, "a measured joint angle or speed is not a finite number"),
            Self::ClockStepped => write!(f, "the time of the joints or of the controller is not monotonic"),
            Self::JointRange { joint } => write!(f, "axis {} is at the end of its range", joint + 1),
            Self::ElbowStretched => {
                write!(f, "the elbow is nearly stretched: the target is at the end of the arm's reach")
            }
            Self::TargetNotBeforeCamera => write!(f, "the target is not in front of the camera"),
            Self::CommandNotFinite => write!(f, "the control law returned a number that is not finite"),
        }
    }
}

/// Result of a step. A value that is unknown in a mode is `None`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlStep {
    /// Command for the arm.
    pub command: Command,
    /// Mode of the controller, with the reason if the arm holds.
    pub mode: Mode,
    /// What happened to the newest observation.
    pub observation: ObservationVerdict,
    /// Pose of the hand, from the measured joints.
    pub base_from_hand: Option<Pose<Base, Hand>>,
    /// Pose of the target at the time of the joint sample, smoothed or predicted.
    pub base_from_model: Option<Pose<Base, Model>>,
    /// Covariance of the predicted target pose at the time of the step: metres and radians, translation first, axes of the model.
    pub target_covariance: Option<Matrix6<f64>>,
    /// How much older than their time stamps the images seem to be, seconds: the target seems to move with the hand.
    pub images_late_s: Option<f64>,
    /// Desired pose of the hand.
    pub base_from_hand_desired: Option<Pose<Base, Hand>>,
    /// Time since the exposure of the last accepted observation, seconds.
    pub observation_age_s: Option<f64>,
    /// Distance of the hand from its desired position, metres.
    pub position_error_m: Option<f64>,
    /// Angle between the hand and its desired orientation, radians.
    pub orientation_error_rad: Option<f64>,
    /// Smallest singular value of the hand's Jacobian, metres and radians.
    pub smallest_singular_value: Option<f64>,
    /// The limit that makes the hand slower than the law requests.
    pub limited_by: Option<Limitation>,
}

/// Controller of one arm with a camera on its hand.
#[derive(Clone, Debug)]
pub struct Controller {
    config: ControllerConfig,
    chain: Chain,
    limits: EffectiveLimits,
    /// The elbow joint and its least angle, rad, if the arm has a bounded elbow.
    elbow: Option<(usize, f64)>,
    damping: Damping,
    history: JointHistory,
    given: GivenCommands,
    target: KnownTarget,
    held: HeldDirections,
    late_images: LateImages,
    /// Exposure time of the newest handled observation; observations that are not newer are ignored.
    handled_at: Option<MonotonicTime>,
    stepped_at: Option<MonotonicTime>,
    /// Time since the previous step, seconds; 0 after a long gap.
    period_s: f64,
    pace: Pace,
    approached_at: Option<MonotonicTime>,
    lost: bool,
    search: Search,
}

impl Controller {
    /// A controller without a target, in a hold, for an arm with these limits. Large errors are corrected only as fast as its
    /// joints can decelerate.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn new(config: ControllerConfig, chain: Chain, limits: EffectiveLimits) -> Result<Self, ConfigError> {
        config.validate()?;
        let damping =
            Damping::new(config.damping.threshold, config.damping.factor_max).map_err(|error| ConfigError {
                key: "damping",
                value: error.value.to_string(),
                allowed: "positive, finite numbers".to_owned(),
            })?;
        let history = JointHistory::new(config.joint_history_samples, config.timeouts.joints_s);
        let elbow_min_rad = config.damping.elbow_min_rad;
        Ok(Self {
            elbow: chain.elbow().filter(|_| elbow_min_rad > 0.0).map(|joint| (joint, elbow_min_rad)),
            chain,
            limits,
            damping,
            history,
            given: GivenCommands::new(config.joint_history_samples),
            target: KnownTarget::none(&config.law)?,
            held: HeldDirections::default(),
            late_images: LateImages::default(),
            handled_at: None,
            stepped_at: None,
            period_s: 0.0,
            pace: Pace::rest(),
            approached_at: None,
            lost: false,
            search: Search::Off,
            config,
        })
    }

    /// Limits of the arm.
    pub(crate) fn limits(&self) -> &EffectiveLimits {
        &self.limits
    }

    /// Drops the target and initialises a new one, after an operator command. Observations from before are not used again.
    pub fn acquire(&mut self) {
        self.forget();
        self.lost = false;
    }

    /// Sets the desired pose of the hand relative to the target, as an operator shifts it in small steps. The hand moves there within the
    /// speed limits; a pose that the configuration would refuse changes nothing.
    pub fn set_model_from_hand_desired(&mut self, model_from_hand_desired: Pose<Model, Hand>) {
        let config = ControllerConfig { model_from_hand_desired, ..self.config };
        if config.validate().is_ok() {
            self.config = config;
        }
    }

    /// The hand approaches its desired pose anew, from where it is and at the speed of an approach.
    pub fn approach_again(&mut self) {
        self.approached_at = None;
    }

    /// Whether the hand may search for a lost target, from [`crate::supervisor::Decision::search`] in each step. Without
    /// [`ControllerConfig::search`] the hand holds.
    pub fn permit_search(&mut self, is_permitted: bool) {
        self.search.permit(is_permitted);
    }

    /// Stores the command that the arm actually received. After a hold the hand starts softly again: from rest, or after a short one
    /// that keeps the target from the measured speed. The joint motion is predicted from the actual commands.
    pub fn set_executed_command(&mut self, executed: Command) {
        let velocity_rad_per_s = match executed {
            Command::Velocity(velocity) => velocity,
            Command::Hold => {
                self.pace.hold(self.stepped_at);
                JointVector::zeros()
            }
        };
        if let Some(at) = self.stepped_at {
            self.given.push(at, velocity_rad_per_s);
        }
    }

    /// One control cycle: never blocks, never allocates. `newest` may be the same observation several times.
    pub fn step(&mut self, joints: &JointState, newest: Option<&TargetObservation>, now: MonotonicTime) -> ControlStep {
        let step = match self.take_joints(joints, now) {
            Ok(()) => self.step_with(joints, newest, now),
            Err(reason) => {
                let base_from_model = self.target.base_from_model_at(now);
                self.resting(Mode::Holding(reason), base_from_model, now)
            }
        };
        self.set_executed_command(step.command);
        step
    }

    /// A step with valid joints.
    fn step_with(
        &mut self,
        joints: &JointState,
        newest: Option<&TargetObservation>,
        now: MonotonicTime,
    ) -> ControlStep {
        let observation = self.take_observation(newest, now);
        let mode = self.next_mode(now);
        let frames = self.chain.joint_frames(&joints.position_rad);
        let base_from_hand = frames.base_from_flange * self.config.flange_from_hand;
        let jacobian = HandJacobian::new(&self.chain, &frames, &base_from_hand.translation_m().into());
        let base_from_model = self.target.base_from_model_at(joints.at);
        let mut step = ControlStep {
            observation,
            base_from_hand: Some(base_from_hand),
            smallest_singular_value: Some(jacobian.smallest_singular_value()),
            ..self.resting(mode, base_from_model, now)
        };
        let Some(base_from_model) = base_from_model else {
            if matches!(mode, Mode::Idle | Mode::Lost) {
                self.look_for_target(&mut step, &base_from_hand, &jacobian, joints, now);
            }
            return step;
        };
        self.search.end();
        let desired = base_from_model * self.config.model_from_hand_desired;
        let error = HandError::new(&base_from_hand, &desired);
        step.base_from_hand_desired = Some(desired);
        step.position_error_m = Some(error.position_in_base_m.norm());
        step.orientation_error_rad = Some(error.angle_rad);
        if matches!(mode, Mode::Approaching | Mode::Tracking) {
            step.mode = self.note_approach(&error, now);
            self.drive(&mut step, &error, jacobian, joints, now);
        }
        step
    }

    /// Checks the joints and stores them.
    fn take_joints(&mut self, joints: &JointState, now: MonotonicTime) -> Result<(), HoldReason> {
        let since_s = self.stepped_at.map(|before| now.seconds_since(before));
        let back = since_s.is_some_and(|since_s| since_s < 0.0);
        self.period_s =
            since_s.filter(|since_s| (0.0..=self.config.timeouts.joints_s).contains(since_s)).unwrap_or(0.0);
        self.stepped_at = Some(now);
        let finite = |vector: &JointVector| vector.iter().all(|x| x.is_finite());
        if !finite(&joints.position_rad) || !finite(&joints.velocity_rad_per_s) {
            return Err(HoldReason::JointsNotFinite);
        }
        let age_s = now.seconds_since(joints.at);
        let ahead = age_s < -self.config.timeouts.joints_s;
        let pushed = self.history.push(*joints);
        if back || ahead || !pushed {
            self.history.clear();
            self.given.clear();
            self.lose();
            return Err(HoldReason::ClockStepped);
        }
        if age_s > self.config.timeouts.joints_s {
            return Err(HoldReason::JointsStale { age_s });
        }
        Ok(())
    }

    /// Handles an observation that is newer than all earlier ones.
    fn take_observation(&mut self, newest: Option<&TargetObservation>, now: MonotonicTime) -> ObservationVerdict {
        let Some(observation) = newest else { return ObservationVerdict::NoneNew };
        if self.handled_at.is_some_and(|handled| observation.at <= handled) {
            return ObservationVerdict::NoneNew;
        }
        let age_s = now.seconds_since(observation.at);
        if !(0.0..=self.config.timeouts.observation_s).contains(&age_s) {
            return ObservationVerdict::WrongTime { age_s };
        }
        self.handled_at = Some(observation.at);
        if !observation.cam_left_from_model.is_finite() {
            return ObservationVerdict::NotFinite;
        }
        if !observation.trusted {
            return ObservationVerdict::Untrusted;
        }
        match self.history.position_at(observation.at) {
            Ok(position_rad) => self.place_target(observation, &position_rad),
            Err(unknown) => ObservationVerdict::JointsUnknown(unknown),
        }
    }

    /// Places an observation with the joints of earlier times, too.
    fn compare_delays(&mut self, observation: &TargetObservation) {
        let flange_from_model =
            self.config.flange_from_hand * self.config.hand_from_cam_left * observation.cam_left_from_model;
        let mut places_m = [Vector3::zeros(); DELAYS_S.len()];
        let mut are_known = true;
        for (place_m, delay_s) in places_m.iter_mut().zip(DELAYS_S) {
            let position_rad = self.history.position_at(observation.at - Duration::from_secs_f64(delay_s));
            let Ok(position_rad) = position_rad else {
                are_known = false;
                break;
            };
            *place_m = (self.chain.forward(&position_rad) * flange_from_model).translation_m();
        }
        self.late_images.take(observation.at, are_known.then_some(places_m));
    }

    /// Transforms an observation to `base` with the joints at its time.
    fn place_target(&mut self, observation: &TargetObservation, position_rad: &JointVector) -> ObservationVerdict {
        self.compare_delays(observation);
        let base_from_hand = self.chain.forward(position_rad) * self.config.flange_from_hand;
        let observed = base_from_hand * self.config.hand_from_cam_left * observation.cam_left_from_model;
        let predicted = self.target.base_from_model_at(observation.at);
        let (observed, covariance) = self.held.complete(&observed, predicted.as_ref(), observation);
        let verdict = self.target.take(&observed, &TargetObservation { covariance, ..*observation });
        if verdict == ObservationVerdict::Accepted {
            self.held.keep(&observed, observation);
        }
        self.lost &= !self.target.is_known();
        verdict
    }

    fn next_mode(&mut self, now: MonotonicTime) -> Mode {
        let Some(observed_at) = self.target.observed_at() else {
            return if self.lost { Mode::Lost } else { Mode::Idle };
        };
        let age_s = now.seconds_since(observed_at);
        if age_s > self.config.timeouts.lost_s {
            self.lose();
            if self.lost { Mode::Lost } else { Mode::Idle }
        } else if age_s > self.config.timeouts.observation_s {
            Mode::Holding(HoldReason::ObservationStale { age_s })
        } else if !self.target.is_locked() {
            Mode::Locking
        } else if self.approached_at.is_some() {
            Mode::Tracking
        } else {
            Mode::Approaching
        }
    }

    /// Ends the approach when the hand has arrived.
    fn note_approach(&mut self, error: &HandError, now: MonotonicTime) -> Mode {
        let near = error.position_in_base_m.norm() <= self.config.approach.done_within_m
            && error.angle_rad <= self.config.approach.done_within_rad;
        if near {
            self.approached_at.get_or_insert(now);
        }
        if self.approached_at.is_some() { Mode::Tracking } else { Mode::Approaching }
    }

    /// An initialised target becomes lost; a target that is not yet initialised is only dropped.
    fn lose(&mut self) {
        self.lost |= self.target.is_locked();
        self.forget();
    }

    fn forget(&mut self) {
        self.target.forget();
        self.held = HeldDirections::default();
        self.late_images.clear();
        self.approached_at = None;
        self.pace = Pace::rest();
    }

    fn resting(&self, mode: Mode, base_from_model: Option<Pose<Base, Model>>, now: MonotonicTime) -> ControlStep {
        ControlStep {
            command: Command::Hold,
            mode,
            observation: ObservationVerdict::NoneNew,
            base_from_hand: None,
            base_from_model,
            target_covariance: self.target.at(now).map(|target| target.covariance),
            images_late_s: self.late_images.delay_s(),
            base_from_hand_desired: None,
            observation_age_s: self.target.observed_at().map(|at| now.seconds_since(at)),
            position_error_m: None,
            orientation_error_rad: None,
            smallest_singular_value: None,
            limited_by: None,
        }
    }
}
