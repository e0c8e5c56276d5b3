//! The arm traits and their data.

use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use pb3dp_kinematics::{JointState, JointVector};

/// Identity and cycle time of an arm, as read back from the device.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmInfo {
    /// Name for messages: `vs-robot (pa10 mock)`.
    pub name: String,
    /// Time between two exchanges expected by the device.
    pub cycle: Duration,
}

/// The command for an arm until the next exchange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointCommand {
    /// Stop and hold (ramped by the device's own deceleration); brakes stay open.
    Hold,
    /// Move each joint at this velocity, rad/s.
    Velocity(JointVector),
}

/// State of drives and brakes. Faults and emergency stops latch until an operator resets them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmState {
    /// Connected, brakes on, no motion possible.
    Disabled,
    /// Drives enabled, velocities are followed.
    Enabled,
    /// Stopped by a fault of the arm, its link or its limits.
    Fault,
    /// Stopped by an emergency stop.
    EStop,
}

/// The kind of an arm error: policies decide by it.
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
    /// The link is lost.
    Disconnected,
}

/// An arm error: its kind and a sentence that names the arm, the joint, the value and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct ArmError {
    kind: ArmErrorKind,
    message: Message,
    joint: Option<usize>,
    code: Option<u16>,
    may_still_move: bool,
    #[source]
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

/// The message of an error.
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
                write!(f, "arm {arm}: no measurement for {age:?}, the cycle is {cycle:?}; the arm holds, try again")
            }
        }
    }
}

impl ArmError {
    /// An error without an underlying cause.
    pub fn new(kind: ArmErrorKind, message: impl Into<String>) -> Self {
        Self::of(kind, Message::Text(message.into()), None)
    }

    fn of(kind: ArmErrorKind, message: Message, source: Option<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self { kind, message, joint: None, code: None, may_still_move: kind == ArmErrorKind::Disconnected, source }
    }

    /// A `Timeout`: the newest measurement has this age, although one is expected in every cycle. This error is common on a bad
    /// line, and is created without heap allocation.
    pub fn late(arm: Arc<str>, age: Duration, cycle: Duration) -> Self {
        Self::of(ArmErrorKind::Timeout, Message::Late { arm, age, cycle }, None)
    }

    /// An error with its underlying cause.
    pub fn caused_by(
        kind: ArmErrorKind,
        message: impl Into<String>,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self::of(kind, Message::Text(message.into()), Some(source.into()))
    }

    /// The same error for this joint, counted from the base, 0 to 6.
    #[must_use]
    pub fn of_joint(self, joint: usize) -> Self {
        Self { joint: Some(joint), ..self }
    }

    /// The same error with the alarm code of the device.
    #[must_use]
    pub fn with_code(self, code: u16) -> Self {
        Self { code: Some(code), ..self }
    }

    /// The same error of an arm that possibly receives no command any more.
    #[must_use]
    pub fn out_of_reach(self) -> Self {
        Self { may_still_move: true, ..self }
    }

    /// Whether commands possibly do not reach the arm, which may still move: a person has to look, and to press its emergency stop.
    pub fn may_still_move(&self) -> bool {
        self.may_still_move
    }

    /// The kind: policies decide by it.
    pub fn kind(&self) -> ArmErrorKind {
        self.kind
    }

    /// The joint concerned, if any.
    pub fn joint(&self) -> Option<usize> {
        self.joint
    }

    /// The alarm code of the device, if any.
    pub fn code(&self) -> Option<u16> {
        self.code
    }
}

/// An arm that is commanded by joint velocities.
///
/// # For backend authors
/// * `exchange` sends one command and returns the newest measured joints. It returns within twice [`ArmInfo::cycle`].
/// * A command with a number that is not finite is `Rejected` and never reaches the arm; the arm holds.
/// * Before [`ArmPower::enable`], `Velocity` is `NotEnabled`; `Hold` always succeeds while the link is up.
/// * Any error cancels the motion: the arm holds until the next accepted command.
/// * Samples never go back in time. Angles are never wrapped (some joints rotate by more than half a turn).
pub trait Arm: Send {
    /// Identity and cycle time of this arm.
    fn info(&self) -> &ArmInfo;

