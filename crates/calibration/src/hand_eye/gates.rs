//! Quality gates of a hand-eye calibration: the limits it must meet, and the advice if it does not.

use std::fmt;

use super::{HandEyeFit, Scale};
use crate::gates::{Grade, Limit, LimitError};

/// A length factor counts as wrong only if it deviates from 1 by more than this number of standard deviations.
const SCALE_SIGMAS: f64 = 2.0;

/// A judged quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HandEyeGate {
    /// Number of used stops.
    Stops,
    /// Stops that disagree with all others.
    Outliers,
    /// Rotations about a second axis.
    RotationSpread,
    /// Reprojection error.
    Corners,
    /// Board position at each stop, compared with the calibration from all other stops.
    LeftOutDistance,
    /// The same for the orientation.
    LeftOutAngle,
    /// Lengths, with the robot as reference.
    Scale,
    /// Hand error caused by the calibration.
    HandError,
}

impl HandEyeGate {
    /// All gates, in display order.
    pub const ALL: [Self; 8] = [
        Self::Stops,
        Self::Outliers,
        Self::RotationSpread,
        Self::Corners,
        Self::LeftOutDistance,
        Self::LeftOutAngle,
        Self::Scale,
        Self::HandError,
    ];

    /// The name in configurations, files and waivers, with its unit.
    pub fn key(self) -> &'static str {
        match self {
            Self::Stops => "stops",
            Self::Outliers => "outliers_percent",
            Self::RotationSpread => "rotation_spread_deg",
            Self::Corners => "corner_rms_px",
            Self::LeftOutDistance => "left_out_mm",
            Self::LeftOutAngle => "left_out_deg",
            Self::Scale => "scale_percent",
            Self::HandError => "hand_error_mm",
        }
    }

    /// Whether larger is better.
    pub fn is_floor(self) -> bool {
        matches!(self, Self::Stops | Self::RotationSpread)
    }

    /// The measured value, for a hand working at the given distance.
    fn measured(self, fit: &HandEyeFit, distance_m: f64) -> f64 {
        let used = fit.used().count() as f64;
        let rms =
            |of: fn(&super::StopCheck) -> f64| (fit.used().map(|stop| of(stop).powi(2)).sum::<f64>() / used).sqrt();
        match self {
            Self::Stops => used,
            Self::Outliers => 100.0 * fit.rejected().count() as f64 / fit.stops.len() as f64,
            Self::RotationSpread => fit.rotation_spread_deg,
            Self::Corners => fit.corner_rms_px,
            Self::LeftOutDistance => rms(|stop| stop.left_out_mm),
            Self::LeftOutAngle => rms(|stop| stop.left_out_deg),
            Self::Scale => 100.0 * worst(off(fit.scales.squares), off(fit.scales.baseline)),
            Self::HandError => fit.hand_error_m(distance_m) * 1e3,
        }
    }

    /// Advice if the grade is not good.
    fn advice(self, fit: &HandEyeFit) -> &'static str {
        match self {
            Self::Stops => "visit more poses, 15 to 20, from which both cameras see the whole board",
            Self::Outliers => {
                "some stops disagree with all others: wait until the arm is stationary before taking an image, fix the board, and visit these stops again"
            }
            Self::RotationSpread => {
                "rotate the flange about at least two axes, by 15 to 30 degrees each; `pb3dp calibrate propose` chooses such poses"
            }
            Self::Corners => {
                "check that the stereo calibration belongs to these cameras in their present state, check for blur and a bent board, and calibrate the stereo rig again from these images"
            }
            Self::LeftOutDistance | Self::LeftOutAngle => {
                "the stops contradict each other: check that cameras and board are fixed, that the arm is stationary at each stop, that the robot description matches this arm, and that its joint zero positions are correct"
            }
            Self::Scale => scale_advice(fit),
            Self::HandError => "visit more poses, with larger rotations, and with the board nearer",
        }
    }
}

/// Deviation of a factor from 1, minus the part explained by chance.
fn off(scale: Scale) -> f64 {
    worst(0.0, (scale.factor - 1.0).abs() - SCALE_SIGMAS * scale.sigma)
}

/// The larger value; NaN takes precedence, which `max` would hide.
fn worst(a: f64, b: f64) -> f64 {
    if a > b || a.is_nan() { a } else { b }
}

