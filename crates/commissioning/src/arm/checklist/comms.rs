//! Step `comms`: messages only, with stationary joints; no motion is possible.

use anyhow::{Context, Result};
use pb3dp_hal_api::{Arm, JointCommand};
use pb3dp_kinematics::JointVector;
use pb3dp_wiring::commissioning::see;

use super::limits::{BRAKED_MAX_DEG, EXCHANGES, LATE_MAX_MS, LOST_PERCENT_MAX};
use super::operator::Question;
use super::session::Session;

/// Runs the step.
///
/// # Errors
/// An arm or an operator that does not answer.
pub fn run(session: &mut Session<'_>) -> Result<()> {
    let mut observed = see(&session.setup, session.choice, &session.clock)?;
    let monitor = observed.arm.monitor();
    let first = monitor.snapshot().joints.context("the arm reported no joints")?.position_rad;
    let mut moved_rad = 0.0_f64;
    // Each call exchanges at least one message, so this loop ends.
    for _ in 0..EXCHANGES {
        if monitor.snapshot().counters.sent >= u64::from(EXCHANGES) {
            break;
        }
        session.pause(std::time::Duration::ZERO)?;
        observed.arm.look()?;
        let joints = monitor.snapshot().joints.context("the arm reported no joints")?;
        moved_rad = moved_rad.max((joints.position_rad - first).amax());
    }
    let snapshot = monitor.snapshot();
    let counters = snapshot.counters;
    let trips = monitor.control_trips();
    let watchdog_us = u64::from(session.gateway.stop_after_us)
        .min(u64::try_from(session.choice.of(&session.setup).command_timeout.as_micros()).unwrap_or(u64::MAX));
    let lost_percent = 100.0 * counters.lost as f64 / counters.sent.max(1) as f64;
    let report = &mut session.report;
    report.at_least("messages sent", counters.sent as f64, f64::from(EXCHANGES), "");
    report.at_most("messages without an answer", lost_percent, LOST_PERCENT_MAX, "%");
    report.at_most("damaged or foreign answers", (counters.damaged + counters.mismatched) as f64, 0.0, "");
    // R5: half of the shorter watchdog.
    report.at_most("round trip, 99 of 100", trips.p99.as_secs_f64() * 1e3, watchdog_us as f64 / 2e3, "ms");
    report.at_most("commands sent late, 99 of 100", monitor.jitter().p99.as_secs_f64() * 1e3, LATE_MAX_MS, "ms");
    report.at_most("largest motion of a joint", moved_rad.to_degrees(), BRAKED_MAX_DEG, "deg");
    let velocity = observed.arm.exchange(JointCommand::Velocity(JointVector::zeros()));
    report.refused("a velocity is refused while the brakes are on", &velocity, "it was accepted");
    session.ask(&Question::Pose { shown_rad: first })
}
