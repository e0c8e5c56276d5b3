//! The kinematic chain from the base of an arm to its flange.

use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange};

use crate::chain_error::ChainError;
use crate::jacobian::Jacobian;
use crate::limits::JointLimits;
use crate::urdf::{self, ChainParts};
use crate::{DOF, JointVector};

/// A serial arm of six or seven revolute joints.
///
/// `base` is the frame of the base link, `flange` that of the tip link, as defined in the description.
#[derive(Clone, Debug)]
pub struct Chain {
    joints: Vec<urdf::MovingJoint>,
    last_joint_from_flange: Isometry3<f64>,
    limits: JointLimits,
}

/// Poses of all joints of an arm, for one set of joint angles.
#[derive(Clone, Debug)]
pub struct JointFrames {
    /// Pose of each joint's frame (rotated by its angle: the frame of the link after it) in the base frame, metres; entries
    /// after the last joint repeat the last joint's.
    pub base_from_joint: [Isometry3<f64>; DOF],
    /// Axis of each joint in the base frame.
    pub axis_in_base: [Unit<Vector3<f64>>; DOF],
    /// Pose of the flange.
    pub base_from_flange: Pose<Base, Flange>,
}

impl JointFrames {
    /// Origins of base, joints and flange in the base frame, metres, in this order: the arm as a polyline.
    pub fn origins_in_base(&self) -> [Point3<f64>; DOF + 2] {
        let mut origins = [Point3::origin(); DOF + 2];
        for (origin, base_from_joint) in origins[1..].iter_mut().zip(&self.base_from_joint) {
            *origin = base_from_joint.translation.vector.into();
        }
        origins[DOF + 1] = self.base_from_flange.translation_m().into();
        origins
    }
}

impl Chain {
    /// Reads the chain between two links from a URDF text. Fixed joints may be between the revolute ones.
    ///
    /// # Errors
    /// If the text is not a URDF, or the part between the links is not a chain of six or seven revolute joints with limits and
    /// axes of length 1; the error names the joint or link.
    pub fn from_urdf_str(xml: &str, base_link: &str, tip_link: &str) -> Result<Self, ChainError> {
        let ChainParts { joints, last_joint_from_tip, limits } = urdf::read(xml, base_link, tip_link)?;
        Ok(Self { joints, last_joint_from_flange: last_joint_from_tip, limits })
    }

    /// Number of joints of the arm.
    pub fn joints(&self) -> usize {
        self.joints.len()
    }

    /// Names of the joints, base to tip.
    pub fn joint_names(&self) -> Vec<&str> {
        self.joints.iter().map(|joint| joint.name.as_str()).collect()
    }

    /// The joint between upper arm and forearm of an S-R-S arm (the first three axes meet in a shoulder, the last three in a
    /// wrist). At zero such an arm is fully extended. `None` for other arms.
    pub fn elbow(&self) -> Option<usize> {
        /// Largest distance between two axes that count as intersecting, metres.
        const MEET_M: f64 = 1e-6;
        let frames = self.joint_frames(&JointVector::repeat(0.4));
        let line =
            |joint: usize| (frames.base_from_joint[joint].translation.vector, frames.axis_in_base[joint].into_inner());
        let meet = |joints: [usize; 3]| {
            let [first, second, third] = joints.map(line);
            nearest_to_both(first, second).is_some_and(|(at_m, apart_m)| {
                let beside_m = (third.0 - at_m).cross(&third.1).norm();
                apart_m < MEET_M && beside_m < MEET_M
            })
        };
        (self.joints.len() == 7 && meet([0, 1, 2]) && meet([4, 5, 6])).then_some(3)
    }

    /// Position and speed limits from the description.
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// Pose of the flange in the base frame at the joint angles `position_rad`.
    pub fn forward(&self, position_rad: &JointVector) -> Pose<Base, Flange> {
        self.joint_frames(position_rad).base_from_flange
    }

    /// Poses of all joints and of the flange at the joint angles `position_rad`.
    pub fn joint_frames(&self, position_rad: &JointVector) -> JointFrames {
        let mut base_from_here = Isometry3::identity();
        let mut base_from_joint = [Isometry3::identity(); DOF];
        let mut axis_in_base = [Vector3::z_axis(); DOF];
        for (i, joint) in self.joints.iter().enumerate() {
            base_from_here *= joint.parent_from_joint;
            base_from_here.rotation *= UnitQuaternion::from_axis_angle(&joint.axis, position_rad[i]);
            base_from_joint[i] = base_from_here;
            axis_in_base[i] = base_from_here.rotation * joint.axis;
        }
        base_from_joint[self.joints.len()..].fill(base_from_here);
        let mut base_from_flange = base_from_here * self.last_joint_from_flange;
        base_from_flange.rotation.renormalize();
        JointFrames { base_from_joint, axis_in_base, base_from_flange: Pose::from_isometry(base_from_flange) }
    }

    /// Geometric Jacobian at the joint angles `position_rad`: `jacobian * joint_velocity` is `[linear; angular]`, the velocity
    /// (m/s) of the flange's origin and the angular velocity (rad/s) of the flange, both in the base frame.
    pub fn jacobian(&self, position_rad: &JointVector) -> Jacobian {
        let frames = self.joint_frames(position_rad);
        self.jacobian_at(&frames, &frames.base_from_flange.translation_m().into())
    }

    /// As [`Self::jacobian`], with the linear velocity of another point that is fixed to the flange: `point_in_base`, metres,
    /// is its current position. `frames` must come from this chain.
    pub fn jacobian_at(&self, frames: &JointFrames, point_in_base: &Point3<f64>) -> Jacobian {
        let mut jacobian = Jacobian::zeros();
        for (i, (base_from_joint, axis)) in
            frames.base_from_joint.iter().zip(&frames.axis_in_base).take(self.joints.len()).enumerate()
        {
            let lever = point_in_base.coords - base_from_joint.translation.vector;
            jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&axis.cross(&lever));
            jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(axis);
        }
        jacobian
    }
}

/// The midpoint between two lines (point and direction of length 1) where they are nearest, and their distance there; `None`
/// for parallel lines.
fn nearest_to_both(
    (one_m, one): (Vector3<f64>, Vector3<f64>),
    (other_m, other): (Vector3<f64>, Vector3<f64>),
) -> Option<(Vector3<f64>, f64)> {
    let cosine = one.dot(&other);
    let sine_squared = 1.0 - cosine * cosine;
    let between_m = other_m - one_m;
    (sine_squared > 1e-9).then(|| {
        let along_one_m = (between_m.dot(&one) - cosine * between_m.dot(&other)) / sine_squared;
        let along_other_m = (cosine * between_m.dot(&one) - between_m.dot(&other)) / sine_squared;
        let [a, b] = [one_m + one * along_one_m, other_m + other * along_other_m];
        ((a + b) / 2.0, (a - b).norm())
    })
}