    /// One cycle: sends the command and returns the measured joints.
    ///
    /// # Errors
    /// See [`ArmErrorKind`].
    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError>;
}

/// An order to the drives and brakes of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerOrder {
    /// Enables the drives.
    Enable(EnablePosition),
    /// Begins to enable the drives. An arm that enables at once does so.
    BeginEnable(EnablePosition),
    /// Whether the drives, which began to be enabled, are enabled; to be given in each cycle, and not after an error.
    PollEnable,
    /// Gives the stop order; [`Self::Stop`] must follow. Two arms can thus be stopped at the same time.
    BeginStop,
    /// Stops the arm and disables the drives.
    Stop,
    /// Clears a latched fault or emergency stop.
    Reset,
}

/// Required position of an arm when it is enabled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnablePosition {
    /// The start position: elsewhere the first velocity is refused.
    Start,
    /// The current position, if the arm was at its start position before.
    Here,
}

/// Drives and brakes of an arm. [`Self::power`] carries out every order; the other methods give one order each.
///
/// # For backend authors
/// * `enable` succeeds only from `Disabled`; it never clears a fault. Afterwards the arm is stationary and holds.
/// * If `enable` takes time, `begin_enable` returns at once, and `poll_enable` reports when it is done. `exchange` measures
///   meanwhile, so that the caller monitors this arm, and every other arm, from the moment when its brakes open. A wrapper of an
///   arm forwards every order.
/// * Only the limiter of an arm regards the [`EnablePosition`].
/// * If `stop` takes time, `begin_stop` gives the order and returns at once; `stop` waits until the arm has stopped.
/// * `stop` ramps to standstill, closes the brakes and is harmless when repeated; it leads to `Disabled`, or leaves a latched
///   state.
/// * `reset` clears a latched state whose cause is gone, to `Disabled`, never further; if nothing is latched it does nothing.
///   Only an operator's action calls it.
pub trait ArmPower: Send {
    /// State of drives and brakes.
    fn state(&self) -> ArmState;

    /// Whether it is latched only because another arm of its workcell stopped; then the other arm must be reset first.
    fn is_stopped_by_other(&self) -> bool {
        false
    }

    /// Carries out an order. `Pending` answers only [`PowerOrder::PollEnable`].
    ///
    /// # Errors
    /// To enable: `Fault` or `Rejected` with the reason; then the arm must be stopped if it had begun. To stop: the arm cannot be reached.
    /// To reset: the cause is still present.
    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError>;

    /// [`PowerOrder::Enable`] at the start position.
    ///
    /// # Errors
    /// As [`Self::power`].
    fn enable(&mut self) -> Result<(), ArmError> {
        self.power(PowerOrder::Enable(EnablePosition::Start)).map(drop)
    }

    /// [`PowerOrder::BeginEnable`] at the start position.
    ///
    /// # Errors
    /// As [`Self::power`].
    fn begin_enable(&mut self) -> Result<(), ArmError> {
        self.power(PowerOrder::BeginEnable(EnablePosition::Start)).map(drop)
    }

    /// [`PowerOrder::PollEnable`]: whether the drives are enabled.
    ///
    /// # Errors
    /// As [`Self::power`].
    fn poll_enable(&mut self) -> Result<bool, ArmError> {
        self.power(PowerOrder::PollEnable).map(|progress| progress.is_ready())
    }

    /// [`PowerOrder::BeginStop`].
    ///
    /// # Errors
    /// As [`Self::power`].
    fn begin_stop(&mut self) -> Result<(), ArmError> {
        self.power(PowerOrder::BeginStop).map(drop)
    }

    /// [`PowerOrder::Stop`].
    ///
    /// # Errors
    /// As [`Self::power`].
    fn stop(&mut self) -> Result<(), ArmError> {
        self.power(PowerOrder::Stop).map(drop)
    }

    /// [`PowerOrder::Reset`].
    ///
    /// # Errors
    /// As [`Self::power`].
    fn reset(&mut self) -> Result<(), ArmError> {
        self.power(PowerOrder::Reset).map(drop)
    }
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

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        (**self).power(order)
    }
}
