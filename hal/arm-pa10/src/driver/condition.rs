//! State of the arm in a reply: measurements, alarms, and the causes of stops. The same for driver and gateway.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{
    Axis, AxisStatus, CommAlarm, CommStatus, ServoAlarm, Signal, SignalSource, StatusSignals, StatusWord,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, MotionQuantity, RejectReason, StopCause};
use pb3dp_kinematics::JointVector;

use super::WarmUpFailure;

/// Maximum age of the newest measurement: three commands of a host at 100 Hz. An older one stops the arm.
pub const MEASUREMENT_AGE_MAX: Duration = Duration::from_millis(30);

/// A measurement of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Age when the reply came, if the link reports it; else 0.
    pub age: Duration,
    /// Joint angles, rad, never wrapped.
    pub position_rad: JointVector,
    /// Joint speeds, rad/s, if the arm measures them.
    pub velocity_rad_per_s: Option<JointVector>,
    /// Torques at the joints, N m; valid only if their scale is known.
    pub torque_n_m: JointVector,
    /// Flags and alarms.
    pub condition: ArmCondition,
}

/// Flags and alarms of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmCondition {
    /// Status of each axis.
    pub axes: [AxisStatus; Axis::COUNT],
    /// Status of the controller.
    pub comm: CommStatus,
    /// State of the gateway and the cause of its stop, if there is a gateway.
    pub gateway: Option<(GatewayState, StopCause)>,
}

/// A condition in which the servos may not hold the arm. `None` as the axis: the controller reports it.
#[derive(Clone, Copy, Debug)]
pub enum Uncontrollable {
    /// No power, or no control.
    Servo {
        /// Which axis.
        axis: Option<Axis>,
        /// Its status word.
        word: u16,
    },
    /// The dead-man switch is released.
    DeadMan {
        /// Which axis.
        axis: Option<Axis>,
        /// Its status word.
        word: u16,
    },
}

/// Why the arm was stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trip {
    /// A fault.
    Fault(FaultCause),
    /// An emergency stop, dead-man switch or limit switch.
    EStop(EmergencyStopCause),
}

