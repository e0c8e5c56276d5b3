//! The record of a replayed run for its report, as the run itself keeps it.

use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;
use pb3dp_bag::run_messages::RunBegin;
use pb3dp_cell::cell::{ArmSite, FreeTarget, JointSource, SimulatedCell};
use pb3dp_cell::channels::Plan;
use pb3dp_cell::journal::{Journal, Outcome};
use pb3dp_cell::log::RunLog;
use pb3dp_cell::moving::Moved;
use pb3dp_cell::noting::{EstimateRecorder, PairEstimate};
use pb3dp_cell::spectator::RunEnd;
use pb3dp_cell::strip::Strip;
use pb3dp_geometry::frames::{Target, World};
use pb3dp_geometry::{MonotonicTime, Pose, Twist};
use pb3dp_kinematics::JointState;
use pb3dp_setup::setup::{Carrier, Setup};
use pb3dp_sim::trajectory::{Mark, Trajectory};

use crate::exact::marking;

/// Keeps steps and estimates for the report.
pub struct Reporting<'a> {
    journal: Journal,
    noting: EstimateRecorder<'a>,
    cell: SimulatedCell,
    begin: MonotonicTime,
    /// Measured joints of both arms, for the cell.
    joints: [Sender<JointState>; 2],
    pushed: Option<Seen>,
}

impl<'a> Reporting<'a> {
    /// Nothing is kept yet.
    ///
    /// # Errors
    /// As [`EstimateRecorder::new`].
    pub fn new(setup: &'a Setup, experiment: &Arc<dyn Trajectory>, run: &RunBegin) -> Result<Self> {
        let begin = MonotonicTime::from_nanos(run.begin_nanos);
        let arms = [&setup.rig.arms.vs, &setup.rig.arms.tc];
        let [(vs, to_vs), (tc, to_tc)] = arms.map(|arm| {
            let (give, samples) = channel();
            (ArmSite::of(arm, JointSource::measured(samples, arm.start_rad)), give)
        });
        let mut cell = SimulatedCell::of(setup, [vs, tc]);
        if let Some(world) = &setup.world {
            cell.follow_truth(&world.truth);
        }
        let start = experiment.pose_at(0.0);
        let pushed = (setup.experiment.carrier == Carrier::Person).then(|| Seen::from(start));
        cell.free_target = match setup.experiment.carrier {
            Carrier::Arm => None,
            Carrier::Nothing => Some(FreeTarget::new(Arc::clone(experiment))),
            Carrier::Person => pushed.clone().map(|seen| FreeTarget::new(Arc::new(seen))),
        };
        cell.begin_at(begin);
        let marks = if run.is_person { Vec::new() } else { experiment.marks().to_vec() };
        let strip = Strip::of(setup.experiment.moments(&marks));
        let log = RunLog { marks, ..RunLog::default() };
        let plan = Plan::of(&setup.experiment.motion, &**experiment);
        let mut noting = EstimateRecorder::new(setup, marking(&run.marking)?, (strip, begin), None)?;
        noting.begin_at(begin);
        let journal = Journal::new(setup, cell.clone(), (begin, experiment.duration_s()), (log, plan)).quiet();
        Ok(Self { journal, noting, cell, begin, joints: [to_vs, to_tc], pushed })
    }

    /// Keeps an estimate.
    ///
    /// # Errors
    /// As [`EstimateRecorder::note`].
    pub fn seen(&mut self, seen: &PairEstimate) -> Result<()> {
        let at = seen.captured.frame.at;
        if let (Some(pushed), Some(truth)) = (&self.pushed, &seen.captured.cam_left_from_target) {
            pushed.push(at.seconds_since(self.begin), self.cell.world_from_cam_left_at(at) * *truth);
        }
        self.noting.note(seen)
    }

    /// Keeps a control step.
    pub fn moved(&mut self, moved: &Moved) {
        let tc = JointState { at: moved.at, position_rad: moved.arms[1].position_rad, ..moved.vs_joints };
        for (to_cell, joints) in self.joints.iter().zip([moved.vs_joints, tc]) {
            // The cell is ours.
            let _ = to_cell.send(joints);
        }
        self.journal.note(moved);
    }

    /// The record; `end` is missing if the recording was broken off.
    pub fn finish(self, end: Option<&RunEnd>) -> Outcome {
        let end = end.cloned().unwrap_or_default();
        self.journal.finish(self.noting.finish(end.pairs_lost), end.commands)
    }
}

/// Where a target that a person pushes was seen.
#[derive(Clone)]
struct Seen(Arc<Mutex<Vec<(f64, Pose<World, Target>)>>>);

impl Seen {
    fn from(start: Pose<World, Target>) -> Self {
        Self(Arc::new(Mutex::new(vec![(0.0, start)])))
    }

    fn push(&self, t_s: f64, pose: Pose<World, Target>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push((t_s, pose));
    }
}

impl Trajectory for Seen {
    fn pose_at(&self, t_s: f64) -> Pose<World, Target> {
        let places = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let last = places.iter().rev().find(|(at_s, _)| *at_s <= t_s);
        last.or(places.first()).map_or(Pose::coincident(), |(_, pose)| *pose)
    }

    fn twist_at(&self, _t_s: f64) -> Twist<World> {
        Twist::zero()
    }

    fn marks(&self) -> &[Mark] {
        &[]
    }

    fn duration_s(&self) -> f64 {
        0.0
    }
}
