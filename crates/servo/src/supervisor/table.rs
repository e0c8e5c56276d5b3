//! The complete table of states and events.

use std::fmt;

/// State of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// No target is selected; the arm holds.
    Idle,
    /// A target is selected and observed; the arm holds until the operator's `start`.
    Selecting,
    /// The hand moves to its desired pose relative to the target.
    Approaching,
    /// The hand follows the target.
    Tracking,
    /// The arm holds and keeps its target; it can resume when the cause is gone.
    Holding,
    /// The arm holds because the target is lost.
    Lost,
    /// Both arms are stopped and latched, by the operator or by a policy.
    Stopped,
    /// Both arms are stopped and latched by a fault.
    Fault,
}

/// Events: operator commands, progress of the motion, detected conditions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// Command: initialise this target.
    Select,
    /// Command: follow the target.
    Start,
    /// Command: hold.
    Hold,
    /// Command: continue after a hold.
    Resume,
    /// Command: take the pose relative to the visible surface as it is known now.
    Realign,
    /// Command: stop both arms.
    Stop,
    /// Command: clear the latched state.
    Reset,
    /// The hand has reached its desired pose.
    Reached,
    /// The hand has to approach again.
    Left,
    /// The cause of the hold has been gone for long enough, and its policy allows to resume automatically.
    CauseGone,
    /// The lost target has been observed again for long enough, and the policy allows to resume automatically.
    TargetFound,
    /// A part stood still for a moment: a hold that keeps the target.
    StallFound,
    /// Every part works again, and the target is still certain enough.
    StallOver,
    /// The stall is none: it lasts too long, or something else inhibits motion.
    StallFailed,
    /// A condition with the action hold.
    HoldFound,
    /// The target is lost.
    LossFound,
    /// A condition with the action stop.
    StopFound,
    /// A condition with the action fault.
    FaultFound,
}

/// Side effect of a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// None.
    None,
    /// The controller drops its set-points and takes new ones from later measurements.
    Rearm,
    /// The same, and both arms are stopped.
    RearmAndStop,
}

/// Effect of an event in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Another state, or the same one entered again.
    To(State, Order),
    /// Accepted without effect.
    Stay,
    /// Refused in this state.
    Refuse,
}

impl State {
    /// All states, in the order of the table.
    pub const ALL: [Self; 8] = [
        Self::Idle,
        Self::Selecting,
        Self::Approaching,
        Self::Tracking,
        Self::Holding,
        Self::Lost,
        Self::Stopped,
        Self::Fault,
    ];

    /// Whether the arm may move.
    pub fn is_moving(self) -> bool {
        matches!(self, Self::Approaching | Self::Tracking)
    }

    /// Whether the arm holds and keeps its target.
    pub fn is_resting(self) -> bool {
        matches!(self, Self::Holding | Self::Lost)
    }

    /// Whether only the operator's reset leaves the state.
    pub fn is_latched(self) -> bool {
        matches!(self, Self::Stopped | Self::Fault)
    }

    /// The name in logs and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Selecting => "selecting",
            Self::Approaching => "approaching",
            Self::Tracking => "tracking",
            Self::Holding => "holding",
            Self::Lost => "lost",
            Self::Stopped => "stopped",
            Self::Fault => "fault",
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl Event {
    /// All events, in the order of the table.
    pub const ALL: [Self; 18] = [
        Self::Select,
        Self::Start,
        Self::Hold,
        Self::Resume,
        Self::Realign,
        Self::Stop,
        Self::Reset,
        Self::Reached,
        Self::Left,
        Self::CauseGone,
        Self::TargetFound,
        Self::StallFound,
        Self::StallOver,
        Self::StallFailed,
        Self::HoldFound,
        Self::LossFound,
        Self::StopFound,
        Self::FaultFound,
    ];

    /// The name in logs and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Select => "select",
            Self::Start => "start",
            Self::Hold => "hold",
            Self::Resume => "resume",
            Self::Realign => "re-align",
            Self::Stop => "stop",
            Self::Reset => "reset",
            Self::Reached => "reached",
            Self::Left => "left",
            Self::CauseGone => "cause-gone",
            Self::TargetFound => "target-found",
            Self::StallFound => "stall-found",
            Self::StallOver => "stall-over",
            Self::StallFailed => "stall-failed",
            Self::HoldFound => "hold-found",
            Self::LossFound => "loss-found",
            Self::StopFound => "stop-found",
            Self::FaultFound => "fault-found",
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Effect of an event in a state.
///
/// `Start`, `Resume` and `Reset` are passed only if no condition inhibits them, see [`super::Supervisor::step`].
#[rustfmt::skip]
pub fn outcome(state: State, event: Event) -> Outcome {
    use Outcome::{Refuse, Stay, To};
    const N: Outcome = Refuse;
    const IDLE: Outcome = To(State::Idle, Order::Rearm);
    const SEL: Outcome = To(State::Selecting, Order::Rearm);
    const APP: Outcome = To(State::Approaching, Order::None);
    const TRA: Outcome = To(State::Tracking, Order::None);
    const HOLD: Outcome = To(State::Holding, Order::Rearm);
    const STALL: Outcome = To(State::Holding, Order::None);
    const LOST: Outcome = To(State::Lost, Order::Rearm);
    const STOP: Outcome = To(State::Stopped, Order::RearmAndStop);
    const F: Outcome = To(State::Fault, Order::RearmAndStop);
    const TABLE: [[Outcome; 18]; 8] = [
        // Select Start Hold  Resume Realign Stop  Reset Reached Left  CauseGone TargetFound StallFound StallOver StallFailed HoldFound LossFound StopFound FaultFound
        [SEL,     N,    Stay, N,     N,      STOP, Stay, Stay,   Stay, Stay,     Stay,       Stay,      Stay,     Stay,       Stay,     Stay,     STOP,     F],    // Idle
        [SEL,     APP,  Stay, N,     N,      STOP, Stay, Stay,   Stay, Stay,     Stay,       Stay,      Stay,     Stay,       Stay,     Stay,     STOP,     F],    // Selecting
        [N,       Stay, HOLD, Stay,  APP,    STOP, Stay, TRA,    Stay, Stay,     Stay,       STALL,     Stay,     Stay,       HOLD,     LOST,     STOP,     F],    // Approaching
        [N,       Stay, HOLD, Stay,  APP,    STOP, Stay, Stay,   APP,  Stay,     Stay,       STALL,     Stay,     Stay,       HOLD,     LOST,     STOP,     F],    // Tracking
        [SEL,     N,    Stay, APP,   N,      STOP, Stay, Stay,   Stay, APP,      Stay,       Stay,      APP,      HOLD,       Stay,     LOST,     STOP,     F],    // Holding
        [SEL,     N,    Stay, APP,   N,      STOP, Stay, Stay,   Stay, Stay,     APP,        Stay,      Stay,     Stay,       Stay,     Stay,     STOP,     F],    // Lost
        [N,       N,    Stay, N,     N,      Stay, IDLE, Stay,   Stay, Stay,     Stay,       Stay,      Stay,     Stay,       Stay,     Stay,     Stay,     F],    // Stopped
        [N,       N,    Stay, N,     N,      Stay, IDLE, Stay,   Stay, Stay,     Stay,       Stay,      Stay,     Stay,       Stay,     Stay,     Stay,     Stay], // Fault
    ];
    TABLE[state as usize][event as usize]
}
