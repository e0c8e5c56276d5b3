//! A simulated run that its caller steps: the loop of a run, which waits after each control step.
//!
//! The run has a thread of its own and is the same, to the bit, as one that is not stepped: it waits where nothing depends on the clock of
//! the computer. The caller sees each step with the true poses, and may change how the hand shall move and where the target is pushed.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::{Result, anyhow, bail};
use nalgebra::Vector3;
use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Decision, OperatorInput};
use pb3dp_setup::setup::{Pace, Setup};
use pb3dp_sim::pushed::PushedTarget;

use crate::estimate_log::PairEstimate;
use crate::experiment::{Ended, conduct};
use crate::journal::{Outcome, TruePoses};
use crate::moving::StepRecord;
use crate::operator::{ByCommand, MotionRequest, Operator};
use crate::parts::Parts;
use crate::spectator::Spectator;

/// A finished control step.
pub struct SteppedStep {
    /// Time of the first control step.
    pub begin: MonotonicTime,
    /// The step.
    pub moved: StepRecord,
    /// True poses at its begin.
    pub poses: Option<TruePoses>,
    /// Pairs that were estimated since the step before.
    pub estimates: Vec<PairEstimate>,
}

/// A simulated run that waits after each control step.
pub struct SteppedRun {
    steps: Receiver<SteppedStep>,
    /// Lets the run go on; `None` once the run is to end.
    go: Option<SyncSender<()>>,
    /// Whether the run waits after a step.
    is_waiting: bool,
    thread: Option<JoinHandle<Result<Ended>>>,
    requests: Arc<Mutex<MotionRequest>>,
    pushed: Option<PushedTarget>,
}

impl SteppedRun {
    /// Starts a run of these parts, with the operator of a command, up to the end of its first control step.
    ///
    /// # Errors
    /// Arms or cameras that are not simulated in this program, and a pace other than `fast`.
    pub fn start(setup: Setup, parts: Parts, stop_after_s: Option<f64>) -> Result<Self> {
        check_simulated(&setup)?;
        if setup.pace != Pace::Fast {
            bail!("a stepped run has simulated time: set run.pace=fast");
        }
        let (tell, steps) = sync_channel(1);
        let (go, waits) = sync_channel(1);
        let requests = Arc::new(Mutex::new(MotionRequest::default()));
        let pushed = parts.pushed.clone();
        let interrupt = Arc::clone(&parts.interrupt);
        let stepper = Stepper { tell, waits, interrupt, begin: MonotonicTime::ZERO, estimates: Vec::new() };
        let operator = Box::new(ByCaller(Arc::clone(&requests)));
        let parts = Parts { operator, spectators: vec![Box::new(stepper)], ..parts };
        let thread = std::thread::Builder::new()
            .name("stepped run".to_owned())
            .spawn(move || conduct(&setup, parts, stop_after_s, None))?;
        Ok(Self { steps, go: Some(go), is_waiting: false, thread: Some(thread), requests, pushed })
    }

    /// The next control step; `None` after the last one.
    ///
    /// # Errors
    /// The failure that ended the run.
    pub fn step(&mut self) -> Result<Option<SteppedStep>> {
        if self.is_waiting
            && let Some(go) = &self.go
        {
            // A run that has ended receives nothing; its result follows.
            let _ = go.send(());
        }
        self.is_waiting = false;
        if let Ok(step) = self.steps.recv() {
            self.is_waiting = true;
            return Ok(Some(step));
        }
        self.end().map(|_| None)
    }

    /// How the hand moves from the next step on.
    pub fn set_motion(&self, motion: MotionRequest) {
        *self.requests.lock().unwrap_or_else(PoisonError::into_inner) = motion;
    }

    /// How the hand moves.
    pub fn motion(&self) -> MotionRequest {
        *self.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Pushes the target to an offset from its start, as [`PushedTarget::push`].
    ///
    /// # Errors
    /// A target that follows a motion of the setup.
    pub fn push_target(&self, offset_m: Vector3<f64>, turn_rad: f64) -> Result<()> {
        let Some(pushed) = &self.pushed else {
            bail!("the target of this setup follows its own motion: set experiment.target=pushed");
        };
        pushed.push(offset_m, turn_rad);
        Ok(())
    }

    /// Ends the run now; returns what was recorded, or nothing if it had ended before.
    ///
    /// # Errors
    /// The failure that ended the run.
    pub fn end(&mut self) -> Result<Option<Outcome>> {
        self.go = None;
        // The last step may still be on its way.
        while self.steps.recv().is_ok() {}
        let Some(thread) = self.thread.take() else { return Ok(None) };
        let Ended { outcome, how, .. } =
            thread.join().map_err(|_| anyhow!("bug: the run has panicked, report it"))??;
        how.map(|()| Some(outcome))
    }
}

impl Drop for SteppedRun {
    fn drop(&mut self) {
        // Its failure was of interest to `step` only.
        let _ = self.end();
    }
}

/// Refuses a setup in which anything outside this program moves or sees.
///
/// # Errors
/// The arms or cameras that are not simulated.
pub fn check_simulated(setup: &Setup) -> Result<()> {
    if !setup.is_emulated() {
        bail!(
            "the setup has arms that are not simulated in this program: here only simulated ones may move; use pb3dp run"
        );
    }
    if setup.rig.real_cameras.is_some() || setup.world.is_none() {
        bail!("the setup has real cameras: here only simulated ones can be used; use pb3dp run");
    }
    Ok(())
}

/// Receives what the run records, and waits after each step.
struct Stepper {
    tell: SyncSender<SteppedStep>,
    waits: Receiver<()>,
    interrupt: Arc<AtomicBool>,
    begin: MonotonicTime,
    estimates: Vec<PairEstimate>,
}

impl Spectator for Stepper {
    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
    }

    fn moved(&mut self, step: &StepRecord, poses: Option<TruePoses>) {
        let estimates = std::mem::take(&mut self.estimates);
        let step = SteppedStep { begin: self.begin, moved: *step, poses, estimates };
        if self.tell.send(step).is_err() || self.waits.recv().is_err() {
            self.interrupt.store(true, Ordering::SeqCst);
        }
    }

    fn estimated(&mut self, pair_estimate: &PairEstimate) {
        self.estimates.push(pair_estimate.clone());
    }
}

/// The operator of a command, with a caller who states how the hand moves.
struct ByCaller(Arc<Mutex<MotionRequest>>);

impl Operator for ByCaller {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        ByCommand.listen(last, now)
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, trouble: Option<String>) {
        if let Some(trouble) = trouble {
            tracing::warn!("{trouble}");
        }
    }

    fn motion(&self) -> MotionRequest {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_person(&self) -> bool {
        false
    }

    fn can_fall_silent(&self) -> bool {
        false
    }
}
