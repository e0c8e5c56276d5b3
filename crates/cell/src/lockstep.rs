//! The loop in simulated time: both halves are stepped by one virtual clock, so that the same seed gives the same run.
//!
//! Two events occur in order of their times: a control step every control period, and a frame when its exposure has ended. An estimate
//! reaches the motion half only `estimate_latency` after the end of its exposure, independent of the speed of this computer.
//!
//! One thread does all the work. In simulated time that keeps to the wall clock, a second one renders and estimates while control steps go
//! on, with the same result to the bit: at the end of an exposure the control thread takes everything that the frame depends on, what the
//! cameras show and what the operator has selected. It waits for the result where the simulated time needs it: at the control step that
//! the result reaches, and before the next frame.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, Scope};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use super::capturing::Captured;
use super::halves::{Capture, Enabled, Estimate, Mover, Record, RunContext, VisionParts, first_failure};
use super::percept::Percept;

/// Steps both halves in order of their times, on request with a second thread for images; both arms are stopped on every exit path.
///
/// # Errors
/// The first permanent failure of an arm, the camera, the estimator or the recording.
pub(super) fn drive<M: Mover, C: Capture, E: Estimate<M::Step>, R: Record<M::Step, E::Observed>>(
    run_context: &RunContext<'_>,
    (camera, estimator, recorder): VisionParts<'_, C, E, R>,
    mover: &mut M,
    has_images_thread: bool,
) -> Result<()> {
    let mut enabled = Enabled::new(run_context, mover)?;
    let begin = enabled.begin(&**run_context.clock, (estimator, recorder));
    std::thread::scope(|scope| {
        let mut vision = Vision {
            here: Some(Images { camera, estimator }),
            thread: None,
            steps: Vec::new(),
            recorder,
            clock: &**run_context.clock,
            latency: run_context.setup.estimate_latency,
            due: MonotonicTime::ZERO,
            arriving: VecDeque::new(),
        };
        let spawned = if has_images_thread { vision.spawn(scope) } else { Ok(()) };
        let stepped = spawned.and_then(|()| step_both(run_context, &mut vision, enabled.mover(), begin));
        // The arms do not wait for a frame that is still with the other thread; the record does.
        let stopped = enabled.stop();
        first_failure([stepped, vision.images().map(drop), stopped])
    })
}

/// Steps both halves from `begin` to the end of the course.
fn step_both<M: Mover, C: Capture, E: Estimate<M::Step>, R: Record<M::Step, E::Observed>>(
    &RunContext { setup, clock, duration, interrupt }: &RunContext<'_>,
    vision: &mut Vision<'_, C, E, R, M::Step>,
    mover: &mut M,
    begin: MonotonicTime,
) -> Result<()> {
    let end = begin + duration;
    let (mut next_control, mut next_frame) = (begin, begin + setup.rig.frames.exposure);
    while next_control.min(next_frame) <= end && !interrupt.load(Ordering::SeqCst) {
        if next_control <= next_frame {
            clock.sleep_until(next_control);
            while let Some(percept) = vision.arrived(next_control)? {
                mover.observe(percept, next_control);
            }
            vision.moved(&mover.step(next_control)?);
            next_control = next_control + setup.control_period;
            // Opening or closing brakes takes time; steps and frames due meanwhile are skipped.
            while next_control < clock.now() {
                next_control = next_control + setup.control_period;
            }
            while next_frame < clock.now() {
                next_frame = next_frame + setup.rig.frames.period;
            }
        } else {
            vision.frame()?;
            next_frame = next_frame + setup.rig.frames.period;
        }
    }
    Ok(())
}

/// The parts that one thread at a time has.
struct Images<'a, C, E> {
    camera: &'a mut C,
    estimator: &'a mut E,
}

/// What came of a frame: the input of the motion half, and the estimate to be recorded; `None` if no frame arrived.
type Found<O> = Option<(Option<Percept>, O)>;

impl<C: Capture, E> Images<'_, C, E> {
    /// The result for this frame, or for the one to be captured.
    fn look<S>(&mut self, frame: Option<Captured>) -> Result<Found<E::Observed>>
    where
        E: Estimate<S>,
    {
        let frame = match frame {
            Some(frame) => Some(frame),
            None => self.camera.capture()?,
        };
        frame.map(|frame| self.estimator.look(frame)).transpose()
    }
}

