//! Monitor of the permanent torque of the joints.

use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

use super::{DriverConfig, FaultCause};

/// Time since which each joint is above its limit.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TorqueMonitor {
    since: [Option<MonotonicTime>; Axis::COUNT],
}

impl TorqueMonitor {
    /// Evaluates a measurement; returns the first axis that was above its limit for too long, if any.
    pub fn judge(&mut self, at: MonotonicTime, torque_n_m: &JointVector, config: &DriverConfig) -> Option<FaultCause> {
        let mut found = None;
        for axis in Axis::ALL {
            let (torque_n_m, allowed_n_m) = (torque_n_m[axis.index()], config.torque_max_n_m[axis.index()]);
            // NaN is not an allowed torque.
            let is_allowed = torque_n_m.abs() <= allowed_n_m;
            let since = &mut self.since[axis.index()];
            *since = if is_allowed { None } else { since.or(Some(at)) };
            let Some(since) = *since else { continue };
            let lasted = at.saturating_since(since);
            if lasted >= config.torque_for && found.is_none() {
                found = Some(FaultCause::TorqueTooHigh { axis, torque_n_m, allowed_n_m, lasted });
            }
        }
        found
    }
}
