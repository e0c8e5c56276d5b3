//! Commands to QEMU while it runs: the QEMU Machine Protocol, lines of JSON on a socket.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use serde_json::{Map, Value, json};

/// Timeout for QEMU: it answers at once, and takes two seconds for a device at most.
const TIMEOUT: Duration = Duration::from_secs(20);

/// A connection to QEMU.
pub struct Control {
    stream: BufReader<UnixStream>,
}

impl Control {
    /// # Errors
    /// If QEMU does not run or does not send its greeting.
    pub fn connect(socket: &Path) -> anyhow::Result<Self> {
        let stream = UnixStream::connect(socket).context("cannot connect to QEMU")?;
        stream.set_read_timeout(Some(TIMEOUT))?;
        stream.set_write_timeout(Some(TIMEOUT))?;
        let mut control = Self { stream: BufReader::new(stream) };
        control.until(|message| message.get("QMP").is_some())?;
        control.command("qmp_capabilities", json!({}))?;
        Ok(control)
    }

    /// Unplugs a device, and waits until QEMU reports that it is gone.
    ///
    /// # Errors
    /// If it is not gone in time.
    pub fn unplug(&mut self, name: &str) -> anyhow::Result<()> {
        self.send("device_del", json!({ "id": name }))?;
        // The answer and the end of the device arrive in any order.
        let (mut answered, mut gone) = (false, false);
        self.until(|message| {
            answered |= message.get("return").is_some();
            gone |= message["event"] == "DEVICE_DELETED" && message["data"]["device"] == name;
            answered && gone
        })
        .with_context(|| format!("{name} was not unplugged"))
    }

    /// Plugs a device in: as on QEMU's command line, `usb-serial,bus=usb.0`.
    ///
    /// # Errors
    /// If QEMU refuses it.
    pub fn plug(&mut self, name: &str, what: &str) -> anyhow::Result<()> {
        self.command("device_add", arguments(name, what)).with_context(|| format!("{name} was not plugged in"))
    }

    fn command(&mut self, command: &str, arguments: Value) -> anyhow::Result<()> {
        self.send(command, arguments)?;
        self.until(|message| message.get("return").is_some())
    }

    fn send(&mut self, command: &str, arguments: Value) -> anyhow::Result<()> {
        let message = json!({ "execute": command, "arguments": arguments });
        writeln!(self.stream.get_mut(), "{message}").context("cannot send a command to QEMU")
    }

    /// Reads until a message matches; an error from QEMU ends it.
    fn until(&mut self, mut is_it: impl FnMut(&Value) -> bool) -> anyhow::Result<()> {
        let end = Instant::now() + TIMEOUT;
        let mut line = String::new();
        loop {
            line.clear();
            if self.stream.read_line(&mut line).context("QEMU does not answer")? == 0 {
                bail!("QEMU has ended");
            }
            let message: Value = serde_json::from_str(&line).context("QEMU does not answer in JSON")?;
            if let Some(error) = message.get("error") {
                bail!("QEMU reports: {}", error["desc"].as_str().unwrap_or_default());
            }
            if is_it(&message) {
                return Ok(());
            }
            if Instant::now() > end {
                bail!("QEMU does not answer");
            }
        }
    }
}

/// A device in the form of a message.
fn arguments(name: &str, what: &str) -> Value {
    let mut map = Map::new();
    let mut parts = what.split(',');
    map.insert("driver".to_owned(), parts.next().unwrap_or_default().into());
    for (key, value) in parts.filter_map(|part| part.split_once('=')) {
        map.insert(key.to_owned(), value.into());
    }
    map.insert("id".to_owned(), name.into());
    Value::Object(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_the_same_on_the_command_line_and_later() {
        let expected = json!({ "driver": "usb-serial", "bus": "usb.0", "chardev": "line", "id": "host" });
        assert_eq!(arguments("host", "usb-serial,bus=usb.0,chardev=line"), expected);
    }
}
