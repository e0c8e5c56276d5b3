//! The loop of a run in the machine's time: looking and moving have a thread each.
//!
//! The thread that moves steps both arms at fixed times and waits for nobody but the arms. What the other one has seen comes to
//! it, and its steps go back, through channels of fixed size whose ends never wait: a picture that takes too long comes too
//! late, and moves nobody else. It allocates nothing and, of arms behind a line, shares no lock with image work; joints that are
//! simulated in process (`mock`) are shared with the cameras.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use pb3dp_arm_pa10::io::arm::JitterMeter;
use pb3dp_arm_pa10::io::realtime::{Realtime, enter};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use super::commands::CommandSummary;
use super::cycles::CycleSummary;
use super::journal::{Journal, Outcome};
use super::log::RunLog;
use super::looking::Looking;
use super::moving::{Moved, Moving};
use super::percept::Percept;
use super::strip::Strip;
use crate::config::setup::Setup;
use crate::wiring::Parts;

/// What was seen, on its way to the controller: it takes all of it in every step.
const PERCEPTS_MAX: usize = 16;
/// Steps that nobody has written down yet: two seconds at 500 Hz.
const STEPS_MAX: usize = 1000;
/// What a thread that moves arms asks for: a priority below those of the arms, which have 50.
pub const CONTROL_THREAD: Realtime = Realtime { priority: Some(40), locks_memory: false, cpu: None };

/// As [`super::lockstep::run`], in the machine's time. The experiment begins when both arms are switched on.
///
/// # Errors
/// If an arm, the camera or the estimator fails for good; the arms are stopped first.
pub fn run(setup: &Setup, parts: Parts, stop_after_s: Option<f64>, record: Option<&Path>) -> Result<Outcome> {
    let Parts { clock, camera, vs, tc, cell, experiment, target_outline_m, monitors, emulated, interrupt, .. } = parts;
    let duration_s = experiment.duration_s();
    let log = RunLog { marks: experiment.marks().to_vec(), ..RunLog::default() };
    let strip = Strip::of(setup.experiment.moments(&log.marks));
    let (mut looking, mut moving) = (
        Looking::new(setup, (camera, cell.clone(), target_outline_m), (strip, clock.now()), record)?,
        Moving::new(setup, (vs, tc), &*experiment, clock.now())?,
    );
    if let Err(error) = moving.enable() {
        moving.stop().ok();
        return Err(error);
    }
    let begin = clock.now();
    cell.begin_at(begin);
    looking.begin_at(begin);
    moving.begin_at(begin);
    let end = begin + Duration::from_secs_f64(stop_after_s.map_or(duration_s, |s| s.clamp(0.0, duration_s)));
    let mut journal = Journal::new(setup, cell, (begin, duration_s), log);
    let (seen_in, seen_out) = sync_channel(PERCEPTS_MAX);
    let (steps_in, steps_out) = sync_channel(STEPS_MAX);
    // Whoever interrupts the run says the same as its end does.
    let is_over = interrupt;
    let mover = Mover {
        clock: Arc::clone(&clock),
        period: setup.control_period,
        moving,
        seen: seen_out,
        steps: steps_in,
        is_over: &is_over,
        lateness: JitterMeter::default(),
        missed: 0,
    };
    let (moved, looked) = std::thread::scope(|scope| {
        // However this thread ends, the other one ends, too, and stops the arms.
        let _over = Over(&is_over);
        let thread =
            std::thread::Builder::new().name("control".to_owned()).spawn_scoped(scope, || mover.run((begin, end)));
        let looked = match &thread {
            Ok(_) => look_on(&mut looking, &mut journal, (&seen_in, &steps_out), &is_over),
            Err(_) => Ok(()),
        };
        is_over.store(true, Ordering::SeqCst);
        let moved = thread.context("no thread for the arms").and_then(|thread| {
            thread
                .join()
                .unwrap_or_else(|_| Err(anyhow!("the thread of the arms has failed by a mistake of the program")))
        });
        (moved, looked)
    });
    let recorded = looking.finish_recording();
    let moved = moved?;
    looked.and(recorded)?;
    for step in steps_out.try_iter() {
        journal.note(&step);
    }
    let mut outcome = journal.finish(setup, looking.finish(), moved.commands);
    outcome.log.cycles.push(moved.cycles);
    outcome.log.cycles.extend(monitors.iter().map(|(name, monitor)| CycleSummary::of_link(name, monitor)));
    drop(emulated);
    Ok(outcome)
}

/// This thread moves arms from now on; what is not to be had is told, and it goes on without.
pub fn enter_control_thread() {
    for shortfall in enter(&CONTROL_THREAD) {
        tracing::warn!("control loop: {shortfall}");
    }
}

/// Says that the run is over when it is dropped.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Looks at pairs until the other thread is done, and writes down what both do.
fn look_on(
    looking: &mut Looking<'_>,
    journal: &mut Journal,
    (seen_in, steps_out): (&SyncSender<Percept>, &Receiver<Moved>),
    is_over: &AtomicBool,
) -> Result<()> {
    while !is_over.load(Ordering::SeqCst) {
        for step in steps_out.try_iter() {
            looking.push_joints(step.vs_joints);
            journal.note(&step);
        }
        let Some(seen) = looking.look()? else { continue };
        // A controller that takes no more has newer ones than it can use.
        seen_in.try_send(seen.percept()).ok();
        looking.note(&seen)?;
    }
    Ok(())
}

/// The thread that moves.
struct Mover<'a> {
    clock: Arc<dyn Clock>,
    period: Duration,
    moving: Moving<'a>,
    seen: Receiver<Percept>,
    steps: SyncSender<Moved>,
    is_over: &'a AtomicBool,
    lateness: JitterMeter,
    /// Steps that were left out.
    missed: u64,
}

/// What the thread that moves leaves behind.
struct Done {
    commands: [CommandSummary; 2],
    cycles: CycleSummary,
}

impl Mover<'_> {
    /// Steps until the end, then stops both arms; also when a step fails or the other thread is done.
    fn run(mut self, (begin, end): (MonotonicTime, MonotonicTime)) -> Result<Done> {
        enter_control_thread();
        let _over = Over(self.is_over);
        let stepped = self.step_until((begin, end));
        let stopped = self.moving.stop();
        stepped.and(stopped)?;
        Ok(Done {
            commands: self.moving.commands(),
            cycles: CycleSummary::new(
                "control loop",
                &self.lateness.summary(),
                self.missed,
                self.moving.replies_missed(),
            ),
        })
    }

    fn step_until(&mut self, (begin, end): (MonotonicTime, MonotonicTime)) -> Result<()> {
        let mut due = begin;
        while due <= end && !self.is_over.load(Ordering::SeqCst) {
            self.clock.sleep_until(due);
            let now = self.clock.now();
            self.lateness.record(now.saturating_since(due));
            while let Ok(percept) = self.seen.try_recv() {
                self.moving.observe(percept);
            }
            let moved = self.moving.step(now)?;
            // Steps that nobody writes down are lost to the report, and to nothing else.
            self.steps.try_send(moved).ok();
            due = due + self.period;
            // Times that have passed are left out.
            while due + self.period <= self.clock.now() {
                due = due + self.period;
                self.missed += 1;
            }
        }
        Ok(())
    }
}