/// A fault. The message names the check that failed and what to do.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FaultCause {
    /// Too many exchanges in a row without a usable reply.
    #[error(
        "if the arm moves, press its emergency stop: {misses} exchanges in a row without a usable reply; check cable and power, and that \
         no other program uses the line, then reset"
    )]
    LinkLost {
        /// Number of exchanges.
        misses: u32,
    },
    /// Too many of the last exchanges had no usable reply, or a damaged one.
    #[error(
        "if the arm moves, press its emergency stop: {bad} of the last {exchanges} exchanges had no usable reply or a damaged one; check \
         cable, ground and the load of the computer, then reset"
    )]
    LinkPoor {
        /// Number of these exchanges.
        bad: u32,
        /// Number of exchanges.
        exchanges: u32,
    },
    /// The gateway answers, but the newest measurement is too old.
    #[error(
        "the newest measurement is {age:?} old although the gateway answers, the limit is {allowed:?}: its bus delivers no newer one; \
         check the gateway's log and the servo controller, then reset"
    )]
    MeasurementTooOld {
        /// Age of the measurement when the answer came.
        age: Duration,
        /// [`MEASUREMENT_AGE_MAX`].
        allowed: Duration,
    },
    /// The link was unplugged or closed.
    #[error("if the arm moves, press its emergency stop: the link is gone (unplugged); connect it again, then reset")]
    Unplugged,
    /// A valid frame of another arm came.
    #[error(
        "a reply came from arm {got}: the configuration has another arm number, or the links of two arms are swapped; correct the \
         number or the links, then reset"
    )]
    WrongArm {
        /// Arm number in the frame.
        got: u8,
    },
    /// The control loop sent no velocity in time.
    #[error(
        "no velocity for {age:?}, the watchdog allows {allowed:?}; find out what delayed the control loop, then reset"
    )]
    CommandTimeout {
        /// Age of the last velocity.
        age: Duration,
        /// Limit of the watchdog.
        allowed: Duration,
    },
    /// The program sent no request while the arm held with open brakes.
    #[error(
        "no request for {age:?} while the brakes were open, the limit is {allowed:?}; find out what delayed the control loop, then \
         reset"
    )]
    OwnerSilent {
        /// Time since the last request.
        age: Duration,
        /// Limit.
        allowed: Duration,
    },
    /// An axis raised an alarm.
    #[error("{axis}: {alarm}; remove the cause, then reset")]
    ServoAlarm {
        /// Which axis.
        axis: Axis,
        /// Which alarm.
        alarm: ServoAlarm,
    },
    /// The controller raised an alarm.
    #[error("controller: {alarm}; remove the cause, then reset")]
    ControllerAlarm {
        /// Which alarm.
        alarm: CommAlarm,
    },
    /// An axis has no power or does not follow.
    #[error(
        "{axis}: power off or uncontrollable while the brakes are open (status word 0x{word:04x}); check its power, then reset"
    )]
    AxisUncontrollable {
        /// Which axis.
        axis: Axis,
        /// Its status word.
        word: u16,
    },
    /// The controller reports that the arm does not follow.
    #[error(
        "controller: power off or arm uncontrollable while the brakes are open (status word 0x{word:04x}); check its panel, then reset"
    )]
    ArmUncontrollable {
        /// The status word.
        word: u16,
    },
    /// The torque of a joint was above its limit for too long.
    #[error(
        "{axis}: {torque_n_m:+.1} N m at the joint, more than {allowed_n_m:.1} N m for {lasted:?}: the joint is blocked, overloaded \
         or pushed; free it, then reset"
    )]
    TorqueTooHigh {
        /// Which axis.
        axis: Axis,
        /// Last measured torque, N m.
        torque_n_m: f64,
        /// Limit of the permanent torque, N m.
        allowed_n_m: f64,
        /// Time above the limit.
        lasted: Duration,
    },
    /// The gateway stopped the arm.
    #[error("the gateway stopped the arm: {0}; {advice}", advice = advice_on_stop(*.0))]
    Gateway(StopCause),
    /// A command was outside a motion limit of the gateway.
    #[error(
        "the gateway stopped the arm: a command was outside its limit for the {quantity} of {axis}, which the limiter of this program \
         should have prevented; compare [limits] in the gateway's file with the arm's limits in the setup, report a defect if they \
         agree, then reset"
    )]
    GatewayLimit {
        /// Which axis.
        axis: Axis,
        /// Which quantity.
        quantity: MotionQuantity,
    },
    /// The gateway stopped following commands without giving a cause.
    #[error("the gateway is {gateway}, but this program did not stop it; find out which program did, then reset")]
    GatewayStopped {
        /// State of the gateway.
        gateway: GatewayState,
    },
    /// The gateway refused a message of the driver.
    #[error(
        "the gateway refused a message: {0}; {advice}",
        advice = advice(*.0)
    )]
    Rejected(RejectReason),
    /// The gateway refused a reset, because the cause of the stop is still present.
    #[error(
        "the gateway cannot reset the arm: {why}",
        why = why_not_reset(*.0)
    )]
    CauseNotCleared(StopCause),
    /// The limits of an axis differ from the configuration.
    #[error(
        "{axis}: the controller keeps a limit of {found_deg:.3} degrees, the configuration {expected_deg:.3}; find out whether this \
         is the arm of the configuration, correct the wrong one, then reset"
    )]
    LimitsDiffer {
        /// Which axis.
        axis: Axis,
        /// The limit in the controller, degrees.
        found_deg: f64,
        /// The limit in the configuration, degrees.
        expected_deg: f64,
    },
    /// An activity took too long.
    #[error("{activity} took longer than {allowed:?}; check that the arm answers, then reset")]
    ActivityTimeout {
        /// Which activity.
        activity: super::Activity,
        /// Limit.
        allowed: Duration,
    },
    /// The other arm of the cell stopped.
    #[error("arm {arm} of the same cell stopped, and stopped this one too; check its message, then reset both")]
    OtherArm {
        /// Number of the other arm.
        arm: u8,
    },
    /// The supervisor of this program stopped the arm.
    #[error("the supervisor of this program stopped the arm; check its message, then reset")]
    Supervisor,
    /// The program ended or released the arm while its brakes were open.
    #[error("the program released the arm while its brakes were open; stop the arm first")]
    Released,
    /// The thread that monitors the arm failed.
    #[error(
        "the thread that monitors the arm failed: a defect of pb3dp; report it with the log, and start the program again"
    )]
    Program,
    /// The state machine received an event that its table does not allow.
    #[error("unexpected event {event:?} while {state}: a defect of pb3dp; report it with the log, then reset")]
    Internal {
        /// The event.
        event: super::Event,
        /// The state.
        state: super::DriverState,
    },
}

