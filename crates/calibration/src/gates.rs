//! Quality gates: judged figures, each with the limits that it must meet and the remedy if it does not.
//!
//! The gates of cameras and stereo rigs are here, those of hand-eye calibrations in [`crate::hand_eye::gates`], and the checks of an
//! existing calibration in [`crate::verify::limits`].

use std::fmt;

use pb3dp_record::calibration_files::JudgedGate;

use crate::defects::Defects;
use crate::quality::Quality;

/// A judged quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// The name in configurations, files and waivers, with its unit.
    pub key: &'static str,
    /// Whether larger is better.
    pub is_floor: bool,
    /// Good up to this value, inclusive.
    pub good: f64,
    /// Refused if worse than this value.
    pub refused: f64,
    /// Advice if the grade is not good.
    pub advice: &'static str,
}

impl Gate {
    /// A gate where smaller is better, good up to `good` and refused above `refused`.
    pub const fn at_most(key: &'static str, [good, refused]: [f64; 2], advice: &'static str) -> Self {
        Self { key, is_floor: false, good, refused, advice }
    }

    /// A gate where larger is better, good from `good` and refused below `refused`.
    pub const fn at_least(key: &'static str, [good, refused]: [f64; 2], advice: &'static str) -> Self {
        Self { key, is_floor: true, good, refused, advice }
    }

    /// The limits in words: of good, and of refused values.
    pub fn limits(&self) -> [String; 2] {
        let [good, refused] = if self.is_floor { ["from", "below"] } else { ["up to", "above"] };
        [format!("{good} {}", self.good), format!("{refused} {}", self.refused)]
    }
}

/// The grade of a judged value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// Meets the recommended limit.
    Good,
    /// Usable.
    Fair,
    /// Not to be used.
    Refused,
}

impl Grade {
    /// Name in files and printed texts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Refused => "refused",
        }
    }
}

/// The result of one gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// The gate, with the limits that the value was compared with.
    pub gate: Gate,
    /// The measured value, in the unit of the gate's key.
    pub measured: f64,
}

impl Judged {
    /// The grade; a value that is not finite is refused.
    pub fn grade(&self) -> Grade {
        let Self { gate, measured } = *self;
        let as_good_as = |limit: f64| if gate.is_floor { measured >= limit } else { measured <= limit };
        match (as_good_as(gate.good), as_good_as(gate.refused)) {
            (true, _) if measured.is_finite() => Grade::Good,
            (_, true) if measured.is_finite() => Grade::Fair,
            _ => Grade::Refused,
        }
    }
}

/// The printed line: measured value, limits, and advice if the grade is not good.
impl fmt::Display for Judged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { gate: Gate { key, advice, .. }, measured } = self;
        let (grade, [good, refused]) = (self.grade(), self.gate.limits());
        write!(f, "{:<8} {key} = {measured:.3} (good {good}, refused {refused})", grade.name())?;
        if grade == Grade::Good { Ok(()) } else { write!(f, ": {advice}") }
    }
}

impl From<&Judged> for JudgedGate {
    fn from(judged: &Judged) -> Self {
        let Gate { key, good, refused, .. } = judged.gate;
        Self { name: key.to_owned(), measured: judged.measured, good, refused, grade: judged.grade().name().to_owned() }
    }
}

/// The worst grade of all gates, and the verdict in words: good, usable, or the number of gates that refuse.
pub fn verdict(judged: &[Judged]) -> (Grade, String) {
    let of = |grade: Grade| judged.iter().filter(|judged| judged.grade() == grade).count();
    match (of(Grade::Refused), of(Grade::Fair)) {
        (0, 0) => (Grade::Good, "good".to_owned()),
        (0, fair) => (Grade::Fair, format!("usable; {fair} of {} gates could be better", judged.len())),
        (refused, _) => (Grade::Refused, format!("refused by {refused} of {} gates", judged.len())),
    }
}

/// The gates of one kind of calibration, with the built-in limits or with others.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Name of their table in a file.
    pub table: &'static str,
    gates: Vec<Gate>,
}

/// An invalid limit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{table}.{key}: good = {good}, refused = {refused}; both must be finite and not negative, and good must be the {better} one"
)]
pub struct LimitError {
    table: &'static str,
    key: &'static str,
    good: f64,
    refused: f64,
    better: &'static str,
}

