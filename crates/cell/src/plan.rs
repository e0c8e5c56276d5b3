//! A straight joint-space move, stationary at both ends.

use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_kinematics::{DOF, JointVector, PlacedArm, clearance};
use pb3dp_setup::setup::{ArmSetup, Setup};

use super::parts::ArmChoice;

/// Share of the acceleration and jerk limits used.
const SHARE: f64 = 0.5;
/// Share of the speed limit used; the remainder is for the correction of joint errors.
const SPEED_SHARE: f64 = 0.9;
/// Peaks of the first, second and third derivative of the course over its duration.
const PEAKS: [f64; 3] = [1.875, 5.774, 60.0];
/// Shortest move, seconds.
const SHORTEST_S: f64 = 0.5;
/// Largest joint motion allowed between planning and opening the brakes, rad.
pub const STAYED_WITHIN_RAD: f64 = 0.01;
/// Number of points along the path at which the distance to the other arm is evaluated.
const PLACES: u32 = 200;

/// A planned move.
#[derive(Clone, Debug)]
pub struct Plan {
    from_rad: JointVector,
    by_rad: JointVector,
    duration_s: f64,
    axis_names: [String; DOF],
}

/// Least distance between the path and the other arm, and the parts concerned.
#[derive(Clone, Debug)]
pub struct Room {
    distance_m: f64,
    parts: String,
}

impl Plan {
    /// Plans a move from measured joints by these angles, within the limits of the arm.
    ///
    /// # Errors
    /// If a joint would end outside its operating range and farther out than it is now.
    pub fn new(arm: &ArmSetup, from_rad: JointVector, by_rad: JointVector) -> Result<Self> {
        let to_rad = from_rad + by_rad;
        let (limits, operating) = (&arm.limits, arm.limits.operating());
        for joint in 0..DOF {
            let (low, high) = (operating.position_min_rad()[joint], operating.position_max_rad()[joint]);
            let outside = |angle: f64| (low - angle).max(angle - high).max(0.0);
            if outside(to_rad[joint]) > 0.0 && outside(to_rad[joint]) >= outside(from_rad[joint]) {
                bail!(
                    "{} would end at {:.3} degrees, outside its operating range {:.1} to {:.1}: choose a shorter move",
                    arm.axis_name(joint),
                    to_rad[joint].to_degrees(),
                    low.to_degrees(),
                    high.to_degrees()
                );
            }
        }
        let speeds = limits.velocity_max_rad_per_s();
        let times = (0..DOF).map(|joint| {
            let by = by_rad[joint].abs();
            let [speed, acceleration, jerk] = PEAKS;
            let by_speed = speed * by / (SPEED_SHARE * speeds[joint]);
            let by_acceleration = (acceleration * by / (SHARE * limits.acceleration_max_rad_per_s2()[joint])).sqrt();
            let by_jerk = (jerk * by / (SHARE * limits.jerk_max_rad_per_s3()[joint])).cbrt();
            by_speed.max(by_acceleration).max(by_jerk)
        });
        let axis_names = std::array::from_fn(|joint| arm.axis_name(joint));
        Ok(Self { from_rad, by_rad, duration_s: times.fold(SHORTEST_S, f64::max), axis_names })
    }

    /// Duration from start to end.
    pub fn duration(&self) -> Duration {
        Duration::from_secs_f64(self.duration_s)
    }

    /// Start of the plan, rad.
    pub fn start_rad(&self) -> &JointVector {
        &self.from_rad
    }

    /// Refuses joints that are not at the start of the plan: ranges and distances were checked from there only.
    ///
    /// # Errors
    /// The axis that is farthest from it.
    pub fn check_begin(&self, position_rad: &JointVector) -> Result<()> {
        let moved = position_rad - self.from_rad;
        if moved.amax() <= STAYED_WITHIN_RAD {
            return Ok(());
        }
        let joint = moved.iamax();
        bail!(
            "{} is {:+.3} degrees from the start of the plan: plan again",
            self.axis_names[joint],
            moved[joint].to_degrees()
        )
    }

    /// Name of a joint in messages; joint 0 is at the base.
    pub fn axis_name(&self, joint: usize) -> &str {
        &self.axis_names[joint]
    }

    /// End of the plan, rad.
    pub fn end_rad(&self) -> JointVector {
        self.from_rad + self.by_rad
    }

    /// Displacement, rad.
    pub fn by_rad(&self) -> &JointVector {
        &self.by_rad
    }