/// An emergency stop, or a switch that stops the arm in the same way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EmergencyStopCause {
    /// Reported by an axis.
    #[error("{axis}: {alarm}; {advice}, then reset", advice = release(alarm.code()))]
    Axis {
        /// Which axis.
        axis: Axis,
        /// Emergency stop, dead-man switch or limit switch.
        alarm: ServoAlarm,
    },
    /// Reported by the controller.
    #[error("controller: {alarm}; {advice}, then reset", advice = release(alarm.code()))]
    Controller {
        /// Emergency stop, dead-man switch or limit switch.
        alarm: CommAlarm,
    },
    /// Shown by bits of a status word that the configuration names.
    #[error(
        "{who}: status word 0x{word:04x} shows the {signal} by the bits of the configuration; {advice}, then reset",
        who = .axis.map_or_else(|| "controller".to_owned(), |axis| axis.to_string()), advice = release_of(*.signal)
    )]
    Switch {
        /// Which switch.
        signal: Signal,
        /// Which axis; `None` for the controller.
        axis: Option<Axis>,
        /// The status word.
        word: u16,
    },
    /// Reported by the gateway.
    #[error(
        "the gateway reports an emergency stop, a released dead-man switch or a limit switch, and cannot tell which; remove the \
         cause, then reset"
    )]
    Gateway,
}

impl EmergencyStopCause {
    /// Name of the switch.
    pub fn name(&self) -> &'static str {
        let code = match self {
            Self::Axis { alarm, .. } => alarm.code(),
            Self::Controller { alarm } => alarm.code(),
            Self::Switch { signal: Signal::DeadMan, .. } => return "dead-man switch",
            Self::Switch { signal: Signal::LimitSwitch, .. } => return "limit switch",
            Self::Switch { .. } => return "emergency stop",
            Self::Gateway => return "a switch",
        };
        match ServoAlarm::from_code(code) {
            Some(ServoAlarm::DeadManOff) => "dead-man switch",
            Some(ServoAlarm::LimitSwitch) => "limit switch",
            _ => "emergency stop",
        }
    }
}

/// Advice for a switch.
fn release_of(signal: Signal) -> &'static str {
    match signal {
        Signal::DeadMan => release(ServoAlarm::DeadManOff.code()),
        Signal::LimitSwitch => release(ServoAlarm::LimitSwitch.code()),
        Signal::EmergencyStop | Signal::Power => release(ServoAlarm::EmergencyStop.code()),
    }
}

/// Advice for the switch of this alarm. Axes and controller share the code.
fn release(code: u8) -> &'static str {
    match ServoAlarm::from_code(code) {
        Some(ServoAlarm::DeadManOff) => "hold the dead-man switch",
        Some(ServoAlarm::LimitSwitch) => "move the arm away from the limit switch",
        _ => "release the emergency stop",
    }
}

impl ArmCondition {
    /// The condition that stops the arm; an emergency stop takes precedence over a fault. The alarms of format A are unknown,
    /// because they are not public: these signals are all that its status words tell.
    pub fn trip(&self, signals: &StatusSignals) -> Option<Trip> {
        let emergency_stop = self.emergency_stop(signals).map(Trip::EStop);
        emergency_stop.or_else(|| self.fault().map(Trip::Fault))
    }

    /// Axis and status word that show a signal by its bits.
    fn shown(&self, signals: &StatusSignals, signal: Signal) -> Option<(Option<Axis>, u16)> {
        let SignalSource::Bits(bits) = signals.get(signal) else { return None };
        let of_axis = |axis: Axis| (Some(axis), self.axes[axis.index()].word());
        match bits.word {
            StatusWord::Controller => Some((None, self.comm.word())).filter(|(_, word)| bits.is_shown_by(*word)),
            StatusWord::Axes => Axis::ALL.into_iter().map(of_axis).find(|(_, word)| bits.is_shown_by(*word)),
        }
    }

    /// The fault, if the gateway does not follow commands. Call it only while the gateway should.
    pub(super) fn gateway_stopped(&self) -> Option<FaultCause> {
        use GatewayState::{Holding, Moving, Started};
        let (gateway, _) = self.gateway?;
        let follows = matches!(gateway, Started | Holding | Moving);
        (!follows).then_some(FaultCause::GatewayStopped { gateway })
    }

