//! Approaches to a stationary target, and tracking of a target through or to singular poses; without images.

use std::sync::PoisonError;

use anyhow::{Context, Result, bail, ensure};
use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_cell::experiment;
use pb3dp_cell::figures::TrackingError;
use pb3dp_cell::log::{ControlSample, RunLog};
use pb3dp_cell::perception::TargetSource;
use pb3dp_geometry::frames::{Base, Flange, Hand, Model, Target, World};
use pb3dp_geometry::{Pose, so3};
use pb3dp_hal_middleware::StartPose;
use pb3dp_kinematics::{Damping, JointVector, damped_pseudo_inverse};
use pb3dp_record::metrics::settled_from;
use pb3dp_setup::setup::{Leader, Setup};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, StepExperimentConfig};
use pb3dp_wiring::wire;
use system_tests::watched::watched;

use crate::limit_use::LimitUse;
use crate::setups::geometric;

/// The hand has arrived if it stays within this of its desired pose by the initial lock: mm and degrees.
pub const THERE_WITHIN: (f64, f64) = (1.0, 0.3);
/// Duration of an approach, seconds.
const APPROACH_S: f64 = 20.0;
/// Distance up to which the target is visible, metres.
pub const MEASURED_UP_TO_M: f64 = 1.4;

/// Result of an approach or path.
pub struct Way {
    /// Name in tables.
    pub name: String,
    /// Error of the hand at the start: mm and degrees.
    pub off: (f64, f64),
    /// Time until the hand stays at its desired pose, seconds; none if it does not.
    pub there_after_s: Option<f64>,
    /// State of the controller at the end, and the reason.
    pub mode: String,
    /// Error at the end: mm and degrees.
    pub left: (f64, f64),
    /// Largest error while the target moved and during the second after it, mm and degrees.
    pub most: (f64, f64),
    /// Smallest singular value on the path.
    pub singular_value_min: f64,
    /// Share of the time between the lock and the end in which the arm was on hold, with the first reason.
    pub held: (f64, Option<String>),
    /// Use of the arm's limits.
    pub used: LimitUse,
    /// The path of the hand.
    pub path: PathShape,
}

/// The path of the hand from start to end.
#[derive(Clone, Copy, Debug)]
pub struct PathShape {
    /// Path length, mm.
    pub length_mm: f64,
    /// Distance from start to end, mm.
    pub straight_mm: f64,
    /// Largest distance from the straight line between both, mm.
    pub aside_mm: f64,
    /// Largest distance between hand and target, mm.
    pub farthest_mm: f64,
    /// Smallest distance of the target's outline from the border of either image, pixels; negative outside.
    pub border_px: f64,
}

/// Places the hand at `start_rad` and the target so that the desired hand pose is `world_from_hand`.
pub fn place(setup: &mut Setup, start_rad: JointVector, world_from_hand: &Pose<World, Hand>) {
    setup.rig.arms.vs.start_rad = start_rad;
    setup.rig.arms.vs.limiter.start =
        StartPose::Near { position_rad: start_rad, tolerance_rad: StartPose::TOLERANCE_RAD };
    let world_from_target =
        *world_from_hand * setup.controller.model_from_hand_desired.inverse().relabel::<Hand, Target>();
    // The other arm is stationary and far away, and does not carry the target.
    let aside = Pose::<World, World>::from_translation(Vector3::new(20.0, 0.0, 0.0));
    setup.rig.arms.tc.world_from_base = aside * setup.rig.arms.tc.world_from_base;
    let world_from_flange =
        setup.rig.arms.tc.world_from_base * setup.rig.arms.tc.chain.forward(&setup.rig.arms.tc.start_rad);
    setup.rig.flange_from_target = world_from_flange.inverse() * world_from_target;
    if let Leader::Geometric(config) = &mut setup.leader {
        config.z_max_m = MEASURED_UP_TO_M;
    }
}

/// Pose of the hand at these joints.
pub fn world_from_hand(setup: &Setup, position_rad: &JointVector) -> Pose<World, Hand> {
    setup.rig.arms.vs.world_from_base
        * setup.rig.arms.vs.chain.forward(position_rad)
        * setup.controller.flange_from_hand
}

