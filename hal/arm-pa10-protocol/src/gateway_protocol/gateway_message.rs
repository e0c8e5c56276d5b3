//! What the gateway says.

// Addresses as numbers: nothing here uses the network.
use core::net::{IpAddr, Ipv6Addr};

use super::fields::{Fields, Put};
use super::host_message::{Control, MESSAGE_SET};
use super::limits::{LIMITS_LENGTH, LIMITS_VERSION};
use super::state::{STATE_LENGTH, State};
use super::{
    ArmId, ControlOperation, Frame, GatewayState, Geometry, MessageError, MotionLimits, MotionQuantity, Payload,
    RejectReason, StopCause,
};
use crate::codec::{Axis, CommWord, ServoWord, WireFormat, WiredSignals};

const HELLO_REPLY: u8 = 0x81;
const STATE: u8 = 0x82;
const CONTROL_REPLY: u8 = 0x83;
const HEALTH: u8 = 0x84;

/// Bit of the message set in the first byte of the answer to HELLO, whose lower half says which sets a gateway has.
const HAS_MESSAGE_SET: u8 = 1 << (MESSAGE_SET - 1);
const EEPROM_LIMITS: u8 = 0x86;
const HELD: u8 = 0x8D;
const REJECT: u8 = 0x8E;
const FAULT: u8 = 0x8F;

/// Name and version of the firmware: ASCII, at most 24 characters, filled up with zeros.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Firmware([u8; 24]);

impl Firmware {
    /// From a text; `None` if it is too long or has other characters than printable ASCII.
    pub fn new(text: &str) -> Option<Self> {
        let mut bytes = [0; 24];
        let printable = text.bytes().all(|byte| (b' '..=b'~').contains(&byte));
        bytes.get_mut(..text.len())?.copy_from_slice(text.as_bytes());
        printable.then_some(Self(bytes))
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        let end = self.0.iter().position(|byte| *byte == 0).unwrap_or(self.0.len());
        // ASCII by construction.
        std::str::from_utf8(&self.0[..end]).unwrap_or_default()
    }
}

/// What the gateway is and can.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HelloReply {
    /// Signals that reach it by wired inputs.
    pub wired: WiredSignals,
    /// The wire format of the arm, as replies showed it; none before the first one.
    pub wire_format: Option<WireFormat>,
    /// The geometry of the arm, from the settings of the gateway.
    pub geometry: Geometry,
    /// What it is doing.
    pub state: GatewayState,
    /// Why it stopped the arm, until it is reset.
    pub cause: StopCause,
    /// Time between two exchanges with the controller, µs.
    pub cycle_us: u32,
    /// Age of a command from which on the arm is slowed down, µs.
    pub ramp_after_us: u32,
    /// Age of a command at which the arm stands, brakes on, µs.
    pub stop_after_us: u32,
    /// The time-out of the servo controller as configured there, µs; 0 if it is unknown.
    pub controller_watchdog_us: u32,
    /// How long brakes take to open, µs: until then only speed 0 is accepted.
    pub brake_release_us: u32,
    /// Name and version.
    pub firmware: Firmware,
    /// Limits of all motion. A command outside them stops the arm.
    pub limits: MotionLimits,
}

/// A control message was carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControlReply {
    /// What was carried out.
    pub control: Control,
    /// What the gateway is doing now.
    pub state: GatewayState,
}

/// How the gateway is. Counts since it started; they stop at their maximum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Health {
    /// What it is doing.
    pub state: GatewayState,
    /// Why it stopped the arm, until it is reset.
    pub cause: StopCause,
    /// Exchanges with the controller.
    pub exchanges: u32,
    /// Replies of the controller that did not come.
    pub replies_lost: u32,
    /// Replies of the controller that came after their cycle.
    pub replies_late: u32,
    /// Replies of the controller with a wrong number, letter or length.
    pub replies_mismatched: u32,
    /// Cycles that began late by more than a tenth.
    pub overruns: u32,
    /// The longest cycle since the last HEALTH, µs.
    pub worst_cycle_us: u32,
    /// Damaged frames from the host: wrong header check or CRC.
    pub host_damaged: u32,
    /// Frames from the host that are missing by their numbers.
    pub host_lost: u32,
    /// Frames from the host that were repeated, overtaken or too old.
    pub host_stale: u32,
}

