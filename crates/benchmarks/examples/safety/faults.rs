//! The faults of a run: estimates, their timing, the control loop, its clock, links, gateways and arms.

use pb3dp_arm_pa10_emulation::line::virtual_end::{Tampering, Towards};
use pb3dp_arm_pa10_protocol::codec::{CommAlarm, ServoAlarm};
use pb3dp_servo::supervisor::OperatorCommand;
use pb3dp_sim::camera_faults::CameraFaultKind;

use crate::cameras;
use crate::scenario::Dice;

/// A fault that lasts for a while.
#[derive(Clone, Debug)]
pub struct Fault {
    /// Kind of fault.
    pub kind: Kind,
    /// Start, seconds since the run began.
    pub from_s: f64,
    /// Duration, seconds, for kinds that have one.
    pub for_s: f64,
    /// Name in tables of the stall that this fault is, or is a part of.
    pub stall: Option<&'static str>,
}

/// Kind of fault.
#[derive(Clone, Debug)]
pub enum Kind {
    /// Each estimate is lost with this probability.
    EstimatesLost(f64),
    /// The estimator has no pose: black, saturated or covered images.
    NoPose,
    /// The estimator has a pose with low confidence.
    Doubtful,
    /// Estimates are late by this much, seconds.
    Late(f64),
    /// The estimator stalls, and then reports its last pose.
    Stall,
    /// Poses are offset by this much to one side, metres, and rotated, radians: another object, or a wrong calibration.
    Off(f64, f64),
    /// Single poses are offset by this much, metres.
    Outliers(f64),
    /// Exposures of the left and right camera differ by this much, seconds.
    Skew(f64),
    /// Image numbers and timestamps go back.
    OldImages,
    /// The estimator follows another target.
    OtherTarget,
    /// A control step takes this long, seconds.
    Overrun(f64),
    /// The clock of the control loop jumps by this much, seconds.
    ClockJump(f64),
    /// A fault of an arm, as a line of a script, and the line that ends it.
    Arm {
        /// 0: the arm with the cameras.
        arm: usize,
        /// Name in tables.
        name: &'static str,
        /// Line that starts the fault.
        line: String,
        /// Line that ends it, if it ends.
        end: Option<String>,
    },
    /// The emergency stop of both arms is pressed.
    EmergencyStopOfBoth,
    /// The cable of this arm is pulled.
    Unplugged(usize),
    /// New images have the number of an old image.
    NumbersStand,
    /// Each pose is offset by up to this much, metres, in a random direction.
    Scatter(f64),
    /// The standard deviations of position and orientation grow by these factors.
    Unsure([f64; 2]),
    /// The operator gives this command, and it arrives this much later, seconds.
    OperatorCommand(OperatorCommand, f64),
    /// No operator heartbeat.
    Silence,
    /// A camera fault.
    Camera(CameraFaultKind),
    /// Poses are those of so many pairs earlier, under the numbers and times of the new pairs: the camera buffers images.
    OldContent(usize),
    /// The operator's client sends random commands, each so much later at most, seconds, one after another and in any order.
    Chatter(f64),
    /// The gateway of this arm dies, and a new one starts at once.
    GatewayRestart(usize),
    /// The process of the host dies.
    HostDies,
    /// Somebody changes, repeats or removes a record on the line of this arm, which has a key.
    Tampered(usize, Towards, Tampering),
    /// The part that writes the record of a run stands still.
    RecorderStalls,
}

type Lines = fn(&mut Dice) -> (String, Option<String>);

