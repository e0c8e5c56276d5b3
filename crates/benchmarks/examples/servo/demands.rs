//! Demands of a target motion on the following arm, as shares of its limits; and the fastest possible step response.

use anyhow::{Context, Result};
use pb3dp_geometry::frames::{Model, Target, World};
use pb3dp_geometry::{Pose, Twist};
use pb3dp_kinematics::{DOF, JointVector, StatedLimits};
use pb3dp_setup::setup::Setup;
use pb3dp_sim::placement::{FlangePath, PathReport, PathRequirements, check_experiment};
use pb3dp_sim::trajectory::{Mark, MotionConfig, StepExperimentConfig, Trajectory};

use crate::setups::ARM_LAG;

/// Factor by which the limits are raised, to find the demands beyond them.
const LIFTED: f64 = 1e4;

/// One demand of a motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Demand {
    /// Name such as `axis 3, speed`.
    pub what: String,
    /// Whether it is the speed of a joint or of the hand, and not an acceleration.
    pub is_speed: bool,
    /// Share of the limit: above 1 the motion is not feasible.
    pub share: f64,
}

/// Pose of the target at the start.
pub fn start(setup: &Setup) -> Pose<World, Target> {
    setup.rig.arms.tc.world_from_base
        * setup.rig.arms.tc.chain.forward(&setup.rig.arms.tc.start_rad)
        * setup.rig.flange_from_target
}

/// Demands on a hand that follows without lag, the largest first.
///
/// # Errors
/// If the motion leads out of reach, out of a joint's range or to a singular pose.
pub fn demands(setup: &Setup, motion: &MotionConfig) -> Result<Vec<Demand>> {
    let target = motion.begin_at(start(setup))?;
    let report = follow(setup, &*target)?;
    let (allowed, speed) = (&setup.rig.arms.vs.limits, &setup.controller.speed.tracking);
    let demand = |what: String, is_speed: bool, share: f64| Demand { what, is_speed, share };
    let mut demands: Vec<Demand> = (0..DOF)
        .flat_map(|joint| {
            let axis = joint + 1;
            let acceleration =
                report.acceleration_max_rad_per_s2[joint].value / allowed.acceleration_max_rad_per_s2()[joint];
            [
                demand(format!("axis {axis}, speed"), true, report.speed_ratio_max[joint].value * LIFTED),
                demand(format!("axis {axis}, acceleration"), false, acceleration),
            ]
        })
        .collect();
    let (linear, angular) = (report.tool_linear_max_m_per_s.value, report.tool_angular_max_rad_per_s.value);
    demands.push(demand("hand, speed".to_owned(), true, linear / speed.linear_m_per_s));
    demands.push(demand("hand, angular speed".to_owned(), true, angular / speed.angular_rad_per_s));
    demands.sort_by(|a, b| b.share.total_cmp(&a.share));
    Ok(demands)
}

fn follow(setup: &Setup, target: &dyn Trajectory) -> Result<PathReport> {
    let allowed = &setup.rig.arms.vs.limits;
    let lifted = StatedLimits {
        servo: allowed.operating().with_velocity_max(allowed.velocity_max_rad_per_s() * LIFTED)?,
        operating_min_rad: *allowed.operating().position_min_rad(),
        operating_max_rad: *allowed.operating().position_max_rad(),
        speed_scale: 1.0,
        acceleration_max_rad_per_s2: allowed.acceleration_max_rad_per_s2() * LIFTED,
        jerk_max_rad_per_s3: *allowed.jerk_max_rad_per_s3(),
    };
    let path = FlangePath::of_follower(
        target,
        &setup.rig.arms.vs.world_from_base,
        &Pose::<Target, Model>::coincident(),
        &setup.controller.model_from_hand_desired,
        &setup.controller.flange_from_hand,
    );
    let requirements = PathRequirements::OF_EXPERIMENT;
    Ok(check_experiment(
        &setup.rig.arms.vs.chain,
        &lifted.effective()?,
        &setup.rig.arms.vs.start_rad,
        &path,
        &requirements,
    )?)
}

