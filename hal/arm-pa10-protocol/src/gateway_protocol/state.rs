//! The state of the arm, as the gateway reports it.

use pb3dp_kinematics::JointVector;

use super::fields::{Fields, Put};
use super::{GatewayState, MessageError, Payload, StopCause};
use crate::codec::{ArmReply, Axis, AxisStatus, CodecError, CommStatus, CommWord, ServoWord, TorqueScale};

/// Micro-units per unit, and milli-units per unit.
const MICRO: f64 = 1e6;
const MILLI: f64 = 1e3;

/// The speeds are measured.
const FLAG_SPEEDS: u16 = 0x0001;
/// The status words have the meaning that format B gives them.
const FLAG_STATUS_DOCUMENTED: u16 = 0x0002;
/// The watchdog slows the arm down.
const FLAG_RAMPING: u16 = 0x0004;

/// Length of the payload.
pub(super) const STATE_LENGTH: usize = 10 + Axis::COUNT * 14;

/// What one axis measures, in whole SI parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisState {
    /// The status word as the controller sent it.
    pub status: u16,
    /// Joint angle, micro-radians; one count of the controller is 7.67 of them. Never wrapped.
    pub angle_urad: i32,
    /// Joint speed, micro-radians per second; 0 where speeds are not measured.
    pub speed_urad_per_s: i32,
    /// Torque at the joint, milli-newton-metres.
    pub torque_mn_m: i32,
}

/// What the gateway and the arm are doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// What the gateway is doing.
    pub gateway: GatewayState,
    /// Why it stopped the arm, until it is reset.
    pub cause: StopCause,
    /// Whether the speeds are measured: format A has none.
    pub has_speeds: bool,
    /// Whether the status words have the meaning that format B gives them.
    pub has_documented_status: bool,
    /// Whether the watchdog slows the arm down because commands stay away.
    pub is_ramping: bool,
    /// How old the measurement was when the frame was sent, µs.
    pub sample_age_us: u32,
    /// The status word of the controller as it sent it.
    pub comm: u16,
    /// From the base on.
    pub axes: [AxisState; Axis::COUNT],
}

impl State {
    /// The state after a reply of the servo controller.
    ///
    /// # Errors
    /// If an angle or torque has no whole number of 32 bits.
    pub fn from_reply(reply: &ArmReply, scale: &TorqueScale, sample_age_us: u32) -> Result<Self, CodecError> {
        let (comm, has_documented_status) = match reply.comm {
            CommStatus::Undocumented(word) => (word, false),
            CommStatus::Comm(word) => (word.0, true),
        };
        let mut axes = [AxisState::default(); Axis::COUNT];
        for axis in Axis::ALL {
            let measured = &reply.axes[axis.index()];
            let angle_rad = measured.angle.to_rad();
            let torque_n_m = scale.to_joint_n_m(axis, measured.torque);
            axes[axis.index()] = AxisState {
                status: match measured.status {
                    AxisStatus::Undocumented(word) => word,
                    AxisStatus::Servo(word) => word.0,
                },
                angle_urad: whole(angle_rad * MICRO).ok_or(CodecError::AngleRange { axis, angle_rad })?,
                // 16 bits of 200 micro-radians per second always fit.
                speed_urad_per_s: measured.speed.map_or(0, |speed| i32::from(speed.0) * 200),
                torque_mn_m: whole(torque_n_m * MILLI).ok_or(CodecError::TorqueRange { axis, torque_n_m })?,
            };
        }
        Ok(Self {
            gateway: GatewayState::Idle,
            cause: StopCause::None,
            has_speeds: reply.axes.iter().all(|axis| axis.speed.is_some()),
            has_documented_status,
            is_ramping: false,
            sample_age_us,
            comm,
            axes,
        })
    }

    /// Joint angles, rad.
    pub fn position_rad(&self) -> JointVector {
        JointVector::from(self.axes.map(|axis| f64::from(axis.angle_urad) / MICRO))
    }

    /// Joint speeds, rad/s, where they are measured.
    pub fn velocity_rad_per_s(&self) -> Option<JointVector> {
        let speeds = self.axes.map(|axis| f64::from(axis.speed_urad_per_s) / MICRO);
        self.has_speeds.then_some(JointVector::from(speeds))
    }

    /// Torques at the joints, N m.
    pub fn torque_n_m(&self) -> JointVector {
        JointVector::from(self.axes.map(|axis| f64::from(axis.torque_mn_m) / MILLI))
    }

    /// Status of an axis.
    pub fn axis_status(&self, axis: Axis) -> AxisStatus {
        let word = self.axes[axis.index()].status;
        if self.has_documented_status { AxisStatus::Servo(ServoWord(word)) } else { AxisStatus::Undocumented(word) }
    }

    /// Status of the controller.
    pub fn comm_status(&self) -> CommStatus {
        if self.has_documented_status {
            CommStatus::Comm(CommWord(self.comm))
        } else {
            CommStatus::Undocumented(self.comm)
        }
    }

    pub(super) fn encode(&self, payload: &mut Payload) {
        payload.put_u8(self.gateway.code());
        payload.put_u8(self.cause.code());
        let bit = |set: bool, flag: u16| if set { flag } else { 0 };
        payload.put_u16(
            bit(self.has_speeds, FLAG_SPEEDS)
                | bit(self.has_documented_status, FLAG_STATUS_DOCUMENTED)
                | bit(self.is_ramping, FLAG_RAMPING),
        );
        payload.put_u32(self.sample_age_us);
        payload.put_u16(self.comm);
        for axis in &self.axes {
            payload.put_u16(axis.status);
            payload.put_i32(axis.angle_urad);
            payload.put_i32(axis.speed_urad_per_s);
            payload.put_i32(axis.torque_mn_m);
        }
    }

    pub(super) fn decode(mut fields: Fields<'_>) -> Result<Self, MessageError> {
        let gateway = fields.code("state", GatewayState::from_code)?;
        let cause = fields.code("cause", StopCause::from_code)?;
        let flags = fields.u16();
        if flags & !(FLAG_SPEEDS | FLAG_STATUS_DOCUMENTED | FLAG_RAMPING) != 0 {
            return Err(fields.no_meaning("flags", i64::from(flags)));
        }
        let has_speeds = flags & FLAG_SPEEDS != 0;
        let (sample_age_us, comm) = (fields.u32(), fields.u16());
        let mut axes = [AxisState::default(); Axis::COUNT];
        for axis in &mut axes {
            axis.status = fields.u16();
            axis.angle_urad = fields.i32();
            axis.speed_urad_per_s = fields.i32();
            axis.torque_mn_m = fields.i32();
            if !has_speeds && axis.speed_urad_per_s != 0 {
                return Err(fields.no_meaning("speed that is not measured", i64::from(axis.speed_urad_per_s)));
            }
        }
        Ok(Self {
            gateway,
            cause,
            has_speeds,
            has_documented_status: flags & FLAG_STATUS_DOCUMENTED != 0,
            is_ramping: flags & FLAG_RAMPING != 0,
            sample_age_us,
            comm,
            axes,
        })
    }
}

/// The nearest whole number, if 32 bits hold it.
fn whole(value: f64) -> Option<i32> {
    let rounded = value.round();
    let possible = rounded >= f64::from(i32::MIN) && rounded <= f64::from(i32::MAX);
    possible.then_some(rounded as i32)
}
