//! Integration tests of the program `pb3dp-bench`.
#![allow(clippy::expect_used, reason = "helpers of tests")]

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
