//! An operator says that he wants an arm to move.

use std::io::BufRead;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::io::signals::StopSignals;

/// Signals are looked for this often while nothing is typed.
const LOOK: Duration = Duration::from_millis(50);

/// Waits until exactly this name was typed.
///
/// # Errors
/// If something else is typed, standard input ends, or a signal asks to end.
pub fn typed(name: &str, signals: &mut StopSignals) -> Result<()> {
    let (sender, receiver) = channel();
    let read = move || {
        let mut line = String::new();
        let got = std::io::stdin().lock().read_line(&mut line).map(|bytes| (bytes > 0).then_some(line));
        // Nobody can be gone who waits for it but the whole program.
        sender.send(got).ok();
    };
    std::thread::Builder::new().name("confirmation".to_owned()).spawn(read).context("no thread for typed lines")?;
    loop {
        if let Some(signal) = signals.try_take()? {
            bail!("ended by {signal}; nothing was moved");
        }
        match receiver.recv_timeout(LOOK) {
            Ok(line) => match line.context("standard input can not be read; nothing was moved")? {
                Some(line) if line.trim_end_matches(['\n', '\r']) == name => return Ok(()),
                Some(line) => bail!("{:?} is not {name}; nothing was moved", line.trim_end()),
                None => bail!("nobody typed {name}: standard input has ended; nothing was moved"),
            },
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => bail!("standard input can not be read; nothing was moved"),
        }
    }
}
