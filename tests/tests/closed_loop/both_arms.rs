//! The common wiring of both arms of a run, and their recordings after a fault.

use std::path::Path;
use std::time::{Duration, SystemTime};

use pb3dp_cell::experiment;
use pb3dp_cell::flight::{self, ArmFault, Flight, LineCounts, Moment, RawLine};
use pb3dp_cell::parts::Parts;
use pb3dp_estimation::estimator::Method;
use pb3dp_hal_api::{ArmErrorKind, JointCommand};
use pb3dp_hal_middleware::LimiterStatistics;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::trajectory::Channel;
use pb3dp_wiring::wire;
use serde_json::Value;

use crate::closed_loop::support::*;

/// The arm with the target has the same wiring as the arm with the cameras: the same refusals, states and limits.
#[test]
fn the_carrying_arm_has_the_limits_and_states_of_the_following_one() {
    let setup = quick_setup(Method::Direct, Pixels::Few, &[Channel::X]);
    let Parts { vs, tc, clock, .. } = wire(&setup).unwrap();
    let mut arms = [("vs-robot", vs, &setup.rig.arms.vs), ("tc-robot", tc, &setup.rig.arms.tc)];
    let mut desired = JointVector::zeros();
    desired[6] = 100.0;
    for (name, arm, _) in &mut arms {
        let early = arm.exchange(JointCommand::Velocity(desired)).unwrap_err();
        assert!(matches!(early.kind(), ArmErrorKind::NotEnabled | ArmErrorKind::Rejected), "{name}: {early}");
        arm.enable().unwrap();
    }
    for (_, arm, _) in &mut arms {
        arm.exchange(JointCommand::Hold).unwrap();
    }
    for (name, arm, setup) in &mut arms {
        let no_number = arm.exchange(JointCommand::Velocity(desired * f64::NAN)).unwrap_err();
        assert_eq!(no_number.kind(), ArmErrorKind::Rejected);
        assert!(no_number.to_string().contains(&format!("limiter of arm {name}")), "{no_number}");
        let limits = &setup.limits;
        let (speed, most) = (limits.velocity_max_rad_per_s()[6], limits.acceleration_max_rad_per_s2()[6]);
        let mut before = arm.exchange(JointCommand::Hold).unwrap();
        let mut fastest: f64 = 0.0;
        for _ in 0..100 {
            clock.sleep_until(clock.now() + Duration::from_millis(10));
            let now = arm.exchange(JointCommand::Velocity(desired)).unwrap();
            let change = now.velocity_rad_per_s[6] - before.velocity_rad_per_s[6];
            assert!(change <= most * 0.01 + 1e-9, "{name}: {change} rad/s in 10 ms");
            fastest = fastest.max(now.velocity_rad_per_s[6]);
            before = now;
        }
        assert!(fastest > 0.9 * speed && fastest <= speed + 1e-9, "{name}: {fastest} of {speed} rad/s");
        let LimiterStatistics { velocity_commands, changed, refused, .. } = arm.statistics();
        assert_eq!((velocity_commands, changed + refused), (102, 102), "{name}");
        assert!(changed >= 100 && refused >= 1, "{name}: {changed}, {refused}");
        arm.stop().unwrap();
    }
}

fn lines_of(file: &Path) -> Vec<Value> {
    std::fs::read_to_string(file).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_fault_leaves_the_flight_of_both_arms() {
    let mut setup = quick_setup(Method::Direct, Pixels::Few, &[Channel::X]);
    // The guard expects slower drives: it detects a fault in the first motion.
    setup.rig.arms.tc.guard.lag = Duration::from_millis(300);
    setup.rig.arms.tc.guard.tracking_error_max_rad = 0.005;
    let parts = wire(&setup).unwrap();
    let (clock, flights) = (parts.clock.clone(), parts.flights.clone());
    let failure = experiment::run(&setup, parts, None, None).err().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let raw = [RawLine { at: clock.now(), is_sent: true, bytes: vec![0xA5, 0x5A, 0x01] }];
    let mut last_velocity_s = Vec::new();
    let moment = Moment { monotonic: clock.now(), wall: SystemTime::now() };
    for (name, log) in &flights {
        let fault = ArmFault {
            at: moment.monotonic - Duration::from_millis(250),
            joint: Some(3),
            code: Some(14),
            cause: "over-current".to_owned(),
            state_before: "moving".to_owned(),
        };
        let counts = LineCounts { lost: 3, late: 2, crc_errors: 1, resyncs: 4, ..LineCounts::default() };
        let flight = Flight { log, fault: Some(fault), counts: Some(counts), raw: &raw };
        let file = flight::write(folder.path(), (name, 1), &flight, &failure, moment).unwrap();
        assert_eq!(file, folder.path().join(format!("flight-{name}.jsonl")));
        let lines = lines_of(&file);
        let (head, entries) = lines.split_first().unwrap();
        let (bytes, entries) = entries.split_last().unwrap();
        assert_eq!((&bytes["raw"], &bytes["bytes"]), (&"sent".into(), &"a55a01".into()));
        assert_eq!((&head["arm"], &head["kind"]), (&(*name).into(), &"fault".into()));
        assert!(head["joint"].as_u64().unwrap() < 7 && head["code"].is_null(), "{head}");
        let cause = head["cause"].as_str().unwrap();
        assert!(cause.contains("tc-robot") && cause.contains("commanded position"), "{cause}");
        let fault = &head["fault"];
        assert_eq!(
            (&fault["joint"], &fault["code"], &fault["state_before"]),
            (&3.into(), &14.into(), &"moving".into())
        );
        for (ended, at) in [("ended_at_s", "at_s"), ("ended_wall_unix_s", "wall_unix_s")] {
            let before_s = head[ended].as_f64().unwrap() - fault[at].as_f64().unwrap();
            assert!((before_s - 0.25).abs() < 1e-3, "{head}");
        }
        assert!(head["ended_wall_unix_s"].as_f64().unwrap() > 1.7e9);
        let counts = ["lost", "late", "crc_errors", "resyncs"].map(|key| head["counts"][key].as_u64().unwrap());
        assert_eq!(counts, [3, 2, 1, 4]);
        let at_s = head["ended_at_s"].as_f64().unwrap();
        let times: Vec<f64> = entries.iter().map(|entry| entry["at_s"].as_f64().unwrap()).collect();
        assert!(times.len() > 50 && times.is_sorted() && *times.last().unwrap() <= at_s, "{name}: {}", times.len());
        let mut moved = entries.iter().filter(|entry| entry["asked"] == "velocity");
        for entry in moved.clone() {
            assert!(entry["velocity_rad_per_s"].as_array().unwrap().len() == 7 && entry["answer"] == "ok", "{entry}");
            assert!(entry["measured_rad"].as_array().unwrap().iter().all(Value::is_f64), "{entry}");
        }
        let last = moved.next_back().unwrap()["at_s"].as_f64().unwrap();
        assert!(entries.last().unwrap()["asked"] == "stop", "{name}");
        last_velocity_s.push(last);
    }
    // The arm with the target has its turn first: the other one was not told to move any more, not even in the same cycle.
    let period_s = setup.control_period.as_secs_f64();
    assert!((last_velocity_s[1] - last_velocity_s[0] - period_s).abs() < 1e-6, "{last_velocity_s:?}");
}
