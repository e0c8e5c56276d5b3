//! Interfaces of the vision half and the motion half of a run. Neither depends on the loop that steps them, in simulated time or in real
//! time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Clock, JointState};
use pb3dp_setup::setup::Setup;

use super::percept::Percept;
use super::perception::Captured;

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

/// Captures frames: the first part of the half that processes images.
pub trait Capture: Send {
    /// Waits for the next frame; `None` if no frame arrived.
    ///
    /// # Errors
    /// If no more frames can arrive.
    fn capture(&mut self) -> Result<Option<Captured>>;

    /// In simulated time: waits for the end of the next exposure and keeps what the frame depends on, so that the next
    /// [`Self::capture`] gives the same frame whatever moves meanwhile. Returns whether the camera can do so.
    fn expose(&mut self) -> bool {
        false
    }
}

/// Estimates the target pose from frames; `S` is the record of a control step.
pub trait Estimate<S>: Send {
    /// The estimate, to be recorded.
    type Observed: Send;

    /// Sets the time of the first control step.
    fn begin_at(&mut self, _begin: MonotonicTime) {}

    /// Receives a finished control step.
    fn moved(&mut self, step: &S);

    /// Keeps what the operator has selected so far for the next [`Self::look`]. To be called before each.
    fn take_selection(&mut self) {}

    /// Estimates from a frame: the input of the motion half, if it gets any, and the estimate to be recorded.
    ///
    /// # Errors
    /// If the method fails permanently.
    fn look(&mut self, frame: Captured) -> Result<(Option<Percept>, Self::Observed)>;
}

/// Record of a control step with the joints that the estimation needs.
pub trait CameraArmStep {
    /// Measured joints of the arm that carries the cameras, after the step.
    fn camera_arm_joints(&self) -> &JointState;
}

impl CameraArmStep for JointState {
    fn camera_arm_joints(&self) -> &JointState {
        self
    }
}

/// Records control steps `S` and estimates `O`; `()` records nothing.
pub trait Record<S, O> {
    /// Sets the time of the first control step.
    fn begin_at(&mut self, _begin: MonotonicTime) {}

    /// Receives a finished control step.
    fn moved(&mut self, _step: &S) {}

    /// Records the estimate from a frame; the motion half has it already.
    ///
    /// # Errors
    /// If the record cannot be written.
    fn note(&mut self, _observed: O) -> Result<()> {
        Ok(())
    }
}

impl<S, O> Record<S, O> for () {}

/// The three parts of the half that processes images; each may have a thread of its own.
pub type VisionParts<'a, C, E, R> = (&'a mut C, &'a mut E, &'a mut R);

/// Duration and clock of a run of both halves.
pub struct RunContext<'a> {
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
    pub fn new(run_context: &RunContext<'_>, mover: &'a mut M) -> Result<Self> {
        let enabled = Self { mover, is_stopped: false };
        let mut next = run_context.clock.now();
        while !enabled.mover.enable()? && !run_context.interrupt.load(Ordering::SeqCst) {
            // A cycle whose time has passed is skipped.
            next = (next + run_context.setup.control_period).max(run_context.clock.now());
            run_context.clock.sleep_until(next);
        }
        Ok(enabled)
    }

    /// Sets the time of the first control step, which is now, in all parts.
    pub fn begin<E: Estimate<M::Step>, R: Record<M::Step, E::Observed>>(
        &mut self,
        clock: &dyn Clock,
        (estimator, recorder): (&mut E, &mut R),
    ) -> MonotonicTime {
        let begin = clock.now();
        estimator.begin_at(begin);
        recorder.begin_at(begin);
        self.mover.begin_at(begin);
        begin
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
