//! Quality gates: the limits that a calibration must meet, and the advice if it does not.

use std::fmt;

use crate::defects::Defects;
use crate::quality::Quality;

/// A judged quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// Number of views.
    Views,
    /// Share of the image covered by detected corners.
    Coverage,
    /// How much the board was tilted.
    Tilt,
    /// How flat the board is.
    Flatness,
    /// Whether a focal length changed.
    Focus,
    /// Whether the board moved between the exposures of the two cameras.
    Motion,
    /// Reprojection error of held-out views.
    HeldOut,
    /// Error of held-out views, divided by the error of the fitted views.
    HeldOutRatio,
    /// Vertical misalignment (epipolar error) of the rectified images.
    Rows,
    /// The baseline compared with an independently measured one.
    Scale,
    /// Depth error caused by the calibration.
    Depth,
}

impl Gate {
    /// All gates, in display order.
    pub const ALL: [Self; 11] = [
        Self::Views,
        Self::Coverage,
        Self::Tilt,
        Self::Flatness,
        Self::Focus,
        Self::Motion,
        Self::HeldOut,
        Self::HeldOutRatio,
        Self::Rows,
        Self::Scale,
        Self::Depth,
    ];

    /// The name in configurations, files and waivers, with its unit.
    pub fn key(self) -> &'static str {
        match self {
            Self::Views => "views",
            Self::Coverage => "coverage_percent",
            Self::Tilt => "tilt_deg",
            Self::Flatness => "board_flatness_mm",
            Self::Focus => "focus_change_percent",
            Self::Motion => "motion_rms_px",
            Self::HeldOut => "held_out_rms_px",
            Self::HeldOutRatio => "held_out_ratio",
            Self::Rows => "row_error_rms_px",
            Self::Scale => "scale_percent",
            Self::Depth => "depth_sigma_percent",
        }
    }

    /// Whether larger is better.
    pub fn is_floor(self) -> bool {
        matches!(self, Self::Views | Self::Coverage | Self::Tilt)
    }

    /// The measured value; `None` if this calibration does not have it.
    fn measured(self, quality: &Quality) -> Option<f64> {
        match self {
            Self::Views => Some(quality.views as f64),
            Self::Coverage => Some(100.0 * quality.coverage),
            Self::Tilt => Some(quality.tilt_deg),
            Self::Flatness => Some(1e3 * quality.defects.as_ref()?.flatness_m?),
            Self::Focus => Some(defects(quality, |defects| defects.refocused.share * 100.0)),
            Self::Motion => {
                quality.rows.map(|_| defects(quality, |defects| defects.moved.map_or(f64::NAN, |moved| moved.rms_px)))
            }
            Self::HeldOut => Some(quality.held_out_rms_px),
            Self::HeldOutRatio => Some(quality.held_out_ratio()),
            Self::Rows => quality.rows.map(|rows| rows.rms_px),
            Self::Scale => quality.scale_error_share.map(|share| 100.0 * share.abs()),
            Self::Depth => quality.depth_sigma_share.map(|share| 100.0 * share),
        }
    }

    /// Advice if the grade is not good.
    pub fn advice(self) -> &'static str {
        match self {
            Self::Views => "take more images of the board, 15 to 20",
            Self::Coverage => "show the board in the corners and at the borders of the image, of both cameras",
            Self::Tilt => "tilt the board by 20 to 40 degrees, about both its axes, in several views",
            Self::Flatness => {
                "the board is bent: fix it to a glass or aluminium plate, or use another board, and take all images again"
            }
            Self::Focus => {
                "a focal length changed between the views: disable autofocus, lock the focus, do not touch the lenses, and take all images again"
            }
            Self::Motion => {
                "the two cameras disagree about the board position: hold the board still (put it down or on a tripod), synchronise the exposures, fix the cameras to each other, and take the images again"
            }
            Self::HeldOut => {
                "check the views with the largest errors for blur, a bent board, or a camera that was touched or refocused; leave these views out or take them again"
            }
            Self::HeldOutRatio => {
                "the fit does not generalise to held-out views: take more views, or choose a lens model with fewer coefficients"
            }
            Self::Rows => {
                "the rectified images are vertically misaligned: fix the cameras to each other, do not change the focus, synchronise the exposures, hold the board still, and take the images again"
            }
            Self::Scale => {
                "the baseline differs from the measured one: measure ten squares of the board, divide and correct --square, or measure the baseline again"
            }
            Self::Depth => {
                "add views with the board at the working distance and with the board nearer, so that it is larger in the image"
            }
        }
    }
}

/// A value of the defects; NaN, which is refused, if the defects could not be estimated.
fn defects(quality: &Quality, number: impl Fn(&Defects) -> f64) -> f64 {
    quality.defects.as_ref().map_or(f64::NAN, number)
}

/// The limits of a gate: good, and refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Good up to this value, inclusive.
    pub good: f64,
    /// Refused if worse than this value.
    pub refused: f64,
}

impl Limit {
    /// The limit, if its numbers are consistent for a gate where larger (`is_floor`) or smaller is better.
    pub(crate) fn checked(self, key: &'static str, is_floor: bool) -> Result<Self, LimitError> {
        let Self { good, refused } = self;
        let ordered = if is_floor { good >= refused } else { good <= refused };
        if good.is_finite() && refused.is_finite() && good >= 0.0 && refused >= 0.0 && ordered {
            return Ok(self);
        }
        let better = if is_floor { "larger" } else { "smaller" };
        Err(LimitError { key, good, refused, better })
    }
}

