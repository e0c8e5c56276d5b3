//! Readers and writers of all pb3dp files: calibrations, datasets, images and reports; and the error measures used in reports.
//!
//! * [`calibration_files`]: stereo calibrations of ROS, Kalibr, OpenCV and our own;
//! * [`dataset`]: case folders and sequence folders, checked;
//! * [`images`]: images in files;
//! * [`metrics`]: errors against ground truth, statistics, lag;
//! * [`overlay`]: drawing on images, animated images;
//! * [`image_quality`]: brightness and sharpness of images;
//! * [`parquet_table`]: tables as Parquet files;
//! * [`plain_zero`]: display of numbers without negative zero;
//! * [`point_cloud`]: coloured surface points as PLY;
//! * [`stops`]: arm poses recorded with images, and poses to visit;
//! * [`regular_file`]: regular files only, up to a size;
//! * [`report`]: self-contained HTML reports with SVG plots;
//! * [`unique_json`]: JSON in which no key is repeated;
//! * [`value_range`]: images with more than 8 bits per channel.
//!
//! Files that people read hold millimetres and degrees; all internal values are metres and radians. This crate estimates nothing,
//! reads no clock and no environment, and accesses only the given files.

pub mod calibration_files;
mod codes;
pub mod dataset;
pub mod estimates_csv;
pub mod image_quality;
pub mod images;
pub mod metrics;
pub mod overlay;
pub mod parquet_table;
pub mod plain_zero;
pub mod point_cloud;
pub mod recorded_exposure;
pub mod regular_file;
pub mod report;
pub mod text_file;
pub mod unique_json;
pub mod value_range;

pub use calibration_files::stops;
