//! Runs both halves in the loop for the pace of the setup.

use anyhow::Result;
use pb3dp_setup::setup::Pace;

use super::cycles::Punctuality;
use super::halves::{Capture, Estimate, Mover, Record, RunContext, VisionParts};
use super::{live, lockstep};

impl RunContext<'_> {
    /// Steps both halves from enabling both arms until they are stopped, in the loop for the pace of the setup. The timing of each thread
    /// is only available in real time.
    ///
    /// # Errors
    /// The first permanent failure of an arm, the camera or the estimator; both arms are stopped first.
    pub fn run<M: Mover, C: Capture, E: Estimate<M::Step>, R: Record<M::Step, E::Observed>>(
        &self,
        vision: VisionParts<'_, C, E, R>,
        mover: &mut M,
    ) -> (Result<()>, Option<Punctuality>) {
        match self.setup.pace {
            Pace::Live => {
                let mut punctuality = Punctuality::default();
                (live::drive(self, vision, mover, &mut punctuality), Some(punctuality))
            }
            Pace::RealTime => (lockstep::drive(self, vision, mover, true), None),
            Pace::Fast => (self.run_in_lockstep(vision, mover), None),
        }
    }

    /// The same in simulated time, independent of the pace of the setup: one thread steps both halves.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn run_in_lockstep<M: Mover, C: Capture, E: Estimate<M::Step>, R: Record<M::Step, E::Observed>>(
        &self,
        vision: VisionParts<'_, C, E, R>,
        mover: &mut M,
    ) -> Result<()> {
        lockstep::drive(self, vision, mover, false)
    }
}
