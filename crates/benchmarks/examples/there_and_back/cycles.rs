//! Repeated cycles, and the remaining position error after each.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use nalgebra::Vector3;
use pb3dp_allocation_count::held_bytes;
use pb3dp_cell::cell::SimulatedCell;
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::halves::{Record, RunContext};
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::parts::Parts;
use pb3dp_cell::vision::Vision;
use pb3dp_geometry::MonotonicTime;
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::Channel;
use pb3dp_wiring::wire;

/// A move out, a hold, a move back, a hold.
const MOVE_S: f64 = 1.5;
const HOLD_S: f64 = 1.5;
const CYCLE_S: f64 = 2.0 * (MOVE_S + HOLD_S);
/// Before the first cycle.
const LEAD_IN_S: f64 = 3.0;
/// The end of a hold, over which the hand position is averaged, seconds.
const AVERAGED_S: f64 = 0.5;
/// Channels in turn, each once per round.
const CHANNELS: [Channel; 6] = [Channel::X, Channel::Y, Channel::Z, Channel::Rx, Channel::Ry, Channel::Rz];
/// Number of cycles compared at the start and at the end: whole rounds, because each axis leaves a different error.
const COMPARED: usize = 2 * CHANNELS.len();
/// Number of cycles until all rings and buffers have their final size.
const SETTLING: usize = 8;
/// Minimum number of cycles for a comparison.
pub const CYCLES_MIN: usize = 2 * COMPARED;
/// Largest drift of the hand that the noise does not explain, mm.
const DRIFT_MAX_MM: f64 = 0.1;
/// Largest growth of the heap after settling in a whole soak, bytes: less than one sample of a joint per cycle.
const GROWTH_MAX_BYTES: usize = 16 * 1024;

/// Results of the cycles.
#[derive(Debug, Default)]
pub struct Figures {
    /// Position of the hand after each cycle, in `world`, relative to the first one, mm.
    returned_mm: Vec<Vector3<f64>>,
    /// Bytes held on the heap then.
    held: Vec<usize>,
}

impl Figures {
    /// For this number of cycles; the vectors are allocated here, so that recording does not count as growth.
    fn of(cycles: usize) -> Self {
        Self { returned_mm: Vec::with_capacity(cycles), held: Vec::with_capacity(cycles) }
    }

    /// Records the end of a cycle.
    pub fn push(&mut self, returned_mm: [f64; 3], held: usize) {
        self.returned_mm.push(Vector3::from(returned_mm));
        self.held.push(held);
    }

    /// Number of cycles.
    pub fn cycles(&self) -> usize {
        self.returned_mm.len()
    }

    /// Mean of the last cycles minus mean of the first ones, mm, and its standard deviation from the noise of single
    /// cycles: from the differences of consecutive cycles along or about the same axis.
    fn drift_mm(&self) -> (f64, f64) {
        let all = &self.returned_mm;
        let mean = |some: &[Vector3<f64>]| some.iter().sum::<Vector3<f64>>() / some.len() as f64;
        let drift = mean(&all[all.len() - COMPARED..]) - mean(&all[..COMPARED]);
        let next = all.iter().zip(&all[CHANNELS.len()..]);
        let variance =
            next.map(|(a, b)| (a - b).norm_squared() / 2.0).sum::<f64>() / (all.len() - CHANNELS.len()) as f64;
        (drift.norm(), (2.0 * variance / COMPARED as f64).sqrt())
    }

    /// Growth of the heap from the end of settling to the end, bytes.
    fn growth(&self) -> usize {
        let settled = self.held[SETTLING.min(self.held.len() - 1)];
        self.held[self.held.len() - 1].saturating_sub(settled)
    }

    /// Lines for a terminal.
    pub fn text(&self) -> String {
        let (drift, sigma) = self.drift_mm();
        let farthest = self.returned_mm.iter().map(|p| p.norm()).fold(0.0, f64::max);
        format!(
            "{} cycles there and back: the last {COMPARED} end {drift:.4} mm from the first {COMPARED} (noise of that: {sigma:.4} mm), \
             farthest of all {farthest:.3} mm from the first\nheap: {} bytes at the end, {} more than after {SETTLING} cycles",
            self.cycles(),
            self.held.last().unwrap_or(&0),
            self.growth()
        )
    }

