//! Recordings in MCAP files with ROS 2 messages: what a run writes, and what other programs have recorded.
//!
//! * [`cdr`]: the encoding of the messages;
//! * [`messages`]: the messages of ROS 2 and their definitions;
//! * [`run_messages`]: messages of our own, which a replay needs;
//! * [`encoded`]: a message that is encoded once, for all that take it;
//! * [`sinks`]: all of these that take the messages of a run;
//! * [`writer`]: a recording that is written by a thread of its own;
//! * [`recent`]: the newest seconds of a run, kept in a file at a fault;
//! * [`live`]: a run for viewers, while it goes on;
//! * [`reader`]: the messages of a file, also of one that was broken off;
//! * [`pairs`]: the stereo pairs and the calibration of a recording;
//! * [`segments`]: its parts with one calibration;
//! * [`stops`]: the stops of an arm, for a calibration;
//! * [`recover`]: a whole file from one that was broken off.
//!
//! A file holds nothing but ROS 2 messages in CDR, so that every viewer and library that knows ROS 2 reads it (ADR 18). It is the format
//! `mcap` of rosbag2 (ROS 2 documentation, "rosbag2_storage_mcap"; MCAP specification, <https://mcap.dev/spec>).

mod backlog;
pub mod cdr;
mod chunk_limit;
mod codes;
pub mod encoded;
mod error;
pub mod live;
pub mod matching;
mod mcap_file;
pub mod messages;
pub mod pairs;
mod picked;
mod pixels;
mod queue;
mod raw;
pub mod reader;
pub mod recent;
pub mod recover;
pub mod run_messages;
pub mod segments;
pub mod sinks;
pub mod stops;
pub mod topics;
pub mod writer;

pub use error::BagError;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
