//! A target that a person pushes about while the simulation runs.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::{UnitQuaternion, Vector3, Vector4};
use pb3dp_geometry::frames::{Target, World};
use pb3dp_geometry::{Pose, Twist};

use crate::trajectory::{Mark, Trajectory};

/// Largest offset from the start along each axis, metres, and largest turn, radians: the hand can follow the target there.
pub const OFFSET_MAX_M: f64 = 0.12;
/// See [`OFFSET_MAX_M`].
pub const TURN_MAX_RAD: f64 = 0.35;

/// Rate at which the target approaches the place to which it is pushed, 1/s: it arrives within half a second. At double the hand lags
/// visibly; at half the target seems to be tied to a rubber band.
const RATE_PER_S: f64 = 8.0;
/// Largest speed of the target in each component, m/s and rad/s; the hand follows up to 0.25 m/s.
const SPEED_MAX: Vector4<f64> = Vector4::new(0.2, 0.2, 0.2, 0.6);
/// Duration that reports state, seconds; the motion itself has no end.
const DURATION_S: f64 = 3600.0;
/// Interval of the stored motion, seconds.
const TICK_S: f64 = 0.005;
/// Number of stored intervals: two seconds, longer than any image is old.
const KEPT: usize = 400;

/// A target at rest until [`Self::push`]. Clones share the motion.
#[derive(Clone, Debug)]
pub struct PushedTarget {
    world_from_start: Pose<World, Target>,
    motion: Arc<Mutex<Motion>>,
}

/// Offset along the axes of the target at its start, metres, and turn about its z axis, radians.
#[derive(Clone, Copy, Debug)]
struct Sample {
    offset: Vector4<f64>,
    rate: Vector4<f64>,
}

#[derive(Debug)]
struct Motion {
    wanted: Vector4<f64>,
    /// Number of the newest sample; sample `n` is at `n * TICK_S`.
    newest: u64,
    samples: VecDeque<Sample>,
}

impl PushedTarget {
    /// A target that rests at this pose.
    pub fn new(world_from_start: Pose<World, Target>) -> Self {
        let at_rest = Sample { offset: Vector4::zeros(), rate: Vector4::zeros() };
        let motion = Motion { wanted: Vector4::zeros(), newest: 0, samples: VecDeque::from([at_rest]) };
        Self { world_from_start, motion: Arc::new(Mutex::new(motion)) }
    }

    /// Pushes the target to an offset from its start: metres along its axes there, and radians about its z axis. Components beyond the
    /// limits are reduced to them; an offset that is not finite changes nothing.
    pub fn push(&self, offset_m: Vector3<f64>, turn_rad: f64) {
        let most = Vector4::new(OFFSET_MAX_M, OFFSET_MAX_M, OFFSET_MAX_M, TURN_MAX_RAD);
        let wanted = Vector4::new(offset_m.x, offset_m.y, offset_m.z, turn_rad);
        if wanted.iter().all(|component| component.is_finite()) {
            self.motion().wanted = wanted.sup(&-most).inf(&most);
        }
    }

