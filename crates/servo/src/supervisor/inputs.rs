//! The inputs of the supervisor in each step. Times are those of the measurements; the supervisor computes their ages.

use std::time::Duration;

use nalgebra::Matrix6;
use pb3dp_geometry::MonotonicTime;

use crate::controller::Mode;

/// Inputs of one control step. A "newest" value may be the same as in the previous step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// Input from the operator.
    pub operator: OperatorInput,
    /// Mode of the controller.
    pub controller: Mode,
    /// What the controller did with an observation in this step.
    pub innovation: Innovation,
    /// Covariance of the predicted target pose at the time of the step, metres and radians, translation first; `None` without a
    /// prediction.
    pub target_covariance: Option<Matrix6<f64>>,
    /// How much older than their time stamps the images seem to be, seconds, as the controller finds.
    pub images_late_s: Option<f64>,
    /// The newest estimate; `None` before the first one.
    pub estimate: Option<EstimateInput>,
    /// The newest frame pair; `None` before the first one.
    pub frame: Option<FrameInput>,
    /// The joint of the camera arm that is nearest to its operating limit; `None` if its joints are unknown.
    pub range_end: Option<RangeEnd>,
    /// Smallest singular value of the hand's Jacobian, metres and radians; `None` if its joints are unknown.
    pub smallest_singular_value: Option<f64>,
    /// The arm that carries the cameras, and the one that carries the target.
    pub arms: [ArmInput; 2],
}

/// Names of the arms in the order of [`Inputs::arms`].
pub const ARM_NAMES: [&str; 2] = ["vs-robot", "tc-robot"];

/// Input from the operator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatorInput {
    /// A new command.
    pub request: Option<OperatorRequest>,
    /// Last sign of life of a panel or a person, not of this program.
    pub heartbeat_at: Option<MonotonicTime>,
    /// Longest silence of this operator, instead of the policy's `age_s`: a person presses a key less often than a panel sends heartbeats.
    pub silent_after: Option<Duration>,
}

/// A command of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OperatorRequest {
    /// The command.
    pub command: OperatorCommand,
    /// Time at which it was given.
    pub at: MonotonicTime,
}

/// Commands of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OperatorCommand {
    /// Initialise this target.
    Select,
    /// Follow the target.
    Start,
    /// Both arms hold.
    Hold,
    /// The camera arm holds; the arm with the target continues.
    HoldHand,
    /// Continue after a hold.
    Resume,
    /// Take the pose relative to the visible surface as it is known now.
    Realign,
    /// Stop both arms.
    Stop,
    /// Clear the latched state.
    Reset,
}

impl OperatorCommand {
    /// All commands.
    pub const ALL: [Self; 8] =
        [Self::Select, Self::Start, Self::Hold, Self::HoldHand, Self::Resume, Self::Realign, Self::Stop, Self::Reset];

    /// Name of the command.
    pub fn name(self) -> &'static str {
        match self {
            Self::Select => "select",
            Self::Start => "start",
            Self::Hold => "hold",
            Self::HoldHand => "hold hand",
            Self::Resume => "resume",
            Self::Realign => "re-align",
            Self::Stop => "stop",
            Self::Reset => "reset",
        }
    }

    /// Whether the command only ends motion; such a command is obeyed in every state and at any age.
    pub fn ends_motion(self) -> bool {
        matches!(self, Self::Stop | Self::Hold | Self::HoldHand)
    }
}

/// The estimate of one stereo pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimateInput {
    /// Midpoint of the left exposure.
    pub at: MonotonicTime,
    /// Confidence of the estimator in its pose.
    pub confidence: Confidence,
    /// Covariance of the pose against the visible surface, that of the first pose included, metres and radians, translation first; `None` if
    /// the method has none.
    pub covariance: Option<Matrix6<f64>>,
    /// Number of the followed target. A lost target that is found again keeps its number; any other target, also after a restart,
    /// gets a new one.
    pub target: u64,
}

/// Confidence of the estimator in its pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Confidence {
    /// Confident: at least the depth is determined.
    Sure,
    /// A pose that may be wrong.
    Doubtful,
    /// No pose.
    NoPose,
    /// The images contradict the calibration, with or without a pose.
    Miscalibrated,
}

/// What the controller did with an observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Innovation {
    /// No new observation in this step.
    NoneNew,
    /// Accepted: it agrees with the expected pose.
    Agrees,
    /// Rejected: too far from the last pose.
    Jump {
        /// Distance, metres.
        position_m: f64,
        /// Angle, radians.
        orientation_rad: f64,
    },
    /// Rejected: too far from the predicted pose.
    Outlier {
        /// Mahalanobis distance, in standard deviations.
        sigmas: f64,
    },
}

/// A stereo pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInput {
    /// Number of the pair.
    pub sequence: u64,
    /// Midpoint of the left exposure.
    pub at: MonotonicTime,
    /// Midpoint of the right exposure minus that of the left one, seconds.
    pub skew_s: f64,
}

/// Distance of a joint from its nearest limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeEnd {
    /// Index from the base, 0 to 6.
    pub joint: usize,
    /// Angle to the limit, radians; negative beyond it.
    pub distance_rad: f64,
}

/// One arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmInput {
    /// State of its drives and brakes.
    pub state: ArmCondition,
    /// Time of the newest joint sample; `None` before the first one.
    pub measured_at: Option<MonotonicTime>,
}

/// State of the drives and brakes of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ArmCondition {
    /// Brakes on, no motion possible.
    Disabled,
    /// Velocity commands are executed.
    Enabled,
    /// Stopped by a fault of the arm, its link or its limits.
    Fault,
    /// Stopped by an emergency stop.
    EmergencyStop,
    /// Stopped by a fault of the other arm.
    StoppedByOther,
}
