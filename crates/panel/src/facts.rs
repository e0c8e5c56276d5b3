//! What the panel knows of the setup; it does not change while the panel runs.

use nalgebra::{Isometry3, Vector3};
use pb3dp_cell::calibration_facts::CalibrationFacts;
use pb3dp_cell::calibration_share::term_of_setup;
use pb3dp_cell::parts::{ArmChoice, GatewayLimits};
use pb3dp_estimation::calibration_term::CalibrationTerm;
use pb3dp_estimation::estimator::EstimatorConfig;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::frames::{Base, CamLeft, Flange, Hand, Model, World};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_kinematics::{Chain, EffectiveLimits, JointVector};
use pb3dp_servo::supervisor::{Action, Condition, ConditionSet, Policies};
use pb3dp_setup::setup::{Leader, Setup};

use crate::refusal::Refusal;

/// An arm as the page shows it.
#[derive(Clone, Debug)]
pub struct AboutArm {
    /// Name in messages: `vs-robot`.
    pub name: String,
    /// Kinematics.
    pub chain: Chain,
    /// Effective limits.
    pub limits: EffectiveLimits,
    /// Mechanical stops: smallest and largest angles, radians.
    pub mechanical_rad: [JointVector; 2],
    /// Limits of its gateway, as told when the run began; `None` without a gateway.
    pub gateway: Option<GatewayLimits>,
    /// Base pose.
    pub world_from_base: Pose<World, Base>,
    /// Pose of the tool: the hand of the camera arm, the target of the other one.
    pub flange_from_tool: Isometry3<f64>,
}

/// The camera arm as a carrier of the cameras.
#[derive(Clone, Debug)]
pub struct AboutHand {
    /// Mounting of the cameras.
    pub hand_from_cam_left: Pose<Hand, CamLeft>,
    /// Place of the hand.
    pub flange_from_hand: Pose<Flange, Hand>,
    /// Desired pose of the hand, without a jog.
    pub model_from_hand_desired: Pose<Model, Hand>,
}

/// All facts about the setup.
#[derive(Clone, Debug)]
pub struct About {
    /// Version of the program.
    pub version: String,
    /// Name of the setup.
    pub setup: String,
    /// Whether no arm outside of this program moves.
    pub is_emulated: bool,
    /// Whether the cameras are simulated.
    pub is_simulated: bool,
    /// Whether the method uses images.
    pub has_images: bool,
    /// The stereo pair, as calibrated.
    pub stereo: StereoRig,
    /// Whether the pair is calibrated; otherwise [`Self::stereo`] is a stand-in, and no target can be chosen.
    pub is_calibrated: bool,
    /// State of the calibration, in words.
    pub calibration: String,
    /// What the calibration files state about themselves.
    pub calibrations: Vec<CalibrationFacts>,
    /// The arms, the one with the cameras first; empty without arms.
    pub arms: Vec<AboutArm>,
    /// The hand; `None` without arms.
    pub hand: Option<AboutHand>,
    /// Parameters of the methods, for previews.
    pub estimator: EstimatorConfig,
    /// Search range, for previews.
    pub range: SearchRange,
    /// Errors of the calibration, for previews; `None` if they are not known.
    pub calibration_term: Option<CalibrationTerm>,
    /// Action of each condition; `None` without arms.
    pub policies: Option<Policies>,
}

impl About {
    /// The same with the limits that gateways have stated, by the names of their arms.
    #[must_use]
    pub fn with_gateways(mut self, stated: &[(&str, GatewayLimits)]) -> Self {
        for arm in &mut self.arms {
            arm.gateway = stated.iter().find(|(name, _)| *name == arm.name).map(|(_, limits)| *limits);
        }
        self
    }

    /// The facts of a setup.
    pub fn of_setup(setup: &Setup, name: &str, version: &str) -> Self {
        let rig = &setup.rig;
        let arm = |choice: ArmChoice| {
            let arm = choice.of(setup);
            AboutArm {
                name: choice.name().to_owned(),
                chain: arm.chain.clone(),
                limits: arm.limits,
                mechanical_rad: [arm.guard.mechanical_min_rad, arm.guard.mechanical_max_rad],
                gateway: None,
                world_from_base: arm.world_from_base,
                flange_from_tool: match choice {
                    ArmChoice::Vs => *setup.controller.flange_from_hand.isometry(),
                    ArmChoice::Tc => *rig.flange_from_target.isometry(),
                },
            }
        };
        Self {
            version: version.to_owned(),
            setup: name.to_owned(),
            is_emulated: setup.is_emulated(),
            is_simulated: setup.world.is_some(),
            has_images: matches!(setup.leader, Leader::Images(_)),
            stereo: rig.stereo,
            is_calibrated: true,
            calibration: calibration_text(setup),
            calibrations: rig
                .calibrations
                .iter()
                .map(|one| CalibrationFacts::of(one.table, &one.source, one.judgement.as_ref()))
                .collect(),
            arms: vec![arm(ArmChoice::Vs), arm(ArmChoice::Tc)],
            hand: Some(AboutHand {
                hand_from_cam_left: setup.controller.hand_from_cam_left,
                flange_from_hand: setup.controller.flange_from_hand,
                model_from_hand_desired: setup.controller.model_from_hand_desired,
            }),
            estimator: setup.estimator.clone(),
            range: setup.range,
            calibration_term: term_of_setup(setup),
            policies: Some(setup.supervisor.policies.clone()),
        }
    }