/// Limits of an axis as the servo controller keeps them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EepromLimits {
    /// Which axis.
    pub axis: Axis,
    /// Upper limit, micro-radians.
    pub positive_limit_urad: i32,
    /// Lower limit, micro-radians.
    pub negative_limit_urad: i32,
}

/// A frame was refused; nothing of it was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reject {
    /// Why.
    pub reason: RejectReason,
    /// Type of the refused frame.
    pub frame_type: u8,
    /// What belongs to the reason: see `docs/arm-protocol.md`.
    pub detail: u32,
}

/// The gateway stopped the arm by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaultReport {
    /// Why.
    pub cause: StopCause,
    /// What it was doing before.
    pub state_before: GatewayState,
    /// The axis, where the cause belongs to one.
    pub axis: Option<Axis>,
    /// The status word that shows the cause; 0 where none does. For [`StopCause::LimitExceeded`] the [`MotionQuantity`].
    pub word: u16,
}

impl FaultReport {
    /// Axis and quantity of a command outside a limit.
    pub fn limit(&self) -> Option<(Axis, MotionQuantity)> {
        let quantity = u8::try_from(self.word).ok().and_then(MotionQuantity::from_code);
        self.axis.zip(quantity).filter(|_| self.cause == StopCause::LimitExceeded)
    }
}

impl std::fmt::Display for FaultReport {
    /// Cause, and axis and word with what the word says, where they show it: only words of format B do.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { cause, axis, word, .. } = *self;
        write!(f, "{cause}")?;
        if let Some((axis, quantity)) = self.limit() {
            return write!(f, ": {axis}, {quantity}");
        }
        let (servo, controller) = (ServoWord(word), CommWord(word));
        match axis {
            Some(axis) => write!(f, ": {axis}, status word 0x{word:04x}")?,
            None if word != 0 => write!(f, ": controller, status word 0x{word:04x}")?,
            None => return Ok(()),
        }
        match (axis, servo.alarm(), controller.alarm()) {
            (Some(_), Some(alarm), _) => write!(f, ", {alarm}")?,
            (None, _, Some(alarm)) => write!(f, ", {alarm}")?,
            _ => {}
        }
        // The same bit in both kinds of words.
        if servo.is_uncontrollable() {
            f.write_str(", uncontrollable")?;
        }
        if axis.is_some() && servo.is_power_off() {
            f.write_str(", power off")?;
        }
        Ok(())
    }
}

/// The host that holds the gateway. Another one is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Its address.
    pub address: IpAddr,
    /// Its port.
    pub port: u16,
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.port {
            // A socket of the gateway's computer has no port.
            0 => write!(f, "this computer"),
            port => write!(f, "{} port {port}", self.address),
        }
    }
}

/// A message of the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GatewayMessage {
    /// To HELLO.
    HelloReply(HelloReply),
    /// To COMMAND.
    State(State),
    /// To CONTROL.
    ControlReply(ControlReply),
    /// To HEARTBEAT.
    Health(Health),
    /// To CONTROL with the operation `read-eeprom`.
    EepromLimits(EepromLimits),
    /// To the first HELLO of a connection, if another host holds the gateway. The connection ends.
    Held(Holder),
    /// To any frame that is refused.
    Reject(Reject),
    /// To nothing: sent once when the gateway stops the arm by itself.
    Fault(FaultReport),
}

