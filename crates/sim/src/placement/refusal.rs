//! Why an arm cannot follow a path.

use std::fmt;

/// Why an arm cannot follow a path. Joints count from 0 at the base.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PathRefusal {
    /// A requirement is out of its range.
    #[error("{key} is {value}: allowed is {allowed}")]
    Requirement {
        /// Which requirement.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The beginning of the path cannot be reached from the given joint angles.
    #[error(
        "the arm does not reach the beginning of the path: {position_error_m:.4} m and {angle_error_rad:.4} rad are missing; \
         move its base or choose other start angles"
    )]
    BeginUnreachable {
        /// Missing distance, m.
        position_error_m: f64,
        /// Missing angle, rad.
        angle_error_rad: f64,
    },
    /// The path leads out of the reach of the arm.
    #[error(
        "the path leads out of reach after {at_s:.2} s: {position_error_m:.4} m and {angle_error_rad:.4} rad are missing; \
         move the base or make the motion smaller"
    )]
    OutOfReach {
        /// Seconds after the beginning of the path.
        at_s: f64,
        /// Missing distance, m.
        position_error_m: f64,
        /// Missing angle, rad.
        angle_error_rad: f64,
    },
    /// A joint comes too near an end of its range.
    #[error(
        "axis {} would be at {:.2} deg after {at_s:.2} s, allowed is {:.2} to {:.2} deg (limits less margin): \
         {:.2} deg too far; change base, start angles or the direction of the motion",
        joint + 1,
        position_rad.to_degrees(),
        min_rad.to_degrees(),
        max_rad.to_degrees(),
        excess_rad.to_degrees()
    )]
    JointRange {
        /// Index from the base.
        joint: usize,
        /// Seconds after the beginning of the path.
        at_s: f64,
        /// Where the joint would be, rad.
        position_rad: f64,
        /// Lower end of its range plus margin, rad.
        min_rad: f64,
        /// Upper end of its range less margin, rad.
        max_rad: f64,
        /// How far it would be outside, rad.
        excess_rad: f64,
    },
    /// The arm comes too near a singular pose.
    #[error(
        "the smallest singular value of the Jacobian falls to {value:.4} after {at_s:.2} s, required is {required}; \
         change base or start angles"
    )]
    Singular {
        /// Seconds after the beginning of the path.
        at_s: f64,
        /// The singular value, metres and radians.
        value: f64,
        /// What is required.
        required: f64,
    },
    /// A joint would have to move faster than it may; the worst one is named.
    #[error(
        "axis {} would have to move at {needed_rad_per_s:.3} rad/s after {at_s:.2} s, allowed are \
         {allowed_rad_per_s:.3} rad/s: {ratio:.2} times too fast; lengthen the moves {ratio:.2}-fold or raise the limit",
        joint + 1
    )]
    TooFast {
        /// Index from the base.
        joint: usize,
        /// Seconds after the beginning of the path.
        at_s: f64,
        /// Speed that the path demands, rad/s.
        needed_rad_per_s: f64,
        /// Effective limit, rad/s.
        allowed_rad_per_s: f64,
        /// Needed over allowed.
        ratio: f64,
    },
    /// A joint would have to change its speed faster than it may; the worst one is named.
    #[error(
        "axis {} would have to accelerate by {needed_rad_per_s2:.3} rad/s^2 after {at_s:.2} s, allowed are \
         {allowed_rad_per_s2:.3} rad/s^2: {ratio:.2} times too much; lengthen the moves {lengthen:.2}-fold or make them smaller",
        joint + 1,
        lengthen = ratio.sqrt()
    )]
    TooAbrupt {
        /// Index from the base.
        joint: usize,
        /// Seconds after the beginning of the path.
        at_s: f64,
        /// Acceleration that the path demands, rad/s^2.
        needed_rad_per_s2: f64,
        /// The limit, rad/s^2.
        allowed_rad_per_s2: f64,
        /// Needed over allowed.
        ratio: f64,
    },
    /// The tool would have to move faster than it may.
    #[error(
        "the {quantity} of the tool would have to be {needed:.3} {unit} after {at_s:.2} s, allowed are {allowed:.3} {unit}: \
         {ratio:.2} times too fast; lengthen the moves {ratio:.2}-fold or raise the limit",
        unit = quantity.unit()
    )]
    ToolTooFast {
        /// Which speed; it says the unit of `needed` and `allowed`.
        quantity: ToolSpeed,
        /// Seconds after the beginning of the path.
        at_s: f64,
        /// Speed that the path demands.
        needed: f64,
        /// The limit.
        allowed: f64,
        /// Needed over allowed.
        ratio: f64,
    },
}

/// One of the two speeds of a tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolSpeed {
    /// Of its origin, m/s.
    Linear,
    /// Angular, rad/s.
    Angular,
}

impl ToolSpeed {
    /// Its unit.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Linear => "m/s",
            Self::Angular => "rad/s",
        }
    }
}

impl fmt::Display for ToolSpeed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Linear => "linear speed",
            Self::Angular => "angular speed",
        })
    }
}
