//! `pb3dp arm` against emulated arms: on pseudo-terminals, and in a program of their own behind TCP.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use pb3dp_test_support::programs_in_real_time_beside_others;
use serde_json::Value;
use tempfile::TempDir;

use crate::cli::mock_arm::MockArm;
use crate::cli::support::{Finished, key_file, numbers, replaced, repository};

/// `start_deg` of the arm with the cameras in configs/hil.toml.
pub const START_DEG: &str = "0,45.4169239,0,97.48979119,0,-52.90671509,0";
pub const START_E1_DEG: f64 = 97.48979119;

pub fn hil() -> String {
    repository().join("configs/hil.toml").display().to_string()
}

/// A setup whose arm with the cameras is at a TCP address.
pub struct Cell {
    pub arm: MockArm,
    pub folder: TempDir,
}

impl Cell {
    pub fn start(args: &[&str]) -> Self {
        let mut arm = MockArm::start(&[&["--tcp", "127.0.0.1:0", "--priority", "45"], args].concat());
        let address = arm.line();
        Self { arm, folder: setup_at(&address) }
    }

    pub fn config(&self) -> PathBuf {
        self.folder.path().join("cell.toml")
    }

    pub fn pb3dp(&self, args: &[&str], typed: Option<&str>) -> Finished {
        pb3dp_arm(&self.config().display().to_string(), args, typed)
    }

    /// A jog turns its joint and no other one, and closes the brakes.
    pub fn assert_jogs(&mut self) {
        let (before, _) = self.joints();
        let jog = ["jog", "--axis", "4", "--by", "-0.5", "--move"];
        let done = self.pb3dp(&jog, Some("vs-robot")).assert_success().stdout;
        assert!(done.contains("done: every joint within 0.0"), "{done}");
        let (after, is_braked) = self.joints();
        assert!(is_braked);
        for (joint, (after, before)) in after.iter().zip(&before).enumerate() {
            let by = if joint == 3 { -0.5 } else { 0.0 };
            assert!((after - before - by).abs() < 0.1, "joint {joint}: {before} to {after}");
        }
    }

    /// Angles of the joints, degrees, as they really are, and whether all brakes are closed.
    pub fn joints(&mut self) -> (Vec<f64>, bool) {
        let state = self.arm.state();
        let axes = state.iter().filter_map(|line| line.trim_start().strip_prefix("axis "));
        let angle = |line: &str| line.split_whitespace().nth(2).unwrap().parse().unwrap();
        (axes.map(angle).collect(), state[0].contains("all brakes closed"))
    }
}

/// Settings of a setup like `hil` that arms which are not emulated need before they were commissioned.
pub const FIRST_RUN: [&str; 14] = [
    "--set",
    "arms.first_run=true",
    "--set",
    "arms.speed_scale=0.25",
    "--set",
    "experiment.move_s=4.0",
    "--set",
    "supervisor.policies.target_lost.resume=by-operator",
    "--set",
    "supervisor.policies.position_jump.resume=by-operator",
    "--set",
    "supervisor.policies.orientation_jump.resume=by-operator",
    "--set",
    "supervisor.policies.outlier.resume=by-operator",
];

/// Settings of a run whose poses come from the simulation: rendering takes the machine away from the arms.
pub const WITHOUT_IMAGES: [&str; 2] = ["--set", "estimator.method=geometric"];

pub fn setup_at(address: &str) -> TempDir {
    setup_behind("tcp", &format!("address = \"{address}\"\nkey_file = \"{}\"", key_file().display()))
}

/// With the arm behind a line of this kind, with these keys.
pub fn setup_behind(backend: &str, keys: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_setup(&folder, |vs| {
        let vs = vs.replacen("backend = \"emulated\"", &format!("backend = \"{backend}\""), 1);
        vs.replacen("\narm = 1 ", &format!("\n{keys}\narm = 1 "), 1)
    });
    folder
}

