//! The loop in simulated time that keeps to the wall clock: as `lockstep`, but a second thread renders and estimates while control steps go on.
//!
//! The result is the same to the bit. At the end of an exposure the control thread takes everything that the frame depends on: what the
//! cameras show, and what the operator has selected. It waits for the result where the simulated time needs it: at the control step that
//! the result reaches, and before the next frame.

use std::sync::mpsc::{Receiver, Sender, channel};

use anyhow::{Context, Result, anyhow};
use pb3dp_geometry::MonotonicTime;

use super::halves::{Capture, Course, Enabled, Estimate, Mover, Parted, Record, first_failure};
use super::lockstep::{Arriving, Looking, step_both};
use super::percept::Percept;

/// Steps both halves in order of their times, with a second thread for images; both arms are stopped on every exit path.
///
/// # Errors
/// The first permanent failure of an arm, the camera, the estimator or the recording.
pub(super) fn drive<M: Mover, W: Parted<Step = M::Step>>(
    course: &Course<'_>,
    watcher: &mut W,
    mover: &mut M,
) -> Result<()> {
    let mut enabled = Enabled::new(course, mover)?;
    let begin = course.clock.now();
    watcher.begin_at(begin);
    enabled.mover().begin_at(begin);
    let (camera, estimator, recorder) = watcher.parts();
    let (to_thread, of_control) = channel();
    let (to_control, of_thread) = channel();
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name("images".to_owned());
        // With the thread its ends of the channels go, so that nobody waits for a thread that is gone.
        let spawned = thread.spawn_scoped(scope, move || work(of_control, to_control)).context("no thread for images");
        let mut looking = Beside {
            here: Some(VisionParts { camera, estimator }),
            to_thread,
            of_thread,
            due: MonotonicTime::ZERO,
            steps: Vec::new(),
            recorder,
            arriving: Arriving::new(course),
        };
        let stepped = spawned.and_then(|_| step_both(course, &mut looking, enabled.mover(), begin));
        // The arms do not wait for a frame that is still with the other thread; the record does.
        let stopped = enabled.stop();
        first_failure([stepped, looking.parts().map(drop), stopped])
    })
}

/// The parts that one thread at a time has.
struct VisionParts<C, E> {
    camera: C,
    estimator: E,
}

impl<C: Capture, E: Estimate<Frame = C::Frame>> VisionParts<C, E> {
    /// The result for this frame, or for the one to be captured; `None` if no frame arrived.
    fn look(&mut self, frame: Option<C::Frame>) -> Result<Option<(Percept, E::Observed)>> {
        let frame = match frame {
            Some(frame) => Some(frame),
            None => self.camera.capture()?,
        };
        frame.map(|frame| self.estimator.look(frame)).transpose()
    }
}

/// A frame to be processed, if it is captured already, and what came of it, each with the parts.
type Task<C, E> = (VisionParts<C, E>, Option<<C as Capture>::Frame>);
type Done<C, E> = (VisionParts<C, E>, Result<Option<(Percept, <E as Estimate>::Observed)>>);

/// Processes frames until there are no more.
#[allow(clippy::needless_pass_by_value, reason = "its ends of the channels go with it")]
fn work<C: Capture, E: Estimate<Frame = C::Frame>>(tasks: Receiver<Task<C, E>>, done: Sender<Done<C, E>>) {
    while let Ok((mut parts, frame)) = tasks.recv() {
        let found = parts.look(frame);
        if done.send((parts, found)).is_err() {
            return;
        }
    }
}

struct Beside<'a, C: Capture, E: Estimate, R> {
    /// `None` while the other thread has them.
    here: Option<VisionParts<C, E>>,
    to_thread: Sender<Task<C, E>>,
    of_thread: Receiver<Done<C, E>>,
    /// When the result of the other thread reaches the motion half.
    due: MonotonicTime,
    /// Steps that the estimator has not received yet.
    steps: Vec<E::Step>,
    recorder: R,
    arriving: Arriving<'a>,
}

impl<C, E, R> Beside<'_, C, E, R>
where
    C: Capture,
    E: Estimate<Frame = C::Frame, Step: Copy>,
    R: Record<Observed = E::Observed, Step = E::Step>,
{
    /// The parts, after the result of the last frame.
    fn parts(&mut self) -> Result<&mut VisionParts<C, E>> {
        if self.here.is_none() {
            let (mut parts, found) = self.of_thread.recv().map_err(|_| thread_is_gone())?;
            self.steps.drain(..).for_each(|step| parts.estimator.moved(&step));
            self.here = Some(parts);
            if let Some((percept, seen)) = found? {
                self.arriving.push(self.due, percept);
                self.recorder.note(seen)?;
            }
        }
        self.here.as_mut().ok_or_else(thread_is_gone)
    }
}

fn thread_is_gone() -> anyhow::Error {
    anyhow!("the images thread panicked: this is a bug, please report it")
}

impl<C, E, R> Looking for Beside<'_, C, E, R>
where
    C: Capture,
    E: Estimate<Frame = C::Frame, Step: Copy>,
    R: Record<Observed = E::Observed, Step = E::Step>,
{
    type Step = E::Step;

    fn moved(&mut self, step: &E::Step) {
        match &mut self.here {
            Some(parts) => parts.estimator.moved(step),
            None => self.steps.push(*step),
        }
        self.recorder.moved(step);
    }

    fn frame(&mut self) -> Result<()> {
        let parts = self.parts()?;
        parts.estimator.take_selection();
        let frame = match parts.camera.expose() {
            true => None,
            // This camera captures at once; what it cannot deliver is no frame.
            false => match parts.camera.capture()? {
                Some(frame) => Some(frame),
                None => return Ok(()),
            },
        };
        self.due = self.arriving.due();
        let Some(parts) = self.here.take() else { return Err(thread_is_gone()) };
        self.to_thread.send((parts, frame)).map_err(|_| thread_is_gone())
    }

    fn arrived(&mut self, by: MonotonicTime) -> Result<Option<Percept>> {
        if self.here.is_none() && self.due <= by {
            self.parts()?;
        }
        Ok(self.arriving.pop(by))
    }
}
