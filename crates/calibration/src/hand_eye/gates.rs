//! Quality gates of a hand-eye calibration: the limits it must meet, and the advice if it does not.

use super::{HandEyeFit, Scale, StopCheck};
use crate::gates::{Gate, Judged, Limits};

/// A length factor counts as wrong only if it deviates from 1 by more than this number of standard deviations.
const SCALE_SIGMAS: f64 = 2.0;

/// Number of used stops.
pub const STOPS: Gate =
    Gate::at_least("stops", [12.0, 8.0], "visit more poses, 15 to 20, from which both cameras see the whole board");

/// Stops that disagree with all others.
pub const OUTLIERS: Gate = Gate::at_most(
    "outliers_percent",
    [10.0, 30.0],
    "some stops disagree with all others: wait until the arm is stationary before taking an image, fix the board, and visit these stops again",
);

/// Rotations about a second axis.
pub const ROTATION_SPREAD: Gate = Gate::at_least(
    "rotation_spread_deg",
    [10.0, 5.0],
    "rotate the flange about at least two axes, by 15 to 30 degrees each; `pb3dp calibrate propose` chooses such poses",
);

/// Reprojection error.
pub const CORNERS: Gate = Gate::at_most(
    "corner_rms_px",
    [0.3, 0.5],
    "check that the stereo calibration belongs to these cameras in their present state, check for blur and a bent board, and calibrate the stereo rig again from these images",
);

const CONTRADICTION: &str = "the stops contradict each other: check that cameras and board are fixed, that the arm is stationary at each stop, that the robot description matches this arm, and that its joint zero positions are correct";

/// Board position at each stop, compared with the calibration from all other stops.
pub const LEFT_OUT_DISTANCE: Gate = Gate::at_most("left_out_mm", [0.7, 2.0], CONTRADICTION);

/// The same for the orientation.
pub const LEFT_OUT_ANGLE: Gate = Gate::at_most("left_out_deg", [0.1, 0.3], CONTRADICTION);

/// Lengths, with the robot as reference; `scale_advice` tells which one is wrong.
pub const SCALE: Gate = Gate::at_most("scale_percent", [0.1, 0.3], BOTH_SCALES);

const BOTH_SCALES: &str = "measure the squares (measure ten with a ruler and divide), then calibrate the stereo rig and the hand again; if the squares are correct, the robot description does not match this arm";

/// Hand error caused by the calibration.
pub const HAND_ERROR: Gate =
    Gate::at_most("hand_error_mm", [0.3, 1.0], "visit more poses, with larger rotations, and with the board nearer");

impl Limits {
    /// The gates of hand-eye calibrations, as in `configs/hand_eye_gates.toml`.
    pub fn of_hand_eye() -> Self {
        let gates = [STOPS, OUTLIERS, ROTATION_SPREAD, CORNERS, LEFT_OUT_DISTANCE, LEFT_OUT_ANGLE, SCALE, HAND_ERROR];
        Self::built_in("hand_eye_gates", &gates)
    }

    /// Judges a hand-eye calibration for a hand working at the given distance.
    pub fn judge_hand_eye(&self, fit: &HandEyeFit, distance_m: f64) -> Vec<Judged> {
        let used = fit.used().count() as f64;
        let rms = |of: fn(&StopCheck) -> f64| (fit.used().map(|stop| of(stop).powi(2)).sum::<f64>() / used).sqrt();
        let scale = worst(off(fit.scales.squares), off(fit.scales.baseline));
        let measured = [
            (STOPS, used),
            (OUTLIERS, 100.0 * fit.rejected().count() as f64 / fit.stops.len() as f64),
            (ROTATION_SPREAD, fit.rotation_spread_deg),
            (CORNERS, fit.corner_rms_px),
            (LEFT_OUT_DISTANCE, rms(|stop| stop.left_out_mm)),
            (LEFT_OUT_ANGLE, rms(|stop| stop.left_out_deg)),
            (Gate { advice: scale_advice(fit), ..SCALE }, 100.0 * scale),
            (HAND_ERROR, fit.hand_error_m(distance_m) * 1e3),
        ];
        measured.map(|(gate, measured)| self.judge(gate, measured)).to_vec()
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
        BOTH_SCALES
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
