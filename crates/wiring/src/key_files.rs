//! Checks the key files of a setup without connecting.

use anyhow::{Context, Result};
use pb3dp_arm_pa10::arm::read_shared_key;
use pb3dp_setup::setup::{ArmLink, GatewayWay, Setup};

/// Checks the key file of each arm behind a TCP gateway: it exists, only its user can read it, and its text is a key. Nothing of the key is
/// kept or shown.
///
/// # Errors
/// All files that cannot be used, with their keys in the setup.
pub fn check_key_files(setup: &Setup) -> Result<()> {
    let mut problems = Vec::new();
    for arm in [&setup.rig.arms.vs, &setup.rig.arms.tc] {
        if let ArmLink::Gateway(_, GatewayWay::Tcp { key_file, .. }) = &arm.link {
            let read = read_shared_key(key_file).with_context(|| format!("{}.gateway.key_file", arm.key));
            problems.extend(read.err());
        }
    }
    let mut problems = problems.into_iter();
    let Some(first) = problems.next() else { return Ok(()) };
    Err(problems.fold(first, |first, other| first.context(format!("{other:#}"))))
}