/// Faults of an arm, as script lines of docs/mock-arm.md.
const OF_ARMS: [(&str, Lines); 21] = [
    ("bus: replies lost", |dice| (format!("drop {}", 1 + dice.below(4)), None)),
    ("bus: replies damaged", |dice| (format!("corrupt {}", 1 + dice.below(6)), None)),
    ("bus: replies late", |dice| (format!("delay {} {}us", 1 + dice.below(20), 500 + dice.below(6000)), None)),
    ("bus: deaf", |dice| (format!("deaf {}", 1 + dice.below(30)), None)),
    ("bus: stale replies", |dice| (format!("stale {}", 1 + dice.below(50)), None)),
    ("bus: silent", |_| ("silence on".into(), Some("silence off".into()))),
    ("line: answers lost", |dice| (format!("line drop {}", 1 + dice.below(4)), None)),
    ("line: answers damaged", |dice| (format!("line corrupt {}", 1 + dice.below(5)), None)),
    ("line: answers late", |dice| (format!("line slow {}us", 1000 + dice.below(30_000)), Some("line slow 0s".into()))),
    ("line: silent", |_| ("line silence on".into(), Some("line silence off".into()))),
    ("line: gateway deaf", |_| ("line deaf on".into(), Some("line deaf off".into()))),
    ("line: clock of the gateway", |dice| (format!("line gateway-clock {:.3}s", dice.within(-5.0, 5.0)), None)),
    ("arm: emergency stop", |_| ("e-stop press".into(), Some("e-stop release".into()))),
    ("arm: servo alarm", |dice| {
        (format!("alarm {} 0x{:02x}", 1 + dice.below(7), dice.pick(ServoAlarm::LISTED).code()), None)
    }),
    ("arm: controller alarm", |dice| {
        (format!("controller-alarm 0x{:02x} reported", dice.pick(CommAlarm::LISTED).code()), None)
    }),
    ("arm: limit switch", |_| ("limit-switch open".into(), Some("limit-switch close".into()))),
    ("arm: power", |_| ("power off".into(), Some("power on".into()))),
    ("arm: stuck joint", |dice| {
        let axis = 1 + dice.below(7);
        (format!("stuck {axis} on"), Some(format!("stuck {axis} off")))
    }),
    ("arm: runaway joint", |dice| {
        let axis = 1 + dice.below(7);
        let speed = dice.within(0.1, 1.2) * dice.sign();
        (format!("runaway {axis} {speed:.3}rad/s"), Some(format!("runaway {axis} off")))
    }),
    ("arm: torque", |dice| {
        let axis = 1 + dice.below(7);
        let torque = dice.within(5.0, 300.0) * dice.sign();
        (format!("torque {axis} {torque:.1}Nm"), Some(format!("torque {axis} 0Nm")))
    }),
    ("arm: encoder jumps", |dice| {
        (format!("jump {} {:.3}rad", 1 + dice.below(7), dice.within(0.005, 0.3) * dice.sign()), None)
    }),
];

/// Names in tables of the kinds that do not belong to one arm.
const OF_THE_CELL: [&str; 26] = [
    "estimates lost",
    "no pose",
    "low-confidence pose",
    "late estimates",
    "estimator stalls",
    "pose offset",
    "outliers",
    "exposures not synchronous",
    "old images",
    "another target",
    "control step overruns",
    "clock jumps",
    "emergency stop of both",
    "cable pulled",
    "image numbers repeat",
    "scattered poses",
    "uncertain poses",
    "operator command",
    "late operator command",
    "operator silent",
    "old content under new numbers",
    "operator commands in any order",
    "gateway restarts",
    "host process dies",
    "line: record changed, repeated or removed",
    "recorder stalls",
];

/// Number of kinds of the first draw, which are not those of one arm.
const FIRST_OF_THE_CELL: usize = 20;

impl Kind {
    /// Number of kinds, without those of the cameras.
    #[cfg(test)]
    pub const COUNT: usize = OF_THE_CELL.len() + OF_ARMS.len();

    /// A fault of one arm, by its name in tables.
    pub fn of_arm(arm: usize, name: &'static str, line: &str, end: Option<&str>) -> Self {
        assert!(OF_ARMS.iter().any(|(known, _)| *known == name), "{name}");
        Self::Arm { arm, name, line: line.to_owned(), end: end.map(str::to_owned) }
    }

    /// Draws one of the kinds that only the wide draw has.
    pub fn draw_wide(dice: &mut Dice) -> Self {
        match dice.below(9) {
            0..3 => Self::OldContent(1 + dice.below(4)),
            3..6 => Self::Chatter(dice.within(0.0, 0.6)),
            6..8 => Self::GatewayRestart(dice.below(2)),
            _ => Self::HostDies,
        }
    }

    /// Draws what somebody on a line with a key does to a record.
    pub fn draw_tampering(dice: &mut Dice) -> Self {
        let how = dice.pick(&[Tampering::Changed, Tampering::Repeated, Tampering::Removed]);
        Self::Tampered(dice.below(2), dice.pick(&[Towards::Host, Towards::Gateway]), how)
    }

