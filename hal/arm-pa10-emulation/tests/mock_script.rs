//! Fault scripts: how they are parsed, and how they are refused.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10_emulation::mock_controller::{Fault, LineFault, ReplyFault, Script, ScriptLine, Side, When};
use pb3dp_arm_pa10_protocol::codec::{Axis, CommAlarm, ServoAlarm};
use proptest::prelude::*;
use proptest::strategy::ValueTree;

fn parse(line: &str) -> ScriptLine {
    ScriptLine::parse(line).unwrap().unwrap()
}

#[test]
fn a_script_is_read_line_by_line() {
    let script = Script::parse(
        "# a morning in the lab\n\
         \n\
         at 1.5s e-stop press\n\
         at 2500ms e-stop release   # and on\n\
         chance 1% at-most 2 drop 1\n\
         in 300us alarm 4 0x0e reported\n\
         runaway 5 -30deg/s\n",
    )
    .unwrap();
    let ms = Duration::from_millis;
    let expected = [
        ScriptLine { when: When::At(ms(1500)), fault: Fault::EmergencyStop { pressed: true } },
        ScriptLine { when: When::At(ms(2500)), fault: Fault::EmergencyStop { pressed: false } },
        ScriptLine {
            when: When::Chance { probability: 0.01, at_most_in_a_row: Some(2) },
            fault: Fault::Reply { kind: ReplyFault::Drop, count: 1 },
        },
        ScriptLine {
            when: When::In(Duration::from_micros(300)),
            fault: Fault::ServoAlarm {
                axis: Axis::from_number(4).unwrap(),
                alarm: Some(ServoAlarm::OverCurrent),
                only_reported: true,
            },
        },
        ScriptLine {
            when: When::Now,
            fault: Fault::Runaway {
                axis: Axis::from_number(5).unwrap(),
                velocity_rad_per_s: Some(-30f64.to_radians()),
            },
        },
    ];
    assert_eq!(script.lines, expected);
}

#[test]
fn a_line_that_is_wrong_is_named_with_its_word() {
    for (line, expected) in [
        ("estop press", "`estop` is not a fault; the faults are drop, duplicate,"),
        ("e-stop", "the emergency stop is missing; write press or release"),
        ("e-stop pres", "the emergency stop is `pres`; write press or release"),
        ("drop three", "the number of replies is `three`; write a whole number such as 3"),
        ("drop -1", "the number of replies is `-1`"),
        ("drop 3 4", "unexpected argument `4`; remove it"),
        ("at 3 drop 1", "the time is `3`; write a time such as 1.5s, 20ms or 300us"),
        ("at -1s drop 1", "the time is `-1s`"),
        ("at infs drop 1", "the time is `infs`"),
        ("at 1e30s drop 1", "the time is `1e30s`"),
        ("at 1s", "the fault is missing"),
        ("chance 0.01 drop 1", "the chance is `0.01`; write a part such as 1% of messages"),
        ("chance 101% drop 1", "the chance is `101%`"),
        ("chance nan% drop 1", "the chance is `nan%`"),
        ("chance 1% at-most drop 1", "the number of messages in a row is `drop`"),
        ("alarm 8 0x0e", "the axis is `8`; write 1 to 7, from the base"),
        ("alarm 0 0x0e", "the axis is `0`"),
        ("alarm 4 0x0", "the alarm is `0x0`; write its code, such as 0x0e, or off"),
        ("alarm 4 0x1ff", "the alarm is `0x1ff`"),
        ("alarm 4 0x0e always", "the last word is `always`; write reported, or nothing"),
        ("jump 2 5", "the angle is `5`; write an angle such as 0.02rad or 1.5deg"),
        ("jump 2 1e9rad", "the angle is `1e9rad`"),
        ("runaway 2 fast", "the speed is `fast`; write a speed such as 0.5rad/s or 30deg/s, or off"),
        ("line stale 3", "the fault of the line is `stale`; write drop, duplicate"),
        ("line", "the fault of the line is missing"),
        ("line deaf 3", "deaf is `3`; write on or off"),
        ("line slow-reader 600", "the rate is `600`; write bytes per second such as 600B/s, or off"),
        ("line slow-reader -1B/s", "the rate is `-1B/s`"),
        ("line host-clock back", "the jump is `back`; write a time such as 5s, -3600s or 20ms"),
        ("line gateway-clock 1e9s", "the jump is `1e9s`"),
        ("torque 2 50", "the torque is `50`; write a torque such as 50Nm"),
    ] {
        let error = ScriptLine::parse(line).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{line}: {error}");
    }
    let error = Script::parse("drop 1\n\n# fine\nslow 5\n").unwrap_err();
    assert_eq!(error.to_string(), "line 4: the delay is `5`; write a time such as 1.5s, 20ms or 300us");
}

