//! Messages of the supervisor: one line for every reason that inhibits motion, with value, limit and remedy.

use std::fmt;

use pb3dp_message_codes::{Coded, MessageCode};

use super::findings::{Cause, Detail};
use super::inputs::{ARM_NAMES, OperatorCommand};
use super::policy::Condition;
use super::table::State;

/// Why the arm does not move, or how it moves. `Display` writes one line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Why {
    /// No target is selected.
    Idle,
    /// The target is observed, and no condition inhibits motion.
    Ready,
    /// The target is selected; this condition inhibits motion.
    Waiting {
        /// The condition.
        cause: Cause,
    },
    /// No condition inhibits motion any more, but the time since then is too short.
    Settling {
        /// Selecting, holding or lost.
        state: State,
        /// The last condition.
        cause: Option<Cause>,
        /// Remaining time, seconds.
        for_s: f64,
    },
    /// The arm moves.
    Moving {
        /// Approaching or tracking.
        state: State,
    },
    /// The arm moves more slowly than the controller requests.
    Slowed {
        /// Approaching or tracking.
        state: State,
        /// The condition.
        cause: Cause,
        /// Share of the velocity.
        share: f64,
    },
    /// The target is lost, and the hand searches for it.
    Searching,
    /// The arm holds, and this condition inhibits motion.
    Resting {
        /// Holding or lost.
        state: State,
        /// The condition.
        cause: Cause,
        /// How the arm resumes afterwards.
        then: Then,
    },
    /// The arm holds, and no condition inhibits motion any more.
    CauseGone {
        /// Holding or lost.
        state: State,
        /// The last condition.
        cause: Cause,
        /// How the arm resumes.
        then: Then,
    },
    /// The arm holds by command of the operator.
    HeldByOperator {
        /// Holding or lost.
        state: State,
        /// Whether the arm with the target holds too.
        every_arm: bool,
        /// Another condition that inhibits motion.
        cause: Option<Cause>,
    },
    /// Both arms are stopped by the operator.
    StoppedByOperator,
    /// Both arms are stopped by a policy.
    Latched {
        /// Stopped or fault.
        state: State,
        /// The condition.
        cause: Cause,
        /// Whether the condition is no longer active.
        is_gone: bool,
    },
}

/// How the arm resumes after a hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Then {
    /// The operator's `resume`.
    Resume,
    /// Automatically, after a time without an active inhibit.
    ByItself {
        /// Seconds.
        after_s: f64,
    },
}

/// A refused command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refusal {
    /// The command.
    pub command: OperatorCommand,
    /// The reason.
    pub because: RefusedFor,
}

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RefusedFor {
    /// It is not possible in this state.
    State(State),
    /// It is too old, or has a future time.
    Age {
        /// Its age, seconds.
        age_s: f64,
        /// Largest allowed age, seconds.
        age_max_s: f64,
    },
    /// It was given before the state changed, or before the operator ended motion.
    OlderThanState(State),
    /// It was given before the present target was observed.
    OlderThanTarget,
    /// The state changed in the same step.
    Overtaken(State),
    /// This condition inhibits motion.
    Cause(Cause),
    /// No condition inhibits motion any more, but the time since then is too short.
    NotClear {
        /// The last condition.
        cause: Option<Cause>,
        /// Time since it ended, seconds.
        clear_s: f64,
        /// Required time, seconds.
        wanted_s: f64,
    },
}

impl Why {
    /// Whether motion continues only after the command `resume`.
    pub fn waits_for_resume(&self) -> bool {
        matches!(
            self,
            Self::Resting { then: Then::Resume, .. }
                | Self::CauseGone { then: Then::Resume, .. }
                | Self::HeldByOperator { .. }
        )
    }

