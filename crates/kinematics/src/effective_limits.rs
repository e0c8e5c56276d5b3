//! Effective limits of an arm for one run, computed once.

use crate::{DOF, JointLimits, JointLimitsError, JointVector};

/// The configured limits of an arm, from which the effective limits are computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatedLimits {
    /// From the robot description: angles (rad) that must never be exceeded, and the speeds (rad/s) of the drives.
    pub servo: JointLimits,
    /// Lower ends of the operating range, rad; within the servo limits.
    pub operating_min_rad: JointVector,
    /// Upper ends of the operating range, rad.
    pub operating_max_rad: JointVector,
    /// Share of the drives' speeds that may be used, above 0 and at most 1.
    pub speed_scale: f64,
    /// Largest acceleration of each joint, rad/s^2.
    pub acceleration_max_rad_per_s2: JointVector,
    /// Largest jerk of each joint, rad/s^3.
    pub jerk_max_rad_per_s3: JointVector,
}

/// The limits of an arm in this run. Limiter, guard, controller, planner and commissioning all use this type. Its values are
/// final: no further scaling is applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectiveLimits {
    servo: JointLimits,
    operating: JointLimits,
    acceleration_max_rad_per_s2: JointVector,
    jerk_max_rad_per_s3: JointVector,
}

/// Why configured limits are invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EffectiveLimitsError {
    /// The operating range is not a range within the servo limits.
    #[error("the operating range is invalid")]
    OperatingRange(#[source] JointLimitsError),
    /// The speed scale is out of range.
    #[error("speed scale {0} is out of range; it must be above 0 and at most 1")]
    SpeedScale(f64),
    /// A speed limit is invalid.
    #[error("speed limit {0} rad/s is not a positive, finite number")]
    Speed(f64),
    /// An acceleration limit is invalid.
    #[error("axis {}: acceleration limit {value} rad/s^2 is not a positive, finite number", joint + 1)]
    Acceleration {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The number given, rad/s^2.
        value: f64,
    },
    /// A jerk limit is invalid.
    #[error("axis {}: jerk limit {value} rad/s^3 is not a positive, finite number", joint + 1)]
    Jerk {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The number given, rad/s^3.
        value: f64,
    },
}

impl StatedLimits {
    /// Computes the effective limits.
    ///
    /// # Errors
    /// The first invalid number.
    pub fn effective(&self) -> Result<EffectiveLimits, EffectiveLimitsError> {
        let scale = self.speed_scale;
        if !(scale > 0.0 && scale <= 1.0) {
            return Err(EffectiveLimitsError::SpeedScale(scale));
        }
        let [acceleration, jerk] = [&self.acceleration_max_rad_per_s2, &self.jerk_max_rad_per_s3].map(first_of_no_use);
        if let Some((joint, value)) = acceleration {
            return Err(EffectiveLimitsError::Acceleration { joint, value });
        }
        if let Some((joint, value)) = jerk {
            return Err(EffectiveLimitsError::Jerk { joint, value });
        }
        let operating = self
            .servo
            .with_position_range(self.operating_min_rad, self.operating_max_rad)
            .and_then(|range| range.with_velocity_max(range.velocity_max_rad_per_s() * scale))
            .map_err(EffectiveLimitsError::OperatingRange)?;
        Ok(EffectiveLimits {
            servo: self.servo,
            operating,
            acceleration_max_rad_per_s2: self.acceleration_max_rad_per_s2,
            jerk_max_rad_per_s3: self.jerk_max_rad_per_s3,
        })
    }
}

fn first_of_no_use(limits: &JointVector) -> Option<(usize, f64)> {
    (0..DOF).map(|joint| (joint, limits[joint])).find(|(_, value)| !(value.is_finite() && *value > 0.0))
}

impl EffectiveLimits {
    /// Angles (rad) that must never be exceeded, and the speeds (rad/s) of the drives, which no motion can exceed.
    pub fn servo(&self) -> &JointLimits {
        &self.servo
    }

    /// Operating range, rad, and operating speeds, rad/s.
    pub fn operating(&self) -> &JointLimits {
        &self.operating
    }

    /// Largest speeds, rad/s: those of [`Self::operating`].
    pub fn velocity_max_rad_per_s(&self) -> &JointVector {
        self.operating.velocity_max_rad_per_s()
    }

    /// Largest accelerations, rad/s^2.
    pub fn acceleration_max_rad_per_s2(&self) -> &JointVector {
        &self.acceleration_max_rad_per_s2
    }

    /// Largest jerks, rad/s^3.
    pub fn jerk_max_rad_per_s3(&self) -> &JointVector {
        &self.jerk_max_rad_per_s3
    }

