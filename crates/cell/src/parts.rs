//! The devices that wiring supplies to a run: arms, camera, clock, workcell. No backend is named here.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use pb3dp_hal_api::Clock;
use pb3dp_hal_middleware::FlightLog;
use pb3dp_record::calibration_files::CameraIdentity;
use pb3dp_setup::setup::{ArmSetup, Setup};
use pb3dp_sim::pushed::PushedTarget;
use pb3dp_sim::trajectory::Trajectory;

use super::camera_controls::ControlDesk;
use super::cell::SimulatedCell;
pub use super::devices::{ArmControl, GatewayLimits, LinkCounts, LinkMonitor};
use super::flight::KeepFlights;
use super::operator::Operator;
use super::perception::{TargetSource, VisionInput};
use super::selection::Selections;
use super::spectator::Spectator;

/// An emulated arm at the other end of a link.
pub trait EmulatedArm: Send {
    /// Injects a fault or ends it; `line` has the script syntax.
    ///
    /// # Errors
    /// Names the wrong part of the line and its replacement; the emulation stays unchanged.
    fn command_line(&self, line: &str) -> Result<()>;
}

/// One of the two arms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmChoice {
    /// The arm with the cameras.
    Vs,
    /// The arm with the target.
    Tc,
}

impl ArmChoice {
    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vs => "vs-robot",
            Self::Tc => "tc-robot",
        }
    }

    /// The other arm.
    pub fn other(self) -> Self {
        match self {
            Self::Vs => Self::Tc,
            Self::Tc => Self::Vs,
        }
    }

    /// Its part of a setup.
    pub fn of(self, setup: &Setup) -> &ArmSetup {
        match self {
            Self::Vs => &setup.rig.arms.vs,
            Self::Tc => &setup.rig.arms.tc,
        }
    }

    /// Its part of a setup, mutable.
    pub fn of_mut(self, setup: &mut Setup) -> &mut ArmSetup {
        match self {
            Self::Vs => &mut setup.rig.arms.vs,
            Self::Tc => &mut setup.rig.arms.tc,
        }
    }
}

/// All devices and models of a run.
pub struct Parts {
    /// The clock, shared by all parts.
    pub clock: Arc<dyn Clock>,
    /// The stereo rig, or its geometric substitute.
    pub camera: VisionInput,
    /// Identity of the cameras, if they are real.
    pub cameras: Option<[CameraIdentity; 2]>,
    /// Controls of the cameras, if they are real.
    pub camera_controls: Option<ControlDesk>,
    /// The arm that carries the cameras.
    pub vs: Box<dyn ArmControl>,
    /// The arm that carries the target.
    pub tc: Box<dyn ArmControl>,
    /// The ground truth.
    pub cell: SimulatedCell,
    /// Motion of the target.
    pub experiment: Arc<dyn Trajectory>,
    /// Flight recorder of each arm, by the arm's name.
    pub flights: [(&'static str, FlightLog); 2],
    /// Writes their files during a run that a fault does not end.
    pub keep_flights: KeepFlights,
    /// How the target is marked in the first left image: outline of a simulated target, or the operator's region.
    pub marking: TargetSource,
    /// Link monitors by the arms' names; arms without a link have none.
    pub links: Vec<(&'static str, Box<dyn LinkMonitor>)>,
    /// Emulated arms at the other end of links; dropping this field ends them.
    pub emulated: Vec<Box<dyn EmulatedArm>>,
    /// Source of the operator commands.
    pub operator: Box<dyn Operator>,
    /// The simulated target, if a person pushes it.
    pub pushed: Option<PushedTarget>,
    /// Observers of the run, such as the panel, and its recorder.
    pub spectators: Vec<Box<dyn Spectator>>,
    /// Targets that the operator selects during the run.
    pub selections: Option<Selections>,
    /// Once set, the run ends early; both arms are stopped as at its regular end.
    pub interrupt: Arc<AtomicBool>,
}
