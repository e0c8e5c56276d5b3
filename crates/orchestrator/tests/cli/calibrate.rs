//! `pb3dp calibrate`, which is another program.

use std::fs;
use std::path::Path;
use std::process::Command;

#[test]
fn arguments_and_exit_code_are_those_of_the_program_beside() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("pb3dp");
    install(env!("CARGO_BIN_EXE_pb3dp").as_ref(), &copy);
    let calibrate = || {
        let mut command = Command::new(&copy);
        command.args(["calibrate", "stereo", "--board", "9x6", "--help"]).env("PATH", folder.path());
        command.output().unwrap()
    };
    let missing = calibrate();
    let told = String::from_utf8_lossy(&missing.stderr);
    assert!(!missing.status.success() && told.contains("cargo build --release -p pb3dp-calibration"), "{told}");
    let program = folder.path().join("pb3dp-calibrate");
    let text = folder.path().join("text");
    fs::write(&text, "#!/bin/sh\necho \"$@\"\nexit 7\n").unwrap();
    install(&text, &program);
    let started = calibrate();
    assert_eq!(String::from_utf8_lossy(&started.stdout), "stereo --board 9x6 --help\n");
    assert_eq!(started.status.code(), Some(7));
}

/// Copies a file to an executable one, in another process.
///
/// If this process wrote it, a program that another test starts meanwhile could hold it open for writing, and
/// Linux does not execute such a file (ETXTBSY).
fn install(from: &Path, to: &Path) {
    assert!(Command::new("install").args(["-m", "755"]).args([from, to]).status().unwrap().success());
}
