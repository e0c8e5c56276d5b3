//! The record of a replayed run for its report, as the run itself keeps it.

use anyhow::Result;
use pb3dp_bag::run_messages::RunBegin;
use pb3dp_cell::channels::Plan;
use pb3dp_cell::journal::{Journal, Outcome, RecordedStep, TruePoses};
use pb3dp_cell::log::RunLog;
use pb3dp_cell::moving::Moved;
use pb3dp_cell::noting::{EstimateRecorder, PairEstimate};
use pb3dp_cell::spectator::RunEnd;
use pb3dp_cell::strip::Strip;
use pb3dp_geometry::MonotonicTime;
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::Trajectory;

use super::past::Past;
use crate::exact::marking;

/// Keeps steps and estimates for the report.
pub struct Reporting<'a> {
    journal: Journal,
    noting: EstimateRecorder<'a>,
}

impl<'a> Reporting<'a> {
    /// Nothing is kept yet.
    ///
    /// # Errors
    /// As [`EstimateRecorder::new`].
    pub fn new(setup: &'a Setup, experiment: &dyn Trajectory, run: &RunBegin) -> Result<Self> {
        let begin = MonotonicTime::from_nanos(run.begin_nanos);
        let marks = if run.is_person { Vec::new() } else { experiment.marks().to_vec() };
        let strip = Strip::of(setup.experiment.moments(&marks));
        let log = RunLog { marks, ..RunLog::default() };
        let plan = Plan::of(&setup.experiment.motion, experiment);
        let mut noting = EstimateRecorder::new(setup, marking(&run.marking)?, (strip, begin), None)?;
        noting.begin_at(begin);
        let journal = Journal::new(setup, (begin, experiment.duration_s()), (log, plan)).quiet();
        let journal = journal.without_console(!run.is_person && !run.can_fall_silent);
        Ok(Self { journal, noting })
    }

    /// Keeps an estimate.
    ///
    /// # Errors
    /// As [`EstimateRecorder::note`].
    pub fn seen(&mut self, seen: &PairEstimate) -> Result<()> {
        self.noting.note(seen)
    }

    /// Keeps a control step.
    pub fn moved(&mut self, moved: &Moved, poses: Option<TruePoses>) {
        self.journal.note(moved, poses);
    }

    /// Keeps a control step that was not replayed.
    pub fn recorded(&mut self, step: RecordedStep, poses: Option<TruePoses>) {
        self.journal.note_recorded(step, poses);
    }

    /// The record; `end` is missing if the recording was broken off. The changes of state are those of the recording if the control was
    /// not replayed.
    pub fn finish(mut self, end: Option<&RunEnd>, past: Past) -> Outcome {
        if past.begins_s.is_some() {
            past.changes.into_iter().for_each(|change| self.journal.note_change(change));
        }
        let end = end.cloned().unwrap_or_default();
        self.journal.finish(self.noting.finish(end.pairs_lost), end.commands)
    }
}
