//! Motion models along or about one axis: Singer model, rest, and the transitions between them.

use nalgebra::{Matrix3, Vector3};

use super::config::{MotionConfig, RestConfig};

/// Mode of a part of the target, linear or angular.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// Acceleration is correlated over time: the Singer model.
    Motion,
    /// No velocity; the position drifts a little.
    Rest,
}

/// One time step of `[position, velocity, acceleration]` along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AxisStep {
    /// The state after the step without noise.
    pub transition: Matrix3<f64>,
    /// Covariance of the noise of the step.
    pub noise: Matrix3<f64>,
    /// Share of that noise across the direction of motion.
    pub across_share: f64,
}

impl AxisStep {
    /// The step of a part in a mode. A part without a rest model is always in motion.
    pub(super) fn new(config: &MotionConfig, mode: Mode, dt_s: f64) -> Self {
        match (mode, &config.rest) {
            (Mode::Rest, Some(rest)) => Self::rest(config, rest, dt_s),
            _ => {
                let step = Self::singer(config.acceleration_sigma_per_s2, config.correlation_time_s, dt_s);
                Self { across_share: config.across_share, ..step }
            }
        }
    }

    /// Singer's model: the acceleration is a first-order Markov process (Ornstein-Uhlenbeck) with a standard deviation and a
    /// correlation time (R. A. Singer, "Estimating Optimal Tracking Filter Performance for Manned Maneuvering Targets", IEEE
    /// Trans. AES 6(4), 1970). Exact for any step.
    pub(super) fn singer(sigma: f64, time_s: f64, dt_s: f64) -> Self {
        let noise =
            if dt_s > time_s { singer_noise_closed(time_s, dt_s) } else { singer_noise_quadrature(time_s, dt_s) };
        Self { transition: singer_transition(time_s, dt_s), noise: noise * (sigma * sigma), across_share: 1.0 }
    }

    /// The transition matrix of the step of a part in a mode.
    pub(super) fn transition_of(config: &MotionConfig, mode: Mode, dt_s: f64) -> Matrix3<f64> {
        match (mode, &config.rest) {
            (Mode::Rest, Some(_)) => rest_transition(),
            _ => singer_transition(config.correlation_time_s, dt_s),
        }
    }

    /// Rest: the position is a random walk, velocity and acceleration have no effect. They are drawn again at each step with the
    /// standard deviations of an onset of motion, so that the motion mode can start from them.
    fn rest(config: &MotionConfig, rest: &RestConfig, dt_s: f64) -> Self {
        let sigma = Vector3::new(
            rest.drift_sigma_per_sqrt_s * dt_s.sqrt(),
            rest.onset_velocity_sigma_per_s,
            config.acceleration_sigma_per_s2,
        );
        Self {
            transition: rest_transition(),
            noise: Matrix3::from_diagonal(&sigma.component_mul(&sigma)),
            across_share: 1.0,
        }
    }
}

fn singer_transition(time_s: f64, dt_s: f64) -> Matrix3<f64> {
    let response = impulse_response(time_s, dt_s);
    let velocity = time_s * -(-dt_s / time_s).exp_m1();
    #[rustfmt::skip]
    let transition = Matrix3::new(
        1.0, dt_s, response.x,
        0.0, 1.0, velocity,
        0.0, 0.0, response.z,
    );
    transition
}

fn rest_transition() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.0, 0.0, 0.0))
}

/// Probability that a part in mode `from` is in mode `to` after `dt_s`: a two-state Markov chain in continuous time.
pub(super) fn switching(rest: &RestConfig, from: Mode, to: Mode, dt_s: f64) -> f64 {
    let (leave_rest, leave_motion) = (1.0 / rest.mean_rest_s, 1.0 / rest.mean_motion_s);
    let forgotten = -(-(leave_rest + leave_motion) * dt_s).exp_m1();
    let rests = leave_motion / (leave_rest + leave_motion);
    let to_other = match from {
        Mode::Rest => (1.0 - rests) * forgotten,
        Mode::Motion => rests * forgotten,
    };
    if from == to { 1.0 - to_other } else { to_other }
}

/// Stationary probability of a mode.
pub(super) fn usual(rest: &RestConfig, mode: Mode) -> f64 {
    let rests = rest.mean_rest_s / (rest.mean_rest_s + rest.mean_motion_s);
    match mode {
        Mode::Rest => rests,
        Mode::Motion => 1.0 - rests,
    }
}

/// `[position, velocity, acceleration]` at a time after an acceleration of 1 that decays with the correlation time.
fn impulse_response(time_s: f64, dt_s: f64) -> Vector3<f64> {
    let fade = (-dt_s / time_s).exp_m1();
    Vector3::new(time_s * time_s * (fade + dt_s / time_s), -time_s * fade, 1.0 + fade)
}

/// Noise of a step for a standard deviation of 1: `2 / time_s` times the integral of the response's outer product.
///
/// Gauss-Legendre quadrature with five nodes: for steps up to the correlation time its relative error is below 1e-8. A sum of outer
/// products has no negative eigenvalue, while Singer's closed form loses all digits of the position.
fn singer_noise_quadrature(time_s: f64, dt_s: f64) -> Matrix3<f64> {
    const NODES: [(f64, f64); 5] = [
        (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
        (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.0, 0.568_888_888_888_888_9),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.906_179_845_938_664, 0.236_926_885_056_189_1),
    ];
    NODES.iter().fold(Matrix3::zeros(), |sum, (node, weight)| {
        let response = impulse_response(time_s, 0.5 * dt_s * (1.0 + node));
        sum + response * response.transpose() * (weight * dt_s / time_s)
    })
}

