//! The active conditions, and since when each is active.

use nalgebra::Matrix6;
use pb3dp_geometry::MonotonicTime;

use super::inputs::{ArmCondition, Confidence, EstimateInput, FrameInput, Innovation, Inputs};
use super::policy::{Action, Condition, Policies};
use crate::controller::Mode;

/// An active condition with its measured value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cause {
    /// The condition.
    pub condition: Condition,
    /// Measured value in the unit of the threshold; infinite without a measurement, 0 without a threshold.
    pub value: f64,
    /// The limit; 0 without a threshold.
    pub threshold: f64,
    /// Location or further detail.
    pub detail: Detail,
}

/// Further detail of a [`Cause`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Detail {
    /// None.
    None,
    /// Index of the arm in [`super::ARM_NAMES`].
    Arm(usize),
    /// Index of the joint from the base, from 0.
    Joint(usize),
    /// Mode of the controller.
    Controller(Mode),
    /// Number of the started target and of the followed one.
    Targets {
        /// The started target.
        started: u64,
        /// The followed target.
        followed: u64,
    },
    /// Numbers of two consecutive frame pairs.
    Frames {
        /// The earlier one.
        before: u64,
        /// The later one.
        after: u64,
    },
    /// The estimate has no pose.
    NoPose,
}

/// Conditions for which a confident estimate cannot be used either.
const DOUBTS: [Condition; 3] = [Condition::PositionUncertain, Condition::OrientationUncertain, Condition::CameraSkew];

/// Evaluates the inputs, and keeps the data for later steps.
#[derive(Clone, Debug)]
pub(super) struct Findings {
    stepped_at: Option<MonotonicTime>,
    frame: Option<FrameInput>,
    disorder: Option<Detail>,
    estimate: Option<EstimateInput>,
    /// The newest estimate with a pose: its covariance is used until the next pose.
    posed: Option<EstimateInput>,
    /// Exposure of the newest confident estimate.
    confident_at: Option<MonotonicTime>,
    /// Exposure of the newest confident estimate that no condition of [`DOUBTS`] concerned when it arrived.
    usable_at: Option<MonotonicTime>,
    /// Time at which the newest confident estimate arrived.
    pub(super) confirmed_at: Option<MonotonicTime>,
    /// Estimates from earlier exposures are ignored: they were made before the selection.
    not_before: MonotonicTime,
    innovation: Innovation,
    started_target: Option<u64>,
    /// Target number of the newest pose; an estimate without a pose has none.
    followed_target: Option<u64>,
    /// Time since which this target is followed.
    followed_since: Option<MonotonicTime>,
    found: [Option<Cause>; Condition::COUNT],
    since: [Option<MonotonicTime>; Condition::COUNT],
}

impl Findings {
    pub(super) fn new() -> Self {
        Self {
            stepped_at: None,
            frame: None,
            disorder: None,
            estimate: None,
            posed: None,
            confident_at: None,
            usable_at: None,
            confirmed_at: None,
            not_before: MonotonicTime::ZERO,
            innovation: Innovation::NoneNew,
            started_target: None,
            followed_target: None,
            followed_since: None,
            found: [None; Condition::COUNT],
            since: [None; Condition::COUNT],
        }
    }

    /// Handles a selection: earlier estimates no longer count.
    pub(super) fn begin(&mut self, now: MonotonicTime) {
        self.forget_target();
        self.started_target = None;
        self.not_before = now;
    }

    /// Handles a start: stores the followed target as the started one.
    pub(super) fn start(&mut self) {
        self.started_target = self.followed_target;
    }

    /// The controller drops its target, so the next observation cannot be a jump.
    pub(super) fn rearm(&mut self) {
        self.innovation = Innovation::NoneNew;
    }

    fn forget_target(&mut self) {
        self.estimate = None;
        self.posed = None;
        self.followed_target = None;
        self.followed_since = None;
        self.confident_at = None;
        self.usable_at = None;
        self.confirmed_at = None;
        self.innovation = Innovation::NoneNew;
    }

    /// Determines the active conditions.
    pub(super) fn look(&mut self, inputs: &Inputs, policies: &Policies, now: MonotonicTime) {
        let step_max_s = policies.get(Condition::ClockStepped).threshold;
        let step_s = self.clock_step_s(inputs, step_max_s, now);
        if step_s.is_some_and(|step_s| step_s < 0.0) {
            // Older times are not comparable after a clock step.
            self.forget_target();
            self.frame = None;
            self.not_before = self.not_before.min(now);
        }
        self.take_frame(inputs.frame, step_max_s, now);
        self.take_estimate(inputs.estimate, step_max_s, now);
        if inputs.innovation != Innovation::NoneNew {
            self.innovation = inputs.innovation;
        }
        for condition in Condition::ALL {
            let threshold = match (condition, inputs.operator.silent_after) {
                (Condition::OperatorSilent, Some(silent_after)) => silent_after.as_secs_f64(),
                _ => policies.get(condition).threshold,
            };
            let found = match condition {
                Condition::ClockStepped => step_s.map(|value| (value, Detail::None)),
                Condition::EmergencyStop
                | Condition::ArmFault
                | Condition::ArmDisabled
                | Condition::JointsStale
                | Condition::OperatorSilent
                | Condition::LimitNear
                | Condition::Singularity
                | Condition::ControllerRests
                | Condition::LateImages => of_the_moment(condition, threshold, inputs, now),
                _ => self.of_the_target(condition, threshold, now),
            };
            let threshold = if condition.rule().threshold.is_some() { threshold } else { 0.0 };
            let index = condition as usize;
            self.found[index] = found.map(|(value, detail)| Cause { condition, value, threshold, detail });
            let since = self.since[index].filter(|since| found.is_some() && *since <= now);
            self.since[index] = since.or(found.map(|_| now));
        }
        if DOUBTS.iter().all(|doubt| self.cause(*doubt).is_none()) {
            self.usable_at = self.confident_at;
        }
    }

