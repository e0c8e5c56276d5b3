//! All hypotheses about the target, mixed: rest or motion of the linear and of the angular part.
//!
//! The interacting multiple model filter (H. A. P. Blom, Y. Bar-Shalom, "The Interacting Multiple Model Algorithm for Systems
//! with Markovian Switching Coefficients", IEEE Trans. Automatic Control 33(8), 1988) with error states on SE(3).

use nalgebra::Matrix6;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Model};

use super::config::{MotionConfig, TargetStateConfig};
use super::gaussian::{ERRORS, ErrorMatrix, ErrorVector, Gaussian, Innovation, State};
use super::measurement::BaseMeasurement;
use super::motion::{AxisStep, Mode, switching, usual};

/// Two modes of two parts.
const HYPOTHESES_MAX: usize = 4;
/// Degrees of freedom of a measured pose.
const DEGREES_OF_FREEDOM: f64 = 6.0;
/// Less probable hypotheses are left out of predictions.
const NEGLIGIBLE: f64 = 1e-3;

/// One pair of modes with its probability and its state.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hypothesis {
    linear: Mode,
    angular: Mode,
    probability: f64,
    gaussian: Gaussian,
}

/// All hypotheses at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bank {
    hypotheses: [Hypothesis; HYPOTHESES_MAX],
    count: usize,
    /// Smoothed squared Mahalanobis distances of the measurements per degree of freedom: about 1 while the target moves as
    /// modelled.
    surprise: f64,
}

/// What happened to a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Correction {
    /// Used in the state.
    Accepted { nis: f64 },
    /// Outside the gate of every hypothesis.
    Outlier { nis: f64 },
    /// A covariance is not positive definite, or a number is not finite: the measurement is not used.
    Failed,
}

/// The mixture of all hypotheses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mixture {
    pub state: State,
    /// Of position and rotation vector, axes of `base`.
    pub covariance: Matrix6<f64>,
    /// Probability that the linear part is in motion.
    pub linear_motion: f64,
    /// Probability that the angular part is in motion.
    pub angular_motion: f64,
}

