//! Readers and writers of everything that pb3dp keeps in files: calibrations, datasets, images and reports; and the
//! error measures that reports are made of.
//!
//! * [`calibration_files`]: stereo calibrations of ROS, Kalibr, OpenCV and our own;
//! * [`dataset`]: case folders and sequence folders, checked;
//! * [`images`]: images in files;
//! * [`metrics`]: errors against truth, statistics, lag;
//! * [`overlay`]: drawing on images, animated images;
//! * [`image_quality`]: brightness and sharpness of images;
//! * [`plain_zero`]: numbers for people, whose zero has no sign;
//! * [`point_cloud`]: coloured surface points as PLY;
//! * [`stops`]: where arms stood while images were taken, and where they are wanted;
//! * [`report`]: self-contained HTML reports with SVG plots.
//!
//! Files hold millimetres and degrees where people read them; inside everything is metres and radians. This crate
//! estimates nothing, reads no clock and no environment, and touches only the files it is told to.

pub mod calibration_files;
pub mod dataset;
pub mod image_quality;
pub mod images;
pub mod metrics;
pub mod overlay;
pub mod plain_zero;
pub mod point_cloud;
pub mod report;

pub use calibration_files::stops;