    /// The same limits with all joints limited to this speed, rad/s, and to this share of the drive's speed.
    ///
    /// # Errors
    /// If the speed is not positive and finite, or the share not above 0 and at most 1.
    pub fn slowed(&self, velocity_max_rad_per_s: f64, drive_share_max: f64) -> Result<Self, EffectiveLimitsError> {
        if !(drive_share_max > 0.0 && drive_share_max <= 1.0) {
            return Err(EffectiveLimitsError::SpeedScale(drive_share_max));
        }
        if !(velocity_max_rad_per_s.is_finite() && velocity_max_rad_per_s > 0.0) {
            return Err(EffectiveLimitsError::Speed(velocity_max_rad_per_s));
        }
        let of_drives = self.servo.velocity_max_rad_per_s() * drive_share_max;
        let slow = self.velocity_max_rad_per_s().inf(&of_drives).map(|speed| speed.min(velocity_max_rad_per_s));
        let operating = self.operating.with_velocity_max(slow).map_err(EffectiveLimitsError::OperatingRange)?;
        Ok(Self { operating, ..*self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stated() -> StatedLimits {
        let max = JointVector::from([3.0, 1.5, 3.0, 2.4, 4.4, 2.8, 4.5]);
        let min = JointVector::from([-2.9, -1.4, -2.8, -2.3, -4.3, -2.7, -4.2]);
        StatedLimits {
            servo: JointLimits::new(min, max, JointVector::from([1.0, 1.0, 2.0, 2.0, 6.0, 6.0, 6.0])).unwrap(),
            operating_min_rad: min * 0.9,
            operating_max_rad: max * 0.8,
            speed_scale: 0.25,
            acceleration_max_rad_per_s2: JointVector::from([2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0]),
            jerk_max_rad_per_s3: JointVector::from([40.0, 40.0, 40.0, 40.0, 100.0, 100.0, 100.0]),
        }
    }

    #[test]
    fn speeds_are_scaled_once_and_angles_not_at_all() {
        let limits = stated().effective().unwrap();
        assert_eq!(limits.velocity_max_rad_per_s(), &JointVector::from([0.25, 0.25, 0.5, 0.5, 1.5, 1.5, 1.5]));
        assert_eq!(limits.servo(), &stated().servo);
        assert_eq!(limits.operating().position_min_rad(), &stated().operating_min_rad);
        assert_eq!(limits.operating().position_max_rad(), &stated().operating_max_rad);
        assert_eq!(limits.acceleration_max_rad_per_s2(), &stated().acceleration_max_rad_per_s2);
        assert_eq!(limits.jerk_max_rad_per_s3(), &stated().jerk_max_rad_per_s3);
    }

    #[test]
    fn slowed_limits_are_never_faster() {
        let limits = stated().effective().unwrap();
        let slow = limits.slowed(0.3, 0.2).unwrap();
        assert_eq!(slow.velocity_max_rad_per_s(), &JointVector::from([0.2, 0.2, 0.3, 0.3, 0.3, 0.3, 0.3]));
        assert_eq!((slow.servo(), slow.operating().position_max_rad()), (limits.servo(), &stated().operating_max_rad));
        assert_eq!(limits.slowed(9.0, 1.0).unwrap(), limits, "they only fall");
        for speed in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(limits.slowed(speed, 1.0), Err(EffectiveLimitsError::Speed(_))), "{speed}");
        }
        assert_eq!(limits.slowed(0.1, 1.1), Err(EffectiveLimitsError::SpeedScale(1.1)));
    }

    #[test]
    fn numbers_that_are_no_limits_are_refused() {
        let refused = |change: fn(&mut StatedLimits)| {
            let mut stated = stated();
            change(&mut stated);
            stated.effective().err()
        };
        assert_eq!(refused(|s| s.speed_scale = 0.0), Some(EffectiveLimitsError::SpeedScale(0.0)));
        assert_eq!(refused(|s| s.speed_scale = 1.01), Some(EffectiveLimitsError::SpeedScale(1.01)));
        assert!(matches!(refused(|s| s.speed_scale = f64::NAN), Some(EffectiveLimitsError::SpeedScale(_))));
        let wide = refused(|s| s.operating_max_rad[1] = 1.6);
        let not_within =
            matches!(wide, Some(EffectiveLimitsError::OperatingRange(JointLimitsError::NotWithin { joint: 1, .. })));
        assert!(not_within, "{wide:?}");
        let weak = refused(|s| s.acceleration_max_rad_per_s2[5] = -1.0);
        assert_eq!(weak, Some(EffectiveLimitsError::Acceleration { joint: 5, value: -1.0 }));
        let soft = refused(|s| s.jerk_max_rad_per_s3[2] = f64::INFINITY);
        assert_eq!(soft, Some(EffectiveLimitsError::Jerk { joint: 2, value: f64::INFINITY }));
    }
}