/// The setup `hil` as one complete file: a real arm takes nothing from a base that is built in.
pub fn complete_hil() -> String {
    let sim = std::fs::read_to_string(repository().join("configs/sim.toml")).unwrap();
    let gateway = |arm: &str, number: u32| {
        format!("[arms.{arm}.gateway]\narm = {number} \nwire_format = \"B\" \ngeometry = \"second-generation\" \n\n")
    };
    [
        ("pace = \"fast\"", "pace = \"live\"".to_owned()),
        ("compare = [\"published\"]", "compare = []".to_owned()),
        ("\ndelay_millis = 10.0 ", "\ndelay_millis = 17.0 ".to_owned()),
        ("[arms.tc]", gateway("vs", 1) + "[arms.tc]"),
        ("[mounts]", gateway("tc", 2) + "[mounts]"),
    ]
    .into_iter()
    .fold(sim.replace("backend = \"mock\"", "backend = \"emulated\""), |text, (from, to)| replaced(&text, from, &to))
}

/// A setup as `hil` is, but for what follows on the line `[arms.vs]`.
pub fn write_setup(folder: &TempDir, change: impl Fn(&str) -> String) {
    let text = complete_hil();
    let robots = repository().join("configs/robots").display().to_string();
    let text = text.replace("robot = \"robots/", &format!("robot = \"{robots}/"));
    let (all, vs) = text.split_once("[arms.vs]").unwrap();
    std::fs::write(folder.path().join("cell.toml"), format!("{all}[arms.vs]{}", change(vs))).unwrap();
}