impl Limits {
    /// These gates with their own limits.
    pub(crate) fn built_in(table: &'static str, gates: &[Gate]) -> Self {
        Self { table, gates: gates.to_vec() }
    }

    /// The gates of cameras and stereo rigs, as in `configs/calibration_gates.toml`.
    pub fn of_cameras() -> Self {
        Self::built_in("gates", &CAMERA_GATES)
    }

    /// All gates, in display order.
    pub fn gates(&self) -> &[Gate] {
        &self.gates
    }

    /// A gate with the limits of this list.
    pub fn of(&self, gate: Gate) -> Gate {
        self.gates.iter().find(|own| own.key == gate.key).map_or(gate, |own| Gate { advice: gate.advice, ..*own })
    }

    /// The same gates with other limits of good and refused values for one of them.
    ///
    /// # Errors
    /// Numbers that are not finite, negative, or in the wrong order.
    pub fn with(mut self, gate: Gate, [good, refused]: [f64; 2]) -> Result<Self, LimitError> {
        let Gate { key, is_floor, .. } = gate;
        let ordered = if is_floor { good >= refused } else { good <= refused };
        if !(good.is_finite() && refused.is_finite() && good >= 0.0 && refused >= 0.0 && ordered) {
            let better = if is_floor { "larger" } else { "smaller" };
            return Err(LimitError { table: self.table, key, good, refused, better });
        }
        for own in self.gates.iter_mut().filter(|own| own.key == key) {
            *own = Gate { good, refused, ..*own };
        }
        Ok(self)
    }

    /// Judges a value.
    pub fn judge(&self, gate: Gate, measured: f64) -> Judged {
        Judged { gate: self.of(gate), measured }
    }

    /// Judges the calibration of a camera or stereo rig; gates whose value it does not have are left out.
    pub fn judge_cameras(&self, quality: &Quality) -> Vec<Judged> {
        let percent = |share: f64| 100.0 * share;
        let moved = |defects: &Defects| defects.moved.map_or(f64::NAN, |moved| moved.rms_px);
        let measured = [
            (VIEWS, Some(quality.views as f64)),
            (COVERAGE, Some(percent(quality.coverage))),
            (TILT, Some(quality.tilt_deg)),
            (FLATNESS, quality.defects.as_ref().and_then(|defects| defects.flatness_m).map(|metres| 1e3 * metres)),
            (FOCUS, Some(defects(quality, |defects| percent(defects.refocused.share)))),
            (MOTION, quality.rows.map(|_| defects(quality, moved))),
            (HELD_OUT, Some(quality.held_out_rms_px)),
            (HELD_OUT_RATIO, Some(quality.held_out_ratio())),
            (ROWS, quality.rows.map(|rows| rows.rms_px)),
            (SCALE, quality.scale_error_share.map(|share| percent(share.abs()))),
            (DEPTH, quality.depth_sigma_share.map(percent)),
        ];
        measured.into_iter().filter_map(|(gate, measured)| Some(self.judge(gate, measured?))).collect()
    }
}

/// A value of the defects; NaN, which is refused, if the defects could not be estimated.
fn defects(quality: &Quality, number: impl Fn(&Defects) -> f64) -> f64 {
    quality.defects.as_ref().map_or(f64::NAN, number)
}

/// Number of views.
pub const VIEWS: Gate = Gate::at_least("views", [12.0, 6.0], "take more images of the board, 15 to 20");

/// Share of the image covered by detected corners.
pub const COVERAGE: Gate = Gate::at_least(
    "coverage_percent",
    [70.0, 45.0],
    "show the board in the corners and at the borders of the image, of both cameras",
);

/// How much the board was tilted.
pub const TILT: Gate = Gate::at_least(
    "tilt_deg",
    [20.0, 10.0],
    "tilt the board by 20 to 40 degrees, about both its axes, in several views",
);

/// How flat the board is.
pub const FLATNESS: Gate = Gate::at_most(
    "board_flatness_mm",
    [0.5, 1.0],
    "the board is bent: fix it to a glass or aluminium plate, or use another board, and take all images again",
);

/// Whether a focal length changed.
pub const FOCUS: Gate = Gate::at_most(
    "focus_change_percent",
    [0.1, 0.3],
    "a focal length changed between the views: disable autofocus, lock the focus, do not touch the lenses, and take all images again",
);

