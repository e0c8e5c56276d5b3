//! The default workcell: both arms follow the experiment of Fig. 7 well away from singular poses and limits; other base poses and
//! motions are refused with the reason.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange, Hand, Model, Target, World};
use pb3dp_kinematics::{Chain, EffectiveLimits, JointVector, StatedLimits};
use pb3dp_sim::placement::{
    FlangePath, PathRefusal, PathReport, PathRequirements, ToolSpeed, ToolSpeedMax, check_experiment,
};
use pb3dp_sim::trajectory::{
    Channel, ExperimentAxes, Sine, SineConfig, StepExperiment, StepExperimentConfig, Trajectory,
};

/// Start angles of the arm with the cameras and of the arm with the target, rad: both flanges are 0.25 m above their bases and
/// point along the x axis of the base, 0.68 m and 0.66 m in front of it, elbow up.
const VS_START_RAD: [f64; 7] = [0.0, 0.792_674_858, 0.0, 1.701_517_843, 0.0, -0.923_396_375, 0.0];
const TC_START_RAD: [f64; 7] = [0.0, 0.766_062_566, 0.0, 1.757_789_259, 0.0, -0.953_055_499, 0.0];

fn chain() -> Chain {
    Chain::from_urdf_str(include_str!("../../../configs/robots/pa10_gen2.urdf"), "base_link", "flange").unwrap()
}

/// The operating range, degrees to either side.
const OPERATING_DEG: [f64; 7] = [170.0, 88.0, 168.0, 131.0, 249.0, 159.0, 249.0];

/// This share of the speeds, in a range of the same size to either side, with drives of sufficient acceleration for any motion.
fn stated(chain: &Chain, speed_scale: f64, operating_deg: [f64; 7]) -> StatedLimits {
    let max = JointVector::from(operating_deg).map(f64::to_radians);
    StatedLimits {
        servo: *chain.limits(),
        operating_min_rad: -max,
        operating_max_rad: max,
        speed_scale,
        acceleration_max_rad_per_s2: JointVector::from_element(1e6),
        jerk_max_rad_per_s3: JointVector::from_element(1e6),
    }
}

fn limits(chain: &Chain, speed_scale: f64) -> EffectiveLimits {
    stated(chain, speed_scale, OPERATING_DEG).effective().unwrap()
}

/// The two arms stand 2 m apart on tables of 0.7 m and face each other along the x axis of `world`.
fn world_from_vs_base() -> Pose<World, Base> {
    Pose::from_translation(Vector3::new(-1.0, 0.0, 0.7))
}

fn world_from_tc_base() -> Pose<World, Base> {
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
    Pose::from_parts(Vector3::new(1.0, 0.0, 0.7), turned)
}

/// Camera bracket: 60 mm in front of the flange; at a joint angle of 0 the flange's x axis points down, so a quarter turn makes
/// the hand's x axis point to the right.
fn flange_from_hand() -> Pose<Flange, Hand> {
    Pose::from_parts(Vector3::new(0.0, 0.0, 0.06), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -FRAC_PI_2))
}

/// The panel is 100 mm in front of the flange; the target's z axis points back into the arm, its y axis down.
fn flange_from_target() -> Pose<Flange, Target> {
    let axes = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    Pose::from_rotation_matrix(&axes, Vector3::new(0.0, 0.0, 0.1))
}

fn model_from_hand() -> Pose<Model, Hand> {
    Pose::from_translation(Vector3::new(0.0, 0.0, -0.5))
}

fn world_from_target(chain: &Chain) -> Pose<World, Target> {
    world_from_tc_base() * chain.forward(&TC_START_RAD.into()) * flange_from_target()
}

#[derive(Clone, Copy, Debug)]
enum CellArm {
    Vs,
    Tc,
}

fn check(arm: CellArm, trajectory: &dyn Trajectory, speed_scale: f64) -> Result<PathReport, PathRefusal> {
    check_for(arm, trajectory, &limits(&chain(), speed_scale), &PathRequirements::OF_EXPERIMENT)
}

