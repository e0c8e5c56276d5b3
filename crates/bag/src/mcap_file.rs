//! One MCAP file that is being written.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use pb3dp_geometry::MonotonicTime;

use crate::BagError;
use crate::encoded::Encoded;
use crate::reader::io;

/// Bytes of a chunk, the unit of the index.
const CHUNK_BYTES: u64 = 4 << 20;
/// Bytes that a message takes besides its own: head of the record 9, header of the message 22, index 16 (MCAP specification).
const MESSAGE_BYTES: u64 = 9 + 22 + 16;

/// Without compression: images of cameras shrink little, and every reader can do without.
pub(crate) fn options() -> WriteOptions {
    WriteOptions::new()
        .compression(None)
        .profile("ros2")
        .library(concat!("pb3dp ", env!("CARGO_PKG_VERSION")))
        .chunk_size(Some(CHUNK_BYTES))
}

/// Creates a file that does not exist yet.
pub(crate) fn create_new(file: &Path) -> Result<File, BagError> {
    File::create_new(file).map_err(|source| match source.kind() {
        std::io::ErrorKind::AlreadyExists => BagError::Exists { file: file.to_path_buf() },
        _ => io(file, "writing", source),
    })
}

pub(crate) struct McapFile {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: BTreeMap<&'static str, u16>,
    bytes: u64,
}

impl McapFile {
    pub(crate) fn create(path: &Path) -> Result<Self, BagError> {
        let writer = options().create(BufWriter::new(create_new(path)?)).map_err(|error| failed(path, error))?;
        Ok(Self { path: path.to_path_buf(), writer, channels: BTreeMap::new(), bytes: 0 })
    }

    /// Bytes with one message more.
    pub(crate) fn bytes_with(&self, message: &Encoded) -> u64 {
        self.bytes + message.bytes() + MESSAGE_BYTES
    }

    pub(crate) fn write(&mut self, message: &Encoded) -> Result<(), BagError> {
        self.write_at(message, message.at)
    }

    /// Writes a message that was first written earlier: its time of sending stays as it was.
    pub(crate) fn write_at(&mut self, message: &Encoded, log_at: MonotonicTime) -> Result<(), BagError> {
        self.bytes = self.bytes_with(message);
        self.try_write(message, log_at).map_err(|error| failed(&self.path, error))
    }

    fn try_write(&mut self, message: &Encoded, log_at: MonotonicTime) -> Result<(), McapError> {
        let channel_id = match self.channels.get(message.topic) {
            Some(id) => *id,
            None => {
                let (name, definition) = (message.schema)();
                let schema = self.writer.add_schema(&name, "ros2msg", definition.as_bytes())?;
                let id = self.writer.add_channel(schema, message.topic, "cdr", &BTreeMap::new())?;
                self.channels.insert(message.topic, id);
                id
            }
        };
        let header = MessageHeader {
            channel_id,
            sequence: message.sequence,
            log_time: log_at.as_nanos(),
            publish_time: message.at.as_nanos(),
        };
        self.writer.write_to_known_channel(&header, &message.data)
    }

    /// Hands all messages so far to the system.
    pub(crate) fn flush(&mut self) -> Result<(), BagError> {
        self.writer.flush().map_err(|error| failed(&self.path, error))
    }

    /// Writes the index and the end.
    pub(crate) fn finish(mut self) -> Result<File, BagError> {
        self.writer.finish().map_err(|error| failed(&self.path, error))?;
        let buffered = self.writer.into_inner();
        buffered.into_inner().map_err(|error| io(&self.path, "writing", error.into_error()))
    }
}

fn failed(file: &Path, error: McapError) -> BagError {
    let source = match error {
        McapError::Io(source) => source,
        other => std::io::Error::other(other),
    };
    io(file, "writing", source)
}
