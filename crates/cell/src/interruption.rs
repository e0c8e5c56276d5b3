//! A run that signals end: by the first one with both arms stopped, by the second one without waiting for the report.

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use pb3dp_hal_platform::signals::StopSignals;
use rustix::event::{PollFd, PollFlags, poll};

use super::parts::ArmOnBus;

/// The exit code of a run that a signal has ended.
pub const INTERRUPTED: u8 = 130;

/// What the first signal has begun: both arms come to rest and close their brakes, one after the other. The time of the brakes comes to
/// it.
const STOP_MAX: Duration = Duration::from_secs(5);

/// What is left if that is not done: the order after a fault, 30 ms to rest, then the brakes, whose time comes to it.
const TRIP_MAX: Duration = Duration::from_secs(2);

/// How often arms are looked at meanwhile.
const LOOK: Duration = Duration::from_millis(10);

/// Has the run end when a signal asks for it, with both arms stopped; whoever asks twice does not want to wait for that, unless an arm
/// is on a bus of this computer. Returns whether a signal has come. `last_words` is called before the program ends at once.
///
/// # Errors
/// If the system gives no thread.
pub fn watch(
    mut signals: StopSignals,
    interrupt: &Arc<AtomicBool>,
    on_bus: Vec<ArmOnBus>,
    last_words: fn(),
) -> Result<Arc<AtomicBool>> {
    let (interrupt, was_interrupted) = (Arc::clone(interrupt), Arc::new(AtomicBool::new(false)));
    let told = Arc::clone(&was_interrupted);
    let work = move || {
        loop {
            // A wait that fails is a short one.
            let _ = poll(&mut [PollFd::from_borrowed_fd(signals.as_fd(), PollFlags::IN)], None);
            let Ok(Some(signal)) = signals.try_take() else { continue };
            interrupt.store(true, Ordering::SeqCst);
            if !told.swap(true, Ordering::SeqCst) {
                tracing::info!("{signal}: both arms stop, then the report");
                continue;
            }
            if on_bus.iter().all(ArmOnBus::is_stopped) {
                tracing::warn!("{signal} again: the program ends at once; an arm that moves is left to its gateway");
            } else {
                let names: Vec<_> = on_bus.iter().map(|arm| arm.name).collect();
                let brakes: Duration = on_bus.iter().map(|arm| arm.brake_time).sum();
                let (stop_max, trip_max) = (STOP_MAX + brakes, TRIP_MAX + brakes);
                tracing::warn!(
                    "{signal} again: no gateway stops {}, so the program ends after the stop order, within {:?}",
                    names.join(" and "),
                    stop_max + trip_max
                );
                wait_until_stopped(&on_bus, stop_max, trip_max);
            }
            last_words();
            std::process::exit(i32::from(INTERRUPTED));
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(work).context("no thread for signals")?;
    Ok(was_interrupted)
}

/// For as long as a stop takes at most; arms that do not stop are stopped as after a fault.
fn wait_until_stopped(on_bus: &[ArmOnBus], stop_max: Duration, trip_max: Duration) {
    if are_stopped_within(on_bus, stop_max) {
        return;
    }
    for arm in on_bus {
        arm.order.give();
    }
    if !are_stopped_within(on_bus, trip_max) {
        tracing::error!("an arm on the bus did not answer to its stop order: press the emergency stop");
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
