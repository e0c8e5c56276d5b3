//! The table `[arms]`: base poses, robot descriptions, limits, and the response of simulated drives.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use nalgebra::Point3;
use pb3dp_arm_pa10_protocol::codec::PA10_SPEED_MAX_RAD_PER_S;
use pb3dp_arm_pa10_protocol::gateway_protocol::SharedKey;
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, World};
use pb3dp_hal_middleware::{
    CommandFade, CoupledArmConfig, GuardConfig, LimiterConfig, PA10_MECHANICAL_RANGE_DEG, StartPose,
};
use pb3dp_kinematics::{
    ArmShape, Chain, DOF, EffectiveLimits, JointFrames, JointLimits, JointVector, NO_JOINT_RAD, StatedLimits,
};
use pb3dp_record::text_file::read_text;
use pb3dp_sim::joint_dynamics::{JointPlantConfig, PA10_ANGLE_QUANTUM_RAD};
use serde::Deserialize;

use super::super::arm_backend::ArmBackend;
use super::super::layers::built_in;
use super::super::load::{Checker, within};
use super::geometry::check_geometry;
use super::link::{ArmLink, GatewaySection};
use super::shape::{PartEntry, build_shape};
use super::{IN_THE_CELL_MM, PoseEntry, millis};

/// Settings of one arm, ready for its backend.
#[derive(Clone, Debug)]
pub struct ArmSetup {
    /// Its table of the setup: `arms.vs`.
    pub key: String,
    /// Its link.
    pub link: ArmLink,
    /// Kinematics.
    pub chain: Chain,
    /// Base pose.
    pub world_from_base: Pose<World, Base>,
    /// Joint angles at the start, rad.
    pub start_rad: JointVector,
    /// Response of the simulated drives.
    pub plant: JointPlantConfig,
    /// Effective limits: limiter, guard, coupling, controller and planner receive these.
    pub limits: EffectiveLimits,
    /// Settings of the limiter before the drives.
    pub limiter: LimiterConfig,
    /// Settings of the guard after the drives.
    pub guard: GuardConfig,
    /// Shape of the arm with its tool, for the clearance between both arms.
    pub shape: ArmShape,
    /// The arm stops without a new command for this time.
    pub command_timeout: Duration,
    /// Seed of the random faults of an emulated arm.
    pub emulation_seed: u64,
    /// Key of the line of the emulated arm in simulated time; no file states it.
    pub emulation_key: Option<SharedKey>,
    /// File with the passed steps of `pb3dp arm test`, if the setup states one.
    pub commissioning_record: Option<PathBuf>,
}

/// The arms of a rig. Each has a table of the setup; two of them take part in a run.
#[derive(Clone, Debug)]
pub struct Arms {
    /// The arm that carries the cameras.
    pub vs: ArmSetup,
    /// The arm that carries the target.
    pub tc: ArmSetup,
    /// The arms that take no part, by the names of their tables.
    pub others: BTreeMap<String, ArmSetup>,
}

impl ArmSetup {
    /// Name of a joint in messages, 0 at the base: `axis 2 (S2)`, with its name in the robot description.
    pub fn axis_name(&self, joint: usize) -> String {
        let name = self.chain.joint_names().get(joint).map(|name| name.to_uppercase()).unwrap_or_default();
        format!("axis {} ({name})", joint + 1)
    }

    /// Information for the coupling of both arms.
    pub fn coupled(&self) -> CoupledArmConfig {
        CoupledArmConfig {
            chain: self.chain.clone(),
            shape: self.shape.clone(),
            world_from_base: self.world_from_base,
            limits: self.limits,
            reaction_time: self.limiter.reaction_time,
            command_timeout: self.limiter.command_timeout,
            fade: self.limiter.fade,
        }
    }
}

/// Settings that both arms share, and the names of the arms of this run.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmsSection {
    #[serde(default = "vs_name")]
    carries_cameras: String,
    #[serde(default = "tc_name")]
    carries_target: String,
    #[serde(default = "rig_speed_scale")]
    pub(super) speed_scale: f64,
    #[serde(default = "yes")]
    pub(super) first_run: bool,
    pub(super) stale_after_millis: f64,
    tracking_error_max_deg: f64,
    tracking_error_millis: f64,
    pub(super) least_room_mm: f64,
}

/// The arms of a setup, by their names.
pub(super) type ArmTables = BTreeMap<String, ArmSection>;

/// Default table of the arm with the cameras.
fn vs_name() -> String {
    "vs".to_owned()
}

/// Default table of the arm with the target.
fn tc_name() -> String {
    "tc".to_owned()
}

