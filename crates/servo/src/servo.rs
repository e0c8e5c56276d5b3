//! Controller and supervisor together, in the order that a control cycle needs.

use pb3dp_geometry::frames::{Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{DOF, JointLimits, JointState, JointVector};

use crate::controller::{Command, ControlStep, Controller};
use crate::supervisor::{
    ArmCondition, ArmInput, Decision, EstimateInput, FrameInput, Innovation, Inputs, OperatorInput, OperatorRequest,
    Permission, RangeEnd, Supervisor,
};
use crate::target_filter::{ObservationVerdict, TargetObservation};

/// Measurements and requests of one control cycle. A "newest" value may be the same as in the cycle before.
#[derive(Clone, Copy, Debug)]
pub struct ServoInput<'a> {
    /// Measured joints of the arm that carries the cameras.
    pub joints: &'a JointState,
    /// The newest pose of the target.
    pub observation: Option<&'a TargetObservation>,
    /// The newest estimate, with or without a pose; `None` before the first one.
    pub estimate: Option<EstimateInput>,
    /// The newest stereo pair; `None` before the first one.
    pub frame: Option<FrameInput>,
    /// Input from the operator.
    pub operator: OperatorInput,
    /// Share of the permitted velocity that the operator requests, 0 to 1. A number that is not finite stands for 0.
    pub speed_share: f64,
    /// The arm that carries the cameras, and the one that carries the target.
    pub arms: [ArmInput; 2],
}

/// Result of one control cycle.
#[derive(Clone, Copy, Debug)]
pub struct ServoStep {
    /// Command for the arm that carries the cameras: that of the controller, within what the supervisor permits.
    pub command: Command,
    /// Result of the controller; its own command is only a request.
    pub control: ControlStep,
    /// Result of the supervisor, with the reason if the arm does not move.
    pub decision: Decision,
}

/// Visual servo of one arm: [`Controller`] and [`Supervisor`], stepped in the right order.
#[derive(Clone, Debug)]
pub struct Servo {
    controller: Controller,
    supervisor: Supervisor,
    /// The operating range of the arm that carries the cameras.
    limits: JointLimits,
    last: Option<Decision>,
    /// States of both arms in the previous cycle.
    arms_before: [ArmCondition; 2],
}

impl Servo {
    /// Nothing moves before the operator selects a target and requests the start.
    pub fn new(controller: Controller, supervisor: Supervisor) -> Self {
        let limits = *controller.limits().operating();
        Self { controller, supervisor, limits, last: None, arms_before: [ArmCondition::Disabled; 2] }
    }

    /// One control cycle: never blocks, never allocates. The caller sends [`ServoStep::command`] to the arm; if the arm does not execute
    /// it, [`Self::set_executed_command`] reports what it did.
    pub fn step(&mut self, input: &ServoInput<'_>, now: MonotonicTime) -> ServoStep {
        let control = self.controller.step(input.joints, input.observation, now);
        let decision = self.supervisor.step(&self.inputs(input, &control), now);
        let speed_share = if input.speed_share.is_finite() { input.speed_share.clamp(0.0, 1.0) } else { 0.0 };
        let command = match (decision.permission, control.command) {
            (Permission::Move { share }, Command::Velocity(velocity)) => {
                Command::Velocity(velocity * (share * speed_share))
            }
            _ => Command::Hold,
        };
        self.controller.permit_search(decision.search);
        if decision.rearm {
            self.controller.acquire();
        }
        if command != control.command {
            self.controller.set_executed_command(command);
        }
        self.last = Some(decision);
        self.arms_before = input.arms.map(|arm| arm.state);
        ServoStep { command, control, decision }
    }

    /// Stores what the arm executed in place of the last command: an arm that did not answer holds, which is a velocity of zero.
    pub fn set_executed_command(&mut self, executed: Command) {
        self.controller.set_executed_command(executed);
    }

    /// Sets the desired pose of the hand, see [`Controller::set_model_from_hand_desired`].
    pub fn set_model_from_hand_desired(&mut self, model_from_hand_desired: Pose<Model, Hand>) {
        self.controller.set_model_from_hand_desired(model_from_hand_desired);
    }

    /// The hand approaches its desired pose anew, see [`Controller::approach_again`].
    pub fn approach_again(&mut self) {
        self.controller.approach_again();
    }

    /// The decision of the last cycle.
    pub fn last_decision(&self) -> Option<&Decision> {
        self.last.as_ref()
    }

    /// Whether a request is a reset that clears the arms: the supervisor accepts it apart from faults latched in the arms, and each of
    /// these was known to it in the previous cycle.
    pub fn would_reset(&self, request: OperatorRequest, arms: [ArmCondition; 2], now: MonotonicTime) -> bool {
        let is_latched = |arm: ArmCondition| !matches!(arm, ArmCondition::Enabled | ArmCondition::Disabled);
        let is_known =
            self.arms_before.into_iter().zip(arms).all(|(before, arm)| is_latched(before) || !is_latched(arm));
        is_known && self.supervisor.would_reset(request, now)
    }

    /// What the supervisor gets in this cycle.
    fn inputs(&self, input: &ServoInput<'_>, control: &ControlStep) -> Inputs {
        Inputs {
            operator: input.operator,
            controller: control.mode,
            innovation: innovation(&control.observation),
            target_covariance: control.target_covariance,
            images_late_s: control.images_late_s,
            estimate: input.estimate,
            frame: input.frame,
            range_end: nearest_end(&self.limits, &input.joints.position_rad),
            smallest_singular_value: control.smallest_singular_value,
            arms: input.arms,
        }
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
