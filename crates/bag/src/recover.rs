//! A whole file from one that was broken off, by a kill or a full disk.

use std::io::BufWriter;
use std::path::Path;

use crate::BagError;
use crate::mcap_file::{create_new, options};
use crate::reader::{Bag, io};

/// What was recovered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recovered {
    /// Number of messages.
    pub messages: u64,
    /// From the first message to the last one, nanoseconds.
    pub duration_nanos: u64,
    /// Whether the file was broken off.
    pub was_unfinished: bool,
    /// Damage in a file with an end: what follows is not recovered.
    pub damage: Option<String>,
}

/// Copies every whole message of a recording into a new file with index and end. The recording stays as it is.
///
/// # Errors
/// A file that is no recording, or a new file that exists or cannot be written.
pub fn recover(from: &Path, to: &Path) -> Result<Recovered, BagError> {
    let bag = Bag::open(from)?;
    let created = create_new(to)?;
    let failed = |error: mcap::McapError| io(to, "writing", std::io::Error::other(error));
    let mut writer = options().create(BufWriter::new(created)).map_err(failed)?;
    let mut times: Option<(u64, u64)> = None;
    let (mut messages, mut damage) = (0, None);
    for message in bag.messages() {
        let message = match message {
            Ok(message) => message,
            // What comes before is kept.
            Err(BagError::Damaged { why, .. }) => {
                damage = Some(why);
                break;
            }
            Err(error) => return Err(error),
        };
        let at = message.log_nanos;
        times = Some(times.map_or((at, at), |(first, last)| (first.min(at), last.max(at))));
        messages += 1;
        let written = writer.write(&mcap::Message {
            channel: message.channel,
            sequence: message.sequence,
            log_time: message.log_nanos,
            publish_time: message.publish_nanos,
            data: message.data.into(),
        });
        written.map_err(failed)?;
    }
    writer.finish().map_err(failed)?;
    let written = writer.into_inner().into_inner().map_err(|error| io(to, "writing", error.into_error()))?;
    written.sync_all().map_err(|source| io(to, "writing", source))?;
    Ok(Recovered {
        messages,
        duration_nanos: times.map_or(0, |(first, last)| last - first),
        was_unfinished: bag.is_unfinished(),
        damage,
    })
}
