//! What a reply tells of the arm, whichever link it came by.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{
    ArmReply, Axis, AxisStatus, CommAlarm, CommStatus, ServoAlarm, TorqueScale, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, RejectReason, State, StopCause};
use pb3dp_kinematics::JointVector;

use super::WarmUpFailure;

/// An arm whose newest measurement is older than this is not watched any more: three commands of a host at 100 Hz.
pub const MEASUREMENT_AGE_MAX: Duration = Duration::from_millis(30);

/// A measurement of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// How old it was when the reply came, if the link reports it.
    pub age: Duration,
    /// Joint angles, rad, never wrapped.
    pub position_rad: JointVector,
    /// Joint speeds, rad/s, where they are measured.
    pub velocity_rad_per_s: Option<JointVector>,
    /// Torques at the joints, N m; only where their scale is known.
    pub torque_n_m: JointVector,
    /// Flags and alarms.
    pub condition: ArmCondition,
}

/// Flags and alarms of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmCondition {
    /// Of each axis.
    pub axes: [AxisStatus; Axis::COUNT],
    /// Of the controller.
    pub comm: CommStatus,
    /// Of the gateway, if there is one: what it is doing and why it stopped.
    pub gateway: Option<(GatewayState, StopCause)>,
}

/// An axis without power or control; without an axis the controller says so of the whole arm.
#[derive(Clone, Copy, Debug)]
pub struct Uncontrollable {
    axis: Option<Axis>,
    word: u16,
}

/// Why the arm was stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trip {
    /// By a fault.
    Fault(FaultCause),
    /// By an emergency stop.
    EStop(EmergencyStopCause),
}

/// A fault. The text names the check that failed and what to do.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FaultCause {
    /// Too many exchanges in a row without a usable reply.
    #[error(
        "{misses} exchanges in a row without a usable reply; check cable and power, and that no other program has the line or \
         the bus, then reset"
    )]
    LinkLost {
        /// How many.
        misses: u32,
    },
    /// Answers come, but what they tell was measured too long ago.
    #[error(
        "the newest measurement is {age:?} old although the gateway answers, {allowed:?} are allowed: it has no newer one of its \
         bus; look at its log and at the servo controller, then reset"
    )]
    MeasurementTooOld {
        /// Age of the measurement when the answer came.
        age: Duration,
        /// [`MEASUREMENT_AGE_MAX`].
        allowed: Duration,
    },
    /// Replies of the controller have the length of the other wire format.
    #[error(
        "the controller answers in {got}, the configuration says {configured}; find out which arm it is, correct wire_format, then \
         reset"
    )]
    ReplyFormat {
        /// What the length of a reply shows.
        got: WireFormat,
        /// Of the configuration.
        configured: WireFormat,
    },
    /// The link is gone.
    #[error("the link is gone (unplugged, closed); connect it again, then reset")]
    Unplugged,
    /// A sound frame of another arm came.
    #[error(
        "a reply came from arm {got}: the configuration has another number for it, or the links of two arms are swapped; correct \
         one of them, then reset"
    )]
    WrongArm {
        /// The arm in the frame.
        got: u8,
    },
    /// The control loop stayed away.
    #[error(
        "no velocity for {age:?}, the watchdog allows {allowed:?}; find out what held the control loop up, then reset"
    )]
    CommandTimeout {
        /// Age of the last velocity.
        age: Duration,
        /// What the watchdog allows.
        allowed: Duration,
    },
    /// The owner of the arm stayed away while it held with open brakes.
    #[error(
        "nobody has asked for anything for {age:?} while the brakes were open, {allowed:?} are allowed; find out what held the \
         control loop up, then reset"
    )]
    OwnerSilent {
        /// Since the last request.
        age: Duration,
        /// How long it may stay away.
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
        "{axis}: status word 0x{word:04x} says power off or uncontrollable while the brakes are open; check its power, then reset"
    )]
    AxisUncontrollable {
        /// Which axis.
        axis: Axis,
        /// Its status word.
        word: u16,
    },
    /// The controller says that the arm does not follow.
    #[error(
        "controller: status word 0x{word:04x} says uncontrollable while the arm has to follow; look at its panel, then reset"
    )]
    ArmUncontrollable {
        /// The status word.
        word: u16,
    },
    /// A joint carried too much for too long.
    #[error(
        "{axis}: {torque_n_m:+.1} N m at the joint, more than {allowed_n_m:.1} N m for {lasted:?}: it is blocked, overloaded or \
         pushed; free it, then reset"
    )]
    TorqueTooHigh {
        /// Which axis.
        axis: Axis,
        /// The last torque measured, N m.
        torque_n_m: f64,
        /// What is allowed for long, N m.
        allowed_n_m: f64,
        /// For how long it was more.
        lasted: Duration,
    },
    /// The gateway stopped the arm.
    #[error("the gateway stopped the arm: {0}; {advice}", advice = advice_on_stop(*.0))]
    Gateway(StopCause),
    /// The gateway does not follow any more, and gives no cause.
    #[error("the gateway is {gateway} although nobody here has stopped it; find out who has, then reset")]
    GatewayStopped {
        /// What it is doing.
        gateway: GatewayState,
    },
    /// The gateway refused what the driver sent.
    #[error(
        "the gateway refused a message: {0}; {advice}",
        advice = advice(*.0)
    )]
    Rejected(RejectReason),
    /// The gateway does not reset the arm: what it found is still there.
    #[error(
        "the gateway does not reset the arm, because of {what}, which is still there; a probe shows its status words; remove the cause, \
         then reset",
        what = what_is_there(*.0)
    )]
    StillThere(StopCause),
    /// The limits of an axis are not those of the configuration.
    #[error(
        "{axis}: the controller keeps a limit of {found_deg:.3} degrees where the configuration says {expected_deg:.3}; find out \
         whether this is the arm of the configuration, correct it, then reset"
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
    #[error("{activity} was not done within {allowed:?}; check the arm's answers, then reset")]
    ActivityTimeout {
        /// Which activity.
        activity: super::Activity,
        /// What was allowed.
        allowed: Duration,
    },
    /// The other arm of the cell stopped.
    #[error("arm {arm} of the same cell stopped, and stops this one too; see what it says, then reset both")]
    OtherArm {
        /// Number of the other arm.
        arm: u8,
    },
    /// Somebody had driven the arm and left it.
    #[error(
        "the arm was found in motion or in its control mode, although nobody here had asked for that, and was stopped: a program \
         that drove it died; look at the arm, find out which program and why, then reset"
    )]
    FoundDriven,
    /// A supervisor of the program stopped the arm.
    #[error("the program's supervisor stopped the arm; see what it says, then reset")]
    Supervisor,
    /// The program ended or released the arm while its brakes were open.
    #[error("the program released the arm while its brakes were open; stop the arm first")]
    LetGo,
    /// The thread that watches the arm failed.
    #[error("the thread that watches the arm failed: a mistake of the program; report it, and start the program again")]
    Program,
    /// The state machine met an event that its table does not have.
    #[error("the driver met {event:?} while {state}: a mistake of the program; report it, then reset")]
    Internal {
        /// The event.
        event: super::Event,
        /// The state.
        state: super::DriverState,
    },
}

