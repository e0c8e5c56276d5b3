//! What truly happened in a simulated run, step by step, as plain numbers.
//!
//! Times are seconds of the simulation's own time since the run began, which no injected step of a clock changes.

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
    /// Where the origin of `b` is in `a`, metres.
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

    /// A point given in `b`, in `a`, metres.
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
    /// Whether all servos are on.
    pub servo_on: bool,
    /// Whether all brakes hold.
    pub brakes_closed: bool,
    /// When the fault or emergency stop came that is latched now, wherever it latched first (controller, gateway, driver,
    /// supervisor), seconds; none if nothing is latched.
    pub latched_since_s: Option<f64>,
    /// Whether each joint follows its command: false while an injected fault moves a joint by itself.
    pub obeys: bool,
    /// The joint that an injected fault moves or keeps at present, from 0.
    pub by_itself: Option<usize>,
    /// Whether the operator's last word lets the arm move: for the hand `start` or `resume`, or the policy that takes the place of
    /// `resume`, with no `hold`, `stop` or latched fault since; for the other arm the begin of the experiment.
    pub may_go: bool,
}

impl ArmTruth {
    /// An arm that rests with open brakes.
    pub fn resting_at(position_rad: Joints) -> Self {
        Self {
            position_rad,
            velocity_rad_per_s: [0.0; 7],
            servo_on: true,
            brakes_closed: false,
            latched_since_s: None,
            obeys: true,
            by_itself: None,
            may_go: true,
        }
    }
}

/// One moment of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Seconds since the run began.
    pub t_s: f64,
    /// Both arms, that with the cameras first.
    pub arms: [ArmTruth; 2],
    /// Where the target truly is.
    pub world_from_target: Placement,
    /// Time since the exposure of the newest estimate that was delivered, by which the estimator stands and whose image was
    /// new, seconds; infinite before the first one.
    pub pose_age_s: f64,
    /// Whether the hand may look for the target: the run permits it, the target is lost, and not for too long.
    pub may_search: bool,
    /// How often the operator has reset.
    pub resets: u32,
    /// Name of the supervisor's state.
    pub state: &'static str,
    /// Whether the supervisor gives a line that says why it does not move.
    pub says_why: bool,
}

/// A line of the run's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// Milliseconds since the run began.
    pub t_millis: u64,
    /// What it says.
    pub text: String,
}

/// A fault that was injected.
#[derive(Clone, Debug, PartialEq)]
pub struct Injected {
    /// For messages.
    pub name: String,
    /// When it began, seconds.
    pub from_s: f64,
    /// When it ended, seconds.
    pub until_s: f64,
    /// Whether anything came of it: an image was lost, a reply did not come, a joint moved by itself.
    pub had_effect: bool,
    /// At least one of these has to be in a line of the log.
    pub words: &'static [&'static str],
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
    /// Forgets the run and keeps the memory for the next one.
    pub fn clear(&mut self) {
        self.steps.clear();
        self.log.clear();
        self.injected.clear();
    }
}