fn check_for(
    arm: CellArm,
    trajectory: &dyn Trajectory,
    limits: &EffectiveLimits,
    requirements: &PathRequirements,
) -> Result<PathReport, PathRefusal> {
    let chain = chain();
    let (path, start) = match arm {
        CellArm::Tc => (FlangePath::of_carrier(trajectory, &world_from_tc_base(), &flange_from_target()), TC_START_RAD),
        CellArm::Vs => {
            let base = world_from_vs_base();
            let on_target = Pose::<Target, Model>::coincident();
            let path = FlangePath::of_follower(trajectory, &base, &on_target, &model_from_hand(), &flange_from_hand());
            (path, VS_START_RAD)
        }
    };
    check_experiment(&chain, limits, &start.into(), &path, requirements)
}

fn steps(config: StepExperimentConfig) -> StepExperiment {
    StepExperiment::new(config, world_from_target(&chain())).unwrap()
}

fn sine(channel: Channel, period_s: f64) -> Sine {
    let amplitude = if channel.is_rotation() { 20f64.to_radians() } else { 0.1 };
    let axes = ExperimentAxes::TargetAtStart;
    let config = SineConfig { channel, amplitude, period_s, periods: 3, lead_in_s: 0.0, axes };
    Sine::new(config, world_from_target(&chain())).unwrap()
}

#[test]
fn the_default_cell_starts_with_the_hand_500_mm_before_the_target_axes_parallel() {
    let chain = chain();
    let world_from_hand = world_from_vs_base() * chain.forward(&VS_START_RAD.into()) * flange_from_hand();
    let hand_from_target = world_from_hand.inverse() * world_from_target(&chain);
    assert!((hand_from_target.translation_m() - Vector3::new(0.0, 0.0, 0.5)).norm() < 1e-8, "{hand_from_target:?}");
    assert!(hand_from_target.rotation_angle_rad() < 1e-8, "{hand_from_target:?}");
    // The cameras point along world x, their right is world -y, their down is world -z.
    let axes = world_from_hand.rotation_matrix();
    let expected = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    assert!((axes - expected).norm() < 1e-8, "{axes}");
}

#[test]
fn both_arms_stay_away_from_singular_poses_and_limits_in_either_direction() {
    for (arm, singular_value, speed_ratio) in [(CellArm::Vs, 0.13, 0.75), (CellArm::Tc, 0.20, 0.45)] {
        for sign in [1.0, -1.0] {
            for axes in [ExperimentAxes::World, ExperimentAxes::TargetAtStart] {
                let (translation_m, rotation_rad) = (0.1 * sign, 20f64.to_radians() * sign);
                let config = StepExperimentConfig { translation_m, rotation_rad, axes, ..Default::default() };
                let report = check(arm, &steps(config), 0.6).unwrap();
                assert!(report.singular_value_min.value > singular_value, "{arm:?} {sign} {axes:?}: {report:#?}");
                assert!(report.fastest_joint().1.value < speed_ratio, "{arm:?} {sign} {axes:?}: {report:#?}");
                assert!(report.tightest_joint().1.value > 15f64.to_radians(), "{arm:?} {sign} {axes:?}: {report:#?}");
                assert!(report.position_error_max_m.value < 1e-6, "{arm:?} {sign} {axes:?}: {report:#?}");
                // Accelerations allowed by a careful driver: 2 rad/s^2 at shoulder and elbow, 5 at the wrist.
                for (joint, peak) in report.acceleration_max_rad_per_s2.iter().enumerate() {
                    assert!(peak.value < if joint < 4 { 2.0 } else { 5.0 }, "{arm:?} joint {joint}: {peak:?}");
                }
            }
        }
    }
}

#[test]
fn a_report_agrees_with_the_chain_itself() {
    // The end pose is on the path, and the speeds match the differences of neighbouring solutions.
    let chain = chain();
    let one = |step_s: f64| {
        let experiment = steps(StepExperimentConfig { channels: vec![Channel::Rx], ..Default::default() });
        let path = FlangePath::of_carrier(&experiment, &world_from_tc_base(), &flange_from_target());
        let requirements = PathRequirements { step_s, ..PathRequirements::OF_EXPERIMENT };
        check_experiment(&chain, &limits(&chain, 0.6), &TC_START_RAD.into(), &path, &requirements).unwrap()
    };
    let (coarse, fine) = (one(0.02), one(0.001));
    for (a, b) in coarse.speed_ratio_max.iter().zip(&fine.speed_ratio_max) {
        assert!((a.value - b.value).abs() < 1e-3, "{a:?} {b:?}");
    }
    let returned = chain.forward(&fine.end_rad).inverse() * chain.forward(&TC_START_RAD.into());
    assert!(returned.translation_m().norm() < 1e-6 && returned.rotation_angle_rad() < 1e-6, "{returned:?}");
    assert!((fine.begin_rad - JointVector::from(TC_START_RAD)).amax() < 1e-6);
}

