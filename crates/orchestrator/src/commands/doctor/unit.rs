//! The installed systemd unit of a gateway, compared with the sandbox of the shipped one.

use super::needs::Needs;
use super::system::System;
use pb3dp_cell::finding::Finding;

const CHECK: &str = "gateway service";

/// File name of the unit.
const UNIT: &str = "pb3dp-gateway@.service";

/// Folders of units, in the order of precedence (systemd.unit(5)).
const FOLDERS: [&str; 4] =
    ["/etc/systemd/system", "/run/systemd/system", "/usr/local/lib/systemd/system", "/usr/lib/systemd/system"];

/// Settings of `configs/deploy/pb3dp-gateway@.service` that confine the gateway. A list has one entry per line of the unit.
pub(super) const SANDBOX: [(&str, &[&str]); 25] = [
    ("User", &["pb3dp"]),
    ("AmbientCapabilities", &["CAP_NET_RAW"]),
    ("CapabilityBoundingSet", &["CAP_NET_RAW"]),
    ("NoNewPrivileges", &["yes"]),
    ("ProtectSystem", &["strict"]),
    ("ProtectHome", &["yes"]),
    ("PrivateTmp", &["yes"]),
    ("PrivateMounts", &["yes"]),
    ("ProtectProc", &["invisible"]),
    ("ProtectKernelModules", &["yes"]),
    ("ProtectKernelTunables", &["yes"]),
    ("ProtectKernelLogs", &["yes"]),
    ("ProtectControlGroups", &["yes"]),
    ("ProtectHostname", &["yes"]),
    ("RestrictNamespaces", &["yes"]),
    ("RestrictSUIDSGID", &["yes"]),
    ("LockPersonality", &["yes"]),
    ("MemoryDenyWriteExecute", &["yes"]),
    ("RemoveIPC", &["yes"]),
    ("UMask", &["0077"]),
    ("RestrictAddressFamilies", &["AF_INET AF_INET6 AF_UNIX AF_PACKET"]),
    ("DevicePolicy", &["closed"]),
    ("DeviceAllow", &["char-ttyS rw", "char-ttyUSB rw", "char-ttyACM rw"]),
    ("SystemCallArchitectures", &["native"]),
    ("SystemCallFilter", &["@system-service", "~@privileged"]),
];

/// The unit of a gateway, if one is installed.
pub(super) fn check(system: &dyn System, needs: &Needs) -> Vec<Finding> {
    if !needs.is_gateway {
        return Vec::new();
    }
    let Some((path, text)) = FOLDERS.iter().find_map(|folder| {
        let path = format!("{folder}/{UNIT}");
        system.text(&path).map(|text| (path, text))
    }) else {
        return vec![Finding::pass(CHECK, format!("{UNIT} is not installed; a person starts the gateway"))];
    };
    let texts: Vec<String> = std::iter::once(text).chain(drop_ins(system)).collect();
    let wrong: Vec<String> = SANDBOX.iter().filter_map(|(key, wanted)| difference(&texts, key, wanted)).collect();
    if wrong.is_empty() {
        return vec![Finding::pass(CHECK, format!("{path} confines the gateway as the shipped unit does"))];
    }
    let advice = format!(
        "install configs/deploy/{UNIT} there, remove what overrides it in {UNIT}.d, then: systemctl daemon-reload; restart the gateway \
         while the arm is off"
    );
    vec![Finding::warning(CHECK, format!("{path} differs from the shipped unit: {}", wrong.join("; ")), advice)]
}

/// Texts of the drop-in files of the unit.
fn drop_ins(system: &dyn System) -> Vec<String> {
    let in_folder = |folder: &&str| {
        let folder = format!("{folder}/{UNIT}.d");
        let names = system.names(&folder).into_iter().filter(|name| name.ends_with(".conf"));
        names.filter_map(|name| system.text(&format!("{folder}/{name}"))).collect::<Vec<_>>()
    };
    FOLDERS.iter().flat_map(in_folder).collect()
}

/// What the texts set a key to instead of the wanted values; `None` if they agree.
fn difference(texts: &[String], key: &str, wanted: &[&str]) -> Option<String> {
    let mut found: Vec<&str> = Vec::new();
    for value in texts.iter().flat_map(|text| values(text, key)) {
        // An empty value removes the earlier ones; a setting that is no list keeps only the last value.
        if value.is_empty() || wanted.len() == 1 {
            found.clear();
        }
        found.extend((!value.is_empty()).then_some(value));
    }
    let is_same =
        found.len() == wanted.len() && found.iter().zip(wanted).all(|(one, other)| means_the_same(one, other));
    (!is_same).then(|| format!("{key}={}, not {}", found.join(" + "), wanted.join(" + ")))
}

/// Values of a key in one file, in order.
fn values<'a>(text: &'a str, key: &'a str) -> impl Iterator<Item = &'a str> {
    text.lines().filter_map(move |line| line.trim().strip_prefix(key)?.strip_prefix('=').map(str::trim))
}

/// Whether two values mean the same: systemd also accepts `true`, `on` and `1` for `yes`.
fn means_the_same(one: &str, other: &str) -> bool {
    let is_yes = |value: &str| ["yes", "true", "on", "1"].iter().any(|word| value.eq_ignore_ascii_case(word));
    one == other || (is_yes(one) && is_yes(other))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_and_empty_values_count_as_in_systemd() {
        let texts = |lines: &[&str]| lines.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>();
        assert_eq!(difference(&texts(&["PrivateTmp=no\nPrivateTmp=true"]), "PrivateTmp", &["yes"]), None);
        assert!(difference(&texts(&["PrivateTmp=yes", "PrivateTmp=no"]), "PrivateTmp", &["yes"]).is_some());
        assert!(difference(&texts(&["#PrivateTmp=yes"]), "PrivateTmp", &["yes"]).is_some());
        let wider = texts(&["DeviceAllow=a\nDeviceAllow=b", "DeviceAllow="]);
        assert_eq!(difference(&wider, "DeviceAllow", &["a", "b"]).unwrap(), "DeviceAllow=, not a + b");
        assert_eq!(
            difference(
                &texts(&["DeviceAllow=c\nDeviceAllow=\nDeviceAllow=a\nDeviceAllow=b"]),
                "DeviceAllow",
                &["a", "b"]
            ),
            None
        );
    }

    #[test]
    fn the_sandbox_is_that_of_the_shipped_unit() {
        let unit = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/deploy/pb3dp-gateway@.service");
        let texts = [std::fs::read_to_string(unit).unwrap()];
        for (key, wanted) in SANDBOX {
            assert_eq!(difference(&texts, key, wanted), None);
        }
    }
}
