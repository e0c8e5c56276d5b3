//! The reset of an arm that is emulated in simulated time.

use std::sync::Arc;

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::arm::{VirtualTime, virtual_trip_line};
use pb3dp_arm_pa10::driver::LimitsCheck;
use pb3dp_hal_api::{ArmPower, Clock};
use pb3dp_setup::setup::{ArmLink, GatewayWay, Setup};

use super::arm::{Line, Wanted, connect};
use super::simulated_arms::SimulatedArm;

/// Resets an arm in simulated time, as `pb3dp arm reset` does: nothing else, and its brakes stay closed.
///
/// # Errors
/// If the arm cannot be connected, or a cause of its stop is present.
pub fn reset_standing(setup: &Setup, (arm, time): (&SimulatedArm, &Arc<VirtualTime>)) -> Result<()> {
    let of_setup = if arm.name == "vs-robot" { &setup.rig.arms.vs } else { &setup.rig.arms.tc };
    let ArmLink::Gateway(link, GatewayWay::Emulated) = &of_setup.link else { bail!("{} has no gateway", arm.name) };
    let clock: Arc<dyn Clock> = Arc::clone(time) as Arc<dyn Clock>;
    let control_period = setup.control_period;
    let wanted =
        Wanted { name: arm.name, arm: of_setup, control_period, clock: &clock, time: Some(time), standing: Some(arm) };
    let seat = virtual_trip_line(1).pop().context("a seat on the trip line between the arms")?;
    let line = Line::Virtual(link, arm.end.clone(), time);
    connect(line, (seat, LimitsCheck::Read), wanted)?.reset()?;
    Ok(())
}
