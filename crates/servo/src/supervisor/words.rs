//! What the supervisor says: one line for everything that keeps an arm from moving, with value, what is allowed and what to do.

use std::fmt;

use super::findings::{Cause, Detail};
use super::inputs::{ARM_NAMES, Word};
use super::policy::Condition;
use super::table::State;

/// Why the arm does not move, or how it moves. Its `Display` is one line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Why {
    /// No target is selected.
    Idle,
    /// The target is seen, and nothing speaks against motion.
    Ready,
    /// The target is selected; this speaks against motion.
    Waiting {
        /// What is wrong.
        cause: Cause,
    },
    /// Nothing speaks against motion any more, but not for long enough for a word.
    Settling {
        /// Selecting, holding or lost.
        state: State,
        /// What did.
        cause: Option<Cause>,
        /// For how long it has to be gone, seconds.
        for_s: f64,
    },
    /// The arm moves.
    Moving {
        /// Approaching or tracking.
        state: State,
    },
    /// The arm moves more slowly than the controller wants.
    Slowed {
        /// Approaching or tracking.
        state: State,
        /// What is wrong.
        cause: Cause,
        /// Share of the velocity that is left.
        share: f64,
    },
    /// The target is lost, and the hand looks for it.
    Searching,
    /// The arm rests, and this speaks against motion.
    Resting {
        /// Holding or lost.
        state: State,
        /// What is wrong.
        cause: Cause,
        /// What leads on afterwards.
        then: Then,
    },
    /// The arm rests, and nothing speaks against motion any more.
    CauseGone {
        /// Holding or lost.
        state: State,
        /// What was wrong.
        cause: Cause,
        /// What leads on.
        then: Then,
    },
    /// The arm rests because the operator said so.
    HeldByOperator {
        /// Holding or lost.
        state: State,
        /// What speaks against motion besides.
        cause: Option<Cause>,
    },
    /// Both arms are stopped by the operator.
    StoppedByOperator,
    /// Both arms are stopped by a policy.
    Latched {
        /// Stopped or fault.
        state: State,
        /// What was wrong.
        cause: Cause,
        /// Whether it still is not.
        is_gone: bool,
    },
}

/// What ends a rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Then {
    /// The operator's `resume`.
    Word,
    /// Time, when nothing is wrong.
    ByItself {
        /// Seconds.
        after_s: f64,
    },
}

/// A word that was not obeyed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refusal {
    /// The word.
    pub word: Word,
    /// Why not.
    pub because: RefusedFor,
}

