//! Flight recorder files: commands and answers of each arm in the last seconds before a fault, as JSON lines (format:
//! [docs/arm-limits.md](https://github.com/pb3dp/pb3dp/blob/main/docs/arm-limits.md)).

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmState, JointCommand};
use pb3dp_hal_middleware::{FlightEntry, FlightLog, RecordedRequest};
use pb3dp_servo::supervisor::{Condition, Decision, State, Why};
use serde_json::{Value, json};

/// Recorded time span of a run.
pub const FLIGHT: Duration = Duration::from_secs(5);

/// Time after a fault at which its record is written again: it then shows whether the arms stayed at rest. Chosen: at half of it a slow
/// joint has not stopped, at double an operator who resets at once has changed the state more often.
const AGAIN_AFTER: Duration = Duration::from_secs(1);

/// Faults of one run that get a record; an operator who resets the same fault again and again does not fill the disk.
const RECORDS_MAX: usize = 20;

/// Writes the flight recorder files of a fault. The arguments: number of the fault in this run, from 1, and its cause.
pub type KeepFlights = Box<dyn FnMut(usize, &anyhow::Error) + Send>;

/// Finds the control steps after which the flight recorders must be written: at a fault or a stop by a condition, and once more a second
/// later. The recorders forget after [`FLIGHT`], and a console run may go on for an hour.
#[derive(Debug, Default)]
pub(crate) struct FaultWatch {
    /// What latched the arms in the last step; none before a fault and after a reset.
    latched: Option<(State, Condition)>,
    again_at: Option<MonotonicTime>,
    faults: usize,
}

impl FaultWatch {
    /// The number of the fault whose record is due after this step. Reads the state instead of the transition, because a step can be
    /// missing.
    pub(crate) fn due(&mut self, at: MonotonicTime, decision: &Decision) -> Option<usize> {
        let latched = match decision.why {
            Why::Latched { state, cause, .. } => Some((state, cause.condition)),
            _ => None,
        };
        let is_new = latched.is_some() && latched != self.latched;
        self.latched = latched;
        if is_new {
            self.faults += 1;
            self.again_at = Some(at + AGAIN_AFTER);
        }
        let is_again = self.again_at.is_some_and(|again_at| latched.is_some() && at >= again_at);
        if is_again || latched.is_none() {
            self.again_at = None;
        }
        ((is_new || is_again) && self.faults <= RECORDS_MAX).then_some(self.faults)
    }

    /// Number of faults so far.
    pub(crate) fn faults(&self) -> usize {
        self.faults
    }
}

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

/// Writes the recorder entries of an arm and the raw bytes of its line to a file in a folder; returns the path. The first fault is in
/// `flight-<arm>.jsonl`, the second one in `flight-<arm>-2.jsonl`.
///
/// # Errors
/// If the file cannot be written.
pub fn write(
    folder: &Path,
    (arm, number): (&str, usize),
    flight: &Flight<'_>,
    failure: &anyhow::Error,
    moment: Moment,
) -> Result<PathBuf> {
    let name = if number <= 1 { format!("flight-{arm}.jsonl") } else { format!("flight-{arm}-{number}.jsonl") };
    let path = folder.join(name);
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
        "kind": fault.map(|fault| kind_name(fault.kind())),
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
        cause: format!("the arm shows {}", state_name(first.state)),
        state_before: before.map_or("not recorded", |before| state_name(entries[before].state)).to_owned(),
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
            Err(kind) => kind_name(kind),
        },
        "state": state_name(entry.state),
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

fn kind_name(kind: ArmErrorKind) -> &'static str {
    match kind {
        ArmErrorKind::Rejected => "rejected",
        ArmErrorKind::NotEnabled => "not-enabled",
        ArmErrorKind::Timeout => "timeout",
        ArmErrorKind::Fault => "fault",
        ArmErrorKind::Disconnected => "disconnected",
        _ => "other",
    }
}

fn state_name(state: ArmState) -> &'static str {
    match state {
        ArmState::Disabled => "disabled",
        ArmState::Enabled => "enabled",
        ArmState::Fault => "fault",
        ArmState::EStop => "e-stop",
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_servo::supervisor::{Cause, Detail};

    use super::*;
    use crate::console::tests::decision;

    const FAULT: Why = latched(State::Fault, Condition::ArmFault);

    const fn latched(state: State, condition: Condition) -> Why {
        Why::Latched {
            state,
            cause: Cause { condition, value: 0.0, threshold: 0.0, detail: Detail::None },
            is_gone: false,
        }
    }

    /// The steps of 10 ms, from 1, after which a record is due, with the number of the fault.
    fn due(steps: usize, why: impl Fn(usize) -> Why) -> Vec<(usize, usize)> {
        let (mut watch, resting) = (FaultWatch::default(), decision());
        let at = |step: usize| MonotonicTime::ZERO + Duration::from_millis(10) * step as u32;
        let mut due = |step| watch.due(at(step), &Decision { why: why(step), transition: None, ..resting });
        (1..=steps).filter_map(|step| due(step).map(|number| (step, number))).collect()
    }

    #[test]
    fn a_fault_is_recorded_at_once_and_a_second_later() {
        assert_eq!(due(1000, |step| if step < 200 { Why::Ready } else { FAULT }), [(200, 1), (300, 1)]);
        assert_eq!(due(1000, |step| if step < 200 { Why::Ready } else { Why::StoppedByOperator }), []);
        // A reset in between: the recorder would show the arm after the reset.
        assert_eq!(due(1000, |step| if (200..250).contains(&step) { FAULT } else { Why::Idle }), [(200, 1)]);
        // A stop by a condition, then the fault of an arm.
        let stopped = latched(State::Stopped, Condition::FrameStale);
        assert_eq!(due(500, |step| if step < 250 { stopped } else { FAULT }), [(1, 1), (101, 1), (250, 2), (350, 2)]);
    }

    #[test]
    fn faults_without_end_do_not_fill_the_disk() {
        let records = due(10_000, |step| if step % 2 == 0 { FAULT } else { Why::Idle });
        assert_eq!(records.last(), Some(&(2 * RECORDS_MAX, RECORDS_MAX)));
        assert_eq!(records.len(), RECORDS_MAX);
    }
}
