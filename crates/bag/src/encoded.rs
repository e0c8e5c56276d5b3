//! A message that is encoded once, for the file, the newest seconds in memory and all viewers.

use std::collections::BTreeMap;
use std::sync::Arc;

use pb3dp_geometry::MonotonicTime;

use crate::cdr::to_bytes;
use crate::messages::{CompressedImage, Image, Message};
use crate::topics::describes_the_run;

/// What a message is to those that must drop some.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// It describes the whole run: never dropped, and repeated in each file.
    Description,
    /// An image: dropped before all others.
    Image,
    /// Any other message.
    Other,
}

/// An encoded message of a topic.
#[derive(Debug)]
pub struct Encoded {
    pub(crate) topic: &'static str,
    /// Name and definition of its type.
    pub(crate) schema: fn() -> (String, String),
    pub(crate) at: MonotonicTime,
    /// Number of the message on its topic, from 1.
    pub(crate) sequence: u32,
    pub(crate) kind: Kind,
    pub(crate) data: Vec<u8>,
}

impl Encoded {
    /// Length of the encoded message, bytes.
    pub(crate) fn bytes(&self) -> u64 {
        self.data.len() as u64
    }

    pub(crate) fn describes_the_run(&self) -> bool {
        self.kind == Kind::Description
    }
}

/// Encodes messages and numbers them by topic.
#[derive(Debug, Default)]
pub struct Encoder {
    sequences: BTreeMap<&'static str, u32>,
}

impl Encoder {
    /// Encodes a message of a topic; `at` is its time of writing.
    pub fn encode<M: Message>(&mut self, topic: &'static str, at: MonotonicTime, message: &M) -> Arc<Encoded> {
        let sequence = self.sequences.entry(topic).or_insert(0);
        *sequence = sequence.wrapping_add(1);
        let name = M::name();
        let kind = if describes_the_run(topic) {
            Kind::Description
        } else if name == Image::name() || name == CompressedImage::name() {
            Kind::Image
        } else {
            Kind::Other
        };
        let schema = || (M::name(), M::definition());
        Arc::new(Encoded { topic, schema, at, sequence: *sequence, kind, data: to_bytes(message) })
    }
}

/// The newest message of each topic that describes the whole run.
///
/// A later message of a topic replaces the earlier one, as a latched topic of ROS 2 with a depth of 1 does: a message of `/tf_static` holds
/// all transforms that do not change.
#[derive(Clone, Debug, Default)]
pub(crate) struct Description {
    newest: BTreeMap<&'static str, Arc<Encoded>>,
}

impl Description {
    /// Takes a message if it describes the run.
    pub(crate) fn update(&mut self, message: &Arc<Encoded>) {
        if message.describes_the_run() {
            self.newest.insert(message.topic, Arc::clone(message));
        }
    }

    pub(crate) fn of(&self, topic: &str) -> Option<&Arc<Encoded>> {
        self.newest.get(topic)
    }

    pub(crate) fn messages(&self) -> impl Iterator<Item = &Arc<Encoded>> {
        self.newest.values()
    }
}
