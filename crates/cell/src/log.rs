//! What a run writes down: one sample per control step, one per frame. Only the run fills it; summary and report read it.

use nalgebra::Matrix6;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Hand, Model, Target, World};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::trajectory::Mark;

use super::commands::CommandSummary;
use super::cycles::CycleSummary;
use super::drift::DriftSummary;
use super::supervision::SupervisionLog;

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
    /// Where the hand should be by the pose of the lock: it takes the target for what the first estimates said, for ever.
    pub world_from_hand_locked: Pose<World, Hand>,
    /// What the controller was doing, in a word.
    pub mode: String,
    /// Smallest singular value of the Jacobian of the arm that carries the cameras.
    pub smallest_singular_value: f64,
    /// The arm that carries the cameras, and the one that carries the target.
    pub arms: [ArmSample; 2],
}

/// One arm in a control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmSample {
    /// Joint angles as measured, rad.
    pub position_rad: JointVector,
    /// Joint velocities as requested of its limiter, rad/s; `None`: to hold.
    pub requested_rad_per_s: Option<JointVector>,
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
    /// From the middle of the exposure until the controller could have the estimate, milliseconds; `None` of methods that only look on.
    pub age_millis: Option<f64>,
    /// Covariance of the pose, metres and radians.
    pub covariance: Option<Matrix6<f64>>,
}

/// What the estimates said at the beginning of where the model's frame is on the target; everything that follows is relative to it.
#[derive(Clone, Copy, Debug)]
pub struct Lock {
    /// Seconds since the experiment began, mid-exposure.
    pub at_s: f64,
    /// Where the frame would be without error: on the target's true plane, on the ray of its estimated origin.
    pub target_from_model: Pose<Target, Model>,
    /// Where the estimates put it: mean until the target first moves, so that the noise of a single one is not in it.
    pub target_from_model_found: Pose<Target, Model>,
    /// What the first estimate said of its own error: covariance of xi = [rho; phi] (m, rad; axes of `model`).
    pub covariance: Option<Matrix6<f64>>,
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
    /// The true pose of each frame, of another frame on the same body; empty where there is no truth.
    pub truth: Vec<Pose<CamLeft, Model>>,
    /// Whether the method measured the rotation about the model's normal in any frame.
    pub rotation_about_normal_observed: bool,
}

impl RunLog {
    /// Control steps that can be judged: all, or none where there is no truth.
    pub fn judged(&self) -> &[ControlSample] {
        if self.without_truth { &[] } else { &self.control }
    }
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
    /// Whether no image was rendered: the poses are the truth with noise.
    pub without_images: bool,
    /// Whether nobody knows where everything truly was: where hand and target are is what the joints of the arms say then, and where the
    /// hand should be is not known.
    pub without_truth: bool,
    /// What the leading method said of the first frame in which it had a pose.
    pub lock: Option<Lock>,
    /// Begin of each move of the target.
    pub marks: Vec<Mark>,
    /// What the supervisor decided.
    pub supervision: SupervisionLog,
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// How far the cameras are from what was calibrated, if somebody has looked at that.
    pub drift: Vec<DriftSummary>,
    /// What became of the velocities of each arm.
    pub commands: Vec<CommandSummary>,
    /// How punctual the cycles were, of a run in the machine's time.
    pub cycles: Vec<CycleSummary>,
}
