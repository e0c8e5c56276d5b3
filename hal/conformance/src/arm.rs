//! The contract of [`Arm`] and [`ArmPower`].

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand, JointState};
use pb3dp_kinematics::{DOF, JointVector};

use crate::Report;

/// Test parameters of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmExpectations {
    /// A speed that each joint can follow from its initial position, in both directions, rad/s.
    pub speed_rad_per_s: f64,
    /// Time within which the arm reaches that speed from standstill, or stops from it.
    pub settles_within: Duration,
}

/// Triggers a condition of an arm that commands cannot trigger.
pub type Hook<A> = Option<Box<dyn Fn(&mut A)>>;

/// Faults that a backend can inject; the rules of those that are `None` are not tested.
pub struct ArmHooks<A> {
    /// Loses the reply to the next exchange.
    pub lose_reply: Hook<A>,
    /// Raises a fault of the arm whose cause persists.
    pub raise_fault: Hook<A>,
    /// Removes that cause.
    pub remove_fault_cause: Hook<A>,
    /// Presses the emergency stop.
    pub press_e_stop: Hook<A>,
    /// Releases the emergency stop.
    pub release_e_stop: Hook<A>,
}

impl<A> Default for ArmHooks<A> {
    fn default() -> Self {
        Self { lose_reply: None, raise_fault: None, remove_fault_cause: None, press_e_stop: None, release_e_stop: None }
    }
}

/// Tests an arm against its contract. Every call of `make` connects to a disabled, stationary arm; `clock` is the arm's clock.
///
/// The arm moves: each joint by about four times `speed * settles_within` to both sides of its start.
///
/// Rules: `info-is-real`, `starts-disabled`, `hold-always-works`, `velocity-needs-enable`, `enables-at-rest`,
/// `enable-only-from-disabled`, `moves-as-commanded`, `hold-comes-to-rest`, `samples-in-order`, `returns-in-time`,
/// `not-finite-is-rejected`, `error-cancels-motion`, `goes-on-after-an-error`, `lost-reply-is-a-timeout`, `stop-disables`,
/// `stop-is-harmless-again`, `fault-latches`, `e-stop-latches`, `reset-needs-the-cause-gone`, `reset-leads-to-disabled`,
/// `unexpected-error`.
pub fn arm_suite<A: Arm + ArmPower>(
    make: impl Fn() -> A,
    clock: &dyn Clock,
    expectations: &ArmExpectations,
    hooks: &ArmHooks<A>,
) -> Report {
    arm_suite_of(&ArmPart::ALL, make, clock, expectations, hooks)
}

/// The parts of [`arm_suite`], each with an arm of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmPart {
    /// Before it is enabled.
    Disabled,
    /// Motion and rest.
    Motion,
    /// Commands that are no numbers.
    NotFinite,
    /// The stop.
    Stop,
    /// A lost reply.
    LostReply,
    /// A fault of the arm.
    Fault,
    /// The emergency stop.
    EmergencyStop,
}

impl ArmPart {
    /// Every part.
    pub const ALL: [Self; 7] =
        [Self::Disabled, Self::Motion, Self::NotFinite, Self::Stop, Self::LostReply, Self::Fault, Self::EmergencyStop];

    fn check<A: Arm + ArmPower>(self, bench: &mut Bench<'_, A>, hooks: &ArmHooks<A>) {
        match self {
            Self::Disabled => check_disabled(bench),
            Self::Motion => check_motion(bench),
            Self::NotFinite => check_not_finite(bench),
            Self::Stop => check_stop(bench),
            Self::LostReply => check_lost_reply(bench, &hooks.lose_reply),
            Self::Fault => check_latching(
                bench,
                &Latching {
                    raise: &hooks.raise_fault,
                    remove: &hooks.remove_fault_cause,
                    state: ArmState::Fault,
                    rule: "fault-latches",
                },
            ),
            Self::EmergencyStop => check_latching(
                bench,
                &Latching {
                    raise: &hooks.press_e_stop,
                    remove: &hooks.release_e_stop,
                    state: ArmState::EStop,
                    rule: "e-stop-latches",
                },
            ),
        }
    }
}

