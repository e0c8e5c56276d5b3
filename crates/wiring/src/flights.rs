//! Flight recorder files of both arms after a fault, with the data of their link monitors.

use std::path::Path;

use pb3dp_arm_pa10::arm::{ArmMonitor, Direction};
use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_cell::flight;
use pb3dp_cell::flight::{ArmFault, Flight, LineCounts, Moment, RawLine};
use pb3dp_hal_middleware::FlightLog;

/// Writes the last seconds of both arms to files in this folder and logs the paths; `number` counts the faults of a run from 1.
pub fn write_flights(
    (folder, number): (&Path, usize),
    flights: &[(&'static str, FlightLog)],
    monitors: &[(&'static str, ArmMonitor)],
    failure: &anyhow::Error,
    moment: Moment,
) {
    for (arm, log) in flights {
        let raw = raw_lines(monitors, arm);
        let (fault, counts) = line_facts(monitors, arm);
        match flight::write(folder, (arm, number), &Flight { log, fault, counts, raw: &raw }, failure, moment) {
            Ok(path) => tracing::info!("flight recorder of the {arm}: {}", path.display()),
            Err(error) => tracing::warn!("the flight recorder of the {arm}: {error:#}"),
        }
    }
}

/// Bytes on an arm's link in the last seconds; none without a link.
pub fn raw_lines(monitors: &[(&'static str, ArmMonitor)], arm: &str) -> Vec<RawLine> {
    let of_arm = monitors.iter().filter(|(name, _)| *name == arm);
    let pieces = of_arm.flat_map(|(_, monitor)| monitor.raw_bytes());
    pieces
        .map(|piece| RawLine { at: piece.at, is_sent: piece.way == Direction::Out, bytes: piece.bytes().to_vec() })
        .collect()
}

/// Cause of an arm's stop from its driver, and counts of its link; none without a link.
pub fn line_facts(monitors: &[(&'static str, ArmMonitor)], arm: &str) -> (Option<ArmFault>, Option<LineCounts>) {
    let Some((_, monitor)) = monitors.iter().find(|(name, _)| *name == arm) else { return (None, None) };
    let snapshot = monitor.snapshot();
    let fault = snapshot.latched.map(|latched| ArmFault {
        at: latched.at,
        joint: latched.trip.axis().map(Axis::index),
        code: latched.trip.code().map(u16::from),
        cause: latched.trip.to_string(),
        state_before: latched.state_before.to_string(),
    });
    let (link, line) = (&snapshot.counters, &snapshot.line);
    let counts = LineCounts {
        sent: link.sent,
        answered: link.answered,
        lost: link.lost,
        late: link.late,
        damaged: link.damaged,
        mismatched: link.mismatched,
        overruns: link.overruns,
        crc_errors: line.crc_errors,
        header_errors: line.header_errors,
        resyncs: line.resyncs,
        unsent: snapshot.frames_unsent,
    };
    (fault, Some(counts))
}
