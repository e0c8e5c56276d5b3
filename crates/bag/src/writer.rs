//! A recording in MCAP files, written by a thread of its own.
//!
//! What a run records goes into a queue of limited size: a slow disk never holds a run up. In real time a message that finds the queue full
//! is dropped and counted; in simulated time the run waits, so that nothing is lost. Every half second all messages so far are handed to
//! the system, so that a kill of the program loses no more.
//!
//! A long recording can be divided ([`Rotation`]): `run.mcap` is continued by `run_001.mcap`, `run_002.mcap` and so on. Each file opens by
//! itself, since it begins with the messages that describe the whole run; all others are in exactly one file.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_geometry::MonotonicTime;

use crate::BagError;
use crate::encoded::{Description, Encoded, Encoder};
use crate::mcap_file::McapFile;
use crate::messages::Message;
use crate::queue::{Receiver, Sender, bounded};
use crate::reader::io;

pub use crate::queue::WhenFull;

/// Messages in the queue: eight seconds of two cameras and two arms. Large ones are limited by their bytes first, so that a disk that
/// stalls costs images, but no control step.
const QUEUED_MAX: u64 = 8192;
/// Bytes in the queue: four seconds of two raw colour images of 640x480 at 30 Hz.
const QUEUED_BYTES_MAX: u64 = 256 << 20;
/// Time after which messages are handed to the system.
const FLUSH_AFTER: Duration = Duration::from_millis(500);

/// When a recording goes on in another file. Without limits it is one file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rotation {
    /// Bytes of a file; at most 10 kB more, for names and the end. A message that would not fit begins the next file; a file with a single
    /// longer message is longer.
    pub bytes_max: Option<u64>,
    /// Time of writing from the first message of a file; the message at this time begins the next file. Messages that describe the whole
    /// run do not count.
    pub duration_max: Option<Duration>,
}

impl Rotation {
    fn is_one_file(&self) -> bool {
        self.bytes_max.is_none() && self.duration_max.is_none()
    }
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The file; the first one of a divided recording.
    pub file: PathBuf,
    /// All files in their order.
    pub files: Vec<PathBuf>,
    /// Number of messages by topic, without those that are repeated in later files.
    pub messages: BTreeMap<&'static str, u64>,
    /// Messages that found the queue full, or came after the disk was full.
    pub dropped: u64,
}

/// What the thread has written.
type Done = Result<(Vec<PathBuf>, BTreeMap<&'static str, u64>), BagError>;

/// A recording that is being written.
#[derive(Debug)]
pub struct BagWriter {
    file: PathBuf,
    encoder: Encoder,
    queue: Option<Sender<Arc<Encoded>>>,
    when_full: WhenFull,
    dropped: u64,
    thread: Option<JoinHandle<Done>>,
}

impl BagWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// A file that exists already or cannot be written.
    pub fn create(file: &Path, when_full: WhenFull) -> Result<Self, BagError> {
        Self::create_rotating(file, when_full, Rotation::default())
    }

    /// Creates the first file of a recording that goes on in further files beside it.
    ///
    /// # Errors
    /// A file, or one of its continuations, that exists already or cannot be written.
    pub fn create_rotating(file: &Path, when_full: WhenFull, rotation: Rotation) -> Result<Self, BagError> {
        if !rotation.is_one_file() {
            refuse_continuations(file)?;
        }
        let open = McapFile::create(file)?;
        let (queue, queued) = bounded(QUEUED_MAX, QUEUED_BYTES_MAX);
        let task = Task {
            files: vec![file.to_path_buf()],
            open,
            rotation,
            first_at: None,
            counts: BTreeMap::new(),
            description: Description::default(),
        };
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn(move || task.run(&queued));
        let thread = thread.map_err(|source| io(file, "starting its thread", source))?;
        Ok(Self {
            file: file.to_path_buf(),
            encoder: Encoder::default(),
            queue: Some(queue),
            when_full,
            dropped: 0,
            thread: Some(thread),
        })
    }

    /// Puts a message of a topic into the queue; `at` is its time of writing.
    pub fn push<M: Message>(&mut self, topic: &'static str, at: MonotonicTime, message: &M) {
        let message = self.encoder.encode(topic, at, message);
        self.push_encoded(message);
    }

    /// Puts an encoded message into the queue; one that describes the whole run is not dropped.
    pub fn push_encoded(&mut self, message: Arc<Encoded>) {
        let bytes = message.bytes();
        let is_taken = match &self.queue {
            Some(queue) if message.describes_the_run() => queue.put(message, bytes),
            Some(queue) => queue.send(message, bytes, self.when_full),
            None => false,
        };
        self.dropped += u64::from(!is_taken);
    }

    /// Whether the thread has ended before [`Self::finish`]: nothing more is recorded.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Writes what is in the queue, the index and the end.
    ///
    /// # Errors
    /// If a file cannot be written, also earlier; what was written until then can be recovered.
    pub fn finish(mut self) -> Result<Written, BagError> {
        let (files, messages) = self.join()?;
        Ok(Written { file: self.file.clone(), files, messages, dropped: self.dropped })
    }

    fn join(&mut self) -> Done {
        // The thread ends when there is no sender any more.
        self.queue = None;
        let Some(thread) = self.thread.take() else { return Ok((Vec::new(), BTreeMap::new())) };
        thread.join().unwrap_or_else(|_| Err(io(&self.file, "writing", std::io::Error::other("the recorder panicked"))))
    }
}

