//! `pb3dp arm reset`: an operator clears what stopped an arm.

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
/// A configuration that is refused, an arm that does not answer, a confirmation that does not come, a cause that is still there.
pub fn run(place: &Place) -> Result<ExitCode> {
    let (choice, mut signals) = (place.choice(), StopSignals::take_over()?);
    let setup = read_layers(&place.setup)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut seen = see(&setup, choice, &clock)?;
    let Some(latched) = seen.arm.monitor().snapshot().latched else {
        print_line(&format!("{}: nothing has stopped it", choice.name()))?;
        return Ok(ExitCode::SUCCESS);
    };
    let name = choice.name();
    print_line(&format!("{name} is stopped: {}\nType {name} once the cause is gone, to clear it:", latched.trip))?;
    confirm::typed(name, &mut signals)?;
    seen.arm.reset()?;
    print_line(&format!("{name}: {}", seen.arm.monitor().snapshot().state))?;
    Ok(ExitCode::SUCCESS)
}
