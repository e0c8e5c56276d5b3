//! `pb3dp arm test`: rehearsed by the program on emulated arms, and by a person at an arm in a program of its own.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink as _;
use serde_json::Value;
use tempfile::TempDir;

use crate::cli::silent_gateway::{Hosts, UnwatchedGateway};
use crate::real_time::arm::{Cell, START_DEG, command, hil, interrupt, pb3dp_arm, setup_at};
use pb3dp_test_support::programs_in_real_time_beside_others;

const STEPS: [&str; 6] = ["comms", "jog", "e-stop", "cable", "kill", "interlock"];

/// The result of each step, and of all.
fn results(report: &Value) -> (Vec<&str>, &str) {
    let steps = report["steps"].as_array().unwrap();
    assert_eq!(steps.iter().map(|step| step["step"].as_str().unwrap()).collect::<Vec<_>>(), STEPS);
    (steps.iter().map(|step| step["result"].as_str().unwrap()).collect(), report["result"].as_str().unwrap())
}

fn report_in(folder: &Path) -> (Value, String) {
    let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    (serde_json::from_str(&text("report.json")).unwrap(), text("report.md"))
}

/// The folder of a report that is not there yet.
fn folder() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("report");
    (folder, out)
}

#[test]
fn the_whole_checklist_is_rehearsed_on_emulated_arms() {
    programs_in_real_time_beside_others(|| {
        let (_folder, out) = folder();
        let out_text = out.display().to_string();
        let args = ["test", "--operator", "emulated", "--by", "1.5", "--move", "--out", &out_text];
        let done = pb3dp_arm(&hil(), &args, Some("vs-robot"));
        assert!(done.success, "{}{}", done.stdout, done.stderr);
        let (report, page) = report_in(&out);
        assert_eq!(results(&report), (vec!["passed"; 6], "passed"), "{}", done.stdout);
        let printed = Command::new("sha256sum").arg(out.join("settings.toml")).output().unwrap().stdout;
        assert!(String::from_utf8(printed).unwrap().starts_with(report["config_sha256"].as_str().unwrap()));
        assert_eq!(report["gateway"]["firmware"], "pb3dp emulation");
        assert!(report["gateway"]["wire_format"].as_str().unwrap().starts_with("format B"), "{report}");
        let figure = &report["steps"][1]["figures"][2];
        assert_eq!((&figure["limit"], &figure["unit"]), (&0.05.into(), &"deg".into()), "{figure}");
        assert!(figure["value"].as_f64().unwrap() < 0.05, "{figure}");
        pb3dp_arm(&hil(), &args, Some("vs-robot")).assert_refused(&["there is a report already; use another --out"]);
        assert_eq!((&report["operator"], &report["is_emulated"]), (&"emulated".into(), &true.into()));
        for (step, least) in report["steps"].as_array().unwrap().iter().zip([7, 12, 9, 7, 5, 9]) {
            let figures = step["figures"].as_array().unwrap();
            assert!(figures.len() >= least, "{step}");
            assert!(figures.iter().all(|figure| figure["passed"] == true), "{step}");
            assert!(!step["answers"].as_array().unwrap().is_empty(), "{step}");
            assert!(step["took_s"].as_f64().unwrap() > 0.1 && step["monotonic_s"].as_f64().unwrap() > 0.0, "{step}");
            let began = step["began"].as_str().unwrap();
            assert!(began.starts_with("20") && began.ends_with('Z') && began.len() == 20, "{began}");
        }
        for part in [
            "# Test of the vs-robot: passed",
            "emulated, no hardware was tested",
            "stopped after 50 ms",
            "## kill: passed",
            "| the gateway has stopped the arm by itself | fault, cause: host-silent | has to hold | ok |",
            "deg | at most 0.05 deg | ok |",
        ] {
            assert!(page.contains(part), "{part:?} is missing in:\n{page}");
        }
    });
}