    /// The first axis that its servo cannot hold, or the whole arm, if the controller reports it, or a released dead-man switch.
    /// Call it only with servos on.
    pub fn uncontrollable(&self, signals: &StatusSignals) -> Option<Uncontrollable> {
        let lost = |axis: &Axis| match self.axes[axis.index()] {
            AxisStatus::Servo(word) if word.is_power_off() || word.is_uncontrollable() => {
                Some(Uncontrollable::Servo { axis: Some(*axis), word: word.0 })
            }
            _ => None,
        };
        let all = || match self.comm {
            CommStatus::Comm(word) if word.is_uncontrollable() => {
                Some(Uncontrollable::Servo { axis: None, word: word.0 })
            }
            _ => None,
        };
        let released = self.shown(signals, Signal::DeadMan).map(|(axis, word)| Uncontrollable::DeadMan { axis, word });
        let power = || self.shown(signals, Signal::Power).map(|(axis, word)| Uncontrollable::Servo { axis, word });
        released.or_else(|| Axis::ALL.iter().find_map(lost)).or_else(all).or_else(power)
    }

    /// Whether the controller reports that its power supply is too warm.
    pub fn is_power_too_warm(&self) -> bool {
        matches!(self.comm, CommStatus::Comm(word) if word.is_power_too_warm())
    }

    fn servo_alarms(&self) -> impl Iterator<Item = (Axis, ServoAlarm)> {
        Axis::ALL.into_iter().filter_map(|axis| match self.axes[axis.index()] {
            AxisStatus::Servo(word) => word.alarm().map(|alarm| (axis, alarm)),
            AxisStatus::Undocumented(_) => None,
        })
    }

    fn comm_alarm(&self) -> Option<CommAlarm> {
        match self.comm {
            CommStatus::Comm(word) => word.alarm(),
            CommStatus::Undocumented(_) => None,
        }
    }

    fn emergency_stop(&self, signals: &StatusSignals) -> Option<EmergencyStopCause> {
        let of_axis = |(axis, alarm)| match alarm {
            ServoAlarm::EmergencyStop | ServoAlarm::DeadManOff | ServoAlarm::LimitSwitch => {
                Some(EmergencyStopCause::Axis { axis, alarm })
            }
            _ => None,
        };
        let of_controller = || match self.comm_alarm()? {
            alarm @ (CommAlarm::EmergencyStop | CommAlarm::DeadManOff | CommAlarm::LimitSwitch) => {
                Some(EmergencyStopCause::Controller { alarm })
            }
            _ => None,
        };
        let of_switch = || {
            let switch = |signal| {
                self.shown(signals, signal).map(|(axis, word)| EmergencyStopCause::Switch { signal, axis, word })
            };
            [Signal::EmergencyStop, Signal::LimitSwitch].into_iter().find_map(switch)
        };
        let of_gateway = || {
            let (state, cause) = self.gateway?;
            let stopped = state == GatewayState::EmergencyStop || cause == StopCause::EmergencyStop;
            stopped.then_some(EmergencyStopCause::Gateway)
        };
        self.servo_alarms().find_map(of_axis).or_else(of_controller).or_else(of_switch).or_else(of_gateway)
    }

    fn fault(&self) -> Option<FaultCause> {
        let of_axis = self.servo_alarms().next().map(|(axis, alarm)| FaultCause::ServoAlarm { axis, alarm });
        let of_controller = || self.comm_alarm().map(|alarm| FaultCause::ControllerAlarm { alarm });
        let of_gateway = || {
            let (state, cause) = self.gateway?;
            let stopped = state == GatewayState::Fault || cause != StopCause::None;
            stopped.then_some(FaultCause::Gateway(cause))
        };
        of_axis.or_else(of_controller).or_else(of_gateway)
    }
}

impl From<Uncontrollable> for Trip {
    fn from(lost: Uncontrollable) -> Self {
        match lost {
            Uncontrollable::Servo { axis: Some(axis), word } => {
                Self::Fault(FaultCause::AxisUncontrollable { axis, word })
            }
            Uncontrollable::Servo { axis: None, word } => Self::Fault(FaultCause::ArmUncontrollable { word }),
            Uncontrollable::DeadMan { axis, word } => {
                Self::EStop(EmergencyStopCause::Switch { signal: Signal::DeadMan, axis, word })
            }
        }
    }
}

impl From<Uncontrollable> for WarmUpFailure {
    fn from(lost: Uncontrollable) -> Self {
        match lost {
            Uncontrollable::Servo { axis: Some(axis), word } => Self::AxisUncontrollable { axis, word },
            Uncontrollable::Servo { axis: None, word } => Self::ArmUncontrollable { word },
            Uncontrollable::DeadMan { word, .. } => Self::DeadManReleased { word },
        }
    }
}

