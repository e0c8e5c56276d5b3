//! `pb3dp arm` where the ARCNET card is in this computer: a socket stands for the card, a mock arm is the controller behind it.

use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

use crate::cli::mock_arm::MockArm;
use crate::cli::support::pb3dp;
use crate::real_time::arm::{Cell, FIRST_RUN, START_DEG, WITHOUT_IMAGES, assert_problem, command, json, write_setup};
use pb3dp_test_support::programs_in_real_time_beside_others;

const GATEWAY: &str = "[arms.vs.gateway]";

pub fn with_bus(folder: &TempDir, port: &str, more: &str) {
    write_setup(folder, |vs| {
        let vs = vs.replacen("backend = \"emulated\"", "backend = \"arcnet\"", 1);
        let (arm, rest) = vs.split_once(GATEWAY).unwrap();
        let (_, others) = rest.split_once("[arms.tc]").unwrap();
        format!("{arm}[arms.vs.bus]\narm = 1\nport = \"{port}\"\n{more}\n[arms.tc]{others}")
    });
}

/// Of the table, but for number and port.
pub fn keys(wire_format: &str, cycle_millis: &str) -> String {
    format!(
        "wire_format = \"{wire_format}\"\ngeometry = \"second-generation\"\nsequence_numbers = 128\ncycle_millis = {cycle_millis}\n\
         brake_millis = 200.0\nsupervise_other_axes = false\nsupervise_dead_man = false\n\
         controller_time_out_millis = 0.0\nsignals = {{ emergency_stop = \"controller 0x0008 set\", limit_switch = \"controller 0x2000 set\", \
         dead_man = \"controller 0x0001 clear\", power = \"axes 0x8000 set\" }}"
    )
}

/// A controller whose time-out is that of one of the sources, in a cycle of 10 ms: programs on a busy machine are not always
/// run within the 2 ms of the manual, and what is tested here is the program, not the machine.
fn cell(args: &[&str], wire_format: &str) -> Cell {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bus").display().to_string();
    let time_out: &[&str] = if args.contains(&"--watchdog") { &[] } else { &["--watchdog", "400ms"] };
    let mut arm = MockArm::start(&[&["--bus", &path, "--priority", "45"], time_out, args].concat());
    assert_eq!(arm.line(), path);
    with_bus(&folder, &format!("socket:{path}"), &keys(wire_format, "10.0"));
    Cell { arm, folder }
}

#[test]
fn a_probe_reads_the_controller_itself() {
    programs_in_real_time_beside_others(|| {
        for (wire_format, format) in [("A", "a"), ("B", "b")] {
            let cell = cell(&["--format", format, "--pose-deg", START_DEG], wire_format);
            let report = json(&cell.pb3dp(&["probe", "--json"], None).assert_success());
            assert_eq!(report["fits"], true, "{report}");
            assert!(report["target"].as_str().unwrap().starts_with("socket "), "{report}");
            assert!(report["gateway"].is_null(), "{report}");
            assert!(report["link"]["sent"].as_u64().unwrap() >= 200, "{report}");
            assert_eq!(report["joints"].as_array().unwrap().len(), 7);
            cell.arm.quit();
        }
    });
}

/// R19: the length of a reply tells the format.
#[test]
fn a_controller_of_the_other_wire_format_is_named() {
    programs_in_real_time_beside_others(|| {
        for (format, configured, detected_format) in [("a", "B", "format A"), ("b", "A", "format B")] {
            let cell = cell(&["--format", format], configured);
            let parts = [
                &format!("the controller answers in {detected_format}"),
                "the configuration says format",
                "set wire_format",
            ];
            assert_problem(&cell.pb3dp(&["probe"], None), &parts);
            let jog = cell.pb3dp(&["jog", "--axis", "7", "--by", "1", "--move"], Some("vs-robot"));
            jog.assert_refused(&parts[..2]);
            cell.arm.quit();
        }
    });
}

/// What a gateway's file says of brakes and switches, the table says of an arm without one.
#[test]
fn the_table_tells_of_brakes_and_switches() {
    programs_in_real_time_beside_others(|| {
        let mut cell = cell(&["--pose-deg", START_DEG], "B");
        let config = cell.config();
        let text = std::fs::read_to_string(&config).unwrap();
        let change = |from: &str, to: &str| {
            let (all, vs) = text.split_once("[arms.vs.bus]").unwrap();
            std::fs::write(&config, format!("{all}[arms.vs.bus]{}", vs.replacen(from, to, 1))).unwrap();
        };
        // All bits of the word of an arm at which nothing is wrong.
        change("controller 0x0008 set", "controller 0xffff set");
        assert_problem(&cell.pb3dp(&["probe"], None), &["shows the emergency stop by the bits of the configuration"]);
        change("controller 0x0008 set", "unknown");
        let jog = cell.pb3dp(&["jog", "--axis", "7", "--by", "1", "--move"], Some("vs-robot"));
        jog.assert_refused(&["arms.vs.bus.signals.emergency_stop unknown", "pb3dp arm signals"]);
        let mut took = |brake_millis: &str| {
            change("brake_millis = 200.0", &format!("brake_millis = {brake_millis}"));
            let begin = Instant::now();
            cell.assert_jogs();
            begin.elapsed()
        };
        // They open once and close once.
        let (quick, slow) = (took("200.0"), took("2200.0"));
        assert!(slow > quick + Duration::from_secs(3), "{quick:?}, {slow:?}");
        cell.arm.quit();
    });
}

