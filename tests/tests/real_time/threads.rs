//! The threads of a run in real time: a slow, stalled or failing thread delays no other thread, and both arms are stopped.
//! No test depends on durations: a stalled thread waits for the others.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use pb3dp_allocation_count::requests;
use pb3dp_cell::capturing::Captured;
use pb3dp_cell::cycles::Punctuality;
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::halves::{Capture, Estimate, Mover, Record, RunContext};
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::parts::Parts;
use pb3dp_cell::percept::Percept;
use pb3dp_cell::perception::View;
use pb3dp_cell::vision::{Estimating, Vision};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::{SystemClock, VirtualClock};
use pb3dp_servo::supervisor::{Condition, Confidence, EstimateInput, FrameInput, State};
use pb3dp_setup::setup::{Leader, Pace, Setup, read_setup};
use pb3dp_test_support::programs_in_real_time_beside_others;
use pb3dp_wiring::wire;
use system_tests::repository;

/// A wait for other threads fails after this time: they are blocked.
const HELD_UP: Duration = Duration::from_secs(60);

/// Size of the record of a control step: about that of a run.
type Step = [u64; 64];

/// Counters of all parts.
#[derive(Default)]
struct Done {
    captured: AtomicU64,
    estimated: AtomicU64,
    observed: AtomicU64,
    recorded: AtomicU64,
    steps: AtomicU64,
    stops: AtomicU64,
    /// Number of heap requests of the control thread between control steps.
    requests: AtomicU64,
    /// The run shall end.
    is_enough: AtomicBool,
}

fn count(counter: &AtomicU64) -> u64 {
    counter.fetch_add(1, Ordering::SeqCst) + 1
}

fn of(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::SeqCst)
}

/// Waits until each of the counters has grown by this much, or the arms are stopped.
fn wait_for(done: &Done, more: u64, counters: &[&AtomicU64]) {
    let begin = Instant::now();
    let until: Vec<u64> = counters.iter().map(|counter| of(counter) + more).collect();
    while of(&done.stops) == 0 && counters.iter().zip(&until).any(|(counter, until)| of(counter) < *until) {
        assert!(begin.elapsed() < HELD_UP, "the other threads are blocked");
        std::thread::sleep(Duration::from_millis(1));
    }
}

type Action = fn(&Done) -> Result<()>;

/// Actions of the parts in addition to their work.
#[derive(Clone, Copy)]
struct Script {
    capture: Action,
    estimate: Action,
    record: Action,
    step: Action,
    stop: Action,
}

const NOTHING: Action = |_| Ok(());
const QUIET: Script = Script { capture: NOTHING, estimate: NOTHING, record: NOTHING, step: NOTHING, stop: NOTHING };

/// Perception, and each of its parts. A frame every two milliseconds.
#[derive(Clone, Copy)]
struct Part<'a>(&'a Done, Script);

impl Capture for Part<'_> {
    fn capture(&mut self) -> Result<Option<Captured>> {
        std::thread::sleep(Duration::from_millis(2));
        (self.1.capture)(self.0)?;
        let frame = FrameInput { sequence: count(&self.0.captured), at: MonotonicTime::ZERO, skew_s: 0.0 };
        Ok(Some(Captured { frame, cam_left_from_target: None, view: View::Nothing }))
    }
}

impl Estimate<Step> for Part<'_> {
    type Observed = ();

    fn moved(&mut self, _step: &Step) {}

    fn look(&mut self, Captured { frame, .. }: Captured) -> Result<(Option<Percept>, ())> {
        (self.1.estimate)(self.0)?;
        count(&self.0.estimated);
        let estimate = EstimateInput { at: frame.at, confidence: Confidence::NoPose, covariance: None, target: 1 };
        Ok((Some(Percept { frame, estimate, observation: None, surface_from_model: None }), ()))
    }
}

impl Record<Step, ()> for Part<'_> {
    fn note(&mut self, _observed: ()) -> Result<()> {
        (self.1.record)(self.0)?;
        count(&self.0.recorded);
        Ok(())
    }
}

