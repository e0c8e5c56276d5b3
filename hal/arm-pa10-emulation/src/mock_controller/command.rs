//! Commands as received, valid or not: invalid commands of a driver must be detectable.

use pb3dp_arm_pa10_protocol::codec::{Axis, WireFormat};

const BRAKE: u16 = 0x0001;
const SERVO: u16 = 0x0002;
const TORQUE: u16 = 0x0004;
const OTHER_AXES: u16 = 0x0010;
const WATCH_DEAD_MAN: u16 = 0x0008;
const SPEED_RAD_PER_S: f64 = 1.0 / 5000.0;

/// Command of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RawAxis {
    pub brake_on: bool,
    pub servo_on: bool,
    pub torque_mode: bool,
    pub stops_with_others: bool,
    pub has_unknown_bits: bool,
    pub torque_counts: i16,
    pub velocity_rad_per_s: f64,
}

/// Commands of all axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RawCommand {
    pub axes: [RawAxis; Axis::COUNT],
    pub watches_dead_man: bool,
}

impl RawCommand {
    /// The data of a message C, if it has the length of the format.
    pub fn decode(format: WireFormat, data: &[u8]) -> Option<Self> {
        let mut command = Self::default();
        match format {
            WireFormat::LittleEndian5x8 => {
                let fields: &[[u8; 5]; Axis::COUNT] = data.as_chunks().0.try_into().ok()?;
                for (axis, &[mode, t0, t1, s0, s1]) in command.axes.iter_mut().zip(fields) {
                    let (torque, speed) = (i16::from_le_bytes([t0, t1]), i16::from_le_bytes([s0, s1]));
                    *axis = RawAxis::new(u16::from(mode), 0, torque, speed);
                }
            }
            WireFormat::BigEndian6x10 => {
                let (fields, word) = data.as_chunks();
                let fields: &[[u8; 6]; Axis::COUNT] = fields.try_into().ok()?;
                for (axis, &[m0, m1, t0, t1, s0, s1]) in command.axes.iter_mut().zip(fields) {
                    let (torque, speed) = (i16::from_be_bytes([t0, t1]), i16::from_be_bytes([s0, s1]));
                    *axis = RawAxis::new(u16::from_be_bytes([m0, m1]), OTHER_AXES, torque, speed);
                }
                command.watches_dead_man = u16::from_be_bytes(word.try_into().ok()?) & WATCH_DEAD_MAN != 0;
            }
        }
        (data.len() == format.command_length()).then_some(command)
    }

    /// Commands that no correct driver sends: torque mode, an unused torque, undefined bits.
    pub fn is_odd(&self) -> bool {
        self.axes.iter().any(|axis| axis.torque_mode || axis.torque_counts != 0 || axis.has_unknown_bits)
    }
}

impl RawAxis {
    fn new(mode: u16, known_besides: u16, torque_counts: i16, speed_counts: i16) -> Self {
        Self {
            brake_on: mode & BRAKE != 0,
            servo_on: mode & SERVO != 0,
            torque_mode: mode & TORQUE != 0,
            stops_with_others: mode & known_besides != 0,
            has_unknown_bits: mode & !(BRAKE | SERVO | TORQUE | known_besides) != 0,
            torque_counts,
            velocity_rad_per_s: f64::from(speed_counts) * SPEED_RAD_PER_S,
        }
    }
}
