//! Disables an arm before its latch is cleared.

use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmPower};

/// The brakes close before a latch is cleared. An arm with a lost link cannot be commanded: its gateway has closed the brakes, and
/// the following reset restores the link or fails.
pub(crate) fn close_brakes(arm: &mut impl ArmPower) -> Result<(), ArmError> {
    match arm.stop() {
        Err(error) if error.kind() == ArmErrorKind::Disconnected => Ok(()),
        other => other,
    }
}
