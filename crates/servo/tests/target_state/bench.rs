//! Motions, noise and error measures for tests of the target's state.

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use pb3dp_computing::rng::SplitMix64;
use pb3dp_geometry::frames::{Base, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose, so3};
use pb3dp_servo::{PoseMeasurement, TargetState, TargetStateConfig};

/// Normal deviates from a seed.
pub struct Noise(SplitMix64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    pub fn normal(&mut self) -> f64 {
        self.0.normal()
    }

    pub fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal())
    }

    /// Gaussian noise with this covariance.
    pub fn with_covariance(&mut self, covariance: &Matrix6<f64>) -> Vector6<f64> {
        covariance.cholesky().unwrap().l() * Vector6::from_fn(|_, _| self.normal())
    }
}

pub fn at_s(seconds: f64) -> MonotonicTime {
    MonotonicTime::from_secs_f64(seconds)
}

/// A pose that is neither near the identity nor along an axis.
pub fn askew() -> Pose<Base, Model> {
    Pose::from_parts(Vector3::new(0.7, -0.2, 0.45), UnitQuaternion::from_scaled_axis(Vector3::new(-1.3, 0.6, 1.9)))
}

pub fn model_from_hand() -> Pose<Model, Hand> {
    Pose::from_translation(Vector3::new(0.0, 0.0, -0.5))
}

/// Independent noise: lateral and depth (m), tilt and rotation about the normal (rad).
pub fn diagonal(lateral_m: f64, depth_m: f64, tilt_rad: f64, roll_rad: f64) -> Matrix6<f64> {
    let sigma = Vector6::new(lateral_m, lateral_m, depth_m, tilt_rad, tilt_rad, roll_rad);
    Matrix6::from_diagonal(&sigma.component_mul(&sigma))
}

/// Assumed accuracy of the estimator.
pub fn coarse() -> Matrix6<f64> {
    diagonal(1e-4, 3e-4, 0.1f64.to_radians(), 0.03f64.to_radians())
}

/// Accuracy of the direct tracker on the crab-like card (docs/benchmarks/accuracy.md).
pub fn fine() -> Matrix6<f64> {
    diagonal(5e-6, 1.6e-5, 0.045f64.to_radians(), 0.01f64.to_radians())
}

/// A measurement of a pose, with noise of this covariance; the measurement reports the same covariance.
pub fn measured(
    noise: &mut Noise,
    at: MonotonicTime,
    truth: &Pose<Base, Model>,
    covariance: &Matrix6<f64>,
) -> PoseMeasurement {
    let error = noise.with_covariance(covariance);
    // true = measured * exp(xi)
    PoseMeasurement { at, base_from_model: truth.perturbed_in_from(&-error), covariance: *covariance }
}

/// Motion of the target over time: translation and rotation vector from the start pose, in axes of the model at the start.
pub type Motion = dyn Fn(f64) -> (Vector3<f64>, Vector3<f64>);

pub fn pose_of(moved: (Vector3<f64>, Vector3<f64>)) -> Pose<Base, Model> {
    let (shift, turn) = moved;
    askew() * Pose::from_parts(shift, so3::exp(&turn))
}

pub const MOVE_S: f64 = 2.0;
pub const HOLD_S: f64 = 3.0;
/// Duration of the steps of Fig. 7 and of the rest before them.
pub const FIG7_S: f64 = HOLD_S + 12.0 * (MOVE_S + HOLD_S);

/// The experiment of Fig. 7: minimum-jerk moves along and about x, y, z, out and back.
pub fn fig7(t_s: f64) -> (Vector3<f64>, Vector3<f64>) {
    let since = t_s - HOLD_S;
    let event = (since / (MOVE_S + HOLD_S)).floor();
    if since < 0.0 {
        return (Vector3::zeros(), Vector3::zeros());
    }
    let u = ((since - event * (MOVE_S + HOLD_S)) / MOVE_S).min(1.0);
    let gone = u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
    let share = if (event as usize).is_multiple_of(2) { gone } else { 1.0 - gone };
    let axis = Vector3::ith((event as usize / 2) % 3, share);
    if event < 6.0 { (axis * 0.1, Vector3::zeros()) } else { (Vector3::zeros(), axis * 20f64.to_radians()) }
}

