//! The simulated workcell: two arms in one world, one with the cameras, one with the target.

use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use pb3dp_geometry::frames::{Base, CamLeft, Flange, Hand, Target, World};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{Chain, JointState, JointVector};
use pb3dp_servo::{JointHistory, NotInHistory};
use pb3dp_setup::setup::{ArmSetup, Setup, Truth};
use pb3dp_sim::joint_dynamics::JointPlant;
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{PoseSource, ScenePoses};
use pb3dp_sim::trajectory::Trajectory;

/// Largest gap between joint measurements that is interpolated, and longest extrapolation from the last one, seconds.
pub(super) const JOINT_GAP_MAX_S: f64 = 0.1;
/// Number of joint measurements kept: two seconds at 500 Hz.
const JOINTS_KEPT: usize = 1000;

/// Source of an arm's joint positions.
#[derive(Clone)]
pub struct JointSource(Source);

#[derive(Clone)]
enum Source {
    Plant(Arc<Mutex<JointPlant>>),
    Measured(Arc<Mutex<MeasuredJoints>>),
}

/// Measured joint positions.
struct MeasuredJoints {
    samples: Receiver<JointState>,
    history: JointHistory,
    start_rad: JointVector,
}

impl JointSource {
    /// Simulated joint positions, shared with the arm backend: exact.
    pub fn plant(plant: Arc<Mutex<JointPlant>>) -> Self {
        Self(Source::Plant(plant))
    }

    /// Measured joint positions; `start_rad` until the first measurement.
    pub fn measured(samples: Receiver<JointState>, start_rad: JointVector) -> Self {
        let history = JointHistory::new(JOINTS_KEPT, JOINT_GAP_MAX_S);
        Self(Source::Measured(Arc::new(Mutex::new(MeasuredJoints { samples, history, start_rad }))))
    }

    /// The simulated joints; `None` for measured ones.
    pub fn simulated(&self) -> Option<&Mutex<JointPlant>> {
        match &self.0 {
            Source::Plant(plant) => Some(plant),
            Source::Measured(_) => None,
        }
    }

    /// Joint angles at `at`. Simulated joints are advanced to `at` if necessary and keep one second of history. Measured joints are
    /// interpolated; where that is not possible, the newest measurement is returned.
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

    /// Whether the joint positions at `at` are still in the history.
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

/// One arm of the workcell.
#[derive(Clone)]
pub struct ArmSite {
    /// Kinematics.
    pub chain: Chain,
    /// Pose of its base in the world.
    pub world_from_base: Pose<World, Base>,
    /// Source of its joint positions.
    pub joints: JointSource,
}

impl ArmSite {
    /// An arm of a setup with the source of its joint positions.
    pub fn of(arm: &ArmSetup, joints: JointSource) -> Self {
        Self { chain: arm.chain.clone(), world_from_base: arm.world_from_base, joints }
    }

    /// True pose of the flange at `at`.
    pub fn world_from_flange_at(&self, at: MonotonicTime) -> Pose<World, Flange> {
        self.world_from_base * self.chain.forward(&self.joints.position_rad_at(at))
    }
}

/// Both arms with their payloads: the ground truth of the simulation.
#[derive(Clone)]
pub struct SimulatedCell {
    /// The arm that carries the cameras.
    pub vs: ArmSite,
    /// The arm that carries the target.
    pub tc: ArmSite,
    /// Pose of the servoed hand on the flange of the first arm.
    pub flange_from_hand: Pose<Flange, Hand>,
    /// Pose of the left camera in the hand frame.
    pub hand_from_cam_left: Pose<Hand, CamLeft>,
    /// Pose of the target on the flange of the second arm.
    pub flange_from_target: Pose<Flange, Target>,
    /// Motion of a free target, which no arm carries.
    pub free_target: Option<FreeTarget>,
    /// What the cameras see, if they have images.
    pub scene: Option<Arc<StereoRenderer>>,
}

/// A free target, which no arm carries.
#[derive(Clone)]
pub struct FreeTarget {
    motion: Arc<dyn Trajectory>,
    /// Set once the experiment begins.
    begin: Arc<OnceLock<MonotonicTime>>,
}

impl FreeTarget {
    /// A free target; its motion starts with the experiment.
    pub fn new(motion: Arc<dyn Trajectory>) -> Self {
        Self { motion, begin: Arc::default() }
    }

    fn world_from_target_at(&self, at: MonotonicTime) -> Pose<World, Target> {
        self.motion.pose_at(self.begin.get().map_or(0.0, |begin| at.seconds_since(*begin)))
    }
}

impl SimulatedCell {
    /// The workcell as the setup states it, with the target on the second arm.
    pub fn of(setup: &Setup, [vs, tc]: [ArmSite; 2]) -> Self {
        Self {
            vs,
            tc,
            flange_from_hand: setup.controller.flange_from_hand,
            hand_from_cam_left: setup.controller.hand_from_cam_left,
            flange_from_target: setup.rig.flange_from_target,
            free_target: None,
            scene: None,
        }
    }

    /// Sets the poses to the true ones.
    pub fn follow_truth(&mut self, truth: &Truth) {
        if let Some(flange_from_cam_left) = &truth.flange_from_cam_left {
            self.hand_from_cam_left = self.flange_from_hand.inverse() * *flange_from_cam_left;
        }
        self.flange_from_target = truth.flange_from_target.unwrap_or(self.flange_from_target);
        self.tc.world_from_base = truth.tc_world_from_base.unwrap_or(self.tc.world_from_base);
    }

    /// Sets the start time of the experiment; only the first call takes effect.
    pub fn begin_at(&self, begin: MonotonicTime) {
        if let Some(target) = &self.free_target {
            target.begin.get_or_init(|| begin);
        }
    }

    /// Whether all poses at `at` are still in the history.
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
