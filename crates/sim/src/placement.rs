//! Checks whether an arm can follow an experiment from its base pose, and by how much it exceeds a limit.
//!
//! Both arms of the workcell move with the target: one carries it, the other keeps a fixed pose relative to it. The path of
//! either flange is therefore rigidly tied to the path of the target ([`FlangePath`]). [`check_experiment`] follows it by
//! resolved-rate control, in the same way as the arms are driven: damped pseudo-inverse, without using the redundant joint.

mod along_path;
mod codes;
mod refusal;

use nalgebra::Vector3;
use pb3dp_geometry::frames::{Base, Flange, Hand, Model, Target, World};
use pb3dp_geometry::{Pose, Twist};
use pb3dp_kinematics::reach::twist_between;
use pb3dp_kinematics::{Chain, Damping, EffectiveLimits, JointVector, NotReached, SingularForm, reach};

use crate::trajectory::Trajectory;

pub use self::along_path::{Extreme, PathReport, PathRequirements, ToolSpeedMax};
use self::along_path::{
    WorstRange, check_acceleration, check_follows, check_range, check_requirements, check_singular_value, check_speed,
    check_tool_speed,
};
pub use self::refusal::{PathRefusal, ToolSpeed};

/// Gain that corrects the drift of the integration, 1/s.
const CORRECTION_PER_S: f64 = 10.0;

/// The path of a flange that is rigidly tied to a moving target, and of the tool on it.
#[derive(Clone, Copy)]
pub struct FlangePath<'a> {
    trajectory: &'a dyn Trajectory,
    base_from_world: Pose<Base, World>,
    target_from_flange: Pose<Target, Flange>,
    tool_in_target_m: Vector3<f64>,
}

impl<'a> FlangePath<'a> {
    /// The flange of the arm with base pose `world_from_base` that carries the target at `flange_from_target`; the tool is the
    /// target.
    pub fn of_carrier(
        trajectory: &'a dyn Trajectory,
        world_from_base: &Pose<World, Base>,
        flange_from_target: &Pose<Flange, Target>,
    ) -> Self {
        let (base_from_world, target_from_flange) = (world_from_base.inverse(), flange_from_target.inverse());
        Self { trajectory, base_from_world, target_from_flange, tool_in_target_m: Vector3::zeros() }
    }

    /// The flange of the arm with base pose `world_from_base` that keeps its hand at `model_from_hand` relative to the target,
    /// without lag or error; the tool is the hand. `target_from_model` is the pose of the model frame on the target.
    pub fn of_follower(
        trajectory: &'a dyn Trajectory,
        world_from_base: &Pose<World, Base>,
        target_from_model: &Pose<Target, Model>,
        model_from_hand: &Pose<Model, Hand>,
        flange_from_hand: &Pose<Flange, Hand>,
    ) -> Self {
        let target_from_hand = *target_from_model * *model_from_hand;
        Self {
            trajectory,
            base_from_world: world_from_base.inverse(),
            target_from_flange: target_from_hand * flange_from_hand.inverse(),
            tool_in_target_m: target_from_hand.translation_m(),
        }
    }

    /// Pose of the flange `t_s` seconds after the start.
    pub fn base_from_flange_at(&self, t_s: f64) -> Pose<Base, Flange> {
        self.base_from_world * self.trajectory.pose_at(t_s) * self.target_from_flange
    }

    /// Velocity of the flange's origin and its angular velocity at that time, in `base`.
    pub fn twist_at(&self, t_s: f64) -> Twist<Base> {
        let (linear, angular) = self.velocity_at(t_s, &self.target_from_flange.translation_m());
        Twist::<World>::new(linear, angular).expressed_in(&self.base_from_world)
    }

    /// Speed of the tool's origin (m/s) and its angular speed (rad/s) at that time.
    pub fn tool_speed_at(&self, t_s: f64) -> (f64, f64) {
        let (linear, angular) = self.velocity_at(t_s, &self.tool_in_target_m);
        (linear.norm(), angular.norm())
    }

