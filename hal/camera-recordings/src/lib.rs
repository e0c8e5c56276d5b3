//! The stereo pairs of recordings of every kind: sequence folders, cases (one pair), MCAP files and folders of rosbag2, EuRoC folders and plain
//! folders of images. `docs/recordings.md` describes them.
//!
//! [`RecordedPairs`] reads the images of any pair; [`Kind`] has what the recording states beside them. Images are delivered as they were
//! recorded, not undistorted or rectified.

mod bag;
mod euroc;
mod folder;
mod kind;
mod options;
mod pairs;
mod source;

pub use kind::{Kind, calibration_of, folder_of};
pub use options::{RecordingOptions, Topics};
pub use pairs::{PERIOD, RecordedPairs};