impl GatewayMessage {
    /// The frame of this message.
    pub fn frame(&self, arm: ArmId, sequence: u16, timestamp_us: u64) -> Frame {
        let mut payload = Payload::EMPTY;
        let frame_type = match self {
            Self::HelloReply(reply) => {
                reply.encode(&mut payload);
                HELLO_REPLY
            }
            Self::State(state) => {
                state.encode(&mut payload);
                STATE
            }
            Self::ControlReply(reply) => {
                let (operation, axis) = reply.control.bytes();
                payload.extend(&[operation.code(), axis, reply.state.code()]);
                CONTROL_REPLY
            }
            Self::Health(health) => {
                health.encode(&mut payload);
                HEALTH
            }
            Self::EepromLimits(limits) => {
                payload.put_u8(limits.axis.number());
                payload.put_i32(limits.positive_limit_urad);
                payload.put_i32(limits.negative_limit_urad);
                EEPROM_LIMITS
            }
            Self::Held(Holder { address, port }) => {
                payload.extend(&to_ipv6(*address).octets());
                payload.put_u16(*port);
                HELD
            }
            Self::Reject(reject) => {
                payload.extend(&[reject.reason.code(), reject.frame_type]);
                payload.put_u32(reject.detail);
                REJECT
            }
            Self::Fault(report) => {
                let axis = report.axis.map_or(0, Axis::number);
                payload.extend(&[report.cause.code(), report.state_before.code(), axis]);
                payload.put_u16(report.word);
                FAULT
            }
        };
        Frame { arm, frame_type, sequence, timestamp_us, payload }
    }

    /// The message in a frame.
    ///
    /// # Errors
    /// If the type is none of the gateway's, or the payload does not fit it.
    pub fn decode(frame: &Frame) -> Result<Self, MessageError> {
        let frame_type = frame.frame_type;
        let fields = |length| Fields::new(frame_type, &frame.payload, length);
        Ok(match frame_type {
            HELLO_REPLY => Self::HelloReply(HelloReply::decode(fields(51 + LIMITS_LENGTH)?)?),
            STATE => Self::State(State::decode(fields(STATE_LENGTH)?)?),
            CONTROL_REPLY => Self::ControlReply(ControlReply::decode(fields(3)?)?),
            HEALTH => Self::Health(Health::decode(fields(38)?)?),
            EEPROM_LIMITS => {
                let mut fields = fields(9)?;
                let axis = fields.code("axis", |byte| Axis::from_number(u16::from(byte)).ok())?;
                let (positive_limit_urad, negative_limit_urad) = (fields.i32(), fields.i32());
                Self::EepromLimits(EepromLimits { axis, positive_limit_urad, negative_limit_urad })
            }
            HELD => {
                let mut fields = fields(18)?;
                let address = Ipv6Addr::from(fields.bytes::<16>());
                Self::Held(Holder { address: IpAddr::V6(address).to_canonical(), port: fields.u16() })
            }
            REJECT => {
                let mut fields = fields(6)?;
                let reason = fields.code("reason", RejectReason::from_code)?;
                Self::Reject(Reject { reason, frame_type: fields.u8(), detail: fields.u32() })
            }
            FAULT => Self::Fault(FaultReport::decode(fields(5)?)?),
            got => return Err(MessageError::Type { got }),
        })
    }
}

/// IPv4 addresses as `::ffff:a.b.c.d`.
fn to_ipv6(address: IpAddr) -> Ipv6Addr {
    match address {
        IpAddr::V4(address) => address.to_ipv6_mapped(),
        IpAddr::V6(address) => address,
    }
}

impl HelloReply {
    fn encode(&self, payload: &mut Payload) {
        payload.put_u8(HAS_MESSAGE_SET | self.wired.bits() << 4);
        payload.put_u8(MESSAGE_SET);
        payload.put_u8(match self.wire_format {
            None => 0,
            Some(WireFormat::LittleEndian5x8) => 1,
            Some(WireFormat::BigEndian6x10) => 2,
        });
        payload.extend(&[self.geometry.code(), self.state.code(), self.cause.code(), LIMITS_VERSION]);
        payload.put_u32(self.cycle_us);
        payload.put_u32(self.ramp_after_us);
        payload.put_u32(self.stop_after_us);
        payload.put_u32(self.controller_watchdog_us);
        payload.put_u32(self.brake_release_us);
        payload.extend(&self.firmware.0);
        self.limits.encode(payload);
    }

