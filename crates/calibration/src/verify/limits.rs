//! Checks of an existing calibration: the limits, and the advice if one is exceeded.

use crate::gates::{Gate, Limits};

/// Reprojection error of new views, with only the board poses fitted.
pub const REPROJECTION: Gate = Gate::at_most(
    "reprojection_rms_px",
    [0.3, 0.5],
    "the cameras no longer match the calibration: check for a touched lens or focus, a different image size, or a wrong board; calibrate again",
);

/// Vertical misalignment (epipolar error) of the rectified images in new views.
pub const ROWS: Gate = Gate::at_most(
    "row_error_rms_px",
    [0.2, 0.3],
    "the cameras have moved relative to each other, or their exposures are not synchronised: fix them and calibrate again",
);

/// Lengths on the board compared with the stated ones, at the working distance.
pub const SCALE: Gate = Gate::at_most(
    "scale_percent",
    [0.3, 1.0],
    "lengths on the board are wrong: measure ten squares of the board; if --square is correct, the cameras have moved relative to each other: calibrate again",
);

/// A length measured with a ruler.
pub const LENGTH: Gate = Gate::at_most(
    "length_percent",
    [0.3, 1.0],
    "the length differs from the ruler: measure it again, and measure ten squares of the calibration board; a wrong square size changes all lengths by the same percentage",
);

/// Difference from a second calibration, in standard deviations.
pub const SIGMAS: Gate = Gate::at_most(
    "difference_sigmas",
    [2.0, 4.0],
    "the calibrations differ by more than chance: a camera was touched in between, or one calibration was made from too few views or a moving board; make a third calibration",
);

/// Distance between the positions that both calibrations compute for a point at the working distance.
pub const DIFFERENCE: Gate = Gate::at_most(
    "difference_p95_mm",
    [0.5, 2.0],
    "use the better of the two calibrations, or calibrate again with more views at the working distance",
);

/// Points touched with the arm.
pub const TOUCH: Gate = Gate::at_most(
    "touch_mm",
    [1.0, 3.0],
    "the touched points disagree with the cameras: check the tool tip entered in the controller, then repeat the hand-eye calibration",
);

/// Expected hand error at the working distance.
pub const HAND_ERROR: Gate = Gate::at_most(
    "hand_error_mm",
    [1.0, 3.0],
    "calibrate again, with views at the working distance; the lines above show what is wrong",
);

impl Limits {
    /// The checks of an existing calibration, as in `configs/calibration_verify.toml`.
    pub fn of_checks() -> Self {
        Self::built_in("checks", &[REPROJECTION, ROWS, SCALE, LENGTH, SIGMAS, DIFFERENCE, TOUCH, HAND_ERROR])
    }
}
