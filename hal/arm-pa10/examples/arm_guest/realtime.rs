//! The system calls that a cycle of 2 ms needs: as root, and as a user without the rights.

use std::fs;
use std::time::Duration;

use pb3dp_arm_pa10::arm::REALTIME;
use pb3dp_hal_platform::realtime::{Realtime, Shortfall, enter, now, sleep_until};

use crate::report::{Outcome, Report, ensure};
use crate::system::{User, as_user};

const CYCLE: Duration = Duration::from_millis(2);
const CYCLES: usize = 1000;

pub fn check(report: &mut Report) {
    report.check("root gets a cycle of 2 ms: policy, memory, processor, clock", as_root);
    report.check("the user nobody gets the refusal and the right that is needed", as_nobody);
}

fn as_root() -> Outcome {
    let thread = std::thread::spawn(|| {
        let shortfalls = enter(&Realtime { cpu: Some(0), ..REALTIME });
        let of_thread = fs::read_to_string("/proc/thread-self/sched").unwrap_or_default();
        let mut late = Vec::with_capacity(CYCLES);
        let mut next = now();
        for _ in 0..CYCLES {
            next = next + CYCLE;
            sleep_until(next);
            let woken = now();
            late.push((woken >= next).then(|| woken.saturating_since(next)));
        }
        (shortfalls, of_thread, late)
    });
    let (shortfalls, of_thread, late) = thread.join().map_err(|_| "the thread has panicked")?;
    ensure(shortfalls.is_empty(), || format!("refused to root: {shortfalls:?}"))?;
    // Policy 1 is SCHED_FIFO.
    let policy = of_thread.lines().find(|line| line.starts_with("policy")).unwrap_or_default();
    ensure(policy.ends_with(" 1"), || format!("the thread has another policy: `{policy}`"))?;
    let locked = locked_kib()?;
    ensure(locked > 0, || "no memory is locked".into())?;
    let mut late = late.into_iter().collect::<Option<Vec<_>>>().ok_or("a sleep ended too early")?;
    late.sort();
    let over = late.iter().filter(|late| **late > CYCLE).count();
    let part = |part: f64| late[((CYCLES - 1) as f64 * part) as usize].as_micros();
    Ok(format!(
        "{CYCLES} cycles, late by {} us (median), {} us (99 of 100), {} us at most, {over} by more than a cycle; {locked} KiB locked",
        part(0.5),
        part(0.99),
        part(1.0)
    ))
}

fn locked_kib() -> Result<u64, Box<dyn std::error::Error>> {
    let status = fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmLck:")).ok_or("no VmLck")?;
    Ok(line.trim().trim_end_matches(" kB").parse()?)
}

fn as_nobody() -> Outcome {
    let output_text = as_user(User::Nobody, &["realtime"])?;
    for args in ["SCHED_FIFO with priority 50", "CAP_SYS_NICE", "memory cannot be locked", "CAP_IPC_LOCK"] {
        ensure(output_text.contains(args), || format!("nothing of `{args}` in: {output_text}"))?;
    }
    ensure(output_text.lines().count() == 3 && output_text.ends_with("slept: true"), || output_text.clone())?;
    let causes: Vec<&str> = output_text.lines().filter_map(|line| line.split(": ").next()).collect();
    Ok(format!("{} for policy and memory; the clock works", causes[..2].join(" and ")))
}

/// Prints the refused requests of this user, and continues without them.
pub fn try_to_enter() {
    for shortfall in enter(&REALTIME) {
        let error = match shortfall {
            Shortfall::Policy { error, .. } | Shortfall::Memory { error } | Shortfall::Processor { error, .. } => error,
        };
        println!("{:?}: {shortfall}", error.kind());
    }
    let next = now() + CYCLE;
    sleep_until(next);
    println!("slept: {}", now() >= next);
}