/// Joints with the hand at this pose, near `guess_rad`.
///
/// # Errors
/// If none are found near the guess.
pub fn joints_at(setup: &Setup, hand: &Pose<World, Hand>, guess_rad: &JointVector) -> Result<JointVector> {
    let wanted: Pose<Base, Flange> =
        setup.rig.arms.vs.world_from_base.inverse() * *hand * setup.controller.flange_from_hand.inverse();
    let damping = Damping::new(1e-3, 1e-3)?;
    let mut position_rad = *guess_rad;
    for _ in 0..2000 {
        let is = setup.rig.arms.vs.chain.forward(&position_rad);
        let turn = so3::log(&(wanted.rotation() * is.rotation().inverse()));
        let error = pb3dp_geometry::se3::join(&(wanted.translation_m() - is.translation_m()), &turn);
        if error.norm() < 1e-9 {
            let margin_rad = setup.rig.arms.vs.limits.operating().position_max_rad() - position_rad.abs();
            ensure!(
                margin_rad.min() > 0.0,
                "a joint exceeds its range by {:.1} degrees",
                -margin_rad.min().to_degrees()
            );
            return Ok(position_rad);
        }
        let step = damped_pseudo_inverse(&setup.rig.arms.vs.chain.jacobian(&position_rad), &damping) * error;
        position_rad += step * (0.05 / step.amax()).min(1.0);
    }
    anyhow::bail!("no joints for the hand at {:?}", hand.translation_m())
}

/// A stationary target.
pub fn at_rest() -> MotionConfig {
    MotionConfig::Steps(StepExperimentConfig {
        channels: vec![Channel::X],
        translation_m: 0.0,
        rotation_rad: 0.0,
        move_s: 0.05,
        hold_s: 0.0,
        lead_in_s: APPROACH_S,
        axes: ExperimentAxes::World,
    })
}

/// A target that moves along an axis of the world and returns.
pub fn out_and_back(channel: Channel, translation_m: f64, move_s: f64) -> MotionConfig {
    MotionConfig::Steps(StepExperimentConfig {
        channels: vec![channel],
        translation_m,
        rotation_rad: 0.0,
        move_s,
        hold_s: 3.0,
        lead_in_s: 3.0,
        axes: ExperimentAxes::World,
    })
}

/// Runs a setup with placed hand and target.
///
/// # Errors
/// Errors of the parts.
pub fn run_way(name: impl Into<String>, setup: &Setup) -> Result<Way> {
    let (parts, vs, _) = watched(wire(setup)?);
    let TargetSource::Outline(outline_m) = parts.marking.clone() else { bail!("the target is not simulated") };
    let log = experiment::run(setup, parts, None, None)?.log;
    let measured_states = vs.measured.lock().unwrap_or_else(PoisonError::into_inner);
    let (first, last) = log.control.first().zip(log.control.last()).context("the run has no steps")?;
    let errors: Vec<TrackingError> = log.control.iter().map(TrackingError::of_locked).collect();
    let mm: Vec<f64> = errors.iter().map(|error| error.position_m * 1e3).collect();
    let deg: Vec<f64> = errors.iter().map(|error| error.orientation_rad.to_degrees()).collect();
    let there = settled_from(&[(&mm, THERE_WITHIN.0), (&deg, THERE_WITHIN.1)]);
    let begins_s = log.marks.first().map_or(0.0, |mark| mark.at_s);
    let moving = |sample: &ControlSample| sample.t_s >= begins_s;
    let most = |of: &[f64]| {
        log.control.iter().zip(of).filter(|(sample, _)| moving(sample)).map(|(_, value)| *value).fold(0.0, f64::max)
    };
    let end = |of: &[f64]| of.last().copied().unwrap_or(f64::NAN);
    Ok(Way {
        name: name.into(),
        off: (mm[0], deg[0]),
        there_after_s: there.map(|index| log.control[index].t_s - first.t_s),
        mode: last.mode.clone(),
        left: (end(&mm), end(&deg)),
        most: (most(&mm), most(&deg)),
        singular_value_min: log
            .control
            .iter()
            .map(|sample| sample.smallest_singular_value)
            .fold(f64::INFINITY, f64::min),
        held: held(&log),
        used: LimitUse::of(setup, &measured_states),
        path: path_shape(setup, &log, &outline_m),
    })
}

/// Share of the steps after the lock in which the controller held, and the first reason.
fn held(log: &RunLog) -> (f64, Option<String>) {
    let locked_s = log.lock.map_or(0.0, |lock| lock.at_s + 0.3);
    let after: Vec<&ControlSample> = log.control.iter().filter(|sample| sample.t_s > locked_s).collect();
    let rests = |sample: &&&ControlSample| !matches!(sample.mode_name(), "approaching" | "tracking");
    let count = after.iter().filter(rests).count();
    (count as f64 / after.len().max(1) as f64, after.iter().find(rests).map(|sample| sample.mode.clone()))
}

