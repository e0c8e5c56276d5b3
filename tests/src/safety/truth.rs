//! The true course of a simulated run, step by step, as plain numbers.
//!
//! Times are seconds of the simulation's own clock since the run began; injected clock steps do not change them.

/// One number per joint, from the base.
pub type Joints = [f64; 7];

/// Index of the arm that carries the cameras.
pub const HAND_ARM: usize = 0;
/// Index of the arm that carries the target.
pub const TARGET_ARM: usize = 1;
/// Names of the arms by index.
pub const ARM_NAMES: [&str; 2] = ["vs-robot", "tc-robot"];

/// A rigid motion `a_from_b`, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Rows of the rotation matrix.
    pub rotation: [[f64; 3]; 3],
    /// Position of the origin of `b` in `a`, metres.
    pub translation_m: [f64; 3],
}

impl Placement {
    /// No motion.
    pub const IDENTITY: Self =
        Self { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation_m: [0.0; 3] };

    /// `a_from_b * b_from_c`.
    pub fn then(&self, inner: &Self) -> Self {
        let rotation = std::array::from_fn(|row| {
            std::array::from_fn(|column| (0..3).map(|k| self.rotation[row][k] * inner.rotation[k][column]).sum())
        });
        Self { rotation, translation_m: self.point(&inner.translation_m) }
    }

    /// Transforms a point from `b` to `a`, metres.
    pub fn point(&self, point_m: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|row| {
            self.translation_m[row] + (0..3).map(|k| self.rotation[row][k] * point_m[k]).sum::<f64>()
        })
    }
}

/// One arm at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmTruth {
    /// True angles, radians.
    pub position_rad: Joints,
    /// True velocities, rad/s.
    pub velocity_rad_per_s: Joints,
    /// Whether all servos are enabled.
    pub servo_on: bool,
    /// By joint, whether its drive moves it: not while its brake holds it, or nothing does.
    pub driven: [bool; 7],
    /// Whether all brakes hold.
    pub brakes_closed: bool,
    /// Time of the fault or emergency stop that is latched now, wherever it latched first (controller, gateway, driver,
    /// supervisor), seconds; none if nothing is latched.
    pub latched_since_s: Option<f64>,
    /// By joint, whether an injected fault moves or blocks it at present.
    pub by_itself: [bool; 7],
    /// By joint, whether it does not follow its command: while a fault moves it by itself, and until it has come to rest after that.
    pub disobeys: [bool; 7],
    /// Whether the operator's commands permit motion of the arm ([`WhoMayMove`](super::who_may_move::WhoMayMove)).
    pub may_go: bool,
    /// Time since the last command that could reach the arm, seconds: since the last control step, or since nothing from the
    /// host has reached the gateway of the arm.
    pub command_age_s: f64,
    /// Whether commands may be lost or late on their way to the drives, or were so a short time ago.
    pub commands_disturbed: bool,
    /// Whether the controller or the gateway stop the arm by themselves, and the program may not know it yet.
    pub stops_by_itself: bool,
    /// Whether the program told the arm to hold, now or so short ago that the driver may still brake it.
    pub ramps: bool,
}

impl ArmTruth {
    /// A stationary arm with open brakes.
    pub fn resting_at(position_rad: Joints) -> Self {
        Self {
            position_rad,
            velocity_rad_per_s: [0.0; 7],
            servo_on: true,
            driven: [true; 7],
            brakes_closed: false,
            latched_since_s: None,
            by_itself: [false; 7],
            disobeys: [false; 7],
            may_go: true,
            command_age_s: 0.0,
            commands_disturbed: false,
            stops_by_itself: false,
            ramps: false,
        }
    }

    /// Whether each joint follows its command.
    pub fn obeys(&self) -> bool {
        !self.disobeys.contains(&true)
    }
}

/// One moment of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Seconds since the run began.
    pub t_s: f64,
    /// Both arms, that with the cameras first.
    pub arms: [ArmTruth; 2],
    /// True pose of the target.
    pub world_from_target: Placement,
    /// Time since the exposure of the newest delivered estimate that is confident and of a new image, seconds; infinite
    /// before the first one.
    pub pose_age_s: f64,
    /// Whether the hand may search for the target: the run permits it, the target is lost, and not for too long.
    pub may_search: bool,
    /// Whether a condition inhibits motion of the hand, or has not been gone for long enough.
    pub is_inhibited: bool,
    /// By how much the content of the delivered pairs is older than their stamps, seconds.
    pub content_late_s: f64,
    /// Number of resets by the operator that may have cleared a latch.
    pub resets: u32,
    /// Name of the supervisor's state.
    pub state: &'static str,
    /// Whether the supervisor's status line gives the reason of a hold.
    pub says_why: bool,
}

/// A line of the run's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// Milliseconds since the run began.
    pub t_millis: u64,
    /// Its text.
    pub text: String,
}

/// An injected fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Injected {
    /// Name in messages.
    pub name: String,
    /// Start, seconds.
    pub from_s: f64,
    /// End, seconds.
    pub until_s: f64,
    /// Whether it had an effect: an image was lost, a reply did not come, a joint moved by itself.
    pub had_effect: bool,
    /// A log line must contain at least one of these.
    pub log_terms: &'static [&'static str],
}

/// A whole run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// In order of time, no farther apart than [`Rules::step_max_s`](super::rules::Rules::step_max_s).
    pub steps: Vec<Step>,
    /// In order of time.
    pub log: Vec<LogLine>,
    /// In any order.
    pub injected: Vec<Injected>,
}

impl Truth {
    /// Clears the run and keeps the memory for the next one.
    pub fn clear(&mut self) {
        self.steps.clear();
        self.log.clear();
        self.injected.clear();
    }
}
