//! State of an emulated arm, for an operator.

use std::time::Duration;

use pb3dp_arm_pa10_gateway::gateway::GatewayStatus;
use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_hal_platform::realtime::Shortfall;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::AxisMode;

use crate::mock_controller::{ControlMode, MockCounters};

/// State of an emulated arm.
#[derive(Clone, Debug, PartialEq)]
pub struct MockReport {
    /// Mode of the controller.
    pub mode: ControlMode,
    /// Whether it has power.
    pub is_powered: bool,
    /// Whether all brakes are closed.
    pub is_braked: bool,
    /// Brake or servo that holds each joint.
    pub axes: [AxisMode; Axis::COUNT],
    /// True angles, rad.
    pub position_rad: JointVector,
    /// True speeds, rad/s.
    pub velocity_rad_per_s: JointVector,
    /// Counters of the controller.
    pub counters: MockCounters,
    /// The gateway, if there is one.
    pub gateway: Option<GatewayStatus>,
    /// Number of wake-ups of the thread more than 1 ms late.
    pub late: u64,
    /// Largest lateness.
    pub latest: Duration,
    /// Answers that were lost because the host did not read.
    pub unread: u64,
    /// Real-time requests that the system refused.
    pub shortfalls: Vec<Shortfall>,
}

impl std::fmt::Display for MockReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mode = match self.mode {
            ControlMode::Adjustment => "adjustment mode",
            ControlMode::Control => "control mode",
            ControlMode::BrakeRelease => "brake-release mode",
        };
        let power = if self.is_powered { "" } else { ", power off" };
        let brakes = if self.is_braked { "all brakes closed" } else { "brakes open or moving" };
        writeln!(f, "controller: {mode}{power}, {brakes}")?;
        for axis in Axis::ALL {
            let index = axis.index();
            let held = match self.axes[index] {
                AxisMode::Servo => "servo",
                AxisMode::Brake => "brake",
                AxisMode::Free => "free",
                AxisMode::Driven { .. } => "runaway",
            };
            let (angle, speed) = (self.position_rad[index].to_degrees(), self.velocity_rad_per_s[index].to_degrees());
            let name = axis.to_string();
            writeln!(f, "  {name:<11} {angle:>9.3} deg {speed:>9.3} deg/s  {held}")?;
        }
        if let Some(gateway) = &self.gateway {
            writeln!(f, "gateway: {}, cause: {}", gateway.state, gateway.cause)?;
        }
        let MockCounters { frames, answered, forbidden, malformed, odd, released, watchdog_trips, .. } = &self.counters;
        writeln!(
            f,
            "messages: {frames} received, {answered} answered, {malformed} malformed, {forbidden} forbidden, {odd} odd, \
             {released} axes released, {watchdog_trips} time-outs"
        )?;
        let faults: Vec<String> = self.counters.faults.iter().map(|(name, count)| format!("{name} {count}")).collect();
        let faults = if faults.is_empty() { "none".to_owned() } else { faults.join(", ") };
        writeln!(f, "faults so far: {faults}")?;
        for shortfall in &self.shortfalls {
            writeln!(f, "{shortfall}")?;
        }
        write!(f, "thread: {} times late, at most {:?}; {} answers not read", self.late, self.latest, self.unread)
    }
}