/// As [`arm_suite`], for some of its parts: those of an arm in real time may run beside each other.
pub fn arm_suite_of<A: Arm + ArmPower>(
    parts: &[ArmPart],
    make: impl Fn() -> A,
    clock: &dyn Clock,
    expectations: &ArmExpectations,
    hooks: &ArmHooks<A>,
) -> Report {
    let mut report = Report::new(&make().info().name);
    for part in parts {
        let mut bench = Bench { arm: make(), clock, expectations, report: &mut report, last_sample: None };
        part.check(&mut bench, hooks);
        // The arm is stopped whatever went wrong.
        let _ = bench.arm.stop();
    }
    report
}

struct Latching<'a, A> {
    raise: &'a Hook<A>,
    remove: &'a Hook<A>,
    state: ArmState,
    rule: &'static str,
}

/// One arm under test.
struct Bench<'a, A> {
    arm: A,
    clock: &'a dyn Clock,
    expectations: &'a ArmExpectations,
    report: &'a mut Report,
    last_sample: Option<MonotonicTime>,
}

impl<A: Arm + ArmPower> Bench<'_, A> {
    /// One exchange, with the rules that hold for every exchange.
    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let called = self.clock.now();
        let result = self.arm.exchange(command);
        let returned = self.clock.now();
        let (took, cycle) = (returned.saturating_since(called), self.arm.info().cycle);
        self.report.check("returns-in-time", took <= 2 * cycle, || format!("took {took:?}, a cycle is {cycle:?}"));
        if let Ok(sample) = &result {
            let in_order = self.last_sample.is_none_or(|last| last <= sample.at) && sample.at <= returned;
            self.report.check("samples-in-order", in_order, || {
                format!("a sample of {:?} after one of {:?}, at {returned:?}", sample.at, self.last_sample)
            });
            let finite = sample.position_rad.iter().chain(sample.velocity_rad_per_s.iter()).all(|x| x.is_finite());
            self.report.check("samples-in-order", finite, || format!("a sample is not finite: {sample:?}"));
            self.last_sample = Some(sample.at);
        }
        result
    }

    /// Repeats a command, cycle by cycle, for the settling time of the arm; returns the last sample.
    fn settle(&mut self, command: JointCommand) -> Option<JointState> {
        let cycle = self.arm.info().cycle.max(Duration::from_micros(100));
        let begin = self.clock.now();
        let mut due = begin;
        loop {
            let sample = self.exchange(command);
            if let Err(error) = &sample {
                self.report.check("unexpected-error", false, || format!("to {command:?}: {error}"));
                return None;
            }
            if due.saturating_since(begin) >= self.expectations.settles_within {
                return sample.ok();
            }
            due = due + cycle;
            self.clock.sleep_until(due);
        }
    }

    /// Lets the settling time pass without any exchange.
    fn be_silent(&self) {
        self.clock.sleep_until(self.clock.now() + self.expectations.settles_within);
    }

    fn enable(&mut self) -> bool {
        let result = self.arm.enable();
        let state = self.arm.state();
        let holds = result.is_ok() && state == ArmState::Enabled;
        self.report.check("enables-at-rest", holds, || format!("enable returned {result:?}, the state is {state:?}"))
    }

    /// Enables the arm and moves every joint.
    fn enable_and_move(&mut self) -> bool {
        self.enable() && self.settle(self.all_joints()).is_some()
    }

    fn all_joints(&self) -> JointCommand {
        let speed = self.expectations.speed_rad_per_s;
        JointCommand::Velocity(JointVector::from_fn(|i, _| if i % 2 == 0 { speed } else { -speed }))
    }

    fn check_at_rest(&mut self, rule: &'static str, when: &str) {
        let speed_max = 0.02 * self.expectations.speed_rad_per_s;
        match self.exchange(JointCommand::Hold) {
            Ok(sample) => {
                let speed = sample.velocity_rad_per_s.amax();
                self.report.check(rule, speed <= speed_max, || format!("{when} a joint moves at {speed} rad/s"));
            }
            Err(error) => {
                self.report.check("hold-always-works", false, || format!("{when}: {error}"));
            }
        }
    }

    fn check_state(&mut self, rule: &'static str, expected: ArmState, when: &str) {
        let state = self.arm.state();
        self.report.check(rule, state == expected, || format!("{when} the state is {state:?}, not {expected:?}"));
    }

    /// Checks that a command is refused with the expected error kind.
    fn check_refused(&mut self, rule: &'static str, command: JointCommand, expected: ArmErrorKind, when: &str) {
        let result = self.exchange(command).map_err(|error| error.kind());
        self.report.check(rule, result.as_ref().err() == Some(&expected), || {
            format!("{when} {command:?} returned {result:?}, not {expected:?}")
        });
    }
}

