//! The command of a cycle: follows the host's command, interpolates speeds, fades stale commands and stops the arm.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, Axis, AxisCommand, SpeedCounts, Supervision};
use pb3dp_arm_pa10_protocol::watchdog::{CommandWatchdog, Staleness};
use pb3dp_geometry::MonotonicTime;

use super::limits::LimitMonitor;

/// The current command, and its time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// The last command of the host.
    target: ArmCommand,
    /// The speeds that were sent when the command came.
    from: [SpeedCounts; Axis::COUNT],
    since: MonotonicTime,
    /// Time to go from these speeds to the target.
    over: Duration,
    /// Time and speeds when the first command came after the watchdog had slowed the arm down.
    resumed: Option<(MonotonicTime, [SpeedCounts; Axis::COUNT])>,
    sent: ArmCommand,
    brakes: Brake,
    brake_time: Duration,
}

/// The last command to the brakes, which all get the same one, and its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Brake {
    OpenSince(MonotonicTime),
    /// `since` is the time of the first command; after the first answer it is the time of that answer.
    Closed {
        since: MonotonicTime,
        acknowledged: bool,
    },
}

/// Kind of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    BrakesOn,
    Rest,
    Motion,
}

/// All brakes on, servos off.
fn off() -> ArmCommand {
    ArmCommand::uniform(AxisCommand::Off, Supervision::default())
}

/// Whether a command opens the brakes, or leaves them open. All axes have the same mode.
pub(super) fn opens(command: &ArmCommand) -> bool {
    command.axes.iter().any(|axis| matches!(axis, AxisCommand::Speed(_)))
}

/// Kind of a command.
pub(super) fn kind(command: &ArmCommand) -> Kind {
    if command.axes.iter().any(|axis| axis.speed() != SpeedCounts::ZERO) {
        Kind::Motion
    } else if opens(command) {
        Kind::Rest
    } else {
        Kind::BrakesOn
    }
}

impl Motion {
    /// The state is unknown: brakes count as open until they were commanded to close and had their time.
    pub fn new(brake_time: Duration, now: MonotonicTime) -> Self {
        Self {
            target: off(),
            from: [SpeedCounts::ZERO; Axis::COUNT],
            since: MonotonicTime::ZERO,
            over: Duration::ZERO,
            resumed: None,
            sent: ArmCommand::uniform(AxisCommand::Braked, Supervision::default()),
            brakes: Brake::OpenSince(now),
            brake_time,
        }
    }

    /// The control mode has begun: brakes on, servos off.
    pub fn restart(&mut self, now: MonotonicTime, supervision: Supervision) {
        self.follow(now, ArmCommand { supervision, ..off() }, Duration::ZERO);
        self.resumed = None;
    }

    /// Follows a new command; speeds reach it after `over`. A repeated command keeps the end of the interpolation.
    pub fn follow(&mut self, now: MonotonicTime, target: ArmCommand, over: Duration) {
        self.over = if target == self.target { (self.since + self.over).saturating_since(now) } else { over };
        (self.target, self.since) = (target, now);
        self.from = self.sent.axes.map(|axis| axis.speed());
    }

    /// As [`Self::follow`], after the watchdog has slowed the arm down: the interpolation starts again, and the speeds rise with
    /// the allowed accelerations.
    pub fn follow_anew(&mut self, now: MonotonicTime, target: ArmCommand, over: Duration) {
        (self.target, self.since, self.over) = (target, now, over);
        self.from = self.sent.axes.map(|axis| axis.speed());
        self.resumed = Some((now, self.from));
    }

    /// Time of the last command.
    pub fn since(&self) -> MonotonicTime {
        self.since
    }

    /// Age of the last command.
    pub fn age(&self, now: MonotonicTime) -> Duration {
        now.saturating_since(self.since)
    }

    /// The last command sent.
    pub fn sent(&self) -> &ArmCommand {
        &self.sent
    }

    /// Records the command that is sent in this cycle.
    pub fn note_sent(&mut self, now: MonotonicTime, command: &ArmCommand) {
        self.brakes = match (opens(command), self.brakes) {
            (true, Brake::Closed { .. }) => Brake::OpenSince(now),
            (false, Brake::OpenSince(_)) => Brake::Closed { since: now, acknowledged: false },
            (_, unchanged) => unchanged,
        };
        self.sent = *command;
    }

    /// The last message was answered: the controller has received its brake commands, now at the latest.
    pub fn note_acknowledged(&mut self, now: MonotonicTime) {
        if let Brake::Closed { acknowledged: false, .. } = self.brakes {
            self.brakes = Brake::Closed { since: now, acknowledged: true };
        }
    }

