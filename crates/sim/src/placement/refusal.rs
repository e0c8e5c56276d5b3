//! Why an arm cannot follow a path.

use std::fmt;

/// Why an arm cannot follow a path. Joints count from 0 at the base.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PathRefusal {
    /// A requirement is out of its range.
    #[error("{key} is {value}; allowed is {allowed}")]
    Requirement {
        /// Name of the requirement.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range.
        allowed: &'static str,
    },
    /// The start of the path cannot be reached from the given joint angles.
    #[error(
        "the arm does not reach the start of the path: {position_error_m:.4} m and {angle_error_rad:.4} rad are missing; \
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
        /// Seconds after the start of the path.
        at_s: f64,
        /// Missing distance, m.
        position_error_m: f64,
        /// Missing angle, rad.
        angle_error_rad: f64,
    },
    /// A joint comes too close to an end of its range.
    #[error(
        "axis {} would be at {:.2} deg after {at_s:.2} s, allowed is {:.2} to {:.2} deg (limits minus margin): \
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
        /// Seconds after the start of the path.
        at_s: f64,
        /// Required joint angle, rad.
        position_rad: f64,
        /// Lower end of its range plus margin, rad.
        min_rad: f64,
        /// Upper end of its range minus margin, rad.
        max_rad: f64,
        /// Range violation, rad.
        excess_rad: f64,
    },
    /// The arm comes too close to a singular pose.
    #[error(
        "the smallest singular value of the Jacobian falls to {value:.4} after {at_s:.2} s, at least {required} is required; \
         change base or start angles"
    )]
    Singular {
        /// Seconds after the start of the path.
        at_s: f64,
        /// The singular value, metres and radians.
        value: f64,
        /// Minimum singular value.
        required: f64,
    },
    /// A joint would exceed its speed limit; the worst joint is reported.
    #[error(
        "axis {} needs a speed of {needed_rad_per_s:.3} rad/s after {at_s:.2} s, allowed is \
         {allowed_rad_per_s:.3} rad/s: {ratio:.2} times too fast; lengthen the moves (experiment.move_s) {ratio:.2}-fold or raise the limit",
        joint + 1
    )]
    TooFast {
        /// Index from the base.
        joint: usize,
        /// Seconds after the start of the path.
        at_s: f64,
        /// Speed required by the path, rad/s.
        needed_rad_per_s: f64,
        /// Effective limit, rad/s.
        allowed_rad_per_s: f64,
        /// Required speed divided by the limit.
        ratio: f64,
    },
    /// A joint would exceed its acceleration limit; the worst joint is reported.
    #[error(
        "axis {} needs an acceleration of {needed_rad_per_s2:.3} rad/s^2 after {at_s:.2} s, allowed is \
         {allowed_rad_per_s2:.3} rad/s^2: {ratio:.2} times too much; lengthen the moves (experiment.move_s) {lengthen:.2}-fold or make them smaller",
        joint + 1,
        lengthen = ratio.sqrt()
    )]
    TooAbrupt {
        /// Index from the base.
        joint: usize,
        /// Seconds after the start of the path.
        at_s: f64,
        /// Acceleration required by the path, rad/s^2.
        needed_rad_per_s2: f64,
        /// The limit, rad/s^2.
        allowed_rad_per_s2: f64,
        /// Required acceleration divided by the limit.
        ratio: f64,
    },
    /// The tool would exceed its speed limit.
    #[error(
        "the tool needs a {quantity} of {needed:.3} {unit} after {at_s:.2} s, allowed is {allowed:.3} {unit}: \
         {ratio:.2} times too fast; lengthen the moves (experiment.move_s) {ratio:.2}-fold or raise the limit",
        unit = quantity.unit()
    )]
    ToolTooFast {
        /// The quantity; it determines the unit of `needed` and `allowed`.
        quantity: ToolSpeed,
        /// Seconds after the start of the path.
        at_s: f64,
        /// Speed required by the path.
        needed: f64,
        /// The limit.
        allowed: f64,
        /// Required speed divided by the limit.
        ratio: f64,
    },
}

/// One of the two speeds of a tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolSpeed {
    /// Speed of the tool origin, m/s.
    Linear,
    /// Angular speed, rad/s.
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