#[test]
fn a_jog_turns_one_joint_and_closes_the_brakes() {
    programs_in_real_time_beside_others(|| {
        let mut cell = cell(&["--pose-deg", START_DEG], "B");
        cell.assert_jogs();
        cell.arm.quit();
    });
}

/// `start_deg` of the arm with the target in configs/hil.toml.
const TC_START_DEG: &str = "0,43.89215190,0,100.71390562,0,-54.60605752,0";

/// A run whose arm with the target moves on a bus, before a controller that goes on with the last speeds.
fn run_on_bus(arm: &mut MockArm) -> (Child, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let bus = format!("[arms.tc.bus]\narm = 2\nport = \"socket:{}\"\n{}\n\n", arm.line(), keys("B", "10.0"));
    write_setup(&folder, |arms| {
        let (vs, tc) = arms.split_once("[arms.tc]").unwrap();
        let tc = tc.replacen("backend = \"emulated\"", "backend = \"arcnet\"", 1);
        let (tc, gateway) = tc.split_once("[arms.tc.gateway]").unwrap();
        format!("{vs}[arms.tc]{tc}{bus}{}", &gateway[gateway.find("\n[").unwrap() + 1..])
    });
    let (config, out) = (folder.path().join("cell.toml"), folder.path().join("out"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
    command.arg("run").arg("--config").arg(config).arg("--out").arg(out).args(FIRST_RUN).arg("--move");
    command.args(WITHOUT_IMAGES);
    let mut run = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    writeln!(run.stdin.as_mut().unwrap(), "tc-robot").unwrap();
    if let Err(printed) = wait_for_motion(arm, &mut run, 2.0) {
        // The flight recorders tell which of the arms was held up.
        let flights = ["vs", "tc"].map(|name| folder.path().join(format!("out/flight-{name}-robot.jsonl")));
        let flights = flights.map(|flight| std::fs::read_to_string(flight).unwrap_or_default());
        let causes: Vec<_> = flights.iter().filter_map(|flight| flight.lines().next()).collect();
        panic!("{printed}\n{causes:?}");
    }
    (run, folder)
}

/// What the program said instead, if the arm did not move.
fn wait_for_motion(arm: &mut MockArm, program: &mut Child, deg_per_s: f64) -> Result<(), String> {
    let until = Instant::now() + Duration::from_secs(60);
    while fastest_deg_per_s(arm) < deg_per_s {
        let is_over = program.try_wait().unwrap().is_some();
        if is_over || Instant::now() > until {
            program.kill().ok();
            return Err(format!("the arm did not move: {}", output_so_far(program)));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// An impatient hand.
fn interrupt_twice(program: &Child) {
    let pid = Pid::from_child(program);
    kill_process(pid, Signal::INT).unwrap();
    std::thread::sleep(Duration::from_millis(20));
    kill_process(pid, Signal::INT).unwrap();
}

fn output_so_far(run: &mut Child) -> String {
    let mut text = String::new();
    run.stderr.take().unwrap().read_to_string(&mut text).unwrap();
    text
}

/// True speed of the fastest axis.
fn fastest_deg_per_s(arm: &mut MockArm) -> f64 {
    let speed = |line: &String| line.split_whitespace().nth(5).and_then(|word| word.parse::<f64>().ok());
    arm.state().iter().filter(|line| line.contains("deg/s")).filter_map(speed).fold(0.0, |max, v| v.abs().max(max))
}

/// Who asks twice does not want to wait for the report; for the arm, which nothing else stops, the program waits all the same.
#[test]
fn two_signals_do_not_leave_an_arm_without_a_gateway_moving() {
    programs_in_real_time_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bus").display().to_string();
        let start = ["--bus", &path, "--priority", "45", "--watchdog", "none", "--pose-deg", TC_START_DEG];
        let mut arm = MockArm::start(&start);
        let (mut run, _folder) = run_on_bus(&mut arm);
        interrupt_twice(&run);
        let status = run.wait().unwrap();
        let (state, printed) = (arm.state(), output_so_far(&mut run));
        assert_eq!(state[0], "controller: adjustment mode, all brakes closed", "{printed}");
        assert!(fastest_deg_per_s(&mut arm) < 0.1, "{printed}");
        assert_eq!(status.code(), Some(130), "{printed}");
        assert!(printed.contains("SIGINT again: no gateway stops tc-robot"), "{printed}");
        arm.quit();
    });
}

#[test]
fn a_jog_that_is_interrupted_twice_closes_the_brakes() {
    programs_in_real_time_beside_others(|| {
        let mut cell = cell(&["--pose-deg", START_DEG, "--watchdog", "none"], "B");
        let config = cell.config().display().to_string();
        let mut jog = command(&config, &["jog", "--axis", "7", "--by", "20", "--move"]).spawn().unwrap();
        // The end of the input would end the motion, too.
        let mut typing = jog.stdin.take().unwrap();
        writeln!(typing, "vs-robot").unwrap();
        wait_for_motion(&mut cell.arm, &mut jog, 0.5).unwrap_or_else(|printed| panic!("{printed}"));
        interrupt_twice(&jog);
        let status = jog.wait().unwrap();
        drop(typing);
        let (state, printed) = (cell.arm.state(), output_so_far(&mut jog));
        assert_eq!(state[0], "controller: adjustment mode, all brakes closed", "{printed}");
        assert_eq!(status.code(), Some(1), "{printed}");
        assert!(printed.contains("ended by SIGINT"), "{printed}");
        cell.arm.quit();
    });
}

#[test]
fn tables_that_do_not_fit_are_refused_by_key() {
    let good = &keys("B", "2.0");
    let refused = |port: &str, more: &str, parts: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        with_bus(&folder, port, more);
        let config = folder.path().join("cell.toml").display().to_string();
        pb3dp(&["arm", "jog", "--config", &config, "--arm", "vs", "--axis", "1", "--by", "1"]).assert_refused(parts);
    };
    refused("eth0", good, &["arms.vs.bus.port", "\"eth0\"", "arcnet:INTERFACE or socket:PATH"]);
    let odd = good.replace("128", "127");
    refused("arcnet:arc0", &odd, &["arms.vs.bus.sequence_numbers = 127", "128 and 256"]);
    let slow = good.replace("cycle_millis = 2.0", "cycle_millis = 20.0");
    refused("arcnet:arc0", &slow, &["arms.vs.bus.cycle_millis = 20", "1 to 10"]);
    let folder = tempfile::tempdir().unwrap();
    with_bus(&folder, "arcnet:arc0", good);
    let config = folder.path().join("cell.toml");
    let text = std::fs::read_to_string(&config).unwrap();
    std::fs::write(&config, text.replacen("command_timeout_millis = 50.0", "command_timeout_millis = 49.0", 1))
        .unwrap();
    let words = ["arm", "probe", "--config", config.to_str().unwrap(), "--arm", "vs"];
    pb3dp(&words).assert_refused(&["arms.vs.command_timeout_millis = 49", "50 to 200"]);
    for (from, to, parts) in [
        ("brake_millis = 200.0", "brake_millis = 5001.0", ["arms.vs.bus.brake_millis = 5001", "1 to 5000"]),
        ("brake_millis = 200.0\n", "", ["arms.vs.bus.brake_millis", "missing"]),
        (
            "0x0008 set",
            "0x0000 set",
            ["arms.vs.bus.signals.emergency_stop: \"controller 0x0000 set\" has no bit", "never"],
        ),
        (
            "controller 0x0008 set",
            "wired",
            ["arms.vs.bus.signals.emergency_stop = \"wired\"", "no gateway with inputs"],
        ),
        ("axes 0x8000 set", "absent", ["arms.vs.bus.signals.power = \"absent\"", "every arm has this signal"]),
        ("\"second-gen", "\"first-gen", ["arms.vs.bus.geometry = \"first-generation\"", "500.0, 80.0 mm"]),
        (
            "time_out_millis = 0.0",
            "time_out_millis = 400.0",
            ["arms.vs.bus.controller_time_out_millis = 400", "arms.vs.command_timeout_millis = 50"],
        ),
    ] {
        refused("arcnet:arc0", &good.replace(from, to), &parts);
    }
    for (from, to, key) in [
        ("other_axes = false", "other_axes = true", "arms.vs.bus.supervise_other_axes = true"),
        ("dead_man = false", "dead_man = true", "arms.vs.bus.supervise_dead_man = true"),
    ] {
        refused("arcnet:arc0", &keys("A", "2.0").replace(from, to), &[key]);
    }
    let same = format!("{good}\n[arms.vs.gateway]\narm = 1\ndialect = \"gateway-v1\"");
    refused("arcnet:arc0", &same, &["arms.vs.gateway"]);
    let folder = tempfile::tempdir().unwrap();
    with_bus(&folder, "arcnet:no-such-bus", good);
    let config = folder.path().join("cell.toml").display().to_string();
    let probe = pb3dp(&["arm", "probe", "--config", &config, "--arm", "vs"]);
    assert_problem(&probe, &["ARCNET interface no-such-bus", "load the card's driver"]);
    write_setup(&folder, |vs| vs.replacen("backend = \"emulated\"", "backend = \"arcnet\"", 1));
    let probe = pb3dp(&["arm", "probe", "--config", &config, "--arm", "vs"]);
    probe.assert_refused(&["arms.vs.gateway: an arm with backend = \"arcnet\" has none"]);
}
