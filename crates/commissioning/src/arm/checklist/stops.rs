//! Steps `e-stop`, `cable` and `interlock`: the emergency stop, the pulled cable and the emergency stop of the other arm, each while
//! the arm moves.

use anyhow::{Context, Result};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, StopCause};
use pb3dp_cell::plan::Plan;
use pb3dp_hal_api::{ArmState, JointCommand, JointState};
use pb3dp_wiring::commissioning::SlowArm;

use super::operator::{Act, Question};
use super::record::StepReport;
use super::session::{Session, Stop, farthest, refuses_motion};
use super::steps::{
    FALL_MAX_RAD_PER_S, INTERLOCK_REST_MAX_MS, LEFT_ALONE, NOTICED_MAX_MS, PLAY_DEG, REST_MARGIN, SAG_MAX_DEG,
    SILENT_CYCLES_MAX,
};
use crate::arm::motion::JOG_RAD_PER_S;

/// Step `e-stop`.
///
/// # Errors
/// If nothing stopped the arm, or an operator does not answer.
pub fn e_stop(session: &mut Session<'_>, report: &mut StepReport, arm: &mut SlowArm) -> Result<()> {
    let choice = session.choice;
    let act = Act::PressEmergencyStop(choice);
    let plan = session.announce(arm, act)?;
    let stop = session.drive_until(arm, &plan, act)?;
    let is_e_stop = stop.state == ArmState::EStop;
    report.holds("the arm is stopped by an emergency stop", is_e_stop, stop.cause.clone());
    noticed(report, "from the operator action to the stop of the program", &stop);
    let rest_max_ms = brakes_ms(session) + 1e3 * REST_MARGIN.as_secs_f64();
    report.at_most("from the stop of the program to standstill", stop.to_rest_ms(), rest_max_ms, "ms");
    report.at_most("fastest joint meanwhile", stop.fastest_rad_per_s(), FALL_MAX_RAD_PER_S, "rad/s");
    travel(report, &stop);
    refuses_motion(report, "while it is pressed", &mut *arm.driven);
    refuses_reset(report, "a reset is refused while it is pressed", arm);
    session.ask(report, &Question::Stopped(choice))?;
    session.operator.ready("Then the arm is reset.", Some(Act::ReleaseEmergencyStop(choice)), &mut session.signals)?;
    refuses_motion(report, "after it was released, before the reset", &mut *arm.driven);
    session.reset(&mut *arm.driven)?;
    let state = arm.driven.state();
    report.holds("after the reset the brakes are on", state == ArmState::Disabled, format!("{state:?}"));
    Ok(())
}

/// Step `cable`.
///
/// # Errors
/// As [`e_stop`].
pub fn cable(session: &mut Session<'_>, report: &mut StepReport, arm: &mut SlowArm) -> Result<()> {
    let choice = session.choice;
    let plan = session.announce(arm, Act::PullCable(choice))?;
    let stop = session.drive_until(arm, &plan, Act::PullCable(choice))?;
    report.holds("the arm is stopped by a fault", stop.state == ArmState::Fault, stop.cause.clone());
    noticed(report, "from the operator action to the stop of the program", &stop);
    let silent_ms = 1e3 * stop.noticed.seconds_since(stop.before.at);
    let silent_max_ms = SILENT_CYCLES_MAX * 1e3 * session.setup.control_period.as_secs_f64();
    report.at_most("from the last measurement to the fault", silent_ms, silent_max_ms, "ms");
    refuses_motion(report, "while it is pulled", &mut *arm.driven);
    session.pause(LEFT_ALONE)?;
    session.ask(report, &Question::Stopped(choice))?;
    session.operator.ready("Then the arm is reset.", Some(Act::PlugCable(choice)), &mut session.signals)?;
    refuses_motion(report, "after it was plugged in, before the reset", &mut *arm.driven);
    session.reset(&mut *arm.driven)?;
    let snapshot = arm.monitor.as_ref().context("the arm has no link")?.snapshot();
    let rests = snapshot.joints.context("the arm reported no joints")?;
    report.holds(
        "the arm was measured after the reset",
        rests.at > stop.noticed,
        format!("{} samples", snapshot.samples),
    );
    let gateway = snapshot.gateway_found.context("the gateway reported no properties")?;
    stopped_by_gateway(report, gateway.state, gateway.cause);
    way(session, report, (&stop.before, &rests));
    Ok(())
}

