//! Policies that are out of range, or weaker than allowed, are refused with key, value and allowed values.

use pb3dp_servo::supervisor::{Action, Condition, Policy, Resume, Supervisor, SupervisorConfig};

use super::bench::{config, with};

fn refusal(config: SupervisorConfig) -> Option<String> {
    Supervisor::new(config).err().map(|error| error.to_string())
}

fn refused(condition: Condition, change: impl FnOnce(&mut Policy)) -> String {
    refusal(with(condition, change)).unwrap_or_else(|| panic!("accepted: {}", condition.key()))
}

const ACTIONS: [Action; 5] = [Action::Note, Action::Slow(0.5), Action::Hold, Action::Stop, Action::Fault];

#[test]
fn no_policy_may_be_weaker_than_its_condition_allows() {
    for condition in Condition::ALL {
        let rule = condition.rule();
        for action in ACTIONS {
            let result = refusal(with(condition, |policy| policy.action = action));
            if action >= rule.least {
                assert_eq!(result, None, "{}: {action}", rule.key);
            } else {
                let result = result.unwrap_or_else(|| panic!("accepted: {} with {action}", rule.key));
                let expected = format!("supervisor setting {}.action is {action}: allowed is {}", rule.key, rule.least);
                assert!(result.starts_with(&expected) && result.ends_with("fault"), "{result}");
            }
        }
    }
}

#[test]
fn faults_of_arms_and_emergency_stops_are_always_faults_and_stale_data_is_at_least_a_hold() {
    for condition in [Condition::EmergencyStop, Condition::ArmFault] {
        assert_eq!(condition.rule().least, Action::Fault);
    }
    let at_least_hold = [
        Condition::ArmDisabled,
        Condition::ClockStepped,
        Condition::OperatorSilent,
        Condition::JointsStale,
        Condition::TargetChanged,
        Condition::Miscalibrated,
        Condition::FrameStale,
        Condition::FrameOrder,
        Condition::TargetLost,
        Condition::EstimateStale,
        Condition::ControllerRests,
    ];
    for condition in at_least_hold {
        assert_eq!(condition.rule().least, Action::Hold, "{}", condition.key());
        assert_eq!(condition.rule().for_max_s, 0.0, "{}: no additional `for_s`", condition.key());
    }
}

#[test]
fn nothing_resumes_by_itself_after_what_only_a_person_can_judge() {
    let for_persons = [
        Condition::EmergencyStop,
        Condition::ArmFault,
        Condition::ArmDisabled,
        Condition::ClockStepped,
        Condition::OperatorSilent,
        Condition::TargetChanged,
        Condition::Miscalibrated,
    ];
    for condition in Condition::ALL {
        let result = refusal(with(condition, |policy| policy.resume = Resume::ByItself));
        if for_persons.contains(&condition) {
            let expected =
                format!("supervisor setting {}.resume is by-itself: allowed is by-operator", condition.key());
            assert_eq!(result, Some(expected));
        } else {
            assert_eq!(result, None, "{}", condition.key());
        }
    }
}

#[test]
fn each_number_has_its_range() {
    for condition in Condition::ALL {
        let rule = condition.rule();
        if let Some(threshold) = rule.threshold {
            let range = format!("allowed is {} to {}", threshold.min, threshold.max);
            for bad in [threshold.min * 0.99, threshold.max * 1.01, -1.0, f64::NAN, f64::INFINITY] {
                let text = refused(condition, |policy| policy.threshold = bad);
                let stated = format!("supervisor setting {}.{} is {bad}: {range}", rule.key, threshold.name);
                assert_eq!(text, stated);
            }
        } else {
            assert_eq!(refusal(with(condition, |policy| policy.threshold = f64::NAN)), None, "it has none");
        }
        for bad in [-0.01, rule.for_max_s + 0.01, f64::NAN] {
            let text = refused(condition, |policy| policy.for_s = bad);
            assert!(
                text.contains(&format!("{}.for_s is {bad}: allowed is 0 to {}", rule.key, rule.for_max_s)),
                "{text}"
            );
        }
    }
    for bad in [0.0, 0.04, 0.96, 1.0, -0.5, f64::NAN] {
        let text = refused(Condition::LowConfidence, |policy| policy.action = Action::Slow(bad));
        assert!(text.contains(&format!("low_confidence.share is {bad}: allowed is 0.05 to 0.95")), "{text}");
    }
    for bad in [0.04, 61.0, f64::NAN] {
        let text = refusal(SupervisorConfig { resume_after_s: bad, ..config() }).unwrap();
        assert_eq!(text, format!("supervisor setting resume_after_s is {bad}: allowed is 0.05 to 60"));
    }
    for bad in [0.04, 0.21, f64::NAN] {
        let text = refusal(SupervisorConfig { go_after_s: bad, ..config() }).unwrap();
        assert_eq!(text, format!("supervisor setting go_after_s is {bad}: allowed is 0.05 to 0.2"));
    }
    for bad in [0.04, 5.1, f64::NAN] {
        let text = refusal(SupervisorConfig { word_age_max_s: bad, ..config() }).unwrap();
        assert_eq!(text, format!("supervisor setting word_age_max_s is {bad}: allowed is 0.05 to 5"));
    }
    let text = refused(Condition::TargetLost, |policy| policy.threshold = 0.29);
    assert_eq!(text, "supervisor setting target_lost.age_s is 0.29: allowed is 0.3 to 10", "stale before lost");
    assert_eq!(refusal(config()), None);
}

#[test]
fn actions_are_ordered_by_severity_and_the_smaller_share_is_the_more_severe() {
    assert!(ACTIONS.is_sorted_by(|one, other| one < other));
    assert!(Action::Slow(0.3) > Action::Slow(0.5) && Action::Slow(0.05) < Action::Hold);
    assert_eq!(ACTIONS.map(Action::is_rest), [false, false, true, true, true]);
}

#[test]
fn keys_are_names_of_their_own() {
    for (index, condition) in Condition::ALL.into_iter().enumerate() {
        assert_eq!(condition as usize, index);
        assert_eq!(Condition::ALL.iter().filter(|other| other.key() == condition.key()).count(), 1);
    }
}