impl Bank {
    /// Starts from a first measurement.
    pub(super) fn begin(config: &TargetStateConfig, measured: &BaseMeasurement) -> Self {
        let state = State {
            base_from_model: measured.base_from_model,
            rate: nalgebra::Vector6::zeros(),
            acceleration: nalgebra::Vector6::zeros(),
        };
        let mut covariance = ErrorMatrix::zeros();
        covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&measured.covariance);
        for (part, first) in [(&config.linear, 6), (&config.angular, 9)] {
            for i in first..first + 3 {
                covariance[(i, i)] = part.start_velocity_sigma_per_s.powi(2);
                covariance[(i + 6, i + 6)] = part.acceleration_sigma_per_s2.powi(2);
            }
        }
        let gaussian = Gaussian { state, covariance };
        let unused = Hypothesis { linear: Mode::Motion, angular: Mode::Motion, probability: 0.0, gaussian };
        let mut bank = Self { hypotheses: [unused; HYPOTHESES_MAX], count: 0, surprise: 1.0 };
        for &linear in modes(&config.linear) {
            for &angular in modes(&config.angular) {
                let probability = share(&config.linear, linear) * share(&config.angular, angular);
                bank.hypotheses[bank.count] = Hypothesis { linear, angular, probability, gaussian };
                bank.count += 1;
            }
        }
        bank
    }

    /// Prediction: the modes may change, then each hypothesis is propagated with its mode.
    pub(super) fn predicted(&self, config: &TargetStateConfig, dt_s: f64) -> Self {
        let old = self.hypotheses();
        let steps = Steps::new(config, self.surprise, dt_s);
        let mut next = *self;
        for to in &mut next.hypotheses[..self.count] {
            let mut weights = [0.0; HYPOTHESES_MAX];
            for (weight, from) in weights.iter_mut().zip(old) {
                *weight = from.probability
                    * change(&config.linear, from.linear, to.linear, dt_s)
                    * change(&config.angular, from.angular, to.angular, dt_s);
            }
            to.probability = weights.iter().sum();
            let mixed = mixed(old, &weights, to.probability);
            to.gaussian = mixed.predicted(steps.linear(to), steps.angular(to));
        }
        next
    }

    /// Updates with a measurement at this time, unless it is outside the gate of every hypothesis.
    pub(super) fn corrected(&self, config: &TargetStateConfig, measured: &BaseMeasurement) -> (Self, Correction) {
        let mut innovations: [Option<Innovation>; HYPOTHESES_MAX] = [const { None }; HYPOTHESES_MAX];
        let (mut nis, mut best) = (f64::INFINITY, f64::NEG_INFINITY);
        for (slot, hypothesis) in innovations.iter_mut().zip(self.hypotheses()) {
            let Some(innovation) = hypothesis.gaussian.innovation(measured) else { return (*self, Correction::Failed) };
            nis = nis.min(innovation.nis);
            best = best.max(innovation.log_likelihood);
            *slot = Some(innovation);
        }
        let mut next = *self;
        let share = config.surprise.newest_share;
        next.surprise += (nis.min(config.gate_nis) / DEGREES_OF_FREEDOM - self.surprise) * share;
        if nis > config.gate_nis {
            return (next, Correction::Outlier { nis });
        }
        let mut sum = 0.0;
        for (hypothesis, innovation) in next.hypotheses_mut().iter_mut().zip(innovations.iter().flatten()) {
            hypothesis.gaussian = hypothesis.gaussian.updated(innovation);
            hypothesis.probability *= (innovation.log_likelihood - best).exp();
            sum += hypothesis.probability;
        }
        for hypothesis in next.hypotheses_mut() {
            hypothesis.probability /= sum;
        }
        if next.is_finite() { (next, Correction::Accepted { nis }) } else { (*self, Correction::Failed) }
    }

    /// The mixture after a time in which no mode changes.
    pub(super) fn mixture(&self, config: &TargetStateConfig, dt_s: f64) -> Mixture {
        let steps = Steps::new(config, self.surprise, dt_s);
        let (mut linear_motion, mut angular_motion) = (0.0, 0.0);
        for hypothesis in self.hypotheses() {
            linear_motion += if hypothesis.linear == Mode::Motion { hypothesis.probability } else { 0.0 };
            angular_motion += if hypothesis.angular == Mode::Motion { hypothesis.probability } else { 0.0 };
        }
        let parts = self.probable(|hypothesis| {
            hypothesis.gaussian.predicted_pose(steps.linear(hypothesis), steps.angular(hypothesis))
        });
        let states = parts.map(|part| part.map(|(weight, (state, _))| (weight, state)));
        let Mean { reference, apart, state } = self.mean(&states);
        let of_pose = |error: &ErrorVector| error.fixed_rows::<6>(0).into_owned();
        let mut covariance = Matrix6::zeros();
        for (weight, (state, part)) in parts.iter().flatten() {
            let apart = of_pose(&(state.minus(&reference) - apart));
            covariance += (part + apart * apart.transpose()) * *weight;
        }
        Mixture { state, covariance, linear_motion, angular_motion }
    }

    /// The pose of that mixture only, at a fraction of the cost.
    pub(super) fn pose_after(&self, config: &TargetStateConfig, dt_s: f64) -> Pose<Base, Model> {
        let both = |part| [Mode::Motion, Mode::Rest].map(|mode| AxisStep::transition_of(part, mode, dt_s));
        let (linear, angular) = (both(&config.linear), both(&config.angular));
        let of = |mode: Mode| usize::from(mode == Mode::Rest);
        let states = self.probable(|hypothesis| {
            hypothesis.gaussian.state.after(&linear[of(hypothesis.linear)], &angular[of(hypothesis.angular)]).0
        });
        self.mean(&states).state.base_from_model
    }

    /// Maps each hypothesis that counts in a prediction, with its weight; the weights sum to 1.
    fn probable<T: Copy>(&self, make: impl Fn(&Hypothesis) -> T) -> [Option<(f64, T)>; HYPOTHESES_MAX] {
        let mut parts = [None; HYPOTHESES_MAX];
        let mut kept = 0.0;
        for (part, hypothesis) in parts.iter_mut().zip(self.hypotheses()) {
            if hypothesis.probability >= NEGLIGIBLE {
                *part = Some((hypothesis.probability, make(hypothesis)));
                kept += hypothesis.probability;
            }
        }
        parts.map(|part| part.map(|(probability, made)| (probability / kept, made)))
    }

    fn mean(&self, states: &[Option<(f64, State)>; HYPOTHESES_MAX]) -> Mean {
        let states = states.iter().flatten();
        let reference = states.clone().map(|(_, state)| *state).next().unwrap_or(self.hypotheses[0].gaussian.state);
        let apart = states.map(|(weight, state)| state.minus(&reference) * *weight).sum();
        Mean { reference, apart, state: reference.plus(&apart) }
    }

    fn hypotheses(&self) -> &[Hypothesis] {
        &self.hypotheses[..self.count]
    }

    fn hypotheses_mut(&mut self) -> &mut [Hypothesis] {
        &mut self.hypotheses[..self.count]
    }

    fn is_finite(&self) -> bool {
        self.hypotheses().iter().all(|hypothesis| hypothesis.probability.is_finite() && hypothesis.gaussian.is_finite())
    }
}

