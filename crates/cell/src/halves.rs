//! Interfaces of the vision half and the motion half of a run. Neither depends on the loop that steps them, in simulated time or in real
//! time.

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
    /// Record of a control step.
    type Step: Copy + Send;

    /// Enables both arms step by step; returns whether they are enabled. Call it in each control cycle until then.
    ///
    /// # Errors
    /// The arm that cannot be enabled, and the cause; the other arm may be enabled.
    fn enable(&mut self) -> Result<bool>;

    /// Sets the time of the first control step.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// Receives the newest result for the target; the control step at `now` is the first one to use it.
    fn observe(&mut self, percept: Percept, now: MonotonicTime);

    /// One control step of both arms.
    ///
    /// # Errors
    /// The cause for which both arms must be stopped.
    fn step(&mut self, now: MonotonicTime) -> Result<Self::Step>;

    /// Stops both arms and closes their brakes, in any state.
    ///
    /// # Errors
    /// The arm that cannot be commanded.
    fn stop(&mut self) -> Result<()>;
}

/// The half that processes images.
pub trait Watcher {
    /// Record of a control step.
    type Step: Copy + Send;

    /// Sets the time of the first control step.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// Receives a finished control step.
    fn moved(&mut self, step: &Self::Step);

    /// Waits for the next pair and estimates the target pose; `None` if no pair arrived.
    ///
    /// # Errors
    /// If no more pairs can arrive.
    fn look(&mut self) -> Result<Option<Percept>>;

    /// Records the last estimate; the motion half has it already.
    ///
    /// # Errors
    /// If the record cannot be written.
    fn note(&mut self) -> Result<()>;
}

/// A vision half whose three parts can have one thread each.
pub trait Parted {
    /// Record of a control step.
    type Step: Copy + Send;
    /// A captured frame.
    type Frame: Send;
    /// The estimate from a frame.
    type Observed: Send;

    /// Sets the time of the first control step.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// The capture, estimation and recording parts.
    #[allow(clippy::type_complexity, reason = "each part with what it has to go with")]
    fn parts(
        &mut self,
    ) -> (
        impl Capture<Frame = Self::Frame>,
        impl Estimate<Frame = Self::Frame, Observed = Self::Observed, Step = Self::Step>,
        impl Record<Observed = Self::Observed, Step = Self::Step>,
    );
}

/// Captures frames.
pub trait Capture: Send {
    /// A captured frame.
    type Frame: Send;

    /// Waits for the next frame; `None` if no frame arrived.
    ///
    /// # Errors
    /// If no more frames can arrive.
    fn capture(&mut self) -> Result<Option<Self::Frame>>;

    /// In simulated time: waits for the end of the next exposure and keeps what the frame depends on, so that the next
    /// [`Self::capture`] gives the same frame whatever moves meanwhile. Returns whether the camera can do so.
    fn expose(&mut self) -> bool {
        false
    }

    /// Sequence number and times of a frame.
    fn input(frame: &Self::Frame) -> FrameInput;
}

/// Estimates the target pose from frames.
pub trait Estimate: Send {
    /// A captured frame.
    type Frame;
    /// The estimate, to be recorded.
    type Observed;
    /// Record of a control step.
    type Step;

    /// Receives a finished control step.
    fn moved(&mut self, step: &Self::Step);

    /// Keeps what the operator has selected so far for the next [`Self::look`]. To be called before each.
    fn take_selection(&mut self) {}

    /// Estimates from a frame: the input of the motion half, and the estimate to be recorded.
    ///
    /// # Errors
    /// If the method fails permanently.
    fn look(&mut self, frame: Self::Frame) -> Result<(Percept, Self::Observed)>;
}

/// Records estimates and control steps.
pub trait Record {
    /// The estimate from a frame.
    type Observed;
    /// Record of a control step.
    type Step;

    /// Receives a finished control step.
    fn moved(&mut self, step: &Self::Step);

    /// Records the estimate from a frame.
    ///
    /// # Errors
    /// If the record cannot be written.
    fn note(&mut self, seen: Self::Observed) -> Result<()>;
}

impl<C: Capture> Capture for &mut C {
    type Frame = C::Frame;

    fn capture(&mut self) -> Result<Option<C::Frame>> {
        (**self).capture()
    }

    fn expose(&mut self) -> bool {
        (**self).expose()
    }

    fn input(frame: &C::Frame) -> FrameInput {
        C::input(frame)
    }
}

/// Duration and clock of a run of both halves.
pub struct Course<'a> {
    /// Setup, with all periods.
    pub setup: &'a Setup,
    /// The clock.
    pub clock: &'a Arc<dyn Clock>,
    /// From the first control step to the last one.
    pub duration: Duration,
    /// Once set, the course ends early.
    pub interrupt: &'a AtomicBool,
}

/// The first failure of several outcomes, in order of occurrence; the others are logged.
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

/// Enabled arms: they are stopped on every exit path, including a panic.
pub(super) struct Enabled<'a, M: Mover> {
    mover: &'a mut M,
    is_stopped: bool,
}

impl<'a, M: Mover> Enabled<'a, M> {
    /// Enables both arms, unless the course is interrupted meanwhile.
    ///
    /// # Errors
    /// As [`Mover::enable`]; both arms are then stopped.
    pub fn new(course: &Course<'_>, mover: &'a mut M) -> Result<Self> {
        let enabled = Self { mover, is_stopped: false };
        let mut next = course.clock.now();
        while !enabled.mover.enable()? && !course.interrupt.load(Ordering::SeqCst) {
            // A cycle whose time has passed is skipped.
            next = (next + course.setup.control_period).max(course.clock.now());
            course.clock.sleep_until(next);
        }
        Ok(enabled)
    }

    /// The motion half.
    pub fn mover(&mut self) -> &mut M {
        self.mover
    }

    /// Stops both arms.
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
