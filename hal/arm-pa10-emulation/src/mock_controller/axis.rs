//! Brake and servo of one axis.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_sim::joint_dynamics::AxisMode;

/// State of a brake, which takes time to change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Brake {
    /// It holds.
    Closed,
    /// It still holds.
    Opening { until: MonotonicTime },
    /// It does not hold.
    Open,
    /// It does not hold yet.
    Closing { until: MonotonicTime },
}

/// Brake, servo and mechanical faults of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AxisDrive {
    pub brake: Brake,
    pub servo_on: bool,
    /// The servo switches off as soon as the brake holds.
    servo_off_when_held: bool,
    /// Command of the servo, rad/s.
    pub velocity_rad_per_s: f64,
    /// The joint is blocked.
    pub stuck: bool,
    /// Velocity that replaces the command, rad/s.
    pub runaway_rad_per_s: Option<f64>,
}

impl AxisDrive {
    /// State after power-up.
    pub const AT_REST: Self = Self {
        brake: Brake::Closed,
        servo_on: false,
        servo_off_when_held: false,
        velocity_rad_per_s: 0.0,
        stuck: false,
        runaway_rad_per_s: None,
    };

    /// Executes a command.
    pub fn command(
        &mut self,
        now: MonotonicTime,
        times: BrakeTimes,
        brake_on: bool,
        servo_on: bool,
        velocity_rad_per_s: f64,
    ) {
        self.servo_off_when_held = false;
        self.servo_on = servo_on;
        self.velocity_rad_per_s = if servo_on && !brake_on { velocity_rad_per_s } else { 0.0 };
        if brake_on { self.close(now, times) } else { self.open(now, times) }
    }

    /// Stops with its servo, which switches off when the brake holds.
    pub fn stop(&mut self, now: MonotonicTime, times: BrakeTimes) {
        self.velocity_rad_per_s = 0.0;
        self.servo_off_when_held = true;
        self.close(now, times);
        self.settle();
    }

    /// Power loss: the servo is off at once, and the brake closes.
    pub fn cut(&mut self, now: MonotonicTime, times: BrakeTimes) {
        self.command(now, times, true, false, 0.0);
    }

    fn open(&mut self, now: MonotonicTime, times: BrakeTimes) {
        self.brake = match self.brake {
            Brake::Closed => Brake::Opening { until: now + times.open },
            Brake::Closing { .. } => Brake::Open,
            other => other,
        };
    }

    fn close(&mut self, now: MonotonicTime, times: BrakeTimes) {
        self.brake = match self.brake {
            Brake::Open => Brake::Closing { until: now + times.close },
            Brake::Opening { .. } => Brake::Closed,
            other => other,
        };
    }

    /// Time at which the brake has finished its motion.
    pub fn next_change(&self) -> Option<MonotonicTime> {
        match self.brake {
            Brake::Opening { until } | Brake::Closing { until } => Some(until),
            Brake::Closed | Brake::Open => None,
        }
    }

    /// Advances the time.
    pub fn advance(&mut self, now: MonotonicTime) {
        self.brake = match self.brake {
            Brake::Opening { until } if now >= until => Brake::Open,
            Brake::Closing { until } if now >= until => Brake::Closed,
            other => other,
        };
        self.settle();
    }

    fn settle(&mut self) {
        if self.servo_off_when_held && self.brake == Brake::Closed {
            (self.servo_on, self.servo_off_when_held) = (false, false);
        }
    }

    /// Brake or servo that holds the joint.
    pub fn mode(&self) -> AxisMode {
        let held = matches!(self.brake, Brake::Closed | Brake::Opening { .. });
        match self.runaway_rad_per_s {
            _ if held || self.stuck => AxisMode::Brake,
            Some(velocity_rad_per_s) if self.servo_on => AxisMode::Driven { velocity_rad_per_s },
            _ if self.servo_on => AxisMode::Servo,
            _ => AxisMode::Free,
        }
    }
}

/// How long brakes take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BrakeTimes {
    pub open: Duration,
    pub close: Duration,
}
