//! Drives the arm that carries the target along its path: feed-forward velocity of the path plus a proportional correction.

use nalgebra::Vector6;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange};
use pb3dp_kinematics::{Chain, Damping, JointVector, damped_pseudo_inverse};
use pb3dp_sim::placement::FlangePath;

/// Gain of the path correction, 1/s.
const CORRECTION_PER_S: f64 = 2.0;

/// Joint velocities (rad/s) that keep a flange on its path, `t_s` seconds after the start of the path.
pub fn carry(
    chain: &Chain,
    damping: &Damping,
    path: &FlangePath<'_>,
    t_s: f64,
    position_rad: &JointVector,
) -> JointVector {
    let frames = chain.joint_frames(position_rad);
    let missing = error_between(&frames.base_from_flange, &path.base_from_flange_at(t_s));
    let twist = path.twist_at(t_s).to_vector() + missing * CORRECTION_PER_S;
    let jacobian = chain.jacobian_at(&frames, &frames.base_from_flange.translation_m().into());
    damped_pseudo_inverse(&jacobian, damping) * twist
}

/// Distance of a flange from its path, metres and radians.
pub fn off_by(chain: &Chain, path: &FlangePath<'_>, t_s: f64, position_rad: &JointVector) -> (f64, f64) {
    let missing = error_between(&chain.forward(position_rad), &path.base_from_flange_at(t_s));
    (missing.fixed_rows::<3>(0).norm(), missing.fixed_rows::<3>(3).norm())
}

/// Error from `is` to `wanted`: translation of the origin (metres), then rotation vector (radians), both in `base`.
fn error_between(is: &Pose<Base, Flange>, wanted: &Pose<Base, Flange>) -> Vector6<f64> {
    let way = wanted.translation_m() - is.translation_m();
    let turn = (wanted.rotation() * is.rotation().inverse()).scaled_axis();
    Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
}