impl Trip {
    /// The axis concerned, if there is one.
    pub fn axis(&self) -> Option<Axis> {
        match self {
            Self::Fault(
                FaultCause::ServoAlarm { axis, .. }
                | FaultCause::AxisUncontrollable { axis, .. }
                | FaultCause::TorqueTooHigh { axis, .. }
                | FaultCause::GatewayLimit { axis, .. }
                | FaultCause::LimitsDiffer { axis, .. },
            )
            | Self::EStop(
                EmergencyStopCause::Axis { axis, .. } | EmergencyStopCause::Switch { axis: Some(axis), .. },
            ) => Some(*axis),
            Self::Fault(_) | Self::EStop(_) => None,
        }
    }

    /// Whether commands possibly do not reach the arm, which may still move.
    pub fn may_still_move(&self) -> bool {
        let Self::Fault(cause) = self else { return false };
        matches!(cause, FaultCause::LinkLost { .. } | FaultCause::LinkPoor { .. } | FaultCause::Unplugged)
    }

    /// Whether another arm of the cell stopped this one.
    pub fn is_by_other_arm(&self) -> bool {
        matches!(self, Self::Fault(FaultCause::OtherArm { .. }))
    }

    /// The alarm code, if an axis or the controller raised an alarm.
    pub fn code(&self) -> Option<u8> {
        match self {
            Self::Fault(FaultCause::ServoAlarm { alarm, .. }) | Self::EStop(EmergencyStopCause::Axis { alarm, .. }) => {
                Some(alarm.code())
            }
            Self::Fault(FaultCause::ControllerAlarm { alarm })
            | Self::EStop(EmergencyStopCause::Controller { alarm }) => Some(alarm.code()),
            Self::Fault(_) | Self::EStop(_) => None,
        }
    }
}

/// Advice for an arm that its gateway stopped.
fn advice_on_stop(cause: StopCause) -> &'static str {
    match cause {
        StopCause::HostFault => {
            "the program that drove the arm found a fault; check its log and its flight recorder, remove the cause, then reset"
        }
        StopCause::HostSilent => {
            "the program that drove the arm ended, hung or lost the line; find out why, remove the cause, then reset"
        }
        StopCause::LimitExceeded => {
            "the program that drove the arm sent a command outside a motion limit of the gateway, whose log names axis and quantity; \
             compare [limits] in the gateway's file with the arm's limits in the setup, then reset"
        }
        StopCause::LocalControl => {
            "the switch of the gateway stands on local: type `remote` at the gateway, then reset"
        }
        _ => "remove the cause, then reset",
    }
}

/// The condition that prevents a reset, and its remedy.
fn why_not_reset(found: StopCause) -> String {
    let what = match found {
        StopCause::LocalControl => return advice_on_stop(found).to_owned(),
        StopCause::ServoAlarm => "an alarm of an axis".to_owned(),
        StopCause::ControllerAlarm => "an alarm of the controller".to_owned(),
        StopCause::EmergencyStop => "an emergency stop, dead-man switch or limit switch".to_owned(),
        StopCause::AxisUncontrollable => {
            "an axis without power or control, a released dead-man switch, or a signal that the gateway does not know ([arm.signals] in its file)"
                .to_owned()
        }
        other => other.to_string(),
    };
    format!("{what} is still present; `pb3dp arm probe` shows the status words; remove the cause, then reset")
}

/// Advice for a message that the gateway refused.
fn advice(reason: RejectReason) -> &'static str {
    match reason {
        RejectReason::CausePresent => {
            "the cause of the stop is still present, `pb3dp arm probe` shows it in the status words: remove it, then reset"
        }
        _ => "find out whether it was restarted or stopped by another program, then reset",
    }
}

impl std::fmt::Display for Trip {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Fault(cause) => write!(f, "fault: {cause}"),
            Self::EStop(cause) => write!(f, "{}: {cause}", cause.name()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stop_of_a_gateway_has_its_own_advice() {
        let advice_on = [
            (StopCause::HostFault, "flight recorder"),
            (StopCause::HostSilent, "ended, hung or lost the line"),
            (StopCause::LimitExceeded, "[limits] in the gateway's file"),
            (StopCause::LocalControl, "type `remote`"),
            (StopCause::EmergencyStop, "remove the cause, then reset"),
        ];
        for (cause, advice) in advice_on {
            let text = FaultCause::Gateway(cause).to_string();
            assert!(text.contains(advice), "{text}");
        }
    }
}