pub fn command(config: &str, args: &[&str]) -> Command {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
    command.args(["arm", args[0], "--config", config, "--arm", "vs"]).args(&args[1..]);
    // As in a release, a process that the command starts included; other tests move their arms beside it.
    let name = format!("pb3dp-test-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
    command.env("PB3DP_TEST_SOLE_PROGRAM", name);
    // Moves that are broken off leave their flight recorders under `out`.
    command.current_dir(env!("CARGO_TARGET_TMPDIR"));
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs `pb3dp arm`; what is typed is all that comes on standard input, which ends if nothing is typed.
pub fn pb3dp_arm(config: &str, args: &[&str], typed: Option<&str>) -> Finished {
    let mut child = command(config, args).spawn().unwrap();
    let mut input = child.stdin.take().unwrap();
    if let Some(line) = typed {
        // It may have ended before.
        writeln!(input, "{line}").ok();
    }
    // The end of the input would stop an arm that moves.
    let _open = typed.map(|_| input);
    let output = child.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    let (stdout, stderr) = (text(output.stdout), text(output.stderr));
    assert!(!stderr.contains("panicked"), "{args:?}:\n{stderr}");
    assert!(matches!(output.status.code(), Some(0 | 1)), "{args:?}: {}\n{stderr}", output.status);
    Finished { success: output.status.success(), stdout, stderr }
}

pub fn json(finished: &Finished) -> Value {
    serde_json::from_str(&finished.stdout).unwrap_or_else(|error| panic!("{error}: {}", finished.stdout))
}

pub fn assert_problem(finished: &Finished, parts: &[&str]) {
    assert!(!finished.success, "{}", finished.stdout);
    for part in parts {
        assert!(finished.stdout.contains(part), "{part:?} is missing in:\n{}{}", finished.stdout, finished.stderr);
    }
}

#[test]
fn a_probe_tells_what_an_arm_is_and_that_it_fits() {
    programs_in_real_time_beside_others(|| {
        let finished = pb3dp_arm(&hil(), &["probe", "--json"], None).assert_success();
        let report = json(&finished);
        assert_eq!(report["arm"], "vs-robot");
        assert_eq!(report["fits"], true);
        assert_eq!(report["gateway"]["firmware"], "pb3dp emulation");
        assert!(report["gateway"]["wire_format"].as_str().unwrap().starts_with("format B"), "{report}");
        assert!(report["link"]["sent"].as_u64().unwrap() >= 200, "{report}");
        let trips = &report["link"]["control_round_trips"];
        assert!(trips["p50_ms"].as_f64() <= trips["p99_ms"].as_f64(), "{report}");
        let joints = report["joints"].as_array().unwrap();
        assert_eq!(joints.len(), 7);
        for joint in joints {
            assert!(joint["from_start_deg"].as_f64().unwrap().abs() < 0.001, "{joint}");
            assert!(numbers(&joint["difference_deg"]).iter().all(|by| by.abs() < 0.001), "{joint}");
        }
        let table = pb3dp_arm(&hil(), &["probe", "--exchanges", "20"], None).assert_success().stdout;
        for part in
            ["gateway: \"pb3dp emulation\"", "1 S1", "-177.000 177.000", "0 lost", "0 resyncs", "no problems found"]
        {
            assert!(table.contains(part), "{part:?} is missing in:\n{table}");
        }
    });
}

#[test]
fn a_probe_says_what_does_not_fit_and_what_to_do() {
    programs_in_real_time_beside_others(|| {
        let cell = Cell::start(&["--limits-deg", "177,90,174,137,255,165,255", "--pose-deg", "171,30,0,60,0,45,0"]);
        let limits = cell.pb3dp(&["probe"], None);
        assert_problem(&limits, &["axis 2 (S2): the controller's limits differ by +1.000 and -1.000", "arms.vs.robot"]);
        assert_problem(&limits, &["axis 1 (S1): 171.000 degrees is outside the operating range", "jog it back"]);
        cell.arm.quit();
        let cell = Cell::start(&["--fault", "at 0s alarm 4 0x0e"]);
        assert_problem(&cell.pb3dp(&["probe"], None), &["axis 4 (E1)", "over-current"]);
        cell.arm.quit();
        let cell = Cell::start(&["--format", "a"]);
        assert_problem(&cell.pb3dp(&["probe"], None), &["format A", "the configuration says format B"]);
        cell.arm.quit();
    });
}

/// R19: who connects to an arm writes down which gateway it was, and which geometry nobody compares.
#[test]
fn what_a_gateway_says_of_itself_is_in_the_log() {
    programs_in_real_time_beside_others(|| {
        let finished = pb3dp_arm(&hil(), &["probe", "--exchanges", "20"], None).assert_success();
        for part in ["vs-robot: gateway \"pb3dp emulation\"", "geometry second-generation", "stopped after 50 ms"] {
            assert!(finished.stderr.contains(part), "{part:?} is missing in:\n{}", finished.stderr);
        }
        assert!(!finished.stderr.contains("the arm geometry is not set"), "{}", finished.stderr);
        let cell = Cell::start(&["--geometry", "unknown", "--pose-deg", START_DEG]);
        let doubted = cell.pb3dp(&["probe", "--exchanges", "20"], None).assert_success();
        assert!(doubted.stdout.contains("warning: the arm geometry is not set at the gateway"), "{}", doubted.stdout);
        assert!(doubted.stderr.contains("vs-robot: the arm geometry is not set at the gateway"), "{}", doubted.stderr);
        cell.arm.quit();
    });
}

#[test]
fn an_arm_that_is_not_there_is_a_finding_too() {
    // Nobody listens at this port.
    let folder = setup_at("127.0.0.1:9");
    let config = folder.path().join("cell.toml").display().to_string();
    let finished = pb3dp_arm(&config, &["probe", "--json"], None);
    assert!(!finished.success);
    let report = json(&finished);
    assert_eq!(report["fits"], false);
    assert!(report["problems"][0].as_str().unwrap().contains("127.0.0.1:9"), "{report}");
    let sim = repository().join("configs/sim.toml").display().to_string();
    assert_problem(&pb3dp_arm(&sim, &["probe"], None), &["arms.vs.backend = \"mock\" has no link to an arm"]);
    let jog = ["jog", "--axis", "4", "--by", "1"];
    pb3dp_arm(&sim, &jog, None).assert_refused(&["arms.vs.backend = \"mock\" has no arm to move"]);
}

#[test]
fn nothing_moves_without_the_name_of_the_arm() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let before = cell.joints();
        let jog = ["jog", "--axis", "4", "--by", "-1"];
        let dry = cell.pb3dp(&jog, Some("vs-robot")).assert_success().stdout;
        for part in
            ["4 E1    97.490    96.490    -1.000", "0.0180", "182 velocities", "dry run", "clearance to the tc-robot"]
        {
            assert!(dry.contains(part), "{part:?} is missing in:\n{dry}");
        }
        assert_eq!(cell.joints(), before);
        let jog = [&jog[..], &["--move"]].concat();
        cell.pb3dp(&jog, None).assert_refused(&["vs-robot was not typed", "nothing was moved"]);
        for wrong in ["yes", "tc-robot", "VS-ROBOT", "", " vs-robot"] {
            cell.pb3dp(&jog, Some(wrong)).assert_refused(&["is not vs-robot", "nothing was moved"]);
        }
        assert_eq!(cell.joints(), before);
        assert!(before.1, "all brakes are closed");
        cell.arm.quit();
    });
}

