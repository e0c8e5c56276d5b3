//! A run: the hand follows the target through its experiment; everything is recorded together with the true poses.

use std::path::Path;
use std::time::Duration;

use anyhow::{Result, anyhow, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_setup::setup::Setup;

use super::cell::SimulatedCell;
use super::cycles::CycleSummary;
use super::flight::{FaultWatch, KeepFlights};
use super::halves::{Record, RunContext, first_failure};
use super::journal::{Journal, Outcome, TruePoses};
use super::moving::{Moving, StepRecord};
use super::parts::Parts;
use super::spectator::{RunEnd, Spectator};
use super::vision::Vision;
use crate::estimate_log::PairEstimate;

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
    let led_by = (operator.is_person(), operator.can_fall_silent());
    let duration_s = if led_by.0 { LED_BY_PERSON_MAX_S } else { experiment.duration_s() };
    let ends_s = stop_after_s.map_or(duration_s, |s| s.clamp(0.0, duration_s));
    let now = clock.now();
    let mut journal = Journal::new(setup, &*experiment, led_by, (now, ends_s))?;
    if let Some(folder) = record {
        journal = journal.record_to(folder, marking.clone())?;
    }
    let Vision { mut capturing, estimating } = Vision::new(setup, (camera, cell.clone(), marking), &clock)?;
    let mut estimating = estimating.with_selections(parts.selections).with_controls(parts.camera_controls);
    let mut moving = Moving::new(setup, (vs, tc), &*experiment, now)?.with_operator(operator);
    let mut keeping =
        RunRecords { journal, cell, spectators: parts.spectators, faults: FaultWatch::default(), keep_flights };
    let run_context =
        RunContext { setup, clock: &clock, duration: Duration::from_secs_f64(ends_s), interrupt: &interrupt };
    let (how, punctuality) = run_context.run((&mut capturing, &mut estimating, &mut keeping), &mut moving);
    let RunRecords { mut journal, spectators, faults, .. } = keeping;
    let recorded = journal.finish_recording();
    let end = RunEnd {
        pairs_lost: capturing.pairs_lost(),
        commands: moving.arms().commands().into(),
        failure: how.as_ref().err().map(|failure| format!("{failure:#}")),
    };
    let kept = spectators.into_iter().map(|spectator| spectator.finish(&end));
    let how = first_failure([how, recorded].into_iter().chain(kept));
    let (steps_untrue, faults) = (journal.steps_untrue(), faults.faults());
    let mut outcome = journal.finish(end.pairs_lost, end.commands);
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

/// The recording part of the vision half.
struct RunRecords<'a> {
    journal: Journal<'a>,
    cell: SimulatedCell,
    spectators: Vec<Box<dyn Spectator>>,
    faults: FaultWatch,
    keep_flights: KeepFlights,
}

impl Record<StepRecord, PairEstimate> for RunRecords<'_> {
    fn begin_at(&mut self, begin: MonotonicTime) {
        self.cell.begin_at(begin);
        self.journal.begin_at(begin);
        self.spectators.iter_mut().for_each(|spectator| spectator.begin_at(begin));
    }

    fn moved(&mut self, step: &StepRecord) {
        let poses = TruePoses::at(&self.cell, step.at);
        self.journal.note(step, poses);
        self.spectators.iter_mut().for_each(|spectator| spectator.moved(step, poses));
        if let Some(number) = self.faults.due(step.at, &step.decision) {
            (self.keep_flights)(number, &anyhow!(self.journal.text_of(&step.decision.why)));
            self.spectators.iter_mut().for_each(|spectator| spectator.fault(number));
        }
    }

    fn note(&mut self, pair_estimate: PairEstimate) -> Result<()> {
        self.spectators.iter_mut().for_each(|spectator| spectator.estimated(&pair_estimate));
        self.journal.note_pair(&pair_estimate)
    }
}
