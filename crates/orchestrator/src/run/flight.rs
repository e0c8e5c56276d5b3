//! The flight recorder's files: what each arm was asked and what it answered in the last seconds before a fault, as JSON lines
//! ([docs/arm-limits.md](../../../../docs/arm-limits.md) has the format).

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmState, JointCommand};
use pb3dp_hal_middleware::{Asked, FlightEntry, FlightLog};
use serde_json::{Value, json};

/// How far back the recorders of a run reach.
pub const FLIGHT: Duration = Duration::from_secs(5);

/// When a fault was noticed.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// On the clock of the run, which stamps the entries.
    pub monotonic: MonotonicTime,
    /// On the wall.
    pub wall: SystemTime,
}

/// Bytes that went over the line of an arm at one time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawLine {
    /// When.
    pub at: MonotonicTime,
    /// To the arm, or from it.
    pub is_sent: bool,
    /// What.
    pub bytes: Vec<u8>,
}

/// Writes what the recorder of an arm holds, and the raw bytes of its line, to `flight-<arm>.jsonl` in a folder; the path of the
/// file.
///
/// # Errors
/// If the file can not be written.
pub fn write(
    folder: &Path,
    arm: &str,
    (log, raw): (&FlightLog, &[RawLine]),
    failure: &anyhow::Error,
    moment: Moment,
) -> Result<PathBuf> {
    let path = folder.join(format!("flight-{arm}.jsonl"));
    let written = || -> std::io::Result<()> {
        let mut file = BufWriter::new(File::create(&path)?);
        writeln!(file, "{}", head(arm, failure, moment))?;
        for entry in log.entries() {
            writeln!(file, "{}", line(&entry))?;
        }
        for piece in raw {
            writeln!(file, "{}", raw_line(piece))?;
        }
        file.flush()
    };
    written().with_context(|| format!("{}: can not be written", path.display()))?;
    Ok(path)
}

fn head(arm: &str, failure: &anyhow::Error, moment: Moment) -> Value {
    let fault = failure.chain().find_map(|error| error.downcast_ref::<ArmError>());
    let unix_s = moment.wall.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    json!({
        "arm": arm,
        "at_s": seconds(moment.monotonic),
        "wall_unix_s": unix_s,
        "kind": fault.map(|fault| kind_word(fault.kind())),
        "joint": fault.and_then(ArmError::joint),
        "code": fault.and_then(ArmError::code),
        "cause": format!("{failure:#}"),
    })
}

fn line(entry: &FlightEntry) -> Value {
    let (asked, velocity) = match &entry.asked {
        Asked::Exchange(JointCommand::Hold) => ("hold", None),
        Asked::Exchange(JointCommand::Velocity(velocity)) => ("velocity", Some(velocity.as_slice().to_vec())),
        Asked::Enable => ("enable", None),
        Asked::Stop => ("stop", None),
        Asked::Reset => ("reset", None),
    };
    let mut line = json!({
        "at_s": seconds(entry.at),
        "took_s": entry.done.saturating_since(entry.at).as_secs_f64(),
        "asked": asked,
        "answer": match entry.answer {
            Ok(_) => "ok",
            Err(kind) => kind_word(kind),
        },
        "state": state_word(entry.state),
    });
    if let Some(velocity) = velocity {
        line["velocity_rad_per_s"] = json!(velocity);
    }
    if let Ok(Some(measured)) = &entry.answer {
        line["measured_at_s"] = json!(seconds(measured.at));
        line["measured_rad"] = json!(measured.position_rad.as_slice());
        line["measured_rad_per_s"] = json!(measured.velocity_rad_per_s.as_slice());
    }
    line
}

fn raw_line(piece: &RawLine) -> Value {
    let hex: String = piece.bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    json!({ "at_s": seconds(piece.at), "raw": if piece.is_sent { "sent" } else { "received" }, "bytes": hex })
}

fn seconds(at: MonotonicTime) -> f64 {
    at.saturating_since(MonotonicTime::ZERO).as_secs_f64()
}

fn kind_word(kind: ArmErrorKind) -> &'static str {
    match kind {
        ArmErrorKind::Rejected => "rejected",
        ArmErrorKind::NotEnabled => "not-enabled",
        ArmErrorKind::Timeout => "timeout",
        ArmErrorKind::Fault => "fault",
        ArmErrorKind::Disconnected => "disconnected",
        _ => "other",
    }
}

fn state_word(state: ArmState) -> &'static str {
    match state {
        ArmState::Disabled => "disabled",
        ArmState::Enabled => "enabled",
        ArmState::Fault => "fault",
        ArmState::EStop => "e-stop",
    }
}
