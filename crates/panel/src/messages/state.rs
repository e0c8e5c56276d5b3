//! The state of the run, as `GET /api/state` and the WebSocket send it.

use serde::Serialize;

use super::{Pixel, Transform, Triple};

/// The state of the run.
#[derive(Clone, Debug, Serialize)]
pub struct StateMessage {
    /// Always `state`.
    #[serde(rename = "type")]
    pub kind: &'static str,
    /// Time on the run's clock.
    pub time_ms: f64,
    /// Seconds of the run per second of the computer, over the last second.
    pub realtime_factor: f64,
    /// State of the supervisor.
    pub state: SupervisorState,
    /// Why nothing moves.
    pub why: Reason,
    /// Who commands.
    pub operator: OperatorState,
    /// The target.
    pub target: TargetState,
    /// Names of the targets that can be chosen again.
    pub saved: Vec<String>,
    /// The controller.
    pub control: ControlState,
    /// The arms, the one with the cameras first.
    pub arms: Vec<ArmState>,
    /// True poses, in a simulation.
    pub truth: Option<Truth>,
    /// The images.
    pub images: ImageCounts,
}

/// State of the supervisor.
#[derive(Clone, Debug, Serialize)]
pub struct SupervisorState {
    /// Counts changes of state, holds and stops: commands refer to it.
    pub number: u64,
    /// `idle`, `selecting`, `approaching`, `tracking`, `holding`, `lost`, `stopped`, `fault`; `starting` before the arms are enabled,
    /// `over` after the run, `no-arms` without arms.
    pub name: &'static str,
    /// Whether an arm may move.
    pub is_moving: bool,
    /// Whether only `reset` leaves the state.
    pub is_latched: bool,
    /// Whether `start` or `resume` would be accepted.
    pub is_ready: bool,
    /// Commands that are possible.
    pub may: Vec<&'static str>,
}

/// Why nothing moves and what to do.
#[derive(Clone, Debug, Serialize)]
pub struct Reason {
    /// One line.
    pub line: String,
    /// Its code.
    pub code: Option<&'static str>,
    /// Active conditions.
    pub inhibits: Vec<Inhibit>,
}

/// An active condition.
#[derive(Clone, Debug, Serialize)]
pub struct Inhibit {
    /// Name in configurations and logs.
    pub name: &'static str,
    /// For how long.
    pub since_ms: f64,
    /// Time until it clears by itself, if that is known.
    pub clears_ms: Option<f64>,
    /// What the supervisor does: `note`, `slow`, `hold`, `stop`, `fault`.
    pub action: &'static str,
}

/// Who commands.
#[derive(Clone, Debug, Serialize)]
pub struct OperatorState {
    /// Who holds the lease.
    pub holder: Option<HolderState>,
    /// Age of the last sign of life.
    #[serde(rename = "heard_ms_ago")]
    pub heartbeat_ms_ago: Option<f64>,
    /// A problem that the operator must know.
    pub trouble: Option<String>,
}

/// Who holds the lease.
#[derive(Clone, Debug, Serialize)]
pub struct HolderState {
    /// Number of the lease.
    pub id: u64,
    /// Name.
    pub name: String,
}

/// The target.
#[derive(Clone, Debug, Default, Serialize)]
pub struct TargetState {
    /// Number; commands refer to it.
    pub id: Option<u64>,
    /// Name.
    pub name: Option<String>,
    /// The pair of this estimate.
    pub sequence: Option<u64>,
    /// Status of the estimate; `none` before the first one.
    pub status: &'static str,
    /// Reason of the status.
    pub reason: String,
    /// Age of the exposure.
    pub age_ms: Option<f64>,
    /// Computing time of the method.
    pub latency_ms: Option<f64>,
    /// Agreement of model and images, at most 1.
    pub fitness: Option<f64>,
    /// Outline in the left image.
    pub outline_px: Vec<Pixel>,
    /// The same in the right image; empty without a pose.
    pub outline_right_px: Vec<Pixel>,
    /// Origin and ends of the axes x, y and z in the left image.
    pub axes_px: Option<[Pixel; 4]>,
    /// The same in the right image.
    pub axes_right_px: Option<[Pixel; 4]>,
    /// Origin of the model in the left camera.
    pub point_mm: Option<Triple>,
    /// Pose in the left camera.
    pub cam_left_from_model: Option<Transform>,
    /// Pose in the world, by the present joints.
    pub world_from_model: Option<Transform>,
    /// Standard deviation of the position along the axes of the model, that of the first pose included.
    pub sigma_mm: Option<Triple>,
    /// Standard deviation of the orientation about the axes of the model, likewise.
    pub sigma_deg: Option<Triple>,
    /// Standard deviation of the position since the first pose.
    pub motion_sigma_mm: Option<Triple>,
    /// Standard deviation of the orientation since the first pose.
    pub motion_sigma_deg: Option<Triple>,
    /// Number of pairs that have improved what is known of the visible surface.
    pub surface_version: Option<u32>,
    /// How far `re-align` would move the hand.
    pub realign_mm: Option<f64>,
    /// How far it would turn it.
    pub realign_deg: Option<f64>,
    /// Error of the position along the axes of the model, where the truth is known.
    pub error_mm: Option<Triple>,
    /// Error of the orientation, where the truth is known.
    pub error_deg: Option<Triple>,
}

/// The controller.
#[derive(Clone, Debug, Serialize)]
pub struct ControlState {
    /// Distance of the hand from its desired pose.
    pub error_mm: Option<f64>,
    /// Angle of the hand to its desired pose.
    pub error_deg: Option<f64>,
    /// Share of the velocity.
    pub speed_percent: f64,
    /// Offset of the desired pose.
    pub jog: JogState,
}

/// Offset of the desired pose of the hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct JogState {
    /// Along the axes of the hand.
    pub offset_mm: Triple,
    /// Rotation vector.
    pub offset_deg: Triple,
}

/// An arm.
#[derive(Clone, Debug, Serialize)]
pub struct ArmState {
    /// Name.
    pub name: String,
    /// `disabled`, `enabled`, `fault`, `emergency-stop`, `stopped-by-other`; `unknown` before the first measurement.
    pub condition: &'static str,
    /// Joint angles.
    pub position_deg: Vec<f64>,
    /// Joint velocities, from the last two states.
    pub speed_deg_per_s: Vec<f64>,
    /// Share of the operating range in use: 0 in the middle, 1 at an end.
    pub near: Vec<f64>,
}

/// True poses.
#[derive(Clone, Debug, Serialize)]
pub struct Truth {
    /// Pose of the target.
    pub world_from_target: Transform,
}

/// Counts of the images.
#[derive(Clone, Debug, Serialize)]
pub struct ImageCounts {
    /// Number of the newest pair.
    pub sequence: Option<u64>,
    /// Rate over the last second.
    pub fps: f64,
    /// Missing pairs.
    pub lost: u64,
}
