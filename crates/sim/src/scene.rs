//! What stands where in the simulated cell at one moment.

use pb3dp_geometry::frames::{CamLeft, Target, World};
use pb3dp_geometry::{MonotonicTime, Pose};

/// Where the moving things of the cell are at one moment. Metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScenePoses {
    /// Pose of the left camera in `world`; the right one follows from the rig.
    pub world_from_cam_left: Pose<World, CamLeft>,
    /// Pose of the carried target in `world`.
    pub world_from_target: Pose<World, Target>,
}

/// Tells where everything is at a given time: a script, or the simulated arms.
///
/// Times asked for do not go back by more than one exposure.
pub trait PoseSource: Send {
    /// Poses at time `at`.
    fn poses_at(&mut self, at: MonotonicTime) -> ScenePoses;
}
