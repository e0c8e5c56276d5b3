//! The arm.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_kinematics::{JointState, JointVector};

/// What an arm is, as read back from the device.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmInfo {
    /// For messages: `vs-robot (pa10 mock)`.
    pub name: String,
    /// Time between two exchanges that the device expects.
    pub cycle: Duration,
}

/// What the arm is asked to do until the next exchange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointCommand {
    /// Come to rest and stay (ramped by the device's own deceleration); brakes stay open.
    Hold,
    /// Move each joint at this velocity, rad/s.
    Velocity(JointVector),
}

/// State of drives and brakes. Faults and emergency stops latch until an operator resets them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmState {
    /// Connected, brakes on, no motion possible.
    Disabled,
    /// Drives on, velocities are followed.
    Enabled,
    /// Stopped by a fault of the arm, its link or its limits.
    Fault,
    /// Stopped by an emergency stop.
    EStop,
}

/// The kind of an arm error: what a policy decides on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ArmErrorKind {
    /// The command was refused before anything was sent (not finite, beyond a limit); the arm holds.
    Rejected,
    /// The arm is not in a state in which it moves.
    NotEnabled,
    /// A reply is late or lost; the next exchange may succeed.
    Timeout,
    /// The arm has stopped and latched a fault.
    Fault,
    /// The link is gone.
    Disconnected,
}

/// An arm error: its kind and a sentence that names the arm, the joint, the value and what to do.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct ArmError {
    kind: ArmErrorKind,
    message: Message,
    joint: Option<usize>,
    code: Option<u16>,
    #[source]
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

/// What an error says.
#[derive(Debug)]
enum Message {
    Text(String),
    Late { arm: Arc<str>, age: Duration, cycle: Duration },
}

impl std::fmt::Display for Message {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Late { arm, age, cycle } => {
                write!(f, "arm {arm}: no measurement since {age:?}, a cycle has {cycle:?}; it holds, try again")
            }
        }
    }
}

impl ArmError {
    /// An error without a cause of its own.
    pub fn new(kind: ArmErrorKind, message: impl Into<String>) -> Self {
        Self { kind, message: Message::Text(message.into()), joint: None, code: None, source: None }
    }

    /// A `Timeout`: the newest measurement is of this age, and every cycle should have one. It is common on a bad line, and takes
    /// nothing from the heap.
    pub fn late(arm: Arc<str>, age: Duration, cycle: Duration) -> Self {
        let message = Message::Late { arm, age, cycle };
        Self { kind: ArmErrorKind::Timeout, message, joint: None, code: None, source: None }
    }

    /// An error with the error that caused it.
    pub fn caused_by(
        kind: ArmErrorKind,
        message: impl Into<String>,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self { kind, message: Message::Text(message.into()), joint: None, code: None, source: Some(source.into()) }
    }

    /// The same error of this joint, counted from the base, 0 to 6.
    #[must_use]
    pub fn of_joint(self, joint: usize) -> Self {
        Self { joint: Some(joint), ..self }
    }

    /// The same error with the alarm code of the device.
    #[must_use]
    pub fn with_code(self, code: u16) -> Self {
        Self { code: Some(code), ..self }
    }

    /// What a policy decides on.
    pub fn kind(&self) -> ArmErrorKind {
        self.kind
    }

    /// The joint that it is about, if it is about one.
    pub fn joint(&self) -> Option<usize> {
        self.joint
    }

    /// The alarm code of the device, if there is one.
    pub fn code(&self) -> Option<u16> {
        self.code
    }
}

/// An arm that takes joint velocities.
///
/// # For backend authors
/// * `exchange` hands over one command and returns the newest measured joints. It returns within twice [`ArmInfo::cycle`].
/// * A command with a number that is not finite is `Rejected` and nothing of it reaches the arm; the arm holds.
/// * Before [`ArmPower::enable`], `Velocity` is `NotEnabled`; `Hold` always succeeds while the link is there.
/// * Any error cancels the motion: the arm holds until the next accepted command.
/// * Samples never go back in time. Angles are never wrapped (some joints turn by more than half a turn).
pub trait Arm: Send {
    /// What this arm is.
    fn info(&self) -> &ArmInfo;

