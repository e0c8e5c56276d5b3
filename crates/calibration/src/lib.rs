//! Calibrates cameras and stereo heads from images of a board, and judges the result.
//!
//! The way of the data: [`detection::find_board`] finds the corners of a [`board::Board`] in an image,
//! [`fit::Fit`] adjusts all cameras, their poses to each other and the board's poses together, [`held_out::choose`] chooses
//! the lens model by views that the fit has not seen, [`quality::Quality`] puts the result into numbers, and
//! [`gates::Limits`] judges them. Calibrations as files are those of `pb3dp_record::calibration_files`.
//!
//! [`hand_eye`] finds where the cameras sit on a robot.
//!
//! The size of a square cannot be judged by images: with squares that are taken 1 % too large every length is 1 % too
//! long, and all errors stay the same. Measure ten squares with a ruler, and after the calibration a length.
//!
//! This library reads no files and no clock; the program `pb3dp-calibrate`, which `pb3dp calibrate` starts, does. It is a
//! crate of its own so that what finds boards stays out of the real-time program.

mod adjust;
pub mod board;
pub mod coach;
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
