//! What is made from the source: reference pages, completion scripts, codes.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn pb3dp(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pb3dp")).args(args).output().unwrap()
}

#[test]
fn the_reference_pages_are_those_of_the_source() {
    let folder = tempfile::tempdir().unwrap();
    let output = pb3dp(&["generate", folder.path().to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");
    let pages = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference");
    for name in ["commands.md", "keys.md", "messages.md"] {
        let of_source = fs::read_to_string(folder.path().join("reference").join(name)).unwrap();
        let page = fs::read_to_string(pages.join(name)).unwrap();
        let line = of_source.lines().zip(page.lines()).position(|(a, b)| a != b).map_or(0, |line| line + 1);
        assert!(of_source == page, "docs/reference/{name} differs from line {line} on: run `cargo xtask reference`");
    }
    let manual = fs::read_to_string(folder.path().join("man/pb3dp-run.1")).unwrap();
    assert!(manual.contains("stop\\-after"), "{manual}");
}

#[test]
fn a_code_is_explained_and_a_wrong_one_is_refused() {
    let output = pb3dp(&["explain", "pb3dp-sup-008"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with("PB3DP-SUP-008\n") && text.contains("remedy: Check the cameras"), "{text}");
    let all = String::from_utf8(pb3dp(&["explain"]).stdout).unwrap();
    assert!(all.lines().count() > 100 && all.contains("PB3DP-ARM-104"), "{all}");
    let wrong = pb3dp(&["explain", "PB3DP-SUP-999"]);
    let text = String::from_utf8(wrong.stderr).unwrap();
    assert!(wrong.status.code() == Some(1) && text.contains("PB3DP-SUP-999"), "{text}");
}

#[test]
fn an_error_at_the_end_carries_its_code() {
    let output = pb3dp(&["run", "--config", "/nowhere/rig.toml"]);
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.contains("/nowhere/rig.toml") && text.contains("PB3DP-CFG-001"), "{text}");
}

#[test]
fn bash_completes_commands_and_flags() {
    // A file: the script is longer than an argument may be (128 KiB).
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("pb3dp.bash");
    std::fs::write(&script, pb3dp(&["completions", "bash"]).stdout).unwrap();
    let ask = "COMP_WORDS=(pb3dp con); COMP_CWORD=1; _pb3dp pb3dp con pb3dp; echo \"${COMPREPLY[@]}\"";
    let output = Command::new("bash").arg("-c").arg(format!("source {}\n{ask}", script.display())).output().unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), "config", "{:?}", String::from_utf8(output.stderr));
    let unknown = pb3dp(&["completions", "tcsh"]);
    assert_eq!(unknown.status.code(), Some(2));
}
