//! Arms that write down what they were told and what they measured, and fail if asked to.

#[allow(
    clippy::duplicate_mod,
    reason = "the benchmark of the servo shares this file, and has no module of its own for it"
)]
#[path = "../between/mod.rs"]
mod between;

use std::sync::{Arc, Mutex};

use between::Between;
use pb3dp_cell::parts::{DrivenArm, Parts};
use pb3dp_hal_api::{ArmError, ArmErrorKind, JointCommand, JointState};

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
    let parts = Parts { vs: noted(parts.vs, vs.clone()), tc: noted(parts.tc, tc.clone()), ..parts };
    (parts, vs, tc)
}

fn noted(arm: Box<dyn DrivenArm>, notes: Notes) -> Box<dyn DrivenArm> {
    Between::boxed(arm, move |arm, command| {
        let mut commands = notes.commands.lock().unwrap();
        if notes.fail_after.lock().unwrap().is_some_and(|limit| commands.len() >= limit) {
            return Err(ArmError::new(ArmErrorKind::Disconnected, "the link was cut by the test"));
        }
        commands.push(command);
        let state = arm.exchange(command)?;
        notes.measured.lock().unwrap().push(state);
        Ok(state)
    })
}
