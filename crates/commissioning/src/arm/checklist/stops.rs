//! Steps `e-stop` and `cable`: the emergency stop and the pulled cable, each while the arm moves.

use anyhow::{Context, Result};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, StopCause};
use pb3dp_hal_api::{ArmState, JointState};
use pb3dp_wiring::commissioning::SlowArm;

use super::operator::{Act, Question};
use super::record::StepReport;
use super::session::{Session, Stop, farthest, refuses_motion};
use super::steps::{
    FALL_MAX_RAD_PER_S, LEFT_ALONE, NOTICED_MAX_MS, PLAY_DEG, REST_MARGIN, SAG_MAX_DEG, SILENT_CYCLES_MAX,
};
use crate::arm::motion::JOG_RAD_PER_S;

/// Step `e-stop`.
///
/// # Errors
/// If nothing stopped the arm, or an operator does not answer.
pub fn e_stop(session: &mut Session<'_>, report: &mut StepReport) -> Result<()> {
    let mut arm = session.connect(false)?;
    let outcome = e_stop_of(session, report, &mut arm);
    session.keep_if_failed(report, &arm, outcome)
}

fn e_stop_of(session: &mut Session<'_>, report: &mut StepReport, arm: &mut SlowArm) -> Result<()> {
    let choice = session.choice;
    let act = Act::PressEmergencyStop(choice);
    let plan = session.announce(arm, act)?;
    let stop = session.drive_until(arm, &plan, act)?;
    let is_e_stop = stop.state == ArmState::EStop;
    report.holds("the arm is stopped by an emergency stop", is_e_stop, stop.cause.clone());
    noticed(report, &stop);
    at_rest(session, report, &stop);
    refuses_motion(report, "while it is pressed", &mut *arm.driven);
    let reset = arm.driven.reset();
    let found = reset.as_ref().map_or_else(ToString::to_string, |()| "it was reset".to_owned());
    report.holds("a reset is refused while it is pressed", reset.is_err(), found);
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
pub fn cable(session: &mut Session<'_>, report: &mut StepReport) -> Result<()> {
    let mut arm = session.connect(false)?;
    let outcome = cable_of(session, report, &mut arm);
    session.keep_if_failed(report, &arm, outcome)
}

fn cable_of(session: &mut Session<'_>, report: &mut StepReport, arm: &mut SlowArm) -> Result<()> {
    let choice = session.choice;
    let plan = session.announce(arm, Act::PullCable(choice))?;
    let stop = session.drive_until(arm, &plan, Act::PullCable(choice))?;
    report.holds("the arm is stopped by a fault", stop.state == ArmState::Fault, stop.cause.clone());
    noticed(report, &stop);
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

/// Records the time from the action to the stop, if the time of the action is known.
fn noticed(report: &mut StepReport, stop: &Stop) {
    if let Some(noticed_ms) = stop.noticed_ms() {
        report.at_most("from the operator action to the stop of the program", noticed_ms, NOTICED_MAX_MS, "ms");
    }
}

/// Records the stop of an arm without drive power; the brake time is allowed.
fn at_rest(session: &Session<'_>, report: &mut StepReport, stop: &Stop) {
    let brakes_ms = f64::from(session.gateway.brake_release_us) / 1e3;
    let most_ms = brakes_ms + 1e3 * REST_MARGIN.as_secs_f64();
    report.at_most("from the stop of the program to standstill", stop.to_rest_ms(), most_ms, "ms");
    report.at_most("fastest joint meanwhile", stop.fastest_rad_per_s(), FALL_MAX_RAD_PER_S, "rad/s");
    let (axis, way_deg) = stop.way();
    report.at_most(format!("travel of {axis}, the joint that moved farthest"), way_deg, SAG_MAX_DEG, "deg");
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
