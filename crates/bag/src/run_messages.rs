//! Messages of our own: what a replay needs, to the last bit.
//!
//! Other programs decode them with the definitions in the file. Times are nanoseconds on the clock of the run; a pose is x, y, z of its
//! translation in metres, then x, y, z, w of its quaternion; a covariance is its columns. A sequence of at most one element stands for a
//! value that may be absent.

use crate::cdr::{Bytes, CdrError, CdrReader, CdrValue, CdrWriter, Later};
use crate::messages::{Message, Time, message};

message! {
    /// A file that the settings of the run name.
    #[derive(Eq)]
    SetupFile = "pb3dp_msgs/SetupFile" {
        /// Its path in the settings.
        path: String,
        /// Its content.
        data: Bytes,
    }
}

message! {
    /// The files that the settings of the run name.
    #[derive(Eq)]
    SetupFiles = "pb3dp_msgs/SetupFiles" {
        /// Each of them.
        files: Vec<SetupFile>,
    }
}

message! {
    /// How a target is marked in the left image.
    #[derive(Default)]
    Marked = "pb3dp_msgs/Marked" {
        /// `rectangle`, `polygon`, `mask`, `click`; `outline` of a simulated target, `awaited` or `nobody`.
        kind: String,
        /// Rectangle: x, y, width, height. Polygon and click: u, v of each point, pixels. Outline: x, y, z of each point, metres.
        numbers: Vec<f64>,
        /// Mask: a PNG file.
        mask: Bytes,
    }
}

message! {
    /// Begin of a run.
    RunBegin = "pb3dp_msgs/RunBegin" {
        /// First control step.
        begin_nanos: u64,
        /// Time since 1970 at the zero of the clock of the run.
        since_1970_nanos: u64,
        /// The operator is a person.
        is_person: bool,
        /// The sign of life of the operator can end.
        can_fall_silent: bool,
        /// How the target is marked at the begin.
        marking: Marked,
        /// The target that the setup names, if the operator selects.
        target_of_setup: Vec<Marked>,
    }
}

message! {
    /// End of a run.
    #[derive(Eq)]
    RunEnd = "pb3dp_msgs/RunEnd" {
        /// Pairs that the camera could not deliver.
        pairs_lost: u64,
        /// Velocity commands of each arm, then those that its limiter changed, and those that were refused.
        commands: Vec<u64>,
        /// The failure that ended the run early; empty: none.
        failure: String,
    }
}

message! {
    /// Where an arm stood.
    Stand = "pb3dp_msgs/Stand" {
        /// Measured angle of each joint, rad: means over the stop.
        joints_rad: Vec<f64>,
        /// Pose of the flange from these angles.
        base_from_flange: [f64; 7],
    }
}

message! {
    /// A stop of `pb3dp arm visit`: a pair for a calibration.
    Stop = "pb3dp_msgs/Stop" {
        /// Stamp of its left image.
        stamp: Time,
        /// The arm with the cameras.
        vs: Stand,
        /// The other arm.
        tc: Vec<Stand>,
    }
}

message! {
    /// A new state of an arm, from a query in a control step on.
    #[derive(Eq)]
    ArmChange = "pb3dp_msgs/ArmChange" {
        /// 0: the arm with the cameras; 1: the arm with the target.
        arm: u8,
        /// Calls of this arm in the step before.
        after: u32,
        /// Number of the query after the last call, from 0.
        query: u32,
        /// `disabled`, `enabled`, `fault`, `emergency stop`, `stopped by other` or `not stopped by other`.
        state: String,
    }
}

message! {
    /// A call of an arm in a control step.
    #[derive(Default)]
    ArmCall = "pb3dp_msgs/ArmCall" {
        /// 0: the arm with the cameras; 1: the arm with the target.
        arm: u8,
        /// `enabled`: the measurement before the first step; `move`, `hold`, `enable`, `enable here`, `begin enable`, `begin enable here`, `poll enable`, `begin stop`, `stop` or `reset`.
        call: String,
        /// Commanded velocity of each joint, rad/s.
        command_rad_per_s: Vec<f64>,
        /// `done`, `pending`, `measured`, or the kind of the failure.
        outcome: String,
        /// Time of the measurement.
        measured_at_nanos: u64,
        /// Measured angle of each joint, rad.
        position_rad: Vec<f64>,
        /// Measured velocity of each joint, rad/s.
        velocity_rad_per_s: Vec<f64>,
    }
}

message! {
    /// The result of a pair, as it reached the control.
    Observed = "pb3dp_msgs/Observed" {
        /// Number of the pair.
        sequence: u64,
        /// Middle of the left exposure.
        exposed_at_nanos: u64,
        /// Middle of the right exposure minus middle of the left one, seconds.
        skew_s: f64,
        /// Number of the target.
        target: u64,
        /// `sure`, `doubtful` or `no pose`.
        confidence: String,
        /// Covariance for the supervisor.
        stated_covariance: Vec<f64>,
        /// Pose of the target in the left camera.
        cam_left_from_model: Vec<f64>,
        /// Whether the controller may use it.
        trusted: bool,
        /// Covariance for the controller.
        covariance: Vec<f64>,
        /// Whether the rotation about the normal is measured.
        rotation_about_normal_observed: bool,
    }
}

