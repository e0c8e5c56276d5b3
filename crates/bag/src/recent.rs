//! The newest seconds of a run in memory, written to a file when they are needed: after a fault.
//!
//! A thread of its own holds the messages, another one writes them: neither [`Recent::push`] nor [`Recent::keep`] waits for a disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use crate::BagError;
use crate::backlog::{Backlog, Limits};
use crate::encoded::{Description, Encoded};
use crate::mcap_file::McapFile;
use crate::queue::{Receiver, Sender, WhenFull, bounded};
use crate::reader::io;

/// Messages on their way to the thread that holds them: a second of two cameras and two arms.
const QUEUED_MAX: u64 = 1024;
/// Bytes on their way to the thread that holds them.
const QUEUED_BYTES_MAX: u64 = 64 << 20;

/// How much is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecentOptions {
    /// Time of writing up to the newest message.
    pub duration: Duration,
    /// Memory for messages, bytes. When it is exceeded, the oldest images are dropped first, then the oldest of all others. The newest two
    /// images and the messages that describe the whole run do not count and always stay. While a file is written, its messages take as much
    /// again.
    pub bytes_max: u64,
    /// What happens to a message when its thread lags behind.
    pub when_full: WhenFull,
}

impl Default for RecentOptions {
    /// 30 s of everything but images; of two raw colour images of 640x480 at 30 Hz, 9 s; of compressed ones, 30 s.
    fn default() -> Self {
        Self { duration: Duration::from_secs(30), bytes_max: 512 << 20, when_full: WhenFull::Drop }
    }
}

/// What was written to a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kept {
    /// The file.
    pub file: PathBuf,
    /// Number of messages, with those that describe the run.
    pub messages: u64,
    /// Time of writing from the first to the last message.
    pub duration: Duration,
}

/// A file that is being written by a thread of its own.
#[derive(Debug)]
pub struct Keeping {
    file: PathBuf,
    result: mpsc::Receiver<Result<Kept, BagError>>,
}

impl Keeping {
    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Waits until the file is whole and on the disk.
    ///
    /// # Errors
    /// A file that exists already or cannot be written.
    pub fn finish(self) -> Result<Kept, BagError> {
        let ended = || Err(io(&self.file, "writing", std::io::Error::other("its thread has ended")));
        self.result.recv().unwrap_or_else(|_| ended())
    }
}

/// The newest messages of a run.
///
/// When it is dropped, it waits for a file that is being written.
#[derive(Debug)]
pub struct Recent {
    queue: Option<Sender<Order>>,
    when_full: WhenFull,
    dropped: u64,
    is_writing: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
enum Order {
    Hold(Arc<Encoded>),
    Keep { file: PathBuf, result: mpsc::Sender<Result<Kept, BagError>>, writing: Writing },
}

/// Exists as long as a file is written.
#[derive(Debug)]
struct Writing(Arc<AtomicBool>);

impl Drop for Writing {
    fn drop(&mut self) {
        self.0.store(false, Ordering::SeqCst);
    }
}

impl Recent {
    /// Starts the thread that holds the messages.
    ///
    /// # Errors
    /// If the system starts no thread.
    pub fn start(options: RecentOptions) -> Result<Self, BagError> {
        let (queue, orders) = bounded(QUEUED_MAX, QUEUED_BYTES_MAX);
        let limits = Limits { bytes_max: options.bytes_max, duration_max: Some(options.duration) };
        let thread = std::thread::Builder::new().name("recent".to_owned()).spawn(move || hold(&orders, limits));
        let thread = thread.map_err(|source| io(Path::new("recent messages"), "starting their thread", source))?;
        Ok(Self {
            queue: Some(queue),
            when_full: options.when_full,
            dropped: 0,
            is_writing: Arc::default(),
            thread: Some(thread),
        })
    }

    /// Adds a message.
    pub fn push(&mut self, message: &Arc<Encoded>) {
        // A description is small, rare, and never dropped.
        let bytes = message.bytes();
        let hold = Order::Hold(Arc::clone(message));
        let is_sent = match &self.queue {
            Some(queue) if message.describes_the_run() => queue.put(hold, bytes),
            Some(queue) => queue.send(hold, bytes, self.when_full),
            None => false,
        };
        self.dropped += u64::from(!is_sent);
    }

    /// Messages that were not held since the thread lagged behind.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Starts to write all messages so far to a new file, and returns at once.
    ///
    /// # Errors
    /// If another file is still being written: its messages take the memory.
    pub fn keep(&self, file: &Path) -> Result<Keeping, BagError> {
        if self.is_writing.swap(true, Ordering::SeqCst) {
            return Err(BagError::Keeping { file: file.to_path_buf() });
        }
        let writing = Writing(Arc::clone(&self.is_writing));
        let (sender, result) = mpsc::channel();
        let order = Order::Keep { file: file.to_path_buf(), result: sender, writing };
        // If the thread has ended, the result says so.
        let _ = self.queue.as_ref().map(|queue| queue.put(order, 0));
        Ok(Keeping { file: file.to_path_buf(), result })
    }
}

impl Drop for Recent {
    fn drop(&mut self) {
        self.queue = None;
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// The thread that holds the messages.
fn hold(orders: &Receiver<Order>, limits: Limits) {
    let mut backlog = Backlog::new(limits);
    let mut description = Description::default();
    let mut writer: Option<JoinHandle<()>> = None;
    while let Some(order) = orders.recv() {
        match order {
            Order::Hold(message) if message.describes_the_run() => description.update(&message),
            Order::Hold(message) => backlog.push(message),
            Order::Keep { file, result, writing } => {
                let (description, messages) = (description.clone(), backlog.messages());
                let at_failure = (file.clone(), result.clone());
                let write = move || {
                    let kept = write(&file, &description, &messages);
                    // The next file may begin as soon as the memory is free.
                    drop((messages, writing));
                    let _ = result.send(kept);
                };
                // The one before has ended, or is about to.
                let _ = writer.take().map(JoinHandle::join);
                match std::thread::Builder::new().name("keeper".to_owned()).spawn(write) {
                    Ok(thread) => writer = Some(thread),
                    Err(source) => {
                        let (file, result) = at_failure;
                        let _ = result.send(Err(io(&file, "starting its thread", source)));
                    }
                }
            }
        }
    }
    let _ = writer.map(JoinHandle::join);
}

fn write(file: &Path, description: &Description, messages: &[Arc<Encoded>]) -> Result<Kept, BagError> {
    let mut open = McapFile::create(file)?;
    let mut count = 0;
    let times = || messages.iter().map(|message| message.at);
    for message in description.messages() {
        open.write_at(message, messages.first().map_or(message.at, |first| first.at))?;
        count += 1;
    }
    for message in messages {
        open.write(message)?;
        count += 1;
    }
    // A fault may be followed by a loss of power.
    open.finish()?.sync_all().map_err(|source| io(file, "writing", source))?;
    let duration =
        times().max().zip(times().min()).map_or(Duration::ZERO, |(last, first)| last.saturating_since(first));
    Ok(Kept { file: file.to_path_buf(), messages: count, duration })
}