/// Why a word was not obeyed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RefusedFor {
    /// It has no place in this state.
    State(State),
    /// It was said too long ago, or will be.
    Age {
        /// Seconds since then.
        age_s: f64,
        /// How many are allowed.
        age_max_s: f64,
    },
    /// It was said before this state was entered.
    SaidBefore(State),
    /// It was said before the target was followed that is followed now.
    SaidToOther,
    /// Something happened in the same step that led to this state.
    Overtaken(State),
    /// This speaks against it.
    Cause(Cause),
    /// Nothing speaks against it any more, but not for long enough.
    NotClear {
        /// What did.
        cause: Option<Cause>,
        /// For how long it has been gone, seconds.
        clear_s: f64,
        /// How long is wanted.
        wanted_s: f64,
    },
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Idle => write!(f, "idle: no target is selected; say select"),
            Self::Ready => write!(f, "selecting: the target is seen and nothing speaks against motion; say start"),
            Self::Waiting { cause } => write!(f, "selecting: {cause}; {}, then say start", remedy(cause)),
            Self::Settling { state, cause, for_s } => {
                let word = if *state == State::Selecting { "start" } else { "resume" };
                write!(f, "{state}: {}; wait until that has lasted for {for_s:.3} s, then say {word}", Gone(cause))
            }
            Self::Moving { state } => write!(f, "{state}"),
            Self::Searching => {
                write!(f, "lost: the hand looks for the target near the place where it was lost; say hold to end that")
            }
            Self::Slowed { state, cause, share } => {
                write!(f, "{state}: slowed to {:.0} %, because {cause}; {}", share * 100.0, remedy(cause))
            }
            Self::Resting { state, cause, then: Then::Word } => {
                write!(f, "{state}: {cause}; {}, then say resume", remedy(cause))
            }
            Self::Resting { state, cause, then: Then::ByItself { after_s } } => {
                write!(f, "{state}: {cause}; {}; goes on by itself {after_s} s after that", remedy(cause))
            }
            Self::CauseGone { state, cause, then: Then::Word } => {
                write!(f, "{state}: {}; say resume", Gone(&Some(*cause)))
            }
            Self::CauseGone { state, cause, then: Then::ByItself { after_s } } => {
                write!(f, "{state}: {}; wait, it goes on by itself after {after_s} s", Gone(&Some(*cause)))
            }
            Self::HeldByOperator { state, cause: None } => write!(f, "{state}: it was told to hold; say resume"),
            Self::HeldByOperator { state, cause: Some(cause) } => {
                write!(f, "{state}: it was told to hold, and {cause}; {}, then say resume", remedy(cause))
            }
            Self::StoppedByOperator => {
                write!(
                    f,
                    "stopped: the operator said stop; say reset, then select, which switches the arms on, and start"
                )
            }
            Self::Latched { state, cause, is_gone: false } => {
                write!(f, "{state}: {cause}; {}, then say reset", remedy(cause))
            }
            Self::Latched { state, cause, is_gone: true } => {
                write!(f, "{state}: it was found that {cause}, which is gone; say reset")
            }
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} is refused: ", self.word.name())?;
        match &self.because {
            RefusedFor::State(state) => write!(f, "it has no place in the state {state}{}", instead(*state)),
            RefusedFor::Age { age_s, age_max_s } => {
                write!(f, "it was said {age_s:.3} s ago, allowed are {age_max_s:.3} s; say it again")
            }
            RefusedFor::SaidBefore(state) => {
                write!(f, "it was said before the state became {state}; look, and say it again")
            }
            RefusedFor::SaidToOther => {
                write!(f, "it was said before the target was seen that is followed now; look, and say it again")
            }
            RefusedFor::Overtaken(state) => {
                write!(f, "the state became {state} at that moment; look, and say it again")
            }
            RefusedFor::Cause(cause) => write!(f, "{cause}; {}", remedy(cause)),
            RefusedFor::NotClear { cause, clear_s, wanted_s } => {
                write!(
                    f,
                    "{}, for {clear_s:.3} s only, and this has to last for {wanted_s:.3} s; say it again",
                    Gone(cause)
                )
            }
        }
    }
}

/// What may be said instead in a state.
fn instead(state: State) -> &'static str {
    match state {
        State::Idle => "; say select",
        State::Selecting => "; say start",
        State::Approaching | State::Tracking => ", as the hand follows already; hold and stop are obeyed",
        State::Holding | State::Lost => "; say resume",
        State::Stopped | State::Fault => "; say reset",
    }
}

/// That something is not so any more.
struct Gone<'a>(&'a Option<Cause>);

impl fmt::Display for Gone<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(cause) => write!(f, "no longer is it so that {cause}"),
            None => write!(f, "nothing speaks against motion"),
        }
    }
}

/// Seconds, or that there are none to be told.
struct Age {
    age_s: f64,
    of: &'static str,
    allowed_s: f64,
}

