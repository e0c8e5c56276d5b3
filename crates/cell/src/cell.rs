//! The simulated cell: two arms that stand in one world, one with the cameras, one with the target.

use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use pb3dp_geometry::frames::{Base, CamLeft, Flange, Hand, Target, World};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{Chain, JointState, JointVector};
use pb3dp_servo::{JointHistory, NotInHistory};
use pb3dp_sim::joint_dynamics::JointPlant;
use pb3dp_sim::scene::{PoseSource, ScenePoses};
use pb3dp_sim::trajectory::Trajectory;

/// Gap between measured joints up to which they are interpolated, and how long the last ones are continued, seconds.
pub(super) const JOINT_GAP_MAX_S: f64 = 0.1;
/// Measured joints that are kept: two seconds at 500 Hz.
const JOINTS_KEPT: usize = 1000;

/// Where the joints of an arm are known from.
#[derive(Clone)]
pub struct JointSource(Source);

#[derive(Clone)]
enum Source {
    Plant(Arc<Mutex<JointPlant>>),
    Measured(Arc<Mutex<MeasuredJoints>>),
}

/// Joints as they were measured.
struct MeasuredJoints {
    samples: Receiver<JointState>,
    history: JointHistory,
    start_rad: JointVector,
}

impl JointSource {
    /// Simulated joints, shared with the arm backend: exact.
    pub fn plant(plant: Arc<Mutex<JointPlant>>) -> Self {
        Self(Source::Plant(plant))
    }

    /// Joints as they are measured; before the first measurement they are at `start_rad`.
    pub fn measured(samples: Receiver<JointState>, start_rad: JointVector) -> Self {
        let history = JointHistory::new(JOINTS_KEPT, JOINT_GAP_MAX_S);
        Self(Source::Measured(Arc::new(Mutex::new(MeasuredJoints { samples, history, start_rad }))))
    }

    /// The simulated joints, if they are.
    pub fn simulated(&self) -> Option<&Mutex<JointPlant>> {
        match &self.0 {
            Source::Plant(plant) => Some(plant),
            Source::Measured(_) => None,
        }
    }

    /// Joint angles at `at`. Simulated joints are advanced to it if need be, and remember their past for a second; measured ones
    /// are interpolated, and the newest ones where that is not possible.
    fn position_rad_at(&self, at: MonotonicTime) -> JointVector {
        match &self.0 {
            Source::Plant(plant) => {
                let mut plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
                plant.advance_to(at);
                plant.position_at(at).unwrap_or_else(|| plant.state().position_rad)
            }
            Source::Measured(measured) => {
                let MeasuredJoints { samples, history, start_rad } =
                    &mut *measured.lock().unwrap_or_else(PoisonError::into_inner);
                while let Ok(sample) = samples.try_recv() {
                    history.push(sample);
                }
                let newest = || history.newest().map_or(*start_rad, |sample| sample.position_rad);
                history.position_at(at).unwrap_or_else(|_| newest())
            }
        }
    }

    /// Whether the joints at a time are not forgotten yet.
    fn remembers(&self, at: MonotonicTime) -> bool {
        match &self.0 {
            Source::Plant(plant) => {
                let plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
                at > plant.state().at || plant.position_at(at).is_some()
            }
            Source::Measured(measured) => {
                let measured = measured.lock().unwrap_or_else(PoisonError::into_inner);
                measured.history.newest().is_none() || measured.history.position_at(at) != Err(NotInHistory::TooOld)
            }
        }
    }
}

/// One arm in the cell.
#[derive(Clone)]
pub struct ArmSite {
    /// Its kinematics.
    pub chain: Chain,
    /// Where it stands.
    pub world_from_base: Pose<World, Base>,
    /// Its joints.
    pub joints: JointSource,
}

impl ArmSite {
    /// True pose of the flange at `at`.
    pub fn world_from_flange_at(&self, at: MonotonicTime) -> Pose<World, Flange> {
        self.world_from_base * self.chain.forward(&self.joints.position_rad_at(at))
    }
}

/// Both arms with what they carry: the exact truth of the simulation.
#[derive(Clone)]
pub struct SimulatedCell {
    /// The arm that carries the cameras.
    pub vs: ArmSite,
    /// The arm that carries the target.
    pub tc: ArmSite,
    /// Where the servoed hand is on the first arm.
    pub flange_from_hand: Pose<Flange, Hand>,
    /// Where the left camera is on the hand.
    pub hand_from_cam_left: Pose<Hand, CamLeft>,
    /// Where the target is on the second arm.
    pub flange_from_target: Pose<Flange, Target>,
    /// The motion of a target that no arm carries.
    pub free_target: Option<FreeTarget>,
}

/// A target that no arm carries.
#[derive(Clone)]
pub struct FreeTarget {
    motion: Arc<dyn Trajectory>,
    /// Known as soon as the experiment begins.
    begin: Arc<OnceLock<MonotonicTime>>,
}

impl FreeTarget {
    /// A target that waits for the experiment to begin.
    pub fn new(motion: Arc<dyn Trajectory>) -> Self {
        Self { motion, begin: Arc::default() }
    }

    fn world_from_target_at(&self, at: MonotonicTime) -> Pose<World, Target> {
        self.motion.pose_at(self.begin.get().map_or(0.0, |begin| at.seconds_since(*begin)))
    }
}

impl SimulatedCell {
    /// The experiment begins at this time; what was said first holds.
    pub fn begin_at(&self, begin: MonotonicTime) {
        if let Some(target) = &self.free_target {
            target.begin.get_or_init(|| begin);
        }
    }

    /// Whether it is not forgotten yet where everything was at `at`.
    pub fn remembers(&self, at: MonotonicTime) -> bool {
        self.vs.joints.remembers(at) && self.tc.joints.remembers(at)
    }

    /// True pose of the hand at `at`.
    pub fn world_from_hand_at(&self, at: MonotonicTime) -> Pose<World, Hand> {
        self.vs.world_from_flange_at(at) * self.flange_from_hand
    }

    /// True pose of the left camera at `at`.
    pub fn world_from_cam_left_at(&self, at: MonotonicTime) -> Pose<World, CamLeft> {
        self.world_from_hand_at(at) * self.hand_from_cam_left
    }

    /// True pose of the target at `at`.
    pub fn world_from_target_at(&self, at: MonotonicTime) -> Pose<World, Target> {
        match &self.free_target {
            Some(target) => target.world_from_target_at(at),
            None => self.tc.world_from_flange_at(at) * self.flange_from_target,
        }
    }
}

impl PoseSource for SimulatedCell {
    fn poses_at(&mut self, at: MonotonicTime) -> ScenePoses {
        ScenePoses {
            world_from_cam_left: self.world_from_cam_left_at(at),
            world_from_target: self.world_from_target_at(at),
        }
    }
}
