//! A run: the hand follows the target through its experiment, and everything is written down beside the truth.

use std::path::Path;
use std::time::Duration;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;

use super::cell::SimulatedCell;
use super::cycles::CycleSummary;
use super::halves::{Course, Watcher, first_failure};
use super::journal::{Journal, Outcome};
use super::log::RunLog;
use super::looking::{Looking, Seen};
use super::moving::{Moved, Moving};
use super::percept::Percept;
use super::strip::Strip;
use crate::config::setup::Setup;
use crate::wiring::Parts;

/// A run that a person leads ends with the word `quit`, or after this time: what is written down stays in memory until then, seconds.
pub const LED_BY_PERSON_MAX_S: f64 = 3600.0;

/// A run that is over.
pub struct Ended {
    /// What was written down until then.
    pub outcome: Outcome,
    /// What has ended it before its time, if anything has failed.
    pub how: Result<()>,
}

/// As [`conduct`], and a failure leaves nothing.
///
/// # Errors
/// If an arm, the camera or the estimator fails for good; the arms are stopped first.
pub fn run(setup: &Setup, parts: Parts, stop_after_s: Option<f64>, record: Option<&Path>) -> Result<Outcome> {
    let Ended { outcome, how } = conduct(setup, parts, stop_after_s, record)?;
    how.map(|()| outcome)
}

/// Runs the experiment to its end, or to `stop_after_s`, in the loop that the pace of the setup asks for; every pair is also written to
/// the folder `record`, if given. The experiment begins when both arms are switched on, and both are stopped on every way out. Where a
/// person leads, the target moves from the word `start` on, and neither a stop nor what is latched in an arm ends the run.
///
/// # Errors
/// What is refused before an arm is switched on.
pub fn conduct(setup: &Setup, parts: Parts, stop_after_s: Option<f64>, record: Option<&Path>) -> Result<Ended> {
    // Everything that can be refused is made before an arm is switched on.
    let Parts { clock, camera, vs, tc, cell, experiment, target_outline_m, monitors, emulated, .. } = parts;
    let (operator, interrupt) = (parts.operator, parts.interrupt);
    // When the moves begin is for a person to say.
    let (duration_s, marks) = match operator.is_person() {
        true => (LED_BY_PERSON_MAX_S, Vec::new()),
        false => (experiment.duration_s(), experiment.marks().to_vec()),
    };
    let log = RunLog { marks, ..RunLog::default() };
    let strip = Strip::of(setup.experiment.moments(&log.marks));
    let now = clock.now();
    let looking = Looking::new(setup, (camera, cell.clone(), target_outline_m), (strip, now), record)?;
    let mut moving = Moving::new(setup, (vs, tc), &*experiment, now)?.with_operator(operator);
    let journal = Journal::new(setup, cell.clone(), (now, duration_s), log);
    let mut watching = Watching { looking, journal, cell, seen: None };
    let course = Course {
        setup,
        clock: &clock,
        duration: Duration::from_secs_f64(stop_after_s.map_or(duration_s, |s| s.clamp(0.0, duration_s))),
        interrupt: &interrupt,
    };
    let (how, punctuality) = course.run(&mut watching, &mut moving);
    let recorded = watching.looking.finish_recording();
    let how = first_failure([how, recorded]);
    let mut outcome = watching.journal.finish(setup, watching.looking.finish(), moving.arms().commands());
    let replies_missed = moving.arms().replies_missed();
    outcome.log.cycles.extend(punctuality.map(|punctuality| {
        CycleSummary::new("control loop", &punctuality.lateness.summary(), punctuality.missed, replies_missed)
    }));
    outcome.log.cycles.extend(monitors.iter().map(|(name, monitor)| CycleSummary::of_link(name, monitor)));
    // The arms go before what is at the other end of their lines.
    drop(moving);
    drop(emulated);
    Ok(Ended { outcome, how })
}

/// Looks, and writes down what both halves do.
struct Watching<'a> {
    looking: Looking<'a>,
    journal: Journal,
    cell: SimulatedCell,
    /// What is not yet written down.
    seen: Option<Seen>,
}

impl Watcher for Watching<'_> {
    type Step = Moved;

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.cell.begin_at(begin);
        self.looking.begin_at(begin);
        self.journal.begin_at(begin);
    }

    fn moved(&mut self, step: &Moved) {
        self.looking.push_joints(step.vs_joints);
        self.journal.note(step);
    }

    fn look(&mut self) -> Result<Option<Percept>> {
        self.seen = self.looking.look()?;
        Ok(self.seen.as_ref().map(Seen::percept))
    }

    fn note(&mut self) -> Result<()> {
        self.seen.take().map_or(Ok(()), |seen| self.looking.note(&seen))
    }
}
