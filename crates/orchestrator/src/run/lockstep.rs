//! The loop of a simulated run: one thread, stepped by one virtual clock, so that the same seed gives the same run.
//!
//! Two things happen, each at its own time, the earlier one first: a control step every control period, and a frame when
//! its exposure has ended. An estimate reaches the controller only `estimate_latency` after its exposure has ended, however
//! fast this machine computed it.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Result;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use super::journal::{Journal, Outcome};
use super::log::RunLog;
use super::looking::Looking;
use super::moving::Moving;
use super::percept::Percept;
use super::strip::Strip;
use crate::config::setup::Setup;
use crate::wiring::Parts;

/// Runs the experiment to its end, or to `stop_after_s`; every pair is also written to the folder `record`, if given. Both
/// arms are stopped on every way out.
///
/// # Errors
/// If an arm, the camera or the estimator fails for good; the arms are stopped first.
pub fn run(setup: &Setup, parts: Parts, stop_after_s: Option<f64>, record: Option<&Path>) -> Result<Outcome> {
    // Everything that can be refused is made before an arm is switched on.
    let Parts { clock, camera, vs, tc, cell, experiment, target_outline_m, interrupt, .. } = parts;
    let begin = clock.now();
    cell.begin_at(begin);
    let duration_s = experiment.duration_s();
    let log = RunLog { marks: experiment.marks().to_vec(), ..RunLog::default() };
    let strip = Strip::of(setup.experiment.moments(&log.marks));
    let looking = Looking::new(setup, (camera, cell.clone(), target_outline_m), (strip, begin), record)?;
    let moving = Moving::new(setup, (vs, tc), &*experiment, begin)?;
    let journal = Journal::new(setup, cell, (begin, duration_s), log);
    let arriving = VecDeque::new();
    let mut looped = Loop { setup, clock, looking, moving, journal, begin, arriving, interrupt };
    let end = begin + Duration::from_secs_f64(stop_after_s.map_or(duration_s, |s| s.clamp(0.0, duration_s)));
    let outcome = looped.moving.enable().and_then(|()| looped.run_to(end));
    let stopped = looped.moving.stop();
    let recorded = looped.looking.finish_recording();
    outcome.and(stopped).and(recorded)?;
    let commands = looped.moving.commands();
    Ok(looped.journal.finish(setup, looped.looking.finish(), commands))
}

struct Loop<'a> {
    setup: &'a Setup,
    clock: Arc<dyn Clock>,
    looking: Looking<'a>,
    moving: Moving<'a>,
    journal: Journal,
    begin: MonotonicTime,
    /// Estimates on their way to the controller, with the time of arrival.
    arriving: VecDeque<(MonotonicTime, Percept)>,
    interrupt: Arc<AtomicBool>,
}

impl Loop<'_> {
    /// Control steps and frames in the order of their times.
    fn run_to(&mut self, end: MonotonicTime) -> Result<()> {
        let mut next_control = self.begin;
        let mut next_frame = self.begin + self.setup.camera.exposure;
        while next_control.min(next_frame) <= end && !self.interrupt.load(Ordering::SeqCst) {
            if next_control <= next_frame {
                self.clock.sleep_until(next_control);
                self.control_step(next_control)?;
                next_control = next_control + self.setup.control_period;
            } else {
                self.frame_step()?;
                next_frame = next_frame + self.setup.camera.period;
            }
        }
        Ok(())
    }

    fn control_step(&mut self, now: MonotonicTime) -> Result<()> {
        while self.arriving.front().is_some_and(|(due, _)| *due <= now) {
            if let Some((_, percept)) = self.arriving.pop_front() {
                self.moving.observe(percept);
            }
        }
        let moved = self.moving.step(now)?;
        self.looking.push_joints(moved.vs_joints);
        self.journal.note(&moved);
        Ok(())
    }

    fn frame_step(&mut self) -> Result<()> {
        let Some(seen) = self.looking.look()? else { return Ok(()) };
        self.arriving.push_back((self.clock.now() + self.setup.estimate_latency, seen.percept()));
        self.looking.note(&seen)
    }
}
