//! The messages of some topics of a file, by its index: the others, such as images, are not read from the disk.
//!
//! MCAP specification, records Chunk, Message Index and Message (<https://mcap.dev/spec>).

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::{Channel, Summary};

use crate::BagError;
use crate::raw::{RECORD_MAX, RawMessage, io, open};

/// Opcode and length before each record, bytes.
const RECORD_HEAD: u64 = 9;
/// Bytes of a chunk record before its messages: times, sizes and check sum, and the empty name of the compression.
const CHUNK_HEAD: u64 = 40;
/// Bytes of a message record before its data.
const MESSAGE_HEAD: usize = 22;
const OP_MESSAGE: u8 = 5;
const OP_INDEX: u8 = 7;

/// Reads picked messages.
pub(crate) struct Picked {
    path: PathBuf,
    file: File,
    /// The chunks that are left, last first: begin of the messages, and place of the index of each wanted channel.
    chunks: Vec<(u64, Vec<u64>)>,
    channels: Vec<(u16, Arc<Channel<'static>>)>,
    /// Places of messages of the present chunk, last first.
    places: Vec<u64>,
    count: u64,
}

impl Picked {
    /// The messages of these topics; `None` if the file is compressed.
    ///
    /// # Errors
    /// If the file cannot be opened.
    pub fn new(path: &Path, summary: &Summary, topics: &[&str]) -> Result<Option<Self>, BagError> {
        if summary.chunk_indexes.iter().any(|chunk| !chunk.compression.is_empty()) {
            return Ok(None);
        }
        let wanted = summary.channels.iter().filter(|(_, channel)| topics.contains(&channel.topic.as_str()));
        let channels: Vec<(u16, Arc<Channel<'static>>)> =
            wanted.map(|(id, channel)| (*id, Arc::clone(channel))).collect();
        let mut chunks: Vec<(u64, Vec<u64>)> = summary
            .chunk_indexes
            .iter()
            .map(|chunk| {
                let index = |(id, _): &(u16, _)| chunk.message_index_offsets.get(id).copied();
                let begin = chunk.chunk_start_offset.saturating_add(RECORD_HEAD + CHUNK_HEAD);
                (begin, channels.iter().filter_map(index).collect())
            })
            .collect();
        chunks.sort_by_key(|(begin, _)| std::cmp::Reverse(*begin));
        let file = open(path)?;
        Ok(Some(Self { path: path.to_path_buf(), file, chunks, channels, places: Vec::new(), count: 0 }))
    }

    fn damaged(&self, why: &str) -> BagError {
        BagError::Damaged { file: self.path.clone(), messages: self.count, why: why.to_owned() }
    }

    fn read(&self, at: u64, length: usize) -> Result<Vec<u8>, BagError> {
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, at).map_err(|source| io(&self.path, "reading", source))?;
        Ok(bytes)
    }

    /// The content of the record at this place.
    fn record(&self, at: u64, opcode: u8) -> Result<Vec<u8>, BagError> {
        let head = self.read(at, RECORD_HEAD as usize)?;
        let length = usize::try_from(number::<8>(&head, 1)).unwrap_or(usize::MAX);
        if head[0] != opcode || length > RECORD_MAX {
            return Err(self.damaged("its index points at something else"));
        }
        self.read(at + RECORD_HEAD, length)
    }

    /// Takes the places of messages in the next chunk.
    fn next_chunk(&mut self) -> Result<bool, BagError> {
        let Some((begin, indexes)) = self.chunks.pop() else { return Ok(false) };
        for at in indexes {
            let index = self.record(at, OP_INDEX)?;
            // Channel and length of the list; then time and place of each message.
            let entries = index.get(6..).unwrap_or_default().as_chunks::<16>().0;
            self.places.extend(entries.iter().map(|entry| begin.saturating_add(number::<8>(entry, 8))));
        }
        self.places.sort_unstable_by_key(|place| std::cmp::Reverse(*place));
        Ok(true)
    }

    fn next_message(&mut self) -> Result<Option<RawMessage>, BagError> {
        let at = loop {
            match self.places.pop() {
                Some(at) => break at,
                None if self.next_chunk()? => {}
                None => return Ok(None),
            }
        };
        let mut record = self.record(at, OP_MESSAGE)?;
        let id = (record.len() >= MESSAGE_HEAD).then(|| number::<2>(&record, 0) as u16);
        let channel = self.channels.iter().find(|(of, _)| Some(*of) == id).map(|(_, channel)| Arc::clone(channel));
        let channel = channel.ok_or_else(|| self.damaged("a message has another channel than its index"))?;
        self.count += 1;
        let sequence = number::<4>(&record, 2) as u32;
        let (log_nanos, publish_nanos) = (number::<8>(&record, 6), number::<8>(&record, 14));
        let data = record.split_off(MESSAGE_HEAD);
        Ok(Some(RawMessage { channel, log_nanos, publish_nanos, sequence, data }))
    }
}

/// A number of `N` bytes, the least significant one first; the bytes are there.
fn number<const N: usize>(bytes: &[u8], at: usize) -> u64 {
    bytes.iter().skip(at).take(N).rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

impl Iterator for Picked {
    type Item = Result<RawMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let read = self.next_message();
        if read.is_err() {
            // Nothing comes after damage.
            (self.chunks, self.places) = (Vec::new(), Vec::new());
        }
        read.transpose()
    }
}
