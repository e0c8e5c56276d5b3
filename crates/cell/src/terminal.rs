//! Helpers for terminal programs: lines in and out, and numbers on a command line.

use std::io::{self, BufRead, Write};
use std::sync::mpsc::{Receiver, channel};

use anyhow::{Context, Result};

/// Writes one line to standard output; a closed pipe is no error.
///
/// # Errors
/// If standard output cannot be written for another reason.
pub fn print_line(line: &str) -> io::Result<()> {
    match writeln!(io::stdout().lock(), "{line}") {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// The lines of standard input without line ends, as they arrive; none follows an error.
///
/// # Errors
/// If the system provides no thread.
pub fn typed_lines() -> Result<Receiver<std::io::Result<String>>> {
    let (sender, receiver) = channel();
    let read = move || {
        for line in std::io::stdin().lock().lines() {
            let is_last = line.is_err();
            if sender.send(line).is_err() || is_last {
                return;
            }
        }
    };
    std::thread::Builder::new().name("typed lines".to_owned()).spawn(read).context("no thread for typed lines")?;
    Ok(receiver)
}

/// A duration in seconds, above 0 to 1e6.
///
/// # Errors
/// The allowed range.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds <= 1e6 => Ok(seconds),
        _ => Err(format!("{text:?} is not a number of seconds above 0, up to 1000000")),
    }
}
