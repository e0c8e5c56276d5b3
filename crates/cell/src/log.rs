//! Record of a run: one sample per control step and one per frame. Only the run fills it; summary and report read it.

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
    /// Time since the start of the experiment, seconds.
    pub t_s: f64,
    /// True pose of the target.
    pub world_from_target: Pose<World, Target>,
    /// True pose of the hand.
    pub world_from_hand: Pose<World, Hand>,
    /// Desired hand pose in front of the true target.
    pub world_from_hand_wanted: Pose<World, Hand>,
    /// Desired hand pose by the initial lock, which keeps the first estimated target pose for the whole run.
    pub world_from_hand_locked: Pose<World, Hand>,
    /// Controller mode, optionally with a reason.
    pub mode: String,
    /// Smallest singular value of the Jacobian of the arm that carries the cameras.
    pub smallest_singular_value: f64,
    /// The arm that carries the cameras and the one that carries the target.
    pub arms: [ArmSample; 2],
}

/// One arm in a control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmSample {
    /// Measured joint angles, rad.
    pub position_rad: JointVector,
    /// Joint velocities requested from the limiter, rad/s; `None`: hold.
    pub requested_rad_per_s: Option<JointVector>,
}

impl ControlSample {
    /// The mode without its reason.
    pub fn mode_name(&self) -> &str {
        self.mode.split(':').next().unwrap_or_default()
    }
}

/// One frame pair.
#[derive(Clone, Debug)]
pub struct FrameSample {
    /// Mid-exposure time since the start of the experiment, seconds.
    pub t_s: f64,
    /// Status word of the estimate.
    pub status: String,
    /// Fitness, eq. (10).
    pub fitness: Option<f64>,
    /// Estimated minus true depth of the target plane on the ray of the estimated origin, metres.
    pub depth_error_m: Option<f64>,
    /// Angle between the estimated and the true normal, radians.
    pub normal_error_rad: Option<f64>,
    /// Wall time from the pair in memory to the estimate on this machine, milliseconds.
    pub latency_millis: f64,
    /// From mid-exposure until the estimate is available to the controller, milliseconds; `None` for compared methods.
    pub age_millis: Option<f64>,
    /// Covariance of the pose since the first one, metres and radians.
    pub covariance: Option<Matrix6<f64>>,
    /// Covariance of the pose, that of the first one included.
    pub pose_covariance: Option<Matrix6<f64>>,
}

/// Initial lock: pose of the model frame on the target by the first estimates. All later poses are relative to it.
#[derive(Clone, Copy, Debug)]
pub struct Lock {
    /// Mid-exposure time since the start of the experiment, seconds.
    pub at_s: f64,
    /// Model frame without error: on the true target plane, on the ray of its estimated origin.
    pub target_from_model: Pose<Target, Model>,
    /// Estimated model frame: mean until the target first moves, to reduce the noise of a single estimate.
    pub target_from_model_found: Pose<Target, Model>,
    /// Error stated by the first estimate against the visible surface: covariance of xi = [rho; phi] (m, rad; axes of `model`).
    pub covariance: Option<Matrix6<f64>>,
}

/// Estimates of one method for every frame, with the true poses.
#[derive(Clone, Debug, Default)]
pub struct MethodLog {
    /// Name of the method.
    pub method: String,
    /// Frames in order of time.
    pub frames: Vec<FrameSample>,
    /// The pose of each frame, if there is one.
    pub estimated: Vec<Option<Pose<CamLeft, Model>>>,
    /// The true pose of each frame, for another frame on the same body; empty without true poses.
    pub truth: Vec<Pose<CamLeft, Model>>,
    /// Whether the method measured the rotation about the model's normal in any frame.
    pub rotation_about_normal_observed: bool,
}

impl RunLog {
    /// Control steps with a true pose: all, or none without true poses.
    pub fn judged(&self) -> &[ControlSample] {
        if self.without_truth { &[] } else { &self.control }
    }
}

/// Record of one run.
#[derive(Clone, Debug, Default)]
pub struct RunLog {
    /// Control steps in order of time.
    pub control: Vec<ControlSample>,
    /// Estimates of the method that leads the hand.
    pub leading: MethodLog,
    /// Estimates of the compared methods.
    pub compared: Vec<MethodLog>,
    /// Whether no image was rendered: the poses are the true ones with noise.
    pub without_images: bool,
    /// Whether there are no true poses: hand and target poses then come from the joints, and the desired hand pose is unknown.
    pub without_truth: bool,
    /// First pose estimate of the leading method.
    pub lock: Option<Lock>,
    /// Begin of each move of the target.
    pub marks: Vec<Mark>,
    /// Supervisor decisions.
    pub supervision: SupervisionLog,
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// Camera drift since calibration, if it was measured.
    pub drift: Vec<DriftSummary>,
    /// Velocity command counts of each arm.
    pub commands: Vec<CommandSummary>,
    /// Timing of the cycles; only in a real-time run.
    pub cycles: Vec<CycleSummary>,
}