/// Which length is wrong; both, if the smaller deviation is at least a third of the larger one.
fn scale_advice(fit: &HandEyeFit) -> &'static str {
    let [squares, baseline] = [fit.scales.squares, fit.scales.baseline].map(|scale| (scale.factor - 1.0).abs());
    if squares > 3.0 * baseline {
        "measure the squares: their side differs from --square (measure ten squares with a ruler and divide)"
    } else if baseline > 3.0 * squares {
        "measure the squares used for the stereo calibration, and calibrate the stereo rig again: its baseline is wrong"
    } else {
        "measure the squares (measure ten with a ruler and divide), then calibrate the stereo rig and the hand again; if the squares are correct, the robot description does not match this arm"
    }
}

/// The limits of all gates.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeLimits {
    limits: [Limit; HandEyeGate::ALL.len()],
}

impl Default for HandEyeLimits {
    fn default() -> Self {
        let limit = |gate| match gate {
            HandEyeGate::Stops => Limit { good: 12.0, refused: 8.0 },
            HandEyeGate::Outliers => Limit { good: 10.0, refused: 30.0 },
            HandEyeGate::RotationSpread => Limit { good: 10.0, refused: 5.0 },
            HandEyeGate::Corners => Limit { good: 0.3, refused: 0.5 },
            HandEyeGate::LeftOutDistance => Limit { good: 0.7, refused: 2.0 },
            HandEyeGate::LeftOutAngle => Limit { good: 0.1, refused: 0.3 },
            HandEyeGate::Scale => Limit { good: 0.1, refused: 0.3 },
            HandEyeGate::HandError => Limit { good: 0.3, refused: 1.0 },
        };
        Self { limits: HandEyeGate::ALL.map(limit) }
    }
}

impl HandEyeLimits {
    /// The limit of a gate.
    pub fn of(&self, gate: HandEyeGate) -> Limit {
        self.limits[gate as usize]
    }

    /// The same limits with the limit of one gate replaced.
    ///
    /// # Errors
    /// Numbers that are not finite, negative, or in the wrong order.
    pub fn with(mut self, gate: HandEyeGate, limit: Limit) -> Result<Self, LimitError> {
        self.limits[gate as usize] = limit.checked(gate.key(), gate.is_floor())?;
        Ok(self)
    }

    /// Judges a calibration for a hand working at the given distance.
    pub fn judge(&self, fit: &HandEyeFit, distance_m: f64) -> Vec<HandEyeVerdict> {
        let of = |gate: HandEyeGate| HandEyeVerdict {
            gate,
            measured: gate.measured(fit, distance_m),
            limit: self.of(gate),
            advice: gate.advice(fit),
        };
        HandEyeGate::ALL.map(of).to_vec()
    }
}

/// The result of one gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeVerdict {
    /// The gate.
    pub gate: HandEyeGate,
    /// The measured value, in the unit of the gate's key.
    pub measured: f64,
    /// The limit it was compared with.
    pub limit: Limit,
    /// Advice if the grade is not good.
    pub advice: &'static str,
}

impl HandEyeVerdict {
    /// The grade; a value that is not finite is refused.
    pub fn grade(&self) -> Grade {
        self.limit.grade(self.measured, self.gate.is_floor())
    }
}

impl fmt::Display for HandEyeVerdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.limit.line(self.gate.key(), self.measured, self.gate.is_floor(), self.advice))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_gate_refuses_beyond_its_limit_and_says_what_to_do() {
        for gate in HandEyeGate::ALL {
            let limit = HandEyeLimits::default().of(gate);
            let verdict = |measured| HandEyeVerdict { gate, measured, limit, advice: "do this" };
            assert_eq!(verdict(limit.good).grade(), Grade::Good);
            assert_eq!(verdict(0.5 * (limit.good + limit.refused)).grade(), Grade::Fair, "{gate:?}");
            let beyond = verdict(limit.refused + 1e-6 * (limit.refused - limit.good));
            assert_eq!(beyond.grade(), Grade::Refused, "{gate:?}");
            assert_eq!(verdict(f64::NAN).grade(), Grade::Refused);
            let text = beyond.to_string();
            assert!(text.starts_with("refused") && text.contains(gate.key()) && text.contains("do this"), "{text}");
        }
        let wrong = HandEyeLimits::default().with(HandEyeGate::Stops, Limit { good: 5.0, refused: 9.0 });
        assert!(wrong.is_err_and(|error| error.to_string().contains("stops") && error.to_string().contains("larger")));
    }

    #[test]
    fn a_factor_that_is_no_number_is_not_hidden() {
        let good = Scale { factor: 1.001, sigma: 0.001 };
        let wrong = Scale { factor: 0.99, sigma: 0.001 };
        assert_eq!(off(good), 0.0);
        assert!((off(wrong) - 0.008).abs() < 1e-12);
        let none = off(Scale { factor: f64::NAN, sigma: 0.001 });
        assert!(worst(none, off(good)).is_nan() && worst(off(good), none).is_nan());
    }
}
