//! Standard input line by line, without waiting for it.

use std::io::BufRead;
use std::sync::mpsc::{Receiver, channel};

use anyhow::{Context, Result};

/// The lines of standard input without their ends, as they come; after an error none follows.
///
/// # Errors
/// If the system gives no thread.
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
