//! The real-time loop: capture, estimation, control and recording have one thread each.
//!
//! The control thread steps both arms at fixed times and waits only for the arms. It reads the newest estimate from a slot, and its steps
//! go into rings of fixed size. No end of these ever waits, locks or allocates, so a slow estimate only arrives late. With arms behind a
//! link, the control thread shares no lock with image processing. Joints simulated in process (`mock`) are shared with the cameras.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{Builder, Scope, ScopedJoinHandle};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::realtime::{Realtime, enter};
use rtrb::{Consumer, Producer, RingBuffer};

use super::capturing::Captured;
use super::cycles::{Punctuality, ThreadTiming};
use super::halves::{Capture, Enabled, Estimate, Mover, Record, RunContext, VisionParts, first_failure};
use super::handover::{LatestConsumer, LatestProducer, Newest, latest};
use super::percept::Percept;

/// Steps that are not consumed yet: two seconds at 500 Hz.
const STEPS_MAX: usize = 1000;
/// Pairs, with their images, that wait for recording: half a second of them.
const ESTIMATES_MAX: usize = 16;
/// Interval at which waiting threads check whether the course is over.
const LOOK: Duration = Duration::from_millis(10);
/// Real-time request of a thread that moves arms: a priority below that of the arm threads, which have 50.
pub const CONTROL_THREAD: Realtime = Realtime { priority: Some(40), locks_memory: false, cpu: None };

/// Steps both halves from the time when both arms are enabled; both are stopped on every exit path. The calling thread is the recording
/// thread.
///
/// # Errors
/// The first permanent failure of an arm, the camera, the estimator or the recording.
pub(super) fn drive<M: Mover, C: Capture, E: Estimate<M::Step>, R: Record<M::Step, E::Observed>>(
    run_context: &RunContext<'_>,
    (camera, estimator, recorder): VisionParts<'_, C, E, R>,
    mover: &mut M,
    punctuality: &mut Punctuality,
) -> Result<()> {
    let mut enabled = Enabled::new(run_context, mover)?;
    let begin = enabled.begin(&**run_context.clock, (estimator, recorder));
    let Punctuality { capture, estimation, control, recording } = punctuality;
    // An interruption sets the same flag as the end of the course.
    let (clock, is_over) = (&**run_context.clock, run_context.interrupt);
    let frames = Newest::default();
    let (give_percept, percepts) = latest();
    let (to_estimation, of_estimation) = RingBuffer::new(STEPS_MAX);
    let (to_recording, of_recording) = RingBuffer::new(STEPS_MAX);
    let (give_estimates, estimates) = sync_channel(ESTIMATES_MAX);
    let driving = Driving { run_context, enabled, percepts, steps: [to_estimation, to_recording], timing: control };
    let capturing = Capturing {
        camera,
        exposure: run_context.setup.rig.frames.exposure,
        frames: &frames,
        clock,
        is_over,
        timing: capture,
    };
    let (steps, timing) = (of_estimation, estimation);
    let estimating = Estimating {
        estimator,
        frames: &frames,
        steps,
        percepts: give_percept,
        estimates: give_estimates,
        clock,
        is_over,
        timing,
    };
    let mut recording = Recording { recorder, steps: of_recording, estimates, clock, is_over, timing: recording };
    let (moved, captured, estimated, recorded) = std::thread::scope(|scope| {
        // When a thread ends for any reason, all others end, and the arms are stopped.
        let over = Over(is_over);
        let control = spawn(scope, "control", || driving.run(begin));
        let capture = spawn(scope, "capture", || capturing.run());
        let estimation = spawn(scope, "estimation", || estimating.run());
        let has_begun = control.is_ok() && capture.is_ok() && estimation.is_ok();
        let recorded = if has_begun { recording.run() } else { Ok(()) };
        drop(over);
        (join("control", control), join("capture", capture), join("estimation", estimation), recorded)
    });
    let recorded = recorded.and_then(|()| recording.finish());
    let (stepped, stopped) = moved.unwrap_or_else(|failure| (Err(failure), Ok(())));
    // The outcome of the stop comes after all other failures.
    first_failure([stepped, captured.flatten(), estimated.flatten(), recorded, stopped])
}

fn spawn<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    name: &str,
    work: impl FnOnce() -> T + Send + 'scope,
) -> Result<ScopedJoinHandle<'scope, T>> {
    Builder::new().name(name.to_owned()).spawn_scoped(scope, work).with_context(|| format!("no thread for {name}"))
}

fn join<T>(name: &str, thread: Result<ScopedJoinHandle<'_, T>>) -> Result<T> {
    thread?.join().map_err(|_| anyhow!("the {name} thread panicked: this is a bug, please report it"))
}

/// Gives this thread the real-time settings of a control thread; logs those that are unavailable and continues.
pub fn enter_control_thread() {
    for shortfall in enter(&CONTROL_THREAD) {
        tracing::warn!("control loop: {shortfall}");
    }
}

/// Sets the end flag of the course when it is dropped.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// The capture thread: of unread frames only the newest one is kept.
struct Capturing<'a, C> {
    camera: &'a mut C,
    exposure: Duration,
    /// Each frame with its arrival time.
    frames: &'a Newest<(MonotonicTime, Captured)>,
    clock: &'a dyn Clock,
    is_over: &'a AtomicBool,
    timing: &'a mut ThreadTiming,
}