#[test]
fn nothing_moves_in_a_dry_run_or_without_the_name() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let before = cell.joints();
        let (_folder, out) = folder();
        let out_text = out.display().to_string();
        let args = ["test", "--axis", "4", "--by", "2", "--skip", "kill", "--out", &out_text];
        let dry = cell.pb3dp(&args, Some("vs-robot")).assert_success().stdout;
        for part in [
            "4 of 6 steps",
            "2. jog: one axis at 0.02 rad/s, there and back",
            "at most 1 % lost",
            "4 E1    97.490    99.490    +2.000",
            "4 E1    97.490    95.490    -2.000",
            "within 3.6 s",
            "clearance to the tc-robot (emulated, at its start pose)",
            "warning: --by 2.0: after NOW you have 2.4 s until the move ends, and a person needs 4 s; use --by 4 or more",
            "dry run: the brakes stayed on and nothing moved",
        ] {
            assert!(dry.contains(part), "{part:?} is missing in:\n{dry}");
        }
        assert!(!dry.contains("kill") && !dry.contains("interlock"), "{dry}");
        let args = [&args[..], &["--move"]].concat();
        cell.pb3dp(&args, None).assert_refused(&["vs-robot was not typed", "nothing was moved"]);
        for wrong in ["tc-robot", "yes", ""] {
            cell.pb3dp(&args, Some(wrong)).assert_refused(&["is not vs-robot", "nothing was moved"]);
        }
        let late = [&args[..], &["--patience", "1"]].concat();
        let waiting = Rehearsal::start(&cell.config(), &late);
        let (code, text) = waiting.finish();
        assert!(code == Some(1) && text.contains("vs-robot was not typed in time"), "{text}");
        assert_eq!(cell.joints(), before);
        assert!(before.1 && !out.exists());
        cell.arm.quit();
    });
}

#[test]
fn what_can_not_be_tested_is_refused_before_anything_happens() {
    let real = setup_at("127.0.0.1:9");
    let config = real.path().join("cell.toml").display().to_string();
    let refused = |config: &str, args: &[&str], parts: &[&str]| {
        pb3dp_arm(config, &[&["test"], args].concat(), Some("vs-robot")).assert_refused(parts);
    };
    refused(&config, &["--operator", "emulated", "--move"], &["arms.vs.backend is not \"emulated\"", "cannot operate"]);
    refused(&config, &[], &["127.0.0.1:9"]);
    refused(&hil(), &["--move"], &["has no switch and no cable for you", "--operator emulated"]);
    refused(&hil(), &["--only", "interlock", "--move"], &["has no switch and no cable for you"]);
    refused(&hil(), &["--alone", "--only", "interlock"], &["remove --alone"]);
    let both = ["--only", "interlock", "--move"];
    refused(&config, &both, &["arms.tc.backend = \"emulated\" has no switch"]);
    refused(&hil(), &["--skip", "comms,jog,e-stop,cable,kill"], &["no step is left"]);
    let sim = crate::cli::support::repository().join("configs/sim.toml").display().to_string();
    refused(&sim, &["--operator", "emulated"], &["arms.vs.backend is not \"emulated\""]);
    // The way back or there leads out of the operating range.
    let cell = Cell::start(&["--pose-deg", "0,80,0,97,0,-50,0"]);
    let far = cell.pb3dp(&["test", "--axis", "2", "--by", "9", "--move"], Some("vs-robot"));
    far.assert_refused(&["axis 2 (S2) would end at 89.000 degrees"]);
    cell.arm.quit();
}

/// `pb3dp arm test` with a person at its keyboard: this test.
struct Rehearsal {
    child: Child,
    input: ChildStdin,
    lines: Receiver<String>,
    output_text: String,
}

