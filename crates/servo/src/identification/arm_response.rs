//! Response of an arm to a commanded velocity: a dead time and a first-order lag.

use nalgebra::{Matrix2, Vector2};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{DOF, JointState, JointVector};

use super::{BATCHES, Interval, NotIdentified, batch_of};

const WHAT: &str = "the time from command to motion";

/// A commanded velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenVelocity {
    /// Start time; valid until the next command.
    pub at: MonotonicTime,
    /// Joint velocities, rad/s.
    pub velocity_rad_per_s: JointVector,
}

/// Identified response of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmResponseEstimate {
    /// Dead time, seconds.
    pub delay: Interval,
    /// Time constant of the first-order lag after it, seconds.
    pub lag: Interval,
    /// Sum of both, seconds; more accurate than either.
    pub total: Interval,
    /// Root mean square of the joint-angle residuals, rad.
    pub residual_rms_rad: f64,
}

/// Search range of dead time and of lag, seconds.
const DELAY_MAX_S: f64 = 0.3;
const LAG_MAX_S: f64 = 0.3;
/// Coarse grid of the search.
const DELAYS: usize = 31;
const LAGS_S: [f64; 7] = [0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 0.3];
/// Minimum number of joint samples.
const SAMPLES_MIN: usize = 50 * BATCHES;
/// A record in which no joint moves by more than this is rejected, rad.
const MOTION_MIN_RAD: f64 = 1e-3;
/// Step of the derivatives, number of steps of the fine search, and its tolerance, seconds.
const DIFFERENCE_S: f64 = 1e-4;
const STEPS_MAX: usize = 30;
const ARRIVED_S: f64 = 1e-7;

/// Identifies dead time and lag from commanded velocities (`given`) and measured joints (`joints`), both ordered by time, by least
/// squares over the angles of all joints. Before the first velocity the arm is stationary.
///
/// Everything between the caller and the arm, such as a limiter, is part of the result.
///
/// # Errors
/// If the record is too short, nothing moved, or a time is longer than 0.3 s.
pub fn arm_response(given: &[GivenVelocity], joints: &[JointState]) -> Result<ArmResponseEstimate, NotIdentified> {
    let record = Record::new(given, joints)?;
    let (mut best, mut least) = (Vector2::zeros(), f64::INFINITY);
    for index in 0..DELAYS {
        for lag_s in LAGS_S {
            let guess = Vector2::new(DELAY_MAX_S * index as f64 / (DELAYS - 1) as f64, lag_s);
            let sum = record.residuals(&guess).iter().map(|row| row.norm_squared()).sum::<f64>();
            if sum < least {
                (best, least) = (guess, sum);
            }
        }
    }
    for _ in 0..STEPS_MAX {
        check_range(&best)?;
        let step = record.linearised(&best).step(|_| true).ok_or(NotIdentified::NotExcited { what: WHAT })?;
        let next = (best + step).map(|value| value.max(0.0));
        let moved = (next - best).amax();
        best = next;
        if moved < ARRIVED_S {
            break;
        }
    }
    check_range(&best)?;
    record.with_intervals(&best)
}

fn check_range(delay_and_lag_s: &Vector2<f64>) -> Result<(), NotIdentified> {
    for (value_s, most_s) in [(delay_and_lag_s.x, DELAY_MAX_S), (delay_and_lag_s.y, LAG_MAX_S)] {
        if value_s >= most_s {
            return Err(NotIdentified::TooLong { what: WHAT, value_s, most_s });
        }
    }
    Ok(())
}

/// Commanded velocities and measured joints, in seconds since the first velocity.
struct Record {
    given: Vec<(f64, JointVector)>,
    joints: Vec<(f64, JointVector)>,
}

/// Residuals of the angles and their derivatives by delay and lag; [`Self::step`] sums them and removes the offsets.
struct Linearised {
    at_s: Vec<f64>,
    residuals: Vec<JointVector>,
    by_delay: Vec<JointVector>,
    by_lag: Vec<JointVector>,
}

impl Record {
    fn new(given: &[GivenVelocity], joints: &[JointState]) -> Result<Self, NotIdentified> {
        let begin = given.first().ok_or(NotIdentified::TooFew { what: "velocities", count: 0, needed: 2 })?.at;
        let since = |at: MonotonicTime| at.seconds_since(begin);
        let given: Vec<_> = given.iter().map(|one| (since(one.at), one.velocity_rad_per_s)).collect();
        let joints: Vec<_> =
            joints.iter().map(|one| (since(one.at), one.position_rad)).filter(|one| one.0 >= 0.0).collect();
        if joints.len() < SAMPLES_MIN {
            return Err(NotIdentified::TooFew { what: "joint samples", count: joints.len(), needed: SAMPLES_MIN });
        }
        let first = joints[0].1;
        if joints.iter().all(|(_, position)| (position - first).amax() < MOTION_MIN_RAD) {
            return Err(NotIdentified::NotExcited { what: WHAT });
        }
        Ok(Self { given, joints })
    }

