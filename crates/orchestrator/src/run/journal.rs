//! What is written down of control steps, beside the truth.

use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{Chain, smallest_singular_value};

use super::cell::SimulatedCell;
use super::commands::CommandSummary;
use super::log::{ControlSample, RunLog};
use super::looking::Looked;
use super::moving::Moved;
use super::strip::Strip;
use crate::config::setup::Setup;

/// How often progress is told, seconds of the experiment.
const PROGRESS_EVERY_S: f64 = 5.0;

/// What a run leaves behind.
pub struct Outcome {
    /// Everything written down.
    pub log: RunLog,
    /// Annotated pictures from moments of interest.
    pub strip: Strip,
}

/// Writes control steps down.
pub struct Journal {
    cell: SimulatedCell,
    chain: Chain,
    begin: MonotonicTime,
    duration_s: f64,
    next_progress_s: f64,
    log: RunLog,
}

impl Journal {
    /// An empty journal of an experiment with this duration that begins at `begin`.
    pub fn new(setup: &Setup, cell: SimulatedCell, (begin, duration_s): (MonotonicTime, f64), log: RunLog) -> Self {
        Self { cell, chain: setup.vs.chain.clone(), begin, duration_s, next_progress_s: 0.0, log }
    }

    /// Writes a step down, and where everything truly was: not longer ago than the joints of the simulation remember.
    pub fn note(&mut self, moved: &Moved) {
        let t_s = moved.at.seconds_since(self.begin);
        if let Some(note) = self.log.supervision.note(t_s, &moved.decision) {
            tracing::info!("{t_s:7.2} s  {}", note.why);
        }
        if t_s >= self.next_progress_s {
            self.next_progress_s += PROGRESS_EVERY_S;
            tracing::info!("{t_s:5.1} of {:.1} s  {}", self.duration_s, moved.decision.why);
        }
        let jacobian = self.chain.jacobian(&moved.vs_joints.position_rad);
        self.log.control.push(ControlSample {
            t_s,
            world_from_target: self.cell.world_from_target_at(moved.at),
            world_from_hand: self.cell.world_from_hand_at(moved.at),
            // Completed at the end of the run.
            world_from_hand_wanted: Pose::coincident(),
            world_from_hand_locked: Pose::coincident(),
            mode: moved.mode.to_string(),
            smallest_singular_value: smallest_singular_value(&jacobian),
        });
    }

    /// What is left behind. Before the first estimate nobody knew where on the target the model is: those samples are
    /// completed now.
    pub fn finish(mut self, setup: &Setup, looked: Looked, commands: [CommandSummary; 2]) -> Outcome {
        let Looked { leading, compared, pairs_lost, strip, lock } = looked;
        let places = lock.map(|lock| (lock.target_from_model, lock.target_from_model_found));
        let (wanted, locked) = places.unwrap_or_else(|| (Pose::coincident(), Pose::coincident()));
        let model_from_hand = setup.controller.model_from_hand_desired;
        for sample in &mut self.log.control {
            sample.world_from_hand_wanted = sample.world_from_target * wanted * model_from_hand;
            sample.world_from_hand_locked = sample.world_from_target * locked * model_from_hand;
        }
        let without_pictures = !setup.leader.needs_pictures();
        let log =
            RunLog { without_pictures, leading, compared, pairs_lost, lock, commands: commands.into(), ..self.log };
        Outcome { log, strip }
    }
}