fn check_disabled<A: Arm + ArmPower>(bench: &mut Bench<'_, A>) {
    let info = bench.arm.info().clone();
    bench.report.check("info-is-real", !info.name.is_empty() && !info.cycle.is_zero(), || format!("{info:?}"));
    bench.check_state("starts-disabled", ArmState::Disabled, "after connecting");
    bench.check_at_rest("starts-disabled", "after connecting");
    let Ok(before) = bench.exchange(JointCommand::Hold) else { return };
    bench.check_refused("velocity-needs-enable", bench.all_joints(), ArmErrorKind::NotEnabled, "while disabled,");
    bench.be_silent();
    if let Ok(after) = bench.exchange(JointCommand::Hold) {
        let moved = (after.position_rad - before.position_rad).amax();
        bench.report.check("velocity-needs-enable", moved < 1e-3, || format!("a disabled arm moved by {moved} rad"));
    }
    if bench.enable() {
        bench.check_at_rest("enables-at-rest", "after enabling");
        let again = bench.arm.enable();
        bench.report.check("enable-only-from-disabled", again.is_err(), || "enabled twice without an error".to_owned());
        bench.check_state("enable-only-from-disabled", ArmState::Enabled, "after enabling twice");
    }
}

fn check_motion<A: Arm + ArmPower>(bench: &mut Bench<'_, A>) {
    if !bench.enable() {
        return;
    }
    for joint in 0..DOF {
        for sign in [1.0, -1.0] {
            let mut velocity = JointVector::zeros();
            velocity[joint] = sign * bench.expectations.speed_rad_per_s;
            let command = JointCommand::Velocity(velocity);
            let (Some(from), Some(to)) = (bench.settle(command), bench.settle(command)) else { return };
            let elapsed_s = to.at.seconds_since(from.at);
            let moved = (to.position_rad - from.position_rad) / elapsed_s;
            let tolerance = 0.1 * bench.expectations.speed_rad_per_s;
            let as_commanded = elapsed_s > 0.0
                && (moved - velocity).amax() <= tolerance
                && (to.velocity_rad_per_s - velocity).amax() <= tolerance;
            bench.report.check("moves-as-told", as_commanded, || {
                let commanded = velocity[joint];
                let (moved, measured) = (moved.as_slice(), to.velocity_rad_per_s);
                format!(
                    "joint {joint} at {commanded} rad/s: the angles moved at {moved:?} rad/s, measured {:?}",
                    measured.as_slice()
                )
            });
        }
    }
    if bench.settle(JointCommand::Hold).is_some() {
        bench.check_at_rest("hold-comes-to-rest", "after holding");
        bench.check_state("hold-comes-to-rest", ArmState::Enabled, "after holding");
    }
}

