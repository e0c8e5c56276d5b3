//! A recording in an MCAP file, written by a thread of its own.
//!
//! What a run records goes into a queue of limited size: a slow disk never holds a run up. In real time a message that finds the queue full
//! is dropped and counted; in simulated time the run waits, so that nothing is lost. Every half second all messages so far are handed to
//! the system, so that a kill of the program loses no more.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use pb3dp_geometry::MonotonicTime;

use crate::BagError;
use crate::cdr::to_bytes;
use crate::messages::Message;
use crate::reader::io;

/// Messages in the queue: a second of two cameras and two arms.
const QUEUED_MAX: usize = 1024;
/// Bytes in the queue: four seconds of two raw colour images of 640x480 at 30 Hz.
const QUEUED_BYTES_MAX: u64 = 256 << 20;
/// Time after which messages are handed to the system.
const FLUSH_AFTER: Duration = Duration::from_millis(500);
/// Bytes of a chunk, the unit of the index.
const CHUNK_BYTES: u64 = 4 << 20;

/// Without compression: images of cameras shrink little, and every reader can do without.
pub(crate) fn options() -> WriteOptions {
    WriteOptions::new()
        .compression(None)
        .profile("ros2")
        .library(concat!("pb3dp ", env!("CARGO_PKG_VERSION")))
        .chunk_size(Some(CHUNK_BYTES))
}

/// What happens to a message when the queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// It is dropped and counted: in real time.
    Drop,
    /// The caller waits: in simulated time.
    Wait,
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The file.
    pub file: PathBuf,
    /// Number of messages by topic.
    pub messages: BTreeMap<&'static str, u64>,
    /// Messages that found the queue full, or came after the disk was full.
    pub dropped: u64,
}

/// A message in the queue.
struct Queued {
    topic: &'static str,
    /// Type and definition of the topic.
    schema: fn() -> (String, String),
    at: MonotonicTime,
    data: Vec<u8>,
}

/// A recording that is being written.
#[derive(Debug)]
pub struct BagWriter {
    file: PathBuf,
    queue: Option<SyncSender<Queued>>,
    queued_bytes: Arc<AtomicU64>,
    when_full: WhenFull,
    dropped: u64,
    thread: Option<JoinHandle<Result<BTreeMap<&'static str, u64>, BagError>>>,
}

impl BagWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// A file that exists already or cannot be written.
    pub fn create(file: &Path, when_full: WhenFull) -> Result<Self, BagError> {
        let created = File::create_new(file).map_err(|source| match source.kind() {
            std::io::ErrorKind::AlreadyExists => BagError::Exists { file: file.to_path_buf() },
            _ => io(file, "writing", source),
        })?;
        let writer = options().create(BufWriter::new(created)).map_err(|error| failed(file, error))?;
        let (queue, queued) = sync_channel(QUEUED_MAX);
        let queued_bytes = Arc::new(AtomicU64::new(0));
        let task = Task { file: file.to_path_buf(), writer, queued, queued_bytes: Arc::clone(&queued_bytes) };
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn(move || task.run());
        let thread = thread.map_err(|source| io(file, "starting its thread", source))?;
        Ok(Self {
            file: file.to_path_buf(),
            queue: Some(queue),
            queued_bytes,
            when_full,
            dropped: 0,
            thread: Some(thread),
        })
    }

    /// Puts a message of a topic into the queue; `at` is its time of writing.
    pub fn push<M: Message>(&mut self, topic: &'static str, at: MonotonicTime, message: &M) {
        let Some(queue) = &self.queue else {
            self.dropped += 1;
            return;
        };
        let data = to_bytes(message);
        let bytes = data.len() as u64;
        let queued = Queued { topic, schema: || (M::name(), M::definition()), at, data };
        let before = self.queued_bytes.fetch_add(bytes, Ordering::SeqCst);
        let is_taken = match self.when_full {
            WhenFull::Drop if before + bytes > QUEUED_BYTES_MAX => false,
            WhenFull::Drop => match queue.try_send(queued) {
                Ok(()) => true,
                Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
            },
            WhenFull::Wait => {
                while self.queued_bytes.load(Ordering::SeqCst) > QUEUED_BYTES_MAX && !self.is_over() {
                    std::thread::sleep(Duration::from_millis(1));
                }
                queue.send(queued).is_ok()
            }
        };
        if !is_taken {
            self.queued_bytes.fetch_sub(bytes, Ordering::SeqCst);
            self.dropped += 1;
        }
    }

    /// Whether the thread has ended before [`Self::finish`]: nothing more is recorded.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Writes what is in the queue, the index and the end.
    ///
    /// # Errors
    /// If the file cannot be written, also earlier; what was written until then can be recovered.
    pub fn finish(mut self) -> Result<Written, BagError> {
        let messages = self.join()?;
        Ok(Written { file: self.file.clone(), messages, dropped: self.dropped })
    }

    fn join(&mut self) -> Result<BTreeMap<&'static str, u64>, BagError> {
        // The thread ends when there is no sender any more.
        self.queue = None;
        let Some(thread) = self.thread.take() else { return Ok(BTreeMap::new()) };
        thread.join().unwrap_or_else(|_| Err(io(&self.file, "writing", std::io::Error::other("the recorder panicked"))))
    }
}

impl Drop for BagWriter {
    fn drop(&mut self) {
        // Also after a failure or a panic of the run the file is whole.
        let _ = self.join();
    }
}

fn failed(file: &Path, error: mcap::McapError) -> BagError {
    let source = match error {
        mcap::McapError::Io(source) => source,
        other => std::io::Error::other(other),
    };
    io(file, "writing", source)
}

/// The thread that writes.
struct Task {
    file: PathBuf,
    writer: Writer<BufWriter<File>>,
    queued: Receiver<Queued>,
    queued_bytes: Arc<AtomicU64>,
}

impl Task {
    fn run(mut self) -> Result<BTreeMap<&'static str, u64>, BagError> {
        let file = self.file.clone();
        self.write_all().map_err(|error| failed(&file, error))
    }

    fn write_all(&mut self) -> Result<BTreeMap<&'static str, u64>, mcap::McapError> {
        let mut channels: BTreeMap<&'static str, (u16, u32)> = BTreeMap::new();
        let mut flushed_at = Instant::now();
        loop {
            match self.queued.recv_timeout(FLUSH_AFTER) {
                Ok(queued) => {
                    self.queued_bytes.fetch_sub(queued.data.len() as u64, Ordering::SeqCst);
                    self.write(queued, &mut channels)?;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if flushed_at.elapsed() >= FLUSH_AFTER {
                self.writer.flush()?;
                flushed_at = Instant::now();
            }
        }
        self.writer.finish()?;
        Ok(channels.into_iter().map(|(topic, (_, count))| (topic, u64::from(count))).collect())
    }

    fn write(
        &mut self,
        Queued { topic, schema, at, data }: Queued,
        channels: &mut BTreeMap<&'static str, (u16, u32)>,
    ) -> Result<(), mcap::McapError> {
        let (channel_id, sequence) = match channels.get_mut(topic) {
            Some(channel) => channel,
            None => {
                let (name, definition) = schema();
                let schema = self.writer.add_schema(&name, "ros2msg", definition.as_bytes())?;
                let id = self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new())?;
                channels.entry(topic).or_insert((id, 0))
            }
        };
        *sequence += 1;
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: at.as_nanos(),
            publish_time: at.as_nanos(),
        };
        self.writer.write_to_known_channel(&header, &data)
    }
}