#[test]
fn a_speed_scale_that_is_too_low_is_refused_by_joint_and_ratio() {
    let experiment = steps(StepExperimentConfig::default());
    let (joint, fastest) = check(CellArm::Vs, &experiment, 0.6).unwrap().fastest_joint();
    let refusal = check(CellArm::Vs, &experiment, 0.1).unwrap_err();
    let message = refusal.to_string();
    let PathRefusal::TooFast { joint: named, ratio, needed_rad_per_s, allowed_rad_per_s, .. } = refusal else {
        panic!("{message}")
    };
    assert_eq!((named, allowed_rad_per_s), (joint, 0.1));
    assert!((ratio - 6.0 * fastest.value).abs() < 1e-9, "{message}");
    assert!((needed_rad_per_s - ratio * 0.1).abs() < 1e-12);
    assert!(message.contains("axis 2") && message.contains("times too fast"), "{message}");
    assert!(check(CellArm::Vs, &experiment, 0.1 * ratio * 1.0001).is_ok());
}

/// Moves of `move_s` along (100 mm) and about (20 degrees) one axis.
fn one_axis(channel: Channel, move_s: f64) -> StepExperiment {
    steps(StepExperimentConfig { channels: vec![channel], move_s, ..Default::default() })
}

#[test]
fn a_change_of_speed_that_the_drives_do_not_allow_is_refused_by_joint_and_ratio() {
    // At the full joint speeds the moves may take 1 s; the accelerations are four times those of 2 s.
    let free = check(CellArm::Vs, &one_axis(Channel::Rx, 1.0), 1.0).unwrap();
    let slow = check(CellArm::Vs, &one_axis(Channel::Rx, 2.0), 1.0).unwrap();
    let peak = free.acceleration_max_rad_per_s2[1];
    assert!((peak.value / slow.acceleration_max_rad_per_s2[1].value - 4.0).abs() < 0.1, "{free:#?} {slow:#?}");

    let mut most = JointVector::from_element(100.0);
    most[1] = 0.8 * peak.value;
    let strong = stated(&chain(), 1.0, OPERATING_DEG);
    let limited = StatedLimits { acceleration_max_rad_per_s2: most, ..strong }.effective().unwrap();
    let check = |move_s: f64| {
        check_for(CellArm::Vs, &one_axis(Channel::Rx, move_s), &limited, &PathRequirements::OF_EXPERIMENT)
    };
    let refusal = check(1.0).unwrap_err();
    let message = refusal.to_string();
    let PathRefusal::TooAbrupt { joint, at_s, needed_rad_per_s2, allowed_rad_per_s2, ratio } = refusal else {
        panic!("{message}")
    };
    assert_eq!((joint, at_s, needed_rad_per_s2, allowed_rad_per_s2), (1, peak.at_s, peak.value, most[1]));
    assert!((ratio - 1.25).abs() < 1e-12, "{message}");
    assert!(message.contains("1.25 times too much") && message.contains("1.12-fold"), "{message}");
    // The advice of the message works.
    assert!(check(1.13).is_ok());
}

