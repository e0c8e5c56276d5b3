//! The emulated computer: QEMU as a child process that never outlives us, with a time limit.

use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};

use super::control::Control;
use super::suites::Suite;
use crate::apt::need;
use crate::workspace::output_of;

const QEMU: &str = "qemu-system-x86_64";
const PACKAGE: &str = "qemu-system-x86";

/// A guest that takes longer than this hangs. The longest suite takes a minute or two on an idle machine.
const LIMIT: Duration = Duration::from_secs(600);

/// Options of every emulated computer. KVM is not used, even if available: the tests work without it, and everywhere in the same way.
/// One plain processor is emulated faster than two.
///
/// Its time is counted, not measured: an instruction takes a nanosecond, and waiting takes no real time. On a busy or slow machine
/// a suite takes longer and gets the same results.
///
/// The default firmware waits for USB devices, which costs as much as the kernel's start; the small one starts the kernel at once.
const COMPUTER: &str = "-icount shift=0,sleep=off -bios qboot.rom -accel tcg -smp 1 -m 512 -nodefaults -no-user-config \
    -no-reboot -display none -serial stdio -rtc base=utc";

/// Kernel messages stay off the console, where they would mix with the lines of the tests; the guest shows them if a test fails.
const KERNEL_ARGUMENTS: &str = "console=ttyS0 quiet loglevel=1 panic=-1";

/// A running emulated computer.
pub struct Machine {
    child: Child,
    lines: Receiver<String>,
    control: Option<Control>,
    socket: PathBuf,
    deadline: Instant,
}

/// Path of QEMU, which is installed if permitted.
///
/// # Errors
/// [`crate::not_possible::NotPossible`], with the package to install.
pub fn find_qemu() -> anyhow::Result<PathBuf> {
    need(QEMU, PACKAGE, || output_of(Command::new(QEMU).arg("--version")).is_ok())?;
    Ok(PathBuf::from(QEMU))
}

impl Machine {
    /// Starts an emulated computer. Its sockets are in `folder`.
    ///
    /// # Errors
    /// If QEMU does not start.
    pub fn start(qemu: &Path, kernel: &Path, disk: &Path, suite: &Suite, folder: &Path) -> anyhow::Result<Self> {
        let socket = folder.join("control");
        let mut command = Command::new(qemu);
        command
            .args(COMPUTER.split_whitespace())
            .args(["-cpu", suite.processor])
            .arg("-kernel")
            .arg(kernel)
            .arg("-initrd")
            .arg(disk);
        command.arg("-append").arg(format!("{KERNEL_ARGUMENTS} {} -- {}", suite.kernel_arguments, suite.name));
        command.arg("-qmp").arg(format!("unix:{},server=on,wait=off", socket.display()));
        for (option, value) in suite.fixed.iter().filter_map(|text| text.split_once(' ')) {
            command.arg(option).arg(value.replace("FOLDER", &folder.display().to_string()));
        }
        for device in suite.pluggable {
            command.arg("-device").arg(format!("{},id={}", device.what, device.name));
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut child = command.spawn().with_context(|| format!("cannot start {}", qemu.display()))?;
        let output = child.stdout.take().context("QEMU has no output")?;
        let (tell, lines) = channel();
        std::thread::spawn(move || {
            let mut output = BufReader::new(output);
            let mut line = Vec::new();
            while matches!(output.read_until(b'\n', &mut line), Ok(1..)) {
                if tell.send(String::from_utf8_lossy(&line).trim().to_owned()).is_err() {
                    return;
                }
                line.clear();
            }
        });
        Ok(Self { child, lines, control: None, socket, deadline: Instant::now() + LIMIT })
    }

    /// The next line of the console, `None` when the computer is off.
    ///
    /// # Errors
    /// If it takes too long.
    pub fn next_line(&mut self) -> anyhow::Result<Option<String>> {
        match self.lines.recv_timeout(self.deadline.saturating_duration_since(Instant::now())) {
            Ok(line) => Ok(Some(line)),
            Err(RecvTimeoutError::Disconnected) => Ok(None),
            Err(RecvTimeoutError::Timeout) => bail!("the guest did not finish within {} s", LIMIT.as_secs()),
        }
    }

    /// Whether a signal that is not ours ended QEMU. A guest that fails ends it normally.
    pub fn has_crashed(&mut self) -> bool {
        let end = Instant::now() + Duration::from_secs(2);
        while Instant::now() < end {
            match self.child.try_wait() {
                Ok(Some(status)) => return status.signal().is_some(),
                Ok(None) => std::thread::sleep(Duration::from_millis(20)),
                Err(_) => return false,
            }
        }
        false
    }

    /// Unplugs a device, and waits until it is gone.
    ///
    /// # Errors
    /// If QEMU fails.
    pub fn unplug(&mut self, name: &str) -> anyhow::Result<()> {
        self.control()?.unplug(name)
    }

    /// Plugs the device in again.
    ///
    /// # Errors
    /// If the suite has no such device, or QEMU fails.
    pub fn plug(&mut self, suite: &Suite, name: &str) -> anyhow::Result<()> {
        let device = suite.pluggable.iter().find(|device| device.name == name);
        let device = device.with_context(|| format!("the guest requests `{name}`, which this suite does not have"))?;
        self.control()?.plug(name, device.what)
    }

    fn control(&mut self) -> anyhow::Result<&mut Control> {
        if self.control.is_none() {
            self.control = Some(Control::connect(&self.socket)?);
        }
        self.control.as_mut().context("no connection to QEMU")
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // QEMU has already ended, unless an error occurred.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
