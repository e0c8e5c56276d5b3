//! Runs both halves in the loop for the pace of the setup.

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;
use pb3dp_setup::setup::Pace;

use super::cycles::Punctuality;
use super::halves::{Capture, Course, Estimate, Mover, Parted, Record, Watcher};
use super::percept::Percept;
use super::{beside, live, lockstep};

impl Course<'_> {
    /// Steps both halves from enabling both arms until they are stopped, in the loop for the pace of the setup. The timing of each thread
    /// is only available in real time.
    ///
    /// # Errors
    /// The first permanent failure of an arm, the camera or the estimator; both arms are stopped first.
    pub fn run<M: Mover, W: Parted<Step = M::Step>>(
        &self,
        watcher: &mut W,
        mover: &mut M,
    ) -> (Result<()>, Option<Punctuality>) {
        match self.setup.pace {
            Pace::Live => {
                let mut punctuality = Punctuality::default();
                (live::drive(self, watcher, mover, &mut punctuality), Some(punctuality))
            }
            Pace::RealTime => (beside::drive(self, watcher, mover), None),
            Pace::Fast => (self.run_in_lockstep(&mut InTurn { parted: watcher, seen: None }, mover), None),
        }
    }

    /// The same in simulated time, independent of the pace of the setup: one thread steps both halves.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn run_in_lockstep<M: Mover, W: Watcher<Step = M::Step>>(&self, watcher: &mut W, mover: &mut M) -> Result<()> {
        lockstep::drive(self, watcher, mover)
    }
}

/// The three parts, called one after the other.
struct InTurn<'w, W: Parted> {
    parted: &'w mut W,
    /// Not recorded yet.
    seen: Option<W::Observed>,
}

impl<W: Parted> Watcher for InTurn<'_, W> {
    type Step = W::Step;

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.parted.begin_at(begin);
    }

    fn moved(&mut self, step: &W::Step) {
        let (_, mut estimator, mut recorder) = self.parted.parts();
        estimator.moved(step);
        recorder.moved(step);
    }

    fn look(&mut self) -> Result<Option<Percept>> {
        let (mut camera, mut estimator, _) = self.parted.parts();
        estimator.take_selection();
        let Some(frame) = camera.capture()? else { return Ok(None) };
        let (percept, seen) = estimator.look(frame)?;
        self.seen = Some(seen);
        Ok(Some(percept))
    }

    fn note(&mut self) -> Result<()> {
        self.seen.take().map_or(Ok(()), |seen| self.parted.parts().2.note(seen))
    }
}