    /// # Errors
    /// Drift, or a growing heap.
    pub fn judge(&self) -> Result<()> {
        ensure!(self.cycles() >= CYCLES_MIN, "{} cycles are too few: at least {CYCLES_MIN} are needed", self.cycles());
        let (drift, sigma) = self.drift_mm();
        ensure!(
            drift <= DRIFT_MAX_MM + 3.0 * sigma,
            "the hand returns with a drift of {drift:.3} mm; allowed are {DRIFT_MAX_MM} mm and 3 x {sigma:.3} mm of noise"
        );
        let growth = self.growth();
        ensure!(growth <= GROWTH_MAX_BYTES, "the heap has grown by {growth} bytes; allowed are {GROWTH_MAX_BYTES}");
        Ok(())
    }
}

/// Follows the target for this many minutes; `tell` gets a line for each cycle.
///
/// # Errors
/// If a part fails, or the hand does not follow the target.
pub fn repeat(setup: &Setup, minutes: f64, tell: impl FnMut(&str)) -> Result<Figures> {
    let cycles = (minutes * 60.0 / CYCLE_S).round() as usize;
    ensure!(cycles >= CYCLES_MIN, "{minutes} minutes are {cycles} cycles: at least {CYCLES_MIN} are needed");
    let mut setup = setup.clone();
    let steps = setup.experiment.steps_mut().context("the experiment of the setup does not go out and back")?;
    steps.channels = CHANNELS.into_iter().cycle().take(cycles).collect();
    (steps.move_s, steps.hold_s, steps.lead_in_s) = (MOVE_S, HOLD_S, LEAD_IN_S);
    let Parts { clock, camera, vs, tc, cell, experiment, marking, interrupt, .. } = wire(&setup)?;
    let now = clock.now();
    let mut vision = Vision::new(&setup, (camera, cell.clone(), marking), &clock)?;
    let mut moving = Moving::new(&setup, (vs, tc), &*experiment, now)?;
    let mut vision_watcher =
        VisionWatcher { cell, begin: now, figures: Figures::of(cycles), at_end: AtEnd::default(), tell };
    let duration = Duration::from_secs_f64(LEAD_IN_S + CYCLE_S * cycles as f64 + 0.1);
    let run_context = RunContext { setup: &setup, clock: &clock, duration, interrupt: &interrupt };
    run_context.run_in_lockstep((&mut vision.capturing, &mut vision.estimating, &mut vision_watcher), &mut moving)?;
    Ok(vision_watcher.figures)
}

/// Collects the results at the end of a cycle.
#[derive(Default)]
struct AtEnd {
    sum_mm: Vector3<f64>,
    count: f64,
    first_mm: Option<Vector3<f64>>,
}

/// Observer that records only the hand position at the end of each cycle.
struct VisionWatcher<T> {
    cell: SimulatedCell,
    begin: MonotonicTime,
    figures: Figures,
    at_end: AtEnd,
    tell: T,
}

impl<T: FnMut(&str)> Record<StepRecord, PairEstimate> for VisionWatcher<T> {
    fn begin_at(&mut self, begin: MonotonicTime) {
        self.cell.begin_at(begin);
        self.begin = begin;
    }

    fn moved(&mut self, moved: &StepRecord) {
        let in_cycle_s = moved.at.seconds_since(self.begin) - LEAD_IN_S - CYCLE_S * self.figures.cycles() as f64;
        // A hand that does not follow the target has not returned.
        if in_cycle_s < CYCLE_S - AVERAGED_S || !moved.decision.state.is_moving() {
            return;
        }
        let AtEnd { sum_mm, count, first_mm } = &mut self.at_end;
        *sum_mm += self.cell.world_from_hand_at(moved.at).translation_m() * 1e3;
        *count += 1.0;
        if in_cycle_s >= CYCLE_S - 1e-6 {
            let mean_mm = *sum_mm / *count;
            let returned_mm = mean_mm - *first_mm.get_or_insert(mean_mm);
            (*sum_mm, *count) = (Vector3::zeros(), 0.0);
            self.figures.push(returned_mm.into(), held_bytes());
            let cycle = self.figures.cycles();
            (self.tell)(&format!("cycle {cycle}: {:.4} mm, {} bytes", returned_mm.norm(), held_bytes()));
        }
    }
}
