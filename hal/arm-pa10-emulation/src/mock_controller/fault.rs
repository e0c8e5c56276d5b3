//! What an emulated controller can be made to suffer.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{Axis, CommAlarm, ServoAlarm};

/// What is done to replies on their way to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ReplyFault {
    /// It gets lost.
    Drop,
    /// It comes twice.
    Duplicate,
    /// It comes after its successor.
    Reorder,
    /// One of its bits is wrong, anywhere.
    Corrupt,
    /// Its end is missing.
    Truncate,
    /// It has another sequence number.
    WrongSequence,
    /// It has another letter.
    WrongLetter,
    /// It comes from another node of the bus.
    WrongNode,
    /// It has the right number and shows the joints and alarms of the moment at which this was asked for.
    Stale,
}

/// Something that goes wrong, or ends going wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The next `count` replies suffer this.
    Reply {
        /// What is done to them.
        kind: ReplyFault,
        /// How many; 0 ends it.
        count: u32,
    },
    /// The next `count` replies come later by this.
    Delay {
        /// How many; 0 ends it.
        count: u32,
        /// By how much.
        by: Duration,
    },
    /// The next `count` messages do not arrive: they are not obeyed, not answered, and do not feed the watchdog.
    Deaf {
        /// How many; 0 ends it.
        count: u32,
    },
    /// A half-open link: messages are obeyed, no reply comes.
    Silence(bool),
    /// Every reply comes later by this.
    Slow(Duration),
    /// An alarm of an axis comes, or its cause goes; the alarm stays until it is cleared.
    ServoAlarm {
        /// Which axis.
        axis: Axis,
        /// Which alarm; `None`: its cause is gone.
        alarm: Option<ServoAlarm>,
        /// The axis goes on as if there were none.
        only_reported: bool,
    },
    /// The same for the controller.
    ControllerAlarm {
        /// Which alarm; `None`: its cause is gone.
        alarm: Option<CommAlarm>,
        /// The arm goes on as if there were none.
        only_reported: bool,
    },
    /// The emergency stop: pressed, it takes the power from the servos and closes the brakes.
    EmergencyStop {
        /// Pressed or released.
        pressed: bool,
    },
    /// The dead-man switch: let go, it stops the arm if commands ask to watch it (format B).
    DeadMan {
        /// Held or let go.
        held: bool,
    },
    /// A limit switch: open, it stops the arm.
    LimitSwitch {
        /// Open or closed.
        open: bool,
    },
    /// The teaching switch: shown, nothing else.
    TeachingSwitch {
        /// Set or not.
        on: bool,
    },
    /// The power supply gets too warm: shown, nothing else.
    PowerTemperature {
        /// Too warm or not.
        high: bool,
    },
    /// The power of controller and arm.
    Power {
        /// On or off.
        on: bool,
    },
    /// The controller stops as if its watchdog had run out.
    TimeOut,
    /// A joint does not move.
    Stuck {
        /// Which axis.
        axis: Axis,
        /// Stuck or free again.
        on: bool,
    },
    /// A joint follows this velocity and no command, while its servo is on and its brake open.
    Runaway {
        /// Which axis.
        axis: Axis,
        /// The velocity, rad/s; `None`: it follows commands again.
        velocity_rad_per_s: Option<f64>,
    },
    /// The measured angle of a joint is wrong by so much more from now on.
    Jump {
        /// Which axis.
        axis: Axis,
        /// By how much, rad.
        by_rad: f64,
    },
    /// The measured torque of a joint.
    Torque {
        /// Which axis.
        axis: Axis,
        /// The torque at the joint, N m.
        torque_n_m: f64,
    },
    /// On the line between host and gateway, where there is one.
    Line(LineFault),
}

/// What goes wrong on the line between host and gateway, frame by frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineFault {
    /// The next `count` frames to the host suffer this. Not `wrong-sequence`, `wrong-letter`, `wrong-node` and `stale`.
    Answers {
        /// What is done to them.
        kind: ReplyFault,
        /// How many; 0 ends it.
        count: u32,
    },
    /// The next `count` frames to the host are sound ones of another arm.
    WrongArm {
        /// How many; 0 ends it.
        count: u32,
    },
    /// The next `count` frames to the host come later by this.
    Delay {
        /// How many; 0 ends it.
        count: u32,
        /// By how much.
        by: Duration,
    },
    /// Every frame to the host comes later by this.
    Slow(Duration),
    /// No frame comes to the host.
    Silence(bool),
    /// Nothing comes from the host.
    Deaf(bool),
    /// The gateway takes so many bytes of the host per second, and the others wait on the line; `None`: all at once.
    SlowReader {
        /// 0: none at all.
        bytes_per_second: Option<u32>,
    },
    /// The clock of one side jumps: the timestamps of its frames are off by so much more from now on.
    ClockJump {
        /// Whose clock.
        side: Side,
        /// By how much, µs. A clock that would fall below zero goes round, as unsigned numbers do.
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
    /// All of them with their names in scripts.
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
    /// Whether it can happen to any frame, and not to replies of a controller alone.
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
            Self::Silence(on) | Self::TeachingSwitch { on } | Self::Power { on } => {
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

/// The code of an alarm, or that there is none.
struct Code(Option<u8>);

impl std::fmt::Display for Code {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            Some(code) => write!(f, "0x{code:02x}"),
            None => f.write_str("off"),
        }
    }
}
