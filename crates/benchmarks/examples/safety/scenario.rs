//! One run of the simulation, drawn from its seed: the motion of the target, and the faults with their times.

use pb3dp_setup::setup::Carrier;
use pb3dp_sim::noise::{hash, unit};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig, StepExperimentConfig};
use system_tests::safety::truth::TARGET_ARM;

use crate::cameras;
use crate::faults::{Fault, Kind};
use crate::restart::Restart;
use crate::stalls;
use crate::workcell::{Differences, Line, Start, Workcell};

/// Length of a run, virtual seconds.
pub const RUN_S: f64 = 20.0;
/// The hand has reached its pose by then if no fault occurs, seconds.
const LEAD_IN_S: f64 = 2.0;
/// No other fault than that of the enabling occurs before, seconds.
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

/// Draws of the starts.
const START_DICE: u64 = 0x57a2_7000_0000_0000;
/// Share of the runs in which both arms start elsewhere.
const ELSEWHERE: f64 = 0.5;
/// Share of the runs with friction, loads and a hand-eye error that the setup does not know.
const DIFFERS: f64 = 0.5;
/// Share of the runs with a fault while the arms are being enabled.
const ENABLING: f64 = 0.1;

/// Draws of the cells.
const CELL_DICE: u64 = 0xce11_0000_0000_0000;
/// Share of the runs whose lines have a key.
const KEYED: f64 = 0.3;
/// Share of these runs in which somebody changes, repeats or removes a record.
const TAMPERED: f64 = 0.4;
/// Share of the runs in which an arm with six axes carries the cameras.
const SIX_AXES: f64 = 0.2;
/// Share of the runs with a stall of the recorder.
const RECORDER_STALLS: f64 = 0.1;
/// Longest stall of the recorder, seconds: less than the control steps that wait for it, 10 s.
const RECORDER_STALL_MAX_S: f64 = 3.0;
/// Share of the runs in which the process of the host dies in addition to those of the wide draw.
const DIES: f64 = 0.05;
/// Share of the runs with a death in which a new host is started.
const RESTARTS: f64 = 0.9;

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

/// How a scenario is drawn. A later draw leaves the scenarios of an earlier one as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Draw {
    /// The workcell of `configs/hil.toml`, exactly known.
    First,
    /// That of the first draw in another workcell, with further faults.
    Wide,
    /// That of the wide draw, in half of the runs with stalls.
    Stalls,
    /// That with stalls; in half of the runs from other joint angles, in half with friction, loads and a hand-eye error, and in a
    /// tenth with a fault while the arms are being enabled.
    Starts,
    /// That with other starts; in three of ten runs the lines have a key, in a fifth an arm with six axes carries the cameras, in a tenth the
    /// recorder stalls, and most hosts that die are started anew.
    Cells,
}

impl Draw {
    /// The present draw.
    pub const PRESENT: Self = Self::Cells;
    /// All draws, the oldest one first.
    const ALL: [Self; 5] = [Self::First, Self::Wide, Self::Stalls, Self::Starts, Self::Cells];

    /// The draw with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|draw| draw.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Wide => "wide",
            Self::Stalls => "stalls",
            Self::Starts => "starts",
            Self::Cells => "cells",
        }
    }
}

/// The scenario of one run.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Its seed.
    pub seed: u64,
    /// How it was drawn.
    pub draw: Draw,
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
    /// How a host that has died is started anew; none if nobody does.
    pub restart: Option<Restart>,
}

impl Scenario {
    /// The scenario of this seed.
    pub fn of(draw: Draw, seed: u64) -> Self {
        let mut scenario = Self::first(seed);
        scenario.draw = draw;
        if draw >= Draw::Wide {
            scenario.widen(&mut Dice::new(seed ^ WIDE_DICE));
        }
        if draw >= Draw::Stalls {
            scenario.stall(&mut Dice::new(seed ^ STALL_DICE));
        }
        if draw >= Draw::Starts {
            scenario.start(&mut Dice::new(seed ^ START_DICE));
        }
        if draw >= Draw::Cells {
            scenario.cell(&mut Dice::new(seed ^ CELL_DICE));
        }
        scenario
    }

    fn widen(&mut self, dice: &mut Dice) {
        self.workcell = Workcell::draw(dice);
        if dice.unit() < MORE {
            let from_s = dice.within(FIRST_FAULT_S, RUN_S - LAST_FAULT_S);
            self.faults.push(Fault::new(Kind::draw_wide(dice), from_s, dice.within(0.1, 3.0)));
        }
        if dice.unit() < AT_ONCE {
            let (first, second) = (dice.below(self.faults.len()), dice.below(self.faults.len()));
            self.faults[second].from_s = self.faults[first].from_s + dice.within(0.0, AT_ONCE_S);
        }
        self.sort_faults();
    }

    fn stall(&mut self, dice: &mut Dice) {
        if dice.unit() < STALLS {
            for _ in 0..=dice.below(STALLS_MAX) {
                let from_s = dice.within(FIRST_FAULT_S, RUN_S - LAST_FAULT_S);
                self.faults.extend(stalls::draw(dice, from_s));
            }
        }
        self.sort_faults();
    }

    fn start(&mut self, dice: &mut Dice) {
        if dice.unit() < ELSEWHERE {
            self.workcell.start = Some(Start::draw(dice));
        }
        if dice.unit() < DIFFERS {
            self.workcell.differences = Some(Differences::draw(dice));
        }
        if dice.unit() < ENABLING {
            let from_s = dice.within(-cameras::LEAD_S, 0.0);
            self.faults.insert(0, Fault::new(Kind::draw_enabling(dice), from_s, dice.within(0.01, 1.0)));
        }
    }