#[test]
fn a_tool_that_would_be_too_fast_is_refused_by_quantity_and_ratio() {
    // The speed of a smooth move is at most 15/8 of its mean; rotating the target swings the hand about it at 500 mm.
    let most_joints = limits(&chain(), 0.6);
    let angular = 15.0 / 8.0 * 20f64.to_radians() / 2.0;
    let most = |linear_m_per_s, angular_rad_per_s| PathRequirements {
        tool_speed_max: Some(ToolSpeedMax { linear_m_per_s, angular_rad_per_s }),
        ..PathRequirements::OF_EXPERIMENT
    };
    let cases = [
        (Channel::Rx, most(0.8 * angular * 0.5, 10.0), ToolSpeed::Linear, angular * 0.5, "m/s"),
        (Channel::Rx, most(10.0, 0.8 * angular), ToolSpeed::Angular, angular, "rad/s"),
        (Channel::Y, most(0.075, 10.0), ToolSpeed::Linear, 0.09375, "m/s"),
    ];
    for (channel, requirements, expected, speed, unit) in cases {
        let refusal = check_for(CellArm::Vs, &one_axis(channel, 2.0), &most_joints, &requirements).unwrap_err();
        let message = refusal.to_string();
        let PathRefusal::ToolTooFast { quantity, at_s, needed, allowed, ratio } = refusal else { panic!("{message}") };
        assert_eq!(quantity, expected, "{message}");
        assert!((needed - speed).abs() < 1e-6 && (allowed - 0.8 * speed).abs() < 1e-12, "{message}");
        assert!((ratio - 1.25).abs() < 1e-4 && at_s > 3.0, "{message}");
        assert!(message.contains(unit) && message.contains("1.25 times too fast"), "{message}");
        // The advised duration is sufficient, and the arm that carries the target does not swing with it.
        assert!(check_for(CellArm::Vs, &one_axis(channel, 2.51), &most_joints, &requirements).is_ok());
    }
    let carrier = check_for(CellArm::Tc, &one_axis(Channel::Rx, 2.0), &most_joints, &most(0.01, 1.0)).unwrap();
    assert!(carrier.tool_linear_max_m_per_s.value < 1e-9, "{carrier:?}");
    assert!((carrier.tool_angular_max_rad_per_s.value - angular).abs() < 1e-6, "{carrier:?}");
    for bad in [most(0.0, 1.0), most(1.0, f64::NAN)] {
        let refusal = check_for(CellArm::Vs, &one_axis(Channel::Rx, 2.0), &most_joints, &bad).unwrap_err();
        assert!(matches!(refusal, PathRefusal::Requirement { .. }), "{refusal}");
    }
}

#[test]
fn sinusoids_are_followed_down_to_the_period_that_shoulder_and_forearm_allow() {
    for channel in Channel::ALL {
        assert!(check(CellArm::Vs, &sine(channel, 5.0), 0.6).is_ok(), "{channel:?}");
        assert!(check(CellArm::Tc, &sine(channel, 3.0), 0.6).is_ok(), "{channel:?}");
    }
    for (channel, expected) in [(Channel::Rx, 1), (Channel::Ry, 4)] {
        let refusal = check(CellArm::Vs, &sine(channel, 3.0), 0.6).unwrap_err();
        assert!(matches!(refusal, PathRefusal::TooFast { joint, .. } if joint == expected), "{channel:?}: {refusal}");
    }
}

/// A step experiment around the target pose that the TC-arm has with these joint angles.
fn refused_from(start_deg: [f64; 7], config: StepExperimentConfig, max_deg: [f64; 7]) -> PathRefusal {
    let chain = chain();
    let start = JointVector::from(start_deg).map(f64::to_radians);
    let target = world_from_tc_base() * chain.forward(&start) * flange_from_target();
    let experiment = StepExperiment::new(config, target).unwrap();
    let path = FlangePath::of_carrier(&experiment, &world_from_tc_base(), &flange_from_target());
    let limits = stated(&chain, 0.6, max_deg).effective().unwrap();
    check_experiment(&chain, &limits, &start, &path, &PathRequirements::OF_EXPERIMENT).unwrap_err()
}

#[test]
fn the_zero_pose_and_the_usual_home_are_refused() {
    let refusal = refused_from([0.0; 7], StepExperimentConfig::default(), OPERATING_DEG);
    assert!(matches!(refusal, PathRefusal::Singular { at_s: 0.0, value, .. } if value < 1e-9), "{refusal}");
    // From home, 20 degrees of the hand about y exceed the reach: the hand is 500 mm in front of the target.
    let home = JointVector::from([45.0, 30.0, 0.0, 60.0, 0.0, 45.0, 0.0]).map(f64::to_radians);
    let chain = chain();
    let world_from_hand = world_from_vs_base() * chain.forward(&home) * flange_from_hand();
    let target = world_from_hand * Pose::<Hand, Target>::from_translation(Vector3::new(0.0, 0.0, 0.5));
    let mut refusals = Vec::new();
    for sign in [1.0, -1.0] {
        let rotation_rad = sign * 20f64.to_radians();
        let channels = vec![Channel::Ry, Channel::Rx];
        let config = StepExperimentConfig { channels, rotation_rad, ..Default::default() };
        let experiment = StepExperiment::new(config, target).unwrap();
        let base = world_from_vs_base();
        let on_target = Pose::<Target, Model>::coincident();
        let path = FlangePath::of_follower(&experiment, &base, &on_target, &model_from_hand(), &flange_from_hand());
        let requirements = PathRequirements::OF_EXPERIMENT;
        refusals.extend(check_experiment(&chain, &limits(&chain, 0.6), &home, &path, &requirements).err());
    }
    assert!(!refusals.is_empty());
    for refusal in refusals {
        assert!(matches!(refusal, PathRefusal::Singular { .. } | PathRefusal::OutOfReach { .. }), "{refusal}");
    }
}