#[test]
fn a_joint_that_is_blocked_ends_its_jog() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG, "--fault", "at 0s stuck 7 on"]);
        let jog = cell.pb3dp(&["jog", "--axis", "7", "--by", "8", "--move"], Some("vs-robot"));
        jog.assert_refused(&["axis 7 is -", "from its commanded position"]);
        assert!(cell.joints().1, "all brakes are closed");
        cell.arm.quit();
    });
}

/// 0.1 rad/s are far below what a run allows, and five times the speed of a jog.
#[test]
fn a_joint_that_is_too_fast_for_a_jog_ends_it() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG, "--fault", "at 0s runaway 7 0.1rad/s"]);
        let jog = cell.pb3dp(&["jog", "--axis", "7", "--by", "8", "--move"], Some("vs-robot"));
        jog.assert_refused(&["axis 7 moves at +0.", "the limit is 0.040 rad/s"]);
        assert!(cell.joints().1, "all brakes are closed");
        cell.arm.quit();
    });
}

#[test]
fn a_jog_turns_one_joint_and_closes_the_brakes() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        cell.assert_jogs();
        cell.arm.quit();
    });
}

#[test]
fn home_leads_to_the_start() {
    programs_in_real_time_beside_others(|| {
        let pose = "2,44,-2,96,3,-50,3";
        let mut cell = Cell::start(&["--pose-deg", pose]);
        let before = cell.joints();
        let dry = cell.pb3dp(&["home"], None).assert_success().stdout;
        assert!(dry.contains("vs-robot: home") && dry.contains("dry run"), "{dry}");
        assert_eq!(cell.joints(), before);
        cell.pb3dp(&["home", "--move"], Some("vs-robot")).assert_success();
        let (after, is_braked) = cell.joints();
        let start: Vec<f64> = START_DEG.split(',').map(|angle| angle.parse().unwrap()).collect();
        assert!(is_braked && after.iter().zip(&start).all(|(is, wanted)| (is - wanted).abs() < 0.1), "{after:?}");
        cell.arm.quit();
    });
}

#[test]
fn a_way_out_of_the_operating_range_is_refused() {
    programs_in_real_time_beside_others(|| {
        let cell = Cell::start(&["--pose-deg", "0,80,0,97,0,-50,0"]);
        let far = ["jog", "--axis", "2", "--by", "9", "--move"];
        let refused = cell.pb3dp(&far, Some("vs-robot"));
        refused.assert_refused(&["axis 2 (S2) would end at 89.000 degrees", "-88.0 to 88.0", "shorter move"]);
        cell.arm.quit();
    });
}

