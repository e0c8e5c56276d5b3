//! The simulated cell: two arms that stand in one world, one with the cameras, one with the target.

use std::sync::{Arc, Mutex, PoisonError};

use pb3dp_geometry::frames::{Base, CamLeft, Flange, Hand, Target, World};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::{Chain, JointVector};
use pb3dp_sim::joint_dynamics::JointPlant;
use pb3dp_sim::scene::{PoseSource, ScenePoses};

/// One arm in the cell.
#[derive(Clone)]
pub struct ArmSite {
    /// Its kinematics.
    pub chain: Chain,
    /// Where it stands.
    pub world_from_base: Pose<World, Base>,
    /// Its joints, shared with the arm backend.
    pub plant: Arc<Mutex<JointPlant>>,
}

impl ArmSite {
    /// True joint angles at `at`, to which the joints are advanced if need be; at most the plant's history ago.
    pub fn position_rad_at(&self, at: MonotonicTime) -> JointVector {
        let mut plant = self.plant.lock().unwrap_or_else(PoisonError::into_inner);
        plant.advance_to(at);
        plant.position_at(at).unwrap_or_else(|| plant.state().position_rad)
    }

    /// True pose of the flange at `at`.
    pub fn world_from_flange_at(&self, at: MonotonicTime) -> Pose<World, Flange> {
        self.world_from_base * self.chain.forward(&self.position_rad_at(at))
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
}

impl SimulatedCell {
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
        self.tc.world_from_flange_at(at) * self.flange_from_target
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
