//! A run: the hand follows the target through its experiment; everything is recorded together with the true poses.

use std::path::Path;
use std::time::Duration;

use anyhow::{Result, anyhow, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_setup::setup::Setup;

use super::capturing::Captured;
use super::cell::SimulatedCell;
use super::channels::Plan;
use super::cycles::CycleSummary;
use super::flight::{FaultWatch, KeepFlights};
use super::halves::{Capture, Course, Estimate, Parted, Record, first_failure};
use super::journal::{Journal, Outcome, TruePoses};
use super::log::RunLog;
use super::looking::{Estimating, Looking};
use super::moving::{Moved, Moving};
use super::noting::EstimateRecorder;
use super::parts::Parts;
use super::percept::Percept;
use super::spectator::{RunEnd, RunRecorder, Spectator};
use super::strip::Strip;
use crate::noting::PairEstimate;

/// Longest run led by a console operator, seconds: the record stays in memory until `quit` or until this time.
pub const LED_BY_PERSON_MAX_S: f64 = 3600.0;

/// A finished run.
pub struct Ended {
    /// Everything recorded until its end.
    pub outcome: Outcome,
    /// The failure that ended the run early, if there is one.
    pub how: Result<()>,
    /// Number of faults during the run whose flight recorder files exist; the failure that ended the run is not among them.
    pub faults: usize,
}

/// As [`conduct`], but a failure discards the outcome.
///
/// # Errors
/// If an arm, the camera or the estimator fails permanently; the arms are stopped first.
pub fn run(setup: &Setup, parts: Parts, stop_after_s: Option<f64>, record: Option<&Path>) -> Result<Outcome> {
    let Ended { outcome, how, .. } = conduct(setup, parts, stop_after_s, record)?;
    how.map(|()| outcome)
}

/// Runs the experiment to its end, or to `stop_after_s`, in the loop for the pace of the setup. If `record` is given, its pairs are also
/// recorded in that folder. The experiment begins when both arms are enabled; both are stopped on every exit path. With a console operator,
/// the target moves from the command `start` on, and neither a stop nor a latched fault ends the run.
///
/// # Errors
/// Refusals before an arm is enabled.
pub fn conduct(setup: &Setup, parts: Parts, stop_after_s: Option<f64>, record: Option<&Path>) -> Result<Ended> {
    if !setup.is_emulated() && !parts.operator.can_fall_silent() {
        bail!(
            "arms that are not emulated need an operator whose silence is noticed: use --operator console, or --move"
        );
    }
    // Everything that can be refused is created before an arm is enabled.
    let Parts { clock, camera, vs, tc, cell, experiment, marking, links, emulated, keep_flights, .. } = parts;
    let (operator, interrupt) = (parts.operator, parts.interrupt);
    let (spectator, recorder, selections) = (parts.spectator, parts.recorder, parts.selections);
    // With a console operator, the operator decides when the moves begin.
    let (duration_s, marks) = match operator.is_person() {
        true => (LED_BY_PERSON_MAX_S, Vec::new()),
        false => (experiment.duration_s(), experiment.marks().to_vec()),
    };
    let log = RunLog { marks, ..RunLog::default() };
    let strip = Strip::of(setup.experiment.moments(&log.marks));
    let now = clock.now();
    let looking = Looking::new(setup, (camera, cell.clone(), marking), (strip, &clock), record)?
        .with_selections(selections)
        .with_controls(parts.camera_controls);
    let is_alone = operator.is_nobody();
    let mut moving = Moving::new(setup, (vs, tc), &*experiment, now)?.with_operator(operator);
    let ends_s = stop_after_s.map_or(duration_s, |s| s.clamp(0.0, duration_s));
    let plan = Plan::of(&setup.experiment.motion, &*experiment);
    let journal = Journal::new(setup, (now, ends_s), (log, plan)).without_console(is_alone);
    let faults = FaultWatch::default();
    let mut watching = Watching { looking, journal, cell, spectator, faults, keep_flights, recorder };
    let course = Course { setup, clock: &clock, duration: Duration::from_secs_f64(ends_s), interrupt: &interrupt };
    let (how, punctuality) = course.run(&mut watching, &mut moving);
    let recorded = watching.looking.noting.finish_recording();
    let end = RunEnd {
        pairs_lost: watching.looking.capturing.pairs_lost(),
        commands: moving.arms().commands().into(),
        failure: how.as_ref().err().map(|failure| format!("{failure:#}")),
    };
    let kept = watching.recorder.take().map_or(Ok(()), |recorder| recorder.finish(&end));
    let how = first_failure([how, recorded, kept]);
    let (steps_untrue, faults) = (watching.journal.steps_untrue(), watching.faults.faults());
    let mut outcome = watching.journal.finish(watching.looking.finish(), end.commands);
    let replies_missed = moving.arms().replies_missed();
    if let Some(mut punctuality) = punctuality {
        punctuality.recording.dropped += steps_untrue;
        outcome.log.cycles.extend(punctuality.summaries(setup, replies_missed));
    }
    let links = links.iter().map(|(name, monitor)| CycleSummary::of_link(name, &**monitor));
    outcome.log.cycles.extend(links);
    // The arms are dropped before the emulators at the other end of their links.
    drop(moving);
    drop(emulated);
    Ok(Ended { outcome, how, faults })
}

/// The vision half of a run, with its recording.
struct Watching<'a> {
    looking: Looking<'a>,
    journal: Journal,
    cell: SimulatedCell,
    spectator: Option<Box<dyn Spectator>>,
    faults: FaultWatch,
    keep_flights: KeepFlights,
    recorder: Option<Box<dyn RunRecorder>>,
}

