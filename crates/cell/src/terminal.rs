//! Helpers for terminal programs: lines in and out, and numbers on a command line.

use std::io::{self, BufRead, Read, Write};
use std::sync::mpsc::{Receiver, Sender, channel};

use anyhow::{Context, Result};
use rustix::termios::{LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr};

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

/// The line without the escape sequences of arrow and function keys.
pub fn without_escape_sequences(line: &str) -> String {
    let (mut text, mut rest) = (String::with_capacity(line.len()), line.chars().peekable());
    while let Some(c) = rest.next() {
        if c != '\x1b' {
            text.push(c);
        } else if rest.next_if_eq(&'O').is_some() {
            // SS3: one character follows.
            rest.next();
        } else if rest.next_if_eq(&'[').is_some() {
            // CSI: parameters and a final character (ECMA-48, 5.4). The Linux console sends `[[A` for F1.
            if rest.next_if_eq(&'[').is_none() {
                while rest.next_if(|c| (' '..='?').contains(c)).is_some() {}
            }
            rest.next_if(|c| ('@'..='~').contains(c));
        }
    }
    text
}

/// Whether a line contains a word in any case, with any punctuation, escape sequences or control characters around it. Only for words
/// that stop something.
pub fn has_term(line: &str, term: &str) -> bool {
    let is_in = |text: &str| text.split(|c: char| !c.is_alphabetic()).any(|part| part.eq_ignore_ascii_case(term));
    // The line as it is, too: a key can take the first letter of the word for its own.
    is_in(line) || is_in(&without_escape_sequences(line).replace(char::is_control, ""))
}

/// The lines of standard input without line ends, as they arrive; none follows an error. At a terminal Ctrl-D ends a line, too, and the
/// key Esc does under [`EscapeEndsLine`].
///
/// # Errors
/// If the system provides no thread.
pub fn typed_lines() -> Result<Receiver<std::io::Result<String>>> {
    let (sender, receiver) = channel();
    let is_by_line = tcgetattr(io::stdin()).is_ok_and(|settings| settings.local_modes.contains(LocalModes::ICANON));
    let read = move || read_lines(io::stdin().lock(), is_by_line, &sender);
    std::thread::Builder::new().name("typed lines".to_owned()).spawn(read).context("no thread for typed lines")?;
    Ok(receiver)
}

/// Reads until the input or its receiver ends. A terminal that delivers line by line delivers nothing else: each piece is a line.
fn read_lines(mut input: impl BufRead, is_by_line: bool, lines: &Sender<io::Result<String>>) {
    let mut line = Vec::new();
    loop {
        let piece = match input.fill_buf() {
            Ok(piece) => piece,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return drop(lines.send(Err(error))),
        };
        let is_last = piece.is_empty();
        let end = piece.iter().position(|byte| *byte == b'\n');
        line.extend_from_slice(&piece[..end.unwrap_or(piece.len())]);
        let length = end.map_or(piece.len(), |end| end + 1);
        input.consume(length);
        let is_whole = end.is_some() || is_by_line || line.ends_with(&[ESCAPE]);
        // Bytes that are no text are part of a line: they must not end the reading.
        let is_complete = if is_last { !line.is_empty() } else { is_whole };
        if (is_complete && lines.send(Ok(text_of(std::mem::take(&mut line)))).is_err()) || is_last {
            return;
        }
    }
}

fn text_of(mut line: Vec<u8>) -> String {
    line.pop_if(|end| *end == b'\r');
    String::from_utf8_lossy(&line).into_owned()
}

/// The byte of the key Esc; arrow and function keys begin with it.
const ESCAPE: u8 = 0x1b;

/// While it lives, the key Esc ends a line at the terminal as Enter does, so that it is heard at once.
#[derive(Debug)]
pub struct EscapeEndsLine {
    before: Termios,
}

impl EscapeEndsLine {
    /// `None` if standard input is no terminal.
    pub fn set() -> Option<Self> {
        let before = tcgetattr(io::stdin()).ok()?;
        let mut changed = before.clone();
        changed.special_codes[SpecialCodeIndex::VEOL] = ESCAPE;
        tcsetattr(io::stdin(), OptionalActions::Now, &changed).ok()?;
        Some(Self { before })
    }
}

impl Drop for EscapeEndsLine {
    fn drop(&mut self) {
        // A terminal that is gone needs no settings.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
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
        _ => Err(with_unit(text, "seconds", &["s", "sec"])
            .unwrap_or_else(|| format!("{text:?} is not a number of seconds above 0, up to 1000000"))),
    }
}

/// The message for a number with a unit, where a number of `unit` without one is wanted; names the number if its unit is one of
/// `symbols`. `None` for other texts.
pub fn with_unit(text: &str, unit: &str, symbols: &[&str]) -> Option<String> {
    let number = text.trim_end_matches(|c: char| c.is_alphabetic() || c == '°').trim_end();
    let symbol = text[number.len()..].trim_start();
    number.parse::<f64>().ok().filter(|_| !symbol.is_empty())?;
    let bare = if symbols.contains(&symbol) { format!(": {number}") } else { String::new() };
    Some(format!("{text:?}: give the number in {unit}, without a unit{bare}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escape_sequences_are_dropped_and_nothing_else() {
        for (line, text) in [
            ("\x1b[Astop", "stop"),
            ("st\x1b[1;5Dop", "stop"),
            ("\x1bOPstart\x1b[15~", "start"),
            ("\x1b[[Ahold", "hold"),
            ("\x1b[200~local\x1b[201~", "local"),
            ("\x1bstop\x1b[", "stop"),
            ("stop [A é\x08", "stop [A é\x08"),
        ] {
            assert_eq!(without_escape_sequences(line), text, "{line:?}");
        }
    }

    #[test]
    fn a_command_is_found_among_other_text_and_keys() {
        for line in ["stop", "STOP!", "é stop", "\x1b[Astop", "\x1b[stop", "e-stop", "\0st\x07op", "x\u{fffd}stop"] {
            assert!(has_term(line, "stop"), "{line:?}");
        }
        assert!(!["stopping", "qstop", "nonstop", "sto p", ""].into_iter().any(|line| has_term(line, "stop")));
    }

    #[test]
    fn a_piece_of_a_terminal_is_a_line_and_a_piece_of_a_pipe_is_not_unless_it_ends_with_escape() {
        let lines_of = |is_by_line| {
            let (sender, lines) = channel();
            let pieces = (&b"a\r\nst"[..]).chain(&b"op"[..]).chain(&b"\x1b"[..]).chain(&b"en\xffd"[..]);
            read_lines(pieces, is_by_line, &sender);
            drop(sender);
            lines.iter().map(Result::unwrap).collect::<Vec<_>>()
        };
        assert_eq!(lines_of(false), ["a", "stop\x1b", "en\u{fffd}d"]);
        assert_eq!(lines_of(true), ["a", "st", "op", "\x1b", "en\u{fffd}d"]);
    }

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
