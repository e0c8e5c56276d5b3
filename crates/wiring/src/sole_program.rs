//! One program of a computer moves arms that are not emulated: two programs keep no distance between their arms.

use std::io;
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use pb3dp_hal_platform::only_program::OnlyProgram;
use pb3dp_setup::setup::ArmSetup;

/// Name of which the moving program is the holder.
const NAME: &str = "pb3dp-moves-arms";

/// Test builds take the name from this variable, and need none without it: tests move arms side by side.
const TEST_NAME: &str = "PB3DP_TEST_SOLE_PROGRAM";

/// The right to move arms, if one of these is not emulated. It ends when the last owner is dropped.
///
/// # Errors
/// If another program of this computer has it.
pub(super) fn sole_program(arms: &[&ArmSetup]) -> Result<Option<Arc<OnlyProgram>>> {
    let Some(name) = name() else { return Ok(None) };
    let Some(arm) = arms.iter().find(|arm| !arm.link.is_toy()) else { return Ok(None) };
    match OnlyProgram::take(&name) {
        Ok(sole) => Ok(Some(Arc::new(sole))),
        Err(error) if error.kind() == io::ErrorKind::AddrInUse => bail!(
            "{}: another program of this computer can move an arm that is not emulated, and nothing would keep a distance between its arm \
             and this one; end it (`pgrep -a pb3dp`), or move both arms by one setup",
            arm.key
        ),
        Err(error) => {
            Err(error).with_context(|| format!("{}: it is unknown whether another program moves an arm", arm.key))
        }
    }
}

fn name() -> Option<String> {
    match cfg!(debug_assertions) {
        true => std::env::var(TEST_NAME).ok(),
        false => Some(NAME.to_owned()),
    }
}
