//! Who may move: a model written from docs/supervisor.md. It knows the operator's commands, the pairs that were delivered, the
//! clock and the latches of the arms, but nothing that the supervisor has decided.
//!
//! The answers that the operator sees count in one direction only: a refused command has no effect, and a hold that is not reported
//! as a stall is none. No answer gives a permission, so a supervisor that moves an arm by mistake cannot excuse itself.
//!
//! The model permits too much rather than too little: it does not know the conditions that depend on the filter of the
//! controller (`outlier`, `position_jump`, `orientation_jump`, `controller_rests`), nor `joints_stale`.

mod conditions;
mod stalls;

use conditions::Conditions;
use stalls::{Stall, Stalls};

/// Tolerance of comparisons of times, seconds: the program counts nanoseconds.
const ROUNDING_S: f64 = 1e-6;

/// Times and limits of docs/supervisor.md, with the values of `sim`, restated.
pub mod limits {
    /// A command older than this is refused, seconds: `word_age_max_s`.
    pub const COMMAND_AGE_S: f64 = 0.5;
    /// After a condition with the action hold, `start` and `resume` are refused for this time, seconds: `go_after_s`.
    pub const GO_AFTER_S: f64 = 0.2;
    /// After such a condition the hand resumes without a command after this time, seconds: `resume_after_s`.
    pub const RESUME_AFTER_S: f64 = 0.2;
    /// `operator_silent`: longest time without a sign of life, seconds.
    pub const SILENCE_S: f64 = 1.0;
    /// `clock_stepped`: longest time between two control steps, seconds.
    pub const CLOCK_STEP_S: f64 = 0.2;
    /// Measurements are ahead of the clock by at least `CLOCK_STEP_S` if the clock is behind by this much, seconds: the newest joint
    /// sample is less than 50 ms old, or `joints_stale` holds the arms.
    pub const CLOCK_BEHIND_S: f64 = 0.25;
    /// `arm_disabled`: the drives of an arm are noticed to be disabled within this time, seconds (three exchanges and a reply).
    pub const DISABLED_S: f64 = 0.1;
    /// `frame_stale`, seconds.
    pub const FRAME_AGE_S: f64 = 0.25;
    /// `estimate_stale`, seconds.
    pub const POSE_AGE_S: f64 = 0.3;
    /// `target_lost`, seconds.
    pub const LOST_AGE_S: f64 = 1.0;
    /// `position_uncertain`, metres, and `orientation_uncertain`, radians; both for [`UNCERTAIN_FOR_S`].
    pub const SIGMA: [f64; 2] = [0.020, 6.0 * std::f64::consts::PI / 180.0];
    /// Time for which a pose must be uncertain, seconds.
    pub const UNCERTAIN_FOR_S: f64 = 0.2;
    /// `camera_skew`, seconds, for [`SKEW_FOR_S`].
    pub const SKEW_S: f64 = 0.005;
    /// Time for which exposures must be apart, seconds.
    pub const SKEW_FOR_S: f64 = 0.1;
}
use limits::{COMMAND_AGE_S, GO_AFTER_S, RESUME_AFTER_S};

/// The operator's commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Selects the target.
    Select,
    /// Begins the motion.
    Start,
    /// Both arms hold.
    Hold,
    /// The hand holds.
    HoldHand,
    /// Ends a hold.
    Resume,
    /// Takes the pose of the hand anew: what may move does not change.
    Realign,
    /// Stops both arms.
    Stop,
    /// Clears a stop or a fault.
    Reset,
}

/// A delivered stereo pair with its estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Image number.
    pub number: u64,
    /// Time of exposure by its stamp, seconds.
    pub exposed_s: f64,
    /// Difference of the exposures of both cameras, seconds.
    pub skew_s: f64,
    /// Number of the target.
    pub target: u64,
    /// Whether there is a pose.
    pub has_pose: bool,
    /// Whether the pose is confident.
    pub is_confident: bool,
    /// Standard deviations of position, metres, and orientation, radians; 0 if unknown.
    pub sigma: [f64; 2],
}

/// A control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Time on the clock of the control loop, to which the times of commands and signs of life refer, seconds.
    pub now_s: f64,
    /// True time, seconds.
    pub true_s: f64,
    /// Last sign of life; none before the first one.
    pub heartbeat_s: Option<f64>,
    /// Time for which the drives of an arm have been disabled, seconds.
    pub disabled_s: f64,
}

/// What must come before the hand may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// `reset`, `select` and `start`.
    Latched,
    /// `select` and `start`.
    Idle,
    /// `start`.
    Selected,
    /// `resume`, or `select` and `start`.
    Held,
    /// Nothing.
    Going,
}

