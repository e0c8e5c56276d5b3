//! History of velocity commands, to predict the motion that the joints still have to execute.

use std::collections::VecDeque;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{JointState, JointVector};

use crate::config::ArmResponse;

/// Ring buffer of commanded velocities; each is valid until the next. All memory is allocated at construction.
#[derive(Clone, Debug)]
pub struct GivenCommands {
    given: VecDeque<Given>,
    capacity: usize,
}

#[derive(Clone, Copy, Debug)]
struct Given {
    at: MonotonicTime,
    velocity_rad_per_s: JointVector,
}

impl GivenCommands {
    /// Creates a buffer for `capacity` commands. When it is full, the oldest command is replaced by a standstill.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(2);
        Self { given: VecDeque::with_capacity(capacity), capacity }
    }

    /// Adds a commanded velocity (rad/s; zero: standstill). A command that is not newer than the newest replaces it.
    pub fn push(&mut self, at: MonotonicTime, velocity_rad_per_s: JointVector) {
        while self.given.back().is_some_and(|newest| newest.at >= at) {
            self.given.pop_back();
        }
        if self.given.len() == self.capacity {
            self.given.pop_front();
        }
        self.given.push_back(Given { at, velocity_rad_per_s });
    }

    /// Removes all commands: the arm is stationary.
    pub fn clear(&mut self) {
        self.given.clear();
    }

    /// Angles (rad) at which the joints come to rest if the last command ends at `now`: measured angles, plus the travel from the
    /// lagged velocity and from commands that are not yet executed.
    pub fn rest_position(&self, measured: &JointState, arm: &ArmResponse, now: MonotonicTime) -> JointVector {
        let window_s = now.seconds_since(measured.at) + arm.delay_s;
        let mut position_rad = measured.position_rad + measured.velocity_rad_per_s * arm.lag_s;
        let mut until_s = 0.0;
        for command in self.given.iter().rev() {
            let from_s = now.seconds_since(command.at);
            let duration_s = (from_s.min(window_s) - until_s).max(0.0);
            position_rad += command.velocity_rad_per_s * duration_s;
            until_s = from_s.max(until_s);
            if until_s >= window_s {
                break;
            }
        }
        position_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: ArmResponse = ArmResponse { delay_s: 0.025, lag_s: 0.04 };

    fn at(micros: u64) -> MonotonicTime {
        MonotonicTime::from_nanos(micros * 1000)
    }

    fn joints(first: f64) -> JointVector {
        JointVector::from([first, -0.5 * first, 0.0, 2.0 * first, 0.0, 0.0, -first])
    }

    /// Joints with the delay and the lag of `ARM` in steps of 10 microseconds, under commands that change every 7 ms.
    #[test]
    fn joints_come_to_rest_where_it_was_foretold() {
        let command_at = |micros: i64| {
            let number = micros.div_euclid(7000);
            if number < 0 { 0.0 } else { 0.3 + 0.2 * (number as f64 * 0.9).sin() }
        };
        let (dt_micros, delay_micros) = (10i64, 25_000i64);
        let (mut position, mut velocity) = (0.8, 0.0);
        let mut given = GivenCommands::new(64);
        let mut foretold = None;
        let (measured_at, now) = (200_000i64, 213_000i64);
        let mut micros = 0;
        while micros < 1_500_000 {
            if micros % 7000 == 0 && micros <= now {
                given.push(at(micros as u64), joints(command_at(micros)));
            }
            if micros == measured_at {
                let state = JointState {
                    at: at(micros as u64),
                    position_rad: joints(position),
                    velocity_rad_per_s: joints(velocity),
                };
                foretold = Some(state);
            }
            // From now on the command is zero.
            let executed = if micros - delay_micros < now { command_at(micros - delay_micros) } else { 0.0 };
            let dt = dt_micros as f64 * 1e-6;
            let next = executed + (velocity - executed) * (-dt / ARM.lag_s).exp();
            position += executed * dt - ARM.lag_s * (next - velocity);
            velocity = next;
            micros += dt_micros;
        }
        let foretold = given.rest_position(&foretold.unwrap(), &ARM, at(now as u64));
        assert!((foretold - joints(position)).amax() < 1e-9, "{foretold} instead of {}", joints(position));
    }

    #[test]
    fn without_commands_only_the_velocity_runs_out() {
        let measured = JointState { at: at(1000), position_rad: joints(0.2), velocity_rad_per_s: joints(0.5) };
        let given = GivenCommands::new(8);
        let rests_at = given.rest_position(&measured, &ARM, at(5000));
        assert!((rests_at - joints(0.22)).amax() < 1e-15, "{rests_at}");
    }

    #[test]
    fn the_ring_keeps_its_memory_and_a_clock_that_steps_back_leaves_the_newest() {
        let mut given = GivenCommands::new(4);
        let capacity = given.given.capacity();
        (0..100).for_each(|i| given.push(at(1000 * i), joints(0.1)));
        assert_eq!((given.given.len(), given.given.capacity()), (4, capacity));
        given.push(at(97_500), joints(0.3));
        assert_eq!(given.given.len(), 3, "the commands of 98 and 99 ms are dropped");
        given.clear();
        assert!(given.given.is_empty());
    }
}
