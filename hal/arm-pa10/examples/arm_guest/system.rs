//! The emulated computer: file systems, modules, users, and kernel messages.
//!
//! Used by every program for that computer, like `report.rs`; each program has its own `clock`.

use std::error::Error;
use std::ffi::CString;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use rustix::mount::{MountFlags, mount};
use rustix::process::{Resource, Rlimit, setrlimit};
use rustix::system::{RebootCommand, finit_module, reboot, uname};

use crate::clock::{now, sleep_until};
use crate::report::Outcome;

/// User and group without rights.
const NOBODY: u32 = 65_534;

/// Actions of a driver take less than this.
pub const LONG: Duration = Duration::from_secs(20);

/// Mounts the file systems and loads the modules.
pub fn prepare() -> Outcome {
    for (what, place) in [("proc", "/proc"), ("sysfs", "/sys"), ("devtmpfs", "/dev"), ("tmpfs", "/tmp")] {
        mount(what, place, what, MountFlags::empty(), None).map_err(|error| format!("{place}: {error}"))?;
    }
    let order = fs::read_to_string("/modules/order")?;
    for name in order.lines() {
        load(name, "")?;
    }
    // Users without rights may lock no memory: the kernel's default is 8 MB.
    let none = Rlimit { current: Some(0), maximum: Some(0) };
    setrlimit(Resource::Memlock, none)?;
    let up = fs::read_to_string("/proc/uptime")?;
    let seconds = up.split(' ').next().unwrap_or_default().to_owned();
    Ok(format!("Linux {}, after {seconds} s", uname().release().to_string_lossy()))
}

/// Loads a packed module.
pub fn load(name: &str, parameters: &str) -> Result<(), Box<dyn Error>> {
    let file = File::open(format!("/modules/{name}.ko")).map_err(|error| format!("module {name}: {error}"))?;
    let loaded = finit_module(&file, &CString::new(parameters)?, 0);
    loaded.map_err(|error| format!("module {name} is not taken: {error}").into())
}

/// Powers the computer off.
pub fn switch_off() {
    // Otherwise output that the console has not shown yet would be lost.
    std::thread::sleep(Duration::from_millis(100));
    if let Err(error) = reboot(RebootCommand::PowerOff) {
        println!("the computer does not switch off: {error}");
    }
}

/// The user that runs a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum User {
    Root,
    Nobody,
}

/// Starts this program again with these arguments; returns its output.
pub fn as_user(user: User, args: &[&str]) -> Result<String, Box<dyn Error>> {
    let mut command = Command::new("/proc/self/exe");
    command.args(args);
    if user == User::Nobody {
        // This also drops the groups of root.
        command.uid(NOBODY).gid(NOBODY);
    }
    let output = command.output()?;
    let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    if output.status.success() {
        Ok(text)
    } else {
        Err(format!("{args:?} as {user:?}: {}: {text}", output.status).into())
    }
}

/// Waits until a condition holds; `what` names the condition in the error.
pub fn wait_for<T>(what: &str, mut is_so: impl FnMut() -> Option<T>) -> Result<T, Box<dyn Error>> {
    let end = now() + LONG;
    loop {
        if let Some(found) = is_so() {
            return Ok(found);
        }
        if now() > end {
            return Err(format!("{what}: not within {LONG:?}").into());
        }
        sleep_until(now() + Duration::from_millis(5));
    }
}

/// Kernel messages from a moment on, with their time on the monotonic clock of programs.
pub struct KernelLog {
    file: File,
    /// Monotonic time minus time of the kernel's log, ns.
    offset_ns: i128,
}

impl KernelLog {
    /// From now on. A message of this program relates the two clocks.
    pub fn open() -> Result<Self, Box<dyn Error>> {
        const NONBLOCK: i32 = 0o4000;
        let file = OpenOptions::new().read(true).write(true).custom_flags(NONBLOCK).open("/dev/kmsg")?;
        let mut log = Self { file, offset_ns: 0 };
        while log.next()?.is_some() {}
        let before = now();
        let mark = format!("pb3dp: the time is {} ns", before.as_nanos());
        // The kernel delays a message without a line end.
        log.file.write_all(format!("{mark}\n").as_bytes())?;
        let (at, _) = wait_for("our own message in the kernel's log", || {
            log.next().ok().flatten().filter(|(_, text)| *text == mark)
        })?;
        // The kernel takes the message at once, so `before` is nearer to its time than the time after it was printed.
        log.offset_ns = i128::from(before.as_nanos()) - i128::from(at.as_nanos());
        Ok(log)
    }

    /// Waits for a kernel message that contains this word; returns its time.
    pub fn wait_for(&mut self, term: &str) -> Result<MonotonicTime, Box<dyn Error>> {
        let what = format!("the kernel says `{term}`");
        wait_for(&what, || self.next().ok().flatten().filter(|(_, text)| text.contains(term)).map(|(at, _)| at))
    }

    fn next(&mut self) -> Result<Option<(MonotonicTime, String)>, Box<dyn Error>> {
        // One message with each call: "6,339,5140900,-;text", with the time in microseconds.
        let mut buffer = [0; 8192];
        let count = match self.file.read(&mut buffer) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
            // Newer messages have overwritten older ones.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return self.next(),
            Err(error) => return Err(error.into()),
        };
        let text = String::from_utf8_lossy(&buffer[..count]).into_owned();
        let (head, rest) = text.split_once(';').ok_or_else(|| format!("message of the kernel: {text}"))?;
        let micros: u64 = head.split(',').nth(2).unwrap_or_default().parse()?;
        let nanos = i128::from(micros) * 1000 + self.offset_ns;
        let message = rest.lines().next().unwrap_or_default().to_owned();
        Ok(Some((MonotonicTime::from_nanos(u64::try_from(nanos)?), message)))
    }
}

/// For the report of a failure.
pub fn last_kernel_messages(count: usize) -> Vec<String> {
    const NONBLOCK: i32 = 0o4000;
    let Ok(file) = OpenOptions::new().read(true).custom_flags(NONBLOCK).open("/dev/kmsg") else { return Vec::new() };
    let mut log = KernelLog { file, offset_ns: 0 };
    let mut messages: Vec<_> = std::iter::from_fn(|| log.next().ok().flatten()).map(|(_, text)| text).collect();
    messages.split_off(messages.len().saturating_sub(count))
}