    /// Predicted joint motion from the first velocity to the time of each sample, for this dead time and lag.
    fn predicted(&self, delay_and_lag_s: &Vector2<f64>) -> Vec<JointVector> {
        let (delay_s, lag_s) = (delay_and_lag_s.x, delay_and_lag_s.y);
        let mut state = Motion { at_s: 0.0, way_rad: JointVector::zeros(), velocity: JointVector::zeros() };
        let mut target = JointVector::zeros();
        let mut next = 0;
        let mut ways = Vec::with_capacity(self.joints.len());
        for (at_s, _) in &self.joints {
            while let Some((given_s, velocity)) = self.given.get(next).filter(|(given_s, _)| given_s + delay_s <= *at_s)
            {
                state = state.after(given_s + delay_s, &target, lag_s);
                target = *velocity;
                next += 1;
            }
            state = state.after(*at_s, &target, lag_s);
            ways.push(state.way_rad);
        }
        ways
    }

    fn residuals(&self, delay_and_lag_s: &Vector2<f64>) -> Vec<JointVector> {
        let predicted = self.predicted(delay_and_lag_s);
        let residuals: Vec<_> = self.joints.iter().zip(predicted).map(|((_, measured), way)| measured - way).collect();
        let mean = residuals.iter().sum::<JointVector>() / residuals.len() as f64;
        residuals.into_iter().map(|residual| residual - mean).collect()
    }

    fn linearised(&self, delay_and_lag_s: &Vector2<f64>) -> Linearised {
        let residuals = self.residuals(delay_and_lag_s);
        // One-sided: neither time may be negative.
        let derivative = |by: Vector2<f64>| -> Vec<JointVector> {
            let beside = self.residuals(&(delay_and_lag_s + by * DIFFERENCE_S));
            beside.iter().zip(&residuals).map(|(beside, here)| (beside - here) / DIFFERENCE_S).collect()
        };
        let (by_delay, by_lag) = (derivative(Vector2::x()), derivative(Vector2::y()));
        Linearised { at_s: self.joints.iter().map(|(at_s, _)| *at_s).collect(), residuals, by_delay, by_lag }
    }

    /// Spread of the results of the pieces.
    fn with_intervals(&self, best: &Vector2<f64>) -> Result<ArmResponseEstimate, NotIdentified> {
        let linearised = self.linearised(best);
        let span_s = (self.joints[0].0, self.joints[self.joints.len() - 1].0);
        let (mut delays, mut lags, mut totals) = ([0.0; BATCHES], [0.0; BATCHES], [0.0; BATCHES]);
        for index in 0..BATCHES {
            let step = linearised
                .step(|at_s| batch_of(at_s, span_s) == index)
                .ok_or(NotIdentified::NotExcited { what: WHAT })?;
            let of_batch = best + step;
            (delays[index], lags[index], totals[index]) = (of_batch.x, of_batch.y, of_batch.sum());
        }
        let numbers = (DOF * linearised.residuals.len()) as f64;
        let sum = linearised.residuals.iter().map(|row| row.norm_squared()).sum::<f64>();
        Ok(ArmResponseEstimate {
            delay: Interval::of_batches(best.x, &delays),
            lag: Interval::of_batches(best.y, &lags),
            total: Interval::of_batches(best.sum(), &totals),
            residual_rms_rad: (sum / numbers).sqrt(),
        })
    }
}

impl Linearised {
    /// Least-squares step of delay and lag over the samples at these times, with one offset per joint.
    fn step(&self, is_meant: impl Fn(f64) -> bool) -> Option<Vector2<f64>> {
        let meant: Vec<usize> = (0..self.at_s.len()).filter(|index| is_meant(self.at_s[*index])).collect();
        let mean =
            |of: &[JointVector]| meant.iter().map(|index| of[*index]).sum::<JointVector>() / meant.len().max(1) as f64;
        let (residual, delay, lag) = (mean(&self.residuals), mean(&self.by_delay), mean(&self.by_lag));
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for index in meant {
            let rows = (self.residuals[index] - residual, self.by_delay[index] - delay, self.by_lag[index] - lag);
            for joint in 0..DOF {
                let row = Vector2::new(rows.1[joint], rows.2[joint]);
                normal += row * row.transpose();
                right -= row * rows.0[joint];
            }
        }
        normal.cholesky().map(|factor| factor.solve(&right)).filter(|step| step.iter().all(|value| value.is_finite()))
    }
}

/// Joints under a constant velocity, in closed form.
#[derive(Clone, Copy)]
struct Motion {
    at_s: f64,
    way_rad: JointVector,
    velocity: JointVector,
}

impl Motion {
    fn after(self, at_s: f64, target: &JointVector, lag_s: f64) -> Self {
        let dt_s = at_s - self.at_s;
        let decay = if lag_s > 0.0 { (-dt_s / lag_s).exp() } else { 0.0 };
        let behind = self.velocity - target;
        Self {
            at_s,
            way_rad: self.way_rad + target * dt_s + behind * (lag_s * (1.0 - decay)),
            velocity: target + behind * decay,
        }
    }
}
