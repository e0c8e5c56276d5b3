//! The command of a cycle: what the host asked for, how far the arm is on the way to it, and how the stop order leads it to rest.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, Axis, AxisCommand, SpeedCounts, Supervision};
use pb3dp_arm_pa10_protocol::watchdog::{CommandWatchdog, Staleness};
use pb3dp_geometry::MonotonicTime;
use pb3dp_safeguards::{Safeguard, is_off};

/// What is sent, and since when.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// What the host asked for.
    target: ArmCommand,
    /// The speeds that were sent when it came.
    from: [SpeedCounts; Axis::COUNT],
    since: MonotonicTime,
    /// How long the way from there to the target takes.
    over: Duration,
    sent: ArmCommand,
    brakes: [Brake; Axis::COUNT],
    brake_time: Duration,
}

/// Where a brake was told to be, and since when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Brake {
    OpenSince(MonotonicTime),
    /// Since it was said first; since it was answered first, once it was.
    Closed {
        since: MonotonicTime,
        heard: bool,
    },
}

/// What kind of command.
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

/// What kind of command it is: one open brake counts.
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
    /// Nobody knows what was before: the brakes count as open until they were told to close, and had their time.
    pub fn new(brake_time: Duration, now: MonotonicTime) -> Self {
        Self {
            target: off(),
            from: [SpeedCounts::ZERO; Axis::COUNT],
            since: MonotonicTime::ZERO,
            over: Duration::ZERO,
            sent: ArmCommand::uniform(AxisCommand::Braked, Supervision::default()),
            brakes: [Brake::OpenSince(now); Axis::COUNT],
            brake_time,
        }
    }

    /// The control mode has begun: brakes on, servos off.
    pub fn restart(&mut self, now: MonotonicTime, supervision: Supervision) {
        self.follow(now, ArmCommand { supervision, ..off() }, Duration::ZERO);
    }

    /// A command came; speeds take this long to get there. One that only repeats the last one leaves its way as long as it was.
    pub fn follow(&mut self, now: MonotonicTime, target: ArmCommand, over: Duration) {
        self.over = if target == self.target { (self.since + self.over).saturating_since(now) } else { over };
        (self.target, self.since) = (target, now);
        self.from = self.sent.axes.map(|axis| axis.speed());
    }

    /// As [`Self::follow`], after the watchdog has slowed the arm down: the way begins anew.
    pub fn follow_anew(&mut self, now: MonotonicTime, target: ArmCommand, over: Duration) {
        (self.target, self.since, self.over) = (target, now, over);
        self.from = self.sent.axes.map(|axis| axis.speed());
    }

    /// When the last command came.
    pub fn since(&self) -> MonotonicTime {
        self.since
    }

    /// Age of the last command.
    pub fn age(&self, now: MonotonicTime) -> Duration {
        now.saturating_since(self.since)
    }

    /// What was sent last.
    pub fn sent(&self) -> &ArmCommand {
        &self.sent
    }

    /// Notes what is sent in this cycle.
    pub fn note_sent(&mut self, now: MonotonicTime, command: &ArmCommand) {
        for (brake, axis) in self.brakes.iter_mut().zip(&command.axes) {
            *brake = match (is_open(axis), *brake) {
                (true, Brake::OpenSince(since)) => Brake::OpenSince(since),
                (true, _) => Brake::OpenSince(now),
                (false, Brake::OpenSince(_)) => Brake::Closed { since: now, heard: false },
                (false, closed @ Brake::Closed { .. }) => closed,
            };
        }
        self.sent = *command;
    }

    /// What was sent last was answered: what it says of brakes was heard, now at the latest.
    pub fn note_heard(&mut self, now: MonotonicTime) {
        for brake in &mut self.brakes {
            if let Brake::Closed { heard: false, .. } = brake {
                *brake = Brake::Closed { since: now, heard: true };
            }
        }
    }

    /// Whether the controller has heard that every brake is to be on.
    pub fn is_heard(&self) -> bool {
        self.brakes.iter().all(|brake| matches!(brake, Brake::Closed { heard: true, .. }))
    }

    /// Nobody knows any more what the controller has heard: all brakes on, servos on.
    pub fn doubt(&mut self) {
        self.sent.axes = [AxisCommand::Braked; Axis::COUNT];
        for brake in &mut self.brakes {
            if let Brake::Closed { heard, .. } = brake {
                *heard = false;
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

    /// Whether a command leaves each brake where the last one wanted it.
    pub fn keeps_brakes(&self, command: &ArmCommand) -> bool {
        command.axes.iter().zip(&self.target.axes).all(|(new, old)| is_open(new) == is_open(old))
    }

    /// Whether a command closes the brake of an axis that has not come to speed 0.
    pub fn brakes_motion(&self, command: &ArmCommand) -> bool {
        command.axes.iter().zip(&self.sent.axes).any(|(new, old)| !is_open(new) && old.speed() != SpeedCounts::ZERO)
    }

    /// Whether every brake is on and had the time to close.
    pub fn brakes_closed(&self, now: MonotonicTime) -> bool {
        (0..Axis::COUNT).all(|index| self.brake_holds(index, now))
    }

    /// The command of this cycle, and whether the watchdog slows it down.
    pub fn command(&self, now: MonotonicTime, watchdog: &CommandWatchdog) -> (ArmCommand, bool) {
        let (left, slowed) = match watchdog.judge(self.age(now)) {
            _ if is_off(Safeguard::GatewayWatchdog) => (1.0, false),
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
                // A servo that lets go before the brake holds lets the axis fall.
                AxisCommand::Off if !self.brake_holds(index, now) => AxisCommand::Braked,
                braked => braked,
            };
        }
        (command, slowed)
    }

    /// All brakes on; servos that are on stay on.
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

/// A command with this part of its speeds.
pub(super) fn fading(from: &ArmCommand, left: f64) -> ArmCommand {
    let axes = from.axes.map(|axis| match axis {
        AxisCommand::Speed(speed) => AxisCommand::Speed(part(f64::from(speed.0), left)),
        other => other,
    });
    ArmCommand { axes, ..*from }
}

/// A part, between 0 and 1, of a number of counts.
fn part(counts: f64, part: f64) -> SpeedCounts {
    // Within 16 bits, as it lies between two numbers that are, or between one of them and 0.
    SpeedCounts((counts * part).round() as i16)
}
