//! Which event leads where: the whole supervisor on one page.

use std::fmt;

/// Where the supervisor is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// No target is selected; the arm rests.
    Idle,
    /// A target is selected and looked for; the arm rests until the operator starts it.
    Selecting,
    /// The hand goes to its place before the target.
    Approaching,
    /// The hand follows.
    Tracking,
    /// The arm rests, the target is kept; the way on is open when the cause is gone.
    Holding,
    /// The arm rests, because the target is lost.
    Lost,
    /// Both arms are stopped, by the operator or by a policy; latched.
    Stopped,
    /// Both arms are stopped by a fault; latched.
    Fault,
}

/// What can happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// Said: this is the target.
    Select,
    /// Said: follow it.
    Start,
    /// Said: come to rest.
    Hold,
    /// Said: go on after a rest.
    Resume,
    /// Said: stop both arms.
    Stop,
    /// Said: clear the latched state.
    Reset,
    /// The hand is at its place before the target.
    Reached,
    /// The hand has to approach again.
    Left,
    /// What held the arm has been gone for long enough, and the policy lets it go on.
    CauseGone,
    /// The lost target is seen again, has been for long enough, and the policy lets the arm go on.
    TargetFound,
    /// Found: something that asks for rest.
    HoldFound,
    /// Found: the target is lost.
    LossFound,
    /// Found: something that asks for a stop.
    StopFound,
    /// Found: a fault.
    FaultFound,
}

/// What goes with a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Nothing.
    None,
    /// The controller drops its set-points and takes them anew from what is measured from now on.
    Rearm,
    /// The same, and both arms are stopped.
    RearmAndStop,
}

/// What an event does in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Another state, or the same one begun anew.
    To(State, Order),
    /// Allowed, and changes nothing.
    Stay,
    /// Not in this state.
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

    /// Whether the arm rests between motions, with its target kept in mind.
    pub fn is_resting(self) -> bool {
        matches!(self, Self::Holding | Self::Lost)
    }

    /// Whether only the operator's reset leads on.
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
    pub const ALL: [Self; 14] = [
        Self::Select,
        Self::Start,
        Self::Hold,
        Self::Resume,
        Self::Stop,
        Self::Reset,
        Self::Reached,
        Self::Left,
        Self::CauseGone,
        Self::TargetFound,
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
            Self::Stop => "stop",
            Self::Reset => "reset",
            Self::Reached => "reached",
            Self::Left => "left",
            Self::CauseGone => "cause-gone",
            Self::TargetFound => "target-found",
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

/// What an event does in a state.
///
/// `Start`, `Resume` and `Reset` come here only if no condition inhibits them, see [`super::Supervisor::step`].
#[rustfmt::skip]
pub fn outcome(state: State, event: Event) -> Outcome {
    use Outcome::{Refuse, Stay, To};
    const N: Outcome = Refuse;
    const IDLE: Outcome = To(State::Idle, Order::Rearm);
    const SEL: Outcome = To(State::Selecting, Order::Rearm);
    const APP: Outcome = To(State::Approaching, Order::None);
    const TRA: Outcome = To(State::Tracking, Order::None);
    const HOLD: Outcome = To(State::Holding, Order::Rearm);
    const LOST: Outcome = To(State::Lost, Order::Rearm);
    const STOP: Outcome = To(State::Stopped, Order::RearmAndStop);
    const F: Outcome = To(State::Fault, Order::RearmAndStop);
    const TABLE: [[Outcome; 14]; 8] = [
        // Select Start Hold  Resume Stop  Reset Reached Left  CauseGone TargetFound HoldFound LossFound StopFound FaultFound
        [SEL,     N,    Stay, N,     STOP, Stay, Stay,   Stay, Stay,     Stay,       Stay,     Stay,     STOP,     F],    // Idle
        [SEL,     APP,  Stay, N,     STOP, Stay, Stay,   Stay, Stay,     Stay,       Stay,     Stay,     STOP,     F],    // Selecting
        [N,       Stay, HOLD, Stay,  STOP, Stay, TRA,    Stay, Stay,     Stay,       HOLD,     LOST,     STOP,     F],    // Approaching
        [N,       Stay, HOLD, Stay,  STOP, Stay, Stay,   APP,  Stay,     Stay,       HOLD,     LOST,     STOP,     F],    // Tracking
        [SEL,     N,    Stay, APP,   STOP, Stay, Stay,   Stay, APP,      Stay,       Stay,     LOST,     STOP,     F],    // Holding
        [SEL,     N,    Stay, APP,   STOP, Stay, Stay,   Stay, Stay,     APP,        Stay,     Stay,     STOP,     F],    // Lost
        [N,       N,    Stay, N,     Stay, IDLE, Stay,   Stay, Stay,     Stay,       Stay,     Stay,     Stay,     F],    // Stopped
        [N,       N,    Stay, N,     Stay, IDLE, Stay,   Stay, Stay,     Stay,       Stay,     Stay,     Stay,     Stay], // Fault
    ];
    TABLE[state as usize][event as usize]
}
