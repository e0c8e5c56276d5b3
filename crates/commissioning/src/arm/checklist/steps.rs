//! The steps of the checklist, in their order, and what each of them allows.

use std::time::Duration;

use clap::ValueEnum;
use serde::Serialize;

/// A step. Each one needs those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Step {
    /// Brakes on: messages only.
    Comms,
    /// One axis, slowly.
    Jog,
    /// The emergency stop while it moves.
    EStop,
    /// The cable between this computer and the gateway, pulled while it moves.
    Cable,
    /// The program, killed while the arm moves.
    Kill,
    /// The emergency stop of the other arm.
    Interlock,
}

/// Messages that prove the link.
pub const EXCHANGES: u32 = 300;
/// Lost messages in a hundred.
pub const LOST_PERCENT_MAX: f64 = 1.0;
/// Late commands: a later one counts as an overrun of the host.
pub const LATE_MAX_MS: f64 = 5.0;
/// Joints with closed brakes that show more than this move, degrees: 45 counts of the resolvers.
pub const BRAKED_MAX_DEG: f64 = 0.02;
/// An axis that is told to move may be behind its plan by this much, degrees.
pub const BEHIND_MAX_DEG: f64 = 0.5;
/// Joints that are told to stay may move by this much, degrees.
pub const OTHERS_MAX_DEG: f64 = 0.1;
/// An axis may end this far from where it was told to, degrees.
pub const END_MAX_DEG: f64 = 0.05;
/// Measured speed over the allowed one, for two samples in a row (R13).
pub const OVER_SPEED: f64 = 1.1;
/// An axis that has turned this far the other way turns the wrong way, degrees.
pub const WRONG_WAY_DEG: f64 = 0.2;
/// How far joints may sag when brakes close or drives lose their power, degrees.
pub const SAG_MAX_DEG: f64 = 2.0;
/// The fastest that a joint may be after an emergency stop, rad/s: what the slowest of them may be at all.
pub const FALL_MAX_RAD_PER_S: f64 = 1.0;
/// Slower than this in every joint is at rest, rad/s: ten counts of a measured speed.
pub const REST_RAD_PER_S: f64 = 2e-3;
/// From the hand at switch or cable to the stop of the program, where the hand is the program's.
pub const NOTICED_MAX_MS: f64 = 30.0;
/// Control cycles from the last measurement to the fault of a link that went silent: three lost replies and the wait for the last.
pub const SILENT_CYCLES_MAX: f64 = 5.0;
/// How far an arm may get beyond what its watchdogs explain, degrees: play of the brakes.
pub const PLAY_DEG: f64 = 0.5;
/// Beyond braking itself, until an arm is at rest.
pub const REST_MARGIN: Duration = Duration::from_millis(50);
/// For an arm that the other one stops, with its brakes: R8 gives 100 ms.
pub const INTERLOCK_REST_MAX_MS: f64 = 100.0;
/// How long an arm is left alone before it is looked at: at 0.02 rad/s one that goes on gets 2.3 degrees.
pub const LEFT_ALONE: Duration = Duration::from_secs(2);

impl Step {
    /// All, in order.
    pub const ALL: [Self; 6] = [Self::Comms, Self::Jog, Self::EStop, Self::Cable, Self::Kill, Self::Interlock];

    /// As on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Comms => "comms",
            Self::Jog => "jog",
            Self::EStop => "e-stop",
            Self::Cable => "cable",
            Self::Kill => "kill",
            Self::Interlock => "interlock",
        }
    }

    /// What it is.
    pub fn title(self) -> &'static str {
        match self {
            Self::Comms => "messages only, brakes on",
            Self::Jog => "one axis at 0.02 rad/s, there and back",
            Self::EStop => "the emergency stop while it moves",
            Self::Cable => "the cable to the gateway, pulled while it moves",
            Self::Kill => "kill -9 of the program that moves it",
            Self::Interlock => "the emergency stop of the other arm, while this one moves",
        }
    }

    /// Whether brakes open in it.
    pub fn moves(self) -> bool {
        self != Self::Comms
    }

    /// What has to happen, for who reads before he does.
    pub fn expects(self) -> String {
        match self {
            Self::Comms => format!(
                "{EXCHANGES} messages; at most {LOST_PERCENT_MAX} % lost, none damaged, joints still within {BRAKED_MAX_DEG} deg, a \
                 velocity is refused"
            ),
            Self::Jog => format!(
                "right axis and direction, at most {BEHIND_MAX_DEG} deg behind, {END_MAX_DEG} deg off at the end; other joints within \
                 {OTHERS_MAX_DEG} deg"
            ),
            Self::EStop => format!(
                "at rest once the brakes had their time, no joint sags by more than {SAG_MAX_DEG} deg; no reset while it is pressed, no \
                 motion before the reset"
            ),
            Self::Cable => format!(
                "one error at once; the gateway stops the arm by itself, within what its watchdog explains and {PLAY_DEG} deg; no motion \
                 before the reset"
            ),
            Self::Kill => format!(
                "the gateway stops the arm by itself, within what its watchdog explains and {PLAY_DEG} deg; no motion before the reset"
            ),
            Self::Interlock => format!(
                "this arm is stopped within one control cycle and at rest within {INTERLOCK_REST_MAX_MS} ms more than its brakes need; it is \
                 reset after the other one only"
            ),
        }
    }
}