impl<C: Capture> Capturing<'_, C> {
    fn run(self) -> Result<()> {
        let _over = Over(self.is_over);
        let mut before = None;
        while !self.is_over.load(Ordering::SeqCst) {
            let Some(frame) = self.camera.capture()? else { continue };
            let (now, input) = (self.clock.now(), frame.frame);
            self.timing.lateness.record(now.saturating_since(input.at + self.exposure / 2));
            // A gap in the sequence numbers counts the frames that did not arrive.
            let since = before.replace(input.sequence).and_then(|before: u64| input.sequence.checked_sub(before));
            self.timing.missed += since.map_or(0, |since| since.saturating_sub(1));
            self.timing.dropped += u64::from(self.frames.give((now, frame)));
        }
        Ok(())
    }
}

/// The estimation thread; it uses the newest frame.
struct Estimating<'a, E: Estimate<S>, S> {
    estimator: &'a mut E,
    frames: &'a Newest<(MonotonicTime, Captured)>,
    steps: Consumer<S>,
    percepts: LatestProducer<Percept>,
    estimates: SyncSender<(MonotonicTime, E::Observed)>,
    clock: &'a dyn Clock,
    is_over: &'a AtomicBool,
    timing: &'a mut ThreadTiming,
}

impl<E: Estimate<S>, S> Estimating<'_, E, S> {
    fn run(mut self) -> Result<()> {
        let _over = Over(self.is_over);
        while !self.is_over.load(Ordering::SeqCst) {
            let frame = self.frames.wait(LOOK);
            while let Ok(step) = self.steps.pop() {
                self.estimator.moved(&step);
            }
            let Some((captured_at, frame)) = frame else { continue };
            self.estimator.take_selection();
            let (percept, estimates) = self.estimator.look(frame)?;
            // A percept contains all current information: an overwritten one loses only an observation.
            self.timing.dropped += u64::from(percept.is_some_and(|percept| self.percepts.give(percept)));
            let now = self.clock.now();
            self.timing.lateness.record(now.saturating_since(captured_at));
            self.timing.dropped += u64::from(self.estimates.try_send((now, estimates)).is_err());
        }
        Ok(())
    }
}

/// The recording thread; no other thread waits for it.
struct Recording<'a, R, S, O> {
    recorder: &'a mut R,
    steps: Consumer<S>,
    estimates: Receiver<(MonotonicTime, O)>,
    clock: &'a dyn Clock,
    is_over: &'a AtomicBool,
    timing: &'a mut ThreadTiming,
}

impl<R: Record<S, O>, S, O> Recording<'_, R, S, O> {
    fn run(&mut self) -> Result<()> {
        let _over = Over(self.is_over);
        while !self.is_over.load(Ordering::SeqCst) {
            self.take_steps();
            match self.estimates.recv_timeout(LOOK) {
                Ok(estimates) => self.note(estimates)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        Ok(())
    }

    /// Records the remaining items.
    fn finish(&mut self) -> Result<()> {
        self.take_steps();
        while let Ok(estimates) = self.estimates.try_recv() {
            self.note(estimates)?;
        }
        Ok(())
    }

    fn take_steps(&mut self) {
        while let Ok(step) = self.steps.pop() {
            self.recorder.moved(&step);
        }
    }

    fn note(&mut self, (estimated_at, estimates): (MonotonicTime, O)) -> Result<()> {
        self.recorder.note(estimates)?;
        self.timing.lateness.record(self.clock.now().saturating_since(estimated_at));
        Ok(())
    }
}

/// The control thread.
struct Driving<'a, M: Mover> {
    run_context: &'a RunContext<'a>,
    enabled: Enabled<'a, M>,
    percepts: LatestConsumer<Percept>,
    /// To the estimation thread and to the recording thread.
    steps: [Producer<M::Step>; 2],
    timing: &'a mut ThreadTiming,
}

impl<M: Mover> Driving<'_, M> {
    /// Steps until the end, then stops both arms; also if a step fails or another thread has ended. Returns the outcome of the steps and
    /// that of the stop.
    fn run(mut self, begin: MonotonicTime) -> (Result<()>, Result<()>) {
        enter_control_thread();
        let _over = Over(self.run_context.interrupt);
        let stepped = self.step_from(begin);
        (stepped, self.enabled.stop())
    }

    fn step_from(&mut self, begin: MonotonicTime) -> Result<()> {
        let &RunContext { setup, clock, duration, interrupt } = self.run_context;
        let (mut due, end, period) = (begin, begin + duration, setup.control_period);
        while due <= end && !interrupt.load(Ordering::SeqCst) {
            clock.sleep_until(due);
            let now = clock.now();
            self.timing.lateness.record(now.saturating_since(due));
            if let Some(percept) = self.percepts.take() {
                self.enabled.mover().observe(percept, now);
            }
            let step = self.enabled.mover().step(now)?;
            // Steps that are not consumed are missing only in the report and in the priors of estimates.
            let taken = self.steps.each_mut().map(|steps| steps.push(step).is_ok());
            self.timing.dropped += u64::from(taken != [true; 2]);
            due = due + period;
            // Times that have passed are skipped.
            while due + period <= clock.now() {
                due = due + period;
                self.timing.missed += 1;
            }
        }
        Ok(())
    }
}
