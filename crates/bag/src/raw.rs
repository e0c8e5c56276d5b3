//! A message as it was written.

use std::path::Path;
use std::sync::Arc;

use mcap::Channel;

use crate::BagError;

/// Longest record, bytes: longer ones come from damaged lengths.
pub(crate) const RECORD_MAX: usize = 1 << 30;

/// Messages of a recording.
pub type Messages = Box<dyn Iterator<Item = Result<RawMessage, BagError>> + Send>;

/// A message as it was written.
#[derive(Clone, Debug)]
pub struct RawMessage {
    /// Its topic with the type.
    pub channel: Arc<Channel<'static>>,
    /// Time of writing, nanoseconds.
    pub log_nanos: u64,
    /// Time of sending, nanoseconds.
    pub publish_nanos: u64,
    /// Number of the message on its topic, if the writer counts.
    pub sequence: u32,
    /// The encoded message.
    pub data: Vec<u8>,
}

/// A failure of the system with a file.
pub(crate) fn io(file: &Path, doing: &'static str, source: std::io::Error) -> BagError {
    BagError::Io { file: file.to_path_buf(), doing, source }
}