/// A frame to be processed, if it is captured already, and what came of it, each with the parts.
type Task<'a, C, E> = (Images<'a, C, E>, Option<Captured>);
type Done<'a, C, E, O> = (Images<'a, C, E>, Result<Found<O>>);
/// The ends of the control thread.
type Thread<'a, C, E, O> = (Sender<Task<'a, C, E>>, Receiver<Done<'a, C, E, O>>);

/// The vision half as this loop steps it.
struct Vision<'a, C, E: Estimate<S>, R, S> {
    /// `None` while the other thread has them.
    here: Option<Images<'a, C, E>>,
    /// The thread for images, if there is one.
    thread: Option<Thread<'a, C, E, E::Observed>>,
    /// Steps that the estimator has not received yet.
    steps: Vec<S>,
    recorder: &'a mut R,
    clock: &'a dyn Clock,
    latency: Duration,
    /// When the result of the last frame reaches the motion half.
    due: MonotonicTime,
    /// Results that have not reached the motion half yet, with their arrival times.
    arriving: VecDeque<(MonotonicTime, Percept)>,
}

impl<'a, C: Capture, E: Estimate<S>, R: Record<S, E::Observed>, S: Copy + Send> Vision<'a, C, E, R, S> {
    /// Starts the thread for images.
    fn spawn<'scope>(&mut self, scope: &'scope Scope<'scope, '_>) -> Result<()>
    where
        'a: 'scope,
        S: 'scope,
    {
        let (to_thread, tasks) = channel::<Task<'a, C, E>>();
        let (done, of_thread) = channel();
        // With the thread its ends of the channels go, so that nobody waits for a thread that is gone.
        let work = move || {
            while let Ok((mut images, frame)) = tasks.recv() {
                let found = images.look(frame);
                if done.send((images, found)).is_err() {
                    return;
                }
            }
        };
        Builder::new().name("images".to_owned()).spawn_scoped(scope, work).context("no thread for images")?;
        self.thread = Some((to_thread, of_thread));
        Ok(())
    }

    /// Camera and estimator, after the result of the last frame.
    fn images(&mut self) -> Result<&mut Images<'a, C, E>> {
        if let (None, Some((_, of_thread))) = (&self.here, &self.thread) {
            let (images, found) = of_thread.recv().map_err(|_| thread_is_gone())?;
            self.steps.drain(..).for_each(|step| images.estimator.moved(&step));
            self.here = Some(images);
            self.take(found?)?;
        }
        self.here.as_mut().ok_or_else(thread_is_gone)
    }

    /// Keeps the result of the last frame for the motion half, and records it.
    fn take(&mut self, found: Found<E::Observed>) -> Result<()> {
        let Some((percept, pair_estimate)) = found else { return Ok(()) };
        self.arriving.extend(percept.map(|percept| (self.due, percept)));
        self.recorder.note(pair_estimate)
    }

    /// Receives a finished control step.
    fn moved(&mut self, step: &S) {
        match &mut self.here {
            Some(images) => images.estimator.moved(step),
            None => self.steps.push(*step),
        }
        self.recorder.moved(step);
    }

    /// A frame is due now.
    fn frame(&mut self) -> Result<()> {
        let has_thread = self.thread.is_some();
        let images = self.images()?;
        images.estimator.take_selection();
        let frame = match has_thread && images.camera.expose() {
            true => None,
            // This camera captures at once; what it cannot deliver is no frame.
            false => match images.camera.capture()? {
                Some(frame) => Some(frame),
                None => return Ok(()),
            },
        };
        self.due = self.clock.now() + self.latency;
        match (&self.thread, self.here.take()) {
            (Some((to_thread, _)), Some(images)) => to_thread.send((images, frame)).map_err(|_| thread_is_gone()),
            (_, mut images) => {
                let found = images.as_mut().map_or(Ok(None), |images| images.look(frame));
                self.here = images;
                self.take(found?)
            }
        }
    }

    /// The next result that has reached the motion half by the time `by`.
    fn arrived(&mut self, by: MonotonicTime) -> Result<Option<Percept>> {
        if self.here.is_none() && self.due <= by {
            self.images()?;
        }
        let is_here = self.arriving.front().is_some_and(|(due, _)| *due <= by);
        Ok(if is_here { self.arriving.pop_front().map(|(_, percept)| percept) } else { None })
    }
}

fn thread_is_gone() -> anyhow::Error {
    anyhow!("the images thread panicked: this is a bug, please report it")
}