    fn decode(mut fields: Fields<'_>) -> Result<Self, MessageError> {
        let abilities = fields.u8();
        if abilities & 0x0E != HAS_MESSAGE_SET {
            return Err(fields.no_meaning("sets of messages", i64::from(abilities & 0x0F)));
        }
        fields.version("set of messages", MESSAGE_SET)?;
        let wire_format = match fields.u8() {
            0 => None,
            1 => Some(WireFormat::LittleEndian5x8),
            2 => Some(WireFormat::BigEndian6x10),
            got => return Err(fields.no_meaning("wire format", i64::from(got))),
        };
        let geometry = fields.code("geometry", Geometry::from_code)?;
        let state = fields.code("state", GatewayState::from_code)?;
        let cause = fields.code("cause", StopCause::from_code)?;
        fields.version("version of the limits", LIMITS_VERSION)?;
        Ok(Self {
            wired: WiredSignals::from_bits(abilities >> 4),
            wire_format,
            geometry,
            state,
            cause,
            cycle_us: fields.u32(),
            ramp_after_us: fields.u32(),
            stop_after_us: fields.u32(),
            controller_watchdog_us: fields.u32(),
            brake_release_us: fields.u32(),
            firmware: firmware(&mut fields)?,
            limits: MotionLimits::decode(&mut fields)?,
        })
    }
}

/// The name of the firmware: zeros only behind it.
fn firmware(fields: &mut Fields<'_>) -> Result<Firmware, MessageError> {
    let bytes: [u8; 24] = fields.bytes();
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    let text = std::str::from_utf8(&bytes[..end]).ok().and_then(Firmware::new);
    let odd = fields.no_meaning("firmware", i64::from(bytes[0]));
    text.filter(|firmware| firmware.0 == bytes).ok_or(odd)
}

impl ControlReply {
    fn decode(mut fields: Fields<'_>) -> Result<Self, MessageError> {
        let operation = fields.code("operation", ControlOperation::from_code)?;
        let axis = fields.u8();
        let no_axis = fields.no_meaning("axis", i64::from(axis));
        let control = Control::from_bytes(operation, axis).ok_or(no_axis)?;
        Ok(Self { control, state: fields.code("state", GatewayState::from_code)? })
    }
}

impl Health {
    fn encode(&self, payload: &mut Payload) {
        payload.extend(&[self.state.code(), self.cause.code()]);
        for count in [
            self.exchanges,
            self.replies_lost,
            self.replies_late,
            self.replies_mismatched,
            self.overruns,
            self.worst_cycle_us,
            self.host_damaged,
            self.host_lost,
            self.host_stale,
        ] {
            payload.put_u32(count);
        }
    }

    fn decode(mut fields: Fields<'_>) -> Result<Self, MessageError> {
        Ok(Self {
            state: fields.code("state", GatewayState::from_code)?,
            cause: fields.code("cause", StopCause::from_code)?,
            exchanges: fields.u32(),
            replies_lost: fields.u32(),
            replies_late: fields.u32(),
            replies_mismatched: fields.u32(),
            overruns: fields.u32(),
            worst_cycle_us: fields.u32(),
            host_damaged: fields.u32(),
            host_lost: fields.u32(),
            host_stale: fields.u32(),
        })
    }
}

impl FaultReport {
    fn decode(mut fields: Fields<'_>) -> Result<Self, MessageError> {
        let cause = fields.code("cause", StopCause::from_code)?;
        let state_before = fields.code("state", GatewayState::from_code)?;
        let axis = match fields.u8() {
            0 => None,
            number => {
                let no_axis = fields.no_meaning("axis", i64::from(number));
                Some(Axis::from_number(u16::from(number)).map_err(|_| no_axis)?)
            }
        };
        Ok(Self { cause, state_before, axis, word: fields.u16() })
    }
}