/// Step `interlock`: the emergency stop of the holding arm stops the moving arm.
///
/// # Errors
/// As [`e_stop`].
pub fn interlock(session: &mut Session<'_>, report: &mut StepReport, arm: &mut SlowArm) -> Result<()> {
    let choice = session.choice;
    let act = Act::PressEmergencyStop(choice.other());
    let plan = session.announce(arm, act)?;
    check_room(session, arm, &plan)?;
    // An arm with closed brakes would not report its emergency stop.
    session.switch_other_on(arm, &plan)?;
    let stop = session.drive_until(arm, &plan, act)?;
    let other = arm.other.as_mut().context("the other arm is not connected")?;
    let reported = other.monitor.as_ref().context("the other arm has no link")?.snapshot().latched;
    let is_e_stop = other.driven.state() == ArmState::EStop;
    let found = reported.map_or_else(|| "not stopped".to_owned(), |latched| latched.trip.to_string());
    report.holds("the other arm is stopped by an emergency stop", is_e_stop, found);
    let is_stopped = matches!(stop.state, ArmState::Fault | ArmState::EStop);
    report.holds("this arm is stopped, too", is_stopped, stop.cause.clone());
    noticed(report, "from the operator action to the stop of this arm", &stop);
    let apart_ms = reported.map_or(f64::NAN, |latched| 1e3 * stop.noticed.seconds_since(latched.at));
    let cycle_ms = 1e3 * session.setup.control_period.as_secs_f64();
    // R20. A common emergency stop may reach this arm first.
    report.at_most("from the stop of the other arm to that of this one", apart_ms, cycle_ms, "ms");
    let rest_max_ms = brakes_ms(session) + INTERLOCK_REST_MAX_MS;
    report.at_most("from there to standstill", stop.to_rest_ms(), rest_max_ms, "ms");
    travel(report, &stop);
    refuses_motion(report, "while it is pressed", &mut *arm.driven);
    refuses_reset(report, "this arm is not reset before the other one", arm);
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

/// Records the time from the action to the stop, if the time of the action is known.
fn noticed(report: &mut StepReport, what: &str, stop: &Stop) {
    if let Some(noticed_ms) = stop.noticed_ms() {
        report.at_most(what, noticed_ms, NOTICED_MAX_MS, "ms");
    }
}

/// Time that the brakes take, ms.
fn brakes_ms(session: &Session<'_>) -> f64 {
    f64::from(session.gateway.brake_release_us) / 1e3
}

/// Records the travel of an arm without drive power.
fn travel(report: &mut StepReport, stop: &Stop) {
    let (axis, way_deg) = stop.way();
    report.at_most(format!("travel of {axis}, the joint that moved farthest"), way_deg, SAG_MAX_DEG, "deg");
}

/// Records that an arm cannot be reset now.
fn refuses_reset(report: &mut StepReport, what: &str, arm: &mut SlowArm) {
    let reset = arm.driven.reset();
    let found = reset.as_ref().map_or_else(ToString::to_string, |()| "it was reset".to_owned());
    report.holds(what, reset.is_err(), found);
}

/// Records whether the gateway stopped the arm because of a silent host.
pub fn stopped_by_gateway(report: &mut StepReport, state: GatewayState, cause: StopCause) {
    let is_so = state == GatewayState::Fault && cause == StopCause::HostSilent;
    report.holds("the gateway has stopped the arm by itself", is_so, format!("{state}, cause: {cause}"));
}

/// Records the travel of an arm that only its gateway could stop.
pub fn way(session: &Session<'_>, report: &mut StepReport, (before, rests): (&JointState, &JointState)) {
    let silence_s = f64::from(session.gateway.stop_after_us) / 1e6;
    // The last measurement may be as old as the allowed gap; the watchdog time follows, at the same speed.
    let gap_s = SILENT_CYCLES_MAX * session.setup.control_period.as_secs_f64();
    let most_deg = (JOG_RAD_PER_S * (silence_s + gap_s)).to_degrees() + PLAY_DEG;
    let (axis, way_deg) = farthest(before, rests);
    let what = format!("travel of {axis}, the joint that moved farthest since the last measurement");
    report.at_most(what, way_deg, most_deg, "deg");
}