/// Arms that only count; the loop's actions between two steps are observed.
struct Arms<'a> {
    done: &'a Done,
    script: Script,
    is_on: bool,
    newest: u64,
    /// Heap requests after the previous step.
    requests: Option<usize>,
    interrupt: &'a AtomicBool,
}

impl Mover for Arms<'_> {
    type Step = Step;

    fn enable(&mut self) -> Result<bool> {
        self.is_on = true;
        Ok(true)
    }

    fn begin_at(&mut self, _begin: MonotonicTime) {}

    fn observe(&mut self, percept: Percept, _now: MonotonicTime) {
        assert!(percept.frame.sequence > self.newest, "a percept arrives once, and never after a newer one");
        self.newest = percept.frame.sequence;
        count(&self.done.observed);
    }

    fn step(&mut self, _now: MonotonicTime) -> Result<Step> {
        let between = self.requests.map_or(0, |before| requests() - before);
        self.done.requests.fetch_add(between as u64, Ordering::SeqCst);
        count(&self.done.steps);
        (self.script.step)(self.done)?;
        if self.done.is_enough.load(Ordering::SeqCst) {
            self.interrupt.store(true, Ordering::SeqCst);
        }
        self.requests = Some(requests());
        Ok([7; 64])
    }

    fn stop(&mut self) -> Result<()> {
        self.is_on = false;
        count(&self.done.stops);
        (self.script.stop)(self.done)
    }
}

fn setup(pace: Pace) -> Setup {
    Setup {
        pace,
        control_period: Duration::from_millis(2),
        ..read_setup(&repository().join("configs/sim.toml")).unwrap()
    }
}

/// Results of a run, which ends when it is complete, after ten minutes, or by a failure or panic (`None`).
fn run(pace: Pace, script: Script) -> (Done, Option<Result<()>>, Punctuality) {
    let (done, interrupt) = (Done::default(), AtomicBool::new(false));
    let clock: Arc<dyn Clock> = match pace {
        Pace::Live => Arc::new(SystemClock::new()),
        Pace::Fast | Pace::RealTime => Arc::new(VirtualClock::new()),
    };
    let setup = setup(pace);
    let mut arms = Arms { done: &done, script, is_on: false, newest: 0, requests: None, interrupt: &interrupt };
    let run_context =
        RunContext { setup: &setup, clock: &clock, duration: Duration::from_secs(600), interrupt: &interrupt };
    let [mut camera, mut method, mut recorder] = [Part(&done, script); 3];
    let ended =
        catch_unwind(AssertUnwindSafe(|| run_context.run((&mut camera, &mut method, &mut recorder), &mut arms)));
    assert!(!arms.is_on, "both arms are stopped, however a run ends");
    assert_eq!(of(&done.stops), 1);
    let (ended, punctuality) = ended.map_or((None, None), |(ended, punctuality)| (Some(ended), punctuality));
    (done, ended, punctuality.unwrap_or_default())
}

/// The cause of the end of a run, as a line.
fn failure(ended: Option<Result<()>>) -> String {
    ended.map_or_else(|| "a panic".to_owned(), |ended| format!("{:#}", ended.unwrap_err()))
}

#[test]
fn a_stalled_recorder_holds_neither_estimation_nor_control_up() {
    const MANY: u64 = 100;
    let record: Action = |done| {
        if of(&done.recorded) == 3 {
            wait_for(done, MANY, &[&done.captured, &done.estimated, &done.observed, &done.steps]);
            done.is_enough.store(true, Ordering::SeqCst);
        }
        Ok(())
    };
    let (done, ended, punctuality) = run(Pace::Live, Script { record, ..QUIET });
    ended.unwrap().unwrap();
    // Frames without room in a ring were dropped and counted; all others were recorded in the end.
    let (recorded, estimated) = (of(&done.recorded), of(&done.estimated));
    assert!(
        punctuality.estimation.dropped >= estimated - recorded && estimated - recorded > MANY / 2,
        "{punctuality:?}"
    );
    assert!(recorded > 4, "{recorded}");
    assert_eq!(punctuality.recording.lateness.summary().cycles, recorded);
}

