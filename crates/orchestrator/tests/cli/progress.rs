//! Progress bars: in a terminal, and nowhere else.

use std::fs::File;
use std::path::Path;
use std::process::{Command, Stdio};

use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink;

/// `pb3dp estimate` on the cases of the repository.
fn estimate(stderr: Stdio) -> std::process::Child {
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
    let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
    command.arg("estimate").arg("--cases").arg(cases).arg("--json").env("TERM", "xterm");
    command.stdout(Stdio::piped()).stderr(stderr).spawn().unwrap()
}

#[test]
fn a_terminal_shows_a_bar_and_whole_lines() {
    let mut terminal = Pty::open().unwrap();
    let line = File::options().read(true).write(true).open(terminal.path()).unwrap();
    rustix::termios::tcsetwinsize(
        &line,
        rustix::termios::Winsize { ws_row: 30, ws_col: 120, ws_xpixel: 0, ws_ypixel: 0 },
    )
    .unwrap();
    let mut child = estimate(line.into());
    let (mut shown, mut buffer) = (Vec::new(), [0; 4096]);
    loop {
        let has_ended = child.try_wait().unwrap().is_some();
        let count = terminal.try_read(&mut buffer).unwrap();
        shown.extend_from_slice(&buffer[..count]);
        if has_ended && count == 0 {
            break;
        }
    }
    let shown = String::from_utf8_lossy(&shown).into_owned();
    assert!(shown.contains("pairs [") && shown.contains("/4 "), "{shown}");
    let log = shown.split("INFO").nth(1).expect("a line of the log");
    assert!(log.contains("4 cases"), "{shown}");
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    for line in String::from_utf8(output.stdout).unwrap().lines() {
        serde_json::from_str::<serde_json::Value>(line).unwrap();
    }
}

#[test]
fn without_a_terminal_there_is_no_bar() {
    let output = estimate(Stdio::piped()).wait_with_output().unwrap();
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(log.contains("4 cases") && !log.contains("pairs [") && !log.contains('\r'), "{log}");
}
