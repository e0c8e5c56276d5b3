//! Failures that are never consecutive, and slow drift: each stops the arms. The whole program in virtual time, with arms that are
//! emulated byte by byte.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_cell::cell::{FreeTarget, SimulatedCell};
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::halves::{Mover, Record, RunContext};
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::percept::Percept;
use pb3dp_cell::vision::Vision;
use pb3dp_geometry::MonotonicTime;
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig};
use pb3dp_wiring::{Wired, wire_cell};

/// Both arms are enabled and the hand follows by then, seconds.
const FROM_S: f64 = 4.0;
/// More than any time between two faults, seconds.
const NEVER_AGAIN_S: f64 = 1e3;

/// Faults of an emulated arm, as lines of docs/mock-arm.md, in turn.
struct Faults {
    /// 0: the arm that carries the cameras.
    arm: usize,
    lines: &'static [&'static str],
    every_s: f64,
}

/// The end of a run: why it ended early, and when, seconds.
struct Ran {
    ended: Option<String>,
    ended_s: f64,
}

fn setup() -> Setup {
    crate::disturbed::setup(MotionConfig::Sine(SineConfig {
        channel: Channel::Y,
        amplitude: 0.05,
        period_s: 6.0,
        periods: 100,
        lead_in_s: 0.0,
        axes: ExperimentAxes::TargetAtStart,
    }))
    .unwrap()
}

fn ran(arm: usize, lines: &'static [&'static str], every_s: f64, for_s: f64) -> Ran {
    let setup = setup();
    let Wired { parts, world, .. } = wire_cell(&setup, |cell, start| {
        let motion = setup.experiment.motion.begin_at(start)?;
        cell.free_target = Some(FreeTarget::new(Arc::clone(&motion)));
        Ok(motion)
    })
    .unwrap();
    let (clock, cell) = (Arc::clone(&parts.clock), parts.cell.clone());
    let sees = (parts.camera, parts.cell, parts.marking);
    let mut vision = Vision::new(&setup, sees, &parts.clock).unwrap();
    let moving = Moving::new(&setup, (parts.vs, parts.tc), &*parts.experiment, clock.now()).unwrap();
    let mut target = FreeToMove(cell);
    let mut faulty = Faulty {
        inner: moving,
        faults: Faults { arm, lines, every_s },
        ends: world.arms.into_iter().map(|arm| arm.end).collect(),
        given: 0,
        begin: clock.now(),
        ended_s: 0.0,
    };
    let interrupt = AtomicBool::new(false);
    let duration = Duration::from_secs_f64(FROM_S + for_s);
    let run_context = RunContext { setup: &setup, clock: &clock, duration, interrupt: &interrupt };
    let ended = run_context
        .run_in_lockstep((&mut vision.capturing, &mut vision.estimating, &mut target), &mut faulty)
        .err()
        .map(|error| format!("{error:#}"));
    Ran { ended, ended_s: faulty.ended_s }
}

/// The target that moves by itself.
struct FreeToMove(SimulatedCell);

impl Record<StepRecord, PairEstimate> for FreeToMove {
    fn begin_at(&mut self, begin: MonotonicTime) {
        self.0.begin_at(begin);
    }
}

/// The motion half, with the faults from [`FROM_S`] on.
struct Faulty<'a> {
    inner: Moving<'a>,
    faults: Faults,
    ends: Vec<VirtualEnd>,
    /// Number of faults that were given.
    given: u32,
    begin: MonotonicTime,
    ended_s: f64,
}

impl Mover for Faulty<'_> {
    type Step = StepRecord;

    fn enable(&mut self) -> anyhow::Result<bool> {
        self.inner.enable()
    }

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
        self.inner.begin_at(begin);
    }

    fn observe(&mut self, percept: Percept, now: MonotonicTime) {
        self.inner.observe(percept, now);
    }

    fn step(&mut self, now: MonotonicTime) -> anyhow::Result<StepRecord> {
        self.ended_s = now.seconds_since(self.begin);
        let Faults { arm, lines, every_s } = self.faults;
        while self.ended_s >= FROM_S + f64::from(self.given) * every_s {
            self.ends[arm].command_line(lines[self.given as usize % lines.len()])?;
            self.given += 1;
        }
        self.inner.step(now)
    }

    fn stop(&mut self) -> anyhow::Result<()> {
        self.inner.stop()
    }
}

/// The run ended with this text, and within this time after the first fault.
fn stopped(ran: &Ran, text: &str, within_s: f64) {
    let ended = ran.ended.as_deref().unwrap_or("nothing stopped the arms");
    assert!(ended.contains(text), "{ended}");
    let after_s = ran.ended_s - FROM_S;
    println!("{after_s:.2} s: {ended}");
    assert!(after_s <= within_s, "only after {after_s} s: {ended}");
}

#[test]
fn two_replies_of_three_lost_for_ever_latch_within_half_a_second() {
    for arm in [0, 1] {
        stopped(&ran(arm, &["line drop 2"], 0.03, 5.0), "of the last 100 exchanges", 0.5);
        stopped(&ran(arm, &["line corrupt 1"], 0.02, 5.0), "of the last 100 exchanges", 0.6);
    }
}

/// One reply of ten: the arm goes on, as an arm at a noisy line should.
#[test]
fn one_reply_of_ten_lost_for_ever_stops_nothing() {
    let ran = ran(0, &["line drop 1"], 0.1, 5.0);
    assert_eq!(ran.ended, None);
}

#[test]
fn every_second_encoder_sample_wrong_latches_within_a_quarter_of_a_second() {
    for arm in [0, 1] {
        let ran = ran(arm, &["jump 3 0.1rad", "jump 3 -0.1rad"], 0.01, 5.0);
        stopped(&ran, "axis 3 seems to have moved", 0.25);
    }
}

/// The arm with the target holds.
#[test]
fn a_creep_of_an_arm_that_holds_is_found() {
    for (line, within_s) in [(&["runaway 2 0.001rad/s"], 60.0), (&["runaway 2 0.0015rad/s"], 20.0)] {
        stopped(&ran(1, line, NEVER_AGAIN_S, 40.0), "although the arm is commanded to hold", within_s);
    }
    let ran = ran(1, &["runaway 2 0.0002rad/s"], NEVER_AGAIN_S, 60.0);
    assert_eq!(ran.ended, None, "half of what is forgotten");
}
