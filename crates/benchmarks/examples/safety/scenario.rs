//! One run of the simulation, drawn from its seed: the motion of the target, and the faults with their times.

use pb3dp_setup::setup::Carrier;
use pb3dp_sim::noise::{hash, unit};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig, StepExperimentConfig};

use crate::cameras;
use crate::faults::{Fault, Kind};
use crate::stalls;
use crate::workcell::Workcell;

/// Length of a run, virtual seconds.
pub const RUN_S: f64 = 20.0;
/// The hand has reached its pose by then if no fault occurs, seconds.
const LEAD_IN_S: f64 = 2.0;
/// No fault occurs before, seconds: a fault while the arms are being enabled keeps them disabled; other tests show it.
const FIRST_FAULT_S: f64 = 0.5;
/// The last fault occurs this long before the end, seconds, so that its consequences are recorded.
const LAST_FAULT_S: f64 = 3.0;

/// Share of the faults of estimates that the cameras cause.
const BY_CAMERA: f64 = 0.6;
/// Share of the runs in which the hand searches for a lost target.
const SEARCHES: f64 = 0.25;
/// Draws that existed before these two stay as they were.
const OTHER_DICE: u64 = 0xca3e_7a00_0000_0000;

/// Draws of the wide draw.
const WIDE_DICE: u64 = 0x51de_0000_0000_0000;
/// Share of the runs of the wide draw with an additional fault that the first draw does not have.
const MORE: f64 = 0.5;
/// Share of those runs with two faults at once.
const AT_ONCE: f64 = 0.3;
/// Faults at once begin within this time, seconds.
const AT_ONCE_S: f64 = 0.05;

/// Draws of the stalls.
const STALL_DICE: u64 = 0x57a1_1000_0000_0000;
/// Share of the runs with stalls.
const STALLS: f64 = 0.5;
/// Most stalls of a run.
const STALLS_MAX: usize = 3;

/// Name of the motion of a run that proves a safeguard.
pub const PROOF: &str = "proof";

/// Random numbers: the same seed gives the same ones on every machine.
pub struct Dice {
    seed: [u32; 2],
    count: u32,
}

impl Dice {
    /// The random numbers of one run.
    pub fn new(seed: u64) -> Self {
        Self { seed: [seed as u32, (seed >> 32) as u32], count: 0 }
    }

    /// 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.count += 1;
        unit(hash(&[self.seed[0], self.seed[1], self.count]))
    }

    /// Between two numbers.
    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.unit()
    }

    /// 0 to less than `count`.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count - 1)
    }

    /// One of these values.
    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    /// Plus or minus.
    pub fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }
}

/// The scenario of one run.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Its seed.
    pub seed: u64,
    /// Name of the motion, for tables.
    pub motion_name: &'static str,
    /// Motion of the target.
    pub motion: MotionConfig,
    /// What moves the target.
    pub carrier: Carrier,
    /// The faults in order of time.
    pub faults: Vec<Fault>,
    /// Duration of the run, seconds.
    pub run_s: f64,
    /// Whether an operator resets and resumes; otherwise the run ends with the first stop.
    pub has_person: bool,
    /// Whether the hand may search for a lost target.
    pub searches: bool,
    /// The workcell.
    pub workcell: Workcell,
}

impl Scenario {
    /// The scenario of this seed: that of the wide draw, in half of the runs with stalls.
    pub fn of(seed: u64) -> Self {
        let mut scenario = Self::wide(seed);
        let mut dice = Dice::new(seed ^ STALL_DICE);
        if dice.unit() < STALLS {
            for _ in 0..=dice.below(STALLS_MAX) {
                let from_s = dice.within(FIRST_FAULT_S, RUN_S - LAST_FAULT_S);
                scenario.faults.extend(stalls::draw(&mut dice, from_s));
            }
        }
        scenario.faults.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        scenario
    }

    /// The scenario of this seed in the wide draw: that of the first draw in another workcell, with further faults.
    pub fn wide(seed: u64) -> Self {
        let mut scenario = Self::first(seed);
        let mut dice = Dice::new(seed ^ WIDE_DICE);
        scenario.workcell = Workcell::draw(&mut dice);
        if dice.unit() < MORE {
            let from_s = dice.within(FIRST_FAULT_S, RUN_S - LAST_FAULT_S);
            scenario.faults.push(Fault::new(Kind::draw_wide(&mut dice), from_s, dice.within(0.1, 3.0)));
        }
        if dice.unit() < AT_ONCE {
            let (first, second) = (dice.below(scenario.faults.len()), dice.below(scenario.faults.len()));
            scenario.faults[second].from_s = scenario.faults[first].from_s + dice.within(0.0, AT_ONCE_S);
        }
        scenario.faults.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        scenario
    }

    /// The scenario of this seed in the first draw: the workcell of `configs/hil.toml`, exactly known.
    pub fn first(seed: u64) -> Self {
        let mut dice = Dice::new(seed);
        let (motion_name, motion, carrier) = motion(&mut dice);
        let count = 1 + dice.below(5);
        let mut faults: Vec<Fault> = (0..count)
            .map(|_| {
                let kind = Kind::draw(&mut dice);
                let from_s = dice.within(FIRST_FAULT_S, RUN_S - LAST_FAULT_S);
                // Half of the faults are short: mistakes hide where a fault is almost tolerated.
                let for_s = if dice.unit() < 0.5 { dice.within(0.01, 0.3) } else { dice.within(0.3, 3.0) };
                Fault::new(kind, from_s, for_s)
            })
            .collect();
        let mut other = Dice::new(seed ^ OTHER_DICE);
        let searches = other.unit() < SEARCHES;
        for fault in faults.iter_mut().filter(|fault| fault.kind.is_of_estimates()) {
            if other.unit() < BY_CAMERA {
                fault.kind = Kind::Camera(cameras::draw(&mut other));
            }
        }
        faults.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        let has_person = dice.unit() < 0.5;
        let workcell = Workcell::default();
        Self { seed, motion_name, motion, carrier, faults, run_s: RUN_S, has_person, searches, workcell }
    }
}

