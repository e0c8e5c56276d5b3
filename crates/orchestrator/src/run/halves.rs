//! The two halves of everything that has both arms move before the cameras: one that looks, and one that moves. Which loop steps
//! them, in simulated time or in the machine's, neither knows.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::Result;
use pb3dp_arm_pa10::io::arm::JitterMeter;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use super::percept::Percept;
use super::{live, lockstep};
use crate::config::setup::{Pace, Setup};

/// The half that moves both arms.
pub trait Mover: Send {
    /// What a control step is remembered by.
    type Step: Send;

    /// Drives on, and where the joints really are.
    ///
    /// # Errors
    /// The arm that can not be switched on, and why; the other one may be on.
    fn enable(&mut self) -> Result<()>;

    /// Control steps begin at this time.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// The newest that was seen of the target; the control step at `now` is the first one that has it.
    fn observe(&mut self, percept: Percept, now: MonotonicTime);

    /// One control step of both arms.
    ///
    /// # Errors
    /// Why both have to be stopped.
    fn step(&mut self, now: MonotonicTime) -> Result<Self::Step>;

    /// Both arms come to rest with brakes on, whatever happened before.
    ///
    /// # Errors
    /// The arm that can not be told.
    fn stop(&mut self) -> Result<()>;
}

/// The half that looks.
pub trait Watcher {
    /// What it is told of a control step.
    type Step: Send;

    /// Control steps begin at this time.
    fn begin_at(&mut self, begin: MonotonicTime);

    /// A control step was done.
    fn moved(&mut self, step: &Self::Step);

    /// Waits for the next pair and looks at it: what those who move are told. `None` if it did not come.
    ///
    /// # Errors
    /// If there will be no more.
    fn look(&mut self) -> Result<Option<Percept>>;

    /// Writes down what was seen last; those who move know it by now.
    ///
    /// # Errors
    /// If it can not be written.
    fn note(&mut self) -> Result<()>;
}

/// For how long both halves are stepped, and on which clock.
pub struct Course<'a> {
    /// Their times.
    pub setup: &'a Setup,
    /// The one clock.
    pub clock: &'a Arc<dyn Clock>,
    /// From the first control step to the last one.
    pub duration: Duration,
    /// Once this is set, the course ends before its time.
    pub interrupt: &'a AtomicBool,
}

/// How punctual the steps were in the machine's time.
#[derive(Debug, Default)]
pub struct Punctuality {
    /// How late they began.
    pub lateness: JitterMeter,
    /// Those that were left out because their time had passed.
    pub missed: u64,
}

impl Course<'_> {
    /// Steps both halves from switching both arms on until they are stopped, in the loop that the pace of the setup asks for. How punctual
    /// that was is known only in the machine's time.
    ///
    /// # Errors
    /// The first failure of an arm, the camera or the estimator for good; both arms are stopped first.
    pub fn run<M: Mover, W: Watcher<Step = M::Step>>(
        &self,
        watcher: &mut W,
        mover: &mut M,
    ) -> (Result<()>, Option<Punctuality>) {
        if self.setup.pace == Pace::Live {
            let mut punctuality = Punctuality::default();
            (live::drive(self, watcher, mover, &mut punctuality), Some(punctuality))
        } else {
            (lockstep::drive(self, watcher, mover), None)
        }
    }
}

/// The first failure of several outcomes, in the order in which they came about; the others are logged.
///
/// # Errors
/// The first failure.
pub(super) fn first_failure(outcomes: impl IntoIterator<Item = Result<()>>) -> Result<()> {
    let mut first = Ok(());
    for next in outcomes {
        match (&first, next) {
            (Ok(()), next) => first = next,
            (Err(_), Err(later)) => tracing::error!("after the first failure: {later:#}"),
            (Err(_), Ok(())) => {}
        }
    }
    first
}

/// Arms that are switched on: on every way out, a panic included, they are stopped.
pub(super) struct Enabled<'a, M: Mover> {
    mover: &'a mut M,
    is_stopped: bool,
}

impl<'a, M: Mover> Enabled<'a, M> {
    /// Switches both arms on.
    ///
    /// # Errors
    /// As [`Mover::enable`]; both are stopped then.
    pub fn new(mover: &'a mut M) -> Result<Self> {
        let enabled = Self { mover, is_stopped: false };
        enabled.mover.enable()?;
        Ok(enabled)
    }

