//! Real-time capabilities of this computer and user.

use super::needs::Needs;
use super::system::System;
use pb3dp_cell::finding::Finding;

/// Clocks that a processor reads without a device access.
const QUICK_CLOCKS: [&str; 4] = ["tsc", "arch_sys_counter", "kvm-clock", "riscv_clocksource"];

/// Minimum share of a second for SCHED_FIFO threads.
const SHARE_MIN: f64 = 0.9;

/// How to get both permissions.
const RIGHTS: &str =
    "install configs/deploy/90-pb3dp.conf in /etc/security/limits.d, then: usermod -aG realtime USER, and log in again";

/// All real-time checks.
pub(super) fn check(system: &dyn System, needs: &Needs) -> Vec<Finding> {
    vec![scheduling(system, needs), memory(system, needs), throttling(system, needs), clock(system), governor(system)]
}

fn scheduling(system: &dyn System, needs: &Needs) -> Finding {
    const CHECK: &str = "real-time scheduling";
    let priority = needs.priority;
    match system.try_fifo(priority) {
        Ok(()) => Finding::pass(CHECK, format!("SCHED_FIFO with priority {priority} is available")),
        Err(message) => Finding::missing(needs.needs_realtime, CHECK, message, RIGHTS),
    }
}

fn memory(system: &dyn System, needs: &Needs) -> Finding {
    const CHECK: &str = "memory lock";
    match system.try_memory_lock() {
        Ok(()) => Finding::pass(CHECK, "the program may lock its memory"),
        Err(message) => Finding::missing(needs.needs_realtime, CHECK, message, RIGHTS),
    }
}

fn throttling(system: &dyn System, needs: &Needs) -> Finding {
    const CHECK: &str = "real-time throttling";
    let number = |name: &str| system.text(&format!("/proc/sys/kernel/{name}"))?.parse::<f64>().ok();
    let (Some(runtime), Some(period)) = (number("sched_rt_runtime_us"), number("sched_rt_period_us")) else {
        return Finding::pass(CHECK, "the kernel does not throttle SCHED_FIFO threads");
    };
    let advice = "sysctl kernel.sched_rt_runtime_us=950000 (and in /etc/sysctl.d)";
    if runtime < 0.0 {
        Finding::pass(CHECK, "off: SCHED_FIFO threads may use a processor completely")
    } else if runtime == 0.0 || period <= 0.0 {
        Finding::missing(needs.needs_realtime, CHECK, "SCHED_FIFO threads get no processor time", advice)
    } else if runtime / period < SHARE_MIN {
        let share = 100.0 * runtime / period;
        Finding::warning(
            CHECK,
            format!(
                "SCHED_FIFO threads are stopped after {share:.0} % of each second, required {:.0} %",
                100.0 * SHARE_MIN
            ),
            advice,
        )
    } else {
        let share = 100.0 * runtime / period;
        Finding::pass(CHECK, format!("SCHED_FIFO threads may use {share:.0} % of each second"))
    }
}

fn clock(system: &dyn System) -> Finding {
    const CHECK: &str = "clock source";
    let folder = "/sys/devices/system/clocksource/clocksource0";
    match system.text(&format!("{folder}/current_clocksource")) {
        None => Finding::warning(CHECK, format!("{folder} cannot be read"), "search the kernel's log for clocksource"),
        Some(name) if QUICK_CLOCKS.contains(&name.as_str()) => Finding::pass(CHECK, name),
        Some(name) => {
            let available = system.text(&format!("{folder}/available_clocksource")).unwrap_or_default();
            let advice = format!(
                "reading the clock takes a microsecond; available: {available}. The kernel's log gives the reason for leaving tsc (dmesg | grep -i \
                 tsc); a newer BIOS often helps"
            );
            Finding::warning(CHECK, name, advice)
        }
    }
}

fn governor(system: &dyn System) -> Finding {
    const CHECK: &str = "processor frequency";
    let folder = "/sys/devices/system/cpu";
    let is_processor = |name: &String| {
        name.strip_prefix("cpu").is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()))
    };
    let of = |name: &String| system.text(&format!("{folder}/{name}/cpufreq/scaling_governor"));
    let mut governors: Vec<String> =
        system.names(folder).iter().filter(|name| is_processor(name)).filter_map(of).collect();
    governors.sort();
    governors.dedup();
    if governors.is_empty() {
        return Finding::pass(CHECK, "the kernel reports no frequency governor");
    }
    let found = governors.join(", ");
    if governors == ["performance"] {
        return Finding::pass(CHECK, found);
    }
    let advice = "a slow processor wakes up late; run at each boot: cpupower frequency-set -g performance";
    Finding::warning(CHECK, format!("governor {found}"), advice)
}