    /// One cycle: command out, measured joints in.
    ///
    /// # Errors
    /// See [`ArmErrorKind`].
    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError>;
}

/// Drives and brakes of an arm.
///
/// # For backend authors
/// * `enable` succeeds only from `Disabled`; it never clears a fault. The arm is at rest and holds afterwards.
/// * Where `enable` takes its time, `begin_enable` returns at once, and `poll_enable` tells when it is done. `exchange` measures
///   meanwhile, so that whoever switches an arm on watches it from the moment on in which its brakes open, and every other arm, too.
///   What wraps an arm passes both on.
/// * Where `stop` takes its time, `begin_stop` gives the order and returns at once; `stop` waits for the rest of it.
/// * `stop` ramps to rest, closes the brakes and is harmless when repeated; it leads to `Disabled`, or leaves a latched state.
/// * `reset` clears a latched state whose cause is gone, to `Disabled`, never further; where nothing is latched it does nothing.
///   Only an operator's action calls it.
pub trait ArmPower: Send {
    /// State of drives and brakes.
    fn state(&self) -> ArmState;

    /// Whether it is latched only because another arm of its cell stopped: then that one is to be reset first.
    fn is_stopped_by_other(&self) -> bool {
        false
    }

    /// Switches the drives on.
    ///
    /// # Errors
    /// `Fault` or `Rejected` with the reason.
    fn enable(&mut self) -> Result<(), ArmError>;

    /// Begins to switch the drives on. An arm that does so in no time has nothing to begin.
    ///
    /// # Errors
    /// As [`Self::enable`].
    fn begin_enable(&mut self) -> Result<(), ArmError> {
        self.enable()
    }

    /// Whether what [`Self::begin_enable`] has begun is done; to be asked in each cycle, and no more behind an error.
    ///
    /// # Errors
    /// As [`Self::enable`]. The arm has to be stopped then.
    fn poll_enable(&mut self) -> Result<bool, ArmError> {
        Ok(true)
    }

    /// Gives the stop order; [`Self::stop`] has to follow. So two arms come to rest at the same time.
    ///
    /// # Errors
    /// If the arm cannot be told.
    fn begin_stop(&mut self) -> Result<(), ArmError> {
        Ok(())
    }

    /// Comes to rest and switches the drives off.
    ///
    /// # Errors
    /// If the arm cannot be told.
    fn stop(&mut self) -> Result<(), ArmError>;

    /// Clears a latched fault or emergency stop.
    ///
    /// # Errors
    /// If the cause is still there.
    fn reset(&mut self) -> Result<(), ArmError>;
}

impl<A: Arm + ?Sized> Arm for Box<A> {
    fn info(&self) -> &ArmInfo {
        (**self).info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        (**self).exchange(command)
    }
}

impl<A: ArmPower + ?Sized> ArmPower for Box<A> {
    fn state(&self) -> ArmState {
        (**self).state()
    }

    fn is_stopped_by_other(&self) -> bool {
        (**self).is_stopped_by_other()
    }

    fn enable(&mut self) -> Result<(), ArmError> {
        (**self).enable()
    }

    fn begin_enable(&mut self) -> Result<(), ArmError> {
        (**self).begin_enable()
    }

    fn poll_enable(&mut self) -> Result<bool, ArmError> {
        (**self).poll_enable()
    }

    fn begin_stop(&mut self) -> Result<(), ArmError> {
        (**self).begin_stop()
    }

    fn stop(&mut self) -> Result<(), ArmError> {
        (**self).stop()
    }

    fn reset(&mut self) -> Result<(), ArmError> {
        (**self).reset()
    }
}