/// An emergency stop, or another switch that stops an arm as it does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EmergencyStopCause {
    /// Told by an axis.
    #[error("{axis}: {alarm}; {advice}, then reset", advice = release(alarm.code()))]
    Axis {
        /// Which axis.
        axis: Axis,
        /// Emergency stop, dead-man switch or limit switch.
        alarm: ServoAlarm,
    },
    /// Told by the controller.
    #[error("controller: {alarm}; {advice}, then reset", advice = release(alarm.code()))]
    Controller {
        /// Emergency stop, dead-man switch or limit switch.
        alarm: CommAlarm,
    },
    /// Told by a switch bit of the controller.
    #[error(
        "controller: status word 0x{word:04x} has a switch bit that the configuration calls an emergency stop; release it, then reset"
    )]
    Switch {
        /// The status word.
        word: u16,
    },
    /// Told by the gateway.
    #[error(
        "the gateway tells of an emergency stop, a dead-man switch that was let go or a limit switch, and not which; remove the \
         cause, then reset"
    )]
    Gateway,
}

impl EmergencyStopCause {
    /// Which switch it was.
    pub fn name(&self) -> &'static str {
        let code = match self {
            Self::Axis { alarm, .. } => alarm.code(),
            Self::Controller { alarm } => alarm.code(),
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

/// What to do about the switch of this alarm, whose code axes and controller share.
fn release(code: u8) -> &'static str {
    match ServoAlarm::from_code(code) {
        Some(ServoAlarm::DeadManOff) => "hold the dead-man switch",
        Some(ServoAlarm::LimitSwitch) => "lead the arm away from the limit switch",
        _ => "release the emergency stop",
    }
}

impl Sample {
    /// From a reply on the bus, whose torques have this scale.
    pub fn from_reply(reply: &ArmReply, scale: &TorqueScale) -> Self {
        Self {
            age: Duration::ZERO,
            position_rad: reply.position_rad(),
            velocity_rad_per_s: reply.velocity_rad_per_s(),
            torque_n_m: reply.torque_n_m(scale),
            condition: ArmCondition { axes: reply.axes.map(|axis| axis.status), comm: reply.comm, gateway: None },
        }
    }

