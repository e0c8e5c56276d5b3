//! Real-time capabilities of this computer and user.

use super::finding::Finding;
use super::needs::Needs;
use super::system::System;

/// Clocks that a processor reads without a device access.
const QUICK_CLOCKS: [&str; 4] = ["tsc", "arch_sys_counter", "kvm-clock", "riscv_clocksource"];

/// Least share of a second that the kernel must leave to SCHED_FIFO threads.
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
        Ok(()) => Finding::pass(CHECK, format!("SCHED_FIFO with priority {priority} is to be had")),
        Err(said) => Finding::missing(needs.needs_realtime, CHECK, said, RIGHTS),
    }
}

fn memory(system: &dyn System, needs: &Needs) -> Finding {
    const CHECK: &str = "memory lock";
    match system.try_memory_lock() {
        Ok(()) => Finding::pass(CHECK, "the program may keep its memory"),
        Err(said) => Finding::missing(needs.needs_realtime, CHECK, said, RIGHTS),
    }
}

fn throttling(system: &dyn System, needs: &Needs) -> Finding {
    const CHECK: &str = "real-time throttling";
    let number = |name: &str| system.text(&format!("/proc/sys/kernel/{name}"))?.parse::<f64>().ok();
    let (Some(runtime), Some(period)) = (number("sched_rt_runtime_us"), number("sched_rt_period_us")) else {
        return Finding::pass(CHECK, "the kernel has no such limit");
    };
    let advice = "sysctl kernel.sched_rt_runtime_us=950000 (and in /etc/sysctl.d)";
    if runtime < 0.0 {
        Finding::pass(CHECK, "off: threads of SCHED_FIFO may take all of a processor")
    } else if runtime == 0.0 || period <= 0.0 {
        Finding::missing(needs.needs_realtime, CHECK, "threads of SCHED_FIFO get no time at all", advice)
    } else if runtime / period < SHARE_MIN {
        let share = 100.0 * runtime / period;
        Finding::warning(CHECK, format!("threads of SCHED_FIFO are stopped after {share:.0} % of a second"), advice)
    } else {
        let share = 100.0 * runtime / period;
        Finding::pass(CHECK, format!("threads of SCHED_FIFO may take {share:.0} % of a second"))
    }
}

fn clock(system: &dyn System) -> Finding {
    const CHECK: &str = "clock source";
    let folder = "/sys/devices/system/clocksource/clocksource0";
    match system.text(&format!("{folder}/current_clocksource")) {
        None => Finding::warning(CHECK, format!("{folder} is not to be read"), "look for it in the kernel's log"),
        Some(name) if QUICK_CLOCKS.contains(&name.as_str()) => Finding::pass(CHECK, name),
        Some(name) => {
            let available = system.text(&format!("{folder}/available_clocksource")).unwrap_or_default();
            let advice = format!(
                "every look at the clock takes a microsecond; available: {available}. The kernel's log says why it left tsc (dmesg | grep -i \
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
        return Finding::pass(CHECK, "nothing to see that changes it");
    }
    let found = governors.join(", ");
    if governors == ["performance"] {
        return Finding::pass(CHECK, found);
    }
    let advice = "a processor that slows down wakes late: cpupower frequency-set -g performance, and at each start of the machine";
    Finding::warning(CHECK, format!("governor {found}"), advice)
}