    /// The clock step, seconds, if it is negative or too long. A measurement too far in the future counts as a negative step.
    fn clock_step_s(&mut self, inputs: &Inputs, step_max_s: f64, now: MonotonicTime) -> Option<f64> {
        let step_s = self.stepped_at.replace(now).map(|before| now.seconds_since(before));
        if let Some(step_s) = step_s.filter(|step_s| !(0.0..=step_max_s).contains(step_s)) {
            return Some(step_s);
        }
        let [vs, tc] = inputs.arms.map(|arm| arm.measured_at);
        let frame = inputs.frame.map(|frame| frame.at);
        let estimate = inputs.estimate.map(|estimate| estimate.at);
        let stamps = [vs, tc, frame, estimate, inputs.operator.heartbeat_at];
        let least_s = stamps.into_iter().flatten().map(|at| now.seconds_since(at)).fold(0.0, f64::min);
        (least_s < -step_max_s).then_some(least_s)
    }

    fn take_frame(&mut self, newest: Option<FrameInput>, ahead_max_s: f64, now: MonotonicTime) {
        let Some(frame) = newest.filter(|frame| now.seconds_since(frame.at) >= -ahead_max_s) else { return };
        if let Some(before) = self.frame {
            if frame == before {
                return;
            }
            let in_order = frame.sequence > before.sequence && frame.at > before.at;
            self.disorder = (!in_order).then_some(Detail::Frames { before: before.sequence, after: frame.sequence });
        }
        self.frame = Some(frame);
    }

    fn take_estimate(&mut self, newest: Option<EstimateInput>, ahead_max_s: f64, now: MonotonicTime) {
        let Some(estimate) = newest else { return };
        let is_known = self.estimate.is_some_and(|before| estimate.at <= before.at);
        if is_known || estimate.at < self.not_before || now.seconds_since(estimate.at) < -ahead_max_s {
            return;
        }
        self.estimate = Some(estimate);
        if matches!(estimate.confidence, Confidence::Sure | Confidence::Doubtful) {
            self.posed = Some(estimate);
            if self.followed_target.replace(estimate.target) != Some(estimate.target) {
                self.followed_since = Some(now);
            }
        }
        if estimate.confidence == Confidence::Sure {
            self.confident_at = Some(estimate.at);
            self.confirmed_at = Some(now);
        }
    }

    fn of_the_target(&self, condition: Condition, threshold: f64, now: MonotonicTime) -> Option<(f64, Detail)> {
        let age_s = |at: Option<MonotonicTime>| at.map_or(f64::INFINITY, |at| now.seconds_since(at));
        let sigma = |first| Some(root_of_trace(&self.posed?.covariance?, first));
        match condition {
            Condition::TargetChanged => {
                let (started, followed) = (self.started_target?, self.followed_target?);
                (started != followed).then_some((0.0, Detail::Targets { started, followed }))
            }
            Condition::FrameStale => above(age_s(self.frame.map(|frame| frame.at)), threshold),
            Condition::FrameOrder => self.disorder.map(|frames| (0.0, frames)),
            Condition::Miscalibrated => {
                (self.estimate?.confidence == Confidence::Miscalibrated).then_some((0.0, Detail::None))
            }
            Condition::TargetLost | Condition::EstimateStale => above(age_s(self.confident_at), threshold),
            Condition::LowConfidence => match self.estimate?.confidence {
                Confidence::Sure => None,
                Confidence::Doubtful | Confidence::Miscalibrated => Some((0.0, Detail::None)),
                Confidence::NoPose => Some((0.0, Detail::NoPose)),
            },
            Condition::PositionJump | Condition::OrientationJump | Condition::Outlier => {
                above(self.innovation_of(condition)?, threshold)
            }
            Condition::PositionUncertain => above(sigma(0)?, threshold),
            Condition::OrientationUncertain => above(sigma(3)?, threshold),
            Condition::CameraSkew => above(self.frame?.skew_s.abs(), threshold),
            _ => None,
        }
    }

