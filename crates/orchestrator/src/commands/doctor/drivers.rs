//! Kernel modules, and ARCNET interfaces.

use super::access::Identity;
use super::needs::{Cameras, Needs};
use super::system::System;
use pb3dp_cell::finding::Finding;

/// Type of an ARCNET interface, and the flag of one that is up: `linux/if_arp.h`, `linux/if.h`.
const ARPHRD_ARCNET: &str = "7";
const IFF_UP: u32 = 1;

/// Required and optional modules.
pub(super) fn modules(system: &dyn System, needs: &Needs) -> Vec<Finding> {
    const CHECK: &str = "kernel modules";
    let mut wanted = Vec::new();
    let has_serial = needs.serial.as_ref().is_none_or(|ports| !ports.is_empty());
    if needs.cameras != Cameras::NotNeeded {
        wanted.push(("uvcvideo", "USB cameras", false));
    }
    if has_serial {
        wanted.push(("ftdi_sio", "serial adapters of FTDI", false));
        wanted.push(("cdc_acm", "serial adapters of the class CDC-ACM", false));
    }
    if !needs.arcnet.is_empty() {
        wanted.push(("arcnet", "ARCNET", true));
        wanted.push(("arc_rawmode", "raw ARCNET frames", true));
    }
    wanted
        .into_iter()
        .map(|(name, purpose, is_needed)| match module(system, name) {
            Some(how) => Finding::pass(CHECK, format!("{name} ({purpose}) {how}")),
            None => Finding::missing(
                is_needed,
                CHECK,
                format!("{name} ({purpose}) is missing"),
                format!("modprobe {name}; if the kernel has no such module, install the full kernel of the distribution (not its cloud variant)"),
            ),
        })
        .collect()
}

/// State of a module: loaded, built into the kernel, or loadable.
fn module(system: &dyn System, name: &str) -> Option<&'static str> {
    if system.node(&format!("/sys/module/{name}")).is_some() {
        return Some("is loaded");
    }
    let release = system.text("/proc/sys/kernel/osrelease")?;
    let lists = |file: &str| {
        let text = system.text(&format!("/lib/modules/{release}/{file}")).unwrap_or_default();
        text.lines().any(|line| {
            let path = line.split(':').next().unwrap_or_default();
            let stem = path.rsplit('/').next().and_then(|file| file.split(".ko").next()).unwrap_or_default();
            stem.replace('-', "_") == name
        })
    };
    if lists("modules.builtin") {
        Some("is part of the kernel")
    } else if lists("modules.dep") {
        Some("is loaded on demand")
    } else {
        None
    }
}

/// The ARCNET interfaces that are named or exist.
pub(super) fn arcnet(system: &dyn System, needs: &Needs) -> Vec<Finding> {
    const CHECK: &str = "ARCNET";
    let folder = "/sys/class/net";
    let kind = |name: &str| system.text(&format!("{folder}/{name}/type"));
    let is_arcnet = |name: &String| kind(name).as_deref() == Some(ARPHRD_ARCNET);
    let there: Vec<String> = system.names(folder).into_iter().filter(is_arcnet).collect();
    let names = if needs.arcnet.is_empty() { there.clone() } else { needs.arcnet.clone() };
    if names.is_empty() {
        return vec![Finding::pass(CHECK, "no interface exists, and the configuration names none")];
    }
    let mut findings: Vec<_> =
        names.iter().map(|name| interface(system, name, kind(name).as_deref(), &there)).collect();
    let may = Identity::of(system).is_some_and(|who| who.has_net_raw());
    findings.push(if may {
        Finding::pass(CHECK, "this user can open packet sockets")
    } else {
        Finding::missing(
            !needs.arcnet.is_empty(),
            CHECK,
            "this user cannot open packet sockets",
            "run as root, or as a service (configs/deploy/pb3dp-gateway@.service), or: setcap cap_net_raw,cap_sys_nice,cap_ipc_lock+ep PROGRAM",
        )
    });
    findings
}

fn interface(system: &dyn System, name: &str, kind: Option<&str>, there: &[String]) -> Finding {
    const CHECK: &str = "ARCNET";
    let flags = || {
        let text = system.text(&format!("/sys/class/net/{name}/flags"))?;
        u32::from_str_radix(text.trim_start_matches("0x"), 16).ok()
    };
    match kind {
        None => Finding::fail(
            CHECK,
            format!("there is no network interface {name}"),
            if there.is_empty() {
                "load the driver of the card: modprobe -a com20020_pci arc_rawmode (at each boot: configs/deploy/pb3dp-modules.conf)"
                    .to_owned()
            } else {
                format!("correct the name; existing interfaces: {}", there.join(", "))
            },
        ),
        Some(ARPHRD_ARCNET) if flags().is_some_and(|flags| flags & IFF_UP == IFF_UP) => {
            Finding::pass(CHECK, format!("{name} is up"))
        }
        Some(ARPHRD_ARCNET) => Finding::fail(
            CHECK,
            format!("{name} is down"),
            format!("ip link set {name} up (at each boot: configs/deploy/70-pb3dp.rules)"),
        ),
        Some(kind) => Finding::fail(
            CHECK,
            format!("{name} is of type {kind}, not ARCNET ({ARPHRD_ARCNET})"),
            "choose the one that `ip link` shows as link/arcnet",
        ),
    }
}