/// Whether the board moved between the exposures of the two cameras.
pub const MOTION: Gate = Gate::at_most(
    "motion_rms_px",
    [0.03, 0.05],
    "the two cameras disagree about the board position: hold the board still (put it down or on a tripod), synchronise the exposures, fix the cameras to each other, and take the images again",
);

/// Reprojection error of held-out views.
pub const HELD_OUT: Gate = Gate::at_most(
    "held_out_rms_px",
    [0.2, 0.35],
    "check the views with the largest errors for blur, a bent board, or a camera that was touched or refocused; leave these views out or take them again",
);

/// Error of held-out views, divided by the error of the fitted views.
pub const HELD_OUT_RATIO: Gate = Gate::at_most(
    "held_out_ratio",
    [1.25, 1.6],
    "the fit does not generalise to held-out views: take more views, or choose a lens model with fewer coefficients",
);

/// Vertical misalignment (epipolar error) of the rectified images.
pub const ROWS: Gate = Gate::at_most(
    "row_error_rms_px",
    [0.2, 0.3],
    "the rectified images are vertically misaligned: fix the cameras to each other, do not change the focus, synchronise the exposures, hold the board still, and take the images again",
);

/// The baseline compared with an independently measured one.
pub const SCALE: Gate = Gate::at_most(
    "scale_percent",
    [1.5, 3.0],
    "the baseline differs from the measured one: measure ten squares of the board, divide and correct --square, or measure the baseline again",
);

/// Depth error caused by the calibration.
pub const DEPTH: Gate = Gate::at_most(
    "depth_sigma_percent",
    [0.1, 0.5],
    "add views with the board at the working distance and with the board nearer, so that it is larger in the image",
);

/// The gates of cameras and stereo rigs, in display order.
const CAMERA_GATES: [Gate; 11] =
    [VIEWS, COVERAGE, TILT, FLATNESS, FOCUS, MOTION, HELD_OUT, HELD_OUT_RATIO, ROWS, SCALE, DEPTH];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_gate_refuses_beyond_its_limit_and_says_what_to_do() {
        for limits in [Limits::of_cameras(), Limits::of_hand_eye(), Limits::of_checks()] {
            for gate in limits.gates() {
                let grade = |measured| limits.judge(*gate, measured).grade();
                assert_eq!(grade(gate.good), Grade::Good);
                assert_eq!(grade(0.5 * (gate.good + gate.refused)), Grade::Fair, "{gate:?}");
                let beyond = gate.refused + 1e-6 * (gate.refused - gate.good);
                assert_eq!(grade(beyond), Grade::Refused, "{gate:?}");
                assert_eq!(grade(f64::NAN), Grade::Refused);
                let text = limits.judge(*gate, beyond).to_string();
                assert!(text.starts_with("refused") && text.contains(gate.key) && text.contains(gate.advice), "{text}");
            }
        }
    }

    #[test]
    fn views_that_the_fit_has_not_used_are_judged() {
        let quality = Quality {
            views: 15,
            corners: 1620,
            reprojection_rms_px: 0.1,
            reprojection_rms_by_camera_px: vec![0.1],
            reprojection_rms_by_view_px: Vec::new(),
            held_out_rms_px: 0.4,
            coverage: 0.9,
            tilt_deg: 30.0,
            defects: None,
            scale_error_share: None,
            rows: None,
            depth_sigma_share: None,
        };
        let judged = Limits::of_cameras().judge_cameras(&quality);
        let held_out = judged.iter().find(|judged| judged.gate == HELD_OUT).expect("judged");
        assert_eq!((held_out.measured, held_out.grade()), (0.4, Grade::Refused));
    }

    #[test]
    fn limits_the_wrong_way_round_are_refused() {
        let with = |gate, limits| Limits::of_cameras().with(gate, limits).map_err(|e| e.to_string());
        assert!(with(ROWS, [0.3, 0.2]).is_err_and(|e| e.contains("row_error_rms_px") && e.contains("smaller")));
        assert!(with(VIEWS, [5.0, 9.0]).is_err_and(|text| text.contains("larger")));
        assert!(with(ROWS, [f64::NAN, 0.2]).is_err());
        assert!(with(ROWS, [0.1, 0.15]).is_ok_and(|limits| limits.of(ROWS).refused == 0.15));
    }
}
