//! From the error of the hand to joint velocities, or to the reason for a hold.

use std::time::Duration;

use pb3dp_geometry::frames::{Base, Hand};
use pb3dp_geometry::{MonotonicTime, Pose, Twist};
use pb3dp_kinematics::{JointState, JointVector};

use super::{Command, ControlStep, Controller, HoldReason, Mode, STALL_MAX_S};
use crate::config::{CartesianSpeed, FeedForwardConfig, LawConfig, PublishedConfig};
use crate::law::feed_forward::{self, Aim, DesiredMotion};
use crate::law::pose_based::{self, HandError};
use crate::law::{hand_twist_of_camera, hybrid, image_based};
use crate::redundancy::secondary_velocity;
use crate::resolved_rate::{HandJacobian, JointBounds, Limitation, keep_apart, limit_twist};

/// If a joint limit leaves no more than this share of the requested speed, the hand holds and reports the limit.
const STANDSTILL_SHARE: f64 = 0.02;

/// A search starts when no joint is faster than this, rad/s.
const AT_REST_RAD_PER_S: f64 = 0.01;

/// Least distance of camera and target that the hand seeks, as a share of the desired one. Chosen: at 500 mm it leaves 50 mm to the near
/// end of the search of `configs/sim.toml`, beyond which the target is lost; a hand that follows comes no closer than some millimetres.
const NEAREST_SHARE: f64 = 0.8;

/// Time after the approach in which translation and rotation become independent, seconds.
const TOGETHER_FADES_S: f64 = 1.0;

/// Time in which the speed rises after a hold that is as short as a stall, seconds. Measured with stalls of 40 ms of the host at 100 mm/s
/// (tests/tests/stalls.rs): 6.4 to 8.5 mm beside the undisturbed run, and the same within 0.6 mm with 0.02 s and with 0.1 s, because the
/// limiter bounds the acceleration anyway.
const RISES_AGAIN_S: f64 = 0.05;

/// Share of the requested speed that is used: it rises after a hold, and falls while the target is not observed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    /// Start of the motion and its share of speed; `None` while the hand holds.
    moving: Option<(MonotonicTime, f64)>,
    /// Begin of a hold that keeps the target.
    held_since: Option<MonotonicTime>,
    /// Whether the speed rises as after a short hold.
    rises_again: bool,
}

impl Pace {
    /// Holding.
    pub(super) fn rest() -> Self {
        Self { moving: None, held_since: None, rises_again: false }
    }

    /// Holds with the same target.
    pub(super) fn hold(&mut self, at: Option<MonotonicTime>) {
        self.held_since = self.held_since.or(at);
    }

    /// Share of the speed by time alone: 0 at the start, 1 after `soft_start_s`.
    fn started(&mut self, soft_start_s: f64, now: MonotonicTime) -> f64 {
        if self.held_since.is_some() {
            *self = Self::rest();
        }
        let (began, _) = *self.moving.get_or_insert((now, 0.0));
        if soft_start_s > 0.0 { (now.seconds_since(began) / soft_start_s).clamp(0.0, 1.0) } else { 1.0 }
    }

    /// Share of the speed, 0 at the start: it rises by 1 in `soft_start_s`, and is never above `most`. After a short hold it begins with the
    /// share that the arm still has, and rises sooner.
    fn risen(
        &mut self,
        soft_start_s: f64,
        period_s: f64,
        most: f64,
        now: MonotonicTime,
        left: impl Fn() -> f64,
    ) -> f64 {
        if let Some(since) = self.held_since {
            let was_moving = self.moving.filter(|_| (0.0..=STALL_MAX_S).contains(&now.seconds_since(since)));
            *self = Self { moving: was_moving.map(|(began, _)| (began, left())), rises_again: true, held_since: None };
        }
        let rises_s = if self.rises_again { soft_start_s.min(RISES_AGAIN_S) } else { soft_start_s };
        let share = match self.moving {
            _ if soft_start_s <= 0.0 => 1.0,
            None => 0.0,
            Some((_, share)) => share + period_s / rises_s,
        };
        self.rises_again &= share < 1.0 && self.moving.is_some();
        let share = share.min(most);
        self.moving = Some((self.moving.map_or(now, |(began, _)| began), share));
        share
    }
}