fn check_not_finite<A: Arm + ArmPower>(bench: &mut Bench<'_, A>) {
    if !bench.enable_and_move() {
        return;
    }
    for (joint, value) in [(0, f64::NAN), (3, f64::INFINITY), (6, f64::NEG_INFINITY)] {
        let mut velocity = JointVector::zeros();
        velocity[joint] = value;
        bench.check_refused(
            "not-finite-is-rejected",
            JointCommand::Velocity(velocity),
            ArmErrorKind::Rejected,
            "with a number that is not finite,",
        );
        bench.be_silent();
        bench.check_state("error-cancels-motion", ArmState::Enabled, "after a rejected command");
        bench.check_at_rest("error-cancels-motion", "after a rejected command");
        let goes_on = bench.exchange(bench.all_joints());
        bench
            .report
            .check("goes-on-after-an-error", goes_on.is_ok(), || format!("after a rejected command: {goes_on:?}"));
    }
}

fn check_stop<A: Arm + ArmPower>(bench: &mut Bench<'_, A>) {
    if !bench.enable_and_move() {
        return;
    }
    for (rule, when) in [("stop-disables", "after a stop"), ("stop-is-harmless-again", "after a second stop")] {
        let result = bench.arm.stop();
        bench.report.check(rule, result.is_ok(), || format!("stop returned {result:?}"));
        bench.check_state(rule, ArmState::Disabled, when);
        bench.check_at_rest(rule, when);
    }
    bench.check_refused("stop-disables", bench.all_joints(), ArmErrorKind::NotEnabled, "after a stop");
    bench.enable();
}

fn check_lost_reply<A: Arm + ArmPower>(bench: &mut Bench<'_, A>, lose_reply: &Hook<A>) {
    let Some(lose_reply) = lose_reply else { return };
    if !bench.enable_and_move() {
        return;
    }
    lose_reply(&mut bench.arm);
    bench.check_refused("lost-reply-is-a-timeout", bench.all_joints(), ArmErrorKind::Timeout, "with its reply lost,");
    bench.be_silent();
    bench.check_state("error-cancels-motion", ArmState::Enabled, "after a lost reply");
    bench.check_at_rest("error-cancels-motion", "after a lost reply");
    let goes_on = bench.exchange(bench.all_joints());
    bench.report.check("goes-on-after-an-error", goes_on.is_ok(), || format!("after a lost reply: {goes_on:?}"));
}

/// A fault or an emergency stop while the arm moves.
fn check_latching<A: Arm + ArmPower>(bench: &mut Bench<'_, A>, latching: &Latching<'_, A>) {
    let Some(raise) = latching.raise else { return };
    if !bench.enable_and_move() {
        return;
    }
    let (rule, state) = (latching.rule, latching.state);
    raise(&mut bench.arm);
    bench.check_state(rule, state, "after it happened");
    bench.check_refused(rule, bench.all_joints(), ArmErrorKind::Fault, "after it happened");
    bench.be_silent();
    bench.check_at_rest(rule, "after it happened");
    let enabled = bench.arm.enable();
    bench.report.check("enable-only-from-disabled", enabled.is_err(), || format!("enabled in {state:?}"));
    bench.check_state(rule, state, "after trying to enable");
    // Whether stopping a stopped arm is an error is not specified; it must not clear the state.
    let _ = bench.arm.stop();
    bench.check_state(rule, state, "after a stop");
    let Some(remove) = latching.remove else { return };
    let early = bench.arm.reset();
    bench.report.check("reset-needs-the-cause-gone", early.is_err(), || "reset with the cause still there".to_owned());
    bench.check_state("reset-needs-the-cause-gone", state, "after an early reset");
    remove(&mut bench.arm);
    bench.check_state(rule, state, "with the cause gone, but without a reset,");
    bench.check_refused(rule, bench.all_joints(), ArmErrorKind::Fault, "before the reset");
    let reset = bench.arm.reset();
    bench.report.check("reset-leads-to-disabled", reset.is_ok(), || format!("reset returned {reset:?}"));
    bench.check_state("reset-leads-to-disabled", ArmState::Disabled, "after the reset");
    let again = bench.arm.reset();
    bench.report.check("reset-leads-to-disabled", again.is_ok(), || format!("a second reset returned {again:?}"));
    bench.check_refused("reset-leads-to-disabled", bench.all_joints(), ArmErrorKind::NotEnabled, "after the reset");
    bench.enable();
}
