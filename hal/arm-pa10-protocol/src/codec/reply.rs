//! The data of the cyclic reply C.

use pb3dp_kinematics::JointVector;

use super::packet::DATA_LENGTH_MAX;
use super::{
    AngleCounts, Axis, AxisStatus, ByteBuffer, CodecError, CommStatus, CommWord, ServoWord, SpeedCounts, TorqueCounts,
    TorqueScale, WireFormat,
};

/// What one axis measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisReply {
    /// Flags and alarm.
    pub status: AxisStatus,
    /// Joint angle.
    pub angle: AngleCounts,
    /// Joint speed; format A has none.
    pub speed: Option<SpeedCounts>,
    /// Torque, signed.
    pub torque: TorqueCounts,
}

/// What the arm measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmReply {
    /// From the base on.
    pub axes: [AxisReply; Axis::COUNT],
    /// Status of the controller.
    pub comm: CommStatus,
}

impl ArmReply {
    /// Joint angles, rad, as counted: never wrapped.
    pub fn position_rad(&self) -> JointVector {
        JointVector::from(self.axes.map(|axis| axis.angle.to_rad()))
    }

    /// Joint speeds, rad/s, if the format has them for all axes.
    pub fn velocity_rad_per_s(&self) -> Option<JointVector> {
        let mut velocity = JointVector::zeros();
        for (value, axis) in velocity.iter_mut().zip(&self.axes) {
            *value = axis.speed?.to_rad_per_s();
        }
        Some(velocity)
    }

    /// Torques at the joints, N m.
    pub fn torque_n_m(&self, scale: &TorqueScale) -> JointVector {
        let mut torque = JointVector::zeros();
        for axis in Axis::ALL {
            torque[axis.index()] = scale.to_joint_n_m(axis, self.axes[axis.index()].torque);
        }
        torque
    }

    pub(super) fn encode(&self, format: WireFormat, out: &mut ByteBuffer<DATA_LENGTH_MAX>) -> Result<(), CodecError> {
        for axis in &self.axes {
            let (status, speed) = match (format, axis.status, axis.speed) {
                (WireFormat::LittleEndian5x8, AxisStatus::Undocumented(status), None) => (status, None),
                (WireFormat::BigEndian6x10, AxisStatus::Servo(status), Some(speed)) => (status.0, Some(speed)),
                _ => return Err(CodecError::NotInFormat { what: "this status and speed of an axis", format }),
            };
            out.extend(&format.u16_bytes(status));
            out.extend(&format.i32_bytes(axis.angle.0));
            if let Some(speed) = speed {
                out.extend(&format.i16_bytes(speed.0));
            }
            out.extend(&format.i16_bytes(axis.torque.0));
        }
        let comm = match (format, self.comm) {
            (WireFormat::LittleEndian5x8, CommStatus::Undocumented(word)) => word,
            (WireFormat::BigEndian6x10, CommStatus::Comm(word)) => word.0,
            _ => return Err(CodecError::NotInFormat { what: "this status of the controller", format }),
        };
        out.extend(&format.u16_bytes(comm));
        Ok(())
    }

    pub(super) fn decode(format: WireFormat, data: &[u8]) -> Result<Self, CodecError> {
        let expected = format.reply_length();
        if data.len() != expected {
            return Err(match WireFormat::of_reply_length(data.len()) {
                Some(got) => CodecError::OtherFormat { got, configured: format },
                None => CodecError::Length { letter: 'C', got: data.len(), expected },
            });
        }
        let word = format.u16([data[expected - 2], data[expected - 1]]);
        let (comm, size) = match format {
            WireFormat::LittleEndian5x8 => (CommStatus::Undocumented(word), 8),
            WireFormat::BigEndian6x10 => (CommStatus::Comm(CommWord(word)), 10),
        };
        let axes = std::array::from_fn(|index| axis(format, &data[index * size..(index + 1) * size]));
        Ok(Self { axes, comm })
    }
}

/// One axis from its 8 or 10 bytes.
fn axis(format: WireFormat, field: &[u8]) -> AxisReply {
    let status = format.u16([field[0], field[1]]);
    let angle = AngleCounts(format.i32([field[2], field[3], field[4], field[5]]));
    let i16_at = |at: usize| format.i16([field[at], field[at + 1]]);
    match format {
        WireFormat::LittleEndian5x8 => {
            AxisReply { status: AxisStatus::Undocumented(status), angle, speed: None, torque: TorqueCounts(i16_at(6)) }
        }
        WireFormat::BigEndian6x10 => AxisReply {
            status: AxisStatus::Servo(ServoWord(status)),
            angle,
            speed: Some(SpeedCounts(i16_at(6))),
            torque: TorqueCounts(i16_at(8)),
        },
    }
}
