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
    brakes: [Brake; Axis::COUNT],
    brake_time: Duration,
}

/// The last command to a brake, and its time.
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

pub(super) fn is_open(axis: &AxisCommand) -> bool {
    matches!(axis, AxisCommand::Speed(_))
}

/// Kind of a command: one open brake counts.
pub(super) fn kind(command: &ArmCommand) -> Kind {
    if command.axes.iter().any(|axis| axis.speed() != SpeedCounts::ZERO) {
        Kind::Motion
    } else if command.axes.iter().any(is_open) {
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
            brakes: [Brake::OpenSince(now); Axis::COUNT],
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
        for (brake, axis) in self.brakes.iter_mut().zip(&command.axes) {
            *brake = match (is_open(axis), *brake) {
                (true, Brake::OpenSince(since)) => Brake::OpenSince(since),
                (true, _) => Brake::OpenSince(now),
                (false, Brake::OpenSince(_)) => Brake::Closed { since: now, acknowledged: false },
                (false, closed @ Brake::Closed { .. }) => closed,
            };
        }
        self.sent = *command;
    }

    /// The last message was answered: the controller has received its brake commands, now at the latest.
    pub fn note_acknowledged(&mut self, now: MonotonicTime) {
        for brake in &mut self.brakes {
            if let Brake::Closed { acknowledged: false, .. } = brake {
                *brake = Brake::Closed { since: now, acknowledged: true };
            }
        }
    }

    /// Whether the controller has received the command to close every brake.
    pub fn is_acknowledged(&self) -> bool {
        self.brakes.iter().all(|brake| matches!(brake, Brake::Closed { acknowledged: true, .. }))
    }

    /// It is unknown what the controller has received: all brakes on, servos on.
    pub fn doubt(&mut self) {
        self.sent.axes = [AxisCommand::Braked; Axis::COUNT];
        for brake in &mut self.brakes {
            if let Brake::Closed { acknowledged, .. } = brake {
                *acknowledged = false;
            }
        }
    }

    /// Whether each axis that is to move had the time to open its brake.
    pub fn may_move(&self, now: MonotonicTime, command: &ArmCommand) -> bool {
        command.axes.iter().zip(&self.brakes).all(|(axis, brake)| {
            let is_ready = matches!(brake, Brake::OpenSince(since) if now.saturating_since(*since) >= self.brake_time);
            is_ready || axis.speed() == SpeedCounts::ZERO
        })
    }

    /// Whether a command keeps each brake as the last command set it.
    pub fn keeps_brakes(&self, command: &ArmCommand) -> bool {
        command.axes.iter().zip(&self.target.axes).all(|(new, old)| is_open(new) == is_open(old))
    }

    /// Whether a command closes the brake of an axis before its speed is 0.
    pub fn brakes_motion(&self, command: &ArmCommand) -> bool {
        command.axes.iter().zip(&self.sent.axes).any(|(new, old)| !is_open(new) && old.speed() != SpeedCounts::ZERO)
    }

    /// Whether every brake is on and had the time to close.
    pub fn brakes_closed(&self, now: MonotonicTime) -> bool {
        (0..Axis::COUNT).all(|index| self.brake_holds(index, now))
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
                AxisCommand::Off if !self.brake_holds(index, now) => AxisCommand::Braked,
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

    fn brake_holds(&self, index: usize, now: MonotonicTime) -> bool {
        match self.brakes[index] {
            Brake::OpenSince(_) => false,
            Brake::Closed { since, .. } => now.saturating_since(since) >= self.brake_time,
        }
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
