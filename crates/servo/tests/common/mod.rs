//! A hand with a camera in front of a target, without images: joints with a command delay and a first-order lag, and exact
//! observations at 30 Hz that arrive late.
#![allow(dead_code, clippy::unwrap_used, clippy::panic)] // Each test file uses a part.

use std::collections::VecDeque;
use std::f64::consts::PI;

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use pb3dp_geometry::frames::{Base, CamLeft, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{Chain, EffectiveLimits, JointState, JointVector, StatedLimits};
use pb3dp_servo::{
    ApproachConfig, ArmResponse, CartesianSpeed, Command, ControlStep, Controller, ControllerConfig, DampingConfig,
    FeedForwardConfig, FeedForwardGains, Gains, LawConfig, PublishedConfig, RedundancyConfig, SpeedConfig,
    TargetFilterConfig, TargetObservation, TargetStateConfig, Timeouts, UnstatedCovariance,
};

/// Well inside the workspace, no joint at zero.
pub const START_RAD: [f64; 7] = [0.15, 0.75, -0.2, 1.6, 0.1, -0.9, 0.25];

pub fn chain() -> Chain {
    Chain::from_urdf_str(include_str!("../../../../configs/robots/pa10_gen2.urdf"), "base_link", "flange").unwrap()
}

/// Limits with accelerations and jerks above the demand of any law.
pub fn limits(speed_scale: f64) -> EffectiveLimits {
    let max = JointVector::from([170.0, 88.0, 168.0, 131.0, 249.0, 159.0, 249.0]).map(f64::to_radians);
    let stated = StatedLimits {
        servo: *chain().limits(),
        operating_min_rad: -max,
        operating_max_rad: max,
        speed_scale,
        acceleration_max_rad_per_s2: JointVector::from_element(1000.0),
        jerk_max_rad_per_s3: JointVector::from_element(1e5),
    };
    stated.effective().unwrap()
}

pub fn rotation(x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z))
}

/// The published law with these gains; no smoothing.
pub fn published(gains: Gains) -> PublishedConfig {
    let target_filter = TargetFilterConfig {
        position_time_constant_s: 0.0,
        orientation_time_constant_s: 0.0,
        gate_position_m: 0.5,
        gate_orientation_rad: 1.0,
        observations_to_lock: 1,
    };
    PublishedConfig { gains, target_filter }
}

/// The configuration with a changed target filter.
pub fn with_filter(config: ControllerConfig, change: impl FnOnce(&mut TargetFilterConfig)) -> ControllerConfig {
    let LawConfig::Published(mut law) = config.law else { panic!("no published law") };
    change(&mut law.target_filter);
    ControllerConfig { law: LawConfig::Published(law), ..config }
}

/// A filter with small measurement noise and without a rest model: the motion of the hand shows the law.
fn trusting() -> TargetStateConfig {
    let mut target = TargetStateConfig::default();
    (target.linear.rest, target.angular.rest) = (None, None);
    target.measurement.position_sigma_min_m = 2e-5;
    target.measurement.orientation_sigma_min_rad = 2e-4;
    target
}

/// The law with feed-forward for an arm, with noise-free observations of the target.
pub fn feed_forward(arm: ArmResponse) -> FeedForwardConfig {
    FeedForwardConfig {
        arm,
        gains: FeedForwardGains::of(&arm),
        target: trusting(),
        observations_to_lock: 3,
        unstated: UnstatedCovariance::default(),
        redundancy: RedundancyConfig::default(),
    }
}

/// [`config`] with the law with feed-forward.
pub fn feed_forward_config(law: FeedForwardConfig) -> ControllerConfig {
    ControllerConfig { law: LawConfig::FeedForward(law), ..config() }
}

/// The published law, no smoothing, no soft start, wide limits; all components of every transform differ from identity.
pub fn config() -> ControllerConfig {
    let wide = CartesianSpeed { linear_m_per_s: 2.0, angular_rad_per_s: 6.0 };
    ControllerConfig {
        model_from_hand_desired: Pose::from_parts(Vector3::new(0.03, -0.02, -0.5), rotation(0.05, -0.1, 0.2)),
        hand_from_cam_left: Pose::from_parts(Vector3::new(-0.05, 0.07, 0.02), rotation(-0.1, 0.15, 0.3)),
        flange_from_hand: Pose::from_parts(Vector3::new(0.01, -0.03, 0.06), rotation(0.02, 0.1, -PI / 2.0)),
        law: LawConfig::Published(published(Gains {
            position_per_s: 3.0,
            velocity: 0.0,
            orientation_per_s: 6.0,
            angular_velocity: 0.0,
        })),
        damping: DampingConfig::default(),
        speed: SpeedConfig { tracking: wide, limit_approach_per_s: 20.0, soft_start_s: 0.0 },
        approach: ApproachConfig { speed: wide, done_within_m: 0.002, done_within_rad: 0.005 },
        timeouts: Timeouts { observation_s: 0.3, lost_s: 1.0, joints_s: 0.03 },
        search: None,
        joint_history_samples: 256,
    }
}