    /// The code of the condition that inhibits motion or has latched the arms.
    pub fn code(&self) -> Option<&'static MessageCode> {
        match self {
            Self::Waiting { cause }
            | Self::Slowed { cause, .. }
            | Self::Resting { cause, .. }
            | Self::HeldByOperator { cause: Some(cause), .. }
            | Self::Latched { cause, .. } => Some(cause.condition.message_code()),
            _ => None,
        }
    }

    /// The same line for a run to which nobody can give commands.
    pub fn without_console(&self) -> impl fmt::Display {
        WithoutConsole(*self)
    }

    fn write_line(&self, f: &mut fmt::Formatter<'_>, has_console: bool) -> fmt::Result {
        self.write_sentence(f, has_console)?;
        self.code().map_or(Ok(()), |known| write!(f, " [{}]", known.code))
    }

    fn write_sentence(&self, f: &mut fmt::Formatter<'_>, has_console: bool) -> fmt::Result {
        let begin = |command, otherwise| Action { command, otherwise, has_console };
        let again = |command| Action { command, otherwise: "start a new run", has_console };
        match self {
            Self::Idle => write!(f, "idle: no target selected; {}", begin("select", "the program selects it")),
            Self::Ready => write!(f, "selecting: target seen, no active inhibit; {}", begin("start", STARTS)),
            Self::Waiting { cause } => {
                write!(f, "selecting: {cause}; {}, then {}", remedy(cause), begin("start", STARTS))
            }
            Self::Settling { state, cause, for_s } => {
                let command = if *state == State::Selecting { "start" } else { "resume" };
                write!(f, "{state}: {}; ready to {command} in {for_s:.1} s", Gone(cause))
            }
            Self::Moving { state } => write!(f, "{state}"),
            Self::Searching => {
                write!(f, "lost: the hand searches for the target near its last position")?;
                if has_console { write!(f, "; use hold to end the search") } else { Ok(()) }
            }
            Self::Slowed { state, cause, share } => {
                write!(f, "{state}: slowed to {:.0} %: {cause}; {}", share * 100.0, remedy(cause))
            }
            Self::Resting { state, cause, then: Then::Resume } => {
                write!(f, "{state}: {cause}; {}, then {}", remedy(cause), again("resume"))
            }
            Self::Resting { state, cause, then: Then::ByItself { after_s } } => {
                write!(f, "{state}: {cause}; {}; resumes by itself {}", remedy(cause), After(*after_s))
            }
            Self::CauseGone { state, cause, then: Then::Resume } => {
                write!(f, "{state}: {}; {}", Gone(&Some(*cause)), again("resume"))
            }
            Self::CauseGone { state, cause, then: Then::ByItself { after_s } } => {
                write!(f, "{state}: {}; resumes by itself in {after_s} s", Gone(&Some(*cause)))
            }
            Self::HeldByOperator { state, every_arm, cause: None } => {
                write!(f, "{state}: {} by the operator; {}", Held(*every_arm), again("resume"))
            }
            Self::HeldByOperator { state, every_arm, cause: Some(cause) } => {
                let (held, remedy) = (Held(*every_arm), remedy(cause));
                write!(f, "{state}: {held} by the operator; also {cause}; {remedy}, then {}", again("resume"))
            }
            Self::StoppedByOperator => {
                let enables = if has_console { ", then select, which enables the arms, then start" } else { "" };
                write!(f, "stopped: by the operator; {}{enables}", again("reset"))
            }
            Self::Latched { state, cause, is_gone: false } => {
                write!(f, "{state}: {cause}; {}, then {}", remedy(cause), again("reset"))
            }
            Self::Latched { state, cause, is_gone: true } => {
                write!(f, "{state}: cleared: {cause}; {}", again("reset"))
            }
        }
    }
}

/// Where the program gives the command `start`.
const STARTS: &str = "the program starts the motion";

/// What can be done next: a command of the operator, or something else if nobody can give one.
struct Action {
    command: &'static str,
    otherwise: &'static str,
    has_console: bool,
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.has_console {
            true => write!(f, "use {}", self.command),
            false => f.write_str(self.otherwise),
        }
    }
}

struct WithoutConsole(Why);

impl fmt::Display for WithoutConsole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.write_line(f, false)
    }
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_line(f, true)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write_sentence(f)?;
        write!(f, " [{}]", self.code().code)
    }
}

impl Refusal {
    /// The code of the condition that inhibits the command, or of the reason why it is refused.
    pub fn code(&self) -> &'static MessageCode {
        match &self.because {
            RefusedFor::Cause(cause) => cause.condition.message_code(),
            because => because.message_code(),
        }
    }

    fn write_sentence(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} refused: ", self.command.name())?;
        match &self.because {
            RefusedFor::State(state) => write!(f, "not possible in the state {state}{}", instead(*state)),
            RefusedFor::Age { age_s, age_max_s } => {
                write!(f, "the request is {age_s:.3} s old, limit {age_max_s:.3} s; repeat it")
            }
            RefusedFor::OlderThanState(state) => {
                write!(
                    f,
                    "requested before the state changed to {state}, or before a later hold or stop; check, then repeat it"
                )
            }
            RefusedFor::OlderThanTarget => {
                write!(f, "requested before the current target was seen; check, then repeat it")
            }
            RefusedFor::Overtaken(state) => {
                write!(f, "the state changed to {state} in the same step; check, then repeat it")
            }
            RefusedFor::Cause(cause) if self.command == OperatorCommand::Reset => {
                write!(f, "{cause}; {}, then use reset again", remedy(cause))
            }
            RefusedFor::Cause(cause) => write!(f, "{cause}; {}", remedy(cause)),
            RefusedFor::NotClear { cause, clear_s, wanted_s } => {
                write!(f, "{}, for {clear_s:.3} s; it must last {wanted_s:.3} s; repeat it", Gone(cause))
            }
        }
    }
}

