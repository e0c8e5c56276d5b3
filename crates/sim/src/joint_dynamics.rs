//! Joint dynamics of an arm that follows velocity commands: delay, lag, saturation, end stops, quantised angles.
//!
//! Every joint follows v' = clamp((u - v) / tau, +-a), x' = v, with the delayed and saturated command u. Between two commands
//! this has a closed form. [`JointPlant`] stores these pieces instead of integrating in steps. The state at a time therefore
//! depends on the commands only, to the last bit, and not on the number or size of the steps; past states are as exact as the
//! present one.
//!
//! Joints that are not held by their drive ([`AxisMode`]) follow the same law with other parameters ([`JointMechanics`]).

mod mechanics;
mod motion;

use std::collections::VecDeque;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{DOF, JointLimits, JointState, JointVector, PositionViolation};

pub use mechanics::{AxisMode, JointMechanics};
use motion::{Drive, JointPath};

/// Angle of one resolver count of the PA-10, rad: 360 degrees / (16384 counts x gear 50).
pub const PA10_ANGLE_QUANTUM_RAD: f64 = std::f64::consts::TAU / (16384.0 * 50.0);

/// Capabilities of the joints and response of their drives.
#[derive(Clone, Debug, PartialEq)]
pub struct JointPlantConfig {
    /// End stops (rad), at which a joint stops at once, and speeds (rad/s), to which commands are saturated.
    pub limits: JointLimits,
    /// Largest acceleration and deceleration of each joint, rad/s^2.
    pub acceleration_max_rad_per_s2: JointVector,
    /// Time constant of the velocity loop; zero: velocity changes at the largest acceleration.
    pub velocity_time_constant: Duration,
    /// Time from a command to its effect.
    pub command_delay: Duration,
    /// Step of the measured angles, rad; zero: no quantisation. [`PA10_ANGLE_QUANTUM_RAD`] for a PA-10.
    pub angle_quantum_rad: f64,
    /// Time span covered by [`JointPlant::position_at`].
    pub history: Duration,
}

/// Errors of the joint simulation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JointPlantError {
    /// A number of the configuration is out of range.
    #[error("{name}{} is {value}, it must be {allowed}", joint.map(|j| format!(" of axis {}", j + 1)).unwrap_or_default())]
    Config {
        /// Field of [`JointPlantConfig`].
        name: &'static str,
        /// Index from the base, 0 to 6, if the number belongs to a joint.
        joint: Option<usize>,
        /// The number.
        value: f64,
        /// The allowed values.
        allowed: &'static str,
    },
    /// The start position is outside the end stops.
    #[error("axis {} starts at {:.2} degrees, outside its end stops, {:.2} to {:.2} degrees", .0.joint + 1, .0.position_rad.to_degrees(), .0.min_rad.to_degrees(), .0.max_rad.to_degrees())]
    Start(PositionViolation),
    /// A command is not finite.
    #[error("axis {}: velocity command {velocity_rad_per_s} rad/s is not finite", .joint + 1)]
    Command {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// The command, rad/s.
        velocity_rad_per_s: f64,
    },
}

/// The joints of one arm. Deterministic: the same commands at the same times give the same bits.
#[derive(Clone, Debug)]
pub struct JointPlant {
    config: JointPlantConfig,
    mechanics: JointMechanics,
    now: MonotonicTime,
    /// Mode of each joint, and the velocity followed by joints with an active drive.
    modes: [AxisMode; DOF],
    velocity_rad_per_s: JointVector,
    /// The current piece, valid until the next command takes effect.
    current: Piece,
    /// The pieces before it, oldest first.
    past: VecDeque<Piece>,
    /// Delayed commands, in the order in which they take effect.
    pending: VecDeque<Pending>,
}

/// A command that has not taken effect yet.
#[derive(Clone, Copy, Debug)]
struct Pending {
    effective: MonotonicTime,
    velocity_rad_per_s: JointVector,
    /// The expiry of an earlier command; a newer command cancels it.
    is_expiry: bool,
}

/// The motion of all joints between two changes of command.
#[derive(Clone, Debug)]
struct Piece {
    start: MonotonicTime,
    drives: [Drive; DOF],
    paths: [JointPath; DOF],
}