    fn cell(&mut self, dice: &mut Dice) {
        let mut more = Vec::new();
        let mut add = |kind: Kind, dice: &mut Dice, longest_s: f64| {
            let from_s = dice.within(FIRST_FAULT_S, RUN_S - LAST_FAULT_S);
            more.push(Fault::new(kind, from_s, dice.within(0.1, longest_s)));
        };
        if dice.unit() < KEYED {
            self.workcell.settings.line = Line::Keyed;
            if dice.unit() < TAMPERED {
                add(Kind::draw_tampering(dice), dice, 0.2);
            }
        }
        if dice.unit() < RECORDER_STALLS {
            add(Kind::RecorderStalls, dice, RECORDER_STALL_MAX_S);
        }
        if dice.unit() < DIES {
            add(Kind::HostDies, dice, 0.2);
        }
        self.faults.extend(more);
        self.sort_faults();
        self.let_die_once();
        let restart = Restart::draw(dice);
        if dice.unit() < SIX_AXES {
            self.carry_with_six_axes();
        }
        let dies = self.faults.iter().any(|fault| matches!(fault.kind, Kind::HostDies));
        self.restart = (dies && dice.unit() < RESTARTS).then_some(restart);
    }

    /// An arm with six axes carries the cameras. It is simulated in the process: faults of arms and lines are those of the other arm, and it
    /// ends with the process.
    fn carry_with_six_axes(&mut self) {
        self.workcell.settings.has_six_axes = true;
        self.faults.retain(|fault| !matches!(fault.kind, Kind::HostDies));
        self.faults.iter_mut().for_each(|fault| fault.kind.set_arm(TARGET_ARM));
        if self.faults.is_empty() {
            self.faults.push(Fault::new(Kind::NoPose, FIRST_FAULT_S, 1.0));
        }
    }

    /// Leaves only the first death of the host.
    fn let_die_once(&mut self) {
        let mut has_died = false;
        self.faults.retain(|fault| !matches!(fault.kind, Kind::HostDies) || !std::mem::replace(&mut has_died, true));
    }

    fn sort_faults(&mut self) {
        self.faults.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    }

    /// Whether a fault begins while the arms are being enabled.
    pub fn disturbs_enabling(&self) -> bool {
        self.faults.iter().any(Fault::is_of_enabling)
    }

    /// The same run without stalls of the recorder, if it has any.
    pub fn without_recorder_stalls(&self) -> Option<Self> {
        let is_stall = |fault: &Fault| matches!(fault.kind, Kind::RecorderStalls);
        self.faults.iter().any(is_stall).then(|| {
            let faults = self.faults.iter().filter(|fault| !is_stall(fault)).cloned().collect();
            Self { faults, ..self.clone() }
        })
    }

    fn first(seed: u64) -> Self {
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
        let has_person = dice.unit() < 0.5;
        let workcell = Workcell::default();
        let draw = Draw::First;
        let run_s = RUN_S;
        let mut scenario = Self {
            seed,
            draw,
            motion_name,
            motion,
            carrier,
            faults,
            run_s,
            has_person,
            searches,
            workcell,
            restart: None,
        };
        scenario.sort_faults();
        scenario
    }
}

/// A target that oscillates by itself or on the other arm, slowly enough for the hand to follow.
pub fn swing(carrier: Carrier, channel: Channel, amplitude: f64, period_s: f64) -> (MotionConfig, Carrier) {
    let axes = ExperimentAxes::TargetAtStart;
    (MotionConfig::Sine(SineConfig { channel, amplitude, period_s, periods: 100, lead_in_s: 1.0, axes }), carrier)
}

/// A target that moves out and back, by so many metres or radians in so much time.
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
        let newest = |seed| Scenario::of(Draw::PRESENT, seed);
        let text = |seed| format!("{:?}", newest(seed));
        assert_eq!(text(7), text(7));
        assert_ne!(text(7), text(8));
        let first = Scenario::of(Draw::First, 7);
        assert!(first.workcell.lag == [1.0; 2] && first.faults.len() <= 5, "the first draw is without change");
        let runs: Vec<_> = (0..2000).map(newest).collect();
        let kinds: BTreeSet<&str> = runs.iter().flat_map(|run| &run.faults).map(Fault::name).collect();
        assert_eq!(kinds.len(), Kind::COUNT + cameras::COUNT + stalls::NAMES.len(), "{kinds:?}");
        assert!((900..1100).contains(&runs.iter().filter(|run| run.workcell.start.is_some()).count()));
        assert!((150..250).contains(&runs.iter().filter(|run| run.disturbs_enabling()).count()));
        assert!((500..700).contains(&runs.iter().filter(|run| run.workcell.settings.line == Line::Keyed).count()));
        assert!((100..300).contains(&runs.iter().filter(|run| run.restart.is_some()).count()));
        assert!((300..500).contains(&runs.iter().filter(|run| run.workcell.settings.has_six_axes).count()));
        assert!((400..600).contains(&runs.iter().filter(|run| run.searches).count()));
        let motions: BTreeSet<&str> = runs.iter().map(|run| run.motion_name).collect();
        assert_eq!(motions.len(), 6);
        for run in runs.iter().map(|run| Scenario::of(Draw::Stalls, run.seed)) {
            let (stalls, others): (Vec<_>, Vec<_>) = run.faults.iter().partition(|fault| fault.stall.is_some());
            assert!(stalls.len() <= 2 * STALLS_MAX && (1..=6).contains(&others.len()));
            let wide = Scenario::of(Draw::Wide, run.seed).faults;
            assert_eq!(format!("{others:?}"), format!("{wide:?}"), "the wide draw is without change");
            assert!(run.faults.iter().all(|fault| fault.from_s >= FIRST_FAULT_S && fault.from_s < RUN_S));
        }
    }
}
