//! The loop in simulated time: one thread, stepped by one virtual clock, so that the same seed gives the same run.
//!
//! Two events occur in order of their times: a control step every control period, and a frame when its exposure has ended. An estimate
//! reaches the motion half only `estimate_latency` after the end of its exposure, independent of the speed of this computer.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;

use super::halves::{Course, Enabled, Mover, Watcher, first_failure};
use super::percept::Percept;

/// Steps both halves in order of their times; both arms are stopped on every exit path.
///
/// # Errors
/// The first permanent failure of an arm, the camera or the estimator.
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
    // Estimates that have not reached the motion half yet, with their arrival times.
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
            // Opening or closing brakes takes time; steps and frames due meanwhile are skipped.
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
