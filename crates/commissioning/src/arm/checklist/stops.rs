//! Steps `e-stop`, `cable` and `interlock`: what is checked once the emergency stop, the pulled cable or the emergency stop of the other
//! arm has stopped the moving arm.

use anyhow::{Context, Result};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, StopCause};
use pb3dp_hal_api::{ArmState, JointState};
use pb3dp_wiring::commissioning::SlowArm;

use super::limits::{
    FALL_MAX_RAD_PER_S, INTERLOCK_REST_MAX_MS, LEFT_ALONE, NOTICED_MAX_MS, PLAY_DEG, REST_MARGIN, SAG_MAX_DEG,
    SILENT_CYCLES_MAX,
};
use super::operator::{Act, Question};
use super::report::StepReport;
use super::session::{Session, Stop, farthest, refuses_motion};
use crate::arm::motion::JOG_RAD_PER_S;

/// Step `e-stop`.
///
/// # Errors
/// An arm or an operator that does not answer.
pub fn e_stop(session: &mut Session<'_>, arm: &mut SlowArm, stop: &Stop) -> Result<()> {
    let choice = session.choice;
    let is_e_stop = stop.state == ArmState::EStop;
    session.report.holds("the arm is stopped by an emergency stop", is_e_stop, stop.cause.clone());
    noticed(&mut session.report, "from the operator action to the stop of the program", stop);
    let rest_max_ms = brakes_ms(session) + 1e3 * REST_MARGIN.as_secs_f64();
    session.report.at_most("from the stop of the program to standstill", stop.to_rest_ms(), rest_max_ms, "ms");
    session.report.at_most("fastest joint meanwhile", stop.fastest_rad_per_s(), FALL_MAX_RAD_PER_S, "rad/s");
    travel(&mut session.report, stop);
    refuses_motion(&mut session.report, "while it is pressed", &mut *arm.driven);
    session.report.refused("a reset is refused while it is pressed", &arm.driven.reset(), "it was reset");
    session.ask(&Question::Stopped(choice))?;
    session.ready("Then the arm is reset.", Some(Act::ReleaseEmergencyStop(choice)))?;
    refuses_motion(&mut session.report, "after it was released, before the reset", &mut *arm.driven);
    session.reset(&mut *arm.driven)?;
    let state = arm.driven.state();
    session.report.holds("after the reset the brakes are on", state == ArmState::Disabled, format!("{state:?}"));
    Ok(())
}

/// Step `cable`.
///
/// # Errors
/// As [`e_stop`].
pub fn cable(session: &mut Session<'_>, arm: &mut SlowArm, stop: &Stop) -> Result<()> {
    let choice = session.choice;
    session.report.holds("the arm is stopped by a fault", stop.state == ArmState::Fault, stop.cause.clone());
    noticed(&mut session.report, "from the operator action to the stop of the program", stop);
    let silent_ms = 1e3 * stop.noticed.seconds_since(stop.before.at);
    let silent_max_ms = SILENT_CYCLES_MAX * 1e3 * session.setup.control_period.as_secs_f64();
    session.report.at_most("from the last measurement to the fault", silent_ms, silent_max_ms, "ms");
    refuses_motion(&mut session.report, "while it is pulled", &mut *arm.driven);
    session.pause(LEFT_ALONE)?;
    session.ask(&Question::Stopped(choice))?;
    session.ready("Then the arm is reset.", Some(Act::PlugCable(choice)))?;
    refuses_motion(&mut session.report, "after it was plugged in, before the reset", &mut *arm.driven);
    session.reset(&mut *arm.driven)?;
    let snapshot = arm.monitor.as_ref().context("the arm has no link")?.snapshot();
    let rests = snapshot.joints.context("the arm reported no joints")?;
    session.report.holds(
        "the arm was measured after the reset",
        rests.at > stop.noticed,
        format!("{} samples", snapshot.samples),
    );
    let gateway = snapshot.gateway_found.context("the gateway reported no properties")?;
    stopped_by_gateway(&mut session.report, gateway.state, gateway.cause);
    way(session, &stop.before, &rests);
    Ok(())
}

/// Step `interlock`: the emergency stop of the holding arm stops the moving arm.
///
/// # Errors
/// As [`e_stop`].
pub fn interlock(session: &mut Session<'_>, arm: &mut SlowArm, stop: &Stop) -> Result<()> {
    let choice = session.choice;
    let other = arm.other.as_mut().context("the other arm is not connected")?;
    let reported = other.monitor.as_ref().context("the other arm has no link")?.snapshot().latched;
    let is_e_stop = other.driven.state() == ArmState::EStop;
    let found = reported.map_or_else(|| "not stopped".to_owned(), |latched| latched.trip.to_string());
    session.report.holds("the other arm is stopped by an emergency stop", is_e_stop, found);
    let is_stopped = matches!(stop.state, ArmState::Fault | ArmState::EStop);
    session.report.holds("this arm is stopped, too", is_stopped, stop.cause.clone());
    noticed(&mut session.report, "from the operator action to the stop of this arm", stop);
    let apart_ms = reported.map_or(f64::NAN, |latched| 1e3 * stop.noticed.seconds_since(latched.at));
    let cycle_ms = 1e3 * session.setup.control_period.as_secs_f64();
    // R20. A common emergency stop may reach this arm first.
    session.report.at_most("from the stop of the other arm to that of this one", apart_ms, cycle_ms, "ms");
    let rest_max_ms = brakes_ms(session) + INTERLOCK_REST_MAX_MS;
    session.report.at_most("from there to standstill", stop.to_rest_ms(), rest_max_ms, "ms");
    travel(&mut session.report, stop);
    refuses_motion(&mut session.report, "while it is pressed", &mut *arm.driven);
    session.report.refused("this arm is not reset before the other one", &arm.driven.reset(), "it was reset");
    session.ask(&Question::Stopped(choice))?;
    session.ask(&Question::Stopped(choice.other()))?;
    let act = Act::ReleaseEmergencyStop(choice.other());
    session.ready("Then both arms are reset.", Some(act))?;
    let other = arm.other.as_mut().context("the other arm is not connected")?;
    session.reset(&mut *other.driven)?;
    session.reset(&mut *arm.driven)?;
    let other = arm.other.as_ref().context("the other arm is not connected")?;
    let states = [arm.driven.state(), other.driven.state()];
    session.report.holds(
        "after the resets both arms have their brakes on",
        states == [ArmState::Disabled; 2],
        format!("{states:?}"),
    );
    Ok(())
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

/// Records whether the gateway stopped the arm because of a silent host.
pub fn stopped_by_gateway(report: &mut StepReport, state: GatewayState, cause: StopCause) {
    let is_so = state == GatewayState::Fault && cause == StopCause::HostSilent;
    report.holds("the gateway has stopped the arm by itself", is_so, format!("{state}, cause: {cause}"));
}

/// Records the travel of an arm that only its gateway could stop.
pub fn way(session: &mut Session<'_>, before: &JointState, rests: &JointState) {
    let silence_s = f64::from(session.gateway.stop_after_us) / 1e6;
    // The last measurement may be as old as the allowed gap; the watchdog time follows, at the same speed.
    let gap_s = SILENT_CYCLES_MAX * session.setup.control_period.as_secs_f64();
    let most_deg = (JOG_RAD_PER_S * (silence_s + gap_s)).to_degrees() + PLAY_DEG;
    let (axis, way_deg) = farthest(before, rests);
    let what = format!("travel of {axis}, the joint that moved farthest since the last measurement");
    session.report.at_most(what, way_deg, most_deg, "deg");
}
