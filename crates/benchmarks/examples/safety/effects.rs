//! The outcome of each fault of a run; a fault without effect is counted separately.

use system_tests::safety::truth::Truth;

use crate::faults::{Fault, Kind};
use crate::recorder::Recorder;
use crate::scenario::Scenario;
use crate::telling::Happened;

/// A fault counts as noticed until this long after its end, seconds.
const NOTICED_S: f64 = 0.5;

/// Outcome of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Became {
    /// The control loop had ended.
    AfterTheEnd,
    /// No effect: no frame pair arrived while it lasted, no operator was present, or the drives were disabled.
    NoEffect,
    /// No log line and no counter.
    Borne,
    /// A log line, or a counter that rose.
    Noticed,
}

impl Became {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::AfterTheEnd => "after the end",
            Self::NoEffect => "without effect",
            Self::Borne => "not noticed",
            Self::Noticed => "noticed",
        }
    }
}

/// Name in tables of the time in which the arms are being enabled: the supervisor does not run yet.
pub const ENABLING: &str = "enabling";

/// The state of the supervisor in which each fault began; none if it did not begin.
pub fn states(faults: &[Fault], times: &[Happened], truth: &Truth) -> Vec<Option<&'static str>> {
    let state = |(fault, times): (&Fault, &Happened)| {
        let from_s = times.from_s?;
        if fault.is_of_enabling() {
            return Some(ENABLING);
        }
        // The step in which it begins may already show its effect.
        truth.steps.iter().take_while(|step| step.t_s < from_s).last().or(truth.steps.first()).map(|step| step.state)
    };
    faults.iter().zip(times).map(state).collect()
}

/// Outcomes of all faults.
pub fn all(scenario: &Scenario, times: &[Happened], recording: &Recorder) -> Vec<Became> {
    let faults = scenario.faults.iter().zip(times).enumerate();
    faults
        .map(|(index, (fault, times))| {
            let Some(from_s) = times.from_s else { return Became::AfterTheEnd };
            let until_s = times.until_s.unwrap_or(f64::INFINITY).min(fault.until_s().max(from_s + fault.for_s));
            let met = met(fault, (from_s, until_s), scenario, &recording.truth);
            if !met.unwrap_or_else(|| recording.was_touched(index)) {
                return Became::NoEffect;
            }
            let within = fault.from_s.min(from_s) - 1e-3..until_s + NOTICED_S;
            let is_noticed = match fault.is_of_enabling() {
                true => recording.noticed_enabling,
                false => recording.noticed_s.iter().any(|t_s| within.contains(t_s)),
            };
            if is_noticed { Became::Noticed } else { Became::Borne }
        })
        .collect()
}

/// Whether the fault had an effect, if its time and the record show it; `None`: the perception thread has recorded it.
fn met(fault: &Fault, (from_s, until_s): (f64, f64), scenario: &Scenario, truth: &Truth) -> Option<bool> {
    let is_on = |arm: Option<usize>| {
        let during = truth.steps.iter().filter(|step| step.t_s >= from_s - 0.01 && step.t_s <= until_s + 0.01);
        during
            .flat_map(|step| step.arms.iter().enumerate())
            .any(|(index, truth)| truth.servo_on && arm.is_none_or(|arm| arm == index))
    };
    match &fault.kind {
        _ if fault.is_of_enabling() => Some(true),
        Kind::Overrun(_) | Kind::ClockJump(_) => Some(is_on(None)),
        Kind::EmergencyStopOfBoth | Kind::Unplugged(_) | Kind::Arm { .. } => Some(is_on(fault.kind.arm())),
        Kind::GatewayRestart(_) | Kind::Tampered(..) => Some(is_on(fault.kind.arm())),
        Kind::HostDies => Some(true),
        Kind::Silence => Some(scenario.has_person),
        _ => None,
    }
}