#[test]
fn an_interrupted_move_ends_with_the_stop_order() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let (code, stderr) = while_it_moves(&mut cell, |_, process| interrupt(process));
        assert_eq!(code, Some(1), "{stderr}");
        assert!(stderr.contains("ended by SIGINT") && stderr.contains("the stop order given"), "{stderr}");
        let (after, is_braked) = cell.joints();
        assert!(is_braked && after[3] > START_E1_DEG - 15.0, "{after:?}");
        cell.arm.quit();
    });
}

pub fn interrupt(process: u32) {
    assert!(Path::new("/proc").join(process.to_string()).exists());
    let sent = Command::new("kill").args(["-INT", &process.to_string()]).status().unwrap();
    assert!(sent.success());
}

#[test]
fn an_arm_that_was_stopped_is_reset_by_name_only() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&[]);
        assert!(cell.pb3dp(&["reset"], None).assert_success().stdout.contains("not stopped, nothing to reset"));
        cell.arm.say("e-stop press");
        let jog = ["jog", "--axis", "4", "--by", "-1", "--move"];
        assert!(!cell.pb3dp(&jog, Some("vs-robot")).success);
        assert!(cell.joints().1, "all brakes are closed");
        cell.arm.say("e-stop release");
        let probe = cell.pb3dp(&["probe"], None);
        assert_problem(&probe, &["the arm is stopped", "(emergency stop); release the emergency stop, then reset"]);
        // Where it stands, as the gateway saw it last.
        assert!(probe.stdout.contains("joints and status words are"), "{}", probe.stdout);
        let report = json(&cell.pb3dp(&["probe", "--json"], None));
        for (joint, angle) in report["joints"].as_array().unwrap().iter().zip(cell.joints().0) {
            assert!((joint["now_deg"].as_f64().unwrap() - angle).abs() < 2.0, "{report}");
        }
        cell.pb3dp(&["reset"], Some("yes")).assert_refused(&["\"yes\" is not vs-robot"]);
        let reset = cell.pb3dp(&["reset"], Some("vs-robot")).assert_success().stdout;
        assert!(reset.contains("connected, brakes on"), "{reset}");
        assert!(
            cell.pb3dp(&["probe", "--exchanges", "20"], None).assert_success().stdout.contains("no problems found")
        );
        cell.arm.quit();
    });
}

