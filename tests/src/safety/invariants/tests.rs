//! Each invariant accepts a good run and reports a run that violates it.

use super::super::truth::{ArmTruth, HAND_ARM, Injected, LogLine, Placement, TARGET_ARM};
use super::*;
use crate::safety::truth::Step;

mod braking;

const STARTS_DEG: [[f64; 7]; 2] =
    [[0.0, 45.4169, 0.0, 97.4898, 0.0, -52.9067, 0.0], [0.0, 43.8922, 0.0, 100.7139, 0.0, -54.6061, 0.0]];
const PERIOD_S: f64 = 0.002;

fn target() -> Placement {
    Placement { rotation: [[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], translation_m: [0.24, 0.0, 0.95] }
}

/// Both arms oscillate in S1 and W2 by a tenth of a radian while `goes` is true, then brake at 1.9 rad/s^2 as the driver does, without a
/// limit of jerk, and continue likewise.
fn run(seconds: f64, goes: impl Fn(usize, f64) -> bool, mut change: impl FnMut(&mut Step)) -> Truth {
    let mut truth = Truth::default();
    let at_rest = |degrees: [f64; 7]| ArmTruth { ramps: true, ..ArmTruth::resting_at(degrees.map(f64::to_radians)) };
    let mut arms = STARTS_DEG.map(at_rest);
    for k in 0..(seconds / PERIOD_S) as u32 {
        let t_s = f64::from(k) * PERIOD_S;
        for (index, arm) in arms.iter_mut().enumerate() {
            for (joint, rate) in [(0, 2.0), (6, 3.0)] {
                let desired = if goes(index, t_s) { 0.1 * rate * (rate * t_s).sin() } else { 0.0 };
                let speed = &mut arm.velocity_rad_per_s[joint];
                let before = *speed;
                *speed += (desired - *speed).clamp(-1.9 * PERIOD_S, 1.9 * PERIOD_S);
                arm.position_rad[joint] += 0.5 * (before + *speed) * PERIOD_S;
            }
        }
        let world_from_target = target();
        let mut step = Step {
            t_s,
            arms,
            world_from_target,
            pose_age_s: 0.05,
            may_search: false,
            is_inhibited: false,
            content_late_s: 0.0,
            resets: 0,
            state: "tracking",
            says_why: true,
        };
        change(&mut step);
        truth.steps.push(step);
    }
    truth
}

fn always(_: usize, _: f64) -> bool {
    true
}

fn found_in(truth: &Truth) -> Vec<Violation> {
    check(&Rules::of_the_rig(), truth)
}

fn silent(truth: &Truth) {
    let found = found_in(truth);
    assert!(found.is_empty(), "{}", found[0]);
}

/// All violations are of this kind; returns the first of them.
fn only(invariant: Invariant, truth: &Truth) -> Violation {
    let found = found_in(truth);
    assert!(!found.is_empty(), "{} was not found", invariant.name());
    for violation in &found {
        assert_eq!(violation.invariant, invariant, "{violation}");
    }
    found[0].clone()
}

/// A fault at 2 s that both arms detect at once, a reset at 4 s, the command to go at 5 s.
fn latched(step: &mut Step) {
    for arm in &mut step.arms {
        arm.latched_since_s = (2.0..4.0).contains(&step.t_s).then_some(2.0);
        arm.may_go = !(2.0..5.0).contains(&step.t_s);
    }
    step.resets = u32::from(step.t_s >= 4.0);
}

fn rests_from_2_to_5(_: usize, t_s: f64) -> bool {
    !(2.0..5.0).contains(&t_s)
}

#[test]
fn nothing_is_found_in_good_runs() {
    silent(&run(4.0, always, |_| ()));
    silent(&run(7.0, rests_from_2_to_5, latched));
    // The cameras are covered from 1 s to 3 s.
    let sees = |t_s: f64| if (1.0..3.0).contains(&t_s) { t_s - 0.95 } else { 0.05 };
    silent(&run(5.0, |arm, t_s| arm == TARGET_ARM || sees(t_s) < 0.3, |step| step.pose_age_s = sees(step.t_s)));
}

#[test]
fn a_record_with_a_hole_or_without_a_number_proves_nothing() {
    only(Invariant::Record, &Truth::default());
    let mut truth = run(1.0, always, |_| ());
    truth.steps.drain(200..206);
    assert!((only(Invariant::Record, &truth).value - 0.014).abs() < 1e-9);
    let truth = run(1.0, always, |step| step.arms[1].velocity_rad_per_s[4] = f64::NAN);
    only(Invariant::Record, &truth);
}

#[test]
fn a_joint_beyond_its_range_is_found() {
    // E2 works to 249 degrees; a tolerance of 0.2 degrees is allowed.
    let far = |degrees: f64| move |step: &mut Step| step.arms[TARGET_ARM].position_rad[4] = degrees.to_radians();
    silent(&run(1.0, always, far(249.1)));
    let violation = only(Invariant::Position, &run(1.0, always, far(249.3)));
    assert_eq!((violation.arm, violation.joint, violation.steps), (Some(TARGET_ARM), Some(4), 500));
    // A joint without drive may coast, but not through its stops.
    let free = |degrees: f64| {
        move |step: &mut Step| {
            far(degrees)(step);
            (step.arms[TARGET_ARM].servo_on, step.arms[TARGET_ARM].driven) = (false, [false; 7]);
        }
    };
    silent(&run(1.0, always, free(260.0)));
    only(Invariant::Position, &run(1.0, always, free(270.5)));
    // A joint that moved by itself may be out of range until the arm is back, and not again.
    let disobeyed = |back_s: f64, out_again_s: f64| {
        run(
            1.0,
            |_, _| false,
            move |step| {
                let t_s = step.t_s;
                let is_out = t_s < back_s || t_s >= out_again_s;
                let arm = &mut step.arms[TARGET_ARM];
                arm.position_rad[4] = if is_out { 249.3f64 } else { 249.1 }.to_radians();
                (arm.disobeys[4], arm.by_itself[4]) = (t_s < 0.2, t_s < 0.2);
            },
        )
    };
    let first_s = |truth: &Truth| {
        let found = found_in(truth);
        found.iter().find(|violation| violation.invariant == Invariant::Position).map(|violation| violation.first_s)
    };
    assert_eq!(first_s(&disobeyed(2.0, 2.0)), None);
    assert_eq!(first_s(&disobeyed(0.5, 2.0)), None);
    assert_eq!(first_s(&disobeyed(0.5, 0.8)), Some(0.8));
}

#[test]
fn a_joint_that_is_too_fast_or_jumps_is_found() {
    let fast = |speed: f64| {
        run(0.5, always, move |step| {
            step.arms[HAND_ARM].velocity_rad_per_s[3] = -speed;
            step.arms[HAND_ARM].position_rad[3] -= speed * (step.t_s - 0.25);
        })
    };
    silent(&fast(1.2));
    let violation = only(Invariant::Speed, &fast(1.23));
    assert_eq!((violation.arm, violation.joint), (Some(HAND_ARM), Some(3)));
    let jump = run(1.0, always, |step| step.arms[HAND_ARM].position_rad[3] -= if step.t_s > 0.5 { 0.01 } else { 0.0 });
    assert!((only(Invariant::Speed, &jump).value - 5.0).abs() < 0.1);
}

/// A joint runs away with growing speed, and comes to rest; its tolerance counts from when it is too fast, for this joint alone.
#[test]
fn a_joint_that_runs_away_may_be_too_fast_for_a_moment() {
    // From 0.4 s on it accelerates at 2 rad/s^2: at 0.7305 s it reaches its speed limit. The fault ends at 0.75 s.
    let runs_away = |most: f64, joint: usize, stopped_at_s: f64| {
        run(2.0, always, move |step| {
            let arm = &mut step.arms[HAND_ARM];
            arm.disobeys[1] = (0.4..stopped_at_s + 0.5).contains(&step.t_s);
            arm.by_itself[1] = (0.4..0.75).contains(&step.t_s);
            let speed = (2.0 * (step.t_s - 0.4)).clamp(0.0, most);
            let speed = if step.t_s < stopped_at_s { speed } else { 0.0 };
            arm.velocity_rad_per_s[joint] = speed;
            let went_s = step.t_s.min(stopped_at_s) - 0.4;
            let risen_s = went_s.clamp(0.0, most / 2.0);
            arm.position_rad[joint] += risen_s * risen_s + most * (went_s - risen_s).max(0.0);
        })
    };
    silent(&runs_away(0.7, 1, 0.778));
    let violation = only(Invariant::Speed, &runs_away(0.7, 1, 0.83));
    assert!((0.778..0.784).contains(&violation.first_s) && violation.note.starts_with("for 0.0"), "{violation}");
    // Samples that are repeated, or a late control loop, hide it for up to 0.1 s more.
    let hidden = |stopped_at_s: f64| {
        let mut truth = runs_away(0.7, 1, stopped_at_s);
        truth.steps.iter_mut().for_each(|step| step.arms[HAND_ARM].commands_disturbed = true);
        truth
    };
    silent(&hidden(0.87));
    only(Invariant::Speed, &hidden(0.89));
    // Below that speed the other invariants apply, also on the way back.
    silent(&runs_away(0.655, 1, 1.0));
    // The arm's other joints have no tolerance.
    let found = found_in(&runs_away(0.7, 0, 0.778));
    let violation = found.iter().find(|violation| violation.invariant == Invariant::Speed).expect("too fast");
    assert!(violation.first_s < 0.71 && violation.joint == Some(0), "{violation}");
    assert!(found.iter().any(|violation| violation.invariant == Invariant::Acceleration), "{found:?}");
}

/// S3 follows speeds that are commanded every 10 ms with the lag of its drive: they change at this rate from 0.5 s on, which grows by
/// this jerk.
fn commanded(rate: f64, jerk: f64, change: impl Fn(&mut ArmTruth)) -> Truth {
    const LAG_S: f64 = 0.030;
    let (mut command, mut acceleration, mut speed, mut position) = (0.0, 0.0, 0.0, 0.0);
    let mut count = 0u32;
    run(
        0.75,
        |_, _| false,
        |step| {
            if step.t_s >= 0.5 && count.is_multiple_of(5) {
                acceleration = (acceleration + jerk * 0.01f64).min(rate);
                command += acceleration * 0.01;
            }
            count += 1;
            let arm = &mut step.arms[HAND_ARM];
            (arm.position_rad[2], arm.velocity_rad_per_s[2]) = (arm.position_rad[2] + position, speed);
            let left = (-PERIOD_S / LAG_S).exp();
            position += command * PERIOD_S + (speed - command) * LAG_S * (1.0 - left);
            speed = command + (speed - command) * left;
            arm.ramps = false;
            change(arm);
        },
    )
}

#[test]
fn acceleration_beyond_the_limit_is_found_in_ramps_and_in_jumps() {
    silent(&commanded(2.0, 80.0, |_| ()));
    let found = found_in(&commanded(2.8, 80.0, |_| ()));
    let violation = found.iter().find(|violation| violation.invariant == Invariant::Acceleration).expect("too steep");
    assert!(violation.note.contains("20 ms") || violation.note.contains("100 ms"), "{violation}");
    assert_eq!(violation.joint, Some(2));
    // If commands were lost, the next one contains the difference of up to two more cycles.
    let disturbed = |rate: f64| commanded(rate, 80.0, |arm| arm.commands_disturbed = true);
    silent(&disturbed(2.3));
    let violation = only(Invariant::Acceleration, &disturbed(2.8));
    assert!(violation.note.contains("100 ms"), "{violation}");
}

#[test]
fn jerk_beyond_the_limit_is_found_unless_the_driver_brakes_the_arm() {
    let violation = only(Invariant::Jerk, &commanded(2.0, 120.0, |_| ()));
    assert!(violation.joint == Some(2) && (1.0..1.3).contains(&violation.value), "{violation}");
    only(Invariant::Jerk, &commanded(2.0, 1e3, |_| ()));
    silent(&commanded(2.0, 1e3, |arm| arm.ramps = true));
    silent(&commanded(2.0, 1e3, |arm| arm.commands_disturbed = true));
}

#[test]
fn motion_after_a_latched_fault_of_either_arm_is_found() {
    // The other arm continues.
    let truth = run(
        7.0,
        |arm, t_s| arm == HAND_ARM || rests_from_2_to_5(arm, t_s),
        |step| {
            latched(step);
            step.arms[HAND_ARM].latched_since_s = None;
            step.arms[HAND_ARM].may_go = true;
        },
    );
    assert_eq!(only(Invariant::RestAfterLatch, &truth).arm, Some(HAND_ARM));
    // It brakes half a second too late.
    let late = |_: usize, t_s: f64| !(2.5..5.0).contains(&t_s);
    let found = found_in(&run(7.0, late, latched));
    assert!(found.iter().any(|violation| violation.invariant == Invariant::RestAfterLatch), "{found:?}");
    // It creeps.
    let mut crept_rad = 0.0;
    let truth = run(7.0, rests_from_2_to_5, |step| {
        latched(step);
        crept_rad += if (2.0..4.0).contains(&step.t_s) { 0.0019 * PERIOD_S } else { 0.0 };
        step.arms[HAND_ARM].position_rad[1] += crept_rad;
        step.arms[HAND_ARM].may_go = true;
    });
    let violation = only(Invariant::RestAfterLatch, &truth);
    assert!(violation.note.contains("crept") && violation.joint == Some(1), "{violation}");
}

#[test]
fn a_latch_that_goes_by_itself_is_found() {
    let truth = run(7.0, rests_from_2_to_5, |step| {
        latched(step);
        step.resets = 0;
    });
    assert_eq!(only(Invariant::LatchCleared, &truth).first_s, 4.0);
}

#[test]
fn motion_before_the_operators_command_is_found() {
    let truth = run(7.0, |_, t_s| !(2.0..4.5).contains(&t_s), latched);
    let violation = only(Invariant::HoldWithoutCommand, &truth);
    assert!((violation.first_s - 4.5).abs() < 0.01, "{violation}");
}

#[test]
fn motion_without_a_fresh_pose_is_found_of_the_hand_alone() {
    let blind = |step: &mut Step| step.pose_age_s = 0.05 + (step.t_s - 1.0).max(0.0);
    let violation = only(Invariant::RestWithoutPose, &run(4.0, always, blind));
    assert_eq!(violation.arm, Some(HAND_ARM));
    assert!((1.26..2.0).contains(&violation.first_s), "{violation}");
    let never = |step: &mut Step| step.pose_age_s = f64::INFINITY;
    only(Invariant::RestWithoutPose, &run(4.0, always, never));
}

/// S1 turns the flange, 0.8 m from its axis, with this speed for this time, from a second after a loss.
fn searching(speed_rad_per_s: f64, seconds: f64, may_search: bool) -> Truth {
    run(
        8.0,
        |_, _| false,
        |step| {
            let since_s = (step.t_s - 2.0).clamp(0.0, seconds);
            let hand = &mut step.arms[HAND_ARM];
            hand.position_rad[0] += speed_rad_per_s * since_s;
            hand.velocity_rad_per_s[0] = if since_s > 0.0 && since_s < seconds { speed_rad_per_s } else { 0.0 };
            // Its speed jumps.
            hand.commands_disturbed = true;
            (step.pose_age_s, step.may_search) = (step.t_s, may_search && step.t_s > 1.0);
        },
    )
}

#[test]
fn a_hand_may_look_for_its_target_where_that_is_permitted_near_and_slowly() {
    silent(&searching(0.03, 2.0, true));
    only(Invariant::RestWithoutPose, &searching(0.03, 2.0, false));
    assert!(only(Invariant::Search, &searching(0.03, 5.5, true)).note.contains("from the start of the search"));
    assert!(only(Invariant::Search, &searching(0.08, 0.5, true)).note.contains("m/s"));
}

/// S1 moves at 0.3 rad/s when the target is lost, at 1 s, and brakes this much later.
fn lost_in_motion(later_s: f64) -> Truth {
    const SPEED: f64 = 0.3;
    const BRAKING: f64 = 1.9;
    run(
        4.0,
        |_, _| false,
        |step| {
            let goes_s = step.t_s.min(1.0 + later_s);
            let brakes_s = (step.t_s - goes_s).min(SPEED / BRAKING);
            let hand = &mut step.arms[HAND_ARM];
            hand.position_rad[0] += SPEED * (goes_s + brakes_s) - 0.5 * BRAKING * brakes_s * brakes_s;
            hand.velocity_rad_per_s[0] = SPEED - BRAKING * brakes_s;
            step.may_search = step.t_s > 1.0;
            step.pose_age_s = if step.may_search { step.t_s } else { 0.0 };
        },
    )
}

#[test]
fn a_hand_that_moves_when_its_target_is_lost_has_its_time_to_brake_before_it_searches() {
    silent(&lost_in_motion(0.1));
    assert!(only(Invariant::Search, &lost_in_motion(0.9)).note.contains("m/s"));
}

#[test]
fn a_joint_that_moves_by_itself_has_to_be_stopped() {
    let by_itself = |latched_at_s: f64| {
        run(
            6.0,
            move |arm, t_s| arm == TARGET_ARM || t_s < latched_at_s,
            move |step| {
                let arm = &mut step.arms[HAND_ARM];
                arm.disobeys[0] = (1.0..latched_at_s).contains(&step.t_s);
                arm.by_itself = arm.disobeys;
                // The oscillation is stationary at its ends.
                arm.velocity_rad_per_s[0] += if arm.obeys() { 0.0 } else { 0.3 };
                arm.latched_since_s = (step.t_s >= latched_at_s).then_some(latched_at_s);
            },
        )
    };
    let stopped = |truth: &Truth| {
        let found = found_in(truth);
        found.iter().all(|violation| violation.arm == Some(TARGET_ARM))
    };
    assert!(stopped(&by_itself(2.5)));
    let found = found_in(&by_itself(4.0));
    assert!(
        found.iter().any(|violation| (violation.invariant, violation.arm) == (Invariant::Disobedience, Some(HAND_ARM)))
    );
    // A stuck joint, axis 4, does not move.
    let mut stuck = by_itself(4.0);
    for step in &mut stuck.steps {
        let arm = &mut step.arms[HAND_ARM];
        arm.by_itself = [false, false, false, arm.disobeys[0], false, false, false];
    }
    assert!(found_in(&stuck).iter().all(|violation| violation.invariant != Invariant::Disobedience));
}

#[test]
fn arms_that_come_too_near_are_found() {
    // E1 stretches both arms towards each other.
    let stretch = |by_rad: f64| {
        run(
            1.0,
            |_, _| false,
            move |step| {
                for arm in &mut step.arms {
                    arm.position_rad[3] -= by_rad;
                }
                step.world_from_target.translation_m = [0.0, 0.0, 5.0];
            },
        )
    };
    silent(&stretch(0.1));
    let violation = only(Invariant::ArmsApart, &stretch(0.6));
    assert!(violation.value < 0.049 && violation.arm.is_none(), "{violation}");
}

#[test]
fn a_hand_that_goes_nearer_than_the_target_allows_is_found_and_a_target_that_comes_is_not() {
    let comes = run(2.0, |_, _| false, |step| step.world_from_target.translation_m[0] -= 0.25 * step.t_s);
    silent(&comes);
    // S2 leans forward, and the hand comes down on a target that is stationary.
    let leans = run(
        2.0,
        |_, _| false,
        |step| {
            step.arms[HAND_ARM].position_rad[1] += 0.25 * step.t_s;
            step.arms[HAND_ARM].velocity_rad_per_s[1] = 0.25;
            step.world_from_target.translation_m = [-0.3, 0.0, 0.5];
        },
    );
    let violation = only(Invariant::TargetApart, &leans);
    assert!(violation.value > violation.limit && violation.note.contains("remain"), "{violation}");
}

/// The hand comes down on a target that is too near to be seen. It may do so until its last pose is too old.
#[test]
fn following_a_target_that_is_too_near_to_be_visible_is_found_once_its_pose_is_too_old() {
    let follows = |for_s: f64| {
        run(
            2.0,
            |_, _| false,
            move |step| {
                // It brakes with 1.25 rad/s^2.
                let braking_s = (step.t_s - for_s).clamp(0.0, 0.2);
                step.arms[HAND_ARM].position_rad[1] +=
                    0.25 * (step.t_s.min(for_s) + braking_s) - 0.625 * braking_s.powi(2);
                step.arms[HAND_ARM].velocity_rad_per_s[1] = 0.25 - 1.25 * braking_s;
                step.world_from_target.translation_m = [-0.3, 0.0, 0.5];
            },
        )
    };
    silent(&follows(0.6));
    let violation = only(Invariant::TargetApart, &follows(1.2));
    assert!(violation.limit < 0.1 && (0.8..1.0).contains(&violation.first_s), "{violation}");
}

#[test]
fn an_unreported_fault_is_found() {
    let mut truth = run(4.0, always, |_| ());
    let fault = |name: &str, had_effect| Injected {
        name: name.to_owned(),
        from_s: 1.0,
        until_s: 1.5,
        had_effect,
        log_terms: &["frozen", "the same image"],
    };
    truth.injected = vec![fault("frozen camera", true), fault("nothing came of it", false)];
    let violation = only(Invariant::Log, &truth);
    assert!(violation.note.contains("frozen camera"), "{violation}");
    let line = |t_millis, text: &str| LogLine { t_millis, text: text.to_owned() };
    truth.log = vec![line(900, "the same image"), line(1200, "holding: something else"), line(2800, "frozen")];
    only(Invariant::Log, &truth);
    truth.log.push(line(1900, "holding: the same image twice"));
    silent(&truth);
}

#[test]
fn an_arm_that_rests_without_a_reason_is_found() {
    let truth = run(1.0, always, |step| {
        (step.state, step.says_why) = if step.t_s < 0.5 { ("tracking", false) } else { ("holding", false) };
    });
    let violation = only(Invariant::StatusLine, &truth);
    assert_eq!((violation.steps, violation.note.as_str()), (250, "holding"));
}

#[test]
fn each_invariant_has_a_name_of_its_own() {
    let mut names: Vec<_> = Invariant::ALL.map(Invariant::name).to_vec();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), Invariant::ALL.len());
}