/// A motion that ends early.
struct Shortened<'a>(&'a dyn Trajectory, f64);

impl Trajectory for Shortened<'_> {
    fn pose_at(&self, t_s: f64) -> Pose<World, Target> {
        self.0.pose_at(t_s.min(self.1))
    }

    fn twist_at(&self, t_s: f64) -> Twist<World> {
        self.0.twist_at(t_s.min(self.1))
    }

    fn marks(&self) -> &[Mark] {
        self.0.marks()
    }

    fn duration_s(&self) -> f64 {
        self.1
    }
}

/// The shortest time in which a hand can come within `within_share` of the distance after a step, with any law, and
/// what determines it. The time is the total delay without the arm's lag (which a law may compensate), and the slowest
/// of each joint from rest to rest at its largest speed and acceleration and of the hand at its largest speeds.
///
/// # Errors
/// If the step leads out of reach.
pub fn shortest_step(
    setup: &Setup,
    step: &StepExperimentConfig,
    delay_s: f64,
    within_share: f64,
) -> Result<(f64, String)> {
    // Slow enough for all limits; only the poses matter.
    let slow = StepExperimentConfig { move_s: 4.0, lead_in_s: 0.0, ..step.clone() };
    let target = MotionConfig::Steps(slow).begin_at(start(setup))?;
    let report = follow(setup, &Shortened(&*target, 4.0))?;
    let limits = &setup.rig.arms.vs.limits;
    let way_rad: JointVector = (report.end_rad - report.begin_rad).map(f64::abs);
    let speed = limits.velocity_max_rad_per_s();
    let joint = |joint: usize| {
        let (way, speed, acceleration) = (way_rad[joint], speed[joint], limits.acceleration_max_rad_per_s2()[joint]);
        (rest_to_rest_s(way, speed, acceleration, within_share), format!("axis {}", joint + 1))
    };
    let target_from_hand = Pose::<Target, Model>::coincident() * setup.controller.model_from_hand_desired;
    let hand = |t_s: f64| target.pose_at(t_s) * target_from_hand;
    let (from, to) = (hand(0.0), hand(4.0));
    let most = setup.controller.speed.tracking;
    let share = 1.0 - within_share;
    let linear_s = share * (to.translation_m() - from.translation_m()).norm() / most.linear_m_per_s;
    let angular_s = share * from.rotation().angle_to(&to.rotation()) / most.angular_rad_per_s;
    let hand_times = [(linear_s, "speed of the hand".to_owned()), (angular_s, "angular speed of the hand".to_owned())];
    let slowest = (0..DOF).map(joint).chain(hand_times).max_by(|a, b| a.0.total_cmp(&b.0));
    let (move_s, what) = slowest.context("an arm has joints")?;
    Ok((delay_s - ARM_LAG.as_secs_f64() + move_s, what))
}

/// Time from rest to within a share of the end, where the joint may still brake: full acceleration, largest speed, full
/// deceleration.
fn rest_to_rest_s(way: f64, speed: f64, acceleration: f64, within_share: f64) -> f64 {
    let whole_s = if way * acceleration > speed * speed {
        way / speed + speed / acceleration
    } else {
        2.0 * (way / acceleration).sqrt()
    };
    let left = (2.0 * within_share * way / acceleration).sqrt();
    (whole_s - left).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_to_rest_takes_as_long_as_the_textbook_says() {
        // 1 rad at 2 rad/s^2: half the distance in 1/sqrt(2) s each; at most 0.5 rad/s: 2 s and 0.25 s.
        assert!((rest_to_rest_s(1.0, 10.0, 2.0, 0.0) - 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((rest_to_rest_s(1.0, 0.5, 2.0, 0.0) - 2.25).abs() < 1e-12);
        // The last 2 % of the distance take sqrt(2 x 0.02 / 2) s.
        assert!((rest_to_rest_s(1.0, 10.0, 2.0, 0.02) - (2.0_f64.sqrt() - 0.02_f64.sqrt())).abs() < 1e-12);
    }
}