/// Whether conditions inhibit the motion of the hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Inhibit {
    /// They do not.
    None,
    /// Parts stand still for a moment: the hand may move on as soon as they work again.
    Stall,
    /// A condition has inhibited it, and has not been gone for long enough.
    Hold,
}

/// A command on its way.
#[derive(Clone, Copy, Debug)]
struct Given {
    command: Command,
    given_s: f64,
    is_refused: bool,
}

/// The model.
#[derive(Clone, Debug)]
pub struct WhoMayMove {
    has_person: bool,
    /// Longest search for a lost target, seconds; 0 if the hand may not search.
    search_max_s: f64,
    stage: Stage,
    /// Begin of the stage, or the last command that ended motion, on the clock of the control loop: older commands refer to something else.
    since_s: f64,
    /// Time of the last control step on this clock.
    now_s: f64,
    /// The target arm waits for `start` or `resume`.
    target_waits: bool,
    given: Option<Given>,
    conditions: Conditions,
    inhibit: Inhibit,
    stalls: Stalls,
    /// What the operator reads in this step: the hand holds for a stall from now on, or does no longer.
    report: Option<bool>,
    /// True time at which the target was lost.
    lost_s: Option<f64>,
    has_searched: bool,
    resets: u32,
}

impl WhoMayMove {
    /// Before the first command. Without a person the target arm follows its path from the beginning.
    pub fn new(has_person: bool, search_max_s: f64) -> Self {
        Self {
            has_person,
            search_max_s,
            stage: Stage::Idle,
            since_s: f64::NEG_INFINITY,
            now_s: f64::NEG_INFINITY,
            target_waits: has_person,
            given: None,
            conditions: Conditions::default(),
            inhibit: Inhibit::None,
            stalls: Stalls::default(),
            report: None,
            lost_s: None,
            has_searched: false,
            resets: 0,
        }
    }

    /// The operator's command arrives at the control loop in this step.
    pub fn commanded(&mut self, command: Command, given_s: f64) {
        self.given = Some(Given { command, given_s, is_refused: false });
    }

    /// The operator sees that the command of this step is refused.
    pub fn refused(&mut self) {
        if let Some(given) = &mut self.given {
            given.is_refused = true;
        }
    }

    /// The operator reads that the hand holds for a stall from this step on, or that the stall ends.
    pub fn reported(&mut self, is_stall: bool) {
        self.report = Some(is_stall);
    }

    /// A pair is delivered to the control loop.
    pub fn saw(&mut self, pair: Pair) {
        self.conditions.newest = Some(pair);
    }

    /// An arm has latched by a fault or an emergency stop, or a control step has failed.
    pub fn latched(&mut self) {
        self.enter(Stage::Latched, self.now_s);
    }

    /// A control step: conditions take precedence over commands, except those that only end motion.
    pub fn stepped(&mut self, moment: &Moment) {
        let now_s = moment.now_s;
        self.now_s = now_s;
        // After the clock has stepped back, new commands must not count as older than the stage.
        self.since_s = self.since_s.min(now_s);
        self.conditions.look(moment);
        let given = self.given.take();
        let wanted = given.filter(|given| !given.is_refused);
        if let Some(Given { command: command @ (Command::Hold | Command::HoldHand | Command::Stop), .. }) = wanted {
            self.ends_motion(command, now_s);
        }
        self.withdraw(moment);
        if let Some(given) = given {
            self.leads_on(given, now_s);
        }
        self.inhibit(moment.true_s);
    }

    fn enter(&mut self, stage: Stage, now_s: f64) {
        if self.stage != stage {
            (self.stage, self.since_s) = (stage, now_s);
        }
        if stage != Stage::Going {
            self.lost_s = None;
        }
        if matches!(stage, Stage::Latched | Stage::Idle | Stage::Selected) {
            self.conditions.started = None;
            self.inhibit = Inhibit::None;
        }
    }

    fn ends_motion(&mut self, command: Command, now_s: f64) {
        match (command, self.stage) {
            (_, Stage::Latched) => {}
            (Command::Stop, _) => self.enter(Stage::Latched, now_s),
            (_, Stage::Going) => self.enter(Stage::Held, now_s),
            _ => {}
        }
        self.since_s = now_s;
        self.target_waits |= command == Command::Hold;
    }

    /// Conditions that need the operator.
    fn withdraw(&mut self, moment: &Moment) {
        let follows = matches!(self.stage, Stage::Going | Stage::Held);
        if follows && self.has_person && self.conditions.is_silent {
            self.enter(Stage::Latched, moment.now_s);
        } else if follows && self.conditions.needs_operator() {
            self.target_waits |= self.conditions.holds_both();
            self.enter(Stage::Held, moment.now_s);
        }
    }

