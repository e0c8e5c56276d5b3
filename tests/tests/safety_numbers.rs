//! The numbers that the safety invariants restate equal those of the product: arm, shape, limits.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use nalgebra::Vector3;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_geometry::Pose;
use pb3dp_kinematics::clearance::{PlacedArm, clearance};
use pb3dp_kinematics::{Chain, JointVector};
use pb3dp_setup::setup::{ArmSetup, Setup, read_setup};
use system_tests::repository;
use system_tests::safety::pa10::{FIRST_GENERATION_M, SECOND_GENERATION_M, links};
use system_tests::safety::rules::{ArmRules, Rules};
use system_tests::safety::shape::room_m;
use system_tests::safety::truth::Joints;

fn setup() -> Setup {
    read_setup(&repository().join("configs/sim.toml")).unwrap()
}

/// Joints from the whole of their ranges; the same ones each time.
fn many_joints(count: usize) -> impl Iterator<Item = Joints> {
    let mut random = SplitMix64::new(11);
    let operating_rad = Rules::of_the_rig().arms[0].operating_rad;
    (0..count).map(move |_| operating_rad.map(|end| random.between(-end, end)))
}

#[test]
fn two_ways_to_write_the_arm_down_give_the_same_flange() {
    for (file, lengths) in [("pa10_gen2", &SECOND_GENERATION_M), ("pa10_gen1", &FIRST_GENERATION_M)] {
        let urdf = std::fs::read_to_string(repository().join(format!("configs/robots/{file}.urdf"))).unwrap();
        let chain = Chain::from_urdf_str(&urdf, "base_link", "flange").unwrap();
        for q_rad in many_joints(200) {
            let (ours, theirs) = (links(lengths, &q_rad).flange, chain.forward(&JointVector::from(q_rad)));
            let theirs = theirs.isometry().to_homogeneous();
            for row in 0..3 {
                assert!((ours.translation_m[row] - theirs[(row, 3)]).abs() < 1e-9, "{file} {q_rad:?}");
                for column in 0..3 {
                    assert!((ours.rotation[row][column] - theirs[(row, column)]).abs() < 1e-9, "{file} {q_rad:?}");
                }
            }
        }
    }
}

#[test]
fn two_ways_to_compute_room_between_arms_agree() {
    let (mut setup, mut rules) = (setup(), Rules::of_the_rig());
    // Closer than in the workcell, so that some overlap.
    for (arm, x_m) in [-0.4, 0.4].into_iter().enumerate() {
        rules.arms[arm].body.base.translation_m[0] = x_m;
        let base =
            if arm == 0 { &mut setup.rig.arms.vs.world_from_base } else { &mut setup.rig.arms.tc.world_from_base };
        *base = Pose::from_parts(Vector3::new(x_m, 0.0, 0.7), base.rotation());
    }
    let (mut first, mut second) = (Vec::new(), Vec::new());
    let mut overlaps = 0;
    let mut joints = many_joints(2000);
    while let (Some(vs_rad), Some(tc_rad)) = (joints.next(), joints.next()) {
        rules.arms[0].body.place(&vs_rad, &mut first);
        rules.arms[1].body.place(&tc_rad, &mut second);
        let ours_m = room_m(&first, &second);
        let frames = [(&setup.rig.arms.vs, vs_rad), (&setup.rig.arms.tc, tc_rad)]
            .map(|(arm, q_rad)| arm.chain.joint_frames(&JointVector::from(q_rad)));
        let placed = [&setup.rig.arms.vs, &setup.rig.arms.tc].map(|arm| (&arm.shape, &arm.world_from_base));
        let [vs, tc] =
            [0, 1].map(|i| PlacedArm { shape: placed[i].0, world_from_base: placed[i].1, frames: &frames[i] });
        let theirs_m = clearance(&vs, &tc).distance_m;
        assert!((ours_m - theirs_m).abs() < 1e-9, "{ours_m} {theirs_m} at {vs_rad:?} {tc_rad:?}");
        overlaps += u32::from(ours_m < 0.0);
    }
    assert!(overlaps > 3, "arms that overlap are among them: {overlaps}");
}

/// A setup that exceeds the rules must be detected.
#[test]
fn the_setup_of_the_cell_keeps_to_the_rules() {
    let (setup, rules) = (setup(), Rules::of_the_rig());
    for (name, arm, rules) in
        [("vs-robot", &setup.rig.arms.vs, &rules.arms[0]), ("tc-robot", &setup.rig.arms.tc, &rules.arms[1])]
    {
        keeps_to(name, arm, rules);
    }
    assert!((setup.control_period.as_secs_f64() - rules.cycle_s).abs() < 1e-12);
    assert!(setup.controller.timeouts.observation_s + rules.cycle_s <= rules.pose_age_max_s + 1e-12);
}

fn keeps_to(name: &str, arm: &ArmSetup, rules: &ArmRules) {
    let (limits, operating) = (&arm.limits, arm.limits.operating());
    for joint in 0..7 {
        let what = format!("{name}, axis {}", joint + 1);
        let range = operating.position_max_rad()[joint].max(-operating.position_min_rad()[joint]);
        assert!(range <= rules.operating_rad[joint] + 1e-9, "{what}: {range}");
        let speed = limits.velocity_max_rad_per_s()[joint];
        assert!(speed <= rules.speed_rad_per_s[joint] + 1e-6, "{what}: {speed}");
        let acceleration = limits.acceleration_max_rad_per_s2()[joint];
        assert!(acceleration <= rules.acceleration_rad_per_s2[joint] + 1e-9, "{what}: {acceleration}");
        let jerk = limits.jerk_max_rad_per_s3()[joint];
        assert!((jerk - rules.jerk_rad_per_s3[joint]).abs() < 1e-9, "{what}: {jerk}");
    }
}
