//! Step `jog`: one axis, there and back.

use anyhow::{Context, Result};
use pb3dp_cell::plan::STAYED_WITHIN_RAD;
use pb3dp_hal_api::JointCommand;
use pb3dp_wiring::commissioning::SlowArm;

use super::limits::{BEHIND_MAX_DEG, END_MAX_DEG, OTHERS_MAX_DEG, SAG_MAX_DEG};
use super::operator::Question;
use super::session::{MoveObservation, Session};

/// Moves the axis there and back.
///
/// # Errors
/// A failed move, or an operator who does not answer.
pub fn there_and_back(session: &mut Session<'_>, arm: &mut SlowArm) -> Result<()> {
    for (way, by) in [("there", session.by_rad), ("back", -session.by_rad)] {
        let axis = session.axis;
        let from_rad = arm.driven.exchange(JointCommand::Hold)?.position_rad;
        let plan = session.plan_by(from_rad, by)?;
        let seconds = plan.duration().as_secs_f64();
        let text = format!(
            "Next, {axis} turns by {:+.1} degrees within {seconds:.0} s. Watch it. Keep a hand on the emergency stop.",
            by.to_degrees()
        );
        session.ready(&text, None)?;
        let (reached, observation) = session.drive(arm, &plan)?;
        let monitor = arm.monitor.as_ref().context("the arm has no link")?;
        let rests = monitor.snapshot().joints.context("the arm reported no joints")?;
        let joint = axis.index();
        let end_deg = (reached.position_rad[joint] - plan.end_rad()[joint]).abs().to_degrees();
        let closed_deg = (rests.position_rad - reached.position_rad).amax().to_degrees();
        let turned_deg = (reached.position_rad[joint] - from_rad[joint]).to_degrees();
        let MoveObservation { sagged_deg, behind_deg, others_deg, fastest_rad_per_s, .. } = observation;
        let report = &mut session.report;
        report.note(format!("{way}: commanded {:+.3} deg, turned by {turned_deg:+.3} deg", by.to_degrees()));
        report.at_most(format!("{way}: sag when the brakes opened"), sagged_deg, STAYED_WITHIN_RAD.to_degrees(), "deg");
        report.at_most(format!("{way}: {axis} behind its plan"), behind_deg, BEHIND_MAX_DEG, "deg");
        report.at_most(format!("{way}: {axis} residual at the end"), end_deg, END_MAX_DEG, "deg");
        report.at_most(format!("{way}: largest motion of another joint"), others_deg, OTHERS_MAX_DEG, "deg");
        let allowed = MoveObservation::fastest_allowed_rad_per_s();
        report.at_most(format!("{way}: fastest, two samples in a row"), fastest_rad_per_s, allowed, "rad/s");
        report.at_most(format!("{way}: sag when the brakes closed"), closed_deg, SAG_MAX_DEG, "deg");
        session.ask(&Question::Turned { axis, by_rad: by })?;
        if !session.report.complaints().is_empty() {
            return Ok(());
        }
    }
    Ok(())
}
