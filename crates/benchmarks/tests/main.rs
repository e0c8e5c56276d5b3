//! Integration tests of the program `pb3dp-bench`.
#![allow(clippy::expect_used, reason = "helpers of tests")]

use std::path::Path;
use std::process::{Command, Output};

fn bench(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pb3dp-bench")).args(args).output().expect("it starts")
}

#[test]
fn every_benchmark_is_named_in_the_help() {
    let help = String::from_utf8(bench(&["--help"]).stdout).expect("text");
    for name in ["accuracy", "real", "speed"] {
        assert!(help.contains(name), "{name} is missing in:\n{help}");
    }
}

#[test]
fn a_benchmark_that_does_not_exist_is_refused_by_name() {
    let refused = bench(&["acuracy"]);
    assert!(!refused.status.success());
    let text = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(text.contains("acuracy") && text.contains("accuracy"), "{text}");
}

#[test]
fn a_sequence_that_was_written_is_tracked_and_compared_with_its_truth() {
    let place = tempfile::tempdir().expect("a folder");
    let folder = |name: &str| place.path().join(name).to_string_lossy().into_owned();
    // The right camera exposes 5 ms later.
    let written = bench(&["dump", "--cell", "skew/5ms 0", "--out", &folder("moving"), "--poses", "3"]);
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    std::fs::create_dir(folder("empty")).expect("a folder");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").to_string_lossy().into_owned();
    let measured = |sequences: &str| {
        bench(&["real", "--sequences", sequences, "--methods", "direct", "--json", "--no-docs", "--root", &root])
    };
    let all = measured(&folder(""));
    let line: serde_json::Value = serde_json::from_slice(&all.stdout).expect("one line of JSON");
    assert_eq!((&line["sequence"], &line["frames"], &line["wrong_ok"]), (&"moving".into(), &2.into(), &0.into()));
    let depth_m = line["depth_m_median_p95"][1].as_f64().expect("a number");
    assert!(depth_m < 0.0003, "{depth_m}");
    let refused = measured(&folder("empty"));
    let text = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && text.contains("no sequence.json"), "{text}");
}
