//! Arms that write down what they were told and what they measured, and fail if asked to.

use std::sync::{Arc, Mutex};

use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, JointCommand, JointState};
use pb3dp_hal_middleware::LimiterStatistics;
use pb3dp_orchestrator::wiring::{DrivenArm, Parts};

/// What one arm was told (before its limiter) and measured, one entry per control step.
#[derive(Clone, Default)]
pub struct Notes {
    pub commands: Arc<Mutex<Vec<JointCommand>>>,
    pub measured: Arc<Mutex<Vec<JointState>>>,
    /// After so many exchanges every further one fails.
    pub fail_after: Arc<Mutex<Option<usize>>>,
}

/// The parts with both arms watched: the arm with the cameras, the arm with the target.
pub fn watched(parts: Parts) -> (Parts, Notes, Notes) {
    let (vs, tc) = (Notes::default(), Notes::default());
    let parts = Parts {
        vs: Box::new(Watched { inner: parts.vs, notes: vs.clone() }),
        tc: Box::new(Watched { inner: parts.tc, notes: tc.clone() }),
        ..parts
    };
    (parts, vs, tc)
}

struct Watched {
    inner: Box<dyn DrivenArm>,
    notes: Notes,
}

impl Arm for Watched {
    fn info(&self) -> &ArmInfo {
        self.inner.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let mut commands = self.notes.commands.lock().unwrap();
        if self.notes.fail_after.lock().unwrap().is_some_and(|limit| commands.len() >= limit) {
            return Err(ArmError::new(ArmErrorKind::Disconnected, "the link was cut by the test"));
        }
        commands.push(command);
        let state = self.inner.exchange(command)?;
        self.notes.measured.lock().unwrap().push(state);
        Ok(state)
    }
}

impl ArmPower for Watched {
    fn state(&self) -> ArmState {
        self.inner.state()
    }

    fn enable(&mut self) -> Result<(), ArmError> {
        self.inner.enable()
    }

    fn stop(&mut self) -> Result<(), ArmError> {
        self.inner.stop()
    }

    fn reset(&mut self) -> Result<(), ArmError> {
        self.inner.reset()
    }
}

impl DrivenArm for Watched {
    fn statistics(&self) -> LimiterStatistics {
        self.inner.statistics()
    }

    fn enable_here(&mut self) -> Result<(), ArmError> {
        self.inner.enable_here()
    }
}