/// A joint of the hand runs away while the arm must be stationary: that joint is excused, the others are not.
#[test]
fn the_other_joints_of_an_arm_that_disobeys_are_found() {
    let held = |joint: usize| {
        run(
            4.0,
            |arm, t_s| arm == TARGET_ARM || t_s < 1.0,
            move |step| {
                let arm = &mut step.arms[HAND_ARM];
                arm.may_go = step.t_s < 1.0;
                arm.disobeys[0] = (2.0..3.0).contains(&step.t_s);
                arm.position_rad[joint] += 0.05 * (step.t_s.clamp(2.0, 3.0) - 2.0);
                arm.velocity_rad_per_s[joint] += if arm.disobeys[0] { 0.05 } else { 0.0 };
            },
        )
    };
    silent(&held(0));
    let violation = only(Invariant::HoldWithoutCommand, &held(5));
    assert_eq!(violation.joint, Some(5));
}

/// E2 was driven out of its range, and obeys again from 0.5 s on: it may stay there and come back, but not go on.
#[test]
fn a_joint_that_goes_on_outwards_after_a_disobedience_is_found() {
    let out = |goes_on_degrees: f64| {
        run(
            2.0,
            |_, _| false,
            move |step| {
                let arm = &mut step.arms[TARGET_ARM];
                arm.position_rad[4] = (250.0 + goes_on_degrees * (step.t_s - 0.5).clamp(0.0, 1.0)).to_radians();
                arm.disobeys[4] = step.t_s < 0.5;
            },
        )
    };
    silent(&out(0.0));
    silent(&out(-2.0));
    let found = found_in(&out(1.0));
    assert!(
        found.iter().any(|violation| (violation.invariant, violation.joint) == (Invariant::Position, Some(4))),
        "{found:?}"
    );
    // Another joint that disobeys excuses nothing.
    let other = run(
        1.0,
        |_, _| false,
        |step| {
            let arm = &mut step.arms[TARGET_ARM];
            arm.position_rad[4] = 249.3f64.to_radians();
            arm.disobeys[5] = true;
        },
    );
    only(Invariant::Position, &other);
}

