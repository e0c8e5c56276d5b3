//! Conversion of fitted parameters to a stereo rig, and the errors of a fit.

use pb3dp_geometry::{Pose, StereoRig, StereoRigError};

use crate::adjust::{AdjustmentError, State};

/// Minimum number of views for a calibration attempt.
pub const VIEWS_MIN: usize = 3;

/// Why the calibration failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Too few views.
    #[error("only {given} usable views of the board, more than {VIEWS_MIN} are needed, 15 are good; take more images")]
    Views {
        /// Usable views.
        given: usize,
    },
    /// The corners of a view fit no camera.
    #[error(
        "{side}: no focal length fits the detected corners; check the board's numbers of corners, and that all images are from one camera"
    )]
    NoStart {
        /// Which camera.
        side: &'static str,
    },
    /// The images of the pairs show the board in different poses: they were not taken at the same moment.
    #[error(
        "left and right images of the pairs do not belong together ({pairs}): the board turns between them by {angle_deg:.0} degrees from \
         pair to pair{advice}"
    )]
    Pairs {
        /// Names of the pairs.
        pairs: String,
        /// Median difference of the pose between the cameras from its middle, degrees.
        angle_deg: f64,
        /// What fits better, and what to do.
        advice: String,
    },
    /// The adjustment failed.
    #[error(transparent)]
    Adjustment(#[from] AdjustmentError),
    /// The two cameras do not form a valid stereo rig.
    #[error(
        "the two cameras do not form a valid stereo rig; check that the folders of the left and right images are not exchanged"
    )]
    Rig(#[from] StereoRigError),
}

/// The stereo rig of a state with two cameras.
pub(crate) fn rig_of(state: &State) -> Result<StereoRig, FitError> {
    // The states of `Fit<2>` have two cameras; `from_first` is `cam_right_from_cam_left`.
    let cam_right_from_cam_left = Pose::from_isometry(state.from_first[1]);
    Ok(StereoRig::new(state.cameras[0], state.cameras[1], cam_right_from_cam_left)?)
}