fn path_shape(setup: &Setup, log: &RunLog, outline_m: &[nalgebra::Point3<f64>]) -> PathShape {
    let points: Vec<Vector3<f64>> = log.control.iter().map(|sample| sample.world_from_hand.translation_m()).collect();
    let (from, to) = (points[0], points[points.len() - 1]);
    let way = to - from;
    let aside = |point: &Vector3<f64>| {
        let share =
            if way.norm() > 1e-6 { ((point - from).dot(&way) / way.norm_squared()).clamp(0.0, 1.0) } else { 0.0 };
        (point - from - way * share).norm()
    };
    let border = |sample: &ControlSample| {
        let world_from_cam = sample.world_from_hand * setup.controller.hand_from_cam_left;
        let cam_left_from_target = world_from_cam.inverse() * sample.world_from_target;
        border_px(setup, &cam_left_from_target, outline_m)
    };
    let target_m = |sample: &ControlSample| {
        (sample.world_from_target.translation_m() - sample.world_from_hand.translation_m()).norm()
    };
    PathShape {
        length_mm: points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum::<f64>() * 1e3,
        straight_mm: way.norm() * 1e3,
        aside_mm: points.iter().map(aside).fold(0.0, f64::max) * 1e3,
        farthest_mm: log.control.iter().map(target_m).fold(0.0, f64::max) * 1e3,
        border_px: log.control.iter().map(border).fold(f64::INFINITY, f64::min),
    }
}

/// Smallest distance of the outline from the border of either image; minus infinity if a point is behind a camera.
fn border_px(
    setup: &Setup,
    cam_left_from_target: &Pose<pb3dp_geometry::frames::CamLeft, Target>,
    outline_m: &[nalgebra::Point3<f64>],
) -> f64 {
    let rig = &setup.rig.stereo;
    let inside = |pixel: Option<nalgebra::Vector2<f64>>, (width, height): (f64, f64)| {
        pixel.map_or(f64::NEG_INFINITY, |p| p.x.min(p.y).min(width - 1.0 - p.x).min(height - 1.0 - p.y))
    };
    let least = |point: &nalgebra::Point3<f64>| {
        let left = cam_left_from_target.transform_point(point);
        let right = rig.cam_right_from_cam_left().transform_point(&left);
        let size = |camera: &pb3dp_geometry::Camera| (f64::from(camera.size().width), f64::from(camera.size().height));
        let in_left = inside(rig.left().project(&left), size(rig.left()));
        in_left.min(inside(rig.right().project(&right), size(rig.right())))
    };
    outline_m.iter().map(least).fold(f64::INFINITY, f64::min)
}

/// A hand that starts 500 mm or farther from the target, turned about an axis of the target by this; it should end at
/// `to`.
///
/// # Errors
/// If no joints reach the start.
pub fn approach_from(
    mut setup: Setup,
    to: &Pose<World, Hand>,
    distance_m: f64,
    turned: &UnitQuaternion<f64>,
) -> Result<Setup> {
    // A tracker takes the axes of its model from the first image: a rotation about the optical axis must be commanded.
    let axis_turn = turned.scaled_axis();
    let about_normal = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, -axis_turn.z));
    let desired = Pose::<Model, Hand>::from_parts(
        setup.controller.model_from_hand_desired.translation_m(),
        about_normal * setup.controller.model_from_hand_desired.rotation(),
    );
    let world_from_model: Pose<World, Model> = *to * setup.controller.model_from_hand_desired.inverse();
    let begin: Pose<World, Hand> = world_from_model
        * Pose::<Model, Model>::from_parts(Vector3::zeros(), *turned)
        * Pose::<Model, Hand>::from_translation(Vector3::new(0.0, 0.0, -distance_m));
    let start_rad = joints_at(&setup, &begin, &setup.rig.arms.vs.start_rad)?;
    place(&mut setup, start_rad, to);
    setup.controller.model_from_hand_desired = desired;
    geometric_at_rest(setup)
}

/// The setup with a stationary target.
///
/// # Errors
/// If the setup file has no configuration for runs without images.
pub fn geometric_at_rest(setup: Setup) -> Result<Setup> {
    let mut setup = geometric(setup, at_rest())?;
    if let Leader::Geometric(config) = &mut setup.leader {
        config.z_max_m = MEASURED_UP_TO_M;
    }
    Ok(setup)
}