#[test]
fn motion_while_a_condition_inhibits_the_hand_is_found() {
    let inhibited = |rests: bool| {
        run(
            4.0,
            move |arm, t_s| arm == TARGET_ARM || !rests || !(1.0..2.0).contains(&t_s),
            |step| step.is_inhibited = (1.0..2.0).contains(&step.t_s),
        )
    };
    silent(&inhibited(true));
    assert_eq!(only(Invariant::RestWhileInhibited, &inhibited(false)).arm, Some(HAND_ARM));
}

#[test]
fn a_recorder_that_stands_still_changes_no_motion() {
    let undisturbed = run(2.0, always, |_| {});
    assert_eq!(check_recorder_stall(&undisturbed, &undisturbed), None);
    let mut moved = undisturbed.clone();
    moved.steps[700].arms[1].position_rad[3] += 1e-12;
    let violation = check_recorder_stall(&moved, &undisturbed).unwrap();
    let place = (violation.invariant, violation.arm, violation.joint, violation.first_s);
    assert_eq!(place, (Invariant::RecorderStall, Some(1), Some(3), undisturbed.steps[700].t_s));
    let mut shorter = undisturbed.clone();
    shorter.steps.truncate(900);
    for (stalled, other) in [(&shorter, &undisturbed), (&undisturbed, &shorter)] {
        assert_eq!(check_recorder_stall(stalled, other).unwrap().first_s, undisturbed.steps[900].t_s);
    }
}

#[test]
fn a_hand_that_moves_on_by_late_images_is_found() {
    let late = |content_late_s: f64, from_s: f64| {
        run(
            7.0,
            |_, t_s| !(5.0..5.5).contains(&t_s),
            move |step| {
                if step.t_s >= from_s {
                    step.content_late_s = content_late_s;
                }
            },
        )
    };
    silent(&late(0.1, 1.0));
    silent(&late(0.2, 5.1));
    assert_eq!(only(Invariant::LateImages, &late(0.2, 1.0)).arm, Some(0));
}