/// Remedy for a command that is not possible in this state.
fn instead(state: State) -> &'static str {
    match state {
        State::Idle => "; use select first",
        State::Selecting => "; use start first",
        State::Approaching | State::Tracking => ", the hand already follows the target; use hold or stop",
        State::Holding | State::Lost => "; use resume",
        State::Stopped | State::Fault => "; use reset first",
    }
}

/// When the arm resumes, seconds after the cause is gone.
struct After(f64);

impl fmt::Display for After {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0.0 => f.write_str("as soon as the cause is gone"),
            after_s => write!(f, "{after_s} s after the cause is gone"),
        }
    }
}

/// Which arms the operator holds.
struct Held(bool);

impl fmt::Display for Held {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0 { "both arms held" } else { "camera arm held" })
    }
}

/// Message for a cleared cause.
struct Gone<'a>(&'a Option<Cause>);

impl fmt::Display for Gone<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(cause) => write!(f, "cleared: {cause}"),
            None => write!(f, "no active inhibit"),
        }
    }
}

/// Message for the age of the newest item of a kind, or for a missing item.
struct Age {
    age_s: f64,
    /// For example "frame pair".
    one: &'static str,
    limit_s: f64,
}

impl fmt::Display for Age {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { age_s, one, limit_s } = self;
        if age_s.is_finite() {
            write!(f, "the newest {one} is {age_s:.3} s old, limit {limit_s:.3} s")
        } else {
            write!(f, "no {one} yet; motion needs one newer than {limit_s:.3} s")
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { condition, value, threshold, detail } = *self;
        let age = |one| Age { age_s: value, one, limit_s: threshold };
        let arm = |of| ArmOf { detail, of };
        match condition {
            Condition::EmergencyStop => {
                write!(f, "{}: emergency stop, dead-man switch or limit switch", arm("arm"))
            }
            Condition::ArmFault => write!(f, "{}: stopped by a fault", arm("arm")),
            Condition::ArmDisabled if detail == Detail::None => write!(f, "both arms: drives disabled"),
            Condition::ArmDisabled => write!(f, "{}: drives disabled", arm("arm")),
            Condition::ClockStepped => {
                write!(f, "the clock stepped by {value:+.3} s, limit 0 to {threshold:.3} s")
            }
            Condition::OperatorSilent => write!(f, "{}", age("sign of life from the operator")),
            Condition::JointsStale => write!(f, "{}: {}", arm("arm"), age("joint measurement")),
            Condition::TargetChanged => match detail {
                Detail::Targets { started, followed } => {
                    write!(f, "the estimator follows target {followed}, but target {started} was started")
                }
                _ => write!(f, "the estimator follows another target than the one that was started"),
            },
            Condition::FrameStale => write!(f, "{}", age("frame pair")),
            Condition::FrameOrder => match detail {
                Detail::Frames { before, after } => write!(f, "frame pair {after} arrived after frame pair {before}"),
                _ => write!(f, "frame pairs arrive out of order"),
            },
            Condition::TargetLost if value.is_finite() => write!(f, "target lost: {}", age("confident pose")),
            Condition::TargetLost | Condition::EstimateStale => write!(f, "{}", age("confident pose")),
            Condition::Miscalibrated => write!(f, "the images contradict the calibration of the cameras"),
            Condition::LowConfidence if detail == Detail::NoPose => write!(f, "the estimator has no pose"),
            Condition::LowConfidence => write!(f, "the estimator has a pose with low confidence"),
            Condition::PositionJump => write!(f, "the target position jumped by {}", Millimetres(value, threshold)),
            Condition::OrientationJump => write!(f, "the target orientation jumped by {}", Degrees(value, threshold)),
            Condition::Outlier => {
                write!(f, "the target is {value:.1} standard deviations from the prediction, limit {threshold:.1}")
            }
            Condition::PositionUncertain => {
                write!(f, "the standard deviation of the target position is {}", Millimetres(value, threshold))
            }
            Condition::OrientationUncertain => {
                write!(f, "the standard deviation of the target orientation is {}", Degrees(value, threshold))
            }
            Condition::CameraSkew => {
                let (value, threshold) = (value * 1e3, threshold * 1e3);
                write!(f, "the camera exposures are {value:.2} ms apart, limit {threshold:.2} ms")
            }
            Condition::LateImages => {
                let [late_ms, limit_ms] = [value, threshold].map(|seconds| seconds * 1e3);
                write!(f, "the images are about {late_ms:.0} ms older than their time stamps, limit {limit_ms:.0} ms")
            }
            Condition::LimitNear => {
                let (value, threshold) = (value.to_degrees(), threshold.to_degrees());
                let axis = Joint(detail);
                write!(f, "{axis} is {value:.2} degrees from the end of its range, limit {threshold:.2} degrees")
            }
            Condition::Singularity => {
                write!(f, "the smallest singular value of the arm is {value:.4}, limit {threshold:.4}")
            }
            Condition::ControllerRests => match detail {
                Detail::Controller(mode) => write!(f, "the controller outputs no velocity ({mode})"),
                _ => write!(f, "the controller outputs no velocity"),
            },
        }
    }
}

