//! What differs between the workcells of the runs: wire format and speeds, and drives that differ from their model.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result};
use nalgebra::Vector6;
use pb3dp_arm_pa10_protocol::gateway_protocol::SharedKey;
use pb3dp_cell::cell::SimulatedCell;
use pb3dp_hal_middleware::StartPose;
use pb3dp_kinematics::{Damping, JointVector, reach};
use pb3dp_servo::LawConfig;
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::setup::{ArmSetup, Leader, Pace, Setup, read_layers};
use pb3dp_sim::joint_dynamics::JointMechanics;
use system_tests::repository;
use system_tests::safety::rules::{ArmRules, Rules};
use system_tests::safety::truth::HAND_ARM;

use crate::scenario::Dice;

/// Length of the history; disabling both arms takes less.
const HISTORY: Duration = Duration::from_secs(5);
/// Key of the lines that have one.
const KEY: [u8; 32] = [7; 32];
/// Share of the drives' speeds in `configs/sim.toml`, to which the rules refer.
const SPEED_SCALE: f64 = 0.6;

/// Kind of the lines between host and gateways.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Line {
    /// A serial line.
    Serial,
    /// A connection with a key: its frames travel in authentic records.
    Keyed,
}

/// The settings of a workcell that a setup states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Settings {
    /// Wire format of both controllers.
    pub wire_format: &'static str,
    /// Share of the drives' speeds, percent.
    pub speed_percent: u32,
    /// Lines to both gateways.
    pub line: Line,
    /// Whether an arm with six axes carries the cameras. It is simulated in the process, without a line.
    pub has_six_axes: bool,
}

impl Settings {
    /// Its properties, for tables.
    pub fn properties(&self) -> [&'static str; 3] {
        let Self { wire_format, line, has_six_axes, .. } = self;
        [
            if *wire_format == "A" { "wire format A" } else { "wire format B" },
            match line {
                Line::Serial => "lines without a key",
                Line::Keyed => "lines with a key",
            },
            if *has_six_axes { "six axes carry the cameras, without a line" } else { "seven axes carry the cameras" },
        ]
    }
}

/// Where both arms start: the target arm with other joint angles, the hand in front of the target as before.
#[derive(Clone, Debug)]
pub struct Start {
    /// Differences of the joint angles of the target arm, radians.
    target_by_rad: JointVector,
    /// The third axis of the hand's arm starts near its angle plus this, radians: another elbow.
    elbow_by_rad: f64,
}

impl Start {
    /// Draws a start: joints up to 9 degrees elsewhere, 100 mm and 20 degrees at the target.
    pub fn draw(dice: &mut Dice) -> Self {
        const TURN_RAD: f64 = 0.15;
        const ELBOW_RAD: f64 = 0.3;
        let target_by_rad = JointVector::from_fn(|_, _| dice.within(-TURN_RAD, TURN_RAD));
        Self { target_by_rad, elbow_by_rad: dice.within(-ELBOW_RAD, ELBOW_RAD) }
    }

    /// Changes the start of both arms of a setup. A start that is out of reach, or near the end of a joint's range, comes nearer
    /// to that of the setup.
    ///
    /// # Errors
    /// If the hand cannot reach its pose in front of the target even near that start.
    fn apply(&self, setup: &mut Setup) -> Result<()> {
        const SHARES: [f64; 4] = [1.0, 0.7, 0.4, 0.1];
        let starts = SHARES.map(|share| self.joints_rad(setup, share));
        let starts = starts.into_iter().flatten().next().context("no start of the arms is within reach")?;
        for (arm, start_rad) in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc].into_iter().zip(starts) {
            arm.start_rad = start_rad;
            if let StartPose::Near { position_rad, .. } = &mut arm.limiter.start {
                *position_rad = start_rad;
            }
        }
        Ok(())
    }

    /// Start of both arms at a share of the drawn differences, radians; none if out of reach, or near the end of a range.
    fn joints_rad(&self, setup: &Setup, share: f64) -> Option<[JointVector; 2]> {
        /// Smallest distance from the end of an operating range.
        const ROOM_RAD: f64 = 0.15;
        let damping = Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max).ok()?;
        let (vs, tc) = (&setup.rig.arms.vs, &setup.rig.arms.tc);
        let target_rad = tc.start_rad + self.target_by_rad * share;
        let world_from_flange = |joints_rad: &JointVector| tc.world_from_base * tc.chain.forward(joints_rad);
        let world_from_hand = vs.world_from_base * vs.chain.forward(&vs.start_rad);
        let target_from_hand = world_from_flange(&tc.start_rad).inverse() * world_from_hand;
        let base_from_hand = vs.world_from_base.inverse() * world_from_flange(&target_rad) * target_from_hand;
        let mut near_rad = vs.start_rad;
        near_rad[2] += self.elbow_by_rad * share;
        let hand_rad = reach(&vs.chain, &near_rad, &base_from_hand, &damping).ok()?;
        let has_room = |arm: &ArmSetup, joints_rad| arm.limits.operating().margin_rad(joints_rad).min() > ROOM_RAD;
        (has_room(vs, &hand_rad) && has_room(tc, &target_rad)).then_some([hand_rad, target_rad])
    }
}