    /// Draws a fault for the time in which the arms are being enabled: one of an arm, a line or a gateway.
    pub fn draw_enabling(dice: &mut Dice) -> Self {
        match dice.below(OF_ARMS.len() + 4) {
            0 => Self::EmergencyStopOfBoth,
            1 => Self::Unplugged(dice.below(2)),
            2 => Self::GatewayRestart(dice.below(2)),
            3 => Self::Overrun(dice.within(0.005, 0.3)),
            other => Self::draw_of_an_arm(other - 4, dice),
        }
    }

    fn draw_of_an_arm(index: usize, dice: &mut Dice) -> Self {
        let (name, lines) = OF_ARMS[index];
        let (line, end) = lines(dice);
        Self::Arm { arm: dice.below(2), name, line, end }
    }

    /// Draws one of the kinds of the first draw.
    pub fn draw(dice: &mut Dice) -> Self {
        match dice.below(FIRST_OF_THE_CELL + OF_ARMS.len()) {
            0 => Self::EstimatesLost(dice.within(0.1, 1.0)),
            1 => Self::NoPose,
            2 => Self::Doubtful,
            3 => Self::Late(dice.within(0.02, 0.6)),
            4 => Self::Stall,
            5 => Self::Off(dice.within(0.002, 0.2) * dice.sign(), dice.within(0.0, 0.5) * dice.sign()),
            6 => Self::Outliers(dice.within(0.01, 0.5) * dice.sign()),
            7 => Self::Skew(dice.within(0.001, 0.05) * dice.sign()),
            8 => Self::OldImages,
            9 => Self::OtherTarget,
            10 => Self::Overrun(dice.within(0.005, 0.3)),
            11 => Self::ClockJump(dice.within(0.02, 3.0) * dice.sign()),
            12 => Self::EmergencyStopOfBoth,
            13 => Self::Unplugged(dice.below(2)),
            14 => Self::NumbersStand,
            15 => Self::Scatter(dice.within(0.2, 0.5)),
            16 => Self::Unsure([0, 1].map(|_| if dice.unit() < 0.5 { 1.0 } else { dice.within(2.0, 3000.0) })),
            17 => Self::OperatorCommand(dice.pick(&OperatorCommand::ALL), 0.0),
            18 => Self::OperatorCommand(dice.pick(&OperatorCommand::ALL), dice.within(0.05, 2.0)),
            19 => Self::Silence,
            other => Self::draw_of_an_arm(other - FIRST_OF_THE_CELL, dice),
        }
    }

