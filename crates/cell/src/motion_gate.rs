//! Motion permission of a run: the supervisor and its inputs.

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::JointState;
use pb3dp_kinematics::{DOF, JointLimits, JointVector};
use pb3dp_servo::supervisor::{
    ArmCondition, ArmInput, Decision, Innovation, Inputs, OperatorInput, OperatorRequest, RangeEnd, Supervisor,
    SupervisorConfig, SupervisorError,
};
use pb3dp_servo::{ControlStep, ObservationVerdict};

use super::percept::Percept;

/// The supervisor of a run.
pub struct MotionGate {
    supervisor: Supervisor,
    /// The operating range of the arm that carries the cameras.
    limits: JointLimits,
    last: Option<Decision>,
    /// State of both arms in the previous step.
    arms_before: [ArmCondition; 2],
}

impl MotionGate {
    /// No motion is permitted yet.
    ///
    /// # Errors
    /// A policy out of its range or too weak.
    pub fn new(config: &SupervisorConfig, limits: JointLimits) -> Result<Self, SupervisorError> {
        let supervisor = Supervisor::new(config.clone())?;
        Ok(Self { supervisor, limits, last: None, arms_before: [ArmCondition::Disabled; 2] })
    }

    /// The last decision.
    pub fn last(&self) -> Option<&Decision> {
        self.last.as_ref()
    }

    /// Whether a command is a reset that clears the arms: the supervisor accepts it apart from faults latched in the arms, and each of
    /// these was known to it in the previous step.
    pub fn would_reset(&self, request: OperatorRequest, arms: [ArmCondition; 2], now: MonotonicTime) -> bool {
        let is_latched = |arm: ArmCondition| !matches!(arm, ArmCondition::Enabled | ArmCondition::Disabled);
        let is_known =
            self.arms_before.into_iter().zip(arms).all(|(before, arm)| is_latched(before) || !is_latched(arm));
        is_known && self.supervisor.would_reset(request, now)
    }

    /// Decides the permission for this step; both arms with their measurements, the one with the cameras first.
    pub fn step(
        &mut self,
        operator: OperatorInput,
        control: &ControlStep,
        newest: Option<&Percept>,
        arms: [(ArmCondition, &JointState); 2],
        now: MonotonicTime,
    ) -> Decision {
        let inputs = Inputs {
            operator,
            controller: control.mode,
            innovation: innovation(&control.observation),
            target_covariance: control.target_covariance,
            images_late_s: control.images_late_s,
            estimate: newest.map(|percept| percept.estimate),
            frame: newest.map(|percept| percept.frame),
            range_end: nearest_end(&self.limits, &arms[0].1.position_rad),
            smallest_singular_value: control.smallest_singular_value,
            arms: arms.map(|(state, joints)| ArmInput { state, measured_at: Some(joints.at) }),
        };
        let decision = self.supervisor.step(&inputs, now);
        self.last = Some(decision);
        self.arms_before = arms.map(|(condition, _)| condition);
        decision
    }
}

fn innovation(verdict: &ObservationVerdict) -> Innovation {
    match *verdict {
        ObservationVerdict::Accepted => Innovation::Agrees,
        ObservationVerdict::Jump { position_m, orientation_rad } => Innovation::Jump { position_m, orientation_rad },
        ObservationVerdict::Outlier { distance_squared } => Innovation::Outlier { sigmas: distance_squared.sqrt() },
        ObservationVerdict::NoneNew
        | ObservationVerdict::Untrusted
        | ObservationVerdict::NotFinite
        | ObservationVerdict::WrongTime { .. }
        | ObservationVerdict::JointsUnknown(_)
        | ObservationVerdict::BadCovariance => Innovation::NoneNew,
    }
}

/// The joint nearest to an end of its range.
fn nearest_end(limits: &JointLimits, position_rad: &JointVector) -> Option<RangeEnd> {
    let left_rad = limits.margin_rad(position_rad);
    let ends = (0..DOF).map(|joint| RangeEnd { joint, distance_rad: left_rad[joint] });
    ends.reduce(|nearest, end| if end.distance_rad < nearest.distance_rad { end } else { nearest })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_joint_nearest_to_its_limit_is_reported() {
        let min_rad = JointVector::from([-1.0, -1.0, -2.0, -0.5, -3.0, -1.0, -4.0]);
        let max_rad = JointVector::from([1.0, 2.0, 1.0, 2.5, 3.0, 1.5, 4.0]);
        let limits = JointLimits::new(min_rad, max_rad, JointVector::from_element(1.0)).unwrap();
        let mut position_rad = JointVector::zeros();
        assert_eq!(nearest_end(&limits, &position_rad), Some(RangeEnd { joint: 3, distance_rad: 0.5 }));
        position_rad[5] = 1.25;
        assert_eq!(nearest_end(&limits, &position_rad), Some(RangeEnd { joint: 5, distance_rad: 0.25 }));
        position_rad[2] = -2.125;
        assert_eq!(nearest_end(&limits, &position_rad), Some(RangeEnd { joint: 2, distance_rad: -0.125 }));
    }

    #[test]
    fn a_jump_is_reported_with_its_size_and_unchecked_quantities_do_not_agree() {
        let jump = ObservationVerdict::Jump { position_m: 0.3, orientation_rad: 0.1 };
        assert_eq!(innovation(&jump), Innovation::Jump { position_m: 0.3, orientation_rad: 0.1 });
        let outlier = ObservationVerdict::Outlier { distance_squared: 49.0 };
        assert_eq!(innovation(&outlier), Innovation::Outlier { sigmas: 7.0 });
        assert_eq!(innovation(&ObservationVerdict::Accepted), Innovation::Agrees);
        assert_eq!(innovation(&ObservationVerdict::Untrusted), Innovation::NoneNew);
    }
}
