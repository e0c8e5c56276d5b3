//! `pb3dp arm reset`: clears a latched stop of an arm after confirmation.

use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Result;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::{ArmPower, Clock};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_setup::setup::read_layers;
use pb3dp_wiring::commissioning::see;

use super::{Place, confirm};

/// Runs the command.
///
/// # Errors
/// A refused configuration, an arm that does not answer, a missing confirmation, or a cause that still exists.
pub fn run(place: &Place) -> Result<ExitCode> {
    let (choice, mut signals) = (place.choice(), StopSignals::take_over()?);
    let setup = read_layers(&place.setup)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut observed = see(&setup, choice, &clock)?;
    let Some(latched) = observed.arm.monitor().snapshot().latched else {
        print_line(&format!("{}: not stopped, nothing to reset", choice.name()))?;
        return Ok(ExitCode::SUCCESS);
    };
    let name = choice.name();
    if !choice.of(&setup).link.is_toy() {
        confirm::need_person()?;
    }
    print_line(&format!("{name} is stopped: {}\nAfter the cause is gone, type {name} to clear it:", latched.trip))?;
    confirm::typed(name, &mut signals)?;
    observed.arm.reset()?;
    print_line(&format!("{name}: {}", observed.arm.monitor().snapshot().state))?;
    Ok(ExitCode::SUCCESS)
}
