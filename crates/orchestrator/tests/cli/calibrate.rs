//! `pb3dp calibrate`, which is another program.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

#[test]
fn arguments_and_exit_code_are_those_of_the_program_beside() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("pb3dp");
    fs::copy(env!("CARGO_BIN_EXE_pb3dp"), &copy).unwrap();
    let calibrate = || {
        let mut command = Command::new(&copy);
        command.args(["calibrate", "stereo", "--board", "9x6", "--help"]).env("PATH", folder.path());
        // Another test's program may have been started while the file was still open for writing.
        loop {
            match command.output() {
                Err(error) if error.kind() == std::io::ErrorKind::ExecutableFileBusy => {}
                finished => break finished.unwrap(),
            }
        }
    };
    let missing = calibrate();
    let told = String::from_utf8_lossy(&missing.stderr);
    assert!(!missing.status.success() && told.contains("cargo build --release -p pb3dp-calibration"), "{told}");
    let program = folder.path().join("pb3dp-calibrate");
    fs::write(&program, "#!/bin/sh\necho \"$@\"\nexit 7\n").unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let started = calibrate();
    assert_eq!(String::from_utf8_lossy(&started.stdout), "stereo --board 9x6 --help\n");
    assert_eq!(started.status.code(), Some(7));
}
