//! The operator of a checklist, who actuates switches and cables and watches the arm.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_arm_pa10_protocol::codec::{Axis, Signal, SignalSource};
use pb3dp_cell::attended_motion::{EndedByPerson, Keys, Questions};
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::terminal::{EscapeEndsLine, print_line};
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_kinematics::JointVector;

use super::super::confirm::{Console, Line};

/// An action of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Press an emergency stop.
    PressEmergencyStop(ArmChoice),
    /// Release an emergency stop.
    ReleaseEmergencyStop(ArmChoice),
    /// Pull the cable between this computer and a gateway.
    PullCable(ArmChoice),
    /// Plug the cable in again.
    PlugCable(ArmChoice),
    /// Actuate or release the switch of a signal.
    Switch(ArmChoice, Signal, bool),
}

/// Something that the operator can see.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    /// Whether the joints are at these angles.
    Pose {
        /// Angles according to the program, rad.
        shown_rad: JointVector,
    },
    /// Whether one axis has turned since the operator was ready.
    Turned {
        /// The axis.
        axis: Axis,
        /// Its angle, rad.
        by_rad: f64,
    },
    /// Whether the arm has this switch.
    HasSwitch(Signal),
    /// Whether bits that two signals change may show one of them.
    Shared {
        /// The signal.
        signal: Signal,
        /// The other one.
        other: Signal,
        /// The bits.
        source: SignalSource,
    },
    /// Whether this arm stopped at once and is stationary with closed brakes.
    Stopped(ArmChoice),
}

/// The operator, who actuates switches and cables and watches the arm.
pub trait Operator {
    /// Name in the report.
    fn name(&self) -> &'static str;

    /// Whether the action takes place during the call of [`Self::act`].
    fn is_prompt(&self) -> bool;

    /// Confirms that arms may move, by typing this name.
    ///
    /// # Errors
    /// If something else is typed, or on a signal.
    fn confirm(&mut self, name: &str, signals: &mut StopSignals) -> Result<()>;

    /// Performs an action at once, while an arm moves.
    ///
    /// # Errors
    /// If the action is impossible.
    fn act(&mut self, act: Act) -> Result<()>;

    /// Ends a motion if the operator has called for its end meanwhile, or shows no sign of life; does not wait for either.
    ///
    /// # Errors
    /// The end.
    fn goes_on(&mut self) -> Result<(), EndedByPerson>;

    /// Shows the next event and the requested action, and waits until the operator is ready.
    ///
    /// # Errors
    /// If the operator declines or does not answer in time, or on a signal.
    fn ready(&mut self, text: &str, act: Option<Act>, signals: &mut StopSignals) -> Result<()>;

    /// Asks a yes-or-no question.
    ///
    /// # Errors
    /// If the operator does not answer in time, or on a signal.
    fn ask(&mut self, question: &Question, signals: &mut StopSignals) -> Result<bool>;
}

/// A person at the keyboard.
pub struct Person {
    console: Console,
    patience: Duration,
    clock: Arc<dyn Clock>,
    keys: Keys,
    /// Not on this thread: it may move an arm, and the terminal may be frozen.
    questions: Questions,
    /// Esc ends a motion, too.
    _escape: Option<EscapeEndsLine>,
}

impl Person {
    /// A person who must answer within `patience`, and press a key within each `key_within` while an arm moves.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn new(console: Console, (patience, key_within): (Duration, Duration), clock: Arc<dyn Clock>) -> Result<Self> {
        let (keys, questions) = (Keys::new(key_within, clock.now()), Questions::start(std::io::stdout())?);
        Ok(Self { console, patience, clock, keys, questions, _escape: EscapeEndsLine::set() })
    }

    fn line(&mut self, signals: &mut StopSignals) -> Result<String> {
        match self.console.line(Some(self.patience), signals)? {
            Line::Typed(line) => {
                self.keys.key_pressed(self.clock.now());
                Ok(line.trim().to_lowercase())
            }
            Line::Ended => bail!("standard input has ended, so no operator can answer; run the test in a terminal"),
            Line::TimedOut => {
                bail!("no answer within {:?}; repeat this step, or increase --patience", self.patience)
            }
        }
    }
}

