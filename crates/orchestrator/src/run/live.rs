//! The loop in the machine's time: looking and moving have a thread each.
//!
//! The thread that moves steps both arms at fixed times and waits for nobody but the arms. What the other one has seen comes to
//! it, and its steps go back, through channels of fixed size whose ends never wait: a picture that takes too long comes too
//! late, and moves nobody else. It allocates nothing and, of arms behind a line, shares no lock with image work; joints that are
//! simulated in process (`mock`) are shared with the cameras.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use anyhow::{Context, Result, anyhow};
use pb3dp_arm_pa10::io::realtime::{Realtime, enter};
use pb3dp_geometry::MonotonicTime;

use super::halves::{Course, Enabled, Mover, Punctuality, Watcher, first_failure};
use super::percept::Percept;

/// What was seen, on its way to those who move: they take all of it in every step.
const PERCEPTS_MAX: usize = 16;
/// Steps that nobody has written down yet: two seconds at 500 Hz.
const STEPS_MAX: usize = 1000;
/// What a thread that moves arms asks for: a priority below those of the arms, which have 50.
pub const CONTROL_THREAD: Realtime = Realtime { priority: Some(40), locks_memory: false, cpu: None };

/// Steps both halves, each on its thread, from the moment in which both arms are switched on; both are stopped on every way out.
///
/// # Errors
/// The first failure of an arm, the camera or the estimator for good.
pub(super) fn drive<M: Mover, W: Watcher<Step = M::Step>>(
    course: &Course<'_>,
    watcher: &mut W,
    mover: &mut M,
    punctuality: &mut Punctuality,
) -> Result<()> {
    let mut enabled = Enabled::new(mover)?;
    let begin = course.clock.now();
    watcher.begin_at(begin);
    enabled.mover().begin_at(begin);
    let (seen_in, seen_out) = sync_channel(PERCEPTS_MAX);
    let (steps_in, steps_out) = sync_channel(STEPS_MAX);
    // Whoever interrupts the course says the same as its end does.
    let is_over = course.interrupt;
    let driving = Driving { course, enabled, seen: seen_out, steps: steps_in, punctuality };
    let (moved, looked) = std::thread::scope(|scope| {
        // However this thread ends, the other one ends, too, and stops the arms.
        let _over = Over(is_over);
        let thread = std::thread::Builder::new().name("control".to_owned()).spawn_scoped(scope, || driving.run(begin));
        let looked = match &thread {
            Ok(_) => look_on(watcher, (&seen_in, &steps_out), is_over),
            Err(_) => Ok(()),
        };
        is_over.store(true, Ordering::SeqCst);
        let moved = thread.context("no thread for the arms").and_then(|thread| {
            thread.join().map_err(|_| anyhow!("the thread of the arms has failed by a mistake of the program"))
        });
        (moved, looked)
    });
    for step in steps_out.try_iter() {
        watcher.moved(&step);
    }
    let (stepped, stopped) = moved.unwrap_or_else(|failure| (Err(failure), Ok(())));
    // Both arms are stopped behind whatever else has failed.
    first_failure([stepped, looked, stopped])
}

/// This thread moves arms from now on; what is not to be had is told, and it goes on without.
pub fn enter_control_thread() {
    for shortfall in enter(&CONTROL_THREAD) {
        tracing::warn!("control loop: {shortfall}");
    }
}

/// Says that the course is over when it is dropped.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Looks at pairs until the other thread is done, and writes down what both do.
fn look_on<W: Watcher>(
    watcher: &mut W,
    (seen_in, steps_out): (&SyncSender<Percept>, &Receiver<W::Step>),
    is_over: &AtomicBool,
) -> Result<()> {
    while !is_over.load(Ordering::SeqCst) {
        for step in steps_out.try_iter() {
            watcher.moved(&step);
        }
        let Some(percept) = watcher.look()? else { continue };
        // Who takes no more has newer ones than can be used.
        seen_in.try_send(percept).ok();
        watcher.note()?;
    }
    Ok(())
}

/// The thread that moves.
struct Driving<'a, M: Mover> {
    course: &'a Course<'a>,
    enabled: Enabled<'a, M>,
    seen: Receiver<Percept>,
    steps: SyncSender<M::Step>,
    punctuality: &'a mut Punctuality,
}

impl<M: Mover> Driving<'_, M> {
    /// Steps until the end, then stops both arms; also when a step fails or the other thread is done. What became of the steps, and of the
    /// stop.
    fn run(mut self, begin: MonotonicTime) -> (Result<()>, Result<()>) {
        enter_control_thread();
        let _over = Over(self.course.interrupt);
        let stepped = self.step_from(begin);
        (stepped, self.enabled.stop())
    }

    fn step_from(&mut self, begin: MonotonicTime) -> Result<()> {
        let &Course { setup, clock, duration, interrupt } = self.course;
        let (mut due, end, period) = (begin, begin + duration, setup.control_period);
        while due <= end && !interrupt.load(Ordering::SeqCst) {
            clock.sleep_until(due);
            let now = clock.now();
            self.punctuality.lateness.record(now.saturating_since(due));
            while let Ok(percept) = self.seen.try_recv() {
                self.enabled.mover().observe(percept, now);
            }
            let step = self.enabled.mover().step(now)?;
            // Steps that nobody writes down are lost to the report, and to nothing else.
            self.steps.try_send(step).ok();
            due = due + period;
            // Times that have passed are left out.
            while due + period <= clock.now() {
                due = due + period;
                self.punctuality.missed += 1;
            }
        }
        Ok(())
    }
}
