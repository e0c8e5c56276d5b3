//! Arms that record their commands and measurements, and fail on request.

use std::sync::{Arc, Mutex, PoisonError};

use pb3dp_cell::parts::{ArmControl, Parts};
use pb3dp_hal_api::{ArmError, ArmErrorKind, JointCommand, JointState};

use crate::between::Between;

/// Commands (before the limiter) and measurements of one arm, one entry per control step.
#[derive(Clone, Default)]
pub struct Notes {
    /// What it was told, before its limiter.
    pub commands: Arc<Mutex<Vec<JointCommand>>>,
    /// What it measured.
    pub measured: Arc<Mutex<Vec<JointState>>>,
    /// After this many exchanges every further exchange fails.
    pub fail_after: Arc<Mutex<Option<usize>>>,
}

/// The parts with both arms watched: the arm with the cameras, the arm with the target.
pub fn watched(parts: Parts) -> (Parts, Notes, Notes) {
    let (vs, tc) = (Notes::default(), Notes::default());
    let parts = Parts { vs: noted(parts.vs, vs.clone()), tc: noted(parts.tc, tc.clone()), ..parts };
    (parts, vs, tc)
}

fn noted(arm: Box<dyn ArmControl>, notes: Notes) -> Box<dyn ArmControl> {
    Between::boxed(arm, move |arm, command| {
        let mut commands = notes.commands.lock().unwrap_or_else(PoisonError::into_inner);
        if notes.fail_after.lock().unwrap_or_else(PoisonError::into_inner).is_some_and(|limit| commands.len() >= limit)
        {
            return Err(ArmError::new(ArmErrorKind::Disconnected, "the link was cut by the test"));
        }
        commands.push(command);
        let state = arm.exchange(command)?;
        notes.measured.lock().unwrap_or_else(PoisonError::into_inner).push(state);
        Ok(state)
    })
}
