//! The stereo pairs of recordings of every kind: sequence folders, cases (one pair), MCAP files and folders of rosbag2, EuRoC folders and plain
//! folders of images. `docs/recordings.md` describes them.
//!
//! [`RecordedPairs`] reads the images of any pair; [`Kind`] has what the recording states beside them. Images are delivered as they were
//! recorded, not undistorted or rectified.

mod bag;
mod contained;
mod euroc;
mod folder;
mod kind;
mod options;
mod pairs;
mod source;

pub use contained::calibration_of;
pub use kind::{Kind, folder_of};
pub use options::{
    CalibrationOptions, PairsPerSecond, RecordingOptions, SkewMillis, TimedRecordingOptions, Topics, parse_size,
};
pub use pairs::{PERIOD, RecordedPairs};