/// The name of the arm in a detail, or a general name.
struct ArmOf {
    detail: Detail,
    of: &'static str,
}

impl fmt::Display for ArmOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.detail {
            Detail::Arm(arm) => f.write_str(ARM_NAMES.get(arm).copied().unwrap_or(self.of)),
            _ => f.write_str(self.of),
        }
    }
}

/// The axis of a detail, counted from 1.
struct Joint(Detail);

impl fmt::Display for Joint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Detail::Joint(joint) => write!(f, "axis {}", joint + 1),
            _ => write!(f, "an axis"),
        }
    }
}

/// A length and its limit, metres.
struct Millimetres(f64, f64);

impl fmt::Display for Millimetres {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} mm, limit {:.2} mm", self.0 * 1e3, self.1 * 1e3)
    }
}

/// An angle and its limit, radians.
struct Degrees(f64, f64);

impl fmt::Display for Degrees {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} degrees, limit {:.2} degrees", self.0.to_degrees(), self.1.to_degrees())
    }
}

/// The remedy.
fn remedy(cause: &Cause) -> &'static str {
    match cause.condition {
        Condition::EmergencyStop => "release the switch",
        Condition::ArmFault => "remove the cause",
        Condition::ArmDisabled => "wait until the drives are enabled, or use select, which enables them",
        Condition::ClockStepped => "find what delays this computer or sets its clock",
        Condition::OperatorSilent => {
            "press Enter at the console, or keep the page of the panel visible and connected; a script sends heartbeats \
             (docs/reference/panel-api.md)"
        }
        Condition::JointsStale => "check the link to the arm",
        Condition::TargetChanged => "select the target again",
        // At the start of a normal run the first image has not arrived yet.
        Condition::FrameStale if cause.value.is_infinite() => "wait for the cameras",
        Condition::FrameStale => "check the cameras",
        Condition::FrameOrder => "check whether the cameras were restarted or send old images",
        // There was no confident pose yet.
        Condition::TargetLost if cause.value.is_infinite() => "clear the view of the target, or mark another region",
        Condition::TargetLost => "bring the target back into view",
        Condition::EstimateStale => "wait for the estimator, or clear the view of the target",
        Condition::Miscalibrated => {
            "look at the status of the estimates; fasten the cameras, or calibrate again and restart the program"
        }
        Condition::LowConfidence => "clear the view of the target, or select it again",
        Condition::PositionJump | Condition::OrientationJump | Condition::Outlier => {
            "check that it is still the same target"
        }
        Condition::LateImages => "find what delays the images, and measure the delays again",
        Condition::PositionUncertain | Condition::OrientationUncertain => "give the target more light, texture or size",
        Condition::CameraSkew => "check the camera trigger",
        Condition::LimitNear => "move the target towards the middle of the arm's range",
        Condition::Singularity => "move the target to where the arm is not stretched",
        Condition::ControllerRests => "wait, or remove the cause",
    }
}
