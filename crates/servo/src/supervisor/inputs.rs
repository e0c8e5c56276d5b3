//! The inputs of the supervisor in each step. Times are those of the measurements; the supervisor computes their ages.

use nalgebra::Matrix6;
use pb3dp_geometry::MonotonicTime;

use crate::controller::Mode;

/// Everything that is known in one control step. "Newest" may be the same as in the step before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// What the operator says.
    pub operator: OperatorInput,
    /// What the controller is doing.
    pub controller: Mode,
    /// What became of an observation in this step.
    pub innovation: Innovation,
    /// The newest estimate; none before the first one.
    pub estimate: Option<EstimateInput>,
    /// The newest stereo pair; none before the first one.
    pub frame: Option<FrameInput>,
    /// The joint of the hand's arm that is nearest to an end of its operating range; none if its joints are not known.
    pub range_end: Option<RangeEnd>,
    /// Smallest singular value of the hand's Jacobian, metres and radians; none if its joints are not known.
    pub smallest_singular_value: Option<f64>,
    /// The arm that carries the cameras, and the one that carries the target.
    pub arms: [ArmInput; 2],
}

/// Names of the arms in the order of [`Inputs::arms`].
pub const ARM_NAMES: [&str; 2] = ["vs-robot", "tc-robot"];

/// What the operator says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatorInput {
    /// A word that was not handed over before.
    pub said: Option<OperatorRequest>,
    /// The last sign of life: of a panel or a person, not of this program.
    pub heard_at: Option<MonotonicTime>,
}

/// A word of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OperatorRequest {
    /// The word.
    pub word: OperatorCommand,
    /// When it was said.
    pub at: MonotonicTime,
}

/// The words of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OperatorCommand {
    /// This is the target.
    Select,
    /// Follow it.
    Start,
    /// Come to rest.
    Hold,
    /// Go on after a rest.
    Resume,
    /// Stop both arms.
    Stop,
    /// Clear the latched state.
    Reset,
}

impl OperatorCommand {
    /// All words.
    pub const ALL: [Self; 6] = [Self::Select, Self::Start, Self::Hold, Self::Resume, Self::Stop, Self::Reset];

    /// The word as it is said.
    pub fn name(self) -> &'static str {
        match self {
            Self::Select => "select",
            Self::Start => "start",
            Self::Hold => "hold",
            Self::Resume => "resume",
            Self::Stop => "stop",
            Self::Reset => "reset",
        }
    }
}

/// What the estimator says about one stereo pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimateInput {
    /// Middle of the left image's exposure.
    pub at: MonotonicTime,
    /// Confidence of the estimator in its pose.
    pub confidence: Confidence,
    /// Covariance of the pose, metres and radians, translation first; none: the method cannot say.
    pub covariance: Option<Matrix6<f64>>,
    /// Number of the target that it follows. A target that was lost and is known again keeps its number; anything else that the
    /// estimator begins to follow, also after a restart, has another one.
    pub target: u64,
}

/// Confidence of the estimator in its pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Confidence {
    /// It does: at least the depth is determined.
    Sure,
    /// There is a pose that may be wrong.
    Doubtful,
    /// There is none.
    NoPose,
}

/// What became of an observation in the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Innovation {
    /// There was no new one in this step.
    NoneNew,
    /// It agrees with where the target was thought to be.
    Agrees,
    /// It was refused, as it is too far from there.
    Jump {
        /// Distance, metres.
        position_m: f64,
        /// Angle, radians.
        orientation_rad: f64,
    },
    /// It was refused, as it is too far from where the target's motion so far leads to expect it.
    Outlier {
        /// Mahalanobis distance: in standard deviations.
        sigmas: f64,
    },
}

/// A stereo pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInput {
    /// Counts pairs.
    pub sequence: u64,
    /// Middle of the left image's exposure.
    pub at: MonotonicTime,
    /// Middle of the right exposure minus middle of the left one, seconds.
    pub skew_s: f64,
}

/// How far a joint is from the nearest end of its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeEnd {
    /// Index from the base, 0 to 6.
    pub joint: usize,
    /// Angle to the end, radians; negative beyond it.
    pub distance_rad: f64,
}

/// One arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmInput {
    /// State of its drives and brakes.
    pub state: ArmCondition,
    /// When its joints were last measured; none before the first time.
    pub measured_at: Option<MonotonicTime>,
}

/// State of the drives and brakes of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ArmCondition {
    /// Brakes on, no motion possible.
    Disabled,
    /// Velocities are followed.
    Enabled,
    /// Stopped by a fault of the arm, its link or its limits.
    Fault,
    /// Stopped by an emergency stop.
    EmergencyStop,
    /// Stopped only because the other arm was: a fault, of which the other one is the cause.
    StoppedByOther,
}