impl Rehearsal {
    fn start(config: &Path, args: &[&str]) -> Self {
        let mut child = command(&config.display().to_string(), args).spawn().unwrap();
        let (input, output) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines() {
                // Nobody may be left who reads it.
                sender.send(line.unwrap()).ok();
            }
        });
        Self { child, input, lines, output_text: String::new() }
    }

    /// With the steps that are named, by moves of 2 degrees.
    fn of(cell: &Cell, steps: &str, out: &Path) -> Self {
        let out = out.display().to_string();
        let mut begun = Self::start(
            &cell.config(),
            &["test", "--only", steps, "--by", "2", "--axis", "4", "--move", "--out", &out],
        );
        begun.answer("Type vs-robot to begin:", "vs-robot");
        begun
    }

    fn until(&mut self, part: &str) {
        let since = Instant::now();
        loop {
            let Ok(line) = self.lines.recv_timeout(Duration::from_secs(40)) else {
                self.child.kill().unwrap();
                self.child.stderr.take().unwrap().read_to_string(&mut self.output_text).unwrap();
                panic!("{part:?} did not come:\n{}", self.output_text);
            };
            self.output_text += &format!("{line}\n");
            if line.contains(part) {
                return;
            }
            assert!(since.elapsed() < Duration::from_secs(60), "{part:?} did not come:\n{}", self.output_text);
        }
    }

    /// A complaint comes before the question; else a panic with what the gateway says of itself.
    fn complains(&mut self, complaint: &str, question: &str, cell: &Cell) {
        let end = |output_text: &str| output_text.contains(complaint) || output_text.contains(question);
        let before = self.output_text.len();
        while !end(&self.output_text[before..]) {
            self.until("");
        }
        if !self.output_text[before..].contains(complaint) {
            self.child.kill().unwrap();
            self.child.wait().unwrap();
            let probe = cell.pb3dp(&["probe", "--exchanges", "10"], None);
            panic!("{complaint:?} did not come:\n{}{}{}", self.output_text, probe.stdout, probe.stderr);
        }
    }

    fn answer(&mut self, part: &str, line: &str) {
        self.until(part);
        writeln!(self.input, "{line}").unwrap();
    }

    /// Its exit code, and all that it said.
    fn finish(mut self) -> (Option<i32>, String) {
        let since = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(since.elapsed() < Duration::from_secs(60), "it does not end:\n{}", self.output_text);
            std::thread::sleep(Duration::from_millis(10));
        };
        self.output_text.extend(self.lines.iter().map(|line| line + "\n"));
        self.child.stderr.take().unwrap().read_to_string(&mut self.output_text).unwrap();
        assert!(!self.output_text.contains("panicked"), "{}", self.output_text);
        (status.code(), self.output_text)
    }
}

#[test]
fn a_person_tests_the_stops_of_an_arm() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let (_folder, out) = folder();
        let mut test = Rehearsal::of(&cell, "e-stop,cable,kill", &out);
        test.answer("While it moves: Press the emergency stop of the vs-robot.", "");
        test.until("NOW: Press the emergency stop of the vs-robot");
        cell.arm.say("e-stop press");
        test.answer("Did the vs-robot stop at once", "yes");
        test.until("Release the emergency stop of the vs-robot.");
        cell.arm.say("e-stop release");
        test.answer("Press Enter", "");
        // A cable of a network that is pulled closes nothing: the line falls silent.
        test.answer("While it moves: Pull the cable to the gateway of the vs-robot.", "");
        test.until("NOW: Pull the cable");
        cell.arm.say("line deaf on");
        cell.arm.say("line silence on");
        test.answer("Did the vs-robot stop at once", "maybe");
        test.answer("Did the vs-robot stop at once", "y");
        test.until("Plug the cable to the gateway of the vs-robot in again.");
        cell.arm.say("line deaf off");
        cell.arm.say("line silence off");
        test.answer("Press Enter", "");
        test.answer("is killed during the move", "");
        test.answer("Did the vs-robot stop at once", "yes");
        test.answer("Next, the arm is reset.", "");
        let (code, text) = test.finish();
        let (report, _) = report_in(&out);
        let expected = vec!["skipped", "skipped", "passed", "passed", "passed", "skipped"];
        assert_eq!(results(&report), (expected, "incomplete"), "{text}");
        assert_eq!((code, &report["operator"]), (Some(0), &"person".into()));
        assert!(cell.joints().1, "all brakes are closed");
        cell.arm.quit();
    });
}

