//! Everything that takes the messages of a run: the recording, the newest seconds, and viewers. A message is encoded once.

use std::path::Path;
use std::sync::Arc;

use pb3dp_geometry::MonotonicTime;

use crate::BagError;
use crate::encoded::Encoder;
use crate::live::Live;
use crate::messages::Message;
use crate::recent::{Keeping, Kept, Recent};
use crate::writer::{BagWriter, Written};

/// All that take the messages of a run.
#[derive(Debug, Default)]
pub struct Sinks {
    encoder: Encoder,
    writer: Option<BagWriter>,
    recent: Option<Recent>,
    live: Option<Live>,
    keeping: Vec<Keeping>,
}

/// What has come of the messages.
#[derive(Debug)]
pub struct Finished {
    /// What was recorded, if a recording was requested.
    pub written: Option<Result<Written, BagError>>,
    /// What was kept at faults.
    pub kept: Vec<Result<Kept, BagError>>,
    /// Messages that are missing in the newest seconds.
    pub recent_dropped: u64,
    /// Messages that reached no viewer.
    pub live_dropped: u64,
}

impl Sinks {
    /// Hands messages to those that are requested.
    pub fn new(writer: Option<BagWriter>, recent: Option<Recent>, live: Option<Live>) -> Self {
        Self { encoder: Encoder::default(), writer, recent, live, keeping: Vec::new() }
    }

    /// Hands a message of a topic to all; `at` is its time of writing. A message that nobody needs is not even encoded.
    pub fn push<M: Message>(&mut self, topic: &'static str, at: MonotonicTime, message: &M) {
        let is_needed = self.writer.is_some() || self.recent.is_some();
        if !is_needed && !self.live.as_ref().is_some_and(|live| live.needs(topic)) {
            return;
        }
        let message = self.encoder.encode(topic, at, message);
        if let Some(recent) = &mut self.recent {
            recent.push(&message);
        }
        if let Some(live) = &mut self.live {
            live.push(&message);
        }
        if let Some(writer) = &mut self.writer {
            writer.push_encoded(Arc::clone(&message));
        }
    }

    /// Whether the recording has ended before [`Self::finish`]: its file cannot be written any more.
    pub fn is_over(&self) -> bool {
        self.writer.as_ref().is_some_and(BagWriter::is_over)
    }

    /// The server of viewers.
    pub fn live(&self) -> Option<&Live> {
        self.live.as_ref()
    }

    /// Starts to write the newest seconds to a new file, and returns at once. [`Self::finish`] gives the result. Does nothing if they are
    /// not held.
    ///
    /// # Errors
    /// If another file with them is still being written.
    pub fn keep(&mut self, file: &Path) -> Result<(), BagError> {
        if let Some(recent) = &self.recent {
            self.keeping.push(recent.keep(file)?);
        }
        Ok(())
    }

    /// Finishes all files.
    pub fn finish(self) -> Finished {
        let Self { writer, recent, live, keeping, .. } = self;
        Finished {
            written: writer.map(BagWriter::finish),
            kept: keeping.into_iter().map(Keeping::finish).collect(),
            recent_dropped: recent.map_or(0, |recent| recent.dropped()),
            live_dropped: live.map_or(0, |live| live.dropped()),
        }
    }
}