/// Covariance of a noise-free observation, with a high weight: 0.02 mm, 0.2 mrad.
pub fn sharp() -> Matrix6<f64> {
    let sigma = Vector6::new(2e-5, 2e-5, 2e-5, 2e-4, 2e-4, 2e-4);
    Matrix6::from_diagonal(&sigma.component_mul(&sigma))
}

/// Response of the joints.
#[derive(Clone, Copy)]
pub struct Plant {
    pub delay_steps: usize,
    pub lag_s: f64,
}

pub const IDEAL: Plant = Plant { delay_steps: 0, lag_s: 0.0 };

/// The cell: controller, arm, camera and clock.
pub struct Cell {
    pub controller: Controller,
    pub config: ControllerConfig,
    pub chain: Chain,
    pub limits: EffectiveLimits,
    pub step_s: f64,
    pub plant: Plant,
    /// Seconds from exposure to arrival.
    pub latency_s: f64,
    pub joints: JointState,
    pub time_s: f64,
    pub newest: Option<TargetObservation>,
    /// Directions that the images show.
    pub observed: [bool; 6],
    commands: VecDeque<JointVector>,
    in_flight: VecDeque<TargetObservation>,
    exposures: u64,
}

impl Cell {
    pub fn new(config: ControllerConfig, plant: Plant, latency_s: f64) -> Self {
        Self::at_speed_scale(1.0, config, plant, latency_s)
    }

    pub fn at_speed_scale(speed_scale: f64, config: ControllerConfig, plant: Plant, latency_s: f64) -> Self {
        let at = MonotonicTime::from_secs_f64(5.0);
        let joints = JointState { at, position_rad: START_RAD.into(), velocity_rad_per_s: JointVector::zeros() };
        Self {
            controller: Controller::new(config, chain(), limits(speed_scale)).unwrap(),
            config,
            chain: chain(),
            limits: limits(speed_scale),
            step_s: 0.002,
            plant,
            latency_s,
            joints,
            time_s: 5.0,
            newest: None,
            observed: [true; 6],
            commands: VecDeque::new(),
            in_flight: VecDeque::new(),
            exposures: 0,
        }
    }

    pub fn now(&self) -> MonotonicTime {
        MonotonicTime::from_secs_f64(self.time_s)
    }

    pub fn base_from_hand(&self) -> Pose<Base, Hand> {
        self.chain.forward(&self.joints.position_rad) * self.config.flange_from_hand
    }

    /// Observation of a model at this pose now.
    pub fn observe(&self, base_from_model: &Pose<Base, Model>) -> TargetObservation {
        let cam_from_base: Pose<CamLeft, Base> = (self.base_from_hand() * self.config.hand_from_cam_left).inverse();
        TargetObservation {
            at: self.now(),
            cam_left_from_model: cam_from_base * *base_from_model,
            trusted: true,
            covariance: Some(sharp()),
            observed: self.observed,
        }
    }

    /// Target pose for which the hand, moved by this (metres, rotation; in `base`), is at its desired pose.
    pub fn target_for_hand_moved(&self, by: Vector3<f64>, turn: UnitQuaternion<f64>) -> Pose<Base, Model> {
        let hand = self.base_from_hand();
        let desired = Pose::<Base, Hand>::from_parts(hand.translation_m() + by, turn * hand.rotation());
        desired * self.config.model_from_hand_desired.inverse()
    }

    /// Exposes and delivers images, steps the controller, moves the joints.
    pub fn step(&mut self, base_from_model: &Pose<Base, Model>) -> ControlStep {
        let elapsed_s = self.time_s - 5.0;
        if elapsed_s + 1e-9 >= self.exposures as f64 / 30.0 {
            self.exposures += 1;
            self.in_flight.push_back(self.observe(base_from_model));
        }
        let now = self.now();
        while self.in_flight.front().is_some_and(|o| now.seconds_since(o.at) >= self.latency_s) {
            self.newest = self.in_flight.pop_front();
        }
        self.step_controller()
    }

    /// As [`Self::step`], with the last delivered observation.
    pub fn step_controller(&mut self) -> ControlStep {
        let step = self.controller.step(&self.joints, self.newest.as_ref(), self.now());
        self.commands.push_back(match step.command {
            Command::Velocity(velocity) => velocity,
            Command::Hold => JointVector::zeros(),
        });
        if self.commands.len() > self.plant.delay_steps {
            let target = self.commands.pop_front().unwrap();
            let keep = if self.plant.lag_s > 0.0 { (-self.step_s / self.plant.lag_s).exp() } else { 0.0 };
            let velocity = target + (self.joints.velocity_rad_per_s - target) * keep;
            self.joints.position_rad += velocity * self.step_s;
            self.joints.velocity_rad_per_s = velocity;
        }
        self.time_s += self.step_s;
        self.joints.at = self.now();
        step
    }
}