impl Operator for Person {
    fn name(&self) -> &'static str {
        "person"
    }

    fn is_prompt(&self) -> bool {
        false
    }

    fn confirm(&mut self, name: &str, signals: &mut StopSignals) -> Result<()> {
        self.console.typed(name, Some(self.patience), signals)?;
        self.keys.key_pressed(self.clock.now());
        Ok(())
    }

    fn act(&mut self, act: Act) -> Result<()> {
        Ok(print_line(&format!("NOW: {act}"))?)
    }

    fn goes_on(&mut self) -> Result<(), EndedByPerson> {
        if let Some(question) = self.console.goes_on(&mut self.keys, self.clock.now())? {
            self.questions.ask(question);
        }
        Ok(())
    }

    fn ready(&mut self, text: &str, act: Option<Act>, signals: &mut StopSignals) -> Result<()> {
        let act = act.map(|act| format!("{act}. ")).unwrap_or_default();
        self.console.forget();
        print_line(&format!("{act}{text}\nPress Enter when you are ready (or type anything else to end this step):"))?;
        match self.line(signals)?.as_str() {
            "" => Ok(()),
            other => bail!("the operator did not go on: {other:?}"),
        }
    }

    fn ask(&mut self, question: &Question, signals: &mut StopSignals) -> Result<bool> {
        loop {
            self.console.forget();
            print_line(&format!("{question} Type yes or no:"))?;
            match self.line(signals)?.as_str() {
                "yes" | "y" => return Ok(true),
                "no" | "n" => return Ok(false),
                _ => {}
            }
        }
    }
}

impl std::fmt::Display for Act {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::PressEmergencyStop(arm) => write!(f, "Press the emergency stop of the {}", arm.name()),
            Self::ReleaseEmergencyStop(arm) => write!(f, "Release the emergency stop of the {}", arm.name()),
            Self::PullCable(arm) => write!(f, "Pull the cable to the gateway of the {}", arm.name()),
            Self::PlugCable(arm) => write!(f, "Plug the cable to the gateway of the {} in again", arm.name()),
            Self::Switch(arm, signal, is_on) => write!(f, "{} of the {}", action(*signal, *is_on), arm.name()),
        }
    }
}

/// Instruction for the switch of a signal.
fn action(signal: Signal, is_on: bool) -> &'static str {
    match (signal, is_on) {
        (Signal::EmergencyStop, true) => "Press the emergency stop",
        (Signal::EmergencyStop, false) => "Release the emergency stop",
        (Signal::LimitSwitch, true) => "Open a limit switch by hand",
        (Signal::LimitSwitch, false) => "Close the limit switch",
        (Signal::DeadMan, true) => "Release the dead-man switch",
        (Signal::DeadMan, false) => "Hold the dead-man switch",
        (Signal::Power, true) => "Switch off the servo power (without a switch: press the emergency stop)",
        (Signal::Power, false) => "Switch on the servo power",
    }
}

impl std::fmt::Display for Question {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Pose { shown_rad } => {
                let angles: Vec<_> = shown_rad.iter().map(|angle| format!("{:.1}", angle.to_degrees())).collect();
                write!(f, "Are the joints, from the base, at {} degrees, with these signs?", angles.join(", "))
            }
            Self::Turned { axis, by_rad } => write!(
                f,
                "Did {axis} alone turn, by {:+.2} degrees (positive as in the robot description), and did the arm not sag?",
                by_rad.to_degrees()
            ),
            Self::HasSwitch(signal) => write!(f, "Does the arm have a {signal}?"),
            Self::Shared { signal, other, source } => write!(
                f,
                "The bits {source} show the {signal} and the {other}. Is that plausible, and may they stop the arm for both?"
            ),
            Self::Stopped(arm) => {
                write!(f, "Did the {} stop at once, and does it stand with its brakes closed?", arm.name())
            }
        }
    }
}