/// The same in closed form (Singer 1970, appendix), for steps longer than the correlation time.
fn singer_noise_closed(time_s: f64, dt_s: f64) -> Matrix3<f64> {
    let x = dt_s / time_s;
    let (e, ee) = ((-x).exp(), (-2.0 * x).exp());
    let pp = 1.0 - ee + 2.0 * x + 2.0 * x * x * x / 3.0 - 2.0 * x * x - 4.0 * x * e;
    let pv = ee + 1.0 - 2.0 * e + 2.0 * x * e - 2.0 * x + x * x;
    let pa = 1.0 - ee - 2.0 * x * e;
    let vv = 4.0 * e - 3.0 - ee + 2.0 * x;
    let va = ee + 1.0 - 2.0 * e;
    let aa = 1.0 - ee;
    let scale = Vector3::new(time_s * time_s, time_s, 1.0);
    Matrix3::new(pp, pv, pa, pv, vv, va, pa, va, aa).component_mul(&(scale * scale.transpose()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integrates `dx = F x`, `dP = F P + P F' + Q` with small steps (Runge-Kutta 4).
    fn integrated(sigma: f64, time_s: f64, dt_s: f64) -> AxisStep {
        let drift = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0 / time_s);
        let power = Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, 2.0 * sigma * sigma / time_s));
        let slope_t = |m: &Matrix3<f64>| drift * m;
        let slope_p = |p: &Matrix3<f64>| drift * p + p * drift.transpose() + power;
        let (mut transition, mut noise) = (Matrix3::identity(), Matrix3::zeros());
        let steps = 4000;
        let h = dt_s / f64::from(steps);
        let rk4 = |m: &Matrix3<f64>, slope: &dyn Fn(&Matrix3<f64>) -> Matrix3<f64>| {
            let k1 = slope(m);
            let k2 = slope(&(m + k1 * (0.5 * h)));
            let k3 = slope(&(m + k2 * (0.5 * h)));
            let k4 = slope(&(m + k3 * h));
            m + (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0)
        };
        for _ in 0..steps {
            transition = rk4(&transition, &slope_t);
            noise = rk4(&noise, &slope_p);
        }
        AxisStep { transition, noise, across_share: 1.0 }
    }

    #[test]
    fn a_step_of_singers_model_is_the_integral_of_its_differential_equation() {
        for (sigma, time_s, dt_s) in [(0.3, 0.7, 0.033), (0.3, 0.7, 0.69), (2.0, 0.2, 0.21), (0.1, 0.5, 2.0)] {
            let step = AxisStep::singer(sigma, time_s, dt_s);
            let golden = integrated(sigma, time_s, dt_s);
            assert!((step.transition - golden.transition).amax() < 1e-10, "{step:?} {golden:?}");
            for (found, expected) in step.noise.iter().zip(golden.noise.iter()) {
                assert!((found / expected - 1.0).abs() < 1e-8, "{time_s} {dt_s}: {found} instead of {expected}");
            }
        }
    }

    #[test]
    fn the_two_forms_of_the_noise_meet() {
        let (quadrature, closed) = (singer_noise_quadrature(0.4, 0.4), singer_noise_closed(0.4, 0.4));
        for (a, b) in quadrature.iter().zip(closed.iter()) {
            assert!((a / b - 1.0).abs() < 1e-8, "{quadrature} {closed}");
        }
    }

    #[test]
    fn the_noise_of_tiny_steps_keeps_its_leading_terms() {
        // For steps much shorter than the correlation time: white jerk of power 2 sigma^2 / time.
        let (sigma, time_s, h) = (0.5f64, 10.0, 1e-4f64);
        let noise = AxisStep::singer(sigma, time_s, h).noise;
        let power = 2.0 * sigma * sigma / time_s;
        let white = Matrix3::new(
            h.powi(5) / 20.0,
            h.powi(4) / 8.0,
            h.powi(3) / 6.0,
            h.powi(4) / 8.0,
            h.powi(3) / 3.0,
            h * h / 2.0,
            h.powi(3) / 6.0,
            h * h / 2.0,
            h,
        ) * power;
        for (found, expected) in noise.iter().zip(white.iter()) {
            assert!((found / expected - 1.0).abs() < 1e-4, "{noise} {white}");
        }
        assert!(noise.determinant() > 0.0);
    }

    #[test]
    fn modes_change_as_a_markov_chain_in_continuous_time() {
        let rest = RestConfig {
            drift_sigma_per_sqrt_s: 1e-4,
            onset_velocity_sigma_per_s: 1e-3,
            mean_rest_s: 3.0,
            mean_motion_s: 0.8,
        };
        // After a short step: the transition rate. Two steps equal one. After a long step: the stationary probability.
        assert!((switching(&rest, Mode::Rest, Mode::Motion, 1e-6) / (1e-6 / 3.0) - 1.0).abs() < 1e-5);
        assert!((switching(&rest, Mode::Motion, Mode::Rest, 1e-6) / (1e-6 / 0.8) - 1.0).abs() < 1e-5);
        let through = |via| switching(&rest, Mode::Rest, via, 0.1) * switching(&rest, via, Mode::Motion, 0.25);
        let once = switching(&rest, Mode::Rest, Mode::Motion, 0.35);
        assert!((through(Mode::Rest) + through(Mode::Motion) - once).abs() < 1e-15);
        for from in [Mode::Rest, Mode::Motion] {
            assert!((switching(&rest, from, Mode::Motion, 100.0) - 0.8 / 3.8).abs() < 1e-12);
        }
        assert!((usual(&rest, Mode::Motion) - 0.8 / 3.8).abs() < 1e-12);
    }
}
