//! Step `interlock`: the emergency stop of the holding arm stops the moving arm.

use anyhow::{Context, Result};
use pb3dp_cell::plan::Plan;
use pb3dp_hal_api::{ArmState, JointCommand};
use pb3dp_wiring::commissioning::{OtherArm, SlowArm};

use super::operator::{Act, Question};
use super::record::StepReport;
use super::session::{Session, refuses_motion};
use super::steps::{INTERLOCK_REST_MAX_MS, NOTICED_MAX_MS, SAG_MAX_DEG};

/// Runs the step.
///
/// # Errors
/// If nothing stopped the arm, or an operator does not answer.
pub fn run(session: &mut Session<'_>, report: &mut StepReport) -> Result<()> {
    let mut arm = session.connect(true)?;
    let outcome = interlock(session, report, &mut arm);
    let may_be_on = |other: &&mut OtherArm| matches!(other.driven.state(), ArmState::Enabled | ArmState::Disabled);
    if let Some(other) = arm.other.as_mut().filter(may_be_on) {
        other.driven.stop().context("the other arm: stop order failed; press its emergency stop")?;
    }
    session.keep_if_failed(report, &arm, outcome)
}

fn interlock(session: &mut Session<'_>, report: &mut StepReport, arm: &mut SlowArm) -> Result<()> {
    let choice = session.choice;
    let act = Act::PressEmergencyStop(choice.other());
    let plan = session.announce(arm, act)?;
    check_room(session, arm, &plan)?;
    // An arm with closed brakes would not report its emergency stop.
    session.switch_other_on(arm, &plan)?;
    let stop = session.drive_until(arm, &plan, act)?;
    let other = arm.other.as_mut().context("the other arm is not connected")?;
    let told = other.monitor.as_ref().context("the other arm has no link")?.snapshot().latched;
    let is_e_stop = other.driven.state() == ArmState::EStop;
    let found = told.map_or_else(|| "not stopped".to_owned(), |latched| latched.trip.to_string());
    report.holds("the other arm is stopped by an emergency stop", is_e_stop, found);
    let is_stopped = matches!(stop.state, ArmState::Fault | ArmState::EStop);
    report.holds("this arm is stopped, too", is_stopped, stop.cause.clone());
    if let Some(noticed_ms) = stop.noticed_ms() {
        report.at_most("from the operator action to the stop of this arm", noticed_ms, NOTICED_MAX_MS, "ms");
    }
    let apart_ms = told.map_or(f64::NAN, |latched| 1e3 * stop.noticed.seconds_since(latched.at));
    let cycle_ms = 1e3 * session.setup.control_period.as_secs_f64();
    // R20. A common emergency stop may reach this arm first.
    report.at_most("from the stop of the other arm to that of this one", apart_ms, cycle_ms, "ms");
    let brakes_ms = f64::from(session.gateway.brake_release_us) / 1e3;
    report.at_most("from there to standstill", stop.to_rest_ms(), brakes_ms + INTERLOCK_REST_MAX_MS, "ms");
    let (axis, way_deg) = stop.way();
    report.at_most(format!("travel of {axis}, the joint that moved farthest"), way_deg, SAG_MAX_DEG, "deg");
    refuses_motion(report, "while it is pressed", &mut *arm.driven);
    let reset = arm.driven.reset();
    let found = reset.as_ref().map_or_else(ToString::to_string, |()| "it was reset".to_owned());
    report.holds("this arm is not reset before the other one", reset.is_err(), found);
    session.ask(report, &Question::Stopped(choice))?;
    session.ask(report, &Question::Stopped(choice.other()))?;
    let act = Act::ReleaseEmergencyStop(choice.other());
    session.operator.ready("Then both arms are reset.", Some(act), &mut session.signals)?;
    let other = arm.other.as_mut().context("the other arm is not connected")?;
    session.reset(&mut *other.driven)?;
    session.reset(&mut *arm.driven)?;
    let other = arm.other.as_ref().context("the other arm is not connected")?;
    let states = [arm.driven.state(), other.driven.state()];
    report.holds(
        "after the resets both arms have their brakes on",
        states == [ArmState::Disabled; 2],
        format!("{states:?}"),
    );
    Ok(())
}

fn check_room(session: &Session<'_>, arm: &mut SlowArm, plan: &Plan) -> Result<()> {
    let other = arm.other.as_mut().context("the other arm is not connected")?;
    let other_rad = other.driven.exchange(JointCommand::Hold)?.position_rad;
    plan.room(&session.setup, session.choice, &other_rad).check(&session.setup)
}
