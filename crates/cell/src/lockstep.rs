//! The loop in simulated time: both halves are stepped by one virtual clock, so that the same seed gives the same run. Here one thread does
//! all the work; `beside` gives images a thread of their own.
//!
//! Two events occur in order of their times: a control step every control period, and a frame when its exposure has ended. An estimate
//! reaches the motion half only `estimate_latency` after the end of its exposure, independent of the speed of this computer.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use super::halves::{Course, Enabled, Mover, Watcher, first_failure};
use super::percept::Percept;

/// Steps both halves in order of their times, in one thread; both arms are stopped on every exit path.
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
    let arriving = Arriving::new(course);
    let stepped = step_both(course, &mut InOneThread { watcher, arriving }, enabled.mover(), begin);
    first_failure([stepped, enabled.stop()])
}

/// The vision half as this loop steps it.
pub(super) trait Looking {
    /// Record of a control step.
    type Step;

    /// Receives a finished control step.
    fn moved(&mut self, step: &Self::Step);

    /// A frame is due now.
    ///
    /// # Errors
    /// As [`Watcher::look`] and [`Watcher::note`], also of an earlier frame.
    fn frame(&mut self) -> Result<()>;

    /// The next result that has reached the motion half by the time `by`.
    ///
    /// # Errors
    /// As [`Self::frame`].
    fn arrived(&mut self, by: MonotonicTime) -> Result<Option<Percept>>;
}

/// Results that have not reached the motion half yet, with their arrival times.
pub(super) struct Arriving<'a> {
    clock: &'a dyn Clock,
    latency: Duration,
    results: VecDeque<(MonotonicTime, Percept)>,
}

impl<'a> Arriving<'a> {
    pub fn new(course: &Course<'a>) -> Self {
        Self { clock: &**course.clock, latency: course.setup.estimate_latency, results: VecDeque::new() }
    }

    /// When the result of a frame arrives whose exposure ends now.
    pub fn due(&self) -> MonotonicTime {
        self.clock.now() + self.latency
    }

    pub fn push(&mut self, due: MonotonicTime, percept: Percept) {
        self.results.push_back((due, percept));
    }

    pub fn pop(&mut self, by: MonotonicTime) -> Option<Percept> {
        self.results.front().filter(|(due, _)| *due <= by)?;
        self.results.pop_front().map(|(_, percept)| percept)
    }
}

struct InOneThread<'a, 'w, W> {
    watcher: &'w mut W,
    arriving: Arriving<'a>,
}

impl<W: Watcher> Looking for InOneThread<'_, '_, W> {
    type Step = W::Step;

    fn moved(&mut self, step: &W::Step) {
        self.watcher.moved(step);
    }

    fn frame(&mut self) -> Result<()> {
        let Some(percept) = self.watcher.look()? else { return Ok(()) };
        self.arriving.push(self.arriving.due(), percept);
        self.watcher.note()
    }

    fn arrived(&mut self, by: MonotonicTime) -> Result<Option<Percept>> {
        Ok(self.arriving.pop(by))
    }
}

/// Steps both halves from `begin` to the end of the course.
///
/// # Errors
/// The first permanent failure of either half.
pub(super) fn step_both<M: Mover, L: Looking<Step = M::Step>>(
    &Course { setup, clock, duration, interrupt }: &Course<'_>,
    looking: &mut L,
    mover: &mut M,
    begin: MonotonicTime,
) -> Result<()> {
    let end = begin + duration;
    let (mut next_control, mut next_frame) = (begin, begin + setup.rig.frames.exposure);
    while next_control.min(next_frame) <= end && !interrupt.load(Ordering::SeqCst) {
        if next_control <= next_frame {
            clock.sleep_until(next_control);
            while let Some(percept) = looking.arrived(next_control)? {
                mover.observe(percept, next_control);
            }
            looking.moved(&mover.step(next_control)?);
            next_control = next_control + setup.control_period;
            // Opening or closing brakes takes time; steps and frames due meanwhile are skipped.
            while next_control < clock.now() {
                next_control = next_control + setup.control_period;
            }
            while next_frame < clock.now() {
                next_frame = next_frame + setup.rig.frames.period;
            }
        } else {
            looking.frame()?;
            next_frame = next_frame + setup.rig.frames.period;
        }
    }
    Ok(())
}