/// How the arms differ from their description: friction of the drives, loads, and where the cameras really are.
#[derive(Clone, Debug)]
pub struct Differences {
    /// Dry friction of the drives of each arm, rad/s.
    friction_rad_per_s: [f64; 2],
    /// Gravity on the joints of each arm that nothing holds, as a share of that of the model.
    load: [f64; 2],
    /// Error of the hand-eye calibration: metres and radians, in the frame of the left camera.
    hand_eye: Vector6<f64>,
}

impl Differences {
    /// Draws differences. The hand-eye error is up to what the gates of a calibration refuse (`configs/hand_eye_gates.toml`).
    pub fn draw(dice: &mut Dice) -> Self {
        const FRICTION_RAD_PER_S: f64 = 0.002;
        const LOAD: f64 = 2.0;
        const HAND_EYE_M: f64 = 0.002;
        const HAND_EYE_RAD: f64 = 0.3 * PI / 180.0;
        let mut factor = |most: f64| most.powf(dice.within(-1.0, 1.0));
        let load = [factor(LOAD), factor(LOAD)];
        let friction_rad_per_s = [0, 1].map(|_| dice.within(0.0, FRICTION_RAD_PER_S));
        let most = |axis: usize| if axis < 3 { HAND_EYE_M } else { HAND_EYE_RAD };
        let hand_eye = Vector6::from_fn(|axis, _| dice.within(-1.0, 1.0) * most(axis) / f64::sqrt(3.0));
        Self { friction_rad_per_s, load, hand_eye }
    }

    fn apply_to_cameras(&self, cell: &mut SimulatedCell) {
        cell.hand_from_cam_left = cell.hand_from_cam_left.perturbed_in_from(&self.hand_eye);
    }

    fn apply(&self, cell: &mut SimulatedCell) -> Result<()> {
        self.apply_to_cameras(cell);
        for (arm, site) in [&cell.vs, &cell.tc].into_iter().enumerate() {
            let Some(plant) = site.joints.simulated() else { continue };
            let model = JointMechanics::default();
            let mechanics = JointMechanics {
                servo_friction_rad_per_s: JointVector::repeat(self.friction_rad_per_s[arm]),
                gravity_rad_per_s2: model.gravity_rad_per_s2 * self.load[arm],
                ..model
            };
            let mut plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
            *plant = plant.clone().with_mechanics(mechanics)?;
        }
        Ok(())
    }
}

/// The workcell of a run.
#[derive(Clone, Debug)]
pub struct Workcell {
    /// Its settings.
    pub settings: Settings,
    /// Time constant of the drives of each arm, as a share of that of the model.
    pub lag: [f64; 2],
    /// Delay of the arm in the model of the controller, as a share of the true one.
    pub model_delay: f64,
    /// Where the arms start, if not as in `configs/sim.toml`.
    pub start: Option<Start>,
    /// How the arms differ from their description, if they do.
    pub differences: Option<Differences>,
}

impl Default for Workcell {
    /// The workcell of `configs/hil.toml`, exactly known.
    fn default() -> Self {
        let settings = Settings { wire_format: "B", speed_percent: 60, line: Line::Serial, has_six_axes: false };
        Self { settings, lag: [1.0; 2], model_delay: 1.0, start: None, differences: None }
    }
}