#[test]
fn reach_range_and_requirements_are_refused_by_name() {
    let start_deg = JointVector::from(TC_START_RAD).map(f64::to_degrees).into();
    let far = StepExperimentConfig { translation_m: -0.9, channels: vec![Channel::Y], ..Default::default() };
    let refusal = refused_from(start_deg, far, OPERATING_DEG);
    assert!(matches!(refusal, PathRefusal::Singular { .. } | PathRefusal::OutOfReach { .. }), "{refusal}");
    let mut narrow_deg = OPERATING_DEG;
    narrow_deg[3] = 105.0;
    let refusal = refused_from(start_deg, StepExperimentConfig::default(), narrow_deg);
    let message = refusal.to_string();
    assert!(matches!(refusal, PathRefusal::JointRange { joint: 3, at_s, .. } if at_s > 3.0), "{message}");
    assert!(message.contains("deg too far"), "{message}");
    let coarse = PathRequirements { step_s: 0.2, ..PathRequirements::OF_EXPERIMENT };
    let experiment = steps(StepExperimentConfig::default());
    let refusal = check_for(CellArm::Tc, &experiment, &limits(&chain(), 0.6), &coarse).unwrap_err();
    assert!(matches!(refusal, PathRefusal::Requirement { key: "step_s", .. }), "{refusal}");
}

#[test]
fn a_path_that_begins_elsewhere_is_reached_first_or_refused() {
    let chain = chain();
    let experiment = steps(StepExperimentConfig::default());
    let path = FlangePath::of_carrier(&experiment, &world_from_tc_base(), &flange_from_target());
    let requirements = PathRequirements::OF_EXPERIMENT;
    let elsewhere = JointVector::from([0.2, 0.5, -0.1, 1.4, 0.3, -0.7, 0.2]);
    let report = check_experiment(&chain, &limits(&chain, 0.6), &elsewhere, &path, &requirements).unwrap();
    let off = chain.forward(&report.begin_rad).inverse() * path.base_from_flange_at(0.0);
    assert!(off.translation_m().norm() < 1e-8 && off.rotation_angle_rad() < 1e-8, "{off:?}");
    let nowhere = JointVector::from_element(f64::NAN);
    let refusal = check_experiment(&chain, &limits(&chain, 0.6), &nowhere, &path, &requirements).unwrap_err();
    assert!(matches!(refusal, PathRefusal::BeginUnreachable { .. }), "{refusal}");
}

#[test]
fn the_twist_of_a_flange_path_is_the_derivative_of_its_pose() {
    let experiment = steps(StepExperimentConfig { lead_in_s: 0.0, hold_s: 0.0, ..Default::default() });
    let base =
        Pose::from_parts(Vector3::new(0.3, -0.7, 0.4), UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.5, 1.3)));
    let on_target = Pose::<Target, Model>::from_parts(
        Vector3::new(0.03, -0.02, 0.05),
        UnitQuaternion::from_scaled_axis(Vector3::new(-0.4, 0.1, 0.2)),
    );
    let path = FlangePath::of_follower(&experiment, &base, &on_target, &model_from_hand(), &flange_from_hand());
    let h = 1e-4;
    for t in (0..48).map(|i| 0.13 + 0.5 * f64::from(i)) {
        let (a, b) = (path.base_from_flange_at(t - h), path.base_from_flange_at(t + h));
        let linear = (b.translation_m() - a.translation_m()) / (2.0 * h);
        let angular = (b.rotation() * a.rotation().inverse()).scaled_axis() / (2.0 * h);
        let twist = path.twist_at(t);
        assert!((twist.linear_m_per_s - linear).norm() < 1e-6, "at {t} s: {twist:?}");
        assert!((twist.angular_rad_per_s - angular).norm() < 1e-6, "at {t} s: {twist:?}");
    }
}
