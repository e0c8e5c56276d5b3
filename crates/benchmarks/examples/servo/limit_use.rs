//! How a run used the limits of its arm.

use pb3dp_hal_api::JointState;
use pb3dp_kinematics::DOF;
use pb3dp_setup::setup::Setup;

/// Use of the limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitUse {
    /// Largest speed as a share of the limit, with its axis, counted from 1.
    pub speed: (f64, usize),
    /// Largest acceleration as a share of the limit, with its axis.
    pub acceleration: (f64, usize),
    /// Smallest margin to an end of the operating range, degrees; negative outside the range; with its axis.
    pub room_deg: (f64, usize),
    /// Number of joint reversals during the motion.
    pub turns: usize,
}

/// A slower joint does not count as reversing, rad/s.
const STILL_RAD_PER_S: f64 = 0.01;

impl LimitUse {
    /// The use of the limits in these measurements of the arm with the cameras.
    pub fn of(setup: &Setup, samples: &[JointState]) -> Self {
        let limits = &setup.rig.arms.vs.limits;
        let speeds = limits.velocity_max_rad_per_s();
        let mut most = Self { speed: (0.0, 1), acceleration: (0.0, 1), room_deg: (f64::INFINITY, 1), turns: 0 };
        let raise = |slot: &mut (f64, usize), value: f64, axis: usize| {
            if value > slot.0 {
                *slot = (value, axis);
            }
        };
        for (index, now) in samples.iter().enumerate() {
            for joint in 0..DOF {
                let axis = joint + 1;
                raise(&mut most.speed, now.velocity_rad_per_s[joint].abs() / speeds[joint], axis);
                let position_rad = now.position_rad[joint];
                let (min, max) =
                    (limits.operating().position_min_rad()[joint], limits.operating().position_max_rad()[joint]);
                let room_deg = (position_rad - min).min(max - position_rad).to_degrees();
                if room_deg < most.room_deg.0 {
                    most.room_deg = (room_deg, axis);
                }
                let Some(before) = index.checked_sub(1).and_then(|before| samples.get(before)) else { continue };
                let (was, is) = (before.velocity_rad_per_s[joint], now.velocity_rad_per_s[joint]);
                let dt_s = now.at.seconds_since(before.at);
                if dt_s > 0.0 {
                    let allowed = limits.acceleration_max_rad_per_s2()[joint];
                    raise(&mut most.acceleration, (is - was).abs() / dt_s / allowed, axis);
                }
                most.turns += usize::from(was * is < 0.0 && (is - was).abs() > STILL_RAD_PER_S);
            }
        }
        most
    }
}
