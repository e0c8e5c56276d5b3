//! Faults of an emulated controller.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{Axis, CommAlarm, ServoAlarm};

/// Fault of a reply to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ReplyFault {
    /// Lost.
    Drop,
    /// Sent twice.
    Duplicate,
    /// Sent after its successor.
    Reorder,
    /// One bit is wrong, anywhere.
    Corrupt,
    /// The end is missing.
    Truncate,
    /// Another sequence number.
    WrongSequence,
    /// Another letter.
    WrongLetter,
    /// Sent from another node of the bus.
    WrongNode,
    /// The right sequence number, with the joints and alarms of the moment at which the fault began.
    Stale,
}

/// The beginning or the end of a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The next `count` replies have this fault.
    Reply {
        /// The fault.
        kind: ReplyFault,
        /// Number of replies; 0 ends the fault.
        count: u32,
    },
    /// The next `count` replies are delayed by this time.
    Delay {
        /// Number of replies; 0 ends the fault.
        count: u32,
        /// The delay.
        by: Duration,
    },
    /// The next `count` messages do not arrive: they are not obeyed, not answered, and do not feed the watchdog.
    Deaf {
        /// Number of messages; 0 ends the fault.
        count: u32,
    },
    /// A half-open link: messages are obeyed, no reply is sent.
    Silence(bool),
    /// Every reply is delayed by this time.
    Slow(Duration),
    /// An alarm of an axis is raised, or its cause is removed; the alarm stays until it is cleared.
    ServoAlarm {
        /// Which axis.
        axis: Axis,
        /// Which alarm; `None`: the cause is removed.
        alarm: Option<ServoAlarm>,
        /// The axis continues as without an alarm.
        only_reported: bool,
    },
    /// The same for the controller.
    ControllerAlarm {
        /// Which alarm; `None`: the cause is removed.
        alarm: Option<CommAlarm>,
        /// The arm continues as without an alarm.
        only_reported: bool,
    },
    /// The emergency stop: if pressed, the servos lose power and the brakes close.
    EmergencyStop {
        /// Pressed or released.
        pressed: bool,
    },
    /// The dead-man switch: if released, it stops the arm if commands request its supervision (format B).
    DeadMan {
        /// Held or released.
        held: bool,
    },
    /// A limit switch: if open, it stops the arm.
    LimitSwitch {
        /// Open or closed.
        open: bool,
    },
    /// The teaching switch: only shown in the status.
    TeachingSwitch {
        /// Set or not.
        on: bool,
    },
    /// The power supply is too warm: only shown in the status.
    PowerTemperature {
        /// Too warm or not.
        high: bool,
    },
    /// The power of the servos: without it the brakes close; the controller still answers.
    ServoPower {
        /// On or off.
        on: bool,
    },
    /// The power of controller and arm.
    Power {
        /// On or off.
        on: bool,
    },
    /// The controller stops as after a time-out of its watchdog.
    TimeOut,
    /// A joint does not move.
    Stuck {
        /// Which axis.
        axis: Axis,
        /// Stuck or free again.
        on: bool,
    },
    /// A joint moves at this velocity and ignores commands, while its servo is on and its brake open.
    Runaway {
        /// Which axis.
        axis: Axis,
        /// The velocity, rad/s; `None`: it follows commands again.
        velocity_rad_per_s: Option<f64>,
    },
    /// The measured angle of a joint is shifted by this additional angle from now on.
    Jump {
        /// Which axis.
        axis: Axis,
        /// The shift, rad.
        by_rad: f64,
    },
    /// The measured torque of a joint.
    Torque {
        /// Which axis.
        axis: Axis,
        /// The torque at the joint, N m.
        torque_n_m: f64,
    },
    /// On the line between host and gateway, if there is one.
    Line(LineFault),
}

/// Fault of the line between host and gateway, frame by frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineFault {
    /// The next `count` frames to the host have this fault. Not `wrong-sequence`, `wrong-letter`, `wrong-node` and `stale`.
    Answers {
        /// The fault.
        kind: ReplyFault,
        /// Number of frames; 0 ends the fault.
        count: u32,
    },
    /// The next `count` frames to the host are valid frames of another arm.
    WrongArm {
        /// Number of frames; 0 ends the fault.
        count: u32,
    },
    /// The next `count` frames to the host are delayed by this time.
    Delay {
        /// Number of frames; 0 ends the fault.
        count: u32,
        /// The delay.
        by: Duration,
    },
    /// Every frame to the host is delayed by this time.
    Slow(Duration),
    /// No frame reaches the host.
    Silence(bool),
    /// Nothing from the host reaches the gateway.
    Deaf(bool),
    /// The gateway reads this many bytes of the host per second, the others wait on the line; `None`: all at once.
    SlowReader {
        /// 0: none.
        bytes_per_second: Option<u32>,
    },
    /// The clock of one side jumps: the timestamps of its frames are shifted by this additional time from now on.
    ClockJump {
        /// Whose clock.
        side: Side,
        /// The shift, µs. A clock below zero wraps around, as unsigned numbers do.
        by_us: i64,
    },
}

/// An end of the line between host and gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The host.
    Host,
    /// The gateway.
    Gateway,
}

