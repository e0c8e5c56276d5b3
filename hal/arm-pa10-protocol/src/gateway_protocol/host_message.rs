//! What the host says.

use pb3dp_kinematics::JointVector;

use super::fields::{Fields, Put};
use super::limits::{LIMITS_LENGTH, LIMITS_VERSION};
use super::{ArmId, ControlOperation, DriveMode, Frame, MessageError, MotionLimits, Payload};
use crate::codec::{Axis, CodecError, SpeedCounts};

/// The type of HELLO, which alone may come first.
pub const HELLO: u8 = 0x01;
const COMMAND: u8 = 0x02;
const CONTROL: u8 = 0x03;
const HEARTBEAT: u8 = 0x04;

/// Number of this set of messages, in HELLO and its answer. Gateways of earlier versions also knew a set 1.
pub(super) const MESSAGE_SET: u8 = 2;

/// Length of the payload of COMMAND.
pub(super) const COMMAND_LENGTH: usize = 1 + Axis::COUNT * 4;

/// Times between two commands that make sense, µs: slower ones would trip the watchdogs by themselves.
const HOST_CYCLE_US: std::ops::RangeInclusive<u32> = 2_000..=10_000;

/// Micro-radians per radian.
const MICRO: f64 = 1e6;

/// Opens the link: how often commands will come, and which limits they keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Time between two commands, µs: 2000 to 10000.
    pub cycle_us: u32,
    /// Limits that all commands keep. A gateway with tighter limits refuses the host.
    pub limits: MotionLimits,
}

/// What the arm is to do until the next command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveCommand {
    /// Brakes and servos.
    pub mode: DriveMode,
    /// Joint speeds from the base on, micro-radians per second; all 0 unless the mode is `follow`.
    pub speed_urad_per_s: [i32; Axis::COUNT],
}

impl DriveCommand {
    /// No motion, in this mode.
    pub fn at_rest(mode: DriveMode) -> Self {
        Self { mode, speed_urad_per_s: [0; Axis::COUNT] }
    }

    /// Brakes open and these joint speeds, rad/s.
    ///
    /// # Errors
    /// If a speed is not finite or beyond what the servo controller can be told.
    pub fn follow(velocity_rad_per_s: &JointVector) -> Result<Self, CodecError> {
        let mut command = Self::at_rest(DriveMode::Follow);
        for axis in Axis::ALL {
            let speed_rad_per_s = velocity_rad_per_s[axis.index()];
            SpeedCounts::from_rad_per_s(axis, speed_rad_per_s)?;
            // Within +-6.56e6 after the check.
            command.speed_urad_per_s[axis.index()] = (speed_rad_per_s * MICRO).round() as i32;
        }
        Ok(command)
    }

    /// Joint speeds, rad/s.
    pub fn velocity_rad_per_s(&self) -> JointVector {
        JointVector::from(self.speed_urad_per_s.map(|speed| f64::from(speed) / MICRO))
    }

    fn check(&self, fields: &Fields<'_>) -> Result<(), MessageError> {
        for (axis, &speed) in Axis::ALL.iter().zip(&self.speed_urad_per_s) {
            let possible = match self.mode {
                DriveMode::Follow => SpeedCounts::from_rad_per_s(*axis, f64::from(speed) / MICRO).is_ok(),
                DriveMode::Off | DriveMode::Braked => speed == 0,
            };
            if !possible {
                return Err(fields.no_meaning("speed", i64::from(speed)));
            }
        }
        Ok(())
    }
}

/// Asks for something besides motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// One of the operations that concern the whole arm.
    Arm(ArmOperation),
    /// Clear the alarm of an axis.
    ClearAlarm(Axis),
    /// Read the limits of an axis.
    ReadEeprom(Axis),
}

/// The operations that concern the whole arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmOperation {
    /// Start the control mode, brakes on.
    Start,
    /// End the control mode.
    End,
    /// Come to rest, brakes on, servos off, end the control mode.
    Stop,
    /// Clear the latched state of the gateway.
    Reset,
    /// Come to rest as for [`Self::Stop`], and latch: the host has found a fault.
    Abort,
}

/// A message of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostMessage {
    /// Opens the link.
    Hello(Hello),
    /// What the arm is to do.
    Command(DriveCommand),
    /// Something besides motion.
    Control(Control),
    /// The host is alive, and wants to know how the gateway is.
    Heartbeat,
}

