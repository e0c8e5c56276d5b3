//! An arm with six axes, selected by one line of the setup, carries the cameras through the experiment of Fig. 7.

use pb3dp_cell::summary::{RunSummary, summarize};
use pb3dp_hal_api::{ArmErrorKind, JointCommand};
use pb3dp_kinematics::{DOF, JointVector};
use pb3dp_setup::setup::{ArmLink, Leader, Setup};
use pb3dp_sim::geometric::{GeometricConfig, PoseSigma};
use pb3dp_wiring::wire;

use crate::closed_loop::geometric::QUIET;
use crate::closed_loop::support::*;

/// Approximate noise of the direct method on the crab.
const NOISY: GeometricConfig = GeometricConfig {
    noise: PoseSigma { lateral_m: 2e-5, depth_m: 1e-4, tilt_rad: 1e-3, about_normal_rad: 3e-4 },
    ..QUIET
};

fn six_axes() -> Setup {
    changed_setup(&[("# carries_cameras = \"ur5e\"", "carries_cameras = \"ur5e\"")])
}

fn summary(setup: Setup) -> RunSummary {
    let setup = Setup { leader: Leader::Geometric(NOISY), compared: Vec::new(), ..setup };
    let outcome = run(&setup, None);
    summarize(&outcome.log, &outcome.plan)
}

#[test]
fn it_follows_as_well_as_the_arm_with_seven() {
    let (seven, six) = (summary(changed_setup(&[])), summary(six_axes()));
    assert_eq!((six.frames_without_pose, six.channels.len()), (0, 6), "no loss");
    for (six, seven) in six.channels.iter().zip(&seven.channels) {
        let [six_rms, seven_rms] = [six, seven].map(|channel| channel.moving.unwrap().rms);
        let what = format!("{} {}: {six_rms:.3} with six axes, {seven_rms:.3} with seven", six.channel, six.unit);
        println!("{what}");
        assert!(six_rms <= 1.5 * seven_rms, "{what}");
    }
}

#[test]
fn it_starts_well_away_from_its_singular_poses() {
    let arm = six_axes().rig.arms.vs;
    assert_eq!((arm.key.as_str(), arm.chain.joints(), arm.chain.elbow()), ("arms.ur5e", 6, None));
    let start_deg = arm.start_rad.map(f64::to_degrees);
    // Stretched or folded at the elbow, and with parallel outer axes of the wrist.
    let from_stretched_deg = start_deg[2].abs().min(180.0 - start_deg[2].abs());
    let from_parallel_deg = start_deg[4].abs().min(180.0 - start_deg[4].abs());
    assert!(from_stretched_deg > 15.0 && from_parallel_deg > 15.0, "{start_deg}");
    // At the shoulder: with the wrist above the first axis. Fifteen degrees at half a metre are 134 mm.
    let wrist = arm.chain.joint_frames(&arm.start_rad).base_from_joint[4].translation.vector;
    assert!(wrist.xy().norm() > 0.134, "{wrist}");
}

#[test]
fn its_own_limits_hold_and_its_joints_have_names() {
    let setup = six_axes();
    assert_eq!(setup.rig.arms.vs.link, ArmLink::InProcess);
    assert_eq!(setup.rig.arms.vs.axis_name(5), "axis 6 (WRIST_3)");
    let allowed = JointVector::from([0.6 * std::f64::consts::PI; DOF]);
    for joint in 0..6 {
        assert!((setup.rig.arms.vs.limits.velocity_max_rad_per_s()[joint] - allowed[joint]).abs() < 1e-12, "{joint}");
    }
    let mut parts = wire(&setup).unwrap();
    parts.vs.enable().unwrap();
    parts.tc.enable().unwrap();
    parts.vs.exchange(JointCommand::Hold).unwrap();
    parts.tc.exchange(JointCommand::Hold).unwrap();
    let mut desired = JointVector::zeros();
    desired[5] = 100.0;
    let mut fastest: f64 = 0.0;
    for _ in 0..200 {
        parts.clock.sleep_until(parts.clock.now() + setup.control_period);
        parts.tc.exchange(JointCommand::Hold).unwrap();
        fastest = fastest.max(parts.vs.exchange(JointCommand::Velocity(desired)).unwrap().velocity_rad_per_s[5]);
    }
    assert!((0.98 * allowed[5]..=allowed[5] * (1.0 + 1e-6)).contains(&fastest), "{fastest} of {}", allowed[5]);
    let nowhere = parts.vs.exchange(JointCommand::Velocity(desired * f64::NAN)).unwrap_err();
    assert_eq!(nowhere.kind(), ArmErrorKind::Rejected);
}

#[test]
fn numbers_for_another_count_of_joints_and_arms_that_are_not_there_are_refused() {
    let configs = system_tests::repository().join("configs").canonicalize().unwrap();
    let setup = std::fs::read_to_string(configs.join("sim.toml")).unwrap();
    let arm = std::fs::read_to_string(configs.join("arms/ur5e.toml")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(configs.join("robots"), dir.path().join("robots")).unwrap();
    std::fs::create_dir(dir.path().join("arms")).unwrap();
    let refused = |named: &str, from: &str, to: &str| {
        assert!(
            setup.contains("# carries_cameras = \"ur5e\"") && (arm.contains(from) || setup.contains(from)),
            "{from}"
        );
        let setup = setup.replace("# carries_cameras = \"ur5e\"", &format!("carries_cameras = {named:?}"));
        std::fs::write(dir.path().join("setup.toml"), setup.replace(from, to)).unwrap();
        std::fs::write(dir.path().join("arms/ur5e.toml"), arm.replace(from, to)).unwrap();
        pb3dp_setup::setup::read_setup(&dir.path().join("setup.toml")).unwrap_err().to_string()
    };
    let message = refused("ur5e", "89.54969538, 90.0]", "89.54969538]");
    assert!(message.contains("arms.ur5e.start_deg: 5 numbers, but arms.ur5e.robot has 6 joints"), "{message}");
    let message = refused("ur10", "", "");
    assert!(
        message.contains("arms.ur10: missing") && message.contains("arms/ur10.toml") && message.contains("tc, vs"),
        "{message}"
    );
    let message = refused("ur5e", "on = \"joint 3\"", "on = \"joint 6\"");
    assert!(
        message.contains("arms.ur5e.parts[3].on = \"joint 6\": arms.ur5e.robot has joint 0 to joint 5"),
        "{message}"
    );
    let message = refused("ur5.e", "", "");
    assert!(message.contains("arms/ur5.e.toml"), "a name may hold a dot: {message}");
    let message = refused("tc", "", "");
    assert!(message.contains("arms.carries_target is the same"), "{message}");
    let message = refused("ur5e", "least_room_mm = 50.0", "least_room_mn = 50.0");
    assert!(message.contains("arms.least_room_mn: unknown key"), "{message}");
    let gateway = "backend = \"emulated\"\ngateway = { arm = 1, wire_format = \"B\", geometry = \"unknown\" }\nrobot = \"../robots/ur5e";
    let message = refused("ur5e", "backend = \"mock\"\nrobot = \"../robots/ur5e", gateway);
    assert!(message.contains("has 6 joints; a PA-10, which is what arms.ur5e.backend drives, has 7"), "{message}");
    let message = refused("ur5e", "base_link = \"base_link\"", "base_lnk = \"base_link\"");
    assert!(message.contains("base_lnk: unknown key"), "{message}");
}