impl Parted for Watching<'_> {
    type Step = Moved;
    type Frame = Captured;
    type Observed = PairEstimate;

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.cell.begin_at(begin);
        self.looking.begin_at(begin);
        self.journal.begin_at(begin);
        if let Some(recorder) = &mut self.recorder {
            recorder.begin_at(begin);
        }
    }

    fn parts(
        &mut self,
    ) -> (
        impl Capture<Frame = Captured>,
        impl Estimate<Frame = Captured, Observed = PairEstimate, Step = Moved>,
        impl Record<Observed = PairEstimate, Step = Moved>,
    ) {
        let Looking { capturing, estimating, noting } = &mut self.looking;
        let Self { journal, cell, spectator, faults, keep_flights, recorder, .. } = self;
        (capturing, Leading(estimating), Keeping { noting, journal, cell, spectator, faults, keep_flights, recorder })
    }
}

/// The method that leads the hand.
struct Leading<'w, 'a>(&'w mut Estimating<'a>);

impl Estimate for Leading<'_, '_> {
    type Frame = Captured;
    type Observed = PairEstimate;
    type Step = Moved;

    fn moved(&mut self, step: &Moved) {
        self.0.push_joints(step.vs_joints);
    }

    fn take_selection(&mut self) {
        self.0.take_selection();
    }

    fn look(&mut self, frame: Captured) -> Result<(Percept, PairEstimate)> {
        let seen = self.0.look(frame)?;
        Ok((seen.percept(), seen))
    }
}

/// The recording part.
struct Keeping<'w, 'a> {
    noting: &'w mut EstimateRecorder<'a>,
    journal: &'w mut Journal,
    cell: &'w SimulatedCell,
    spectator: &'w mut Option<Box<dyn Spectator>>,
    faults: &'w mut FaultWatch,
    keep_flights: &'w mut KeepFlights,
    recorder: &'w mut Option<Box<dyn RunRecorder>>,
}

impl Record for Keeping<'_, '_> {
    type Observed = PairEstimate;
    type Step = Moved;

    fn moved(&mut self, step: &Moved) {
        let poses = TruePoses::at(self.cell, step.at);
        self.journal.note(step, poses);
        if let Some(recorder) = self.recorder {
            recorder.moved(step, poses);
        }
        if let Some(spectator) = self.spectator {
            spectator.moved(step);
        }
        if let Some(number) = self.faults.due(step.at, &step.decision) {
            (self.keep_flights)(number, &anyhow!(self.journal.words(&step.decision.why)));
            if let Some(recorder) = self.recorder {
                recorder.fault(number);
            }
        }
    }

    fn note(&mut self, seen: PairEstimate) -> Result<()> {
        if let Some(spectator) = self.spectator {
            spectator.seen(&seen);
        }
        if let Some(recorder) = self.recorder {
            recorder.seen(&seen);
        }
        self.noting.note(&seen)
    }
}