impl fmt::Display for Age {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { age_s, of, allowed_s } = self;
        if age_s.is_finite() {
            write!(f, "{of} is {age_s:.3} s old, allowed are {allowed_s:.3} s")
        } else {
            write!(f, "{of} has not come yet, allowed is an age of {allowed_s:.3} s")
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { condition, value, threshold, detail } = *self;
        let age = |of| Age { age_s: value, of, allowed_s: threshold };
        let arm = |of| ArmOf { detail, of };
        match condition {
            Condition::EmergencyStop => {
                write!(f, "{} is stopped by an emergency stop, dead-man switch or limit switch", arm("arm"))
            }
            Condition::ArmFault => write!(f, "{} is stopped by a fault", arm("arm")),
            Condition::ArmDisabled => write!(f, "{} has its drives off", arm("arm")),
            Condition::ClockStepped => {
                write!(f, "time went by {value:+.3} s, allowed are steps of 0 to {threshold:.3} s")
            }
            Condition::OperatorSilent => write!(f, "{}", age("the operator's last sign of life")),
            Condition::JointsStale => write!(f, "{}: {}", arm("arm"), age("the newest measurement of the joints")),
            Condition::TargetChanged => match detail {
                Detail::Targets { started, followed } => {
                    write!(f, "the estimator follows target {followed}, started was target {started}")
                }
                _ => write!(f, "the estimator follows another target than the one that was started"),
            },
            Condition::FrameStale => write!(f, "{}", age("the newest pair of pictures")),
            Condition::FrameOrder => match detail {
                Detail::Frames { before, after } => write!(f, "pair {after} of the pictures came after pair {before}"),
                _ => write!(f, "pictures come out of order"),
            },
            Condition::TargetLost => {
                write!(f, "the target is lost, as {}", age("the newest pose that the estimator stands by"))
            }
            Condition::EstimateStale => write!(f, "{}", age("the newest pose that the estimator stands by")),
            Condition::LowConfidence if detail == Detail::NoPose => write!(f, "the estimator has no pose"),
            Condition::LowConfidence => write!(f, "the estimator has a pose and does not stand by it"),
            Condition::PositionJump => write!(f, "the target jumped by {}", Millimetres(value, threshold)),
            Condition::OrientationJump => write!(f, "the target turned at once by {}", Degrees(value, threshold)),
            Condition::Outlier => {
                write!(
                    f,
                    "the target is {value:.1} standard deviations from where it was expected, allowed are {threshold:.1}"
                )
            }
            Condition::PositionUncertain => {
                write!(f, "the target's position has a standard deviation of {}", Millimetres(value, threshold))
            }
            Condition::OrientationUncertain => {
                write!(f, "the target's orientation has a standard deviation of {}", Degrees(value, threshold))
            }
            Condition::CameraSkew => {
                let (value, threshold) = (value * 1e3, threshold * 1e3);
                write!(f, "both eyes were exposed {value:.2} ms apart, allowed are {threshold:.2} ms")
            }
            Condition::LimitNear => {
                let (value, threshold) = (value.to_degrees(), threshold.to_degrees());
                let axis = Joint(detail);
                write!(f, "{axis} is {value:.2} degrees from the end of its range, less than {threshold:.2} degrees")
            }
            Condition::Singularity => {
                write!(f, "the smallest singular value of the arm is {value:.4}, less than {threshold:.4}")
            }
            Condition::ControllerRests => match detail {
                Detail::Controller(mode) => write!(f, "the controller gives no velocity ({mode})"),
                _ => write!(f, "the controller gives no velocity"),
            },
        }
    }
}

/// The arm that a detail names, or what to call it.
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

/// The axis that a detail names, counted from 1.
struct Joint(Detail);

impl fmt::Display for Joint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Detail::Joint(joint) => write!(f, "axis {}", joint + 1),
            _ => write!(f, "an axis"),
        }
    }
}

/// A length and what is allowed, metres.
struct Millimetres(f64, f64);

impl fmt::Display for Millimetres {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} mm, allowed are {:.2} mm", self.0 * 1e3, self.1 * 1e3)
    }
}

/// An angle and what is allowed, radians.
struct Degrees(f64, f64);

impl fmt::Display for Degrees {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} degrees, allowed are {:.2} degrees", self.0.to_degrees(), self.1.to_degrees())
    }
}

/// What to do about it.
fn remedy(cause: &Cause) -> &'static str {
    match cause.condition {
        Condition::EmergencyStop => "release it and reset the arm",
        Condition::ArmFault => "remove the cause and reset the arm",
        Condition::ArmDisabled => "wait until it is on, or say select, which switches it on",
        Condition::ClockStepped => "look what holds up this computer or sets its clock",
        Condition::OperatorSilent => "look after the panel and its line",
        Condition::JointsStale => "look after the line of the arm",
        Condition::TargetChanged => "select the target anew",
        Condition::FrameStale => "look after the cameras",
        Condition::FrameOrder => "look whether the cameras were restarted or send old pictures",
        Condition::TargetLost => "bring the target back into view",
        Condition::EstimateStale => "wait for the estimator, or clear its view of the target",
        Condition::LowConfidence => "clear the view of the target, or select it anew",
        Condition::PositionJump | Condition::OrientationJump | Condition::Outlier => {
            "look whether it is still the same target"
        }
        Condition::PositionUncertain | Condition::OrientationUncertain => "give the target more light, texture or size",
        Condition::CameraSkew => "look after the trigger of the cameras",
        Condition::LimitNear => "move the target back to the middle of the arm's range",
        Condition::Singularity => "move the target to where the arm is not stretched",
        Condition::ControllerRests => "remove what it says",
    }
}