    /// Deviation of the last observation, in the unit of the condition.
    fn innovation_of(&self, condition: Condition) -> Option<f64> {
        match (self.innovation, condition) {
            (Innovation::Jump { position_m, .. }, Condition::PositionJump) => Some(position_m),
            (Innovation::Jump { orientation_rad, .. }, Condition::OrientationJump) => Some(orientation_rad),
            (Innovation::Outlier { sigmas }, Condition::Outlier) => Some(sigmas),
            _ => None,
        }
    }

    /// The first condition with at least this action, even before its `for_s` has passed.
    pub(super) fn first_at_least(&self, policies: &Policies, action: Action) -> Option<Cause> {
        self.all_at_least(policies, action).next()
    }

    /// All conditions with at least this action, even before their `for_s` has passed.
    pub(super) fn all_at_least<'a>(
        &'a self,
        policies: &'a Policies,
        action: Action,
    ) -> impl Iterator<Item = Cause> + 'a {
        self.found.iter().flatten().filter(move |cause| policies.get(cause.condition).action >= action).copied()
    }

    /// The conditions that have been active for the `for_s` of their policy. Those of [`DOUBTS`] are not awaited for longer than the
    /// newest usable pose may be old: with late pairs, that would add to their age.
    pub(super) fn lasting<'a>(
        &'a self,
        policies: &'a Policies,
        now: MonotonicTime,
    ) -> impl Iterator<Item = (Cause, Action)> + 'a {
        let age_max_s = policies.get(Condition::EstimateStale).threshold;
        let is_old = self.usable_at.is_none_or(|usable| now.seconds_since(usable) > age_max_s);
        self.found.iter().zip(&self.since).filter_map(move |(found, since)| {
            let (cause, since) = ((*found)?, (*since)?);
            let policy = policies.get(cause.condition);
            let lasts = now.seconds_since(since) >= policy.for_s || is_old && DOUBTS.contains(&cause.condition);
            lasts.then_some((cause, policy.action))
        })
    }

    /// Time since which the current target is followed; `None` without a target.
    pub(super) fn followed_since(&self) -> Option<MonotonicTime> {
        self.followed_since
    }

    /// Standard deviations of position and orientation, as the policies compare them.
    pub(super) fn sigmas(covariance: &Matrix6<f64>) -> [f64; 2] {
        [0, 3].map(|first| root_of_trace(covariance, first))
    }

    /// The current measurement of this condition.
    pub(super) fn cause(&self, condition: Condition) -> Option<Cause> {
        self.found[condition as usize]
    }
}

/// Measurements of one step.
fn of_the_moment(condition: Condition, threshold: f64, inputs: &Inputs, now: MonotonicTime) -> Option<(f64, Detail)> {
    let age_s = |at: Option<MonotonicTime>| at.map_or(f64::INFINITY, |at| now.seconds_since(at));
    let in_state = |state| inputs.arms.iter().position(|arm| arm.state == state).map(|arm| (0.0, Detail::Arm(arm)));
    match condition {
        Condition::EmergencyStop => in_state(ArmCondition::EmergencyStop),
        Condition::ArmFault => in_state(ArmCondition::Fault).or_else(|| in_state(ArmCondition::StoppedByOther)),
        // No arm stands for both.
        Condition::ArmDisabled if inputs.arms.iter().all(|arm| arm.state == ArmCondition::Disabled) => {
            Some((0.0, Detail::None))
        }
        Condition::ArmDisabled => in_state(ArmCondition::Disabled),
        Condition::JointsStale => {
            let stale = |(arm, input): (usize, &super::inputs::ArmInput)| {
                above(age_s(input.measured_at), threshold).map(|(value, _)| (value, Detail::Arm(arm)))
            };
            inputs.arms.iter().enumerate().find_map(stale)
        }
        Condition::OperatorSilent => above(age_s(inputs.operator.heartbeat_at), threshold),
        Condition::LimitNear => {
            let end = inputs.range_end?;
            let is_far = end.distance_rad >= threshold;
            (!is_far).then_some((end.distance_rad, Detail::Joint(end.joint)))
        }
        Condition::Singularity => {
            let value = inputs.smallest_singular_value?;
            let is_far = value >= threshold;
            (!is_far).then_some((value, Detail::None))
        }
        Condition::ControllerRests => (!matches!(inputs.controller, Mode::Approaching | Mode::Tracking))
            .then_some((0.0, Detail::Controller(inputs.controller))),
        Condition::LateImages => above(inputs.images_late_s?, threshold),
        _ => None,
    }
}

/// The value, if it is above the limit or NaN.
fn above(value: f64, allowed: f64) -> Option<(f64, Detail)> {
    let is_allowed = value <= allowed;
    (!is_allowed).then_some((value, Detail::None))
}

/// Standard deviation of the norm of a three-component error: the square root of the sum of variances, which is at least the
/// largest standard deviation in any direction. Infinite for a negative or NaN variance.
fn root_of_trace(covariance: &Matrix6<f64>, first: usize) -> f64 {
    let variances = [0, 1, 2].map(|i| covariance[(first + i, first + i)]);
    let are_variances = variances.iter().all(|variance| *variance >= 0.0);
    if are_variances { variances.iter().sum::<f64>().sqrt() } else { f64::INFINITY }
}
