//! Limits for the verification of a calibration.

use crate::gates::{Grade, Limit, LimitError};
use crate::report::GateLine;

/// A verified quantity; smaller is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// Reprojection error of new views, with only the board poses fitted.
    Reprojection,
    /// Vertical misalignment (epipolar error) of the rectified images in new views.
    Rows,
    /// Lengths on the board compared with the stated ones, at the working distance.
    Scale,
    /// A length measured with a ruler.
    Length,
    /// Difference from a second calibration, in standard deviations.
    Sigmas,
    /// Distance between the positions that both calibrations compute for a point at the working distance.
    Difference,
    /// Points touched with the arm.
    Touch,
    /// Expected hand error at the working distance.
    HandError,
}

impl Check {
    /// All checks, in display order.
    pub const ALL: [Self; 8] = [
        Self::Reprojection,
        Self::Rows,
        Self::Scale,
        Self::Length,
        Self::Sigmas,
        Self::Difference,
        Self::Touch,
        Self::HandError,
    ];

    /// The name in files, with its unit.
    pub fn key(self) -> &'static str {
        match self {
            Self::Reprojection => "reprojection_rms_px",
            Self::Rows => "row_error_rms_px",
            Self::Scale => "scale_percent",
            Self::Length => "length_percent",
            Self::Sigmas => "difference_sigmas",
            Self::Difference => "difference_p95_mm",
            Self::Touch => "touch_mm",
            Self::HandError => "hand_error_mm",
        }
    }

    fn advice(self) -> &'static str {
        match self {
            Self::Reprojection => {
                "the cameras no longer match the calibration: check for a touched lens or focus, a different image size, or a wrong board; calibrate again"
            }
            Self::Rows => {
                "the cameras have moved relative to each other, or their exposures are not synchronised: fix them and calibrate again"
            }
            Self::Scale => {
                "lengths on the board are wrong: measure ten squares of the board; if --square is correct, the cameras have moved relative to each other: calibrate again"
            }
            Self::Length => {
                "the length differs from the ruler: measure it again, and measure ten squares of the calibration board; a wrong square size changes all lengths by the same percentage"
            }
            Self::Sigmas => {
                "the calibrations differ by more than chance: a camera was touched in between, or one calibration was made from too few views or a moving board; make a third calibration"
            }
            Self::Difference => {
                "use the better of the two calibrations, or calibrate again with more views at the working distance"
            }
            Self::Touch => {
                "the touched points disagree with the cameras: check the tool tip entered in the controller, then repeat the hand-eye calibration"
            }
            Self::HandError => {
                "calibrate again, with views at the working distance; the lines above show what is wrong"
            }
        }
    }
}

/// The limits of all checks.
#[derive(Clone, Debug, PartialEq)]
pub struct VerifyLimits {
    limits: [Limit; Check::ALL.len()],
}

impl Default for VerifyLimits {
    fn default() -> Self {
        let limit = |check| match check {
            Check::Reprojection => Limit { good: 0.3, refused: 0.5 },
            Check::Rows => Limit { good: 0.2, refused: 0.3 },
            Check::Scale | Check::Length => Limit { good: 0.3, refused: 1.0 },
            Check::Sigmas => Limit { good: 2.0, refused: 4.0 },
            Check::Difference => Limit { good: 0.5, refused: 2.0 },
            Check::Touch | Check::HandError => Limit { good: 1.0, refused: 3.0 },
        };
        Self { limits: Check::ALL.map(limit) }
    }
}

impl VerifyLimits {
    /// The limit of a check.
    pub fn of(&self, check: Check) -> Limit {
        self.limits[check as usize]
    }

    /// The same limits with the limit of one check replaced.
    ///
    /// # Errors
    /// Numbers that are not finite, negative, or in the wrong order.
    pub fn with(mut self, check: Check, limit: Limit) -> Result<Self, LimitError> {
        self.limits[check as usize] = limit.checked(check.key(), false)?;
        Ok(self)
    }

    /// Judges a value; a value that is not finite is refused.
    pub fn judge(&self, check: Check, measured: f64) -> GateLine {
        let Limit { good, refused } = self.of(check);
        let grade = match measured {
            measured if measured <= good => Grade::Good,
            measured if measured <= refused => Grade::Fair,
            _ => Grade::Refused,
        };
        let (name, advice) = (check.key().to_owned(), check.advice().to_owned());
        GateLine { name, measured, good, refused, grade, advice }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_check_refuses_beyond_its_limit() {
        let limits = VerifyLimits::default();
        for check in Check::ALL {
            let Limit { good, refused } = limits.of(check);
            let grade = |measured| limits.judge(check, measured).grade;
            assert_eq!(grade(good), Grade::Good);
            assert_eq!(grade(0.5 * (good + refused)), Grade::Fair);
            assert_eq!(grade(1.001 * refused), Grade::Refused);
            assert_eq!(grade(f64::NAN), Grade::Refused);
        }
        assert!(limits.clone().with(Check::Rows, Limit { good: 0.4, refused: 0.2 }).is_err());
        assert_eq!(
            limits.with(Check::Rows, Limit { good: 0.1, refused: 0.2 }).map(|l| l.of(Check::Rows).good),
            Ok(0.1)
        );
    }
}