    /// What moves them.
    pub fn mover(&mut self) -> &mut M {
        self.mover
    }

    /// Stops both.
    ///
    /// # Errors
    /// As [`Mover::stop`].
    pub fn stop(mut self) -> Result<()> {
        self.is_stopped = true;
        self.mover.stop()
    }
}

impl<M: Mover> Drop for Enabled<'_, M> {
    fn drop(&mut self) {
        if !self.is_stopped {
            self.mover.stop().ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use pb3dp_hal_clock::{SystemClock, VirtualClock};

    use super::*;
    use crate::config::setup::read_setup;

    /// Arms that fail by a mistake of the program after some steps.
    #[derive(Default)]
    struct Mistaken {
        is_on: bool,
        steps: usize,
        stops: usize,
    }

    impl Mover for Mistaken {
        type Step = ();

        fn enable(&mut self) -> Result<()> {
            self.is_on = true;
            Ok(())
        }

        fn begin_at(&mut self, _begin: MonotonicTime) {}

        fn observe(&mut self, _percept: Percept, _now: MonotonicTime) {}

        fn step(&mut self, _now: MonotonicTime) -> Result<()> {
            self.steps += 1;
            assert!(self.steps < 5, "a mistake");
            Ok(())
        }

        fn stop(&mut self) -> Result<()> {
            self.is_on = false;
            self.stops += 1;
            Ok(())
        }
    }

    /// Nothing to be seen, every now and then.
    struct Blind;

    impl Watcher for Blind {
        type Step = ();

        fn begin_at(&mut self, _begin: MonotonicTime) {}

        fn moved(&mut self, _step: &()) {}

        fn look(&mut self) -> Result<Option<Percept>> {
            std::thread::sleep(Duration::from_millis(1));
            Ok(None)
        }

        fn note(&mut self) -> Result<()> {
            Ok(())
        }
    }

    /// Arms that can not be stopped.
    struct Unstoppable;

    impl Mover for Unstoppable {
        type Step = ();

        fn enable(&mut self) -> Result<()> {
            Ok(())
        }

        fn begin_at(&mut self, _begin: MonotonicTime) {}

        fn observe(&mut self, _percept: Percept, _now: MonotonicTime) {}

        fn step(&mut self, _now: MonotonicTime) -> Result<()> {
            Ok(())
        }

        fn stop(&mut self) -> Result<()> {
            anyhow::bail!("an arm can not be told")
        }
    }

    /// A camera that is gone.
    struct Broken;

    impl Watcher for Broken {
        type Step = ();

        fn begin_at(&mut self, _begin: MonotonicTime) {}

        fn moved(&mut self, _step: &()) {}

        fn look(&mut self) -> Result<Option<Percept>> {
            anyhow::bail!("the camera is gone")
        }

        fn note(&mut self) -> Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_stop_that_fails_does_not_hide_why_both_arms_were_stopped() {
        for (pace, clock) in clocks() {
            let (setup, interrupt) = (setup(pace), AtomicBool::new(false));
            let course =
                Course { setup: &setup, clock: &clock, duration: Duration::from_secs(10), interrupt: &interrupt };
            let failure = course.run(&mut Broken, &mut Unstoppable).0.unwrap_err();
            assert_eq!(failure.to_string(), "the camera is gone", "{pace:?}");
        }
    }

    fn clocks() -> [(Pace, Arc<dyn Clock>); 2] {
        [(Pace::Fast, Arc::new(VirtualClock::new())), (Pace::Live, Arc::new(SystemClock::new()))]
    }

    fn setup(pace: Pace) -> Setup {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        Setup { pace, ..read_setup(Path::new(file)).unwrap() }
    }

    #[test]
    fn a_mistake_of_the_half_that_moves_stops_both_arms() {
        for (pace, clock) in clocks() {
            let (setup, interrupt) = (setup(pace), AtomicBool::new(false));
            let course =
                Course { setup: &setup, clock: &clock, duration: Duration::from_secs(10), interrupt: &interrupt };
            let mut mover = Mistaken::default();
            let run = std::panic::AssertUnwindSafe(|| course.run(&mut Blind, &mut mover).0);
            let ended = std::panic::catch_unwind(run);
            assert!(ended.map_or(true, |ended| ended.is_err()), "{pace:?}");
            assert_eq!((mover.steps, mover.stops, mover.is_on), (5, 1, false), "{pace:?}");
        }
    }
}