/// Runs one step on an arm that is said to be so; its figures have to complain of this, and the report to say so.
fn fails(step: &str, cell: &mut Cell, acts: impl FnOnce(&mut Rehearsal, &mut Cell), complaint: &str) {
    let (_folder, out) = folder();
    let mut test = Rehearsal::of(cell, &format!("{step},kill"), &out);
    acts(&mut test, cell);
    let (code, text) = test.finish();
    let (report, page) = report_in(&out);
    let failed = report["steps"].as_array().unwrap().iter().find(|found| found["step"] == step).unwrap();
    assert_eq!((code, &report["result"], &failed["result"]), (Some(1), &"failed".into(), &"failed".into()), "{text}");
    let reasons = failed["reasons"].to_string();
    assert!(reasons.contains(complaint), "{complaint:?} is missing in:\n{failed}\n{text}");
    assert!(!reasons.contains("delayed the control loop"), "the program itself was slow to stop it: {reasons}");
    assert!(page.contains(&format!("## {step}: failed")), "{page}");
    let after = &report["steps"][4];
    assert!(after["result"] == "skipped" && after["reasons"].to_string().contains("did not pass"), "{after}");
    if step != "comms" {
        let flight = Path::new(failed["flights"][0].as_str().unwrap());
        let lines = std::fs::read_to_string(flight).unwrap();
        assert!(lines.lines().count() > 50, "{}", flight.display());
    }
}

#[test]
fn an_arm_that_is_not_as_it_has_to_be_fails() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG, "--fault", "at 0s runaway 4 -0.02rad/s"]);
        let wrong_way = |test: &mut Rehearsal, _: &mut Cell| test.answer("Press Enter", "");
        fails("jog", &mut cell, wrong_way, "axis 4 (E1) turns the wrong way");
        assert!(cell.joints().1, "all brakes are closed");
        cell.arm.quit();

        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let pose = |test: &mut Rehearsal, _: &mut Cell| {
            // What is typed before it is asked for does not count.
            test.answer("comms: messages only", "yes");
            test.answer("Are the joints, from the base, at 0.0, 45.4", "no");
        };
        fails("comms", &mut cell, pose, "the operator answered no: Are the joints");
        let unwilling = |test: &mut Rehearsal, _: &mut Cell| test.answer("Press Enter", "there is a cat");
        fails_without_motion(&mut cell, unwilling);
        cell.arm.quit();
    });
}

fn fails_without_motion(cell: &mut Cell, acts: impl FnOnce(&mut Rehearsal, &mut Cell)) {
    let (_folder, out) = folder();
    let before = cell.joints();
    let mut test = Rehearsal::of(cell, "jog", &out);
    acts(&mut test, cell);
    let (code, text) = test.finish();
    assert!(code == Some(1) && text.contains("the operator did not go on: \"there is a cat\""), "{text}");
    assert_eq!(cell.joints(), before);
}

#[test]
fn an_emergency_stop_that_does_not_stop_fails() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let nobody = |test: &mut Rehearsal, _: &mut Cell| test.answer("Press Enter", "");
        fails("e-stop", &mut cell, nobody, "the move ended without a stop (Press the emergency stop");
        assert!(cell.joints().1, "all brakes are closed");
        // The arm goes on for a while: so it looks from here.
        let late = |test: &mut Rehearsal, cell: &mut Cell| {
            test.answer("Press Enter", "");
            test.until("NOW: Press");
            cell.arm.say("in 40ms jump 4 3deg");
            cell.arm.say("e-stop press");
            test.answer("Did the vs-robot stop at once", "yes");
            test.until("Release the emergency stop of the vs-robot.");
            cell.arm.say("e-stop release");
            test.answer("Press Enter", "");
        };
        fails("e-stop", &mut cell, late, ", the joint that moved farthest: ");
        cell.arm.quit();
    });
}

