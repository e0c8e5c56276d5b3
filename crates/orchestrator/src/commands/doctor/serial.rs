//! Serial ports of arms and gateways.

use super::access::{Identity, denied};
use super::needs::Needs;
use super::system::System;
use pb3dp_cell::finding::Finding;

const CHECK: &str = "serial ports";

/// Longest acceptable latency timer of an adapter, ms.
const TIMER_MAX_MS: u32 = 1;

/// Names that depend on the order of connection.
const NUMBERED: [&str; 2] = ["/dev/ttyUSB", "/dev/ttyACM"];

/// All checks of serial ports.
pub(super) fn check(system: &dyn System, needs: &Needs) -> Vec<Finding> {
    let Some(who) = Identity::of(system) else { return Vec::new() };
    match &needs.serial {
        Some(ports) if ports.is_empty() => vec![Finding::pass(CHECK, format!("{} needs no serial port", needs.source))],
        Some(ports) => ports.iter().flat_map(|port| port_findings(system, &who, port, true)).collect(),
        None => {
            let names = system.names("/dev");
            let paths = names.iter().map(|name| format!("/dev/{name}"));
            let ports: Vec<_> = paths.filter(|path| NUMBERED.iter().any(|start| path.starts_with(start))).collect();
            if ports.is_empty() {
                return vec![Finding::pass(CHECK, "no USB adapter is connected; --config checks the ports of a setup")];
            }
            ports.iter().flat_map(|port| port_findings(system, &who, port, false)).collect()
        }
    }
}

fn port_findings(system: &dyn System, who: &Identity, port: &str, is_named: bool) -> Vec<Finding> {
    let Some(node) = system.node(port) else {
        let there = system.names("/dev/serial/by-id");
        let advice = if there.is_empty() {
            "no USB adapter is connected: check cable, power, and the output of `dmesg`".to_owned()
        } else {
            format!(
                "correct the name, or connect the adapter; connected: /dev/serial/by-id/{}",
                there.join(", /dev/serial/by-id/")
            )
        };
        return vec![Finding::fail(CHECK, format!("{port} does not exist"), advice)];
    };
    if !node.is_device {
        return vec![Finding::fail(CHECK, format!("{port} is not a device"), "correct the name in the configuration")];
    }
    let mut findings = Vec::new();
    findings.push(match denied(system, who, port, &node) {
        Some((found, advice)) => Finding::missing(is_named, CHECK, found, advice),
        None => Finding::pass(CHECK, format!("{port} exists, and this user can use it")),
    });
    if is_named && NUMBERED.iter().any(|start| port.starts_with(start)) {
        findings.push(Finding::warning(
            CHECK,
            format!("{port} names the adapter that was connected first"),
            "use its name in /dev/serial/by-id, or a name from configs/deploy/70-pb3dp.rules, so that arms cannot be swapped",
        ));
    }
    findings.extend(latency(system, port));
    findings
}

/// Latency timer of an adapter, if it has one.
fn latency(system: &dyn System, port: &str) -> Option<Finding> {
    const CHECK: &str = "serial latency";
    let target = system.target(port)?;
    let name = target.rsplit('/').next()?;
    let file = format!("/sys/bus/usb-serial/devices/{name}/latency_timer");
    let millis: u32 = system.text(&file)?.parse().ok()?;
    if millis <= TIMER_MAX_MS {
        return Some(Finding::pass(CHECK, format!("{port}: the adapter delays bytes by up to {millis} ms")));
    }
    let advice = format!(
        "install configs/deploy/70-pb3dp.rules in /etc/udev/rules.d, or for now as root: echo {TIMER_MAX_MS} > {file}"
    );
    Some(Finding::warning(CHECK, format!("{port}: the adapter delays bytes by up to {millis} ms"), advice))
}
