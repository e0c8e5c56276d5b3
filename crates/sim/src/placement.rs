//! Checks whether an arm can follow an experiment from its base pose, and by how much it exceeds a limit.
//!
//! Both arms of the workcell move with the target: one carries it, the other keeps a fixed pose relative to it. The path of
//! either flange is therefore rigidly tied to the path of the target ([`FlangePath`]). [`check_experiment`] follows it by
//! resolved-rate control, in the same way as the arms are driven: damped pseudo-inverse, without using the redundant joint.

mod codes;
mod refusal;

use nalgebra::{Vector3, Vector6};
use pb3dp_geometry::frames::{Base, Flange, Hand, Model, Target, World};
use pb3dp_geometry::{Pose, Twist};
use pb3dp_kinematics::reach::twist_between;
use pb3dp_kinematics::{
    Chain, DOF, Damping, EffectiveLimits, JointLimits, JointVector, NotReached, SingularForm, damped_pseudo_inverse,
    reach,
};

use crate::trajectory::Trajectory;

pub use self::refusal::{PathRefusal, ToolSpeed};

/// Gain that corrects the drift of the integration, 1/s.
const CORRECTION_PER_S: f64 = 10.0;
/// Maximum path deviation for the arm to count as following it, m and rad.
const FOLLOWS_WITHIN: f64 = 1e-3;
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

/// Requirements along the whole path, in addition to the arm limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathRequirements {
    /// Minimum singular value of the Jacobian (metres and radians).
    pub singular_value_min: f64,
    /// Minimum distance of each joint from the ends of its range, rad.
    pub limit_margin_rad: f64,
    /// Maximum speeds of the tool; `None`: unlimited.
    pub tool_speed_max: Option<ToolSpeedMax>,
    /// Time between two checked points, seconds, 0.0005 to 0.1.
    pub step_s: f64,
}

/// Maximum speeds of a tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolSpeedMax {
    /// Of its origin, m/s, above 0.
    pub linear_m_per_s: f64,
    /// Angular, rad/s, above 0.
    pub angular_rad_per_s: f64,
}

impl PathRequirements {
    /// The requirements of the experiment: singular value 0.05, 3 degrees of margin, steps of 10 ms. The tool speed is not
    /// limited.
    pub const OF_EXPERIMENT: Self = Self {
        singular_value_min: 0.05,
        limit_margin_rad: 3.0 * std::f64::consts::PI / 180.0,
        tool_speed_max: None,
        step_s: 0.01,
    };
}

/// The extreme of a value along a path, and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extreme {
    /// The value; its unit is that of the field that holds it.
    pub value: f64,
    /// Seconds after the start of the path.
    pub at_s: f64,
}

/// Results for a path that the arm can follow.
#[derive(Clone, Debug, PartialEq)]
pub struct PathReport {
    /// Joint angles at the start of the path, rad: reached from the given ones.
    pub begin_rad: JointVector,
    /// Joint angles at the end, rad. They differ slightly from the start even for a closed path: resolved-rate control does not
    /// return the redundant joint exactly.
    pub end_rad: JointVector,
    /// Smallest singular value of the Jacobian, metres and radians.
    pub singular_value_min: Extreme,
    /// Largest speed of each joint, as a share of its limit; 1 is just possible.
    pub speed_ratio_max: [Extreme; DOF],
    /// Largest joint acceleration per joint, rad/s^2.
    pub acceleration_max_rad_per_s2: [Extreme; DOF],
    /// Largest speed of the tool's origin, m/s.
    pub tool_linear_max_m_per_s: Extreme,
    /// Largest angular speed of the tool, rad/s.
    pub tool_angular_max_rad_per_s: Extreme,
    /// Smallest distance of each joint to an end of its range, rad.
    pub limit_margin_min_rad: [Extreme; DOF],
    /// Largest distance between the flange and its path in the numerical integration, m.
    pub position_error_max_m: Extreme,
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
    for step in 0..=steps {
        let at_s = step as f64 * requirements.step_s;
        let error = twist_between(&chain.forward(&position_rad), &path.base_from_flange_at(at_s));
        check_follows(&error, at_s).map_err(|refusal| range.or(refusal))?;
        range.note(check_range(limits.operating(), requirements.limit_margin_rad, &position_rad, at_s));
        let form = SingularForm::new(&chain.jacobian(&position_rad));
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
        let inverse = damped_pseudo_inverse(&chain.jacobian(&half_way_rad), &damping);
        position_rad += inverse * twist * requirements.step_s;
        last_velocity = velocity;
    }
    range.check()?;
    check_speed(&report, limits.velocity_max_rad_per_s())?;
    check_tool_speed(&report, requirements.tool_speed_max)?;
    check_acceleration(&report, limits.acceleration_max_rad_per_s2())?;
    Ok(report)
}

