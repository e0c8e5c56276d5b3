//! What a run writes down: one sample per control step, one per frame. Only the run fills it; summary and report read it.

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Hand, Model, Target, World};
use pb3dp_sim::trajectory::Mark;

use super::commands::CommandSummary;
use super::cycles::CycleSummary;

/// One control step.
#[derive(Clone, Debug)]
pub struct ControlSample {
    /// Seconds since the experiment began.
    pub t_s: f64,
    /// True pose of the target.
    pub world_from_target: Pose<World, Target>,
    /// True pose of the hand.
    pub world_from_hand: Pose<World, Hand>,
    /// Where the hand should be: at the chosen place before the true target.
    pub world_from_hand_wanted: Pose<World, Hand>,
    /// What the controller was doing, in a word.
    pub mode: String,
    /// Smallest singular value of the Jacobian of the arm that carries the cameras.
    pub smallest_singular_value: f64,
}

impl ControlSample {
    /// The mode without its reason.
    pub fn mode_word(&self) -> &str {
        self.mode.split(':').next().unwrap_or_default()
    }
}

/// One frame pair.
#[derive(Clone, Debug)]
pub struct FrameSample {
    /// Seconds since the experiment began, mid-exposure.
    pub t_s: f64,
    /// Status word of the estimate.
    pub status: String,
    /// Fitness, eq. (10).
    pub fitness: Option<f64>,
    /// Estimated less true depth of the target's plane on the ray of the estimated origin, metres.
    pub depth_error_m: Option<f64>,
    /// Angle between the estimated and the true normal, radians.
    pub normal_error_rad: Option<f64>,
    /// From the pair in memory to the estimate, milliseconds of wall time on this machine.
    pub latency_millis: f64,
}

/// What one method said of every frame, beside the truth.
#[derive(Clone, Debug, Default)]
pub struct MethodLog {
    /// Name of the method.
    pub method: String,
    /// Frames in order of time.
    pub frames: Vec<FrameSample>,
    /// The pose of each frame, if there is one.
    pub estimated: Vec<Option<Pose<CamLeft, Model>>>,
    /// The true pose of each frame, of another frame on the same body.
    pub truth: Vec<Pose<CamLeft, Model>>,
    /// Whether the method measured the rotation about the model's normal in any frame.
    pub rotation_about_normal_observed: bool,
}

/// Everything written down in one run.
#[derive(Clone, Debug, Default)]
pub struct RunLog {
    /// Control steps in order of time.
    pub control: Vec<ControlSample>,
    /// What the method that leads the hand said.
    pub leading: MethodLog,
    /// What the methods said that only looked on.
    pub compared: Vec<MethodLog>,
    /// Begin of each move of the target.
    pub marks: Vec<Mark>,
    /// What happened besides, with seconds since the beginning.
    pub events: Vec<(f64, String)>,
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// What became of the velocities of each arm.
    pub commands: Vec<CommandSummary>,
    /// How punctual the cycles were, of a run in the machine's time.
    pub cycles: Vec<CycleSummary>,
}