#[test]
fn a_gateway_that_does_not_watch_its_host_fails() {
    for (hosts, found) in
        [(Hosts::All, "the gateway has stopped the arm by itself"), (Hosts::UntilAKill, "it cannot connect: ")]
    {
        programs_in_real_time_beside_others(|| a_kill_leaves_it_moving(hosts, found));
    }
}

fn a_kill_leaves_it_moving(hosts: Hosts, found: &str) {
    let mut arm =
        crate::cli::mock_arm::MockArm::start(&["--tcp", "127.0.0.1:0", "--priority", "45", "--pose-deg", START_DEG]);
    let gateway = UnwatchedGateway::start(&arm.line(), hosts);
    let cell_folder = setup_at(&gateway.address());
    let mut cell = Cell { arm, folder: cell_folder };
    let (_folder, out) = folder();
    let mut test = Rehearsal::of(&cell, "kill", &out);
    test.answer("is killed during the move", "");
    test.complains("PRESS THE EMERGENCY STOP", "Did the vs-robot stop at once", &cell);
    test.answer("Did the vs-robot stop at once", "no");
    let (code, text) = test.finish();
    let (report, _) = report_in(&out);
    let complaints = report["steps"][4]["reasons"].to_string();
    assert_eq!(code, Some(1), "{text}");
    for part in [found, "the operator answered no"] {
        assert!(complaints.contains(part), "{part:?} is missing in {complaints}\n{text}");
    }
    let turned_deg = cell.joints().0[3] - crate::real_time::arm::START_E1_DEG;
    assert!(turned_deg > 2.5, "it went on by itself: {turned_deg}");
    cell.arm.quit();
}

/// The name was typed for other settings: with exchanged addresses it would be the other arm.
#[test]
fn a_setup_that_changes_during_the_checklist_moves_no_arm() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let (_folder, out) = folder();
        let mut test = Rehearsal::of(&cell, "kill", &out);
        let before = std::fs::read_to_string(cell.config()).unwrap();
        std::fs::write(cell.config(), before.replacen("arm = 1 ", "arm = 2 ", 1)).unwrap();
        test.answer("is killed during the move", "");
        let (code, text) = test.finish();
        assert_ne!(code, Some(0), "{text}");
        let turned_deg = cell.joints().0[3] - crate::real_time::arm::START_E1_DEG;
        assert!(turned_deg.abs() < 0.01 && cell.joints().1, "{turned_deg}: {text}");
        cell.arm.quit();
    });
}

#[test]
fn an_arm_that_goes_on_while_the_cable_is_pulled_fails() {
    programs_in_real_time_beside_others(|| {
        let mut arm = crate::cli::mock_arm::MockArm::start(&[
            "--tcp",
            "127.0.0.1:0",
            "--priority",
            "45",
            "--pose-deg",
            START_DEG,
        ]);
        let gateway = UnwatchedGateway::start(&arm.line(), Hosts::All);
        let mut cell = Cell { arm, folder: setup_at(&gateway.address()) };
        let acts = |test: &mut Rehearsal, _: &mut Cell| {
            test.answer("While it moves: Pull the cable", "");
            test.until("NOW: Pull the cable");
            gateway.plug(false);
            test.answer("Did the vs-robot stop at once", "no");
            test.until("PRESS THE EMERGENCY STOP of the vs-robot");
            test.until("Plug the cable to the gateway of the vs-robot in again.");
            gateway.plug(true);
            test.answer("Press Enter", "");
        };
        fails("cable", &mut cell, acts, ", the joint that moved farthest since the last measurement: ");
        cell.arm.quit();
    });
}

