//! Why a recording cannot be used.

use std::net::SocketAddr;
use std::path::PathBuf;

use pb3dp_record::calibration_files::CalibrationFileError;
use pb3dp_record::images::ImageFileError;
use pb3dp_record::regular_file::RefusedFile;

use crate::cdr::CdrError;
use crate::matching::LeftOut;

/// Why a recording cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    /// A file or folder cannot be read or written.
    #[error("{}: {doing} failed; check the path, permissions and free space", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What was attempted.
        doing: &'static str,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// A path that is not a regular file.
    #[error("{}: {refused}", file.display())]
    Refused {
        /// The path.
        file: PathBuf,
        /// What it is.
        refused: RefusedFile,
    },
    /// No MCAP file.
    #[error("{}: is no MCAP file; name a file.mcap, or the folder of a rosbag2 recording with such files", file.display())]
    NoMcap {
        /// The file.
        file: PathBuf,
    },
    /// A rosbag2 recording in SQLite.
    #[error(
        "{}: a rosbag2 recording in SQLite is not read; convert it: pip install rosbags, then rosbags-convert --src BAG --dst NEW --dst-storage mcap",
        file.display()
    )]
    Sqlite {
        /// The file.
        file: PathBuf,
    },
    /// The content is damaged, or of a kind that is not read.
    #[error("{}: damaged after {messages} messages: {why}; `pb3dp recover` copies what comes before", file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Number of messages before.
        messages: u64,
        /// The error of the reader.
        why: String,
    },
    /// A file would be overwritten.
    #[error("{}: exists already; give another name", file.display())]
    Exists {
        /// The file.
        file: PathBuf,
    },
    /// The newest messages are to be kept while they are being written to another file.
    #[error("{}: not written, since another file with the newest messages is still being written; wait until it is whole", file.display())]
    Keeping {
        /// The file that is not written.
        file: PathBuf,
    },
    /// Viewers cannot be served at an address.
    #[error(
        "{address}: viewers cannot be served there; give another address or port with --live, or end the program that uses it"
    )]
    Serve {
        /// The address.
        address: SocketAddr,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The left and the right image topic are not known.
    #[error("{}: {why}; give them with --topics LEFT,RIGHT; topics with images: {known}", file.display())]
    Topics {
        /// The file.
        file: PathBuf,
        /// What is not known.
        why: String,
        /// The topics with images.
        known: String,
    },
    /// A message is not what its topic promises.
    #[error("{topic}, message of {stamp_s:.6} s: {why}; record it again, or leave it out")]
    Message {
        /// The topic.
        topic: String,
        /// Time of the message, seconds.
        stamp_s: f64,
        /// The fault.
        why: CdrError,
    },
    /// The pixels of an image cannot be converted.
    #[error("{topic}, image of {stamp_s:.6} s: {why}")]
    Pixels {
        /// The topic.
        topic: String,
        /// Time of the image, seconds.
        stamp_s: f64,
        /// The fault, and what to do.
        why: String,
    },
    /// An image in the format of an image file cannot be read.
    #[error("{topic}, image of {stamp_s:.6} s")]
    Image {
        /// The topic.
        topic: String,
        /// Time of the image, seconds.
        stamp_s: f64,
        /// The fault.
        #[source]
        source: ImageFileError,
    },
    /// There is no usable calibration in the recording.
    #[error("{}: no calibration in it ({why}); give one with --calib", file.display())]
    NoCalibration {
        /// The file.
        file: PathBuf,
        /// Why not.
        why: String,
    },
    /// There is no such part of the recording.
    #[error("{}: --segment {asked} does not exist: its calibration makes {segments} of it; state one from 1 on", file.display())]
    NoSegment {
        /// The file.
        file: PathBuf,
        /// What was asked for.
        asked: usize,
        /// Number of segments.
        segments: usize,
    },
    /// The calibration in the recording is refused.
    #[error("{}: the calibration in it is refused; give another one with --calib, or exchange the two topics if left and right are exchanged", file.display())]
    Calibration {
        /// The file.
        file: PathBuf,
        /// Why.
        #[source]
        source: CalibrationFileError,
    },
    /// No pair of images with the same time.
    #[error(
        "{}: no image of {left} has one of {right} within {within_ms} ms; state a longer time with --pair-within, or check the clocks of the cameras{}",
        file.display(), left_out.early_end().map(|early| format!("; images left out: {}; {early}", left_out.images)).unwrap_or_default()
    )]
    NoPairs {
        /// The file.
        file: PathBuf,
        /// Topic of the left images.
        left: String,
        /// Topic of the right images.
        right: String,
        /// Longest time between the images of a pair, milliseconds.
        within_ms: f64,
        /// The images.
        left_out: LeftOut,
    },
}
