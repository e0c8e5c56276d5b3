//! Helpers for terminal programs: lines in and out, and numbers on a command line.

use std::io::{self, BufRead, Read, Write};
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

/// The lines of [`typed_lines`] as an input, after the first ones were read as answers: a second reader of standard input would compete
/// with the first one.
#[derive(Debug)]
pub struct TypedInput {
    lines: Receiver<io::Result<String>>,
    rest: io::Cursor<Vec<u8>>,
}

impl TypedInput {
    /// The remaining lines.
    pub fn of(lines: Receiver<io::Result<String>>) -> Self {
        Self { lines, rest: io::Cursor::default() }
    }
}

impl Read for TypedInput {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut available = self.fill_buf()?;
        let count = available.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for TypedInput {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.rest.fill_buf()?.is_empty()
            && let Ok(line) = self.lines.recv()
        {
            self.rest = io::Cursor::new((line? + "\n").into_bytes());
        }
        self.rest.fill_buf()
    }

    fn consume(&mut self, count: usize) {
        self.rest.consume(count);
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_after_an_answer_are_read_as_an_input() {
        let (sender, lines) = channel();
        for line in ["vs-robot", "select", "", "start"] {
            sender.send(Ok(line.to_owned())).unwrap();
        }
        drop(sender);
        assert_eq!(lines.recv().unwrap().unwrap(), "vs-robot");
        let mut text = String::new();
        TypedInput::of(lines).read_to_string(&mut text).unwrap();
        assert_eq!(text, "select\n\nstart\n");
    }
}