message! {
    /// A command of the operator.
    #[derive(Eq)]
    OperatorEntry = "pb3dp_msgs/Said" {
        /// The command.
        word: String,
        /// When it was given.
        at_nanos: u64,
    }
}

message! {
    /// A control step: everything that it depended on, and its results.
    #[derive(Default)]
    ControlStep = "pb3dp_msgs/ControlStep" {
        /// Number of the step, from 0.
        number: u64,
        /// Begin of the step.
        at_nanos: u64,
        /// Inputs that are missing here because the record was too slow.
        lost: u32,
        /// The result of a pair that this step is the first to use.
        observed: Vec<Observed>,
        /// The command of the operator.
        said: Vec<OperatorEntry>,
        /// Last sign of life of the operator.
        heard_at_nanos: Vec<u64>,
        /// Longest silence of this operator.
        silent_after_nanos: Vec<u64>,
        /// Share of the velocity that the operator allows.
        speed_share: f64,
        /// Offset of the desired pose of the hand.
        hand_from_hand_shifted: [f64; 7],
        /// The arm with the target may move before `start`.
        carries_before_start: bool,
        /// Changes of state of the arms.
        changes: Vec<ArmChange>,
        /// Calls of the arms, in order.
        calls: Vec<ArmCall>,
        /// Whether the step came to its end.
        finished: bool,
        /// Mode of the controller.
        mode: String,
        /// State of the supervisor.
        state: String,
        /// Reason and remedy of the supervisor; empty: as in the step before.
        why: String,
        /// Pose of the target in the base of the arm with the cameras, by the filter.
        base_from_model: Vec<f64>,
        /// True pose of the hand; without a simulation that from the measured joints.
        world_from_hand: Vec<f64>,
        /// True pose of the target; without a simulation that from the measured joints.
        world_from_target: Vec<f64>,
        /// Whether each direction of the pose of this result is measured: shifts along x, y, z of the model, and turns about them.
        observed_directions: Later<bool>,
        /// The visible surface beside the model, of this result.
        surface_from_model: Later<f64>,
    }
}

message! {
    /// What the operator has selected for a pair.
    Chosen = "pb3dp_msgs/Chosen" {
        /// `of setup` or `marked`.
        kind: String,
        /// The region.
        region: Marked,
        /// Number of the pair on which it was drawn; its images are on topics of their own.
        drawn_on: Vec<u64>,
    }
}

message! {
    /// The estimate of a pair: everything that it depended on besides the images, and the result.
    #[derive(Default)]
    PairResult = "pb3dp_msgs/PairResult" {
        /// Number of the pair.
        sequence: u64,
        /// Middle of the left exposure.
        exposed_at_nanos: u64,
        /// Middle of the right exposure minus middle of the left one, seconds.
        skew_s: f64,
        /// Whether there are images.
        has_images: bool,
        /// Control steps whose joints the estimate knew.
        steps: u64,
        /// What the operator selected.
        chosen: Vec<Chosen>,
        /// True pose of the target in the left camera.
        cam_left_from_target: Vec<f64>,
        /// Motion of the left camera since the previous pair, from the joints.
        cam_left_prev_from_cam_left_now: Vec<f64>,
        /// Time since the previous pair, seconds.
        since_previous_s: Vec<f64>,
        /// Number of the target.
        target: u64,
        /// The region with which the target was initialised in this pair.
        region: Vec<Marked>,
        /// Status of the estimate.
        status: String,
        /// Its reason.
        reason: String,
        /// Pose of the target in the left camera.
        cam_left_from_model: Vec<f64>,
        /// Its covariance.
        covariance: Vec<f64>,
        /// Agreement of model and images.
        fitness: Vec<f64>,
        /// Whether each direction is observed.
        observed: Vec<bool>,
        /// Whether the rotation about the normal is measured.
        rotation_about_normal_observed: bool,
        /// Outline of the target in the left image: u, v of each point, pixels.
        outline_px: Vec<f64>,
        /// Wall time of the method, milliseconds.
        latency_millis: f64,
        /// Age of the estimate when it reached the control, milliseconds.
        age_millis: f64,
        /// Covariance of the first pose against the visible surface.
        first_pose_covariance: Later<f64>,
        /// Covariance of the pose, that of the first one included.
        pose_covariance: Later<f64>,
        /// The plane of the visible surface beside the model.
        surface_from_model: Later<f64>,
        /// Its covariance.
        surface_covariance: Later<f64>,
        /// Number of pairs that have improved it.
        surface_version: Later<u32>,
        /// The frame `model` that a chosen target had before, in the pair on which it was drawn.
        chosen_model: Later<f64>,
        /// Covariance of the pose that defined it.
        chosen_model_covariance: Later<f64>,
    }
}