impl JointPlant {
    /// Joints stationary at `position_rad` at the time `at`, with the default [`JointMechanics`].
    ///
    /// # Errors
    /// A number of the configuration is out of range, or the start lies outside the end stops.
    pub fn new(
        config: JointPlantConfig,
        position_rad: JointVector,
        at: MonotonicTime,
    ) -> Result<Self, JointPlantError> {
        check(&config)?;
        if let Some(violation) = config.limits.violation(&position_rad) {
            return Err(JointPlantError::Start(violation));
        }
        let mechanics = JointMechanics::default();
        let modes = [AxisMode::Servo; DOF];
        let rest = JointVector::zeros();
        let drives = mechanics.drives(&config, &modes, &position_rad);
        let current = Piece::new(drives, at, &position_rad, &rest, &mechanics.targets(&modes, &position_rad, &rest));
        let (past, pending) = (VecDeque::new(), VecDeque::new());
        Ok(Self { config, mechanics, now: at, modes, velocity_rad_per_s: rest, current, past, pending })
    }

    /// The same joints with this friction, these brakes and this gravity instead of the default ones; only before the first
    /// command.
    ///
    /// # Errors
    /// A number is out of range.
    pub fn with_mechanics(mut self, mechanics: JointMechanics) -> Result<Self, JointPlantError> {
        mechanics.check()?;
        self.mechanics = mechanics;
        Ok(self)
    }

    /// The configuration.
    pub fn config(&self) -> &JointPlantConfig {
        &self.config
    }

    /// The time to which the plant has advanced.
    pub fn now(&self) -> MonotonicTime {
        self.now
    }

    /// Gives a velocity command (rad/s) at the time `at`. It takes effect after the command delay, saturated to the speed limits,
    /// and holds until the next command. A command cannot change the past or overtake an earlier command: it takes effect no
    /// earlier than [`Self::now`] and no earlier than the previous command.
    ///
    /// # Errors
    /// A number is not finite; then nothing is changed.
    pub fn command(&mut self, at: MonotonicTime, velocity_rad_per_s: JointVector) -> Result<(), JointPlantError> {
        if let Some(joint) = (0..DOF).find(|&joint| !velocity_rad_per_s[joint].is_finite()) {
            return Err(JointPlantError::Command { joint, velocity_rad_per_s: velocity_rad_per_s[joint] });
        }
        let arrives = (at + self.config.command_delay).max(self.now);
        // An expiry before this command still happens, even if the plant has not advanced to it yet.
        if self.pending.back().is_some_and(|last| last.is_expiry && last.effective >= arrives) {
            self.pending.pop_back();
        }
        let effective = self.pending.back().map_or(arrives, |last| last.effective.max(arrives));
        self.pending.push_back(Pending { effective, velocity_rad_per_s, is_expiry: false });
        Ok(())
    }

    /// As [`Self::command`], for a drive with a watchdog: without another command within `valid_for` the joints stop.
    ///
    /// # Errors
    /// As [`Self::command`].
    pub fn command_for(
        &mut self,
        at: MonotonicTime,
        velocity_rad_per_s: JointVector,
        valid_for: Duration,
    ) -> Result<(), JointPlantError> {
        self.command(at, velocity_rad_per_s)?;
        let starts = self.pending.back().map_or(self.now, |last| last.effective);
        let velocity_rad_per_s = JointVector::zeros();
        self.pending.push_back(Pending { effective: starts + valid_for, velocity_rad_per_s, is_expiry: true });
        Ok(())
    }

    /// Drops all pending commands and stops the joints from `at` on (or [`Self::now`], if that is later), without command delay,
    /// with the deceleration of the drives.
    pub fn halt(&mut self, at: MonotonicTime) {
        self.advance_to(at);
        self.pending.clear();
        self.velocity_rad_per_s = JointVector::zeros();
        self.take_effect(self.now);
    }

    /// Changes the mode of each joint, from `at` on (or [`Self::now`], if that is later), without command delay. Velocity
    /// commands are kept, and joints with an active drive follow them.
    ///
    /// # Errors
    /// A velocity is not finite; then nothing is changed.
    pub fn set_modes(&mut self, at: MonotonicTime, modes: [AxisMode; DOF]) -> Result<(), JointPlantError> {
        for (joint, mode) in modes.iter().enumerate() {
            if let AxisMode::Driven { velocity_rad_per_s } = *mode
                && !velocity_rad_per_s.is_finite()
            {
                return Err(JointPlantError::Command { joint, velocity_rad_per_s });
            }
        }
        self.advance_to(at);
        if self.modes != modes {
            self.modes = modes;
            self.take_effect(self.now);
        }
        Ok(())
    }

