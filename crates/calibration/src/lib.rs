//! Calibrates cameras, stereo rigs and their mounting on a robot from images of a board, and judges the result.
//!
//! Data flow: [`detection::find_board`] detects the corners of a [`board::Board`] in an image. [`fit::Fit`] adjusts all cameras,
//! the pose between the cameras and the board poses together. [`held_out::choose`] selects the lens model by its error on
//! held-out views. [`quality::Quality`] computes the quality figures, and [`gates::Limits`] judges them. Calibration files are
//! read and written by `pb3dp_record::calibration_files`.
//!
//! [`hand_eye`] estimates the pose of the cameras on a robot.
//!
//! Images cannot reveal a wrong square size: if the squares are entered 1 % too large, every length is 1 % too long and all
//! residuals stay the same. Measure ten squares with a ruler, and check a known length after the calibration.
//!
//! Only [`command`], the commands of `pb3dp calibrate`, reads files and the clock.

mod adjust;
pub mod board;
pub mod coach;
pub mod command;
pub mod defects;
mod depth;
pub mod detection;
pub mod fit;
pub mod fitted_rig;
pub mod gates;
pub mod hand_eye;
pub mod held_out;
pub mod ink;
pub mod lens;
pub mod quality;
pub mod report;
pub mod selection;
pub mod sharpness;
pub mod stand;
mod start;
pub mod verify;

pub use adjust::AdjustmentError;
