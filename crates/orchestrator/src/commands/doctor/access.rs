//! User, groups and permissions.

use super::system::{Node, System};
use pb3dp_cell::finding::Finding;

/// Bit of `CAP_NET_RAW` in Linux's `linux/capability.h`.
const CAP_NET_RAW: u32 = 13;

/// User and groups of this program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub(super) uid: u32,
    pub(super) gids: Vec<u32>,
    capabilities: u64,
}

impl Identity {
    /// From `/proc/self/status`; `None` if it is unreadable.
    pub(super) fn of(system: &dyn System) -> Option<Self> {
        let text = system.text("/proc/self/status")?;
        let line = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)).map(str::trim);
        let numbers = |key: &str| -> Vec<u32> {
            line(key).unwrap_or_default().split_whitespace().filter_map(|word| word.parse().ok()).collect()
        };
        // Real, effective, saved, of files.
        let uid = *numbers("Uid:").get(1)?;
        let mut gids = numbers("Groups:");
        gids.extend(numbers("Gid:").get(1));
        let capabilities = u64::from_str_radix(line("CapEff:").unwrap_or("0"), 16).unwrap_or(0);
        Some(Self { uid, gids, capabilities })
    }

    pub(super) fn is_root(&self) -> bool {
        self.uid == 0
    }

    /// Whether packet sockets are permitted.
    pub(super) fn has_net_raw(&self) -> bool {
        self.capabilities >> CAP_NET_RAW & 1 == 1
    }

    /// Whether a file is readable and writable.
    pub(super) fn may_use(&self, node: &Node) -> bool {
        const READ_AND_WRITE: u32 = 0o6;
        let shift = if node.uid == self.uid {
            6
        } else if self.gids.contains(&node.gid) {
            3
        } else {
            0
        };
        self.is_root() || node.mode >> shift & READ_AND_WRITE == READ_AND_WRITE
    }
}

/// Names and numbers of `/etc/group`.
pub(super) fn groups(system: &dyn System) -> Vec<(String, u32)> {
    let text = system.text("/etc/group").unwrap_or_default();
    let parse = |line: &str| {
        let mut fields = line.split(':');
        Some((fields.next()?.to_owned(), fields.nth(1)?.parse().ok()?))
    };
    text.lines().filter_map(parse).collect()
}

/// Why a device is not accessible, and the remedy; `None` if it is accessible.
pub(super) fn denied(system: &dyn System, who: &Identity, path: &str, node: &Node) -> Option<(String, String)> {
    if who.may_use(node) {
        return None;
    }
    let group = groups(system).into_iter().find(|(_, gid)| *gid == node.gid).map(|(name, _)| name);
    let name = group.clone().unwrap_or_else(|| node.gid.to_string());
    let found =
        format!("{path}: this user cannot read and write it (mode {:03o}, user {}, group {name})", node.mode, node.uid);
    let advice = match group {
        Some(name) if name != "root" && node.mode & 0o060 == 0o060 => {
            format!("usermod -aG {name} USER, and log in again")
        }
        _ => "install configs/deploy/70-pb3dp.rules in /etc/udev/rules.d, and plug it in again".to_owned(),
    };
    Some((found, advice))
}

/// Whether the groups of the deployment files exist, and this user belongs to them.
pub(super) fn check(system: &dyn System, wanted: &[&str]) -> Vec<Finding> {
    const CHECK: &str = "groups";
    let Some(who) = Identity::of(system) else {
        return vec![Finding::fail(CHECK, "/proc/self/status cannot be read", "mount /proc")];
    };
    let known = groups(system);
    let mut findings = Vec::new();
    for name in wanted {
        findings.push(match known.iter().find(|(group, _)| group == name) {
            None => Finding::warning(
                CHECK,
                format!("there is no group {name}"),
                "install configs/deploy/pb3dp-sysusers.conf as /etc/sysusers.d/pb3dp.conf, then: systemd-sysusers",
            ),
            Some((_, gid)) if who.gids.contains(gid) => Finding::pass(CHECK, format!("this user is in group {name}")),
            Some(_) if who.is_root() => {
                Finding::pass(CHECK, format!("group {name} exists (not needed when running as root)"))
            }
            Some(_) => Finding::warning(
                CHECK,
                format!("this user is not in group {name}"),
                format!("usermod -aG {name} USER, and log in again"),
            ),
        });
    }
    findings
}
