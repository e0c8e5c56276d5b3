//! Inverse kinematics: joint angles that bring the flange to a pose.

use nalgebra::Vector6;
use pb3dp_geometry::frames::{Base, Flange};
use pb3dp_geometry::{Pose, Twist};

use crate::{Chain, Damping, JointVector, damped_pseudo_inverse};

/// Largest error of a reached pose, metres and radians.
const REACHED_WITHIN: f64 = 1e-9;
/// Largest number of steps, and the longest step of a joint.
const STEPS_MAX: usize = 500;
const STEP_MAX_RAD: f64 = 0.05;

/// A pose that could not be reached.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("out of reach: the flange ends {:.1} mm and {:.2} degrees from the pose", 1e3 * position_error_m, angle_error_rad.to_degrees())]
pub struct NotReached {
    /// Remaining position error of the flange, metres.
    pub position_error_m: f64,
    /// Remaining angular error, radians.
    pub angle_error_rad: f64,
}

/// `[linear; angular]` twist that moves one pose to the other in one second, in `base`.
pub fn twist_between(from: &Pose<Base, Flange>, to: &Pose<Base, Flange>) -> Vector6<f64> {
    let linear = to.translation_m() - from.translation_m();
    let angular = (to.rotation() * from.rotation().inverse()).scaled_axis();
    Twist::<Base>::new(linear, angular).to_vector()
}

/// Newton steps of bounded length from `start_rad` to joint angles at which the flange has a pose; of several solutions, one
/// near the start. Joint limits are not checked.
///
/// # Errors
/// A pose that is out of reach, or a singularity on the path to it.
pub fn reach(
    chain: &Chain,
    start_rad: &JointVector,
    base_from_flange: &Pose<Base, Flange>,
    damping: &Damping,
) -> Result<JointVector, NotReached> {
    let mut position_rad = *start_rad;
    let mut error = twist_between(&chain.forward(&position_rad), base_from_flange);
    for _ in 0..STEPS_MAX {
        let (position_error_m, angle_error_rad) = sizes(&error);
        if position_error_m < REACHED_WITHIN && angle_error_rad < REACHED_WITHIN {
            return Ok(position_rad);
        }
        let step = damped_pseudo_inverse(&chain.jacobian(&position_rad), damping) * error;
        let shorten = (STEP_MAX_RAD / step.amax()).min(1.0);
        position_rad += step * shorten;
        error = twist_between(&chain.forward(&position_rad), base_from_flange);
    }
    let (position_error_m, angle_error_rad) = sizes(&error);
    Err(NotReached { position_error_m, angle_error_rad })
}

/// Position error and angular error of a `[linear; angular]` error.
fn sizes(error: &Vector6<f64>) -> (f64, f64) {
    (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm())
}