    /// From a state of the gateway.
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
}

impl Sample {
    /// That it tells too little of the arm as it is now.
    pub(super) fn too_old(&self) -> Option<FaultCause> {
        let (age, allowed) = (self.age, MEASUREMENT_AGE_MAX);
        (age > allowed).then_some(FaultCause::MeasurementTooOld { age, allowed })
    }
}

impl ArmCondition {
    /// What stops the arm, an emergency stop before a fault. Status words of format A tell nothing, as their meaning is not public.
    ///
    /// `emergency_stop_bits` of the controller's word mean an emergency stop.
    pub fn trip(&self, emergency_stop_bits: u16) -> Option<Trip> {
        let emergency_stop = self.emergency_stop(emergency_stop_bits).map(Trip::EStop);
        emergency_stop.or_else(|| self.fault().map(Trip::Fault))
    }

    /// What the gateway is doing instead of following, where it should.
    pub(super) fn gateway_stopped(&self) -> Option<FaultCause> {
        use GatewayState::{Holding, Moving, Started};
        let (gateway, _) = self.gateway?;
        let follows = matches!(gateway, Started | Holding | Moving);
        (!follows).then_some(FaultCause::GatewayStopped { gateway })
    }

    /// An axis that cannot be held by its servo, where all should be; or the whole arm, as the controller says.
    pub fn uncontrollable(&self) -> Option<Uncontrollable> {
        let lost = |axis: &Axis| match self.axes[axis.index()] {
            AxisStatus::Servo(word) if word.is_power_off() || word.is_uncontrollable() => {
                Some(Uncontrollable { axis: Some(*axis), word: word.0 })
            }
            _ => None,
        };
        let all = || match self.comm {
            CommStatus::Comm(word) if word.is_uncontrollable() => Some(Uncontrollable { axis: None, word: word.0 }),
            _ => None,
        };
        Axis::ALL.iter().find_map(lost).or_else(all)
    }

    /// The power supply of the controller says that it is too warm.
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

    fn emergency_stop(&self, bits: u16) -> Option<EmergencyStopCause> {
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
        let of_switch = || match self.comm {
            CommStatus::Comm(word) if word.0 & bits != 0 => Some(EmergencyStopCause::Switch { word: word.0 }),
            _ => None,
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

impl From<Uncontrollable> for FaultCause {
    fn from(Uncontrollable { axis, word }: Uncontrollable) -> Self {
        axis.map_or(Self::ArmUncontrollable { word }, |axis| Self::AxisUncontrollable { axis, word })
    }
}

impl From<Uncontrollable> for WarmUpFailure {
    fn from(Uncontrollable { axis, word }: Uncontrollable) -> Self {
        axis.map_or(Self::ArmUncontrollable { word }, |axis| Self::AxisUncontrollable { axis, word })
    }
}

impl Trip {
    /// The axis that it is about, if it is about one.
    pub fn axis(&self) -> Option<Axis> {
        match self {
            Self::Fault(
                FaultCause::ServoAlarm { axis, .. }
                | FaultCause::AxisUncontrollable { axis, .. }
                | FaultCause::TorqueTooHigh { axis, .. }
                | FaultCause::LimitsDiffer { axis, .. },
            )
            | Self::EStop(EmergencyStopCause::Axis { axis, .. }) => Some(*axis),
            Self::Fault(_) | Self::EStop(_) => None,
        }
    }

    /// Whether another arm of the cell stopped this one.
    pub fn is_by_other_arm(&self) -> bool {
        matches!(self, Self::Fault(FaultCause::OtherArm { .. }))
    }

    /// The alarm code of axis or controller, if one raised it.
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

/// What to do about an arm that its gateway has stopped.
fn advice_on_stop(cause: StopCause) -> &'static str {
    match cause {
        StopCause::HostFault => {
            "the program that drove it found a fault; see what it said and its flight recorder, remove the cause, then reset"
        }
        StopCause::HostSilent => {
            "the program that drove it ended, hung or lost the line; find out why, remove the cause, then reset"
        }
        _ => "remove the cause, then reset",
    }
}

/// What a gateway finds at a reset, in words.
fn what_is_there(found: StopCause) -> String {
    match found {
        StopCause::ServoAlarm => "an alarm of an axis".to_owned(),
        StopCause::ControllerAlarm => "an alarm of the controller".to_owned(),
        StopCause::EmergencyStop => "an emergency stop, dead-man switch or limit switch".to_owned(),
        other => other.to_string(),
    }
}

/// What to do when a gateway refuses.
fn advice(reason: RejectReason) -> &'static str {
    match reason {
        RejectReason::CausePresent => {
            "what stopped the arm is still there, in the status words that a probe shows: remove it, then reset"
        }
        _ => "was it restarted, or told to stop by somebody else? Find out, then reset",
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
