//! What a calibration must hold when it is verified.

use crate::gates::{Grade, Limit, LimitError};
use crate::report::GateLine;

/// Something that is judged when a calibration is verified; smaller is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// Reprojection of fresh views, only the board's poses fitted.
    Reprojection,
    /// Rows of the rectified images of fresh views.
    Rows,
    /// Lengths on the board against the stated ones at the working distance.
    Scale,
    /// A length that was measured with a ruler.
    Length,
    /// Difference of a second calibration, in units of what both say of their errors.
    Sigmas,
    /// How far both calibrations place a point at the working distance from each other.
    Difference,
    /// Places that were touched.
    Touch,
    /// How far the hand will be off at the working distance.
    HandError,
}

impl Check {
    /// All of them, in the order in which they are told.
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
                "the cameras do not see the board as they did: look for a touched lens or focus, another size of images, or a wrong board; calibrate again"
            }
            Self::Rows => {
                "the cameras have moved against each other, or are not exposed together: fix them and calibrate again"
            }
            Self::Scale => {
                "lengths come out wrong: measure ten squares of the board; if they are right, the cameras have moved against each other: calibrate again"
            }
            Self::Length => {
                "the ruler disagrees: measure the length once more, and ten squares of the board with which was calibrated; a wrong square makes everything wrong by the same share"
            }
            Self::Sigmas => {
                "the calibrations differ by more than chance: a camera was touched in between, or one of them was made from few or moving views; make a third one"
            }
            Self::Difference => {
                "take the better one of both, or calibrate once more with more views at the working distance"
            }
            Self::Touch => {
                "what is touched is not where the cameras say: check that the flange's tool tip is the one that is entered, then do the hand-eye calibration again"
            }
            Self::HandError => {
                "calibrate again, with views at the working distance; see the lines above for what is wrong"
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

    /// The same with another limit of one check.
    ///
    /// # Errors
    /// Numbers that are not finite, negative, or the wrong way round.
    pub fn with(mut self, check: Check, limit: Limit) -> Result<Self, LimitError> {
        self.limits[check as usize] = limit.checked(check.key(), false)?;
        Ok(self)
    }

    /// Judges a number; one that is not finite is refused.
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