impl Drop for BagWriter {
    fn drop(&mut self) {
        // Also after a failure or a panic of the run the file is whole.
        let _ = self.join();
    }
}

/// The name of the n-th continuation. Three digits keep the order of names up to 999 files where names are compared as text; [`Bag::open`]
/// compares numbers by value, and `rosbags` orders files by their times.
///
/// [`Bag::open`]: crate::reader::Bag::open
fn continuation(file: &Path, number: usize) -> PathBuf {
    let mut name = OsString::from(file.file_stem().unwrap_or_default());
    name.push(format!("_{number:03}"));
    if let Some(extension) = file.extension() {
        name.push(".");
        name.push(extension);
    }
    file.with_file_name(name)
}

/// Files of an earlier recording would be taken for continuations of this one.
fn refuse_continuations(file: &Path) -> Result<(), BagError> {
    let folder = file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned() + "_";
    for entry in std::fs::read_dir(folder).map_err(|source| io(folder, "reading the folder", source))? {
        let other = entry.map_err(|source| io(folder, "reading the folder", source))?.path();
        let name = other.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = name.strip_prefix(&stem).unwrap_or_default();
        if other.extension() == file.extension() && number.parse::<u64>().is_ok() {
            return Err(BagError::Exists { file: other });
        }
    }
    Ok(())
}

/// The thread that writes.
struct Task {
    /// The last one is open.
    files: Vec<PathBuf>,
    open: McapFile,
    rotation: Rotation,
    /// Time of the first message of the open file that does not describe the run.
    first_at: Option<MonotonicTime>,
    counts: BTreeMap<&'static str, u64>,
    description: Description,
}

impl Task {
    fn run(mut self, queued: &Receiver<Arc<Encoded>>) -> Done {
        let mut flushed_at = Instant::now();
        loop {
            match queued.recv_timeout(FLUSH_AFTER) {
                Ok(message) => self.write(&message)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if flushed_at.elapsed() >= FLUSH_AFTER {
                self.open.flush()?;
                flushed_at = Instant::now();
            }
        }
        self.open.finish()?;
        Ok((self.files, self.counts))
    }

    fn write(&mut self, message: &Arc<Encoded>) -> Result<(), BagError> {
        self.description.update(message);
        if !message.describes_the_run() {
            if self.first_at.is_some_and(|first_at| self.is_full(first_at, message)) {
                self.rotate(message.at)?;
            }
            self.first_at.get_or_insert(message.at);
        }
        *self.counts.entry(message.topic).or_insert(0) += 1;
        self.open.write(message)
    }

    fn is_full(&self, first_at: MonotonicTime, next: &Encoded) -> bool {
        let Rotation { bytes_max, duration_max } = self.rotation;
        bytes_max.is_some_and(|max| self.open.bytes_with(next) > max)
            || duration_max.is_some_and(|max| next.at.saturating_since(first_at) >= max)
    }

    /// Goes on in the next file, whose first messages describe the run.
    fn rotate(&mut self, at: MonotonicTime) -> Result<(), BagError> {
        let path = continuation(&self.files[0], self.files.len());
        let finished = std::mem::replace(&mut self.open, McapFile::create(&path)?);
        self.files.push(path);
        self.first_at = None;
        finished.finish()?;
        self.description.messages().try_for_each(|message| self.open.write_at(message, at))
    }
}