    /// Linear and angular velocity of a point on the target or rigidly tied to it, in `world`.
    fn velocity_at(&self, t_s: f64, point_in_target_m: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let target = self.trajectory.twist_at(t_s);
        let lever = self.trajectory.pose_at(t_s).transform_vector(point_in_target_m);
        (target.linear_m_per_s + target.angular_rad_per_s.cross(&lever), target.angular_rad_per_s)
    }

    /// Duration, seconds.
    pub fn duration_s(&self) -> f64 {
        self.trajectory.duration_s()
    }
}

/// Follows `path` with the arm and reports the distances to its limits.
///
/// The arm first moves from `start_rad` to the start of the path (ignoring speed), then follows it by resolved-rate control.
///
/// # Errors
/// The first point at which reach, joint range or singular value violate a requirement. Otherwise the worst point of the whole
/// path at which a joint is too fast, or the tool is too fast, or a joint acceleration is too high, in this order.
pub fn check_experiment(
    chain: &Chain,
    limits: &EffectiveLimits,
    start_rad: &JointVector,
    path: &FlangePath<'_>,
    requirements: &PathRequirements,
) -> Result<PathReport, PathRefusal> {
    check_requirements(requirements)?;
    let damping = damping(requirements)?;
    let begin_rad = reach(chain, start_rad, &path.base_from_flange_at(0.0), &damping).map_err(
        |NotReached { position_error_m, angle_error_rad }| PathRefusal::BeginUnreachable {
            position_error_m,
            angle_error_rad,
        },
    )?;
    let mut report = PathReport::begin(begin_rad);
    let steps = (path.duration_s() / requirements.step_s).ceil() as usize;
    let mut position_rad = begin_rad;
    let mut last_velocity = JointVector::zeros();
    let mut range = WorstRange::default();
    let mut form = SingularForm::new(&chain.jacobian(&position_rad));
    for step in 0..=steps {
        let at_s = step as f64 * requirements.step_s;
        let error = twist_between(&chain.forward(&position_rad), &path.base_from_flange_at(at_s));
        check_follows(&error, at_s).map_err(|refusal| range.or(refusal))?;
        range.note(check_range(limits.operating(), requirements.limit_margin_rad, &position_rad, at_s));
        form = form.near(&chain.jacobian(&position_rad));
        let singular_value = form.smallest_value();
        check_singular_value(singular_value, requirements.singular_value_min, at_s)
            .map_err(|refusal| range.or(refusal))?;
        let inverse = form.damped_inverse(&damping);
        let velocity = inverse * path.twist_at(at_s).to_vector();
        report.singular_value_min.lower(singular_value, at_s);
        report.note_tool(path.tool_speed_at(at_s), at_s);
        report.position_error_max_m.raise(error.fixed_rows::<3>(0).norm(), at_s);
        report.note_joints(limits.operating(), requirements, at_s, &position_rad, &velocity, &last_velocity);
        let half_way_rad = position_rad + velocity * (0.5 * requirements.step_s);
        let twist = path.twist_at(at_s + 0.5 * requirements.step_s).to_vector() + error * CORRECTION_PER_S;
        form = form.near(&chain.jacobian(&half_way_rad));
        let inverse = form.damped_inverse(&damping);
        position_rad += inverse * twist * requirements.step_s;
        last_velocity = velocity;
    }
    range.check()?;
    check_speed(&report, limits.velocity_max_rad_per_s())?;
    check_tool_speed(&report, requirements.tool_speed_max)?;
    check_acceleration(&report, limits.acceleration_max_rad_per_s2())?;
    Ok(report)
}

/// Damping that acts only where the path is refused anyway.
fn damping(requirements: &PathRequirements) -> Result<Damping, PathRefusal> {
    let threshold = 0.5 * requirements.singular_value_min;
    Damping::new(threshold, threshold).map_err(|error| PathRefusal::Requirement {
        key: "singular_value_min",
        value: error.value,
        allowed: "0.0001 to 1",
    })
}