#[test]
fn a_slow_estimator_holds_neither_capture_nor_control_up_and_gets_the_newest_frame() {
    const MANY: u64 = 100;
    let estimate: Action = |done| {
        match of(&done.estimated) {
            3 => wait_for(done, MANY, &[&done.captured, &done.steps]),
            5 => done.is_enough.store(true, Ordering::SeqCst),
            _ => {}
        }
        Ok(())
    };
    let (done, ended, punctuality) = run(Pace::Live, Script { estimate, ..QUIET });
    ended.unwrap().unwrap();
    let (captured, estimated) = (of(&done.captured), of(&done.estimated));
    // The slot held the first frame of the wait, and the last one may be counted but not yet handed over.
    assert!(punctuality.capture.dropped >= MANY - 2, "{punctuality:?}");
    assert!(captured > MANY && estimated < MANY, "{captured} frames, {estimated} of them estimated");
    assert_eq!(punctuality.control.lateness.summary().cycles, of(&done.steps));
}

#[test]
fn a_camera_that_waits_holds_control_not_up() {
    let capture: Action = |done| {
        wait_for(done, 20, &[&done.steps]);
        done.is_enough.store(of(&done.captured) > 3, Ordering::SeqCst);
        Ok(())
    };
    run(Pace::Live, Script { capture, ..QUIET }).1.unwrap().unwrap();
}

/// Rings and slots that are full, empty and overwritten in turn: the control thread allocates nothing between two steps.
#[test]
fn handing_over_takes_nothing_from_the_heap() {
    let record: Action = |done| {
        match of(&done.recorded) {
            // More than the rings hold.
            10 => wait_for(done, 1200, &[&done.steps]),
            60 => done.is_enough.store(true, Ordering::SeqCst),
            _ => {}
        }
        Ok(())
    };
    let (done, ended, punctuality) = run(Pace::Live, Script { record, ..QUIET });
    ended.unwrap().unwrap();
    assert_eq!(of(&done.requests), 0, "in {} steps", of(&done.steps));
    assert!(of(&done.observed) > 100 && punctuality.control.dropped > 100, "{punctuality:?}");
}

#[test]
fn a_mistake_in_any_thread_stops_both_arms() {
    let mistake: Action = |done| if of(&done.steps) >= 5 { panic!("a mistake of the test") } else { Ok(()) };
    let scripts = [
        ("capture", Script { capture: mistake, ..QUIET }),
        ("estimation", Script { estimate: mistake, ..QUIET }),
        ("control", Script { step: mistake, ..QUIET }),
        ("recording", Script { record: mistake, ..QUIET }),
    ];
    for (part, script) in scripts {
        let (done, ended, _) = run(Pace::Live, script);
        let why = failure(ended);
        // The recorder runs on the caller's thread.
        let expected = if part == "recording" { "a panic".to_owned() } else { format!("the {part} thread panicked") };
        assert!(why.contains(&expected), "{part}: {why}");
        assert!(of(&done.steps) >= 5, "{part}");
        let (_, ended, _) = run(Pace::Fast, script);
        assert_eq!(failure(ended), "a panic", "{part}");
    }
}

#[test]
fn a_failure_in_any_thread_stops_both_arms_and_is_reported() {
    let fail: Action = |done| if of(&done.steps) >= 5 { bail!("the part is gone") } else { Ok(()) };
    let scripts = [
        Script { capture: fail, ..QUIET },
        Script { estimate: fail, ..QUIET },
        Script { step: fail, ..QUIET },
        Script { record: fail, ..QUIET },
    ];
    // A stop that fails does not hide the cause of the stop of both arms.
    let stop: Action = |_| bail!("an arm cannot be told");
    for script in scripts {
        for pace in [Pace::Live, Pace::Fast] {
            for script in [script, Script { stop, ..script }] {
                assert_eq!(failure(run(pace, script).1), "the part is gone", "{pace:?}");
            }
        }
    }
}

/// Number of steps for which the hand tracks, before its method stalls, holds meanwhile, and tracks again.
const ENOUGH: u64 = 40;

/// What the recorder has been told of so far.
#[derive(Default)]
struct ThreadCounts {
    followed: AtomicU64,
    stale: AtomicU64,
    /// The hand has resumed after a hold.
    resumed: AtomicU64,
}

