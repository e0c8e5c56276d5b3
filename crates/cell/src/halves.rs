//! The two halves of everything that has both arms move before the cameras: one that looks, and one that moves. Which loop steps
//! them, in simulated time or in the machine's, neither knows.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_servo::supervisor::FrameInput;
use pb3dp_setup::setup::Setup;

use super::percept::Percept;

/// The half that moves both arms.
pub trait Mover: Send {
    /// What a control step is remembered by.
    type Step: Copy + Send;

    /// Switches both arms on, as far as that is possible now: whether they are on. To be called in each control cycle until then.
    ///
    /// # Errors
    /// The arm that cannot be switched on, and why; the other one may be on.
    fn enable(&mut self) -> Result<bool>;

    /// Control steps begin at this time.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// The newest that was seen of the target; the control step at `now` is the first one that has it.
    fn observe(&mut self, percept: Percept, now: MonotonicTime);

    /// One control step of both arms.
    ///
    /// # Errors
    /// Why both have to be stopped.
    fn step(&mut self, now: MonotonicTime) -> Result<Self::Step>;

    /// Both arms come to rest with brakes on, whatever happened before.
    ///
    /// # Errors
    /// The arm that cannot be told.
    fn stop(&mut self) -> Result<()>;
}

/// The half that looks.
pub trait Watcher {
    /// What it is told of a control step.
    type Step: Copy + Send;

    /// Control steps begin at this time.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// A control step was done.
    fn moved(&mut self, step: &Self::Step);

    /// Waits for the next pair and looks at it: what those who move are told. `None` if it did not come.
    ///
    /// # Errors
    /// If there will be no more.
    fn look(&mut self) -> Result<Option<Percept>>;

    /// Writes down what was seen last; those who move know it by now.
    ///
    /// # Errors
    /// If it cannot be written.
    fn note(&mut self) -> Result<()>;
}

/// The half that looks, whose three parts can have a thread each.
pub trait Parted {
    /// What it is told of a control step.
    type Step: Copy + Send;
    /// What is captured.
    type Frame: Send;
    /// What is seen in it.
    type Seen: Send;

    /// Control steps begin at this time.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// What captures, what estimates, and what writes down.
    #[allow(clippy::type_complexity, reason = "each part with what it has to go with")]
    fn parts(
        &mut self,
    ) -> (
        impl Capture<Frame = Self::Frame>,
        impl Estimate<Frame = Self::Frame, Seen = Self::Seen, Step = Self::Step>,
        impl Record<Seen = Self::Seen, Step = Self::Step>,
    );
}

/// What captures frames.
pub trait Capture: Send {
    /// What is captured.
    type Frame: Send;

    /// Waits for the next frame. `None` if it did not come.
    ///
    /// # Errors
    /// If there will be no more.
    fn capture(&mut self) -> Result<Option<Self::Frame>>;

    /// Number and times of a frame.
    fn input(frame: &Self::Frame) -> FrameInput;
}

/// What estimates from frames.
pub trait Estimate: Send {
    /// What is looked at.
    type Frame;
    /// What was seen, to be written down.
    type Seen;
    /// What it is told of a control step.
    type Step;

    /// A control step was done.
    fn moved(&mut self, step: &Self::Step);

    /// Looks at a frame: what those who move are told, and what is to be written down.
    ///
    /// # Errors
    /// If it fails for good.
    fn look(&mut self, frame: Self::Frame) -> Result<(Percept, Self::Seen)>;
}

/// What writes down.
pub trait Record {
    /// What was seen in a frame.
    type Seen;
    /// What it is told of a control step.
    type Step;

    /// A control step was done.
    fn moved(&mut self, step: &Self::Step);

    /// Writes down what was seen in a frame.
    ///
    /// # Errors
    /// If it cannot be written.
    fn note(&mut self, seen: Self::Seen) -> Result<()>;
}

impl<C: Capture> Capture for &mut C {
    type Frame = C::Frame;

    fn capture(&mut self) -> Result<Option<C::Frame>> {
        (**self).capture()
    }

    fn input(frame: &C::Frame) -> FrameInput {
        C::input(frame)
    }
}

/// For how long both halves are stepped, and on which clock.
pub struct Course<'a> {
    /// Their times.
    pub setup: &'a Setup,
    /// The one clock.
    pub clock: &'a Arc<dyn Clock>,
    /// From the first control step to the last one.
    pub duration: Duration,
    /// Once this is set, the course ends before its time.
    pub interrupt: &'a AtomicBool,
}

/// The first failure of several outcomes, in the order in which they came about; the others are logged.
///
/// # Errors
/// The first failure.
pub(super) fn first_failure(outcomes: impl IntoIterator<Item = Result<()>>) -> Result<()> {
    let mut first = Ok(());
    for next in outcomes {
        match (&first, next) {
            (Ok(()), next) => first = next,
            (Err(_), Err(later)) => tracing::error!("after the first failure: {later:#}"),
            (Err(_), Ok(())) => {}
        }
    }
    first
}

/// Arms that are switched on: on every way out, a panic included, they are stopped.
pub(super) struct Enabled<'a, M: Mover> {
    mover: &'a mut M,
    is_stopped: bool,
}

impl<'a, M: Mover> Enabled<'a, M> {
    /// Switches both arms on, unless the course is interrupted meanwhile.
    ///
    /// # Errors
    /// As [`Mover::enable`]; both are stopped then.
    pub fn new(course: &Course<'_>, mover: &'a mut M) -> Result<Self> {
        let enabled = Self { mover, is_stopped: false };
        let mut next = course.clock.now();
        while !enabled.mover.enable()? && !course.interrupt.load(Ordering::SeqCst) {
            // A cycle whose time has passed is left out.
            next = (next + course.setup.control_period).max(course.clock.now());
            course.clock.sleep_until(next);
        }
        Ok(enabled)
    }

    /// What moves them.
    pub fn mover(&mut self) -> &mut M {
        self.mover
    }

    /// Stops both.
    ///
    /// # Errors
    /// As [`Mover::stop`].
    pub fn stop(mut self) -> Result<()> {
        self.is_stopped = true;
        self.mover.stop()
    }
}

impl<M: Mover> Drop for Enabled<'_, M> {
    fn drop(&mut self) {
        if !self.is_stopped {
            self.mover.stop().ok();
        }
    }
}
