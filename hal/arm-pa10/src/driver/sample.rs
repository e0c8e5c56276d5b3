//! Measurements of the arm in the replies of the controller and of the gateway.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{ArmReply, Axis, TorqueScale};
use pb3dp_arm_pa10_protocol::gateway_protocol::State;

use super::condition::{ArmCondition, FaultCause, MEASUREMENT_AGE_MAX, Sample};

impl Sample {
    /// The measurement in a reply on the bus. `scale` converts its torques.
    pub fn from_reply(reply: &ArmReply, scale: &TorqueScale) -> Self {
        Self {
            age: Duration::ZERO,
            position_rad: reply.position_rad(),
            velocity_rad_per_s: reply.velocity_rad_per_s(),
            torque_n_m: reply.torque_n_m(scale),
            condition: ArmCondition { axes: reply.axes.map(|axis| axis.status), comm: reply.comm, gateway: None },
        }
    }

    /// The measurement in a state message of the gateway.
    pub fn from_state(state: &State) -> Self {
        Self {
            age: Duration::from_micros(u64::from(state.sample_age_us)),
            position_rad: state.position_rad(),
            velocity_rad_per_s: state.velocity_rad_per_s(),
            torque_n_m: state.torque_n_m(),
            condition: ArmCondition {
                axes: Axis::ALL.map(|axis| state.axis_status(axis)),
                comm: state.comm_status(),
                gateway: Some((state.gateway, state.cause)),
            },
        }
    }

    /// The fault, if the measurement is older than [`MEASUREMENT_AGE_MAX`].
    pub(super) fn too_old(&self) -> Option<FaultCause> {
        let (age, allowed) = (self.age, MEASUREMENT_AGE_MAX);
        (age > allowed).then_some(FaultCause::MeasurementTooOld { age, allowed })
    }
}
