//! Reads the constant parts of a chain from a URDF text; rejects everything except a plain chain of six or seven revolute
//! joints.

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::chain_error::ChainError;
use crate::description::{self, Joint, Robot};
use crate::limits::{JointLimits, JointLimitsError};
use crate::{DOF, JointVector, NO_JOINT_RAD};

/// Largest deviation of a joint axis from length 1 that counts as rounding in the file.
const AXIS_LENGTH_TOLERANCE: f64 = 1e-4;

/// With fewer joints a hand cannot rotate and move in all directions.
const JOINTS_MIN: usize = 6;

/// A moving joint: its pose on the previous joint (including fixed joints in between), and its axis.
#[derive(Clone, Debug)]
pub(crate) struct MovingJoint {
    pub name: String,
    /// Pose in the previous moving joint's frame (rotated by its angle), or in the base link.
    pub parent_from_joint: Isometry3<f64>,
    /// Axis in the joint's own frame.
    pub axis: Unit<Vector3<f64>>,
}

/// The constant parts of a chain.
pub(crate) struct ChainParts {
    pub joints: Vec<MovingJoint>,
    pub last_joint_from_tip: Isometry3<f64>,
    pub limits: JointLimits,
}

/// Reads and checks a description.
pub(crate) fn read(xml: &str, base: &str, tip: &str) -> Result<ChainParts, ChainError> {
    let robot = description::read(xml)?;
    for link in [base, tip] {
        check_link(&robot, link)?;
    }
    let path = path_from_base(&robot, base, tip)?;
    let mut moving = Vec::with_capacity(DOF);
    let mut limits = Vec::with_capacity(DOF);
    let mut pending = Isometry3::identity();
    for joint in path {
        pending *= origin(joint)?;
        if is_moving(joint)? {
            limits.push(joint);
            moving.push(MovingJoint { name: joint.name.clone(), parent_from_joint: pending, axis: axis(joint)? });
            pending = Isometry3::identity();
        }
    }
    if !(JOINTS_MIN..=DOF).contains(&moving.len()) {
        return Err(ChainError::JointCount {
            base: base.into(),
            tip: tip.into(),
            count: moving.len(),
            joints: moving.iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>().join(", "),
        });
    }
    Ok(ChainParts { joints: moving, last_joint_from_tip: pending, limits: joint_limits(&limits)? })
}

fn check_link(robot: &Robot, name: &str) -> Result<(), ChainError> {
    if robot.links.iter().any(|link| link == name) {
        return Ok(());
    }
    Err(ChainError::UnknownLink { robot: robot.name.clone(), link: name.into(), links: robot.links.join(", ") })
}

/// The joints from base to tip, found by walking from the tip to its parents.
fn path_from_base<'a>(robot: &'a Robot, base: &str, tip: &str) -> Result<Vec<&'a Joint>, ChainError> {
    let mut path: Vec<&Joint> = Vec::new();
    let mut link = tip;
    while link != base {
        let mut leading_here = robot.joints.iter().filter(|joint| joint.child_link == link);
        let Some(joint) = leading_here.next() else {
            return Err(ChainError::Broken { base: base.into(), tip: tip.into(), stopped_at: link.into() });
        };
        let met_again = path.iter().any(|visited| visited.name == joint.name);
        if met_again || leading_here.next().is_some() {
            return Err(ChainError::NotATree { link: link.into(), joint: joint.name.clone() });
        }
        path.push(joint);
        link = &joint.parent_link;
    }
    path.reverse();
    Ok(path)
}

fn is_moving(joint: &Joint) -> Result<bool, ChainError> {
    if let Some(leader) = &joint.mimics {
        return Err(ChainError::Mimic { joint: joint.name.clone(), leader: leader.clone() });
    }
    match joint.kind.as_str() {
        "revolute" => Ok(true),
        "fixed" => Ok(false),
        kind => Err(ChainError::JointKind { joint: joint.name.clone(), kind: kind.into() }),
    }
}

/// `parent_from_joint` at angle zero. URDF: roll, pitch, yaw about the fixed axes x, y, z.
fn origin(joint: &Joint) -> Result<Isometry3<f64>, ChainError> {
    let (xyz, rpy) = (joint.origin_xyz_m, joint.origin_rpy_rad);
    if !xyz.iter().chain(&rpy).all(|number| number.is_finite()) {
        return Err(ChainError::Origin { joint: joint.name.clone(), xyz, rpy });
    }
    let rotation = UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Ok(Isometry3::from_parts(Translation3::from(Vector3::from(xyz)), rotation))
}

fn axis(joint: &Joint) -> Result<Unit<Vector3<f64>>, ChainError> {
    let axis = joint.axis;
    let vector = Vector3::from(axis);
    let length = vector.norm();
    // Written so that NaN is rejected too.
    if (length - 1.0).abs() <= AXIS_LENGTH_TOLERANCE {
        return Ok(Unit::new_normalize(vector));
    }
    Err(ChainError::Axis { joint: joint.name.clone(), axis, length })
}

fn joint_limits(joints: &[&Joint]) -> Result<JointLimits, ChainError> {
    let vector = |number: fn(&Joint) -> f64, without: f64| {
        JointVector::from_fn(|index, _| joints.get(index).map_or(without, |joint| number(joint)))
    };
    JointLimits::new(
        vector(|joint| joint.limit.lower_rad, -NO_JOINT_RAD),
        vector(|joint| joint.limit.upper_rad, NO_JOINT_RAD),
        vector(|joint| joint.limit.velocity_rad_per_s, NO_JOINT_RAD),
    )
    .map_err(|source| {
        let (JointLimitsError::Position { joint, .. }
        | JointLimitsError::Velocity { joint, .. }
        | JointLimitsError::NotWithin { joint, .. }) = source;
        ChainError::Limits { joint: joints[joint].name.clone(), source }
    })
}
