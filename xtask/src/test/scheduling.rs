//! Scheduling priorities during the tests.

use std::fs;
use std::process::Command;

/// Niceness of the session during the tests.
const NICE_OF_SESSION: &str = "19";
/// Starts a program in the class SCHED_IDLE.
const IDLE: &[&str] = &["chrt", "--idle", "0"];
const AUTOGROUP: &str = "/proc/self/autogroup";

/// Priority that real-time tests can have on this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Precedence {
    /// None: they run after all others.
    None,
    /// Over all normal programs, if their threads get a SCHED_FIFO priority. Whole programs, which compute, wait for all others.
    Priority,
    /// Over the other tests, which run in the class SCHED_IDLE, as also the kernel threads that carry bytes to a
    /// terminal have priority over these.
    Class,
}

impl Precedence {
    /// The priority on this machine.
    pub fn find() -> Self {
        match (grants_real_time(), has_idle_class()) {
            (false, _) => Self::None,
            (true, false) => Self::Priority,
            (true, true) => Self::Class,
        }
    }

    /// Prefix of the command of other tests: a program that lowers their priority.
    pub fn of_tests(self) -> &'static [&'static str] {
        match self {
            Self::Class => IDLE,
            _ => &["nice", "-n", "10"],
        }
    }

    /// Prefix of a build beside the tests.
    pub fn of_build(self) -> &'static [&'static str] {
        match self {
            Self::Class => IDLE,
            _ => &[],
        }
    }
}

/// Whether all normal threads have priority over a program of the class SCHED_IDLE. In a separate control group the program
/// competes with kernel threads by the weight of its group; the same holds for a separate session, but not with its niceness
/// ([`LowSession`]).
fn has_idle_class() -> bool {
    let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let chrt = Command::new(IDLE[0]).args(&IDLE[1..]).arg("true").status();
    chrt.is_ok_and(|status| status.success()) && shares_processors_with_kernel(&groups)
}

/// Whether processors are shared with kernel threads without a control group between: from /proc/self/cgroup.
fn shares_processors_with_kernel(groups: &str) -> bool {
    let mut group_of_all = None;
    for line in groups.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { continue };
        if controllers.split(',').any(|name| name == "cpu") {
            return path == "/";
        }
        if controllers.is_empty() {
            group_of_all = Some(path);
        }
    }
    group_of_all == Some("/")
}

/// Lowers the priority of this program's session until this is dropped. Linux divides processors between sessions first
/// (sched(7), "The autogroup feature"): without this, the class of a program counts within its session only, and kernel
/// threads are in none.
pub struct LowSession {
    before: Option<String>,
}

impl LowSession {
    /// Whether the machine divides processors by sessions.
    pub fn enter() -> Self {
        let before = fs::read_to_string(AUTOGROUP).ok();
        let nice = before.as_deref().and_then(|text| text.split_whitespace().last()).map(str::to_owned);
        let is_lowered = nice.is_some() && fs::write(AUTOGROUP, NICE_OF_SESSION).is_ok();
        Self { before: nice.filter(|_| is_lowered) }
    }
}

impl Drop for LowSession {
    fn drop(&mut self) {
        if let Some(nice) = &self.before {
            // An interrupted run has left the session at low priority.
            let nice = if nice == NICE_OF_SESSION { "0" } else { nice };
            fs::write(AUTOGROUP, nice).ok();
        }
    }
}

/// Whether this process may use SCHED_FIFO: it has the capability, or its limit allows a priority.
fn grants_real_time() -> bool {
    const SYS_NICE: u32 = 23;
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let capabilities = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let has_capability = capabilities
        .and_then(|digits| u64::from_str_radix(digits.trim(), 16).ok())
        .is_some_and(|bits| bits >> SYS_NICE & 1 == 1);
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let limit = limits.lines().find_map(|line| line.strip_prefix("Max realtime priority"));
    let has_limit = limit.and_then(|rest| rest.split_whitespace().next()).is_some_and(|soft| soft != "0");
    has_capability || has_limit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_without_a_group_are_processors_shared_with_the_kernel() {
        for (groups, expected) in [
            ("9:name=systemd:/\n4:memory:/a\n1:cpu:/\n0::/\n", true),
            ("3:cpu,cpuacct:/user.slice\n0::/\n", false),
            ("0::/\n", true),
            ("0::/user.slice/user-1000.slice/session-2.scope\n", false),
            ("", false),
        ] {
            assert_eq!(shares_processors_with_kernel(groups), expected, "{groups:?}");
        }
    }
}