/// A jog is under way, something happens; its exit code and messages.
pub fn while_it_moves(cell: &mut Cell, happens: impl FnOnce(&mut Cell, u32)) -> (Option<i32>, String) {
    let out = cell.folder.path().join("flights").display().to_string();
    let jog = ["jog", "--axis", "4", "--by", "-20", "--move", "--out", &out];
    let mut child = command(&cell.config().display().to_string(), &jog).spawn().unwrap();
    let mut input = child.stdin.take().unwrap();
    writeln!(input, "vs-robot").unwrap();
    let since = Instant::now();
    while cell.joints().0[3] > START_E1_DEG - 0.2 && child.try_wait().unwrap().is_none() {
        assert!(since.elapsed() < Duration::from_secs(20), "it does not move");
        std::thread::sleep(Duration::from_millis(20));
    }
    if child.try_wait().unwrap().is_some() {
        let output = child.wait_with_output().unwrap();
        panic!("it has ended: {}", String::from_utf8_lossy(&output.stderr));
    }
    happens(cell, child.id());
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

/// Until all brakes are closed; where the joints are then.
fn rests(cell: &mut Cell) -> Vec<f64> {
    let since = Instant::now();
    loop {
        if let (joints, true) = cell.joints() {
            return joints;
        }
        assert!(since.elapsed() < Duration::from_secs(10), "its brakes stay open");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// An arm that moves stops near the start of its way.
fn stops_early(happens: impl FnOnce(&mut Cell, u32)) -> (Cell, Option<i32>, String) {
    let mut cell = Cell::start(&["--pose-deg", START_DEG]);
    let (code, stderr) = while_it_moves(&mut cell, happens);
    assert!(rests(&mut cell)[3] > START_E1_DEG - 15.0, "{stderr}");
    (cell, code, stderr)
}

#[test]
fn an_emergency_stop_stops_the_arm() {
    programs_in_real_time_beside_others(|| {
        let (cell, code, stderr) = stops_early(|cell, _| cell.arm.say("e-stop press"));
        assert!(code == Some(1) && stderr.contains("emergency stop"), "{code:?} {stderr}");
        let flight = std::fs::read_to_string(cell.folder.path().join("flights/flight-vs-robot.jsonl")).unwrap();
        let head: Value = serde_json::from_str(flight.lines().next().unwrap()).unwrap();
        assert!(head.to_string().contains("emergency stop") && flight.lines().count() > 100, "{head}");
        cell.arm.quit();
    });
}

#[test]
fn a_pulled_cable_stops_the_arm() {
    programs_in_real_time_beside_others(|| {
        let (cell, code, stderr) = stops_early(|cell, _| cell.arm.say("unplug"));
        assert_eq!(code, Some(1), "{stderr}");
        let [order, cause] = ["EMERGENCY STOP: press it at vs-robot", "the link is gone"].map(|text| stderr.find(text));
        assert!(order.is_some() && order < cause, "{stderr}");
        cell.arm.quit();
    });
}

#[test]
fn a_killed_program_leaves_an_arm_that_stops() {
    programs_in_real_time_beside_others(|| {
        let (cell, code, stderr) = stops_early(|_, process| {
            assert!(Command::new("kill").args(["-KILL", &process.to_string()]).status().unwrap().success());
        });
        assert_eq!(code, None, "{stderr}");
        assert_problem(&cell.pb3dp(&["probe"], None), &["the arm is stopped"]);
        // The gateway refuses it until its stop order has ended.
        let since = Instant::now();
        loop {
            let reset = cell.pb3dp(&["reset"], Some("vs-robot"));
            if reset.success {
                break;
            }
            let is_early = reset.stderr.contains("wrong-state") && since.elapsed() < Duration::from_secs(10);
            assert!(is_early, "{}", reset.stderr);
        }
        cell.arm.quit();
    });
}

#[test]
fn the_room_to_the_other_arm_is_watched_unless_it_is_left_out() {
    programs_in_real_time_beside_others(|| {
        let jog = ["jog", "--axis", "4", "--by", "-1"];
        let dry = pb3dp_arm(&hil(), &jog, None).assert_success().stdout;
        assert!(
            dry.contains(
                "clearance to the tc-robot (emulated, at its start pose) on the path: 377 mm (cameras to panel)"
            ),
            "{dry}"
        );
        let moved = pb3dp_arm(&hil(), &[&jog[..], &["--move"]].concat(), Some("vs-robot")).assert_success().stdout;
        assert!(moved.contains("done: every joint within 0.0"), "{moved}");
        // More room is wanted than there is.
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("cell.toml");
        std::fs::write(&config, "base = \"hil\"\narms.least_room_mm = 400.0\n").unwrap();
        let refused = pb3dp_arm(&config.display().to_string(), &jog, None);
        refused.assert_refused(&["377 mm (cameras to panel) is less than arms.least_room_mm, 400 mm"]);
        let alone = [&jog[..], &["--alone", "--move"]].concat();
        let config = config.display().to_string();
        pb3dp_arm(&config, &alone, Some("vs-robot")).assert_refused(&["\"vs-robot\" is not vs-robot alone"]);
        pb3dp_arm(&config, &alone, Some("vs-robot alone")).assert_success();
    });
}

/// Each of two setups calls the arm of the other one emulated: nothing would keep a distance between both arms.
#[test]
fn only_one_program_of_a_computer_moves_arms_that_are_not_emulated() {
    programs_in_real_time_beside_others(|| {
        let (first, second) = (Cell::start(&["--pose-deg", START_DEG]), Cell::start(&["--pose-deg", START_DEG]));
        let name = format!("pb3dp-test-{}", std::process::id());
        let jog = |cell: &Cell, args: &[&str]| {
            let args = [&["jog", "--axis", "4", "--by", "-1"], args].concat();
            let mut command = command(&cell.config().display().to_string(), &args);
            command.env("PB3DP_TEST_SOLE_PROGRAM", &name);
            command
        };
        let mut waiting = jog(&first, &["--move"]).spawn().unwrap();
        let mut output = BufReader::new(waiting.stdout.take().unwrap()).lines();
        assert!(output.any(|line| line.unwrap().contains("Type vs-robot to move it")));
        let refused = jog(&second, &[]).output().unwrap();
        let text = String::from_utf8(refused.stderr).unwrap();
        assert!(!refused.status.success() && text.contains("arms.vs: another program of this computer"), "{text}");
        // Whatever ends a program frees the way for the next one.
        waiting.kill().unwrap();
        waiting.wait().unwrap();
        let dry = jog(&second, &[]).output().unwrap();
        assert!(dry.status.success(), "{}", String::from_utf8(dry.stderr).unwrap());
        [first, second].into_iter().for_each(|cell| cell.arm.quit());
    });
}

/// R21: the flight file of an arm says when, where and from which state it stopped, and how its line was.
#[test]
fn a_run_that_an_alarm_ends_says_when_and_where() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let out = cell.folder.path().join("out");
        let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
        command.arg("run").arg("--config").arg(cell.config()).arg("--out").arg(&out).args(FIRST_RUN).arg("--move");
        command.args(WITHOUT_IMAGES);
        let mut run = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut typed = run.stdin.take().unwrap();
        writeln!(typed, "vs-robot").unwrap();
        let begin = Instant::now();
        while cell.joints().1 {
            if begin.elapsed() > Duration::from_secs(60) || run.try_wait().unwrap().is_some() {
                run.kill().ok();
                panic!("{}", String::from_utf8_lossy(&run.wait_with_output().unwrap().stderr));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        // Until both arms are led.
        std::thread::sleep(Duration::from_secs(5));
        // It may have ended: then its log says why, below.
        writeln!(typed).ok();
        cell.arm.say("alarm 4 0x0e");
        let output = run.wait_with_output().unwrap();
        assert!(!output.status.success());
        let log = String::from_utf8_lossy(&output.stderr);
        let head = |arm: &str| {
            let file = out.join(format!("flight-{arm}.jsonl"));
            let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{error}: {log}"));
            serde_json::from_str::<Value>(text.lines().next().unwrap()).unwrap()
        };
        let (vs, tc) = (head("vs-robot"), head("tc-robot"));
        let fault = &vs["fault"];
        let cause = fault["cause"].as_str().unwrap_or_else(|| panic!("{vs}: {log}"));
        assert!(cause.contains("over-current"), "{vs}: {log}");
        assert_eq!((&fault["joint"], &fault["code"]), (&3.into(), &14.into()), "{vs}");
        assert!(["moving", "holding"].contains(&fault["state_before"].as_str().unwrap()), "{vs}");
        assert!(tc["fault"]["cause"].as_str().unwrap().contains("arm 1 of the same cell"), "{tc}");
        let at_s = |head: &Value| head["fault"]["at_s"].as_f64().unwrap();
        assert!(at_s(&vs) <= at_s(&tc) && at_s(&tc) <= tc["ended_at_s"].as_f64().unwrap(), "{vs} {tc}");
        let before_s = vs["ended_wall_unix_s"].as_f64().unwrap() - fault["wall_unix_s"].as_f64().unwrap();
        assert!((before_s - (vs["ended_at_s"].as_f64().unwrap() - at_s(&vs))).abs() < 1e-3, "{vs}");
        assert!(vs["counts"]["answered"].as_u64().unwrap() > 100 && vs["counts"]["crc_errors"].is_u64(), "{vs}");
        cell.arm.quit();
    });
}
