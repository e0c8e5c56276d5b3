//! Each reason that inhibits motion has its own one-line message, with the fault and the remedy.

use std::collections::BTreeSet;

use pb3dp_servo::supervisor::{
    ARM_NAMES, ArmCondition, Cause, Condition, Detail, Innovation, Inputs, OperatorCommand, Permission, Refusal,
    RefusedFor, State, Then, Why,
};
use pb3dp_servo::{HoldReason, Mode};

use super::bench::{Bench, config};

/// Causes of each condition with all their details, and the texts that the message must contain.
fn causes() -> Vec<(Cause, Vec<String>)> {
    let of = |condition: Condition| -> (f64, f64, Vec<Detail>, [&'static str; 2]) {
        let arms = vec![Detail::Arm(0), Detail::Arm(1)];
        let none = vec![Detail::None];
        match condition {
            Condition::EmergencyStop | Condition::ArmFault | Condition::ArmDisabled => (0.0, 0.0, arms, ["", ""]),
            Condition::ClockStepped => (-1.5, 0.2, none, ["-1.500 s", "0.200 s"]),
            Condition::JointsStale => (0.123, 0.05, arms, ["0.123 s", "0.050 s"]),
            Condition::OperatorSilent | Condition::FrameStale | Condition::TargetLost | Condition::EstimateStale => {
                (0.456, 0.25, none, ["0.456 s", "0.250 s"])
            }
            Condition::TargetChanged => {
                (0.0, 0.0, vec![Detail::Targets { started: 3, followed: 4 }], ["target 4", "target 3"])
            }
            Condition::FrameOrder => (0.0, 0.0, vec![Detail::Frames { before: 60, after: 57 }], ["pair 57", "pair 60"]),
            Condition::Miscalibrated => (0.0, 0.0, none, ["images", "calibration"]),
            Condition::LowConfidence => (0.0, 0.0, vec![Detail::None, Detail::NoPose], ["pose", "estimator"]),
            Condition::PositionJump | Condition::PositionUncertain => (0.0234, 0.01, none, ["23.40 mm", "10.00 mm"]),
            Condition::Outlier => (12.34, 6.0, none, ["12.3", "6.0"]),
            Condition::OrientationJump | Condition::OrientationUncertain => {
                (0.1, 0.05, none, ["5.73 degrees", "2.86 degrees"])
            }
            Condition::CameraSkew => (0.0072, 0.005, none, ["7.20 ms", "5.00 ms"]),
            Condition::LateImages => (0.125, 0.02, none, ["125 ms", "20 ms"]),
            Condition::LimitNear => {
                (0.02, 0.05, vec![Detail::Joint(0), Detail::Joint(6)], ["1.15 degrees", "2.86 degrees"])
            }
            Condition::Singularity => (0.0123, 0.03, none, ["0.0123", "0.0300"]),
            Condition::ControllerRests => {
                let stale = Mode::Holding(HoldReason::ObservationStale { age_s: 0.321 });
                (0.0, 0.0, vec![Detail::Controller(stale), Detail::Controller(Mode::Locking)], ["controller", ""])
            }
        }
    };
    let mut causes = Vec::new();
    for condition in Condition::ALL {
        let (value, threshold, details, parts) = of(condition);
        for detail in details {
            let also = match detail {
                Detail::Arm(arm) => ARM_NAMES[arm].to_owned(),
                Detail::Joint(joint) => format!("axis {}", joint + 1),
                Detail::Controller(mode) => mode.to_string(),
                _ => String::new(),
            };
            let parts = parts.iter().map(|part| (*part).to_owned()).chain([also]).collect();
            causes.push((Cause { condition, value, threshold, detail }, parts));
        }
    }
    causes
}

#[test]
fn every_state_and_every_condition_has_a_line_of_its_own() {
    use State::{Approaching, Fault, Holding, Lost, Stopped, Tracking};
    let by_itself = Then::ByItself { after_s: 0.2 };
    let mut lines = BTreeSet::new();
    let mut add = |why: Why, parts: &[String], to_do: &str| {
        let line = why.to_string();
        for part in parts {
            assert!(line.contains(part), "{part:?} is not in {line:?}");
        }
        assert!(line.contains(to_do), "the remedy ({to_do}) is not in {line:?}");
        assert!(!line.contains('\n') && line.len() < 300 && !line.contains("  "), "{line:?}");
        assert!(lines.insert(line.clone()), "duplicate: {line:?}");
        let alone = why.without_console().to_string();
        assert!(!alone.contains("; use ") && !alone.contains(", then use "), "nobody can do that: {alone:?}");
        assert_eq!(
            alone.contains("start a new run"),
            why.waits_for_resume() || to_do.contains("use reset"),
            "{alone:?}"
        );
    };
    add(Why::Idle, &["idle: ".into()], "use select");
    add(Why::Ready, &["selecting: ".into()], "use start");
    add(Why::StoppedByOperator, &["stopped: ".into(), "operator".into()], "use reset");
    for state in [Approaching, Tracking] {
        add(Why::Moving { state }, &[state.to_string()], "");
    }
    for state in [Holding, Lost] {
        for every_arm in [false, true] {
            add(Why::HeldByOperator { state, every_arm, cause: None }, &[format!("{state}: ")], "use resume");
        }
    }
    for state in [State::Selecting, Holding, Lost] {
        let why = Why::Settling { state, cause: None, for_s: 0.2 };
        add(why, &[format!("{state}: ")], "ready to ");
    }
    for (cause, parts) in causes() {
        let mut parts = parts.clone();
        parts.push(cause.to_string());
        add(Why::Waiting { cause }, &parts, "then use start");
        for state in [State::Selecting, Holding, Lost] {
            let parts = [parts.clone(), vec![format!("{state}: cleared: ")]].concat();
            let why = Why::Settling { state, cause: Some(cause), for_s: 0.2 };
            add(why, &parts, "in 0.2 s");
        }
        for state in [Approaching, Tracking] {
            let parts = [parts.clone(), vec![format!("{state}: "), "50 %".into()]].concat();
            add(Why::Slowed { state, cause, share: 0.5 }, &parts, ";");
        }
        for state in [Holding, Lost] {
            let parts = [parts.clone(), vec![format!("{state}: ")]].concat();
            add(Why::Resting { state, cause, then: Then::Resume }, &parts, "then use resume");
            add(Why::Resting { state, cause, then: by_itself }, &parts, "resumes by itself 0.2 s after");
            add(Why::CauseGone { state, cause, then: Then::Resume }, &parts, "use resume");
            add(Why::CauseGone { state, cause, then: by_itself }, &parts, "resumes by itself in 0.2 s");
            add(Why::HeldByOperator { state, every_arm: true, cause: Some(cause) }, &parts, "then use resume");
        }
        for state in [Stopped, Fault] {
            let parts = [parts.clone(), vec![format!("{state}: ")]].concat();
            add(Why::Latched { state, cause, is_gone: false }, &parts, "then use reset");
            add(Why::Latched { state, cause, is_gone: true }, &parts, "use reset");
        }
    }
    assert!(lines.len() > 14 * Condition::COUNT);
}

#[test]
fn a_missing_observation_is_reported_as_never_received() {
    for condition in [
        Condition::OperatorSilent,
        Condition::JointsStale,
        Condition::FrameStale,
        Condition::TargetLost,
        Condition::EstimateStale,
    ] {
        let cause = Cause { condition, value: f64::INFINITY, threshold: 0.25, detail: Detail::Arm(1) };
        let line = cause.to_string();
        assert!(
            line.contains("yet; motion needs one newer than") && line.contains("0.250 s") && !line.contains("inf"),
            "{line}"
        );
    }
}

#[test]
fn every_refusal_has_its_own_text() {
    let mut lines = BTreeSet::new();
    for command in OperatorCommand::ALL {
        let age = RefusedFor::Age { age_s: 0.7, age_max_s: 0.5 };
        let not_clear = |cause| RefusedFor::NotClear { cause, clear_s: 0.07, wanted_s: 0.2 };
        let mut reasons = vec![age, RefusedFor::OlderThanTarget, not_clear(None)];
        reasons.extend(causes().into_iter().map(|(cause, _)| not_clear(Some(cause))));
        for state in State::ALL {
            reasons.extend([RefusedFor::State(state), RefusedFor::OlderThanState(state), RefusedFor::Overtaken(state)]);
        }
        reasons.extend(causes().into_iter().map(|(cause, _)| RefusedFor::Cause(cause)));
        for because in reasons {
            let line = Refusal { command, because }.to_string();
            assert!(line.starts_with(&format!("{} refused: ", command.name())) && !line.contains('\n'), "{line}");
            assert!(lines.insert(line.clone()), "duplicate: {line}");
        }
    }
    let age = Refusal { command: OperatorCommand::Start, because: RefusedFor::Age { age_s: 0.7, age_max_s: 0.5 } }
        .to_string();
    let not_clear = RefusedFor::NotClear { cause: Some(causes()[0].0), clear_s: 0.07, wanted_s: 0.2 };
    let line = Refusal { command: OperatorCommand::Resume, because: not_clear }.to_string();
    assert!(line.contains("0.070 s") && line.contains("0.200 s") && line.contains("repeat it"), "{line}");
    assert!(age.contains("0.700 s") && age.contains("0.500 s") && age.contains("repeat it"), "{age}");
}

#[test]
fn a_refusal_says_what_to_use_instead() {
    for (state, instead) in [
        (State::Idle, "idle; use select first"),
        (State::Selecting, "selecting; use start first"),
        (State::Approaching, "approaching, the hand already follows the target; use hold or stop"),
        (State::Tracking, "tracking, the hand already follows the target; use hold or stop"),
        (State::Holding, "holding; use resume"),
        (State::Lost, "lost; use resume"),
        (State::Stopped, "stopped; use reset first"),
        (State::Fault, "fault; use reset first"),
    ] {
        let refusal = Refusal { command: OperatorCommand::Select, because: RefusedFor::State(state) };
        let line = format!("select refused: not possible in the state {instead} [PB3DP-SUP-101]");
        assert_eq!(refusal.to_string(), line);
    }
    let (pressed, _) = causes()[0];
    let line = |command| Refusal { command, because: RefusedFor::Cause(pressed) }.to_string();
    assert!(line(OperatorCommand::Reset).contains("; release the switch, then use reset again ["));
    assert!(line(OperatorCommand::Start).contains("; release the switch ["));
}

#[test]
fn the_remedy_depends_on_what_is_missing() {
    let line = |condition, value, detail| Why::Waiting { cause: Cause { condition, value, threshold: 0.25, detail } };
    for (condition, value, detail, part) in [
        (Condition::FrameStale, f64::INFINITY, Detail::None, "; wait for the cameras,"),
        (Condition::FrameStale, 0.3, Detail::None, "; check the cameras,"),
        (Condition::TargetLost, f64::INFINITY, Detail::None, "; clear the view of the target, or mark another region,"),
        (Condition::TargetLost, 0.3, Detail::None, "; bring the target back into view,"),
        (Condition::LowConfidence, 0.0, Detail::NoPose, "the estimator has no pose;"),
        (Condition::LowConfidence, 0.0, Detail::None, "the estimator has a pose with low confidence;"),
    ] {
        let line = line(condition, value, detail).to_string();
        assert!(line.contains(part), "{part:?} is not in {line:?}");
    }
}

#[test]
fn only_some_holds_wait_for_the_command_resume() {
    let (cause, _) = causes()[0];
    let (state, by_itself) = (State::Holding, Then::ByItself { after_s: 0.2 });
    for (why, expected) in [
        (Why::Resting { state, cause, then: Then::Resume }, true),
        (Why::Resting { state, cause, then: by_itself }, false),
        (Why::CauseGone { state, cause, then: Then::Resume }, true),
        (Why::CauseGone { state, cause, then: by_itself }, false),
        (Why::HeldByOperator { state, every_arm: false, cause: None }, true),
        (Why::Latched { state: State::Fault, cause, is_gone: true }, false),
        (Why::Ready, false),
    ] {
        assert_eq!(why.waits_for_resume(), expected, "{why}");
    }
}

/// Messages in the order in which an operator sees them.
#[test]
fn an_arm_that_does_not_move_says_why_in_each_step() {
    let mut bench = Bench::new(config());
    bench.step();
    assert_eq!(bench.why(), "idle: no target selected; use select");
    bench.lie(|i| i.estimate = None);
    bench.say(OperatorCommand::Select);
    bench.step();
    assert_eq!(
        bench.why(),
        "selecting: no confident pose yet; motion needs one newer than 1.000 s; clear the view of the target, or mark another \
         region, then use start [PB3DP-SUP-010]"
    );
    bench.truth();
    bench.run(0.3);
    assert!(bench.why().ends_with("use start"), "{}", bench.why());
    bench.say(OperatorCommand::Start);
    assert_eq!(bench.why(), "approaching");
    bench.lie(|i| i.frame.as_mut().unwrap().skew_s = 0.0061);
    bench.run(0.3);
    assert_eq!(
        bench.why(),
        "holding: the camera exposures are 6.10 ms apart, limit 5.00 ms; check the camera trigger; resumes by itself 0.2 s after the \
         cause is gone [PB3DP-SUP-018]"
    );
    bench.say(OperatorCommand::Hold);
    assert!(
        bench.why().starts_with("holding: both arms held by the operator; also the camera exposures"),
        "{}",
        bench.why()
    );
    bench.truth();
    bench.run(0.3);
    assert_eq!(bench.why(), "holding: both arms held by the operator; use resume");
    bench.say(OperatorCommand::Stop);
    assert_eq!(bench.why(), "stopped: by the operator; use reset, then select, which enables the arms, then start");
    for _ in 0..200 {
        let decision = bench.step();
        assert_eq!(decision.permission, Permission::Stop);
        assert!(decision.why.to_string().len() > 20);
    }
}

/// Neither arm stands for both: the drives that do not answer may be those of the other one.
#[test]
fn two_disabled_arms_are_named_together() {
    let mut bench = Bench::new(config());
    bench.say(OperatorCommand::Select);
    bench.lie(|i| i.arms.iter_mut().for_each(|arm| arm.state = ArmCondition::Disabled));
    bench.run(0.5);
    assert!(bench.why().starts_with("selecting: both arms: drives disabled; "), "{}", bench.why());
    bench.lie(|i| i.arms[1].state = ArmCondition::Disabled);
    bench.step();
    assert!(bench.why().starts_with("selecting: tc-robot: drives disabled; "), "{}", bench.why());
}

/// Right after `select` the line shows no measurement of the state before, and its next step shows the same reason.
#[test]
fn the_line_after_select_is_that_of_the_next_step() {
    let lies: [fn(&mut Inputs); 6] = [
        |_| {},
        |i| i.estimate = None,
        |i| i.innovation = Innovation::Outlier { sigmas: 60.0 },
        |i| i.innovation = Innovation::Jump { position_m: 0.5, orientation_rad: 0.0 },
        |i| i.estimate.as_mut().unwrap().covariance.as_mut().unwrap()[(2, 2)] = 4e-4,
        |i| i.controller = Mode::Lost,
    ];
    for (number, lie) in lies.into_iter().enumerate() {
        for command in [OperatorCommand::Hold, OperatorCommand::Stop] {
            let mut bench = Bench::following(config());
            bench.lie(lie);
            bench.run(0.5);
            bench.say(command);
            bench.run(0.5);
            if command == OperatorCommand::Stop {
                bench.say(OperatorCommand::Reset);
                bench.run(0.1);
            }
            let selected = bench.say(OperatorCommand::Select);
            assert_eq!(selected.state, State::Selecting, "{number}");
            let next = bench.step();
            let request = selected.why.to_string();
            assert!(request.starts_with("selecting: no confident pose yet; "), "{number} {command:?}: {request}");
            assert_eq!(request, next.why.to_string(), "{number} {command:?}");
        }
    }
}

/// A single image that disagreed long ago did not cause the hold.
#[test]
fn a_hold_by_the_operator_names_no_condition_from_before() {
    let mut bench = Bench::following(config());
    bench.lie(|i| {
        if i.innovation == Innovation::Agrees {
            i.innovation = Innovation::Outlier { sigmas: 60.0 };
        }
    });
    bench.run(0.04);
    bench.truth();
    bench.run(2.0);
    assert_eq!(bench.state(), State::Tracking, "{}", bench.why());
    bench.say(OperatorCommand::Hold);
    let why = bench.why();
    assert!(!why.contains("cleared") && why.ends_with("no active inhibit; ready to resume in 0.1 s"), "{why}");
}
