//! Through and along singular poses (S-R-S arms: q2 = q6 = 0, and a stretched elbow): the hand neither stops nor shakes there,
//! and a stretched arm returns.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use crate::common::{Cell, Plant, feed_forward, feed_forward_config};
use nalgebra::Vector3;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Model};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::{ArmResponse, Command, HoldReason, Limitation, Mode, RedundancyConfig};

const PLANT: Plant = Plant { delay_steps: 5, lag_s: 0.03 };
const ARM: ArmResponse = ArmResponse { delay_s: 0.01, lag_s: 0.03 };

fn cell(start_rad: [f64; 7], redundancy: RedundancyConfig) -> Cell {
    let mut law = feed_forward(ARM);
    law.redundancy = redundancy;
    let mut config = feed_forward_config(law);
    config.speed.limit_approach_per_s = 2.0;
    config.speed.soft_start_s = 0.3;
    let mut cell = Cell::at_speed_scale(0.6, config, PLANT, 0.05);
    cell.joints.position_rad = JointVector::from(start_rad);
    cell
}

fn desired_for(cell: &Cell, hand_joints: &JointVector) -> Pose<Base, Model> {
    let hand = cell.chain.forward(hand_joints) * cell.config.flange_from_hand;
    hand * cell.config.model_from_hand_desired.inverse()
}

/// 0 to 1 with zero speed and acceleration at both ends.
fn smooth(share: f64) -> f64 {
    let x = share.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

/// Shoulder and wrist pass zero simultaneously, exactly or nearly, with the elbow bent; each path takes 4 s.
#[test]
fn a_motion_that_crosses_a_singular_pose_neither_halts_nor_shakes() {
    for (aside, sideways_m) in [(0.0, 0.0), (0.01, 0.0), (0.05, 0.0), (0.0, 0.03)] {
        for redundancy in
            [RedundancyConfig::default(), RedundancyConfig { speed_max_rad_per_s: 0.0, gain_rad_per_s: 0.0 }]
        {
            let begin = [0.2, 0.3, aside, 1.2, 0.3, -0.3, 0.1];
            let mut cell = cell(begin, redundancy);
            let way =
                |share: f64| JointVector::from([0.2, 0.3 - 0.6 * share, aside, 1.2, 0.3, -0.3 + 0.6 * share, 0.1]);
            let (mut least, mut turns, mut last) = (f64::MAX, 0, JointVector::zeros());
            let (mut worst, mut end) = (0.0f64, (0.0, 0.0));
            while cell.time_s < 12.0 {
                let share = smooth((cell.time_s - 6.0) / 4.0);
                let mut target = desired_for(&cell, &way(share));
                let sideways = Vector3::new(0.0, sideways_m, 0.0) * (4.0 * share * (1.0 - share));
                target = Pose::from_parts(target.translation_m() + sideways, target.rotation());
                let step = cell.step(&target);
                let case = format!("{aside} {sideways_m} {redundancy:?} at {} s: {step:?}", cell.time_s - 5.0);
                if cell.time_s > 5.5 {
                    let Command::Velocity(velocity) = step.command else { panic!("stopped, {case}") };
                    let change = velocity - last;
                    assert!(change.amax() < 0.3, "jumps by {}, {case}", change.amax());
                    turns += (0..7).filter(|&i| velocity[i] * last[i] < 0.0 && change[i].abs() > 0.01).count();
                    last = velocity;
                    least = least.min(step.smallest_singular_value.unwrap());
                }
                let desired = target * cell.config.model_from_hand_desired;
                let hand = cell.base_from_hand();
                end = (
                    (desired.translation_m() - hand.translation_m()).norm(),
                    desired.rotation().angle_to(&hand.rotation()),
                );
                worst = worst.max(end.0);
            }
            let case = format!("{aside} {sideways_m} {redundancy:?}");
            assert!(least < 0.03, "{case}: no singular pose was passed: {least}");
            assert!(turns < 30, "{case}: {turns} changes of direction");
            // The error in the singular direction is corrected after the singular pose.
            let most = if sideways_m > 0.0 { 0.12 } else { 0.04 };
            assert!(worst < most && end.0 < 1e-3 && end.1 < 3e-3, "{case}: at most {worst} m, final error {end:?}");
        }
    }
}

/// A target that moves 150 mm beyond the reach of the arm and returns.
#[test]
fn an_arm_that_was_pulled_straight_stops_with_the_reason_and_comes_back_at_once() {
    for bent in [0.8, -0.8] {
        let mut cell = cell([0.3, 0.9, 0.2, bent, -0.3, 0.7, 0.4], RedundancyConfig::default());
        let home = desired_for(&cell, &cell.joints.position_rad);
        let shoulder = Vector3::new(0.0, 0.0, 0.317);
        let outwards = (cell.base_from_hand().translation_m() - shoulder).normalize();
        let (mut straightest, mut stopped_at, mut elbow_limited) = (f64::MAX, None, false);
        let mut back_at = None;
        while cell.time_s < 20.0 {
            let t = cell.time_s - 6.0;
            let by = 0.25 * (smooth(t / 4.0) - smooth((t - 7.0) / 4.0));
            let target = Pose::from_parts(home.translation_m() + outwards * by, home.rotation());
            let step = cell.step(&target);
            straightest = straightest.min(cell.joints.position_rad[3].abs());
            assert!(cell.joints.position_rad[3] * bent > 0.0, "the elbow changed its side");
            assert!(cell.joints.velocity_rad_per_s.amax() < 2.0, "{step:?}");
            elbow_limited |= step.limited_by == Some(Limitation::ElbowStretched)
                || step.mode == Mode::Holding(HoldReason::ElbowStretched);
            if (4.5..6.9).contains(&t) {
                let speed = cell.joints.velocity_rad_per_s.amax();
                assert!(speed < 0.05, "the arm moves while the target is out of reach: {speed} at {t}");
                assert!(step.position_error_m.is_some_and(|error| error > 0.02), "{step:?}");
                stopped_at.get_or_insert(t);
            }
            let off =
                (target * cell.config.model_from_hand_desired).translation_m() - cell.base_from_hand().translation_m();
            if t > 7.0 && off.norm() < 0.002 {
                back_at.get_or_insert((t, by));
            }
        }
        assert!(elbow_limited && stopped_at.is_some());
        assert!(straightest > 0.08, "the elbow is closer to straight than 5 degrees: {straightest}");
        let (at_s, by_m) = back_at.expect("the hand did not return");
        assert!(by_m > 0.02 && at_s < 10.8, "the hand reaches the target too late: {at_s} s, {by_m} m");
    }
}

/// Null motion with the seventh joint: the elbow moves to a better pose, and the hand stays within 0.1 mm.
#[test]
fn the_elbow_moves_and_the_hand_stays() {
    let mut cell = cell([0.9, 0.75, -0.9, 1.6, 0.5, -0.9, 2.0], RedundancyConfig::default());
    let begin = cell.joints.position_rad;
    let target = desired_for(&cell, &begin);
    let hand = cell.base_from_hand();
    let mut worst = (0.0f64, 0.0f64);
    for _ in 0..5000 {
        cell.step(&target);
        let off = hand.inverse() * cell.base_from_hand();
        worst = (worst.0.max(off.translation_m().norm()), worst.1.max(off.rotation_angle_rad()));
    }
    assert!((cell.joints.position_rad - begin).norm() > 0.3, "{}", cell.joints.position_rad);
    assert!(worst.0 < 1e-4 && worst.1 < 2e-4, "{worst:?}");
}
