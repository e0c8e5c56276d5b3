//! A host that died is started anew: the operator finds both arms latched, resets them, and starts the program again.

use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_middleware::StartPose;
use pb3dp_kinematics::JointVector;
use pb3dp_setup::setup::Setup;
use pb3dp_wiring::reset_standing::reset_standing;
use pb3dp_wiring::{Wired, wire_cell_in};
use system_tests::safety::truth::ARM_NAMES;

use crate::recorder::lock;
use crate::rig::{LOOK, Stage, setup_of};
use crate::scenario::Dice;

/// The operator gives up after so many attempts: a cause that is still present, or a gateway that does not answer.
const ATTEMPTS_MAX: u32 = 8;

/// What the operator does after the death of the host.
#[derive(Clone, Copy, Debug)]
pub struct Restart {
    /// From the death to the first attempt to start a new host, seconds.
    after_s: f64,
    /// Time before each further action, seconds.
    thinks_s: f64,
    /// Whether the system closes the connections of the dead process: not if the computer loses power.
    pub is_closed: bool,
    /// An arm that the operator forgets to reset before the second attempt.
    forgets: Option<usize>,
    /// Whether the new run begins where the arms are; otherwise the setup states a start that they have left.
    begins_here: bool,
}

impl Restart {
    /// Draws what the operator does: in a quarter of the runs the new host comes before the gateways have missed the first one.
    pub fn draw(dice: &mut Dice) -> Self {
        const SOON_S: (f64, f64) = (0.005, 0.15);
        const LATER_S: (f64, f64) = (0.15, 2.0);
        let (from_s, to_s) = if dice.unit() < 0.25 { SOON_S } else { LATER_S };
        Self {
            after_s: dice.within(from_s, to_s),
            thinks_s: dice.within(0.05, 0.4),
            is_closed: dice.unit() < 0.7,
            forgets: if dice.unit() < 0.3 { Some(dice.below(2)) } else { None },
            begins_here: dice.unit() < 0.8,
        }
    }

    /// Waits until a new host is connected to both arms, which it leaves disabled, with the time of the run for which the faults of its
    /// camera are planned, seconds; none if the operator gives up before the end of the run.
    ///
    /// # Errors
    /// If its setup cannot be built.
    pub fn next_host(&self, stage: &Stage<'_>) -> Result<Option<(Setup, f64, Wired)>> {
        stage.wait(self.after_s);
        for attempt in 0..ATTEMPTS_MAX {
            let planned_s = stage.t_s();
            let setup = self.setup(stage, planned_s)?;
            match connected(stage, &setup) {
                Ok(wired) => return Ok(Some((setup, planned_s, wired))),
                Err(refusal) => stage.note(&format!("a new host is refused: {refusal:#}")),
            }
            for (arm, name) in ARM_NAMES.into_iter().enumerate() {
                if attempt > 0 || self.forgets != Some(arm) {
                    stage.wait(self.thinks_s);
                    reset(stage, &setup, (arm, name));
                }
            }
            stage.wait(self.thinks_s);
            if stage.t_s() > stage.scenario.run_s {
                break;
            }
        }
        Ok(None)
    }

    fn setup(&self, stage: &Stage<'_>, planned_s: f64) -> Result<Setup> {
        let mut setup = setup_of(stage.base, stage.scenario, planned_s)?;
        if self.begins_here {
            let arms = [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc];
            for (arm, start_rad) in arms.into_iter().zip(stage.joints_rad()) {
                arm.start_rad = start_rad;
                if let StartPose::Near { position_rad, .. } = &mut arm.limiter.start {
                    *position_rad = start_rad;
                }
            }
        }
        Ok(setup)
    }
}

fn connected(stage: &Stage<'_>, setup: &Setup) -> Result<Wired> {
    wire_cell_in(setup, &stage.world, |cell, start| {
        stage.scenario.workcell.change_again(cell);
        cell.free_target.clone_from(&stage.cell.free_target);
        Ok(setup.experiment.motion.begin_at(start)?)
    })
}

/// The operator resets an arm by `pb3dp arm reset`.
fn reset(stage: &Stage<'_>, setup: &Setup, (arm, name): (usize, &str)) {
    let time = stage.world.time.as_ref().context("no simulated time");
    let done = time.and_then(|time| reset_standing(setup, (&stage.world.arms[arm], time)));
    match done {
        Ok(()) => lock(&stage.recorder).reset_alone(name, stage.clock.now()),
        Err(refusal) => stage.note(&format!("{name}: reset refused: {refusal:#}")),
    }
}

impl Stage<'_> {
    /// Waits while the record goes on.
    fn wait(&self, for_s: f64) {
        let until = self.clock.now() + Duration::from_secs_f64(for_s);
        while self.clock.now() < until {
            self.clock.sleep_until(until.min(self.clock.now() + LOOK));
            lock(&self.recorder).catch_up(self.clock.now());
        }
    }

    /// Seconds since the run began.
    fn t_s(&self) -> f64 {
        lock(&self.recorder).t_s(self.clock.now())
    }

    fn note(&self, text: &str) {
        lock(&self.recorder).note(self.clock.now(), text.to_owned());
    }

    /// Present joint angles of both arms.
    fn joints_rad(&self) -> [JointVector; 2] {
        let now: MonotonicTime = self.clock.now();
        lock(&self.recorder).joints_rad(now).map(JointVector::from)
    }
}
