//! The data of the cyclic command C.

use pb3dp_kinematics::JointVector;

use super::packet::DATA_LENGTH_MAX;
use super::{Axis, ByteBuffer, CodecError, SpeedCounts, WireFormat};

/// Brake on.
const MODE_BRAKE: u16 = 0x0001;
/// Servo on.
const MODE_SERVO: u16 = 0x0002;
/// React to alarms of other axes (format B).
const MODE_OTHER_AXES: u16 = 0x0010;
/// Watch the dead-man switch: the word after the axes (format B).
const WATCH_DEAD_MAN: u16 = 0x0008;

/// What one axis is to do. An axis with neither brake nor servo would fall and cannot be expressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisCommand {
    /// Brake on, servo off: the safe command.
    Off,
    /// Brake on, servo on, speed 0: before the brake opens and after it closes.
    Braked,
    /// Brake off, servo on, this speed.
    Speed(SpeedCounts),
}

impl AxisCommand {
    fn mode(self) -> u16 {
        match self {
            Self::Off => MODE_BRAKE,
            Self::Braked => MODE_BRAKE | MODE_SERVO,
            Self::Speed(_) => MODE_SERVO,
        }
    }

    /// The speed commanded: 0 where the brake is on.
    pub fn speed(self) -> SpeedCounts {
        match self {
            Self::Off | Self::Braked => SpeedCounts::ZERO,
            Self::Speed(speed) => speed,
        }
    }
}

/// What the controller itself is to watch. Format B only; Orca leaves both off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Supervision {
    /// An axis stops when another one raises an alarm.
    pub other_axes: bool,
    /// The arm stops when the dead-man switch is let go.
    pub dead_man: bool,
}

/// What the arm is to do until the next exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmCommand {
    /// From the base on.
    pub axes: [AxisCommand; Axis::COUNT],
    /// What the controller is to watch.
    pub supervision: Supervision,
}

impl ArmCommand {
    /// The same for all axes.
    pub fn uniform(command: AxisCommand, supervision: Supervision) -> Self {
        Self { axes: [command; Axis::COUNT], supervision }
    }

    /// Brakes off and these joint speeds, rad/s, each rounded to the nearest count.
    ///
    /// # Errors
    /// If a speed is not finite or beyond what the wire carries; it names the axis.
    pub fn velocities(velocity_rad_per_s: &JointVector, supervision: Supervision) -> Result<Self, CodecError> {
        let mut command = Self::uniform(AxisCommand::Speed(SpeedCounts::ZERO), supervision);
        for axis in Axis::ALL {
            let speed = SpeedCounts::from_rad_per_s(axis, velocity_rad_per_s[axis.index()])?;
            command.axes[axis.index()] = AxisCommand::Speed(speed);
        }
        Ok(command)
    }

    /// The speeds commanded, rad/s: 0 where a brake is on.
    pub fn velocity_rad_per_s(&self) -> JointVector {
        JointVector::from(self.axes.map(|axis| axis.speed().to_rad_per_s()))
    }

    pub(super) fn encode(&self, format: WireFormat, out: &mut ByteBuffer<DATA_LENGTH_MAX>) -> Result<(), CodecError> {
        let unused_torque = [0u8; 2];
        for axis in self.axes {
            let speed = format.i16_bytes(axis.speed().0);
            match format {
                WireFormat::LittleEndian5x8 => out.extend(&axis.mode().to_le_bytes()[..1]),
                WireFormat::BigEndian6x10 => {
                    let watches = if self.supervision.other_axes { MODE_OTHER_AXES } else { 0 };
                    out.extend(&format.u16_bytes(axis.mode() | watches));
                }
            }
            out.extend(&unused_torque);
            out.extend(&speed);
        }
        match format {
            WireFormat::LittleEndian5x8 if self.supervision != Supervision::default() => {
                Err(CodecError::NotInFormat { what: "supervision by the controller", format })
            }
            WireFormat::LittleEndian5x8 => Ok(()),
            WireFormat::BigEndian6x10 => {
                let word = if self.supervision.dead_man { WATCH_DEAD_MAN } else { 0 };
                out.extend(&format.u16_bytes(word));
                Ok(())
            }
        }
    }

    pub(super) fn decode(format: WireFormat, data: &[u8]) -> Result<Self, CodecError> {
        let expected = format.command_length();
        if data.len() != expected {
            return Err(CodecError::Length { letter: 'C', got: data.len(), expected });
        }
        let mut command = Self::uniform(AxisCommand::Off, Supervision::default());
        let size = match format {
            WireFormat::LittleEndian5x8 => 5,
            WireFormat::BigEndian6x10 => 6,
        };
        for (axis, field) in Axis::ALL.into_iter().zip(data.chunks_exact(size)) {
            let (mode, torque, speed) = match format {
                WireFormat::LittleEndian5x8 => (u16::from(field[0]), [field[1], field[2]], [field[3], field[4]]),
                WireFormat::BigEndian6x10 => {
                    (format.u16([field[0], field[1]]), [field[2], field[3]], [field[4], field[5]])
                }
            };
            let watches = format == WireFormat::BigEndian6x10 && mode & MODE_OTHER_AXES != 0;
            if axis.index() == 0 {
                command.supervision.other_axes = watches;
            } else if watches != command.supervision.other_axes {
                return Err(CodecError::MixedSupervision { axis });
            }
            let mode = if watches { mode & !MODE_OTHER_AXES } else { mode };
            let fields = AxisFields { mode, torque: format.i16(torque), speed: format.i16(speed) };
            command.axes[axis.index()] = fields.check(axis)?;
        }
        if format == WireFormat::BigEndian6x10 {
            let word = format.u16([data[expected - 2], data[expected - 1]]);
            if word & !WATCH_DEAD_MAN != 0 {
                return Err(CodecError::Supervision { got: word });
            }
            command.supervision.dead_man = word != 0;
        }
        Ok(command)
    }
}

/// The fields of one axis as they came.
struct AxisFields {
    mode: u16,
    torque: i16,
    speed: i16,
}

impl AxisFields {
    fn check(&self, axis: Axis) -> Result<AxisCommand, CodecError> {
        let command = match self.mode {
            MODE_BRAKE => AxisCommand::Off,
            MODE_SERVO => AxisCommand::Speed(SpeedCounts(self.speed)),
            mode if mode == MODE_BRAKE | MODE_SERVO => AxisCommand::Braked,
            mode => return Err(CodecError::Mode { axis, mode }),
        };
        if self.torque != 0 {
            return Err(CodecError::NotZero { axis, field: "torque", value: self.torque });
        }
        if self.speed != command.speed().0 {
            return Err(CodecError::NotZero { axis, field: "speed against the brake", value: self.speed });
        }
        Ok(command)
    }
}