/// Motion that a law requests.
struct LawOutput {
    /// Velocity of the hand.
    twist: Twist<Base>,
    /// Speed limit of the hand.
    most: CartesianSpeed,
    /// Joints and Jacobian to resolve it with.
    position_rad: JointVector,
    jacobian: HandJacobian,
    /// Null motion of the joints, rad/s.
    secondary_rad_per_s: JointVector,
    /// Share of the motion that is used now, and the reason if it is less than 1.
    share: f64,
    slowed_by: Limitation,
}

impl Controller {
    /// Applies law and limits; keeps `Hold` with the reason if no motion is possible.
    pub(super) fn drive(
        &mut self,
        step: &mut ControlStep,
        error: &HandError,
        jacobian: HandJacobian,
        joints: &JointState,
        now: MonotonicTime,
    ) {
        let request = match self.config.law {
            LawConfig::FeedForward(law) => self
                .feed_forward_motion(&law, joints, now)
                .ok_or_else(|| HoldReason::ObservationStale { age_s: step.observation_age_s.unwrap_or(f64::INFINITY) }),
            LawConfig::Published(law) => {
                let twist = self.published_twist(&law, error, &jacobian, joints);
                Ok(self.motion_without_feed_forward(twist, jacobian, joints, now))
            }
            LawConfig::ImageBased(_) | LawConfig::Hybrid(_) => match self.twist_by_camera(step) {
                Some(twist) => Ok(self.motion_without_feed_forward(twist, jacobian, joints, now)),
                None => Err(HoldReason::TargetNotBeforeCamera),
            },
        };
        let request = match request {
            Ok(request) => request,
            Err(reason) => {
                step.mode = Mode::Holding(reason);
                return;
            }
        };
        let (twist, hand_share) = limit_twist(&request.twist, &request.most);
        let (twist, is_near) = self.kept_apart(&twist, step);
        let primary = request.jacobian.joint_velocity(&twist, &self.damping);
        let bounds = self.joint_bounds();
        let beside = bounds.share_beside(&primary, &request.secondary_rad_per_s, &request.position_rad);
        let limited = bounds.limit(&(primary + request.secondary_rad_per_s * beside), &request.position_rad);
        step.limited_by = limited
            .limited_by
            .or(is_near.then_some(Limitation::TargetNear))
            .or((hand_share < 1.0).then_some(Limitation::HandSpeed));
        if request.share < 1.0 {
            step.limited_by = Some(request.slowed_by);
        }
        let command = limited.velocity_rad_per_s * request.share;
        if !command.iter().all(|x| x.is_finite()) {
            step.mode = Mode::Holding(HoldReason::CommandNotFinite);
            return;
        }
        match limited.limited_by {
            Some(Limitation::JointRange { joint }) if limited.share <= STANDSTILL_SHARE => {
                step.mode = Mode::Holding(HoldReason::JointRange { joint });
            }
            Some(Limitation::ElbowStretched) if limited.share <= STANDSTILL_SHARE => {
                step.mode = Mode::Holding(HoldReason::ElbowStretched);
            }
            _ => step.command = Command::Velocity(command),
        }
    }

    /// The twist without what brings the camera nearer to the target than [`NEAREST_SHARE`] of its desired distance.
    fn kept_apart(&self, twist: &Twist<Base>, step: &ControlStep) -> (Twist<Base>, bool) {
        let (Some(base_from_hand), Some(base_from_model)) = (step.base_from_hand, step.base_from_model) else {
            return (*twist, false);
        };
        let (model_from_hand, mounting) = (&self.config.model_from_hand_desired, &self.config.hand_from_cam_left);
        let camera_m = (base_from_hand * *mounting).translation_m();
        let target_m = base_from_model.translation_m() - camera_m;
        let lever_m = camera_m - base_from_hand.translation_m();
        let least_m = NEAREST_SHARE * (*model_from_hand * *mounting).translation_m().norm();
        keep_apart(twist, (&target_m, &lever_m), least_m)
    }