fn any_fault() -> impl Strategy<Value = Fault> {
    let axis = || (0usize..7).prop_map(|index| Axis::ALL[index]);
    let nanos = || (0u64..5_000_000_000).prop_map(Duration::from_nanos);
    let number = || -500.0..500.0f64;
    prop_oneof![
        (0usize..9, any::<u32>()).prop_map(|(kind, count)| Fault::Reply { kind: ReplyFault::ALL[kind].0, count }),
        (any::<u32>(), nanos()).prop_map(|(count, by)| Fault::Delay { count, by }),
        any::<u32>().prop_map(|count| Fault::Deaf { count }),
        any::<bool>().prop_map(Fault::Silence),
        nanos().prop_map(Fault::Slow),
        (axis(), any::<u8>(), any::<bool>()).prop_map(|(axis, code, only_reported)| Fault::ServoAlarm {
            axis,
            alarm: ServoAlarm::from_code(code),
            only_reported
        }),
        (any::<u8>(), any::<bool>()).prop_map(|(code, only_reported)| Fault::ControllerAlarm {
            alarm: CommAlarm::from_code(code),
            only_reported
        }),
        any::<bool>().prop_map(|pressed| Fault::EmergencyStop { pressed }),
        any::<bool>().prop_map(|held| Fault::DeadMan { held }),
        any::<bool>().prop_map(|open| Fault::LimitSwitch { open }),
        any::<bool>().prop_map(|on| Fault::TeachingSwitch { on }),
        any::<bool>().prop_map(|high| Fault::PowerTemperature { high }),
        any::<bool>().prop_map(|on| Fault::ServoPower { on }),
        any::<bool>().prop_map(|on| Fault::Power { on }),
        Just(Fault::TimeOut),
        (axis(), any::<bool>()).prop_map(|(axis, on)| Fault::Stuck { axis, on }),
        (axis(), prop::option::of(number()))
            .prop_map(|(axis, velocity_rad_per_s)| Fault::Runaway { axis, velocity_rad_per_s }),
        (axis(), number()).prop_map(|(axis, by_rad)| Fault::Jump { axis, by_rad }),
        (axis(), number()).prop_map(|(axis, torque_n_m)| Fault::Torque { axis, torque_n_m }),
        line_fault().prop_map(Fault::Line),
    ]
}

fn line_fault() -> impl Strategy<Value = LineFault> {
    let nanos = || (0u64..5_000_000_000).prop_map(Duration::from_nanos);
    prop_oneof![
        (0usize..5, any::<u32>()).prop_map(|(kind, count)| LineFault::Answers { kind: ReplyFault::ALL[kind].0, count }),
        any::<u32>().prop_map(|count| LineFault::WrongArm { count }),
        (any::<u32>(), nanos()).prop_map(|(count, by)| LineFault::Delay { count, by }),
        nanos().prop_map(LineFault::Slow),
        any::<bool>().prop_map(LineFault::Silence),
        any::<bool>().prop_map(LineFault::Deaf),
        prop::option::of(any::<u32>()).prop_map(|bytes_per_second| LineFault::SlowReader { bytes_per_second }),
        (any::<bool>(), -100_000_000_000_000..100_000_000_000_000i64).prop_map(|(is_host, by_us)| {
            LineFault::ClockJump { side: if is_host { Side::Host } else { Side::Gateway }, by_us }
        }),
    ]
}

proptest! {
    #[test]
    fn a_fault_reads_as_it_is_written(fault in any_fault()) {
        let line = ScriptLine { when: When::Now, fault };
        prop_assert_eq!(parse(&line.to_string()), line);
    }

    #[test]
    fn any_text_is_a_script_or_an_error(text in "\\PC{0,60}") {
        Script::parse(&text).ok();
    }

    #[test]
    fn any_words_are_a_line_or_an_error(words in prop::collection::vec("at|in|chance|at-most|drop|alarm|runaway|jump|slow|1|7|off|on|0x0e|1%|1s|-3ms|1e400s|9rad", 0..7)) {
        ScriptLine::parse(&words.join(" ")).ok();
    }
}

/// docs/mock-arm.md: its examples can be typed unchanged, and it lists every fault.
#[test]
fn the_documentation_says_what_the_parser_reads() {
    let page = include_str!("../../../docs/mock-arm.md");
    let example = page.split("```mock-arm\n").nth(1).unwrap().split("```").next().unwrap();
    assert_eq!(Script::parse(example).unwrap().lines.len(), 4);
    let table_line =
        |name: &str| page.lines().any(|line| line.starts_with("| `") && line.contains(&format!("`{name}")));
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    for _ in 0..400 {
        let name = any_fault().new_tree(&mut runner).unwrap().current().name();
        assert!(table_line(name), "{name}");
    }
    // Lines of the table with their placeholders filled in.
    let filled = |line: &str| {
        let mut line = line.to_owned();
        for (placeholder, value) in [
            ("AXIS", "3"),
            ("CODE", "0x0e"),
            ("TIME", "2ms"),
            ("SPEED", "9deg/s"),
            ("ANGLE", "1deg"),
            ("TORQUE", "9Nm"),
            ("RATE", "600B/s"),
            (" N", " 2"),
        ] {
            line = line.replace(placeholder, value);
        }
        line
    };
    let faults = page.split("## Faults").nth(1).unwrap().split("Codes are").next().unwrap();
    let first_cells = faults.lines().filter(|line| line.starts_with("| `")).filter_map(|line| line.split('|').nth(1));
    let mut read = 0;
    for cell in first_cells.flat_map(|cell| cell.split('`').skip(1).step_by(2)).filter(|cell| !cell.starts_with("..."))
    {
        parse(&filled(cell));
        read += 1;
    }
    assert!(read > 30, "{read}");
}

/// docs/mock-arm.md; that its tests exist, `cargo xtask tidy` checks (rule `named-item`).
#[test]
fn the_documentation_names_a_test_of_each_fault_of_the_requirements() {
    let page = include_str!("../../../docs/mock-arm.md");
    let table = page.split("## The test set").nth(1).unwrap().split("\n## ").next().unwrap();
    for fault in [
        "drop",
        "delay",
        "duplicate",
        "reorder",
        "corrupt",
        "truncate",
        "wrong sequence",
        "wrong arm",
        "stale state",
        "alarm code",
        "emergency stop",
        "power off",
        "time-out",
        "unplugged",
        "half-open",
        "slow reader",
        "clock that jumps",
    ] {
        let row = table.lines().find(|line| line.split('|').nth(1).is_some_and(|cell| cell.contains(fault)));
        assert!(row.is_some_and(|row| row.contains("::")), "{fault}");
    }
}
