//! What is measured along a path, and what of it is refused.

use nalgebra::Vector6;
use pb3dp_kinematics::{DOF, JointLimits, JointVector};

use super::refusal::{PathRefusal, ToolSpeed};

/// Maximum path deviation for the arm to count as following it, m and rad.
const FOLLOWS_WITHIN: f64 = 1e-3;

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

impl PathReport {
    pub(super) fn begin(begin_rad: JointVector) -> Self {
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
    pub(super) fn note_joints(
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

    pub(super) fn note_tool(&mut self, (linear_m_per_s, angular_rad_per_s): (f64, f64), at_s: f64) {
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
    pub(super) fn raise(&mut self, value: f64, at_s: f64) {
        if value > self.value {
            *self = Self { value, at_s };
        }
    }

    pub(super) fn lower(&mut self, value: f64, at_s: f64) {
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

pub(super) fn check_follows(error: &Vector6<f64>, at_s: f64) -> Result<(), PathRefusal> {
    let (position_error_m, angle_error_rad) = sizes(error);
    if position_error_m <= FOLLOWS_WITHIN && angle_error_rad <= FOLLOWS_WITHIN {
        return Ok(());
    }
    Err(PathRefusal::OutOfReach { at_s, position_error_m, angle_error_rad })
}

pub(super) fn check_range(
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
pub(super) struct WorstRange {
    excess_rad: f64,
    refusal: Option<PathRefusal>,
}

impl WorstRange {
    pub(super) fn note(&mut self, checked: Result<(), PathRefusal>) {
        if let Err(refusal @ PathRefusal::JointRange { excess_rad, .. }) = checked
            && excess_rad > self.excess_rad
        {
            (self.excess_rad, self.refusal) = (excess_rad, Some(refusal));
        }
    }

    /// If a joint left its range earlier, that is the cause of the later refusal.
    pub(super) fn or(&self, refusal: PathRefusal) -> PathRefusal {
        self.refusal.clone().unwrap_or(refusal)
    }

    pub(super) fn check(self) -> Result<(), PathRefusal> {
        self.refusal.map_or(Ok(()), Err)
    }
}

pub(super) fn check_singular_value(value: f64, required: f64, at_s: f64) -> Result<(), PathRefusal> {
    if value >= required { Ok(()) } else { Err(PathRefusal::Singular { at_s, value, required }) }
}

pub(super) fn check_speed(report: &PathReport, most_rad_per_s: &JointVector) -> Result<(), PathRefusal> {
    let (joint, Extreme { value: ratio, at_s }) = report.fastest_joint();
    if ratio <= 1.0 {
        return Ok(());
    }
    let allowed_rad_per_s = most_rad_per_s[joint];
    Err(PathRefusal::TooFast { joint, at_s, needed_rad_per_s: ratio * allowed_rad_per_s, allowed_rad_per_s, ratio })
}

pub(super) fn check_tool_speed(report: &PathReport, most: Option<ToolSpeedMax>) -> Result<(), PathRefusal> {
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

pub(super) fn check_acceleration(report: &PathReport, most: &JointVector) -> Result<(), PathRefusal> {
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

pub(super) fn check_requirements(requirements: &PathRequirements) -> Result<(), PathRefusal> {
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
