//! A run: the hand follows the target through its experiment, and everything is written down beside the truth.

use std::path::Path;
use std::time::Duration;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;
use pb3dp_setup::setup::Setup;

use super::capturing::Captured;
use super::cell::SimulatedCell;
use super::cycles::CycleSummary;
use super::halves::{Capture, Course, Estimate, Parted, Record, first_failure};
use super::journal::{Journal, Outcome};
use super::log::RunLog;
use super::looking::{Estimating, Looking};
use super::moving::{Moved, Moving};
use super::noting::Noting;
use super::parts::Parts;
use super::percept::Percept;
use super::strip::Strip;
use crate::noting::Seen;

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
    let Parts { clock, camera, vs, tc, cell, experiment, marking, links, emulated, .. } = parts;
    let (operator, interrupt) = (parts.operator, parts.interrupt);
    // When the moves begin is for a person to say.
    let (duration_s, marks) = match operator.is_person() {
        true => (LED_BY_PERSON_MAX_S, Vec::new()),
        false => (experiment.duration_s(), experiment.marks().to_vec()),
    };
    let log = RunLog { marks, ..RunLog::default() };
    let strip = Strip::of(setup.experiment.moments(&log.marks));
    let now = clock.now();
    let looking = Looking::new(setup, (camera, cell.clone(), marking), (strip, &clock), record)?;
    let mut moving = Moving::new(setup, (vs, tc), &*experiment, now)?.with_operator(operator);
    let journal = Journal::new(setup, cell.clone(), (now, duration_s), log);
    let mut watching = Watching { looking, journal, cell };
    let course = Course {
        setup,
        clock: &clock,
        duration: Duration::from_secs_f64(stop_after_s.map_or(duration_s, |s| s.clamp(0.0, duration_s))),
        interrupt: &interrupt,
    };
    let (how, punctuality) = course.run(&mut watching, &mut moving);
    let recorded = watching.looking.noting.finish_recording();
    let how = first_failure([how, recorded]);
    let steps_untrue = watching.journal.steps_untrue();
    let mut outcome = watching.journal.finish(setup, watching.looking.finish(), moving.arms().commands());
    let replies_missed = moving.arms().replies_missed();
    if let Some(mut punctuality) = punctuality {
        punctuality.recording.dropped += steps_untrue;
        outcome.log.cycles.extend(punctuality.summaries(setup, replies_missed));
    }
    let links = links.iter().map(|(name, monitor)| CycleSummary::of_link(name, setup.control_period, &**monitor));
    outcome.log.cycles.extend(links);
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
}

impl Parted for Watching<'_> {
    type Step = Moved;
    type Frame = Captured;
    type Seen = Seen;

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.cell.begin_at(begin);
        self.looking.begin_at(begin);
        self.journal.begin_at(begin);
    }

    fn parts(
        &mut self,
    ) -> (
        impl Capture<Frame = Captured>,
        impl Estimate<Frame = Captured, Seen = Seen, Step = Moved>,
        impl Record<Seen = Seen, Step = Moved>,
    ) {
        let Looking { capturing, estimating, noting } = &mut self.looking;
        (capturing, Leading(estimating), Keeping { noting, journal: &mut self.journal })
    }
}

/// The method that leads the hand.
struct Leading<'w, 'a>(&'w mut Estimating<'a>);

impl Estimate for Leading<'_, '_> {
    type Frame = Captured;
    type Seen = Seen;
    type Step = Moved;

    fn moved(&mut self, step: &Moved) {
        self.0.push_joints(step.vs_joints);
    }

    fn look(&mut self, frame: Captured) -> Result<(Percept, Seen)> {
        let seen = self.0.look(frame)?;
        Ok((seen.percept(), seen))
    }
}

/// What writes down.
struct Keeping<'w, 'a> {
    noting: &'w mut Noting<'a>,
    journal: &'w mut Journal,
}

impl Record for Keeping<'_, '_> {
    type Seen = Seen;
    type Step = Moved;

    fn moved(&mut self, step: &Moved) {
        self.journal.note(step);
    }

    fn note(&mut self, seen: Seen) -> Result<()> {
        self.noting.note(&seen)
    }
}
