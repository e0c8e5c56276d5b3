//! The limiter before an arm that answers late and goes on with its last command: whichever command is the last one, each joint stays in
//! its range.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmInfo, Clock, JointCommand, JointState};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_middleware::{Limiter, LimiterConfig, StartPose};
use pb3dp_kinematics::{DOF, JointVector};

use crate::common::{CYCLE, acceleration, limits, operating_range_rad, velocity};

/// The motion is sampled in steps of this length, seconds.
const STEP_S: f64 = 1e-3;

/// An arm whose drives follow each command exactly, after a delay.
struct Late {
    info: ArmInfo,
    clock: Arc<VirtualClock>,
    delay: Duration,
    /// Commands with the times at which they take effect.
    commands: Vec<(MonotonicTime, JointVector)>,
    position_rad: JointVector,
    /// Time of the position.
    at: MonotonicTime,
}

impl Late {
    /// Moves on until `to`, piece by piece.
    fn advance(&mut self, to: MonotonicTime) {
        let ends: Vec<_> = self.commands.iter().map(|(from, _)| *from).chain([to]).collect();
        for end in ends.into_iter().filter(|end| *end <= to) {
            if end > self.at {
                self.position_rad += self.velocity_at(self.at) * end.seconds_since(self.at);
                self.at = end;
            }
        }
    }

    fn velocity_at(&self, at: MonotonicTime) -> JointVector {
        let in_force = self.commands.iter().rev().find(|(from, _)| *from <= at);
        in_force.map_or_else(JointVector::zeros, |(_, velocity)| *velocity)
    }

    /// The farthest position of a joint if no further command comes: the arm goes on with the last one for `timeout`, and then brakes by
    /// itself.
    fn farthest_rad(&self, joint: usize, timeout: Duration) -> f64 {
        let end = self.commands.last().map_or(self.at, |(from, _)| *from) + timeout;
        let (mut at, mut position_rad) = (self.at, self.position_rad[joint]);
        let mut farthest_rad = position_rad;
        while at < end {
            position_rad += self.velocity_at(at)[joint] * STEP_S;
            farthest_rad = farthest_rad.max(position_rad);
            at = at + Duration::from_secs_f64(STEP_S);
        }
        // The ramp of a driver has no limit of jerk.
        let last = self.velocity_at(end)[joint].max(0.0);
        let braking_rad = last * last / (2.0 * acceleration()[joint]);
        farthest_rad.max(position_rad + braking_rad)
    }
}

impl Arm for Late {
    fn info(&self) -> &ArmInfo {
        &self.info
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let now = self.clock.now();
        self.advance(now);
        let velocity = match command {
            JointCommand::Velocity(velocity) => velocity,
            JointCommand::Hold => JointVector::zeros(),
        };
        self.commands.push((now + self.delay, velocity));
        Ok(JointState { at: now, position_rad: self.position_rad, velocity_rad_per_s: self.velocity_at(now) })
    }
}

/// Drives a joint towards the end of its range; returns the smallest distance from that end, over all commands that might be the last one.
fn room_rad(joint: usize, delay: Duration, command_timeout: Duration) -> f64 {
    let clock = Arc::new(VirtualClock::new());
    let end_rad = operating_range_rad()[joint];
    let mut position_rad = JointVector::zeros();
    position_rad[joint] = end_rad - 2.0;
    let info = ArmInfo { name: "late".to_owned(), cycle: CYCLE };
    let (at, commands) = (clock.now(), Vec::new());
    let arm = Late { info, clock: Arc::clone(&clock), delay, commands, position_rad, at };
    let config = LimiterConfig {
        reaction_time: CYCLE + delay,
        command_timeout,
        fade: None,
        stale_after: Duration::from_millis(50),
        start: StartPose::Anywhere,
    };
    let mut limiter = Limiter::new(arm, limits(1.0), config, Arc::clone(&clock) as Arc<dyn Clock>).unwrap();
    limiter.exchange(JointCommand::Hold).unwrap();
    let mut least_rad = f64::INFINITY;
    for _ in 0..1500 {
        clock.sleep_until(clock.now() + CYCLE);
        limiter.exchange(velocity(joint, 10.0)).unwrap();
        least_rad = least_rad.min(end_rad - limiter.arm().farthest_rad(joint, command_timeout));
    }
    least_rad
}

#[test]
fn whichever_command_is_the_last_one_the_joint_stays_in_its_range() {
    for (delay_ms, timeout_ms) in [(30, 50), (30, 200), (100, 200), (200, 200), (200, 1000)] {
        for joint in 0..DOF {
            let room_rad = room_rad(joint, Duration::from_millis(delay_ms), Duration::from_millis(timeout_ms));
            println!("delay {delay_ms} ms, time-out {timeout_ms} ms, axis {}: {:.2} mrad", joint + 1, 1e3 * room_rad);
            assert!(
                room_rad > -1e-6,
                "delay {delay_ms} ms, time-out {timeout_ms} ms, axis {}: {room_rad} rad",
                joint + 1
            );
        }
    }
}