impl Workcell {
    /// Draws a workcell; half of the runs have exactly known drives.
    pub fn draw(dice: &mut Dice) -> Self {
        /// Drives and their model differ by at most this factor.
        const FACTOR: f64 = 2.0;
        let settings = Settings {
            wire_format: dice.pick(&["B", "A"]),
            speed_percent: dice.pick(&[60, 60, 60, 25, 10]),
            line: Line::Serial,
            has_six_axes: false,
        };
        let is_known = dice.unit() < 0.5;
        let mut factor = || FACTOR.powf(dice.within(-1.0, 1.0));
        let factors = [factor(), factor(), factor()];
        let [first, second, model_delay] = if is_known { [1.0; 3] } else { factors };
        Self { settings, lag: [first, second], model_delay, start: None, differences: None }
    }

    /// The limits that hold in this workcell.
    pub fn rules(&self) -> Rules {
        let mut rules = Rules::of_the_rig();
        if self.settings.has_six_axes {
            rules.arms[HAND_ARM] = ArmRules::with_six_axes();
        }
        let speed = f64::from(self.settings.speed_percent) / 100.0 / SPEED_SCALE;
        let friction = self.differences.as_ref().map_or([0.0; 2], |differences| differences.friction_rad_per_s);
        for ((arm, lag), friction) in rules.arms.iter_mut().zip(self.lag).zip(friction) {
            arm.lag_s *= lag;
            arm.friction_rad_per_s = friction;
            arm.speed_rad_per_s = arm.speed_rad_per_s.map(|limit| limit * speed);
        }
        rules
    }

    /// Changes the drives of a setup, its model of them, and the start of the arms.
    ///
    /// # Errors
    /// If the hand cannot start there.
    pub fn apply(&self, setup: &mut Setup) -> Result<()> {
        for (arm, lag) in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc].into_iter().zip(self.lag) {
            arm.plant.velocity_time_constant = arm.plant.velocity_time_constant.mul_f64(lag);
        }
        if let LawConfig::FeedForward(law) = &mut setup.controller.law {
            law.arm.delay_s *= self.model_delay;
        }
        self.start.iter().try_for_each(|start| start.apply(setup))
    }

    /// Changes the true cell, which was wired with this setup.
    ///
    /// # Errors
    /// Never: the drawn values are possible ones.
    pub fn change(&self, cell: &mut SimulatedCell) -> Result<()> {
        self.differences.iter().try_for_each(|differences| differences.apply(cell))
    }

    /// Changes what a new host finds of the true cell: the cameras are where they were, whatever its calibration states.
    pub fn change_again(&self, cell: &mut SimulatedCell) {
        self.differences.iter().for_each(|differences| differences.apply_to_cameras(cell));
    }
}

/// The setups of all settings, each read once.
#[derive(Default)]
pub struct Setups(Mutex<BTreeMap<(Settings, bool), Arc<Setup>>>);

impl Setups {
    /// The setup of `configs/hil.toml` with these settings, in simulated time, with or without images.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn get(&self, settings: Settings, rendered: bool) -> Result<Arc<Setup>> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(setup) = known.get(&(settings, rendered)) {
            return Ok(Arc::clone(setup));
        }
        let setup = Arc::new(read(settings, rendered)?);
        known.insert((settings, rendered), Arc::clone(&setup));
        Ok(setup)
    }
}

fn read(settings: Settings, rendered: bool) -> Result<Setup> {
    let Settings { wire_format, speed_percent, line, has_six_axes } = settings;
    let formats = ["vs", "tc"].map(|arm| format!("arms.{arm}.gateway.wire_format=\"{wire_format}\""));
    let speed = format!("arms.speed_scale={}", f64::from(speed_percent) / 100.0);
    let six_axes = has_six_axes.then(|| "arms.carries_cameras=\"ur5e\"".to_owned());
    let set = formats.into_iter().chain([speed]).chain(six_axes).collect();
    let args = SetupArgs { configs: vec![repository().join("configs/hil.toml")], set, ..SetupArgs::default() };
    let mut setup = read_layers(&args).with_context(|| format!("configs/hil.toml with {settings:?}"))?;
    setup.pace = Pace::Fast;
    setup.compared.clear();
    if !rendered {
        setup.leader = Leader::Geometric(setup.geometric.context("configs/hil.toml has no table estimator.geometric")?);
    }
    for arm in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc] {
        arm.plant.history = HISTORY;
        if line == Line::Keyed {
            arm.emulation_key = Some(SharedKey::new(&KEY)?);
        }
    }
    Ok(setup)
}
