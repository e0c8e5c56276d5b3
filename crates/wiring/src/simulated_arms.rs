//! Arms that are emulated in simulated time, and outlive the program that moves them.

use std::sync::{Arc, Mutex};

use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_sim::joint_dynamics::JointPlant;

/// Joints of an emulated arm, for its controller and the simulation.
pub(super) type SharedPlant = Arc<Mutex<JointPlant>>;

/// An arm that is emulated in simulated time: the far end of its line and its joints. It outlives the program that moves it.
#[derive(Clone)]
pub struct SimulatedArm {
    /// Name of the arm.
    pub name: &'static str,
    /// Far end of its line.
    pub end: VirtualEnd,
    /// Its joints.
    pub(super) plant: SharedPlant,
}