/// A method that once takes so long that the newest images become too old.
struct SlowMethod<'w, 'a>(Estimating<'a>, &'w ThreadCounts);

struct Kept<'w> {
    /// Since the hand tracks.
    moved: Vec<StepRecord>,
    counts: &'w ThreadCounts,
    /// Ends the run.
    interrupt: &'w AtomicBool,
}

impl Estimate<StepRecord> for SlowMethod<'_, '_> {
    type Observed = PairEstimate;

    fn moved(&mut self, step: &StepRecord) {
        self.0.moved(step);
    }

    fn look(&mut self, frame: Captured) -> Result<(Option<Percept>, PairEstimate)> {
        let begin = Instant::now();
        while of(&self.1.followed) >= ENOUGH && of(&self.1.stale) < ENOUGH {
            assert!(begin.elapsed() < HELD_UP, "the hand does not hold");
            std::thread::sleep(Duration::from_millis(1));
        }
        Estimate::<StepRecord>::look(&mut self.0, frame)
    }
}

impl Record<StepRecord, PairEstimate> for Kept<'_> {
    fn moved(&mut self, step: &StepRecord) {
        let has_followed = of(&self.counts.followed) >= ENOUGH;
        let has_rested = of(&self.counts.stale) >= ENOUGH;
        if has_followed {
            self.moved.push(*step);
        }
        if is_stale(step) {
            // On a slow machine images may be too old before the method stalls.
            if has_followed {
                count(&self.counts.stale);
            }
        } else if step.decision.state == State::Tracking {
            let counter = if has_rested { &self.counts.resumed } else { &self.counts.followed };
            if count(counter) >= ENOUGH && has_rested {
                self.interrupt.store(true, Ordering::SeqCst);
            }
        }
    }
}

fn is_stale(step: &StepRecord) -> bool {
    step.decision.found.contains(Condition::FrameStale)
}

/// While the method stalls the arm holds by the policy of stale frames, step by step, and resumes afterwards.
#[test]
fn an_arm_rests_while_its_method_takes_too_long() {
    // May fail by chance: a machine that stalls its threads repeatedly makes the hand hold repeatedly.
    programs_in_real_time_beside_others(|| {
        let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
        setup.pace = Pace::Live;
        setup.compared.clear();
        setup.leader = Leader::Geometric(setup.geometric.unwrap());
        setup.experiment.steps_mut().unwrap().lead_in_s = 1.0;
        let Parts { clock, camera, vs, tc, cell, experiment, marking, interrupt, .. } = wire(&setup).unwrap();
        let now = clock.now();
        let Vision { mut capturing, estimating } = Vision::new(&setup, (camera, cell, marking), &clock).unwrap();
        let mut moving = Moving::new(&setup, (vs, tc), &*experiment, now).unwrap();
        let counts = ThreadCounts::default();
        let mut slow = SlowMethod(estimating, &counts);
        let mut kept = Kept { moved: Vec::new(), counts: &counts, interrupt: &interrupt };
        // The recorder ends the run long before.
        let run_context = RunContext { setup: &setup, clock: &clock, duration: HELD_UP, interrupt: &interrupt };
        run_context.run((&mut capturing, &mut slow, &mut kept), &mut moving).0.unwrap();
        rests_while_stale(&kept);
    });
}

fn rests_while_stale(Kept { counts, moved, .. }: &Kept<'_>) {
    let why = moved.last().map(|step| &step.decision.why);
    assert!(of(&counts.resumed) >= ENOUGH, "{why:?}");
    let runs = moved.chunk_by(|a, b| is_stale(a) == is_stale(b)).filter(|run| is_stale(&run[0]));
    let stale = runs.max_by_key(|run| run.len()).unwrap();
    for step in stale {
        assert!(matches!(step.decision.state, State::Holding | State::Lost), "{}", step.decision.why);
    }
    let speed = stale[stale.len() - 1].vs_joints.velocity_rad_per_s.amax();
    assert!(speed < 1e-3, "the arm moves at {speed} rad/s");
}