    /// The most recent velocity command, pending or in effect, rad/s.
    pub fn commanded_rad_per_s(&self) -> &JointVector {
        self.pending.back().map_or(&self.velocity_rad_per_s, |last| &last.velocity_rad_per_s)
    }

    /// The mode of each joint.
    pub fn modes(&self) -> &[AxisMode; DOF] {
        &self.modes
    }

    /// Advances to `at`; a time before [`Self::now`] has no effect.
    pub fn advance_to(&mut self, at: MonotonicTime) {
        self.now = self.now.max(at);
        while let Some(next) = self.pending.front().copied().filter(|next| next.effective <= self.now) {
            self.pending.pop_front();
            self.velocity_rad_per_s = next.velocity_rad_per_s;
            self.take_effect(next.effective);
        }
        let oldest_wanted = self.now - self.config.history;
        let still_wanted = |plant: &Self| plant.past.get(1).unwrap_or(&plant.current).start > oldest_wanted;
        while !self.past.is_empty() && !still_wanted(self) {
            self.past.pop_front();
        }
    }

    /// Measured joints at the present time: angles quantised, velocities exact.
    pub fn state(&self) -> JointState {
        let (position_rad, velocity_rad_per_s) = self.current.at(self.now);
        let quantum = self.config.angle_quantum_rad;
        let measured = |angle: f64| if quantum > 0.0 { (angle / quantum).round() * quantum } else { angle };
        JointState { at: self.now, position_rad: position_rad.map(measured), velocity_rad_per_s }
    }

    /// True angles (rad, not quantised) at a time between the start, or [`JointPlantConfig::history`] ago, and the present;
    /// `None` outside.
    pub fn position_at(&self, at: MonotonicTime) -> Option<JointVector> {
        self.motion_at(at).map(|(position_rad, _)| position_rad)
    }

    /// True velocities (rad/s) at a time, as [`Self::position_at`].
    pub fn velocity_at(&self, at: MonotonicTime) -> Option<JointVector> {
        self.motion_at(at).map(|(_, velocity_rad_per_s)| velocity_rad_per_s)
    }

    /// True angles (rad) and velocities (rad/s) at a time, as [`Self::position_at`].
    pub fn motion_at(&self, at: MonotonicTime) -> Option<(JointVector, JointVector)> {
        if at > self.now {
            return None;
        }
        let pieces = std::iter::once(&self.current).chain(self.past.iter().rev());
        let piece = pieces.into_iter().find(|piece| piece.start <= at)?;
        Some(piece.at(at))
    }

    fn take_effect(&mut self, at: MonotonicTime) {
        let (position, velocity) = self.current.at(at);
        let drives = self.mechanics.drives(&self.config, &self.modes, &position);
        let targets = self.mechanics.targets(&self.modes, &position, &self.velocity_rad_per_s);
        let replaced = std::mem::replace(&mut self.current, Piece::new(drives, at, &position, &velocity, &targets));
        // Of two commands at the same time the later one counts.
        if replaced.start < at {
            self.past.push_back(replaced);
        }
    }
}

impl Piece {
    fn new(
        drives: [Drive; DOF],
        start: MonotonicTime,
        position: &JointVector,
        velocity: &JointVector,
        command: &JointVector,
    ) -> Self {
        let paths = std::array::from_fn(|i| {
            JointPath::new(&drives[i], position[i], velocity[i], drives[i].saturate(command[i]))
        });
        Self { start, drives, paths }
    }

    /// Positions and velocities at a time of this piece.
    fn at(&self, at: MonotonicTime) -> (JointVector, JointVector) {
        let elapsed = at.seconds_since(self.start);
        let (mut position, mut velocity) = (JointVector::zeros(), JointVector::zeros());
        for i in 0..DOF {
            (position[i], velocity[i]) = self.paths[i].at(&self.drives[i], elapsed);
        }
        (position, velocity)
    }
}

fn check(config: &JointPlantConfig) -> Result<(), JointPlantError> {
    mechanics::positive("acceleration_max_rad_per_s2", &config.acceleration_max_rad_per_s2)?;
    let value = config.angle_quantum_rad;
    if !(value.is_finite() && value >= 0.0) {
        let allowed = "zero or a positive, finite number";
        return Err(JointPlantError::Config { name: "angle_quantum_rad", joint: None, value, allowed });
    }
    Ok(())
}

#[cfg(test)]
mod mechanics_tests;
#[cfg(test)]
mod tests;
