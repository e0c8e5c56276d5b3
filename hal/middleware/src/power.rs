//! Switching an arm off before its stop is forgiven.

use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmPower};

/// The brakes close before anything is forgiven. An arm whose link is gone cannot be told: its gateway has closed them, and the
/// reset that follows finds the link again or fails.
pub(crate) fn close_brakes(arm: &mut impl ArmPower) -> Result<(), ArmError> {
    match arm.stop() {
        Err(error) if error.kind() == ArmErrorKind::Disconnected => Ok(()),
        other => other,
    }
}
