//! `pb3dp doctor` on the machine of the tests, whatever that is.

use std::process::Command;

use serde_json::Value;

use crate::cli::support::repository;

fn doctor(more: &[&str]) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_pb3dp")).arg("doctor").args(more).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!stderr.contains("panicked"), "{stderr}");
    (output.status.code(), String::from_utf8(output.stdout).unwrap())
}

#[test]
fn every_check_says_something_and_the_worst_one_decides() {
    let (code, text) = doctor(&["--json"]);
    let report: Value = serde_json::from_str(text.trim()).unwrap();
    let findings = report["findings"].as_array().unwrap();
    for check in [
        "real-time scheduling",
        "memory lock",
        "real-time throttling",
        "clock source",
        "processor frequency",
        "groups",
        "serial ports",
        "cameras",
        "kernel modules",
        "ARCNET",
        "space for recordings",
    ] {
        assert!(findings.iter().any(|finding| finding["check"] == check), "{check} is missing: {text}");
    }
    let verdicts = ["pass", "warning", "fail"];
    let rank = |word: &Value| verdicts.iter().position(|verdict| word == verdict).unwrap();
    let worst = findings.iter().map(|finding| rank(&finding["verdict"])).max().unwrap();
    assert_eq!((rank(&report["worst"]), code), (worst, i32::try_from(worst).ok()));
    for finding in findings {
        let advice = finding["advice"].as_str().unwrap_or_default();
        assert_eq!(advice.is_empty(), finding["verdict"] == "pass", "what to do, unless it passes: {finding}");
    }
}

#[test]
fn what_a_configuration_names_has_to_be_there() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("arm.toml");
    let text = std::fs::read_to_string(repository().join("configs/gateway.toml")).unwrap();
    let text = text
        .replace("\"arcnet:arc0\"", "\"arcnet:arc77\"")
        .replace("\"tcp:127.0.0.1:4534\"", "\"serial:/dev/no_such_port\"");
    std::fs::write(&file, text).unwrap();
    let (code, text) = doctor(&["--config", &file.display().to_string()]);
    assert_eq!(code, Some(2), "{text}");
    for part in [
        "FAIL     serial ports: /dev/no_such_port does not exist",
        "FAIL     ARCNET: there is no network interface arc77",
        "modprobe -a com20020_pci",
    ] {
        assert!(text.contains(part), "{part:?} is missing:\n{text}");
    }
    let (code, text) = doctor(&["--config", "no_such_file.toml", "--json"]);
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("\"check\":\"configuration\"") && text.contains("no_such_file.toml"), "{text}");
}
