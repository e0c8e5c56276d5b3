//! Status words: what is unknown inhibits motion, `pb3dp arm signals` finds the bits, and their signals stop the arm.

use std::path::PathBuf;

use pb3dp_test_support::{beside_each_other, programs_in_real_time_beside_others};
use tempfile::TempDir;

use crate::cli::mock_arm::MockArm;
use crate::cli::support::{Finished, key_file, pb3dp};
use crate::real_time::arm::{Cell, FIRST_RUN, START_DEG, pb3dp_arm, setup_at, while_it_moves, write_setup};

/// As printed for the emulated controller.
const LINES: &str = "emergency_stop = \"controller 0x0008 set\"\nlimit_switch = \"controller 0x2000 set\"\n\
                     dead_man = \"controller 0x0001 clear\"\npower = \"controller 0x0004 clear\"";

/// A setup whose arm with the cameras has this wire format, at an address, with these signals.
fn setup(wire_format: &str, address: Option<&str>, signals: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_setup(&folder, |vs| {
        let vs = vs.replacen("wire_format = \"B\"", &format!("wire_format = \"{wire_format}\""), 1);
        let Some(address) = address else { return vs };
        let vs = vs.replacen("backend = \"emulated\"", "backend = \"tcp\"", 1);
        let line = format!("\naddress = \"{address}\"\nkey_file = \"{}\"\narm = 1 ", key_file().display());
        vs.replacen("\narm = 1 ", &line, 1).replacen("\n\n", &format!("\n\n{signals}\n\n"), 1)
    });
    folder
}

fn config(folder: &TempDir) -> String {
    folder.path().join("cell.toml").display().to_string()
}

/// Like [`Cell::start`], in format A.
fn cell(args: &[&str], signals: &str) -> Cell {
    let start = ["--tcp", "127.0.0.1:0", "--priority", "45", "--format", "a", "--pose-deg", START_DEG];
    let mut arm = MockArm::start(&[&start, args].concat());
    let address = arm.line();
    Cell { arm, folder: setup("A", Some(&address), signals) }
}

fn table(lines: &str) -> String {
    format!("[arms.vs.gateway.signals]\n{lines}")
}

#[test]
fn an_arm_whose_status_words_are_unknown_does_not_move() {
    // Nobody listens at this port: the refusal comes first.
    let parts = [
        "arms.vs.gateway.signals.emergency_stop, arms.vs.gateway.signals.limit_switch",
        "arms.vs.gateway.signals.power unknown",
        "`pb3dp arm signals` finds the bits",
    ];
    let folder = setup("A", Some("127.0.0.1:9"), "");
    let run = |folder: &TempDir| -> Finished {
        let out = folder.path().join("out").display().to_string();
        pb3dp(&[&["run", "--config", &config(folder), "--out", &out, "--move"], &FIRST_RUN[..]].concat())
    };
    run(&folder).assert_refused(&parts);
    pb3dp_arm(&config(&folder), &["jog", "--axis", "7", "--by", "1", "--move"], Some("vs-robot"))
        .assert_refused(&parts);
    let one = table(&LINES.replace("controller 0x0008 set", "unknown"));
    run(&setup("A", Some("127.0.0.1:9"), &one)).assert_refused(&["arms.vs.gateway.signals.emergency_stop unknown"]);
    let zero = table(&LINES.replace("0x0008", "0x0000"));
    for format in ["A", "B"] {
        run(&setup(format, Some("127.0.0.1:9"), &zero)).assert_refused(&[
            "arms.vs.gateway.signals.emergency_stop",
            "has no bit: the signal would never be noticed",
        ]);
    }
    // The sources state the bits of format B.
    let b: PathBuf = setup_at("127.0.0.1:9").keep();
    let words = ["run", "--config", b.join("cell.toml").to_str().unwrap(), "--move", "--out", b.to_str().unwrap()]
        .map(str::to_owned);
    let words: Vec<&str> = words.iter().map(String::as_str).chain(FIRST_RUN).collect();
    assert!(!pb3dp(&words).stderr.contains("signals"), "format B is known");
    std::fs::remove_dir_all(b).unwrap();
}

#[test]
fn bits_are_found_on_an_emulated_arm() {
    programs_in_real_time_beside_others(|| {
        let folder = setup("A", None, "");
        let learnt = pb3dp_arm(&config(&folder), &["signals", "--operator", "emulated"], None).assert_success().stdout;
        assert!(learnt.contains(&format!("[arms.vs.gateway.signals]\n{LINES}\n")), "{learnt}");
        assert!(learnt.contains(&format!("[arm.signals]\n{LINES}\n")), "{learnt}");
        assert!(learnt.contains("emergency stop: changed: controller 0x0008 set"), "{learnt}");
    });
}

/// With the bits that were found in its setup, an arm that moves stops for each signal, and says why.
#[test]
fn each_signal_stops_the_arm_with_the_exact_cause() {
    let signals = [
        ("e-stop press", "shows the emergency stop by the bits of the configuration"),
        ("limit-switch open", "shows the limit switch by the bits of the configuration"),
        ("dead-man release", "shows the dead-man switch by the bits of the configuration"),
        ("servo-power off", "uncontrollable"),
    ];
    programs_in_real_time_beside_others(|| {
        beside_each_other(signals, |(line, cause)| {
            let mut cell = cell(&[], &table(LINES));
            let (code, stderr) = while_it_moves(&mut cell, |cell, _| cell.arm.say(line));
            assert!(code == Some(1) && stderr.contains(cause), "{cause:?} is missing in:\n{stderr}");
            cell.arm.quit();
        });
    });
}

#[test]
fn an_emergency_stop_is_reset_when_its_bit_is_clear() {
    programs_in_real_time_beside_others(|| {
        let mut cell = cell(&[], &table(LINES));
        cell.arm.say("e-stop press");
        let jog = ["jog", "--axis", "7", "--by", "1", "--move"];
        let part = "shows the emergency stop";
        cell.pb3dp(&jog, Some("vs-robot")).assert_refused(&[part]);
        cell.pb3dp(&["reset"], Some("vs-robot")).assert_refused(&["it is not reset", part]);
        cell.arm.say("e-stop release");
        cell.pb3dp(&["reset"], Some("vs-robot")).assert_success();
        cell.arm.quit();
    });
}

#[test]
fn a_gateway_that_does_not_know_the_bits_opens_no_brake() {
    programs_in_real_time_beside_others(|| {
        let mut cell = cell(&["--unknown-signals"], &table(LINES));
        let jog = cell.pb3dp(&["jog", "--axis", "7", "--by", "1", "--move"], Some("vs-robot"));
        jog.assert_refused(&["a signal that the gateway does not know ([arm.signals] in its file)"]);
        assert!(cell.joints().1, "the brakes are closed");
        cell.arm.quit();
    });
}
