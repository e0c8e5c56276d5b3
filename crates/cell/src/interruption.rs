//! Ends a run on signals: the first signal stops both arms, the second one skips the report.

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use pb3dp_hal_platform::signals::StopSignals;
use rustix::event::{PollFd, PollFlags, poll};

use super::parts::ArmOnBus;

/// Exit code of a run that was ended by a signal.
pub const INTERRUPTED: u8 = 130;

/// Longest stop after the first signal without the brake times: both arms come to a stop and close their brakes, one after the other.
const STOP_MAX: Duration = Duration::from_secs(5);

/// Longest stop after a fault without the brake times: the stop order and 30 ms to standstill.
const TRIP_MAX: Duration = Duration::from_secs(2);

/// Interval of the checks whether the arms have stopped.
const LOOK: Duration = Duration::from_millis(10);

/// Ends the run on the first signal, with both arms stopped. A second signal ends the program at once, unless an arm is on a bus of this
/// computer. Returns the flag that a signal has arrived. `final_flush` is called before the program ends at once.
///
/// # Errors
/// If the system provides no thread.
pub fn watch(
    mut signals: StopSignals,
    interrupt: &Arc<AtomicBool>,
    on_bus: Vec<ArmOnBus>,
    final_flush: fn(),
) -> Result<Arc<AtomicBool>> {
    let (interrupt, was_interrupted) = (Arc::clone(interrupt), Arc::new(AtomicBool::new(false)));
    let flag = Arc::clone(&was_interrupted);
    let work = move || {
        loop {
            // A failed poll only shortens the wait.
            let _ = poll(&mut [PollFd::from_borrowed_fd(signals.as_fd(), PollFlags::IN)], None);
            let Ok(Some(signal)) = signals.try_take() else { continue };
            interrupt.store(true, Ordering::SeqCst);
            if !flag.swap(true, Ordering::SeqCst) {
                tracing::info!("{signal}: stopping both arms, then writing the report");
                continue;
            }
            if on_bus.iter().all(ArmOnBus::is_stopped) {
                tracing::warn!("{signal} again: exiting at once; the gateway stops an arm that still moves");
            } else {
                let names: Vec<_> = on_bus.iter().map(|arm| arm.name).collect();
                let brakes: Duration = on_bus.iter().map(|arm| arm.brake_time).sum();
                let (stop_max, trip_max) = (STOP_MAX + brakes, TRIP_MAX + brakes);
                tracing::warn!(
                    "{signal} again: no gateway stops {}; exiting after the stop order, within {:?}",
                    names.join(" and "),
                    stop_max + trip_max
                );
                wait_until_stopped(&on_bus, stop_max, trip_max);
            }
            final_flush();
            std::process::exit(i32::from(INTERRUPTED));
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(work).context("no thread for signals")?;
    Ok(was_interrupted)
}

/// Waits up to the longest stop time; arms that do not stop get the stop of a fault.
fn wait_until_stopped(on_bus: &[ArmOnBus], stop_max: Duration, trip_max: Duration) {
    if are_stopped_within(on_bus, stop_max) {
        return;
    }
    for arm in on_bus {
        arm.order.give();
    }
    if !are_stopped_within(on_bus, trip_max) {
        tracing::error!("an arm on the bus did not acknowledge its stop order: press the emergency stop");
    }
}

fn are_stopped_within(on_bus: &[ArmOnBus], time: Duration) -> bool {
    let begin = Instant::now();
    while !on_bus.iter().all(ArmOnBus::is_stopped) {
        if begin.elapsed() >= time {
            return false;
        }
        std::thread::sleep(LOOK);
    }
    true
}