impl ReplyFault {
    /// All faults with their names in scripts.
    pub const ALL: [(Self, &'static str); 9] = [
        (Self::Drop, "drop"),
        (Self::Duplicate, "duplicate"),
        (Self::Reorder, "reorder"),
        (Self::Corrupt, "corrupt"),
        (Self::Truncate, "truncate"),
        (Self::WrongSequence, "wrong-sequence"),
        (Self::WrongLetter, "wrong-letter"),
        (Self::WrongNode, "wrong-node"),
        (Self::Stale, "stale"),
    ];

    /// Its name in scripts.
    pub fn name(self) -> &'static str {
        Self::ALL.into_iter().find(|(kind, _)| *kind == self).map_or("reply", |(_, name)| name)
    }
}

impl Fault {
    /// Its name in scripts.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Reply { kind, .. } => kind.name(),
            Self::Delay { .. } => "delay",
            Self::Deaf { .. } => "deaf",
            Self::Silence(_) => "silence",
            Self::Slow(_) => "slow",
            Self::ServoAlarm { .. } => "alarm",
            Self::ControllerAlarm { .. } => "controller-alarm",
            Self::EmergencyStop { .. } => "e-stop",
            Self::DeadMan { .. } => "dead-man",
            Self::LimitSwitch { .. } => "limit-switch",
            Self::TeachingSwitch { .. } => "teaching-switch",
            Self::PowerTemperature { .. } => "power-temperature",
            Self::ServoPower { .. } => "servo-power",
            Self::Power { .. } => "power",
            Self::TimeOut => "time-out",
            Self::Stuck { .. } => "stuck",
            Self::Runaway { .. } => "runaway",
            Self::Jump { .. } => "jump",
            Self::Torque { .. } => "torque",
            Self::Line(_) => "line",
        }
    }
}

impl ReplyFault {
    /// Whether the fault can affect any frame, not only replies of a controller.
    pub(super) fn is_of_any_frame(self) -> bool {
        matches!(self, Self::Drop | Self::Duplicate | Self::Reorder | Self::Corrupt | Self::Truncate)
    }
}

/// As in a script, without the word `line`.
impl std::fmt::Display for LineFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let on_off = |on: bool| if on { "on" } else { "off" };
        match self {
            Self::Answers { kind, count } => write!(f, "{} {count}", kind.name()),
            Self::WrongArm { count } => write!(f, "wrong-arm {count}"),
            Self::Delay { count, by } => write!(f, "delay {count} {by:?}"),
            Self::Slow(by) => write!(f, "slow {by:?}"),
            Self::Silence(on) => write!(f, "silence {}", on_off(*on)),
            Self::Deaf(on) => write!(f, "deaf {}", on_off(*on)),
            Self::SlowReader { bytes_per_second: Some(rate) } => write!(f, "slow-reader {rate}B/s"),
            Self::SlowReader { bytes_per_second: None } => f.write_str("slow-reader off"),
            Self::ClockJump { side: Side::Host, by_us } => write!(f, "host-clock {by_us}us"),
            Self::ClockJump { side: Side::Gateway, by_us } => write!(f, "gateway-clock {by_us}us"),
        }
    }
}

/// As in a script.
impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())?;
        let reported = |only_reported: bool| if only_reported { " reported" } else { "" };
        let choose = |first: bool, words: [&'static str; 2]| words[usize::from(!first)];
        match self {
            Self::Reply { count, .. } | Self::Deaf { count } => write!(f, " {count}"),
            Self::Delay { count, by } => write!(f, " {count} {by:?}"),
            Self::Slow(by) => write!(f, " {by:?}"),
            Self::Silence(on) | Self::TeachingSwitch { on } | Self::ServoPower { on } | Self::Power { on } => {
                write!(f, " {}", choose(*on, ["on", "off"]))
            }
            Self::ServoAlarm { axis, alarm, only_reported } => {
                write!(f, " {} {}{}", axis.number(), Code(alarm.map(ServoAlarm::code)), reported(*only_reported))
            }
            Self::ControllerAlarm { alarm, only_reported } => {
                write!(f, " {}{}", Code(alarm.map(CommAlarm::code)), reported(*only_reported))
            }
            Self::EmergencyStop { pressed } => write!(f, " {}", choose(*pressed, ["press", "release"])),
            Self::DeadMan { held } => write!(f, " {}", choose(*held, ["hold", "release"])),
            Self::LimitSwitch { open } => write!(f, " {}", choose(*open, ["open", "close"])),
            Self::PowerTemperature { high } => write!(f, " {}", choose(*high, ["high", "normal"])),
            Self::TimeOut => Ok(()),
            Self::Stuck { axis, on } => write!(f, " {} {}", axis.number(), choose(*on, ["on", "off"])),
            Self::Runaway { axis, velocity_rad_per_s } => match velocity_rad_per_s {
                Some(velocity) => write!(f, " {} {velocity}rad/s", axis.number()),
                None => write!(f, " {} off", axis.number()),
            },
            Self::Jump { axis, by_rad } => write!(f, " {} {by_rad}rad", axis.number()),
            Self::Torque { axis, torque_n_m } => write!(f, " {} {torque_n_m}Nm", axis.number()),
            Self::Line(fault) => write!(f, " {fault}"),
        }
    }
}

/// The code of an alarm, or `off`.
struct Code(Option<u8>);

impl std::fmt::Display for Code {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            Some(code) => write!(f, "0x{code:02x}"),
            None => f.write_str("off"),
        }
    }
}