    /// Name in tables.
    pub fn name(&self) -> &'static str {
        OF_THE_CELL[match self {
            Self::EstimatesLost(_) => 0,
            Self::NoPose => 1,
            Self::Doubtful => 2,
            Self::Late(_) => 3,
            Self::Stall => 4,
            Self::Off(..) => 5,
            Self::Outliers(_) => 6,
            Self::Skew(_) => 7,
            Self::OldImages => 8,
            Self::OtherTarget => 9,
            Self::Overrun(_) => 10,
            Self::ClockJump(_) => 11,
            Self::EmergencyStopOfBoth => 12,
            Self::Unplugged(_) => 13,
            Self::NumbersStand => 14,
            Self::Scatter(_) => 15,
            Self::Unsure(_) => 16,
            Self::OperatorCommand(_, 0.0) => 17,
            Self::OperatorCommand(..) => 18,
            Self::Silence => 19,
            Self::OldContent(_) => 20,
            Self::Chatter(_) => 21,
            Self::GatewayRestart(_) => 22,
            Self::HostDies => 23,
            Self::Tampered(..) => 24,
            Self::RecorderStalls => 25,
            Self::Arm { name, .. } => return name,
            Self::Camera(kind) => return cameras::name(kind),
        }]
    }

    /// Words of which a log line must contain one, where the fault must not go unnoticed.
    pub fn log_terms(&self) -> &'static [&'static str] {
        match self {
            Self::EmergencyStopOfBoth => &["emergency stop"],
            Self::Unplugged(_) | Self::Tampered(..) => &["the link is gone"],
            Self::Arm { name: "arm: emergency stop" | "arm: limit switch", .. } => &["emergency stop", "switch"],
            // The gateway reports the alarms of the switches as such.
            Self::Arm { name: "arm: servo alarm" | "arm: controller alarm", line, .. }
                if ["0x11", "0x12", "0x13"].iter().any(|code| line.contains(code)) =>
            {
                &["alarm", "exchanges in a row", "switch"]
            }
            Self::Arm { name: "arm: servo alarm" | "arm: controller alarm", .. } => &["alarm", "exchanges in a row"],
            Self::Arm { name: "arm: power", .. } => &["exchanges in a row", "power", "gateway", "alarm"],
            _ => &[],
        }
    }

    /// Minimum duration of the fault, and the time after that in which both arms begin to stop for good, seconds. The
    /// time follows from the arm's report, from three exchanges without an answer, or from a watchdog of 50 ms.
    pub fn stops_after_s(&self) -> Option<(f64, f64)> {
        const REPORTED_S: f64 = 0.02;
        const MISSED_S: f64 = 0.1;
        match self {
            Self::EmergencyStopOfBoth => Some((0.0, REPORTED_S)),
            Self::GatewayRestart(_) | Self::HostDies => Some((0.0, MISSED_S)),
            Self::Overrun(by_s) if *by_s >= MISSED_S => Some((0.0, MISSED_S)),
            Self::Unplugged(_) | Self::Tampered(..) => Some((0.0, MISSED_S)),
            Self::Arm { name: "bus: silent" | "line: silent" | "line: gateway deaf", .. } => Some((MISSED_S, MISSED_S)),
            Self::Arm { name: "arm: emergency stop" | "arm: limit switch", .. } => Some((0.0, REPORTED_S)),
            Self::Arm { name: "arm: servo alarm" | "arm: controller alarm", .. } => Some((0.0, REPORTED_S)),
            Self::Arm { name: "arm: power", .. } => Some((MISSED_S, MISSED_S)),
            // More than any joint moves between two samples, and more torque than any joint may carry.
            Self::Arm { name: "arm: encoder jumps", line, .. } if amount(line) >= 0.12 => Some((0.0, MISSED_S)),
            Self::Arm { name: "arm: torque", line, .. } if amount(line) >= 130.0 => Some((MISSED_S, MISSED_S)),
            _ => None,
        }
    }

    /// If controller or gateway stop the arm by themselves at this fault: the time within which the program knows it, seconds.
    pub fn stops_beyond_the_host_s(&self) -> Option<f64> {
        /// Until an arm that has come to rest is 0.05 rad from its commanded position for 0.1 s, seconds.
        const UNTIL_THE_GUARD_S: f64 = 0.3;
        match self {
            Self::Overrun(_) | Self::Unplugged(_) | Self::HostDies | Self::Tampered(..) => None,
            // The controller's own watchdog waits 6 ms. Nobody knows the alarms of format A: there the guard stops the arm, later.
            Self::Arm { name: "bus: deaf", .. } => Some(UNTIL_THE_GUARD_S),
            Self::Arm { name: "arm: encoder jumps" | "arm: torque", .. } => None,
            _ => self.stops_after_s().map(|(lasts_s, within_s)| lasts_s + within_s),
        }
    }

    /// The arm concerned; `None` if both.
    pub fn arm(&self) -> Option<usize> {
        match self {
            Self::Unplugged(arm) | Self::GatewayRestart(arm) | Self::Tampered(arm, ..) | Self::Arm { arm, .. } => {
                Some(*arm)
            }
            _ => None,
        }
    }

    /// Makes a fault of one arm one of this arm.
    pub fn set_arm(&mut self, to: usize) {
        if let Self::Unplugged(arm) | Self::GatewayRestart(arm) | Self::Tampered(arm, ..) | Self::Arm { arm, .. } = self
        {
            *arm = to;
        }
    }

    /// The arm that the log cannot see while the fault lasts: its controller has no power, or its replies are lost.
    pub fn hides(&self) -> Option<usize> {
        match self {
            Self::Unplugged(arm) => Some(*arm),
            Self::Arm { arm, name: "arm: power" | "bus: silent" | "line: silent", .. } => Some(*arm),
            _ => None,
        }
    }

    /// The arm whose gateway no command reaches while the fault lasts.
    pub fn keeps_commands_from(&self) -> Option<usize> {
        match self {
            Self::Unplugged(arm) | Self::Arm { arm, name: "line: gateway deaf", .. } => Some(*arm),
            _ => None,
        }
    }

    /// Whether an alarm reports the fault.
    pub fn is_alarm(&self) -> bool {
        matches!(self, Self::Arm { name: "arm: servo alarm" | "arm: controller alarm", .. })
    }

    /// Whether commands to this arm may be lost or late because of the fault.
    pub fn disturbs_commands_to(&self, to: usize) -> bool {
        match self {
            Self::Overrun(_) | Self::ClockJump(_) | Self::HostDies => true,
            Self::Unplugged(arm) | Self::GatewayRestart(arm) | Self::Tampered(arm, ..) => *arm == to,
            Self::Arm { arm, name, .. } => {
                // The guard discards a sample that jumps, and the arm holds.
                let is_lost = name.starts_with("bus:") || name.starts_with("line:") || *name == "arm: encoder jumps";
                *arm == to && is_lost
            }
            _ => false,
        }
    }

    /// Whether only the servo controller can report the fault.
    pub fn is_read_by_controller(&self) -> bool {
        match self {
            Self::EmergencyStopOfBoth => true,
            Self::Arm { name, .. } => {
                matches!(
                    *name,
                    "arm: emergency stop" | "arm: limit switch" | "arm: servo alarm" | "arm: controller alarm"
                )
            }
            _ => false,
        }
    }

    /// Whether the fault may stop arms.
    pub fn may_stop(&self) -> bool {
        match self {
            Self::Arm { .. } | Self::Unplugged(_) | Self::EmergencyStopOfBoth => true,
            Self::GatewayRestart(_) | Self::HostDies | Self::Tampered(..) | Self::Chatter(_) => true,
            Self::Overrun(_) | Self::ClockJump(_) | Self::Silence => true,
            Self::OperatorCommand(kind_name, _) => *kind_name == OperatorCommand::Stop,
            _ => false,
        }
    }

    /// Whether a camera fault can replace this fault of the estimates.
    pub fn is_of_estimates(&self) -> bool {
        matches!(
            self,
            Self::EstimatesLost(_)
                | Self::NoPose
                | Self::Doubtful
                | Self::Late(_)
                | Self::Stall
                | Self::Skew(_)
                | Self::OldImages
                | Self::NumbersStand
        )
    }

    /// Whether the fault ends with its time; an alarm stays.
    pub fn ends(&self) -> bool {
        !matches!(self, Self::Arm { end: None, .. } | Self::GatewayRestart(_) | Self::HostDies | Self::Tampered(..))
    }

    /// The arm and the joint (from 0) that does not obey commands while the fault lasts.
    pub fn disobeys(&self) -> Option<(usize, usize)> {
        match self {
            Self::Arm { arm, name: "arm: stuck joint" | "arm: runaway joint", line, .. } => {
                let axis: usize = line.split(' ').nth(1)?.parse().ok()?;
                Some((*arm, axis - 1))
            }
            _ => None,
        }
    }
}

/// The value in the third word of a line, without unit and sign.
fn amount(line: &str) -> f64 {
    let kind_name = line.split(' ').nth(2).unwrap_or("");
    let number = kind_name.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    number.parse().map_or(0.0, f64::abs)
}

impl Fault {
    /// A fault that is no stall.
    pub fn new(kind: Kind, from_s: f64, for_s: f64) -> Self {
        Self { kind, from_s, for_s, stall: None }
    }

    /// Name in tables.
    pub fn name(&self) -> &'static str {
        self.stall.unwrap_or_else(|| self.kind.name())
    }

    /// Whether it begins while the arms are being enabled.
    pub fn is_of_enabling(&self) -> bool {
        self.from_s < 0.0
    }

    /// End of the fault, seconds.
    pub fn until_s(&self) -> f64 {
        self.from_s + self.for_s
    }

    /// Whether the fault is active at this time.
    pub fn is_on(&self, t_s: f64) -> bool {
        (self.from_s..self.until_s()).contains(&t_s)
    }
}
