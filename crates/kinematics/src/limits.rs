//! Position and speed limits of the joints.

use crate::JointVector;

/// Position and speed limits, one number per joint.
///
/// Created by [`JointLimits::new`], so every number is finite, each minimum is below its maximum and each speed is positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    position_min_rad: JointVector,
    position_max_rad: JointVector,
    velocity_max_rad_per_s: JointVector,
}

/// Why numbers are not valid limits.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum JointLimitsError {
    /// The position range is empty or not finite.
    #[error(
        "axis {}: position limits {min_rad} to {max_rad} rad are not a range; give finite numbers, minimum below maximum",
        joint + 1
    )]
    Position {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The minimum given, rad.
        min_rad: f64,
        /// The maximum given, rad.
        max_rad: f64,
    },
    /// The speed is not a positive number.
    #[error("axis {}: speed limit {velocity_rad_per_s} rad/s is not a positive, finite number", joint + 1)]
    Velocity {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The limit given, rad/s.
        velocity_rad_per_s: f64,
    },
    /// The inner limits are not within the outer ones.
    #[error(
        "axis {}: {min_rad} to {max_rad} rad is not within the outer limits, {outer_min_rad} to {outer_max_rad} rad",
        joint + 1
    )]
    NotWithin {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The inner minimum, rad.
        min_rad: f64,
        /// The inner maximum, rad.
        max_rad: f64,
        /// The outer minimum, rad.
        outer_min_rad: f64,
        /// The outer maximum, rad.
        outer_max_rad: f64,
    },
}

/// A joint outside its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionViolation {
    /// Index from the base, 0 to 6.
    pub joint: usize,
    /// Position of the joint, rad.
    pub position_rad: f64,
    /// Lower end of its range, rad.
    pub min_rad: f64,
    /// Upper end of its range, rad.
    pub max_rad: f64,
}

impl JointLimits {
    /// Creates limits from positions in rad and speeds in rad/s.
    ///
    /// # Errors
    /// If a range is empty, a speed is not positive or a number is not finite; the error names the joint.
    pub fn new(
        position_min_rad: JointVector,
        position_max_rad: JointVector,
        velocity_max_rad_per_s: JointVector,
    ) -> Result<Self, JointLimitsError> {
        let ranges = position_min_rad.iter().zip(position_max_rad.iter()).zip(velocity_max_rad_per_s.iter());
        for (joint, ((&min_rad, &max_rad), &velocity_rad_per_s)) in ranges.enumerate() {
            if !(min_rad.is_finite() && max_rad.is_finite() && min_rad < max_rad) {
                return Err(JointLimitsError::Position { joint, min_rad, max_rad });
            }
            if !(velocity_rad_per_s.is_finite() && velocity_rad_per_s > 0.0) {
                return Err(JointLimitsError::Velocity { joint, velocity_rad_per_s });
            }
        }
        Ok(Self { position_min_rad, position_max_rad, velocity_max_rad_per_s })
    }

    /// The same speeds with a position range inside this one, for example an operating range within the hard limits.
    ///
    /// # Errors
    /// If the new range is empty, not finite or exceeds this one; the error names the joint.
    pub fn with_position_range(&self, min_rad: JointVector, max_rad: JointVector) -> Result<Self, JointLimitsError> {
        let inner = Self::new(min_rad, max_rad, self.velocity_max_rad_per_s)?;
        for joint in 0..crate::DOF {
            let (min_rad, max_rad) = (min_rad[joint], max_rad[joint]);
            let (outer_min_rad, outer_max_rad) = (self.position_min_rad[joint], self.position_max_rad[joint]);
            if min_rad < outer_min_rad || max_rad > outer_max_rad {
                return Err(JointLimitsError::NotWithin { joint, min_rad, max_rad, outer_min_rad, outer_max_rad });
            }
        }
        Ok(inner)
    }

    /// The same ranges with other speeds, rad/s.
    ///
    /// # Errors
    /// If a speed is not positive and finite; the error names the joint.
    pub fn with_velocity_max(&self, velocity_max_rad_per_s: JointVector) -> Result<Self, JointLimitsError> {
        Self::new(self.position_min_rad, self.position_max_rad, velocity_max_rad_per_s)
    }