impl PathReport {
    fn begin(begin_rad: JointVector) -> Self {
        let zero = Extreme { value: 0.0, at_s: 0.0 };
        let far = Extreme { value: f64::INFINITY, at_s: 0.0 };
        Self {
            begin_rad,
            end_rad: begin_rad,
            singular_value_min: far,
            speed_ratio_max: [zero; DOF],
            acceleration_max_rad_per_s2: [zero; DOF],
            tool_linear_max_m_per_s: zero,
            tool_angular_max_rad_per_s: zero,
            limit_margin_min_rad: [far; DOF],
            position_error_max_m: zero,
        }
    }

    /// Updates the extremes of the joints with one point of the path.
    fn note_joints(
        &mut self,
        limits: &JointLimits,
        requirements: &PathRequirements,
        at_s: f64,
        position_rad: &JointVector,
        velocity: &JointVector,
        last_velocity: &JointVector,
    ) {
        let speed_ratio = velocity.component_div(limits.velocity_max_rad_per_s());
        let acceleration = (velocity - last_velocity) / requirements.step_s;
        let margin_rad = limits.margin_rad(position_rad);
        for joint in 0..DOF {
            self.speed_ratio_max[joint].raise(speed_ratio[joint].abs(), at_s);
            self.acceleration_max_rad_per_s2[joint].raise(acceleration[joint].abs(), at_s);
            self.limit_margin_min_rad[joint].lower(margin_rad[joint], at_s);
        }
        self.end_rad = *position_rad;
    }

    fn note_tool(&mut self, (linear_m_per_s, angular_rad_per_s): (f64, f64), at_s: f64) {
        self.tool_linear_max_m_per_s.raise(linear_m_per_s, at_s);
        self.tool_angular_max_rad_per_s.raise(angular_rad_per_s, at_s);
    }

    /// The joint with the largest share of its allowed speed, and this share.
    pub fn fastest_joint(&self) -> (usize, Extreme) {
        worst(&self.speed_ratio_max, |a, b| a > b)
    }

    /// The joint nearest to an end of its range, and the distance (rad).
    pub fn tightest_joint(&self) -> (usize, Extreme) {
        worst(&self.limit_margin_min_rad, |a, b| a < b)
    }
}

impl Extreme {
    fn raise(&mut self, value: f64, at_s: f64) {
        if value > self.value {
            *self = Self { value, at_s };
        }
    }

    fn lower(&mut self, value: f64, at_s: f64) {
        if value < self.value {
            *self = Self { value, at_s };
        }
    }
}

fn worst(extremes: &[Extreme; DOF], is_worse: fn(f64, f64) -> bool) -> (usize, Extreme) {
    let mut found = (0, extremes[0]);
    for (joint, extreme) in extremes.iter().enumerate() {
        if is_worse(extreme.value, found.1.value) {
            found = (joint, *extreme);
        }
    }
    found
}

/// Position and angle of a `[linear; angular]` error.
fn sizes(error: &Vector6<f64>) -> (f64, f64) {
    (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm())
}

fn check_follows(error: &Vector6<f64>, at_s: f64) -> Result<(), PathRefusal> {
    let (position_error_m, angle_error_rad) = sizes(error);
    if position_error_m <= FOLLOWS_WITHIN && angle_error_rad <= FOLLOWS_WITHIN {
        return Ok(());
    }
    Err(PathRefusal::OutOfReach { at_s, position_error_m, angle_error_rad })
}

fn check_range(
    limits: &JointLimits,
    margin_rad: f64,
    position_rad: &JointVector,
    at_s: f64,
) -> Result<(), PathRefusal> {
    let (joint, least_rad) = limits.margin_rad(position_rad).argmin();
    if least_rad >= margin_rad {
        return Ok(());
    }
    Err(PathRefusal::JointRange {
        joint,
        at_s,
        position_rad: position_rad[joint],
        min_rad: limits.position_min_rad()[joint] + margin_rad,
        max_rad: limits.position_max_rad()[joint] - margin_rad,
        excess_rad: margin_rad - least_rad,
    })
}

