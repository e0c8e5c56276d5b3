//! A message as it was written.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use mcap::Channel;
use pb3dp_record::regular_file::{RefusedFile, open_regular};

use crate::BagError;

/// Longest record, bytes: longer ones come from damaged lengths. Chosen: an image of [`pb3dp_record::images::PIXELS_MAX`] pixels in
/// four channels has 400 MB. Chunks may be longer: the reader decompresses them record by record.
pub(crate) const RECORD_MAX: usize = 512 << 20;

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
    let file = file.to_path_buf();
    match RefusedFile::of(&source) {
        Some(refused) => BagError::Refused { file, refused: refused.clone() },
        None => BagError::Io { file, doing, source },
    }
}

/// Opens a file of a recording.
pub(crate) fn open(file: &Path) -> Result<File, BagError> {
    open_regular(file).map_err(|source| io(file, "opening", source))
}