    /// Facts of cameras without arms.
    pub fn of_cameras(stereo: StereoRig, setup: &str, version: &str, range: SearchRange) -> Self {
        Self {
            version: version.to_owned(),
            setup: setup.to_owned(),
            is_emulated: false,
            is_simulated: false,
            has_images: true,
            stereo,
            is_calibrated: true,
            calibration: String::new(),
            calibrations: Vec::new(),
            arms: Vec::new(),
            hand: None,
            estimator: EstimatorConfig::default(),
            range,
            calibration_term: None,
            policies: None,
        }
    }

    /// Refuses what needs a calibration.
    ///
    /// # Errors
    /// If the cameras are not calibrated.
    pub fn check_calibrated(&self, what: &'static str) -> Result<(), Refusal> {
        let why = || "the cameras are not calibrated; calibrate them, then give --calib FILE or a setup".to_owned();
        if self.is_calibrated { Ok(()) } else { Err(Refusal::NotHere { what, why: why() }) }
    }

    /// Whether commands move arms.
    pub fn has_arms(&self) -> bool {
        !self.arms.is_empty()
    }

    /// Word for the action of a condition.
    pub fn action_of(&self, condition: Condition) -> &'static str {
        match self.policies.as_ref().map(|policies| policies.get(condition).action) {
            None | Some(Action::Note) => "note",
            Some(Action::Slow(_)) => "slow",
            Some(Action::Hold) => "hold",
            Some(Action::Stop) => "stop",
            Some(Action::Fault) => "fault",
        }
    }

    /// Names of the conditions of a set with their actions.
    pub fn inhibits(&self, found: ConditionSet) -> impl Iterator<Item = (Condition, &'static str)> + '_ {
        found.iter().map(|condition| (condition, self.action_of(condition)))
    }

    /// Pose of the left camera for the joints of the camera arm; `None` without arms.
    pub fn world_from_cam_left(&self, position_rad: &JointVector) -> Option<Pose<World, CamLeft>> {
        let (arm, hand) = (self.arms.first()?, self.hand.as_ref()?);
        Some(arm.world_from_base * arm.chain.forward(position_rad) * hand.flange_from_hand * hand.hand_from_cam_left)
    }
}

impl AboutArm {
    /// The fixed transform before each joint, then the one from the last joint to the flange; and the axis of each joint in its frame.
    pub fn links(&self) -> (Vec<Isometry3<f64>>, Vec<Vector3<f64>>) {
        let frames = self.chain.joint_frames(&JointVector::zeros());
        let joints = &frames.base_from_joint[..self.chain.joints()];
        let (mut transforms, mut before) = (Vec::new(), Isometry3::identity());
        for base_from_joint in joints {
            transforms.push(before.inverse() * base_from_joint);
            before = *base_from_joint;
        }
        transforms.push(before.inverse() * frames.base_from_flange.isometry());
        let axes = joints.iter().zip(&frames.axis_in_base);
        let axes = axes.map(|(base_from_joint, axis)| base_from_joint.rotation.inverse() * axis.into_inner());
        (transforms, axes.collect())
    }
}

/// State of the calibration in words.
fn calibration_text(setup: &Setup) -> String {
    match (&setup.rig.nominal_calibration, setup.rig.calibrations.is_empty()) {
        (Some(nominal), _) => format!("nominal, not measured: {nominal}"),
        (None, true) => "stated in the setup".to_owned(),
        (None, false) => setup
            .rig
            .calibrations
            .iter()
            .map(|one| format!("{}: {}", one.table, one.source))
            .collect::<Vec<_>>()
            .join("; "),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, UnitVector3};
    use pb3dp_setup::layers::SetupArgs;
    use pb3dp_setup::setup::read_layers;

    use super::*;

    #[test]
    fn the_links_of_an_arm_compose_to_its_kinematics() {
        let setup = read_layers(&SetupArgs { configs: vec!["sim".into()], ..SetupArgs::default() }).unwrap();
        let about = About::of_setup(&setup, "sim", "0");
        assert!(about.is_emulated && about.is_simulated && about.has_images);
        for arm in &about.arms {
            let position_rad = JointVector::from([0.3, -0.4, 0.5, 0.7, -0.2, 0.9, 1.1]);
            let (links, axes) = arm.links();
            let mut base_from_here = Isometry3::identity();
            for (joint, axis) in axes.iter().enumerate() {
                let turn = UnitQuaternion::from_axis_angle(&UnitVector3::new_normalize(*axis), position_rad[joint]);
                base_from_here = base_from_here * links[joint] * turn;
            }
            let base_from_flange = base_from_here * links[axes.len()];
            let difference = base_from_flange.inverse() * arm.chain.forward(&position_rad).isometry();
            assert!(difference.translation.vector.norm() < 1e-12 && difference.rotation.angle() < 1e-7, "{difference}");
        }
    }
}