/// Default share of the joint speed limits, R11 of the requirements.
fn rig_speed_scale() -> f64 {
    0.10
}

/// Largest share on the first run.
pub(super) const FIRST_RUN_SPEED_SCALE: f64 = 0.25;

/// Default: the arms have not been run yet.
fn yes() -> bool {
    true
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmSection {
    backend: ArmBackend,
    gateway: Option<GatewaySection>,
    robot: String,
    base_link: String,
    flange_link: String,
    world_from_base: PoseEntry,
    parts: Vec<PartEntry>,
    start_deg: Vec<f64>,
    mechanical_range_deg: Vec<f64>,
    operating_range_deg: Vec<f64>,
    acceleration_max_rad_per_s2: Vec<f64>,
    jerk_max_rad_per_s3: Vec<f64>,
    velocity_time_constant_millis: f64,
    command_delay_millis: f64,
    command_timeout_millis: f64,
    commissioning_record: Option<PathBuf>,
}

/// Joint history of the simulation, for the arm poses at the times of exposures.
const PLANT_HISTORY: Duration = Duration::from_secs(1);

/// Upper bounds of the accelerations, rad/s^2, before the wrist and in it: chosen, no source has any (docs/arm-limits.md).
const ACCELERATION_MAX_RAD_PER_S2: [f64; 2] = [2.0, 5.0];

/// Number of wrist joints.
const WRIST_JOINTS: usize = 3;

/// Upper bound of the acceleration of a joint of an arm with seven joints, rad/s^2; `joint` counts from the base, from 0.
pub fn acceleration_max_rad_per_s2(joint: usize) -> f64 {
    ACCELERATION_MAX_RAD_PER_S2[usize::from(joint + WRIST_JOINTS >= DOF)]
}

fn check_accelerations(key: &str, accelerations: &[f64], check: &mut Checker) {
    for (joint, &value) in accelerations.iter().enumerate() {
        let is_in_wrist = joint + WRIST_JOINTS >= accelerations.len();
        let most = ACCELERATION_MAX_RAD_PER_S2[usize::from(is_in_wrist)];
        check.number(&format!("{key}.acceleration_max_rad_per_s2[{joint}]"), value, 0.01..=most);
    }
}

/// Behaviour of a velocity without a successor: the driver of a real arm fades it.
fn fade(link: &ArmLink) -> Option<CommandFade> {
    let watchdog = CommandWatchdog::default();
    match link {
        ArmLink::InProcess => None,
        ArmLink::Gateway(..) => {
            Some(CommandFade { begins_after: watchdog.ramp_after(), ends_after: watchdog.stop_after() })
        }
    }
}

impl ArmsSection {
    /// Whether an arm of this run is behind a link.
    pub(super) fn has_link(&self, tables: &ArmTables) -> bool {
        let names = [&self.carries_cameras, &self.carries_target];
        let mut arms = names.into_iter().filter_map(|name| tables.get(name));
        arms.any(|arm| arm.gateway.is_some())
    }

    /// All arms; `None` if a file cannot be read or a limit is refused.
    pub(super) fn build(&self, tables: &ArmTables, control_period_millis: f64, check: &mut Checker) -> Option<Arms> {
        check.number("arms.speed_scale", self.speed_scale, 0.01..=1.0);
        if self.first_run && self.speed_scale > FIRST_RUN_SPEED_SCALE && self.speed_scale <= 1.0 {
            check.refuse(format!(
                "arms.speed_scale = {}: at most {FIRST_RUN_SPEED_SCALE} on the first run (arms.first_run, also if it is not set)",
                self.speed_scale
            ));
        }
        check.number("arms.stale_after_millis", self.stale_after_millis, control_period_millis..=200.0);
        // Rounded up to a tenth of a degree.
        let tracking_error_max_deg = (GuardConfig::TRACKING_ERROR_MAX_RAD.to_degrees() * 10.0).ceil() / 10.0;
        check.number("arms.tracking_error_max_deg", self.tracking_error_max_deg, 0.1..=tracking_error_max_deg);
        check.number("arms.least_room_mm", self.least_room_mm, 1.0..=1000.0);
        let tracking_error_millis = control_period_millis..=GuardConfig::TRACKING_ERROR_FOR.as_secs_f64() * 1e3;
        check.number("arms.tracking_error_millis", self.tracking_error_millis, tracking_error_millis);
        let mut arms: BTreeMap<String, Option<ArmSetup>> = tables
            .iter()
            .map(|(name, table)| {
                (name.clone(), table.build(&format!("arms.{name}"), self, control_period_millis, check))
            })
            .collect();
        if self.carries_cameras == self.carries_target {
            check.refuse(format!(
                "arms.carries_cameras = {:?}: arms.carries_target is the same; one arm carries the cameras, another one the target",
                self.carries_cameras
            ));
        }
        let mut take = |key: &str, name: &str| {
            arms.remove(name).unwrap_or_else(|| {
                let known: Vec<&str> = tables.keys().map(String::as_str).collect();
                check.refuse(format!(
                    "arms.{name}: missing; {key} = {name:?} needs this table, or a file arms/{name}.toml beside the one that says so (there \
                     is {})",
                    if known.is_empty() { "no arm".to_owned() } else { known.join(", ") }
                ));
                None
            })
        };
        let vs = take("arms.carries_cameras", &self.carries_cameras);
        let tc = take("arms.carries_target", &self.carries_target);
        if [&vs, &tc].into_iter().flatten().any(|arm| !arm.link.is_toy()) {
            check.number("arms.least_room_mm", self.least_room_mm, REAL_ROOM_MIN_MM..=1000.0);
        }
        let others = arms.into_iter().filter_map(|(name, arm)| Some((name, arm?))).collect();
        Some(Arms { vs: vs?, tc: tc?, others })
    }
}

/// Smallest distance to keep between two arms if one of them is not emulated: shapes are drawn by hand, and arms bend.
const REAL_ROOM_MIN_MM: f64 = 10.0;

/// Half of the thickness that every link of a PA-10 has at least, metres: chosen, a good deal less than its wrist.
const LINK_RADIUS_MIN_M: f64 = 0.04;
/// Depth of what a flange carries below the surface of a part, metres: chosen, half a camera without its lens.
const CARRIED_DEPTH_M: f64 = 0.01;

impl ArmSetup {
    /// Checks that the collision shape of an arm that is not emulated encloses the arm and what its flange carries, points by their names:
    /// at the start, stretched out, and bent. Otherwise no clearance is ever too small.
    pub(super) fn check_shape(&self, carried: &[(&str, Point3<f64>)], check: &mut Checker) {
        if self.link.is_toy() {
            return;
        }
        let (key, shape) = (&self.key, &self.shape);
        let bent_rad = self.limits.operating().position_max_rad() * 0.5;
        let poses =
            [self.start_rad, JointVector::zeros(), bent_rad].map(|joints_rad| self.chain.joint_frames(&joints_rad));
        if let Some(piece) = poses.iter().find_map(|frames| shape.bare_piece(frames, LINK_RADIUS_MIN_M)) {
            check.refuse(format!(
                "{key}.parts: the arm is bare {piece}, and nothing would keep a distance from it; enclose each link with its cables, at \
                 least {:.0} mm around the line through the joints, in a part that moves with it",
                1e3 * LINK_RADIUS_MIN_M
            ));
        }
        for (name, in_flange) in carried {
            let place = |frames: &JointFrames| frames.base_from_flange.isometry() * in_flange;
            if !poses.iter().all(|frames| shape.covers(frames, place(frames), CARRIED_DEPTH_M)) {
                check.refuse(format!(
                    "{key}.parts: {name} is in no part, and nothing would keep a distance from it; enclose all that the flange carries in \
                     parts with on = \"flange\""
                ));
            }
        }
    }
}

/// A robot description may state less than the drives of a PA-10 can do, not more: its speeds times `arms.speed_scale` are the limits.
fn check_speeds((key, file): (&str, &Path), chain: &Chain, check: &mut Checker) {
    let stated = chain.limits().velocity_max_rad_per_s();
    for (joint, most) in PA10_SPEED_MAX_RAD_PER_S.into_iter().enumerate().filter(|(joint, most)| stated[*joint] > *most)
    {
        check.refuse(format!(
            "{key}.robot: {}: axis {} has velocity = {} rad/s; the drive of a PA-10 turns it by at most {most:.4} rad/s (data sheet)",
            file.display(),
            joint + 1,
            stated[joint]
        ));
    }
}

/// Numbers for each joint, from a file; `without` for the unused capacity.
fn per_joint(numbers: &[f64], without: f64) -> JointVector {
    JointVector::from_fn(|joint, _| numbers.get(joint).copied().unwrap_or(without))
}

/// Half of a symmetric range, rad.
fn range_rad(range_deg: &[f64]) -> JointVector {
    per_joint(range_deg, NO_JOINT_RAD.to_degrees()).map(f64::to_radians).map(|end| end.min(NO_JOINT_RAD))
}

impl ArmSection {
    fn build(&self, key: &str, all: &ArmsSection, control_period_millis: f64, check: &mut Checker) -> Option<ArmSetup> {
        let link = self.backend.link(self.gateway.as_ref(), (key, control_period_millis), check);
        let accelerations = &self.acceleration_max_rad_per_s2;
        check_accelerations(key, accelerations, check);
        check.numbers(&format!("{key}.jerk_max_rad_per_s3"), &self.jerk_max_rad_per_s3, 0.1..=10_000.0);
        let lag = self.velocity_time_constant_millis;
        check.number(&format!("{key}.velocity_time_constant_millis"), lag, 0.0..=1000.0);
        check.number(&format!("{key}.command_delay_millis"), self.command_delay_millis, 0.0..=500.0);
        let timeout = self.command_timeout_millis;
        self.check_timeout(key, control_period_millis, check);
        let world_from_base = self.world_from_base.build(&format!("{key}.world_from_base"), IN_THE_CELL_MM, check);
        let shape = build_shape(&format!("{key}.parts"), &self.parts, check);
        let chain = self.chain(key, link.as_ref(), check);
        let has_all = self.check_lengths(key, chain.as_ref(), check);
        // Without a valid robot description the angles cannot be checked.
        if let Some(chain) = chain.as_ref().filter(|_| has_all) {
            self.check_angles(key, chain.limits(), check);
        }
        let (chain, shape) = chain.zip(shape).filter(|_| has_all)?;
        let start_rad = per_joint(&self.start_deg, 0.0).map(f64::to_radians);
        let mechanical_max_rad = range_rad(&self.mechanical_range_deg);
        let limits = self.limits((key, all.speed_scale), &chain, check)?;
        let link = link?.limited(&limits).map_err(|error| check.refuse(format!("{key}: {error}"))).ok()?;
        let fade = fade(&link);
        Some(ArmSetup {
            key: key.to_owned(),
            link,
            world_from_base,
            shape,
            start_rad,
            plant: JointPlantConfig {
                limits: *limits.servo(),
                acceleration_max_rad_per_s2: *limits.acceleration_max_rad_per_s2(),
                velocity_time_constant: millis(lag),
                command_delay: millis(self.command_delay_millis),
                angle_quantum_rad: PA10_ANGLE_QUANTUM_RAD,
                history: PLANT_HISTORY,
            },
            limits,
            limiter: LimiterConfig {
                reaction_time: millis(control_period_millis + self.command_delay_millis + lag),
                command_timeout: millis(timeout),
                fade,
                stale_after: millis(all.stale_after_millis),
                start: StartPose::Near { position_rad: start_rad, tolerance_rad: StartPose::TOLERANCE_RAD },
            },
            guard: GuardConfig {
                mechanical_min_rad: -mechanical_max_rad,
                mechanical_max_rad,
                ripple_rad_per_s: 0.0,
                delay: millis(self.command_delay_millis),
                lag: millis(lag),
                tracking_error_max_rad: all.tracking_error_max_deg.to_radians(),
                tracking_error_for: millis(all.tracking_error_millis),
            },
            command_timeout: millis(timeout),
            emulation_seed: 0, // Each run seeds it: `Setup::reseed`.
            emulation_key: None,
            commissioning_record: self.commissioning_record.clone(),
            chain,
        })
    }

    /// Effective limits of the arm. A refused number is replaced by a possible one, so that all other problems are found too.
    fn limits(&self, (key, speed_scale): (&str, f64), chain: &Chain, check: &mut Checker) -> Option<EffectiveLimits> {
        let servo = *chain.limits();
        let operating_max_rad = range_rad(&self.operating_range_deg);
        let stated = StatedLimits {
            servo,
            operating_min_rad: -operating_max_rad,
            operating_max_rad,
            speed_scale,
            acceleration_max_rad_per_s2: per_joint(&self.acceleration_max_rad_per_s2, 1.0),
            jerk_max_rad_per_s3: per_joint(&self.jerk_max_rad_per_s3, 1.0),
        };
        let possible = StatedLimits {
            servo,
            operating_min_rad: *servo.position_min_rad(),
            operating_max_rad: *servo.position_max_rad(),
            speed_scale: 1.0,
            acceleration_max_rad_per_s2: JointVector::repeat(1.0),
            jerk_max_rad_per_s3: JointVector::repeat(1.0),
        };
        let instead = |error| {
            if check.is_clean() {
                check.refuse(format!("{key}: {error}"));
            }
            possible.effective()
        };
        stated.effective().or_else(instead).ok()
    }

    /// The limiter keeps a margin for the time in which the arm may continue with its last command.
    fn check_timeout(&self, key: &str, control_period_millis: f64, check: &mut Checker) {
        let timeout = self.command_timeout_millis;
        let least = self.backend.goes_on_millis(control_period_millis);
        check.number(&format!("{key}.command_timeout_millis"), timeout, least..=200.0);
    }

    /// Every list must have one number per joint of the robot, and every part must belong to an existing joint.
    fn check_lengths(&self, key: &str, chain: Option<&Chain>, check: &mut Checker) -> bool {
        let lists = [
            ("start_deg", &self.start_deg),
            ("mechanical_range_deg", &self.mechanical_range_deg),
            ("operating_range_deg", &self.operating_range_deg),
            ("acceleration_max_rad_per_s2", &self.acceleration_max_rad_per_s2),
            ("jerk_max_rad_per_s3", &self.jerk_max_rad_per_s3),
        ];
        let joints = chain.map_or(self.start_deg.len(), Chain::joints);
        let wrong = lists.into_iter().filter(|(_, list)| list.len() != joints);
        let wrong: Vec<String> = wrong
            .map(|(name, list)| {
                format!(
                    "{key}.{name}: {} numbers, but {key}.robot has {joints} joints; give one for each, base to tip",
                    list.len()
                )
            })
            .collect();
        for (index, part) in self.parts.iter().enumerate() {
            if let Some(joint) = part.joint().filter(|joint| *joint >= joints) {
                check.refuse(format!(
                    "{key}.parts[{index}].on = \"joint {joint}\": {key}.robot has joint 0 to joint {}",
                    joints.saturating_sub(1)
                ));
            }
        }
        let has_all = wrong.is_empty();
        wrong.into_iter().for_each(|line| check.refuse(line));
        has_all && joints <= DOF
    }

    /// The operating range is inside the limits of the robot's joints, these are inside the mechanical range, and the start is
    /// inside the operating range.
    fn check_angles(&self, key: &str, limits: &JointLimits, check: &mut Checker) {
        let ranges = self.operating_range_deg.iter().copied().zip(self.start_deg.iter().copied());
        for (joint, (operating_deg, start_deg)) in ranges.enumerate() {
            let hard_rad = limits.position_max_rad()[joint].min(-limits.position_min_rad()[joint]);
            let outer_rad = limits.position_max_rad()[joint].max(-limits.position_min_rad()[joint]);
            let outer_deg = (outer_rad.to_degrees() * 100.0).ceil() / 100.0;
            let mechanical_deg = self.mechanical_range_deg[joint];
            let most_deg = PA10_MECHANICAL_RANGE_DEG[joint].max(outer_deg);
            check.number(&format!("{key}.mechanical_range_deg[{joint}]"), mechanical_deg, outer_deg..=most_deg);
            let hard_deg = ((hard_rad.to_degrees() * 100.0).floor() / 100.0).max(1.0);
            check.number(&format!("{key}.operating_range_deg[{joint}]"), operating_deg, 1.0..=hard_deg);
            let operating_deg = within(operating_deg, 1.0, hard_deg);
            check.number(&format!("{key}.start_deg[{joint}]"), start_deg, -operating_deg..=operating_deg);
        }
    }

    /// The robot description, compared with the link lengths of the stated geometry.
    fn chain(&self, key: &str, link: Option<&ArmLink>, check: &mut Checker) -> Option<Chain> {
        let file = Path::new(&self.robot);
        let xml = match built_in::text_at(&self.robot) {
            Some(text) => text.to_owned(),
            None => read_text(file)
                .inspect_err(|error| check.refuse(format!("{key}.robot: {} cannot be read: {error}", file.display())))
                .ok()?,
        };
        let chain = Chain::from_urdf_str(&xml, &self.base_link, &self.flange_link)
            .inspect_err(|error| check.refuse(format!("{key}.robot: {}: {error}", file.display())))
            .ok()?;
        if link.is_some_and(|link| !matches!(link, ArmLink::InProcess)) && chain.joints() != DOF {
            check.refuse(format!(
                "{key}.robot: {} has {} joints; a PA-10, which is what {key}.backend drives, has {DOF}: with other arms only \"mock\" is possible",
                file.display(),
                chain.joints()
            ));
            return None;
        }
        if link.is_some_and(|link| !matches!(link, ArmLink::InProcess)) {
            check_speeds((key, file), &chain, check);
        }
        if let Some(geometry) = link.and_then(ArmLink::geometry) {
            check_geometry(key, geometry, &chain, check);
        }
        Some(chain)
    }
}
