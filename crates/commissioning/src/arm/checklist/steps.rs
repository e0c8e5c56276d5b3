//! The checklist: a table of its steps, with what each one needs and does, and their limits.

use anyhow::{Context, Result};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use pb3dp_cell::parts::ArmChoice;
use pb3dp_hal_api::{ArmPower as _, ArmState};
use pb3dp_wiring::commissioning::{OtherArm, SlowArm};

use super::limits::{
    BEHIND_MAX_DEG, BRAKED_MAX_DEG, END_MAX_DEG, EXCHANGES, INTERLOCK_REST_MAX_MS, LOST_PERCENT_MAX, OTHERS_MAX_DEG,
    PLAY_DEG, SAG_MAX_DEG,
};
use super::operator::Act;
use super::session::{Session, Stop};
use super::{comms, jog, kill, stops};

/// A step. Each one needs the previous ones.
pub struct Step {
    /// Name on the command line, in reports and in commissioning records.
    pub name: &'static str,
    /// Help on the command line.
    help: &'static str,
    /// Description of the step.
    pub title: &'static str,
    /// What it needs and does.
    pub task: Task,
    /// Expected result, for the operator.
    expects: fn() -> String,
}

/// What a step needs and does. Each task records its figures.
pub enum Task {
    /// Messages; no brake opens.
    Messages(fn(&mut Session<'_>) -> Result<()>),
    /// This program moves the arm.
    Move(fn(&mut Session<'_>, &mut SlowArm) -> Result<()>),
    /// This program moves the arm until an action of the operator stops it.
    StoppedMove {
        /// The action.
        by: fn(ArmChoice) -> Act,
        /// Whether the other arm holds with open brakes.
        beside_other: bool,
        /// What is checked once the arm is stopped.
        check: fn(&mut Session<'_>, &mut SlowArm, &Stop) -> Result<()>,
    },
    /// Another process moves the arm.
    OtherProcess(fn(&mut Session<'_>) -> Result<()>),
}

/// The steps, in order.
pub static STEPS: [Step; 6] = [
    Step {
        name: "comms",
        help: "Messages only, with brakes on",
        title: "messages only, brakes on",
        task: Task::Messages(comms::run),
        expects: || {
            format!(
                "{EXCHANGES} messages; at most {LOST_PERCENT_MAX} % lost, none damaged, joints still within {BRAKED_MAX_DEG} deg, a \
                 velocity is refused"
            )
        },
    },
    Step {
        name: "jog",
        help: "One axis, slowly",
        title: "one axis at 0.02 rad/s, there and back",
        task: Task::Move(jog::there_and_back),
        expects: || {
            format!(
                "right axis and direction, lag at most {BEHIND_MAX_DEG} deg, residual at most {END_MAX_DEG} deg at the end; other joints \
                 within {OTHERS_MAX_DEG} deg"
            )
        },
    },
    Step {
        name: "e-stop",
        help: "Emergency stop while the arm moves",
        title: "the emergency stop while it moves",
        task: Task::StoppedMove { by: Act::PressEmergencyStop, beside_other: false, check: stops::e_stop },
        expects: || {
            format!(
                "stationary after the brake time, no joint sags by more than {SAG_MAX_DEG} deg; no reset while the stop is pressed, no \
                 motion before the reset"
            )
        },
    },
    Step {
        name: "cable",
        help: "Cable between this computer and the gateway, pulled while the arm moves",
        title: "the cable to the gateway, pulled while it moves",
        task: Task::StoppedMove { by: Act::PullCable, beside_other: false, check: stops::cable },
        expects: || {
            format!(
                "one error at once; the gateway stops the arm by itself, within its watchdog travel plus {PLAY_DEG} deg; no motion \
                 before the reset"
            )
        },
    },
    Step {
        name: "kill",
        help: "Process killed while the arm moves",
        title: "kill -9 of the program that moves it",
        task: Task::OtherProcess(kill::run),
        expects: || {
            format!(
                "the gateway stops the arm by itself, within its watchdog travel plus {PLAY_DEG} deg; no motion before the reset"
            )
        },
    },
    Step {
        name: "interlock",
        help: "Emergency stop of the other arm",
        title: "the emergency stop of the other arm, while this one moves",
        task: Task::StoppedMove {
            by: |choice| Act::PressEmergencyStop(choice.other()),
            beside_other: true,
            check: stops::interlock,
        },
        expects: || {
            format!(
                "this arm is stopped within one control cycle and stationary within its brake time plus {INTERLOCK_REST_MAX_MS} ms; it can \
                 only be reset after the other one"
            )
        },
    },
];

/// The steps by their names on the command line.
pub fn parser() -> impl TypedValueParser<Value = &'static Step> {
    let names = STEPS.iter().map(|step| PossibleValue::new(step.name).help(step.help));
    PossibleValuesParser::new(names)
        .try_map(|name| STEPS.iter().find(|step| step.name == name).ok_or("it is no step of the checklist"))
}

impl PartialEq for Step {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl std::fmt::Debug for Step {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

impl Step {
    /// Whether brakes open in this step.
    pub fn moves(&self) -> bool {
        !matches!(self.task, Task::Messages(_))
    }

    /// Whether the operator acts at a switch or cable while the arm moves.
    pub fn is_acted_on(&self) -> bool {
        matches!(self.task, Task::StoppedMove { .. })
    }

    /// Whether the other arm takes part.
    pub fn needs_other(&self) -> bool {
        matches!(self.task, Task::StoppedMove { beside_other: true, .. })
    }

    /// A line of the plan.
    pub fn line(&self, number: usize) -> String {
        format!("{number}. {}: {}\n   expected: {}", self.name, self.title, (self.expects)())
    }

    /// Connects the arms that are needed, acts, and keeps the flight recorders if something has failed.
    ///
    /// # Errors
    /// An arm or an operator that does not answer, a failed move, or nothing that stopped an arm.
    pub fn run(&self, session: &mut Session<'_>) -> Result<()> {
        match self.task {
            Task::Messages(run) | Task::OtherProcess(run) => run(session),
            Task::Move(run) => drive(session, false, run),
            Task::StoppedMove { by, beside_other, check } => {
                drive(session, beside_other, |session, arm| {
                    let act = by(session.choice);
                    let plan = session.announce(arm, act)?;
                    if beside_other {
                        session.check_room(arm, &plan)?;
                        // An arm with closed brakes would not report its emergency stop.
                        session.switch_other_on(arm, &plan)?;
                    }
                    let stop = session.drive_until(arm, &plan, act)?;
                    check(session, arm, &stop)
                })
            }
        }
    }
}

/// Acts with the arm connected, alone or with the other one; that one is stopped afterwards.
fn drive(
    session: &mut Session<'_>,
    beside_other: bool,
    act: impl FnOnce(&mut Session<'_>, &mut SlowArm) -> Result<()>,
) -> Result<()> {
    let mut arm = session.connect(beside_other)?;
    let outcome = act(session, &mut arm);
    let may_be_on = |other: &&mut OtherArm| matches!(other.driven.state(), ArmState::Enabled | ArmState::Disabled);
    if let Some(other) = arm.other.as_mut().filter(may_be_on) {
        other.driven.stop().context("the other arm: stop order failed; press its emergency stop")?;
    }
    session.keep_if_failed(&arm, outcome)
}