impl HostMessage {
    /// The frame of this message.
    pub fn frame(&self, arm: ArmId, sequence: u16, timestamp_us: u64) -> Frame {
        let mut payload = Payload::EMPTY;
        let frame_type = match self {
            Self::Hello(hello) => {
                payload.put_u8(MESSAGE_SET);
                payload.put_u32(hello.cycle_us);
                payload.put_u8(LIMITS_VERSION);
                hello.limits.encode(&mut payload);
                HELLO
            }
            Self::Command(command) => {
                payload.put_u8(command.mode.code());
                command.speed_urad_per_s.iter().for_each(|speed| payload.put_i32(*speed));
                COMMAND
            }
            Self::Control(control) => {
                let (operation, axis) = control.bytes();
                payload.put_u8(operation.code());
                payload.put_u8(axis);
                CONTROL
            }
            Self::Heartbeat => HEARTBEAT,
        };
        Frame { arm, frame_type, sequence, timestamp_us, payload }
    }

    /// The message in a frame.
    ///
    /// # Errors
    /// If the type is none of the host's, or the payload does not fit it.
    pub fn decode(frame: &Frame) -> Result<Self, MessageError> {
        let frame_type = frame.frame_type;
        let fields = |length| Fields::new(frame_type, &frame.payload, length);
        Ok(match frame_type {
            HELLO => {
                let mut fields = fields(6 + LIMITS_LENGTH)?;
                fields.version("set of messages", MESSAGE_SET)?;
                let cycle_us = fields.u32();
                if !HOST_CYCLE_US.contains(&cycle_us) {
                    return Err(fields.no_meaning("time between two commands", i64::from(cycle_us)));
                }
                fields.version("version of the limits", LIMITS_VERSION)?;
                Self::Hello(Hello { cycle_us, limits: MotionLimits::decode(&mut fields)? })
            }
            COMMAND => {
                let mut fields = fields(COMMAND_LENGTH)?;
                let mode = fields.code("mode", DriveMode::from_code)?;
                let command = DriveCommand { mode, speed_urad_per_s: std::array::from_fn(|_| fields.i32()) };
                command.check(&fields)?;
                Self::Command(command)
            }
            CONTROL => {
                let mut fields = fields(2)?;
                let operation = fields.code("operation", ControlOperation::from_code)?;
                let axis = fields.u8();
                let no_axis = fields.no_meaning("axis", i64::from(axis));
                Self::Control(Control::from_bytes(operation, axis).ok_or(no_axis)?)
            }
            HEARTBEAT => fields(0).map(|_| Self::Heartbeat)?,
            got => return Err(MessageError::Type { got }),
        })
    }
}

impl Control {
    /// What is asked for, without its axis.
    pub fn operation(self) -> ControlOperation {
        self.bytes().0
    }

    /// Operation and axis number, 0 where none belongs to it.
    pub(super) fn bytes(self) -> (ControlOperation, u8) {
        match self {
            Self::Arm(ArmOperation::Start) => (ControlOperation::Start, 0),
            Self::Arm(ArmOperation::End) => (ControlOperation::End, 0),
            Self::Arm(ArmOperation::Stop) => (ControlOperation::Stop, 0),
            Self::Arm(ArmOperation::Reset) => (ControlOperation::Reset, 0),
            Self::Arm(ArmOperation::Abort) => (ControlOperation::Abort, 0),
            Self::ClearAlarm(axis) => (ControlOperation::ClearAlarm, axis.number()),
            Self::ReadEeprom(axis) => (ControlOperation::ReadEeprom, axis.number()),
        }
    }

    /// `None` if the axis does not belong to the operation.
    pub(super) fn from_bytes(operation: ControlOperation, axis: u8) -> Option<Self> {
        let arm = |operation| (axis == 0).then_some(Self::Arm(operation));
        let axis = || Axis::from_number(u16::from(axis)).ok();
        match operation {
            ControlOperation::Start => arm(ArmOperation::Start),
            ControlOperation::End => arm(ArmOperation::End),
            ControlOperation::Stop => arm(ArmOperation::Stop),
            ControlOperation::Reset => arm(ArmOperation::Reset),
            ControlOperation::Abort => arm(ArmOperation::Abort),
            ControlOperation::ClearAlarm => axis().map(Self::ClearAlarm),
            ControlOperation::ReadEeprom => axis().map(Self::ReadEeprom),
        }
    }
}