/// The limits of all gates.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    limits: [Limit; Gate::ALL.len()],
}

/// An invalid limit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "gates.{key}: good = {good}, refused = {refused}; both must be finite and not negative, and good must be the {better} one"
)]
pub struct LimitError {
    key: &'static str,
    good: f64,
    refused: f64,
    better: &'static str,
}

impl Default for Limits {
    fn default() -> Self {
        let limit = |gate| match gate {
            Gate::Views => Limit { good: 12.0, refused: 6.0 },
            Gate::Coverage => Limit { good: 70.0, refused: 45.0 },
            Gate::Tilt => Limit { good: 20.0, refused: 10.0 },
            Gate::Flatness => Limit { good: 0.5, refused: 1.0 },
            Gate::Focus => Limit { good: 0.1, refused: 0.3 },
            Gate::Motion => Limit { good: 0.03, refused: 0.05 },
            Gate::HeldOut => Limit { good: 0.2, refused: 0.35 },
            Gate::HeldOutRatio => Limit { good: 1.25, refused: 1.6 },
            Gate::Rows => Limit { good: 0.2, refused: 0.3 },
            Gate::Scale => Limit { good: 1.5, refused: 3.0 },
            Gate::Depth => Limit { good: 0.1, refused: 0.5 },
        };
        Self { limits: Gate::ALL.map(limit) }
    }
}

impl Limits {
    /// The limit of a gate.
    pub fn of(&self, gate: Gate) -> Limit {
        self.limits[gate as usize]
    }

    /// The same limits with the limit of one gate replaced.
    ///
    /// # Errors
    /// Numbers that are not finite, negative, or in the wrong order.
    pub fn with(mut self, gate: Gate, limit: Limit) -> Result<Self, LimitError> {
        self.limits[gate as usize] = limit.checked(gate.key(), gate.is_floor())?;
        Ok(self)
    }

    /// Judges a calibration.
    pub fn judge(&self, quality: &Quality) -> Vec<Verdict> {
        let of = |gate: Gate| Some(Verdict { gate, measured: gate.measured(quality)?, limit: self.of(gate) });
        Gate::ALL.into_iter().filter_map(of).collect()
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
pub struct Verdict {
    /// The gate.
    pub gate: Gate,
    /// The measured value, in the unit of the gate's key.
    pub measured: f64,
    /// The limit it was compared with.
    pub limit: Limit,
}

impl Verdict {
    /// The grade; a value that is not finite is refused.
    pub fn grade(&self) -> Grade {
        self.limit.grade(self.measured, self.gate.is_floor())
    }
}

impl Limit {
    /// Grades a value; a value that is not finite is refused.
    pub(crate) fn grade(self, measured: f64, is_floor: bool) -> Grade {
        let as_good_as = |limit: f64| if is_floor { measured >= limit } else { measured <= limit };
        match (as_good_as(self.good), as_good_as(self.refused)) {
            (true, _) if measured.is_finite() => Grade::Good,
            (_, true) if measured.is_finite() => Grade::Fair,
            _ => Grade::Refused,
        }
    }

    /// The printed line of a gate: measured value, limits, and advice if it is not good.
    pub(crate) fn line(self, key: &str, measured: f64, is_floor: bool, advice: &str) -> String {
        let word = if is_floor { "from" } else { "up to" };
        let Self { good, refused } = self;
        let grade = self.grade(measured, is_floor);
        let told = format!(
            "{:<8} {key} = {measured:.3} (good {word} {good}, refused {} {refused})",
            grade.name(),
            if is_floor { "below" } else { "above" }
        );
        if grade == Grade::Good { told } else { format!("{told}: {advice}") }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.limit.line(self.gate.key(), self.measured, self.gate.is_floor(), self.gate.advice()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_gate_refuses_beyond_its_limit_and_says_what_to_do() {
        for gate in Gate::ALL {
            let limit = Limits::default().of(gate);
            let grade = |measured| Verdict { gate, measured, limit }.grade();
            assert_eq!(grade(limit.good), Grade::Good);
            assert_eq!(grade(0.5 * (limit.good + limit.refused)), Grade::Fair, "{gate:?}");
            let beyond = limit.refused + 1e-6 * (limit.refused - limit.good);
            assert_eq!(grade(beyond), Grade::Refused, "{gate:?}");
            assert_eq!(grade(f64::NAN), Grade::Refused);
            let text = Verdict { gate, measured: beyond, limit }.to_string();
            assert!(text.starts_with("refused") && text.contains(gate.key()) && text.contains(gate.advice()), "{text}");
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
        let verdicts = Limits::default().judge(&quality);
        let held_out = verdicts.iter().find(|verdict| verdict.gate == Gate::HeldOut).expect("judged");
        assert_eq!((held_out.measured, held_out.grade()), (0.4, Grade::Refused));
    }

    #[test]
    fn limits_the_wrong_way_round_are_refused() {
        let refused =
            |gate, good, refused| Limits::default().with(gate, Limit { good, refused }).map_err(|e| e.to_string());
        assert!(
            refused(Gate::Rows, 0.3, 0.2)
                .is_err_and(|text| text.contains("row_error_rms_px") && text.contains("smaller"))
        );
        assert!(refused(Gate::Views, 5.0, 9.0).is_err_and(|text| text.contains("larger")));
        assert!(refused(Gate::Rows, f64::NAN, 0.2).is_err());
        assert!(refused(Gate::Rows, 0.1, 0.15).is_ok_and(|limits| limits.of(Gate::Rows).refused == 0.15));
    }
}