/// The largest range violation of a joint along the path: the first violation says little about the required change.
#[derive(Default)]
struct WorstRange {
    excess_rad: f64,
    refusal: Option<PathRefusal>,
}

impl WorstRange {
    fn note(&mut self, checked: Result<(), PathRefusal>) {
        if let Err(refusal @ PathRefusal::JointRange { excess_rad, .. }) = checked
            && excess_rad > self.excess_rad
        {
            (self.excess_rad, self.refusal) = (excess_rad, Some(refusal));
        }
    }

    /// If a joint left its range earlier, that is the cause of the later refusal.
    fn or(&self, refusal: PathRefusal) -> PathRefusal {
        self.refusal.clone().unwrap_or(refusal)
    }

    fn check(self) -> Result<(), PathRefusal> {
        self.refusal.map_or(Ok(()), Err)
    }
}

fn check_singular_value(value: f64, required: f64, at_s: f64) -> Result<(), PathRefusal> {
    if value >= required { Ok(()) } else { Err(PathRefusal::Singular { at_s, value, required }) }
}

fn check_speed(report: &PathReport, most_rad_per_s: &JointVector) -> Result<(), PathRefusal> {
    let (joint, Extreme { value: ratio, at_s }) = report.fastest_joint();
    if ratio <= 1.0 {
        return Ok(());
    }
    let allowed_rad_per_s = most_rad_per_s[joint];
    Err(PathRefusal::TooFast { joint, at_s, needed_rad_per_s: ratio * allowed_rad_per_s, allowed_rad_per_s, ratio })
}

fn check_tool_speed(report: &PathReport, most: Option<ToolSpeedMax>) -> Result<(), PathRefusal> {
    let Some(most) = most else { return Ok(()) };
    let speeds = [
        (ToolSpeed::Linear, report.tool_linear_max_m_per_s, most.linear_m_per_s),
        (ToolSpeed::Angular, report.tool_angular_max_rad_per_s, most.angular_rad_per_s),
    ];
    let ratio = |speed: &(ToolSpeed, Extreme, f64)| speed.1.value / speed.2;
    let worst = if ratio(&speeds[1]) > ratio(&speeds[0]) { speeds[1] } else { speeds[0] };
    let (quantity, Extreme { value: needed, at_s }, allowed) = worst;
    if needed <= allowed {
        return Ok(());
    }
    Err(PathRefusal::ToolTooFast { quantity, at_s, needed, allowed, ratio: needed / allowed })
}

fn check_acceleration(report: &PathReport, most: &JointVector) -> Result<(), PathRefusal> {
    let ratio = |joint: usize| {
        let Extreme { value, at_s } = report.acceleration_max_rad_per_s2[joint];
        Extreme { value: value / most[joint], at_s }
    };
    let (joint, Extreme { value: ratio, at_s }) = worst(&std::array::from_fn(ratio), |a, b| a > b);
    if ratio <= 1.0 {
        return Ok(());
    }
    let allowed_rad_per_s2 = most[joint];
    let needed_rad_per_s2 = report.acceleration_max_rad_per_s2[joint].value;
    Err(PathRefusal::TooAbrupt { joint, at_s, needed_rad_per_s2, allowed_rad_per_s2, ratio })
}

fn check_requirements(requirements: &PathRequirements) -> Result<(), PathRefusal> {
    let PathRequirements { singular_value_min, limit_margin_rad, step_s, .. } = *requirements;
    let tool = requirements.tool_speed_max.unwrap_or(ToolSpeedMax { linear_m_per_s: 1.0, angular_rad_per_s: 1.0 });
    let checks = [
        ("singular_value_min", singular_value_min, (1e-4..=1.0).contains(&singular_value_min), "0.0001 to 1"),
        ("limit_margin_rad", limit_margin_rad, (0.0..=1.0).contains(&limit_margin_rad), "0 to 1 rad"),
        ("tool_speed_max.linear_m_per_s", tool.linear_m_per_s, tool.linear_m_per_s > 0.0, "above 0 m/s"),
        ("tool_speed_max.angular_rad_per_s", tool.angular_rad_per_s, tool.angular_rad_per_s > 0.0, "above 0 rad/s"),
        ("step_s", step_s, (5e-4..=0.1).contains(&step_s), "0.0005 to 0.1 s"),
    ];
    match checks.into_iter().find(|(_, _, good, _)| !good) {
        None => Ok(()),
        Some((key, value, _, allowed)) => Err(PathRefusal::Requirement { key, value, allowed }),
    }
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
