//! Flight recorder files of the commissioning commands.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Error, Result};
use pb3dp_arm_pa10::arm::ArmMonitor;
use pb3dp_cell::flight::{self, Flight, Moment};
use pb3dp_cell::parts::ArmChoice;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_middleware::FlightLog;
use pb3dp_wiring::commissioning::SlowArm;
use pb3dp_wiring::{line_facts, raw_lines};

/// A time as UTC in RFC 3339 form, whole seconds.
pub fn utc(moment: SystemTime) -> String {
    humantime::format_rfc3339_seconds(moment).to_string()
}

/// Default output folder of a command: `out/arm-jog-vs-robot-2026-11-21T024508Z`.
pub fn folder_of(command: &str, choice: ArmChoice, began: SystemTime) -> PathBuf {
    PathBuf::from(format!("out/arm-{command}-{}-{}", choice.name(), utc(began).replace(':', "")))
}

/// Writes the flight recorders of an arm, and of the other one if it is connected, after a failure; returns the files or write errors.
pub fn keep(
    folder: &Path,
    choice: ArmChoice,
    arm: &SlowArm,
    failure: &Error,
    now: MonotonicTime,
) -> Vec<Result<PathBuf>> {
    let moment = Moment { monotonic: now, wall: SystemTime::now() };
    let kept = |choice: ArmChoice, log: &FlightLog, monitor: Option<&ArmMonitor>| {
        let name = choice.name();
        let monitors: Vec<_> = monitor.into_iter().map(|monitor| (name, monitor.clone())).collect();
        let (raw, (fault, counts)) = (raw_lines(&monitors, name), line_facts(&monitors, name));
        std::fs::create_dir_all(folder)
            .with_context(|| folder.display().to_string())
            .and_then(|()| flight::write(folder, (name, 1), &Flight { log, fault, counts, raw: &raw }, failure, moment))
            .with_context(|| format!("cannot write the flight recorder of the {name}"))
    };
    let mut files = vec![kept(choice, &arm.flight, arm.monitor.as_ref())];
    if let Some(other) = &arm.other {
        files.push(kept(choice.other(), &other.flight, other.monitor.as_ref()));
    }
    files
}