/// Whether the target of [`fig7`] moves, and whether it has rested for at least 1 s.
pub fn fig7_phase(t_s: f64) -> (bool, bool) {
    let since = t_s - HOLD_S;
    if since < 0.0 {
        return (false, t_s > 1.5);
    }
    let in_event = since.rem_euclid(MOVE_S + HOLD_S);
    (in_event < MOVE_S, in_event > MOVE_S + 1.0)
}

/// RMS errors of the desired hand, stored as sums of squares.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rms {
    position: f64,
    orientation: f64,
    count: f64,
    pub position_max_m: f64,
    /// Sums of the error along the velocity, and of the squared velocity.
    along: f64,
    speed: f64,
}

impl Rms {
    /// Adds a prediction; the target moves from `truth` to `next` within 10 ms.
    pub fn add(&mut self, found: &Pose<Base, Model>, truth: &Pose<Base, Model>, next: &Pose<Base, Model>) {
        let hand = |pose: &Pose<Base, Model>| *pose * model_from_hand();
        let (found, truth, next) = (hand(found), hand(truth), hand(next));
        let velocity = (next.translation_m() - truth.translation_m()) / 0.01;
        self.along += (truth.translation_m() - found.translation_m()).dot(&velocity);
        self.speed += velocity.norm_squared();
        let apart = (found.translation_m() - truth.translation_m()).norm();
        self.position += apart.powi(2);
        self.position_max_m = self.position_max_m.max(apart);
        self.orientation += found.rotation().angle_to(&truth.rotation()).powi(2);
        self.count += 1.0;
    }

    pub fn position_mm(&self) -> f64 {
        1e3 * (self.position / self.count).sqrt()
    }

    /// Lag of the estimated positions, seconds, by least squares.
    pub fn lag_s(&self) -> f64 {
        self.along / self.speed
    }

    pub fn orientation_deg(&self) -> f64 {
        (self.orientation / self.count).sqrt().to_degrees()
    }
}

/// Errors, in motion and in hold, of the hand predicted over a delay, at 100 Hz, from images at 30 Hz.
pub fn follow(
    config: &TargetStateConfig,
    covariance: &Matrix6<f64>,
    delay_s: f64,
    duration_s: f64,
    motion: &Motion,
    phase: &dyn Fn(f64) -> (bool, bool),
    seed: u64,
) -> (Rms, Rms) {
    let mut filter = TargetState::new(*config).unwrap();
    let mut noise = Noise::new(seed);
    let (mut moving, mut still) = (Rms::default(), Rms::default());
    let mut frame = 0;
    for cycle in 0..(duration_s * 100.0) as usize {
        let now_s = cycle as f64 / 100.0;
        while f64::from(frame) / 30.0 + delay_s <= now_s {
            let exposed_s = f64::from(frame) / 30.0;
            let mut measurement = measured(&mut noise, at_s(exposed_s), &pose_of(motion(exposed_s)), covariance);
            // The tracker reports too small a covariance; `covariance_factor` corrects it.
            measurement.covariance /= config.measurement.covariance_factor;
            filter.observe(&measurement);
            frame += 1;
        }
        let Ok(prediction) = filter.at(at_s(now_s)) else { continue };
        let (moves, rests) = phase(now_s);
        let (truth, next) = (pose_of(motion(now_s)), pose_of(motion(now_s + 0.01)));
        if moves {
            moving.add(&prediction.base_from_model, &truth, &next);
        } else if rests {
            still.add(&prediction.base_from_model, &truth, &next);
        }
    }
    (moving, still)
}