/// The mean of several states, and the error from the mean to one of them.
struct Mean {
    reference: State,
    apart: ErrorVector,
    state: State,
}

/// A time step in each mode, `[motion, rest]`.
struct Steps {
    linear: [AxisStep; 2],
    angular: [AxisStep; 2],
}

impl Steps {
    /// A large innovation increases the noise of motion, and of the velocity and acceleration at the onset of motion.
    fn new(config: &TargetStateConfig, surprise: f64, dt_s: f64) -> Self {
        let factor = config.surprise.noise_factor(surprise);
        let both = |part: &MotionConfig| {
            let mut motion = AxisStep::new(part, Mode::Motion, dt_s);
            let mut rest = AxisStep::new(part, Mode::Rest, dt_s);
            let drift = rest.noise[(0, 0)];
            motion.noise *= factor;
            rest.noise *= factor;
            rest.noise[(0, 0)] = drift;
            [motion, rest]
        };
        Self { linear: both(&config.linear), angular: both(&config.angular) }
    }

    fn linear(&self, hypothesis: &Hypothesis) -> &AxisStep {
        &self.linear[usize::from(hypothesis.linear == Mode::Rest)]
    }

    fn angular(&self, hypothesis: &Hypothesis) -> &AxisStep {
        &self.angular[usize::from(hypothesis.angular == Mode::Rest)]
    }
}

/// The modes of a part.
fn modes(part: &MotionConfig) -> &'static [Mode] {
    if part.rest.is_some() { &[Mode::Motion, Mode::Rest] } else { &[Mode::Motion] }
}

fn share(part: &MotionConfig, mode: Mode) -> f64 {
    part.rest.map_or(1.0, |rest| usual(&rest, mode))
}

fn change(part: &MotionConfig, from: Mode, to: Mode, dt_s: f64) -> f64 {
    part.rest.map_or(1.0, |rest| switching(&rest, from, to, dt_s))
}

/// The Gaussian with mean and covariance of a weighted sum of Gaussians; `sum` is the sum of the weights.
fn mixed(hypotheses: &[Hypothesis], weights: &[f64; HYPOTHESES_MAX], sum: f64) -> Gaussian {
    let mut most = 0;
    for i in 1..hypotheses.len() {
        if weights[i] > weights[most] {
            most = i;
        }
    }
    let reference = hypotheses[most].gaussian.state;
    let mut apart = [ErrorVector::zeros(); HYPOTHESES_MAX];
    let mut mean = ErrorVector::zeros();
    for ((apart, hypothesis), weight) in apart.iter_mut().zip(hypotheses).zip(weights) {
        *apart = hypothesis.gaussian.state.minus(&reference);
        mean += *apart * (weight / sum);
    }
    let mut covariance = ErrorMatrix::zeros();
    for ((apart, hypothesis), weight) in apart.iter().zip(hypotheses).zip(weights) {
        let (apart, share) = (apart - mean, weight / sum);
        // Element by element, without temporary matrices of this size.
        for column in 0..ERRORS {
            for row in 0..ERRORS {
                let own = hypothesis.gaussian.covariance[(row, column)];
                covariance[(row, column)] += (own + apart[row] * apart[column]) * share;
            }
        }
    }
    Gaussian { state: reference.plus(&mean), covariance }
}