    /// Lower ends of the position ranges, rad.
    pub fn position_min_rad(&self) -> &JointVector {
        &self.position_min_rad
    }

    /// Upper ends of the position ranges, rad.
    pub fn position_max_rad(&self) -> &JointVector {
        &self.position_max_rad
    }

    /// Largest speeds, rad/s.
    pub fn velocity_max_rad_per_s(&self) -> &JointVector {
        &self.velocity_max_rad_per_s
    }

    /// Distance of each joint to the nearer end of its range, rad; negative outside.
    pub fn margin_rad(&self, position_rad: &JointVector) -> JointVector {
        let above = position_rad - self.position_min_rad;
        let below = self.position_max_rad - position_rad;
        above.zip_map(&below, f64::min)
    }

    /// The first joint outside its range or not finite, if any.
    pub fn violation(&self, position_rad: &JointVector) -> Option<PositionViolation> {
        (0..crate::DOF).find_map(|joint| {
            let (position_rad, min_rad, max_rad) =
                (position_rad[joint], self.position_min_rad[joint], self.position_max_rad[joint]);
            let inside = (min_rad..=max_rad).contains(&position_rad);
            (!inside).then_some(PositionViolation { joint, position_rad, min_rad, max_rad })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> JointLimits {
        let max = JointVector::from([3.0, 1.5, 3.0, 2.4, 4.4, 2.8, 4.5]);
        let min = JointVector::from([-2.9, -1.4, -2.8, -2.3, -4.3, -2.7, -4.2]);
        JointLimits::new(min, max, JointVector::from([1.0, 1.0, 2.0, 2.0, 6.0, 6.0, 6.0])).unwrap()
    }

    #[test]
    fn refuses_what_is_no_range_and_names_the_joint() {
        let good = limits();
        let mut max = *good.position_max_rad();
        max[4] = -5.0;
        let error = JointLimits::new(*good.position_min_rad(), max, *good.velocity_max_rad_per_s()).unwrap_err();
        assert_eq!(error, JointLimitsError::Position { joint: 4, min_rad: -4.3, max_rad: -5.0 });
        assert!(error.to_string().contains("axis 5: position limits -4.3 to -5 rad"), "{error}");
        max[4] = f64::NAN;
        assert!(JointLimits::new(*good.position_min_rad(), max, *good.velocity_max_rad_per_s()).is_err());
    }

    #[test]
    fn refuses_a_speed_that_is_not_positive() {
        let good = limits();
        for bad in [0.0, -1.0, f64::INFINITY, f64::NAN] {
            let mut speed = *good.velocity_max_rad_per_s();
            speed[2] = bad;
            let result = JointLimits::new(*good.position_min_rad(), *good.position_max_rad(), speed);
            assert!(matches!(result, Err(JointLimitsError::Velocity { joint: 2, .. })), "{bad}: {result:?}");
        }
    }

    #[test]
    fn an_inner_range_must_be_inside() {
        let hard = limits();
        let inner = hard.with_position_range(hard.position_min_rad() * 0.9, hard.position_max_rad() * 0.9).unwrap();
        assert_eq!(inner.velocity_max_rad_per_s(), hard.velocity_max_rad_per_s());
        let mut min = hard.position_min_rad() * 0.9;
        min[6] = -4.21;
        let error = hard.with_position_range(min, *hard.position_max_rad()).unwrap_err();
        assert!(matches!(error, JointLimitsError::NotWithin { joint: 6, .. }), "{error}");
    }

    #[test]
    fn margin_and_violation_agree() {
        let limits = limits();
        let mut position = JointVector::from([0.5, -0.2, 0.1, 2.0, -4.0, 0.0, 4.4]);
        let margin = limits.margin_rad(&position);
        assert!((margin[4] - 0.3).abs() < 1e-12 && (margin[6] - 0.1).abs() < 1e-12, "{margin}");
        assert_eq!(limits.violation(&position), None);
        position[6] = 4.51;
        assert!(limits.margin_rad(&position)[6] < 0.0);
        assert_eq!(limits.violation(&position).map(|v| (v.joint, v.max_rad)), Some((6, 4.5)));
        position[6] = f64::NAN;
        assert_eq!(limits.violation(&position).map(|v| v.joint), Some(6));
    }
}
