//! `pb3dp arm` where the ARCNET card is in this computer: a socket stands for the card, a mock arm is the controller behind it.

use tempfile::TempDir;

use crate::arm::{Cell, START_DEG, assert_problem, json, patiently, write_setup};
use crate::mock_arm::MockArm;
use crate::support::pb3dp;

const GATEWAY: &str = "[arms.vs.gateway]";

pub fn with_bus(folder: &TempDir, port: &str, more: &str) {
    write_setup(folder, |vs| {
        let vs = vs.replacen("backend = \"emulated\"", "backend = \"arcnet\"", 1);
        let (arm, rest) = vs.split_once(GATEWAY).unwrap();
        let (_, others) = rest.split_once("[arms.tc]").unwrap();
        format!("{arm}[arms.vs.bus]\narm = 1\nport = \"{port}\"\n{more}\n[arms.tc]{others}")
    });
}

/// A controller whose time-out is that of one of the sources: threads of tests are not always run within 6 ms.
fn cell(args: &[&str], wire_format: &str) -> Cell {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bus").display().to_string();
    let mut arm = MockArm::start(&[&["--bus", &path, "--priority", "45", "--watchdog", "400ms"], args].concat());
    assert_eq!(arm.line(), path);
    let more = format!("wire_format = \"{wire_format}\"\nsequence_numbers = 128\ncycle_millis = 2.0");
    with_bus(&folder, &format!("socket:{path}"), &more);
    Cell { arm, folder }
}

#[test]
fn a_probe_reads_the_controller_itself() {
    patiently(|| {
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
        let cell = cell(&["--format", "a"], "B");
        assert_problem(&cell.pb3dp(&["probe"], None), &["reply"]);
        cell.arm.quit();
    });
}

#[test]
fn a_jog_turns_one_joint_and_closes_the_brakes() {
    patiently(|| {
        let mut cell = cell(&["--pose-deg", START_DEG], "B");
        cell.assert_jogs();
        cell.arm.quit();
    });
}

#[test]
fn tables_that_do_not_fit_are_refused_by_key() {
    let good = "wire_format = \"B\"\nsequence_numbers = 128\ncycle_millis = 2.0";
    let refused = |port: &str, more: &str, parts: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        with_bus(&folder, port, more);
        let config = folder.path().join("cell.toml").display().to_string();
        pb3dp(&["arm", "jog", "--config", &config, "--arm", "vs", "--axis", "1", "--by", "1"]).assert_refused(parts);
    };
    refused("eth0", good, &["arms.vs.bus.port", "\"eth0\"", "arcnet:INTERFACE or socket:PATH"]);
    let odd = good.replace("128", "127");
    refused("arcnet:arc0", &odd, &["arms.vs.bus.sequence_numbers = 127", "128 and 256"]);
    let slow = good.replace("2.0", "20.0");
    refused("arcnet:arc0", &slow, &["arms.vs.bus.cycle_millis = 20", "1 to 10"]);
    let same = format!("{good}\n[arms.vs.gateway]\narm = 1\ndialect = \"gateway-v1\"");
    refused("arcnet:arc0", &same, &["arms.vs.gateway"]);
    let folder = tempfile::tempdir().unwrap();
    with_bus(&folder, "arcnet:no-such-bus", good);
    let config = folder.path().join("cell.toml").display().to_string();
    let seen = pb3dp(&["arm", "probe", "--config", &config, "--arm", "vs"]);
    assert_problem(&seen, &["ARCNET interface no-such-bus", "arms.vs.bus"]);
    write_setup(&folder, |vs| vs.replacen("backend = \"emulated\"", "backend = \"arcnet\"", 1));
    let seen = pb3dp(&["arm", "probe", "--config", &config, "--arm", "vs"]);
    seen.assert_refused(&["arms.vs.gateway: an arm with backend = \"arcnet\" has none"]);
}
