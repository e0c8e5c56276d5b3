//! What wiring hands to a run: arms, camera, clock, and what stands in the cell. Nothing here names a backend.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::Result;
use pb3dp_hal_api::{Arm, ArmError, ArmPower, Clock};
use pb3dp_hal_middleware::{FlightLog, Limiter, LimiterStatistics};
use pb3dp_hal_platform::jitter::Jitter;
use pb3dp_record::calibration_files::CameraIdentity;
use pb3dp_setup::setup::{ArmSetup, Setup};
use pb3dp_sim::trajectory::Trajectory;

use super::cell::SimulatedCell;
use super::eyes::{Marking, Sight};
use super::operator::Operator;

/// An arm with its limiter: motion, power, and how often the limiter stepped in.
pub trait DrivenArm: Arm + ArmPower {
    /// How often the limiter stepped in so far.
    fn statistics(&self) -> LimiterStatistics;

    /// As [`ArmPower::enable`], and the motion goes on from where the arm is, if it has begun at its start before.
    ///
    /// # Errors
    /// As [`ArmPower::enable`].
    fn enable_here(&mut self) -> Result<(), ArmError>;

    /// As [`ArmPower::begin_enable`], for [`Self::enable_here`].
    ///
    /// # Errors
    /// As [`ArmPower::enable`].
    fn begin_enable_here(&mut self) -> Result<(), ArmError> {
        self.enable_here()
    }
}

impl<A: Arm + ArmPower> DrivenArm for Limiter<A> {
    fn statistics(&self) -> LimiterStatistics {
        Self::statistics(self)
    }

    fn enable_here(&mut self) -> Result<(), ArmError> {
        Self::enable_here(self)
    }

    fn begin_enable_here(&mut self) -> Result<(), ArmError> {
        Self::begin_enable_here(self)
    }
}

/// How punctual and complete the exchanges over an arm's link are.
pub trait LinkMonitor: Send {
    /// How late its cycles began.
    fn lateness(&self) -> Jitter;

    /// What did not take place.
    fn counts(&self) -> LinkCounts;
}

/// What did not take place on the link of an arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Cycles that were left out because their time had passed.
    pub missed: u64,
    /// Replies that did not come in time.
    pub replies_lost: u64,
}

/// An emulated arm at the other end of a link.
pub trait EmulatedArm: Send {
    /// Lets something go wrong, or end going wrong: a line as in a script.
    ///
    /// # Errors
    /// Names the word that is wrong and what to write instead; nothing happens then.
    fn command_line(&self, line: &str) -> Result<()>;
}

/// The stop order of an arm, from anywhere.
pub trait StopOrder: Send {
    /// Whether it is done and was heard, or none was needed.
    fn is_done(&self) -> bool;

    /// Gives it.
    fn give(&self);
}

/// An arm on a bus of this computer: nothing but this program stops it.
pub struct ArmOnBus {
    /// For messages.
    pub name: &'static str,
    /// Stops it.
    pub order: Box<dyn StopOrder>,
    /// How long its brakes take to close.
    pub brake_time: Duration,
}

impl ArmOnBus {
    /// Whether its stop order is done and was heard, or none was needed.
    pub fn is_stopped(&self) -> bool {
        self.order.is_done()
    }
}

/// Which arm of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmChoice {
    /// The one with the cameras.
    Vs,
    /// The one with the target.
    Tc,
}

impl ArmChoice {
    /// The name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vs => "vs-robot",
            Self::Tc => "tc-robot",
        }
    }

    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Self::Vs => Self::Tc,
            Self::Tc => Self::Vs,
        }
    }

    /// Its part of a setup.
    pub fn of(self, setup: &Setup) -> &ArmSetup {
        match self {
            Self::Vs => &setup.rig.vs,
            Self::Tc => &setup.rig.tc,
        }
    }

    /// Its part of a setup, to be changed.
    pub fn of_mut(self, setup: &mut Setup) -> &mut ArmSetup {
        match self {
            Self::Vs => &mut setup.rig.vs,
            Self::Tc => &mut setup.rig.tc,
        }
    }
}

/// Everything that a run steps.
pub struct Parts {
    /// The one clock.
    pub clock: Arc<dyn Clock>,
    /// The stereo pair, or what stands for it.
    pub camera: Sight,
    /// Which cameras these are, if they are real.
    pub cameras: Option<[CameraIdentity; 2]>,
    /// The arm that carries the cameras.
    pub vs: Box<dyn DrivenArm>,
    /// The arm that carries the target.
    pub tc: Box<dyn DrivenArm>,
    /// The truth.
    pub cell: SimulatedCell,
    /// How the target moves.
    pub experiment: Arc<dyn Trajectory>,
    /// What the flight recorder of each arm holds, by the arm's name.
    pub flights: [(&'static str, FlightLog); 2],
    /// What is marked in the first left image: the outline of a simulated target, or what the operator has marked.
    pub marking: Marking,
    /// What the links of the arms are like, by the names of the arms, as far as they have one.
    pub links: Vec<(&'static str, Box<dyn LinkMonitor>)>,
    /// Emulated arms at the other end of links; they end with this.
    pub emulated: Vec<Box<dyn EmulatedArm>>,
    /// Arms that no gateway would stop.
    pub on_bus: Vec<ArmOnBus>,
    /// Who tells the run what to do.
    pub operator: Box<dyn Operator>,
    /// Once this is set, the run ends before its time: both arms are stopped as at its end.
    pub interrupt: Arc<AtomicBool>,
}