#[test]
fn a_signal_ends_a_step_by_the_stop_order_with_a_partial_report() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let (_folder, out) = folder();
        let mut test = Rehearsal::of(&cell, "comms,jog,kill", &out);
        test.answer("Are the joints, from the base, at", "yes");
        test.answer("Press Enter", "");
        let since = Instant::now();
        while cell.joints().0[3] < crate::real_time::arm::START_E1_DEG + 0.2 {
            assert!(since.elapsed() < Duration::from_secs(20), "it does not move");
            std::thread::sleep(Duration::from_millis(20));
        }
        interrupt(test.child.id());
        let (code, text) = test.finish();
        let (report, page) = report_in(&out);
        let expected = vec!["passed", "interrupted", "skipped", "skipped", "skipped", "skipped"];
        assert_eq!(results(&report), (expected, "interrupted"), "{text}");
        assert!(code == Some(1) && page.contains("ended by SIGINT"), "{text}");
        assert!(text.contains("the stop order given"), "{text}");
        let (after, is_braked) = cell.joints();
        assert!(is_braked && after[3] < crate::real_time::arm::START_E1_DEG + 1.9, "{after:?}");

        // While another program moves the arm: that one ends by its stop order, too.
        let (_folder, out) = folder();
        let mut test = Rehearsal::of(&cell, "kill", &out);
        test.answer("is killed during the move", "");
        let start_deg = cell.joints().0[3];
        while (cell.joints().0[3] - start_deg).abs() < 0.1 {
            assert!(since.elapsed() < Duration::from_secs(60), "it does not move");
            std::thread::sleep(Duration::from_millis(10));
        }
        let sent = Command::new("kill").args(["-TERM", &test.child.id().to_string()]).stdout(Stdio::null()).status();
        assert!(sent.unwrap().success());
        let (code, text) = test.finish();
        let (report, _) = report_in(&out);
        assert_eq!((code, &report["result"]), (Some(1), &"interrupted".into()), "{text}");
        assert!(cell.joints().1, "all brakes are closed");
        let probe = cell.pb3dp(&["probe", "--exchanges", "20"], None).assert_success().stdout;
        assert!(probe.contains("no problems found"), "nothing has to be reset: {probe}");
        cell.arm.quit();
    });
}

/// A person who types stop beside a moving arm must not wait for the end of its move.
#[test]
fn a_stop_that_is_typed_ends_a_step_while_the_arm_moves() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        for (step, number, question) in [("jog", 1, "Press Enter"), ("kill", 4, "is killed during the move")] {
            let (_folder, out) = folder();
            let mut test = Rehearsal::of(&cell, step, &out);
            test.answer(question, "");
            let start_deg = cell.joints().0[3];
            let since = Instant::now();
            while (cell.joints().0[3] - start_deg).abs() < 0.2 {
                assert!(since.elapsed() < Duration::from_secs(20), "{step}: it does not move");
                std::thread::sleep(Duration::from_millis(10));
            }
            writeln!(test.input, "\nstop").unwrap();
            let (code, text) = test.finish();
            let (report, _) = report_in(&out);
            let found = &report["steps"][number];
            assert_eq!((code, &found["result"]), (Some(1), &"interrupted".into()), "{step}: {text}");
            assert!(found["reasons"].to_string().contains("ended by \\\"stop\\\", which was typed"), "{step}: {found}");
            let (after, is_braked) = cell.joints();
            assert!(is_braked && (after[3] - start_deg).abs() < 1.5, "{step}: {after:?}");
        }
        cell.arm.quit();
    });
}

#[test]
fn nobody_at_the_keyboard_ends_a_step_while_the_arm_moves() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let (_folder, out) = folder();
        let out_text = out.display().to_string();
        let silent = ["--set", "supervisor.operator_key_within_s=5"];
        let args = ["test", "--only", "jog", "--by", "10", "--axis", "4", "--move", "--out", &out_text];
        let mut test = Rehearsal::start(&cell.config(), &[&args[..], &silent].concat());
        test.answer("Type vs-robot to begin:", "vs-robot");
        test.answer("Press Enter", "");
        let start_deg = cell.joints().0[3];
        test.until("are you there? press Enter now");
        let (code, text) = test.finish();
        let (report, _) = report_in(&out);
        let found = &report["steps"][1];
        assert_eq!((code, &found["result"]), (Some(1), &"interrupted".into()), "{text}");
        assert!(found["reasons"].to_string().contains("operator_silent"), "{found}");
        let (after, is_braked) = cell.joints();
        // Within 5 s the speed grows to 0.02 rad/s.
        let turned_deg = (after[3] - start_deg).abs();
        assert!(is_braked && (0.1..7.0).contains(&turned_deg), "{start_deg} {after:?}");
        cell.arm.quit();
    });
}

