//! From fitted parameters to a rig, and why a fit fails.

use pb3dp_geometry::{Pose, StereoRig, StereoRigError};

use crate::adjust::{AdjustmentError, State};

/// The fewest views of which a calibration is tried.
pub const VIEWS_MIN: usize = 3;

/// Why no calibration came of the views.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Too few views.
    #[error("{seen} views of the board can be used, more than {VIEWS_MIN} are needed, 15 are good: take more images")]
    Views {
        /// Views that can be used.
        seen: usize,
    },
    /// No camera explains a view.
    #[error(
        "{side}: no focal length explains what the views show: check the numbers of the board's corners and that all images are of one camera"
    )]
    NoStart {
        /// Which camera.
        side: &'static str,
    },
    /// The adjustment failed.
    #[error(transparent)]
    Adjustment(#[from] AdjustmentError),
    /// The cameras are no stereo head.
    #[error("the cameras are no stereo head; check that the folders of the left and right images are not exchanged")]
    Rig(#[from] StereoRigError),
}

/// The stereo head of a state with two cameras.
pub(crate) fn rig_of(state: &State) -> Result<StereoRig, FitError> {
    // The states of `Fit<2>` have two cameras, and `from_first` is `cam_right_from_cam_left` there.
    let cam_right_from_cam_left = Pose::from_isometry(state.from_first[1]);
    Ok(StereoRig::new(state.cameras[0], state.cameras[1], cam_right_from_cam_left)?)
}
