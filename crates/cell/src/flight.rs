//! Flight recorder files: commands and answers of each arm in the last seconds before a fault, as JSON lines (format:
//! [docs/arm-limits.md](../../../../docs/arm-limits.md)).

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmState, JointCommand};
use pb3dp_hal_middleware::{FlightEntry, FlightLog, RecordedRequest};
use serde_json::{Value, json};

/// Recorded time span of a run.
pub const FLIGHT: Duration = Duration::from_secs(5);

/// Time at which a fault was noticed.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// On the clock of the run, which stamps the entries.
    pub monotonic: MonotonicTime,
    /// Wall-clock time.
    pub wall: SystemTime,
}

/// Bytes on the line of an arm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawLine {
    /// Time.
    pub at: MonotonicTime,
    /// Direction: to the arm (true) or from it.
    pub is_sent: bool,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// Cause of an arm's stop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArmFault {
    /// Time on the clock of the run.
    pub at: MonotonicTime,
    /// Index of the joint from the base, if known.
    pub joint: Option<usize>,
    /// Alarm code of the controller, if there is one.
    pub code: Option<u16>,
    /// The complete message.
    pub cause: String,
    /// State of the arm before the fault.
    pub state_before: String,
}

/// Counts of messages and bytes on a line since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LineCounts {
    /// Messages sent.
    pub sent: u64,
    /// Messages with a usable reply in time.
    pub answered: u64,
    /// Messages without a reply.
    pub lost: u64,
    /// Replies that arrived too late.
    pub late: u64,
    /// Replies that were damaged.
    pub damaged: u64,
    /// Replies to another message.
    pub mismatched: u64,
    /// Cycles skipped because the arm's thread was not scheduled in time.
    pub overruns: u64,
    /// Frames with a wrong CRC.
    pub crc_errors: u64,
    /// Sync bytes without a valid header behind them.
    pub header_errors: u64,
    /// How often bytes were skipped to find the next frame.
    pub resyncs: u64,
    /// Frames that the line did not accept.
    pub unsent: u64,
}

/// Information on an arm when a run fails.
#[derive(Clone)]
pub struct Flight<'a> {
    /// Its recorder.
    pub log: &'a FlightLog,
    /// Cause of its stop from its driver; none if it did not stop or has no driver.
    pub fault: Option<ArmFault>,
    /// Counts of its line, if it has one.
    pub counts: Option<LineCounts>,
    /// The last bytes of its line.
    pub raw: &'a [RawLine],
}

/// Writes the recorder entries of an arm and the raw bytes of its line to `flight-<arm>.jsonl` in a folder; returns the path.
///
/// # Errors
/// If the file cannot be written.
pub fn write(
    folder: &Path,
    arm: &str,
    flight: &Flight<'_>,
    failure: &anyhow::Error,
    moment: Moment,
) -> Result<PathBuf> {
    let path = folder.join(format!("flight-{arm}.jsonl"));
    let written = || -> std::io::Result<()> {
        let mut file = BufWriter::new(File::create(&path)?);
        let entries = flight.log.entries();
        writeln!(file, "{}", head(arm, (flight, &entries), failure, moment))?;
        for entry in entries {
            writeln!(file, "{}", line(&entry))?;
        }
        for piece in flight.raw {
            writeln!(file, "{}", raw_line(piece))?;
        }
        file.flush()
    };
    written().with_context(|| format!("{}: cannot be written", path.display()))?;
    Ok(path)
}

fn head(arm: &str, (flight, entries): (&Flight<'_>, &[FlightEntry]), failure: &anyhow::Error, moment: Moment) -> Value {
    let fault = failure.chain().find_map(|error| error.downcast_ref::<ArmError>());
    let own = flight.fault.clone().or_else(|| recorded_fault(entries));
    json!({
        "arm": arm,
        "ended_at_s": seconds(moment.monotonic),
        "ended_wall_unix_s": moment.unix_s(moment.monotonic),
        "fault": own.map(|own| json!({
            "at_s": seconds(own.at),
            "wall_unix_s": moment.unix_s(own.at),
            "joint": own.joint,
            "code": own.code,
            "cause": own.cause,
            "state_before": own.state_before,
        })),
        "counts": flight.counts,
        "kind": fault.map(|fault| kind_word(fault.kind())),
        "joint": fault.and_then(ArmError::joint),
        "code": fault.and_then(ArmError::code),
        "cause": format!("{failure:#}"),
    })
}

/// For an arm without a driver: the first recorded entry of its stop.
fn recorded_fault(entries: &[FlightEntry]) -> Option<ArmFault> {
    let is_latched = |entry: &FlightEntry| matches!(entry.state, ArmState::Fault | ArmState::EStop);
    let before = entries.iter().rposition(|entry| !is_latched(entry));
    let first = entries.get(before.map_or(0, |before| before + 1))?;
    Some(ArmFault {
        at: first.done,
        joint: None,
        code: None,
        cause: format!("the arm shows {}", state_word(first.state)),
        state_before: before.map_or("not recorded", |before| state_word(entries[before].state)).to_owned(),
    })
}

impl Moment {
    /// Converts a time on the clock of the run to wall time, s since 1970.
    fn unix_s(&self, at: MonotonicTime) -> f64 {
        let unix_s = self.wall.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        unix_s - (seconds(self.monotonic) - seconds(at))
    }
}

fn line(entry: &FlightEntry) -> Value {
    let (asked, velocity) = match &entry.asked {
        RecordedRequest::Exchange(JointCommand::Hold) => ("hold", None),
        RecordedRequest::Exchange(JointCommand::Velocity(velocity)) => ("velocity", Some(velocity.as_slice().to_vec())),
        RecordedRequest::Enable => ("enable", None),
        RecordedRequest::Stop => ("stop", None),
        RecordedRequest::Reset => ("reset", None),
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