    /// Commands that lead to motion.
    fn leads_on(&mut self, Given { command, given_s, is_refused }: Given, now_s: f64) {
        let age_s = now_s - given_s;
        let is_timely = age_s.abs() <= COMMAND_AGE_S + ROUNDING_S && given_s >= self.since_s - ROUNDING_S;
        // Of a reset that is refused because one arm cannot be reset, the other arm may take notice.
        self.resets += u32::from(is_timely && command == Command::Reset && self.stage == Stage::Latched);
        if !is_timely || is_refused {
            return;
        }
        let may_go = self.conditions.is_clear_for(GO_AFTER_S);
        match (command, self.stage) {
            (Command::Reset, Stage::Latched) => {
                self.enter(Stage::Idle, now_s);
                self.target_waits |= self.has_person;
            }
            // The select of a moving hand is refused.
            (Command::Select, Stage::Idle | Stage::Selected | Stage::Held | Stage::Going) => {
                self.since_s = now_s;
                self.enter(Stage::Selected, now_s);
                self.conditions.select(now_s);
            }
            // `start` means the target that was followed when it was given.
            (Command::Start, Stage::Selected) if may_go && given_s >= self.conditions.followed_since_s - ROUNDING_S => {
                self.conditions.started = self.conditions.followed;
                self.go(now_s);
            }
            (Command::Resume, Stage::Held) if may_go => self.go(now_s),
            // The hand holds because of a condition that has gone, and need not wait.
            (Command::Resume, Stage::Going) if may_go => {
                self.inhibit = Inhibit::None;
                self.target_waits = false;
            }
            _ => {}
        }
    }

    fn go(&mut self, now_s: f64) {
        self.enter(Stage::Going, now_s);
        self.target_waits = false;
        self.inhibit = Inhibit::None;
        self.has_searched = false;
    }

    /// Holds of the hand that end without a command: a stall at once, others after some time.
    fn inhibit(&mut self, true_s: f64) {
        let is_still = self.stage == Stage::Going && self.conditions.are_only_parts_still();
        let stall = self.stalls.look(self.report.take(), is_still, self.now_s);
        if self.stage != Stage::Going {
            return;
        }
        self.inhibit = match (self.inhibit, stall) {
            (Inhibit::None | Inhibit::Stall, Stall::On) if self.conditions.holds() => Inhibit::Stall,
            _ if self.conditions.holds() => Inhibit::Hold,
            _ if self.conditions.is_clear_for(RESUME_AFTER_S) => Inhibit::None,
            (Inhibit::Stall, Stall::Over) if self.conditions.is_clear() => Inhibit::None,
            (Inhibit::Stall, Stall::None | Stall::Over) => Inhibit::Hold,
            (inhibit, _) => inhibit,
        };
        if self.inhibit == Inhibit::None {
            (self.lost_s, self.has_searched) = (None, false);
        } else if self.conditions.is_lost && self.lost_s.is_none() && !self.has_searched {
            (self.lost_s, self.has_searched) = (Some(true_s), true);
        }
    }

    /// Whether the hand may move: the operator permits it.
    pub fn hand_may_go(&self) -> bool {
        self.stage == Stage::Going
    }

    /// Whether a condition inhibits the hand, which may not search either.
    pub fn is_hand_inhibited(&self, true_s: f64) -> bool {
        self.inhibit != Inhibit::None && !self.may_search(true_s)
    }

    /// Whether the target arm may move.
    pub fn target_may_go(&self) -> bool {
        let has_begun = !self.has_person || matches!(self.stage, Stage::Going | Stage::Held);
        has_begun && self.stage != Stage::Latched && !self.target_waits && !self.conditions.holds_both()
    }

    /// Whether the hand may search for the lost target.
    pub fn may_search(&self, true_s: f64) -> bool {
        /// A search that exceeds its time ends within this time, seconds.
        const ENDS_WITHIN_S: f64 = 0.02;
        let is_early = self.lost_s.is_some_and(|lost_s| true_s - lost_s <= self.search_max_s + ENDS_WITHIN_S);
        self.search_max_s > 0.0 && is_early && self.stage == Stage::Going
    }

    /// Whether the operator has stopped both arms, or has to clear a fault.
    pub fn is_latched(&self) -> bool {
        self.stage == Stage::Latched
    }

    /// Number of the operator's resets in time, each of which may clear the latch of an arm.
    pub fn resets(&self) -> u32 {
        self.resets
    }

    /// The target that the operator started.
    pub fn started(&self) -> Option<u64> {
        self.conditions.started
    }
}

#[cfg(test)]
mod tests;
