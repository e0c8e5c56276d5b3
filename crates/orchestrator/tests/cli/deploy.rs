//! The files of configs/deploy, checked by the tools of this machine. `cargo xtask tidy` checks that they parse.

use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Parser;
use pb3dp_commissioning::gateway::file::read_gateway;
use pb3dp_orchestrator::cli::Cli;
use pb3dp_test_support::not_checked;

use crate::cli::support::repository;

fn deployed(name: &str) -> PathBuf {
    repository().join("configs/deploy").join(name)
}

fn unit() -> String {
    std::fs::read_to_string(deployed("pb3dp-gateway@.service")).unwrap()
}

/// Values of a key of the unit.
fn values(key: &str) -> Vec<String> {
    let text = unit();
    let of = |line: &str| line.split_once('=').filter(|(name, _)| *name == key).map(|(_, value)| value.to_owned());
    text.lines().filter_map(of).collect()
}

/// What a tool says of a file; none, and the test is reported as not checked, where the machine has no such tool.
fn judged(test: &str, tool: &str, arguments: &[&str], file: &Path) -> Option<(bool, String)> {
    match Command::new(tool).args(arguments).arg(file).output() {
        Ok(output) => {
            let output_text = [output.stdout, output.stderr].concat();
            Some((output.status.success(), String::from_utf8_lossy(&output_text).into_owned()))
        }
        Err(error) => {
            not_checked(&format!("cli::deploy::{test}"), &format!("{tool} {arguments:?} cannot be run: {error}"));
            None
        }
    }
}

#[test]
fn the_unit_starts_what_the_program_understands() {
    let [command] = &values("ExecStart")[..] else { panic!("one command") };
    let command = command.replace("%i", "arm1");
    let words: Vec<&str> = command.split_whitespace().collect();
    assert_eq!(words[0], "pb3dp", "systemd searches /usr/local/bin and /usr/bin: {command}");
    Cli::try_parse_from(&words).unwrap();
}

/// A gateway that is started anew is idle (`hal/arm-pa10-gateway/tests/gateway_properties.rs`), so that may happen by itself;
/// nothing that moves an arm may be started so.
#[test]
fn nothing_is_started_by_itself_that_moves_an_arm() {
    let units = std::fs::read_dir(repository().join("configs/deploy")).unwrap();
    let names = units.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let units: Vec<_> = names.filter(|name| name.ends_with(".service")).collect();
    assert_eq!(units, ["pb3dp-gateway@.service"], "a unit that is new here needs its own reasons");
    assert!(values("ExecStart").iter().all(|command| command.contains("pb3dp gateway ")));
    assert_eq!(values("Restart"), ["on-failure"]);
    assert_eq!(values("KillSignal"), ["SIGTERM"], "the stop order");
}

#[test]
fn the_unit_permits_what_the_gateway_asks_for() {
    let gateway = read_gateway(&repository().join("configs/gateway.toml"), None, None).unwrap();
    let [priority] = &values("LimitRTPRIO")[..] else { panic!("one limit") };
    assert!(priority.parse::<u8>().unwrap() >= gateway.realtime.priority.unwrap());
    assert!(gateway.realtime.locks_memory);
    assert_eq!(values("LimitMEMLOCK"), ["infinity"]);
    let limits = std::fs::read_to_string(deployed("90-pb3dp.conf")).unwrap();
    assert!(limits.contains("\n@realtime - rtprio 99\n") && limits.contains("\n@realtime - memlock unlimited\n"));
    for key in ["AmbientCapabilities", "CapabilityBoundingSet"] {
        assert_eq!(values(key), ["CAP_NET_RAW"], "{key}");
    }
}

#[test]
fn systemd_finds_nothing_wrong_with_the_unit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pb3dp-gateway@.service");
    // The program is not where it will be installed.
    let verify = |text: &str| {
        std::fs::write(&file, text.replace("ExecStart=pb3dp", concat!("ExecStart=", env!("CARGO_BIN_EXE_pb3dp"))))
            .unwrap();
        judged("systemd_finds_nothing_wrong_with_the_unit", "systemd-analyze", &["verify", "--man=no"], &file)
    };
    let Some((works, output_text)) = verify(&unit()) else { return };
    // It also tells of other units of the machine.
    assert!(works && !output_text.contains("pb3dp"), "{output_text}");
    let (_, output_text) = verify(&unit().replace("RestartSec=", "RestartSecs=")).unwrap();
    assert!(output_text.contains("RestartSecs"), "a mistake is reported: {output_text}");
}

#[test]
fn udev_finds_nothing_wrong_with_the_rules() {
    let test = "udev_finds_nothing_wrong_with_the_rules";
    let Some((works, output_text)) = judged(test, "udevadm", &["verify"], &deployed("70-pb3dp.rules")) else { return };
    if output_text.contains("nrecognized command") || output_text.contains("nknown command") {
        let reason = format!("this udevadm is older than its command verify (254): {output_text}");
        return not_checked(&format!("cli::deploy::{test}"), &reason);
    }
    assert!(works, "{output_text}");
}

#[test]
fn systemd_makes_the_groups() {
    let root = tempfile::tempdir().unwrap();
    std::fs::create_dir(root.path().join("etc")).unwrap();
    let rooted = format!("--root={}", root.path().display());
    let (test, file) = ("systemd_makes_the_groups", deployed("pb3dp-sysusers.conf"));
    let Some((works, output_text)) = judged(test, "systemd-sysusers", &[&rooted], &file) else { return };
    assert!(works, "{output_text}");
    let groups = std::fs::read_to_string(root.path().join("etc/group")).unwrap();
    for (group, member) in [("realtime", "pb3dp"), ("dialout", "pb3dp"), ("video", "")] {
        let line = groups
            .lines()
            .find(|line| line.starts_with(&format!("{group}:")))
            .unwrap_or_else(|| panic!("{group}: {groups}"));
        assert!(line.ends_with(&format!(":{member}")), "{line}");
    }
}
