//! The loop in simulated time: one thread, stepped by one virtual clock, so that the same seed gives the same run.
//!
//! Two things happen, each at its own time, the earlier one first: a control step every control period, and a frame when
//! its exposure has ended. An estimate reaches those who move only `estimate_latency` after its exposure has ended, however
//! fast this machine computed it.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;

use super::halves::{Course, Enabled, Mover, Watcher, first_failure};
use super::percept::Percept;

/// Steps both halves in the order of their times; both arms are stopped on every way out.
///
/// # Errors
/// The first failure of an arm, the camera or the estimator for good.
pub(super) fn drive<M: Mover, W: Watcher<Step = M::Step>>(
    course: &Course<'_>,
    watcher: &mut W,
    mover: &mut M,
) -> Result<()> {
    let mut enabled = Enabled::new(course, mover)?;
    let begin = course.clock.now();
    watcher.begin_at(begin);
    enabled.mover().begin_at(begin);
    let stepped = step_both(course, watcher, enabled.mover(), begin);
    first_failure([stepped, enabled.stop()])
}

fn step_both<M: Mover, W: Watcher<Step = M::Step>>(
    &Course { setup, clock, duration, interrupt }: &Course<'_>,
    watcher: &mut W,
    mover: &mut M,
    begin: MonotonicTime,
) -> Result<()> {
    let end = begin + duration;
    // Estimates on their way to those who move, with the time of arrival.
    let mut arriving: VecDeque<(MonotonicTime, Percept)> = VecDeque::new();
    let (mut next_control, mut next_frame) = (begin, begin + setup.rig.frames.exposure);
    while next_control.min(next_frame) <= end && !interrupt.load(Ordering::SeqCst) {
        if next_control <= next_frame {
            clock.sleep_until(next_control);
            while let Some((_, percept)) = arriving.front().filter(|(due, _)| *due <= next_control) {
                mover.observe(*percept, next_control);
                arriving.pop_front();
            }
            watcher.moved(&mover.step(next_control)?);
            next_control = next_control + setup.control_period;
            // Brakes that open or close take their time; what would have been then is left out.
            while next_control < clock.now() {
                next_control = next_control + setup.control_period;
            }
            while next_frame < clock.now() {
                next_frame = next_frame + setup.rig.frames.period;
            }
        } else {
            if let Some(percept) = watcher.look()? {
                arriving.push_back((clock.now() + setup.estimate_latency, percept));
                watcher.note()?;
            }
            next_frame = next_frame + setup.rig.frames.period;
        }
    }
    Ok(())
}