    /// Whether the controller has received the command to close the brakes.
    pub fn is_acknowledged(&self) -> bool {
        matches!(self.brakes, Brake::Closed { acknowledged: true, .. })
    }

    /// It is unknown what the controller has received: all brakes on, servos on.
    pub fn doubt(&mut self) {
        self.sent.axes = [AxisCommand::Braked; Axis::COUNT];
        if let Brake::Closed { acknowledged, .. } = &mut self.brakes {
            *acknowledged = false;
        }
    }

    /// Whether the brakes had the time to open, if a command moves an axis.
    pub fn may_move(&self, now: MonotonicTime, command: &ArmCommand) -> bool {
        let is_ready = matches!(self.brakes, Brake::OpenSince(since) if now.saturating_since(since) >= self.brake_time);
        is_ready || kind(command) != Kind::Motion
    }

    /// Whether a command closes the brakes before the speeds are 0.
    pub fn brakes_motion(&self, command: &ArmCommand) -> bool {
        !opens(command) && kind(&self.sent) == Kind::Motion
    }

    /// Whether the brakes are on and had the time to close.
    pub fn brakes_closed(&self, now: MonotonicTime) -> bool {
        matches!(self.brakes, Brake::Closed { since, .. } if now.saturating_since(since) >= self.brake_time)
    }

    /// The command of this cycle, and whether the watchdog slows it down.
    pub fn command(&self, now: MonotonicTime, watchdog: &CommandWatchdog, limits: &LimitMonitor) -> (ArmCommand, bool) {
        let (left, slowed) = match watchdog.judge(self.age(now)) {
            Staleness::Fresh => (1.0, false),
            Staleness::Ramp(part) => (part, true),
            Staleness::Expired => (0.0, true),
        };
        let way = if self.over.is_zero() { 1.0 } else { self.age(now).as_secs_f64() / self.over.as_secs_f64() };
        let mut command = self.target;
        for (index, axis) in command.axes.iter_mut().enumerate() {
            *axis = match *axis {
                AxisCommand::Speed(to) => {
                    let from = f64::from(self.from[index].0);
                    AxisCommand::Speed(part((f64::from(to.0) - from).mul_add(way.min(1.0), from), left))
                }
                // A servo that is disabled before the brake holds lets the axis fall.
                AxisCommand::Off if !self.brakes_closed(now) => AxisCommand::Braked,
                braked => braked,
            };
        }
        match self.resumed {
            Some((since, from)) => {
                (fading(&command, share_risen(&command, &from, now.seconds_since(since), limits)), slowed)
            }
            _ => (command, slowed),
        }
    }

    /// All brakes on; enabled servos stay enabled.
    pub fn braked(&self) -> ArmCommand {
        let axes = self.sent.axes.map(|axis| match axis {
            AxisCommand::Speed(_) | AxisCommand::Braked => AxisCommand::Braked,
            AxisCommand::Off => AxisCommand::Off,
        });
        ArmCommand { axes, ..self.sent }
    }

    /// All brakes on, servos off.
    pub fn off(&self) -> ArmCommand {
        ArmCommand { supervision: self.sent.supervision, ..off() }
    }
}

/// Share of a command that all axes can have reached after a time, from these speeds and with the allowed accelerations.
fn share_risen(command: &ArmCommand, from: &[SpeedCounts; Axis::COUNT], time_s: f64, limits: &LimitMonitor) -> f64 {
    let share = |index: usize| {
        let most = from[index].to_rad_per_s().abs() + limits.acceleration_rad_per_s2(index) * time_s;
        let speed = command.axes[index].speed().to_rad_per_s().abs();
        if speed > most { most / speed } else { 1.0 }
    };
    (0..Axis::COUNT).map(share).fold(1.0, f64::min)
}

/// The command with its speeds scaled by `left`.
pub(super) fn fading(from: &ArmCommand, left: f64) -> ArmCommand {
    let axes = from.axes.map(|axis| match axis {
        AxisCommand::Speed(speed) => AxisCommand::Speed(part(f64::from(speed.0), left)),
        other => other,
    });
    ArmCommand { axes, ..*from }
}

/// A number of counts scaled by `part`, 0 to 1.
fn part(counts: f64, part: f64) -> SpeedCounts {
    // Within 16 bits: the value lies between two 16-bit numbers, or between one and 0.
    SpeedCounts((counts * part).round() as i16)
}