    /// Joint angles and speeds at a time, rad and rad/s.
    pub fn at(&self, time: Duration) -> (JointVector, JointVector) {
        let u = (time.as_secs_f64() / self.duration_s).clamp(0.0, 1.0);
        // The polynomial of lowest order with zero speed and acceleration at both ends.
        let share = u * u * u * (10.0 + u * (6.0 * u - 15.0));
        let speed = 30.0 * u * u * (1.0 - u) * (1.0 - u) / self.duration_s;
        (self.from_rad + self.by_rad * share, self.by_rad * speed)
    }

    /// The least distance to the other arm along the path.
    pub fn room(&self, setup: &Setup, choice: ArmChoice, other_rad: &JointVector) -> Room {
        let (arm, other) = (choice.of(setup), choice.other().of(setup));
        let other_frames = other.chain.joint_frames(other_rad);
        let standing =
            PlacedArm { shape: &other.shape, world_from_base: &other.world_from_base, frames: &other_frames };
        let room_at = |place: u32| {
            let (joints_rad, _) = self.at(self.duration() * place / PLACES);
            let frames = arm.chain.joint_frames(&joints_rad);
            let moving = PlacedArm { shape: &arm.shape, world_from_base: &arm.world_from_base, frames: &frames };
            let nearest = clearance(&moving, &standing);
            Room { distance_m: nearest.distance_m, parts: format!("{} to {}", nearest.first, nearest.second) }
        };
        let nearer = |one: Room, other: Room| if other.distance_m < one.distance_m { other } else { one };
        (1..=PLACES).map(room_at).fold(room_at(0), nearer)
    }

    /// The move as a table, joint by joint.
    pub fn table(&self, arm: &ArmSetup) -> String {
        let (operating, servo) = (arm.limits.operating(), arm.limits.servo());
        let mut text =
            "axis   now deg    to deg    by deg  fastest rad/s  to operating range, deg  to servo limit, deg\n"
                .to_owned();
        let to_rad = self.end_rad();
        for joint in 0..DOF {
            let left = |low: f64, high: f64| (to_rad[joint] - low).min(high - to_rad[joint]).to_degrees();
            text += &format!(
                "{} {}  {:>8.3}  {:>8.3}  {:>+8.3}  {:>13.4}  {:>23.2}  {:>19.2}\n",
                joint + 1,
                arm.chain.joint_names()[joint].to_uppercase(),
                self.from_rad[joint].to_degrees(),
                to_rad[joint].to_degrees(),
                self.by_rad[joint].to_degrees(),
                PEAKS[0] * self.by_rad[joint].abs() / self.duration_s,
                left(operating.position_min_rad()[joint], operating.position_max_rad()[joint]),
                left(servo.position_min_rad()[joint], servo.position_max_rad()[joint]),
            );
        }
        text
    }
}

impl Room {
    /// Checks the distance against its limit.
    ///
    /// # Errors
    /// If it is less than the setup allows.
    pub fn check(&self, setup: &Setup) -> Result<()> {
        // NaN is not enough.
        if self.distance_m >= setup.rig.least_room_m {
            return Ok(());
        }
        bail!(
            "the clearance of {self} is less than arms.least_room_mm, {:.0} mm: move the other arm away",
            1e3 * setup.rig.least_room_m
        )
    }
}

impl std::fmt::Display for Room {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.0} mm ({})", 1e3 * self.distance_m, self.parts)
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_setup::setup::read_setup;

    use super::*;

    #[test]
    fn a_plan_begins_where_it_was_made_and_nowhere_else() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let setup = read_setup(std::path::Path::new(file)).unwrap();
        let from_rad = setup.rig.arms.vs.start_rad;
        let plan = Plan::new(&setup.rig.arms.vs, from_rad, JointVector::repeat(0.05)).unwrap();
        let moved = |joint: usize, by_rad: f64| {
            let mut at_rad = from_rad;
            at_rad[joint] += by_rad;
            plan.check_begin(&at_rad).map_err(|refusal| refusal.to_string())
        };
        assert_eq!(moved(3, -0.9 * STAYED_WITHIN_RAD), Ok(()));
        let refusal = moved(3, -0.02).unwrap_err();
        assert!(refusal.contains("-1.146 degrees from the start of the plan: plan again"), "{refusal}");
        assert!(refusal.starts_with("axis 4 (E1)"), "{refusal}");
    }
}