    fn joint_bounds(&self) -> JointBounds<'_> {
        JointBounds {
            limits: self.limits.operating(),
            limit_approach_per_s: self.config.speed.limit_approach_per_s,
            elbow: self.elbow,
        }
    }

    /// One step of the search, if it is configured, no faster than an approach.
    pub(super) fn look_for_target(
        &mut self,
        step: &mut ControlStep,
        base_from_hand: &Pose<Base, Hand>,
        jacobian: &HandJacobian,
        joints: &JointState,
        now: MonotonicTime,
    ) {
        let Some(config) = self.config.search else { return };
        // While the hand still moves, its pose is not the one at which the target was lost.
        if self.search.is_ready() && joints.velocity_rad_per_s.amax() > AT_REST_RAD_PER_S {
            return;
        }
        let Some(twist) = self.search.step(&config, base_from_hand, now) else { return };
        let (twist, _) = limit_twist(&twist, &self.config.approach.speed);
        let limited = self.joint_bounds().limit(&jacobian.joint_velocity(&twist, &self.damping), &joints.position_rad);
        let share = self.pace.started(self.config.speed.soft_start_s, now);
        let command = limited.velocity_rad_per_s * share;
        if command.iter().all(|x| x.is_finite()) {
            step.mode = Mode::Searching;
            step.limited_by = limited.limited_by;
            step.command = Command::Velocity(command);
        }
    }

    fn published_twist(
        &self,
        law: &PublishedConfig,
        error: &HandError,
        jacobian: &HandJacobian,
        joints: &JointState,
    ) -> Twist<Base> {
        let desired_twist = self.target.smoothed_twist(&self.config.model_from_hand_desired);
        let measured_twist = jacobian.twist(&joints.velocity_rad_per_s);
        pose_based::hand_twist(&law.gains, error, &desired_twist, &measured_twist)
    }

    /// Request of the image-based laws; `None` if the target is not in front of the camera.
    fn twist_by_camera(&self, step: &ControlStep) -> Option<Twist<Base>> {
        let (base_from_hand, base_from_model) = (step.base_from_hand?, step.base_from_model?);
        let mounting = self.config.hand_from_cam_left;
        let cam_left_from_model = (base_from_hand * mounting).inverse() * base_from_model;
        let wanted = (self.config.model_from_hand_desired * mounting).inverse();
        let camera = match self.config.law {
            LawConfig::ImageBased(law) => {
                image_based::camera_twist(law.gain_per_s, law.half_width_m, &cam_left_from_model, &wanted)
            }
            LawConfig::Hybrid(law) => hybrid::camera_twist(law.gain_per_s, &cam_left_from_model, &wanted),
            LawConfig::FeedForward(_) | LawConfig::Published(_) => None,
        };
        camera.map(|camera| hand_twist_of_camera(&camera, &base_from_hand, &mounting))
    }

    fn motion_without_feed_forward(
        &mut self,
        twist: Twist<Base>,
        jacobian: HandJacobian,
        joints: &JointState,
        now: MonotonicTime,
    ) -> LawOutput {
        LawOutput {
            twist,
            most: if self.approached_at.is_some() { self.config.speed.tracking } else { self.config.approach.speed },
            position_rad: joints.position_rad,
            jacobian,
            secondary_rad_per_s: JointVector::zeros(),
            share: self.pace.started(self.config.speed.soft_start_s, now),
            slowed_by: Limitation::SoftStart,
        }
    }

    /// Request of the law with feed-forward; `None` if the target cannot be predicted to the time of the motion.
    fn feed_forward_motion(
        &mut self,
        law: &FeedForwardConfig,
        joints: &JointState,
        now: MonotonicTime,
    ) -> Option<LawOutput> {
        let begins_to_act = now + Duration::from_secs_f64(law.arm.delay_s);
        let target = self.target.at(begins_to_act)?;
        let desired = DesiredMotion::before(&target, &self.config.model_from_hand_desired);
        let aim = Aim::new(&desired, &law.arm, self.period_s);
        let position_rad = self.given.rest_position(joints, &law.arm, now);
        let frames = self.chain.joint_frames(&position_rad);
        let base_from_hand = frames.base_from_flange * self.config.flange_from_hand;
        let jacobian = HandJacobian::new(&self.chain, &frames, &base_from_hand.translation_m().into());
        let gains = aim.gains_within(&law.gains, &base_from_hand, self.limits.acceleration_max_rad_per_s2(), |twist| {
            jacobian.joint_velocity(twist, &self.damping)
        });
        let most = self.correction_most(law, now);
        let most = most.towards(&aim.together(&gains, &base_from_hand, &most), self.share_together(now));
        let twist = feed_forward::hand_twist(&gains, &aim, &base_from_hand, &most);
        // The closer to a singular pose, the less null motion.
        let weight = (jacobian.smallest_singular_value() / self.damping.threshold()).min(1.0).powi(2);
        let secondary_rad_per_s = secondary_velocity(
            &self.chain,
            self.limits.operating(),
            &position_rad,
            jacobian.matrix(),
            &law.redundancy,
            weight,
        );
        let fresh = self.freshness(now);
        let left = || {
            let wanted = jacobian.joint_velocity(&twist, &self.damping);
            let left = joints.velocity_rad_per_s.dot(&wanted) / wanted.norm_squared();
            if left.is_finite() { left.clamp(0.0, 1.0) } else { 0.0 }
        };
        let share = self.pace.risen(self.config.speed.soft_start_s, self.period_s, fresh, now, left);
        let slowed_by = if share < fresh { Limitation::SoftStart } else { Limitation::Fading };
        let most = self.config.speed.tracking;
        Some(LawOutput { twist, most, position_rad, jacobian, secondary_rad_per_s, share, slowed_by })
    }

    /// Speed limit for corrections: that of the approach until the hand has arrived, then rising to that of tracking.
    fn correction_most(&self, law: &FeedForwardConfig, now: MonotonicTime) -> CartesianSpeed {
        let (slow, fast) = (&self.config.approach.speed, &self.config.speed.tracking);
        let since_s = self.approached_at.map_or(0.0, |at| now.seconds_since(at).max(0.0));
        let rising = |slow: f64, fast: f64, acceleration: f64| (slow + acceleration * since_s).min(fast.max(slow));
        CartesianSpeed {
            linear_m_per_s: rising(slow.linear_m_per_s, fast.linear_m_per_s, law.gains.linear_m_per_s2),
            angular_rad_per_s: rising(slow.angular_rad_per_s, fast.angular_rad_per_s, law.gains.angular_rad_per_s2),
        }
    }

    /// Degree to which translation and rotation end together: 1 during the approach, then falling to 0.
    fn share_together(&self, now: MonotonicTime) -> f64 {
        let since_s = self.approached_at.map_or(0.0, |at| now.seconds_since(at));
        (1.0 - since_s / TOGETHER_FADES_S).clamp(0.0, 1.0)
    }

    /// 1 while the target was observed within half of the time-out; then falling to 0 at the time-out, where the hand holds.
    fn freshness(&self, now: MonotonicTime) -> f64 {
        let timeout_s = self.config.timeouts.observation_s;
        let age_s = self.target.observed_at().map_or(timeout_s, |at| now.seconds_since(at));
        (2.0 * (timeout_s - age_s) / timeout_s).clamp(0.0, 1.0)
    }
}