/// A target that oscillates by itself or on the other arm, slowly enough for the hand to follow.
#[cfg(feature = "disabled-guards")]
pub fn swing(carrier: Carrier, channel: Channel, amplitude: f64, period_s: f64) -> (MotionConfig, Carrier) {
    let axes = ExperimentAxes::TargetAtStart;
    (MotionConfig::Sine(SineConfig { channel, amplitude, period_s, periods: 100, lead_in_s: 1.0, axes }), carrier)
}

/// A target that moves out and back, by so many metres or radians in so much time.
#[cfg(feature = "disabled-guards")]
pub fn there_and_back(carrier: Carrier, channel: Channel, way: f64, move_s: f64) -> (MotionConfig, Carrier) {
    let motion = MotionConfig::Steps(StepExperimentConfig {
        channels: vec![channel],
        translation_m: if channel.is_rotation() { 0.1 } else { way },
        rotation_rad: if channel.is_rotation() { way } else { 0.1 },
        move_s,
        hold_s: 1.0,
        lead_in_s: 1.0,
        axes: ExperimentAxes::TargetAtStart,
    });
    (motion, carrier)
}

/// Motion of the target: on the other arm or by itself, slow enough for the hand to follow or too fast.
fn motion(dice: &mut Dice) -> (&'static str, MotionConfig, Carrier) {
    match dice.below(8) {
        0..3 => ("carried steps", steps(dice, (0.02, 0.1), (0.03, 0.35), (1.5, 3.0)), Carrier::Arm),
        3 => ("carried, quicker than the arms", steps(dice, (0.05, 0.15), (0.1, 0.5), (0.3, 0.8)), Carrier::Arm),
        4 => ("free sinusoid", sine(dice, (2.0, 8.0), (0.03, 0.15)), Carrier::Nothing),
        5 => ("free, quicker than the arm", sine(dice, (0.3, 1.5), (0.1, 0.3)), Carrier::Nothing),
        6 => ("teleports", steps(dice, (0.05, 0.5), (0.05, 1.0), (0.0, 0.0)), Carrier::Nothing),
        _ => ("leaves the view", steps(dice, (0.4, 0.8), (0.6, 1.2), (0.5, 3.0)), Carrier::Nothing),
    }
}

fn steps(dice: &mut Dice, way_m: (f64, f64), turn_rad: (f64, f64), move_s: (f64, f64)) -> MotionConfig {
    let channels = (0..3).map(|_| dice.pick(&Channel::ALL)).collect();
    MotionConfig::Steps(StepExperimentConfig {
        channels,
        translation_m: dice.within(way_m.0, way_m.1) * dice.sign(),
        rotation_rad: dice.within(turn_rad.0, turn_rad.1) * dice.sign(),
        move_s: dice.within(move_s.0, move_s.1),
        hold_s: dice.within(0.2, 2.0),
        lead_in_s: LEAD_IN_S,
        axes: ExperimentAxes::TargetAtStart,
    })
}

fn sine(dice: &mut Dice, period_s: (f64, f64), way_m: (f64, f64)) -> MotionConfig {
    let channel = dice.pick(&Channel::ALL);
    let way_m = dice.within(way_m.0, way_m.1);
    MotionConfig::Sine(SineConfig {
        channel,
        // At 500 mm a rotation moves the hand by half a metre per radian.
        amplitude: if channel.is_rotation() { 2.0 * way_m } else { way_m },
        period_s: dice.within(period_s.0, period_s.1),
        periods: 100,
        lead_in_s: LEAD_IN_S,
        axes: ExperimentAxes::TargetAtStart,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn a_seed_is_a_run_and_all_kinds_come() {
        let text = |seed| format!("{:?}", Scenario::of(seed));
        assert_eq!(text(7), text(7));
        assert_ne!(text(7), text(8));
        let first = Scenario::first(7);
        assert!(first.workcell.lag == [1.0; 2] && first.faults.len() <= 5, "the first draw is without change");
        let runs: Vec<_> = (0..2000).map(Scenario::of).collect();
        let kinds: BTreeSet<&str> = runs.iter().flat_map(|run| &run.faults).map(Fault::name).collect();
        assert_eq!(kinds.len(), Kind::COUNT + cameras::COUNT + stalls::NAMES.len(), "{kinds:?}");
        assert!((400..600).contains(&runs.iter().filter(|run| run.searches).count()));
        let motions: BTreeSet<&str> = runs.iter().map(|run| run.motion_name).collect();
        assert_eq!(motions.len(), 6);
        for run in &runs {
            let (stalls, others): (Vec<_>, Vec<_>) = run.faults.iter().partition(|fault| fault.stall.is_some());
            assert!(stalls.len() <= 2 * STALLS_MAX && (1..=6).contains(&others.len()));
            let wide = Scenario::wide(run.seed).faults;
            assert_eq!(format!("{others:?}"), format!("{wide:?}"), "the wide draw is without change");
            assert!(run.faults.iter().all(|fault| fault.from_s >= FIRST_FAULT_S && fault.from_s < RUN_S));
        }
    }
}