/// A pass that the commissioning record states was not followed by a failure or an interruption of the same step.
#[test]
fn no_interruption_of_a_step_leaves_its_earlier_pass_in_the_record() {
    programs_in_real_time_beside_others(|| {
        let cell = Cell::start(&["--pose-deg", START_DEG]);
        let text = std::fs::read_to_string(cell.config()).unwrap();
        let named = text.replacen("[arms.vs]", "[arms.vs]\ncommissioning_record = \"vs.json\"", 1);
        std::fs::write(cell.config(), named).unwrap();
        let file = cell.folder.path().join("vs.json");
        let has_comms = || {
            let record: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
            assert!(record["setup"]["signals"]["emergency_stop"].is_string(), "{record}");
            record["steps"].get("comms").is_some()
        };
        let begin = |cell: &Cell, out: &Path| {
            let mut test = Rehearsal::of(cell, "comms", out);
            test.until("Are the joints, from the base, at");
            test
        };
        let pass = |cell: &Cell| {
            let (_folder, out) = folder();
            let mut test = begin(cell, &out);
            writeln!(test.input, "yes").unwrap();
            let (code, text) = test.finish();
            assert!(code == Some(0) && has_comms(), "{text}");
        };
        pass(&cell);
        // The report cannot be written: the answer counts all the same.
        let (_folder, out) = folder();
        let mut test = begin(&cell, &out);
        std::fs::remove_dir_all(&out).unwrap();
        writeln!(test.input, "no").unwrap();
        let (code, text) = test.finish();
        assert!(code == Some(1) && text.contains("report.json: cannot be written"), "{text}");
        assert!(!has_comms(), "{text}");
        pass(&cell);
        // Power failure of this computer, or a program that is killed.
        let (_folder, out) = folder();
        let mut test = begin(&cell, &out);
        test.child.kill().unwrap();
        test.child.wait().unwrap();
        assert!(!has_comms());
        cell.arm.quit();
    });
}

/// The terminal is closed during a step: nothing can be printed any more, and the report is written all the same.
#[test]
fn a_terminal_that_is_closed_during_a_step_leaves_a_report() {
    programs_in_real_time_beside_others(|| {
        let cell = Cell::start(&["--pose-deg", START_DEG]);
        let (_folder, out) = folder();
        let mut terminal = Pty::open().unwrap();
        let screen = std::fs::File::options().write(true).open(terminal.path()).unwrap();
        let out_text = out.display().to_string();
        let args = ["test", "--only", "comms", "--move", "--out", &out_text];
        let mut child = command(&cell.config().display().to_string(), &args).stdout(screen).spawn().unwrap();
        let mut input = child.stdin.take().unwrap();
        let mut output_text = String::new();
        let mut until = |part: &str| {
            let since = Instant::now();
            while !output_text.contains(part) {
                assert!(since.elapsed() < Duration::from_secs(40), "{part:?} did not come:\n{output_text}");
                let mut bytes = [0; 4096];
                let count = terminal.try_read(&mut bytes).unwrap();
                output_text += &String::from_utf8_lossy(&bytes[..count]);
                std::thread::sleep(Duration::from_millis(10));
            }
        };
        until("Type vs-robot to begin:");
        writeln!(input, "vs-robot").unwrap();
        until("Are the joints, from the base, at");
        drop(terminal);
        writeln!(input, "no").unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(1));
        let (report, _) = report_in(&out);
        assert_eq!(results(&report).0[0], "failed", "{report}");
        cell.arm.quit();
    });
}