    fn motion(&self) -> MutexGuard<'_, Motion> {
        self.motion.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Motion {
    /// Offset and its rate, `t_s` seconds after the start.
    fn at(&mut self, t_s: f64) -> Sample {
        let ticks = (t_s.max(0.0) / TICK_S).min(1e12);
        let (before, share) = (ticks.floor() as u64, ticks.fract());
        while self.newest < before + 1 {
            self.advance();
        }
        let sample = |number: u64| {
            let back = usize::try_from(self.newest - number).unwrap_or(usize::MAX);
            self.samples[self.samples.len().saturating_sub(1).saturating_sub(back)]
        };
        let (one, two) = (sample(before), sample(before + 1));
        Sample { offset: one.offset.lerp(&two.offset, share), rate: one.rate.lerp(&two.rate, share) }
    }

    /// One interval of a critically damped motion with limited speed.
    fn advance(&mut self) {
        let Sample { offset, rate } =
            self.samples.back().copied().unwrap_or(Sample { offset: Vector4::zeros(), rate: Vector4::zeros() });
        let acceleration = (self.wanted - offset) * (RATE_PER_S * RATE_PER_S) - rate * (2.0 * RATE_PER_S);
        let rate = (rate + acceleration * TICK_S).sup(&-SPEED_MAX).inf(&SPEED_MAX);
        self.samples.push_back(Sample { offset: offset + rate * TICK_S, rate });
        self.newest += 1;
        if self.samples.len() > KEPT {
            self.samples.pop_front();
        }
    }
}

impl Trajectory for PushedTarget {
    fn pose_at(&self, t_s: f64) -> Pose<World, Target> {
        let Sample { offset, .. } = self.motion().at(t_s);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), offset.w);
        self.world_from_start * Pose::<Target, Target>::from_parts(offset.xyz(), turn)
    }

    fn twist_at(&self, t_s: f64) -> Twist<World> {
        let Sample { rate, .. } = self.motion().at(t_s);
        Twist::new(
            self.world_from_start.transform_vector(&rate.xyz()),
            self.world_from_start.transform_vector(&(Vector3::z() * rate.w)),
        )
    }

    fn marks(&self) -> &[Mark] {
        &[]
    }

    fn duration_s(&self) -> f64 {
        DURATION_S
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(one: Vector3<f64>, other: Vector3<f64>, within: f64) {
        assert!((one - other).norm() <= within, "{one} and {other}");
    }

    fn tilted() -> Pose<World, Target> {
        Pose::from_parts(Vector3::new(0.7, -0.2, 0.9), UnitQuaternion::from_euler_angles(0.3, -0.2, 0.8))
    }

    #[test]
    fn it_rests_until_it_is_pushed_and_arrives_where_it_was_pushed_to() {
        let target = PushedTarget::new(tilted());
        assert_eq!(target.pose_at(3.0).translation_m(), tilted().translation_m());
        target.push(Vector3::new(0.05, -0.02, 0.01), 0.2);
        let there = tilted().inverse() * target.pose_at(6.0);
        assert_near(there.translation_m(), Vector3::new(0.05, -0.02, 0.01), 1e-5);
        assert!((there.rotation().angle() - 0.2).abs() < 1e-5);
    }

    #[test]
    fn a_pose_of_the_past_stays_what_it_was_and_none_jumps() {
        let target = PushedTarget::new(tilted());
        target.push(Vector3::new(0.1, 0.0, 0.0), 0.0);
        let early = target.pose_at(0.3);
        target.push(Vector3::new(-0.1, 0.0, 0.0), 0.0);
        let mut before = early;
        for step in 1..200_u32 {
            let t_s = 0.3 + f64::from(step) * 0.004;
            let pose = target.pose_at(t_s);
            let way_m = (pose.translation_m() - before.translation_m()).norm();
            assert!(way_m <= 0.2 * 0.004 + 1e-12, "{way_m} m in 4 ms at {t_s} s");
            before = pose;
        }
        assert_eq!(target.pose_at(0.3).translation_m(), early.translation_m());
        // The rate is the derivative of the pose.
        let (one, two) = (target.pose_at(0.5), target.pose_at(0.502));
        let speed = (two.translation_m() - one.translation_m()) / 0.002;
        assert_near(speed, target.twist_at(0.501).linear_m_per_s, 0.02);
    }

    #[test]
    fn a_push_beyond_the_limits_is_reduced_and_one_that_is_not_finite_is_ignored() {
        let target = PushedTarget::new(tilted());
        target.push(Vector3::new(9.0, 0.0, -9.0), -9.0);
        target.push(Vector3::new(f64::NAN, 0.0, 0.0), 0.0);
        let there = tilted().inverse() * target.pose_at(9.0);
        assert_near(there.translation_m(), Vector3::new(OFFSET_MAX_M, 0.0, -OFFSET_MAX_M), 1e-9);
        assert!((there.rotation().angle() - TURN_MAX_RAD).abs() < 1e-9);
    }
}
