//! The messages of a recording in the order in which they were written.
//!
//! A file that was broken off has no index and no end: its messages up to the last whole one are read.

use std::collections::BTreeMap;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use mcap::sans_io::LinearReaderOptions;
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{Channel, McapResult, Summary};

use crate::BagError;
use crate::chunk_limit::ChunkLimit;
use crate::picked::Picked;
use crate::raw::RECORD_MAX;
pub(crate) use crate::raw::io;
use crate::raw::open;
pub use crate::raw::{Messages, RawMessage};
use crate::topics::Topic;

/// First bytes of an MCAP file (specification, "Magic").
const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n'];
/// First bytes of an SQLite file.
const SQLITE: &[u8] = b"SQLite format 3";

/// A recording: one file, or those of a folder, by rosbag2 or divided ([`crate::writer::Rotation`]).
#[derive(Clone, Debug)]
pub struct Bag {
    path: PathBuf,
    files: Vec<BagFile>,
    topics: Vec<Topic>,
}

#[derive(Clone, Debug)]
struct BagFile {
    path: PathBuf,
    /// It was broken off.
    is_unfinished: bool,
}

impl Bag {
    /// Whether a path is a recording of this kind: an MCAP file, a folder of rosbag2, or a folder with nothing but MCAP files.
    pub fn is_one(path: &Path) -> bool {
        let is_file = path.exists() && !path.is_dir() && extension(path).is_some_and(|e| e == "mcap" || e == "db3");
        is_file || path.join("metadata.yaml").is_file() || has_only_mcap_files(path)
    }

    /// Opens a recording, and counts its messages if it has no index.
    ///
    /// # Errors
    /// A path that is no such recording, or cannot be read.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let paths = if path.is_dir() { files_in(path)? } else { vec![path.to_path_buf()] };
        let mut files = Vec::new();
        let mut counts = BTreeMap::new();
        for path in paths {
            check_magic(&path)?;
            let summary = summary(&path)?;
            let file = BagFile { is_unfinished: summary.is_none(), path };
            match summary {
                Some(summary) => add_counts(&mut counts, &summary),
                None => {
                    for message in messages_of(&file)? {
                        *counts.entry(topic_of(&message?.channel)).or_insert(0) += 1;
                    }
                }
            }
            files.push(file);
        }
        let topics =
            counts.into_iter().map(|((name, ros_type), messages)| Topic { name, ros_type, messages }).collect();
        Ok(Self { path: path.to_path_buf(), files, topics })
    }

    /// The path, as the caller gave it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All topics, by name.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Whether a file was broken off.
    pub fn is_unfinished(&self) -> bool {
        self.files.iter().any(|file| file.is_unfinished)
    }

    /// The messages on these topics, in the order of their files. Where the file has an index and no compression, only they are read.
    ///
    /// # Errors
    /// If a file cannot be opened.
    pub fn messages_on(&self, topics: &[&str]) -> Result<Messages, BagError> {
        let files = self.files.iter().map(|file| messages_on(file, topics)).collect::<Result<Vec<_>, _>>()?;
        Ok(Box::new(files.into_iter().flatten()))
    }

    /// All messages in the order of their files.
    pub fn messages(&self) -> impl Iterator<Item = Result<RawMessage, BagError>> + Send + 'static {
        self.files.clone().into_iter().flat_map(|file| match messages_of(&file) {
            Ok(messages) => Box::new(messages) as Box<dyn Iterator<Item = _> + Send>,
            Err(error) => Box::new(std::iter::once(Err(error))),
        })
    }
}

/// The messages of one file on these topics.
fn messages_on(file: &BagFile, topics: &[&str]) -> Result<Messages, BagError> {
    if let Some(summary) = summary(&file.path)?
        && let Some(picked) = Picked::new(&file.path, &summary, topics)?
    {
        return Ok(Box::new(picked));
    }
    let topics: Vec<String> = topics.iter().map(|topic| (*topic).to_owned()).collect();
    let is_wanted = move |read: &Result<RawMessage, BagError>| {
        read.as_ref().map_or(true, |message| topics.contains(&message.channel.topic))
    };
    Ok(Box::new(messages_of(file)?.filter(is_wanted)))
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_string_lossy().to_ascii_lowercase())
}

fn has_only_mcap_files(folder: &Path) -> bool {
    let Ok(entries) = std::fs::read_dir(folder) else { return false };
    let mut is_mcap =
        entries.map(|entry| entry.is_ok_and(|e| extension(&e.path()).as_deref() == Some("mcap"))).peekable();
    is_mcap.peek().is_some() && is_mcap.all(|is| is)
}

/// The MCAP files of a folder; numbers in their names count by value.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>, BagError> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|source| io(folder, "reading the folder", source))? {
        let path = entry.map_err(|source| io(folder, "reading the folder", source))?.path();
        match extension(&path).as_deref() {
            Some("mcap") => files.push(path),
            Some("db3") => return Err(BagError::Sqlite { file: path }),
            _ => {}
        }
    }
    if files.is_empty() {
        return Err(BagError::NoMcap { file: folder.to_path_buf() });
    }
    files.sort_by_key(|file| by_number(&file.file_stem().unwrap_or_default().to_string_lossy()));
    Ok(files)
}

/// The parts of a name, of which numbers count by value: `run` is before `run_2`, and that before `run_10`.
fn by_number(name: &str) -> Vec<(u64, String)> {
    let mut parts: Vec<(u64, String)> = Vec::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let is_digit = first.is_ascii_digit();
        let end = rest.find(|c: char| c.is_ascii_digit() != is_digit).unwrap_or(rest.len());
        let (part, more) = rest.split_at(end);
        // Numbers come before letters, as in ASCII.
        parts.push((if is_digit { part.parse().unwrap_or(u64::MAX - 1) } else { u64::MAX }, part.to_owned()));
        rest = more;
    }
    parts
}

fn check_magic(file: &Path) -> Result<(), BagError> {
    let mut head = Vec::new();
    let opened = open(file)?;
    opened.take(SQLITE.len() as u64).read_to_end(&mut head).map_err(|source| io(file, "reading", source))?;
    match &head[..] {
        head if head.starts_with(SQLITE) => Err(BagError::Sqlite { file: file.to_path_buf() }),
        head if head.starts_with(&MAGIC) => Ok(()),
        _ => Err(BagError::NoMcap { file: file.to_path_buf() }),
    }
}

/// The index at the end of a file; `None` if it was broken off, or written without one.
fn summary(path: &Path) -> Result<Option<Summary>, BagError> {
    let mut file = open(path)?;
    let size = file.metadata().map_err(|source| io(path, "reading", source))?.len();
    let options = SummaryReaderOptions::default().with_file_size(size).with_record_length_limit(RECORD_MAX);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(count)) => {
                let read = file.read(reader.insert(count)).map_err(|source| io(path, "reading", source))?;
                reader.notify_read(read);
            }
            Ok(SummaryReadEvent::SeekRequest(to)) => {
                reader.notify_seeked(file.seek(to).map_err(|source| io(path, "reading", source))?);
            }
            // Without an end there is no index: the file is read from its begin.
            Err(_) => return Ok(None),
        }
    }
    Ok(reader.finish().filter(|summary| summary.stats.is_some()))
}

fn topic_of(channel: &Channel<'_>) -> (String, String) {
    let ros_type = channel.schema.as_ref().map(|schema| schema.name.clone()).unwrap_or_default();
    (channel.topic.clone(), ros_type)
}

fn add_counts(counts: &mut BTreeMap<(String, String), u64>, summary: &Summary) {
    let counted = summary.stats.as_ref().map(|stats| &stats.channel_message_counts);
    for (id, channel) in &summary.channels {
        let messages = counted.and_then(|counted| counted.get(id)).copied().unwrap_or(0);
        *counts.entry(topic_of(channel)).or_insert(0) += messages;
    }
}

fn messages_of(file: &BagFile) -> Result<impl Iterator<Item = Result<RawMessage, BagError>> + Send + use<>, BagError> {
    let opened = open(&file.path)?;
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_record_length_limit(RECORD_MAX)
        .with_validate_chunk_crcs(true);
    let reader = mcap::io::MessageReader::new_with_options(ChunkLimit::new(BufReader::new(opened)), options);
    let BagFile { path, is_unfinished } = file.clone();
    let mut count = 0;
    let raw = move |read: McapResult<mcap::Message<'static>>| match read {
        Ok(message) => {
            count += 1;
            Some(Ok(RawMessage {
                channel: message.channel,
                log_nanos: message.log_time,
                publish_nanos: message.publish_time,
                sequence: message.sequence,
                data: message.data.into_owned(),
            }))
        }
        // The rest of a file that was broken off.
        Err(_) if is_unfinished => None,
        Err(error) => Some(Err(BagError::Damaged { file: path.clone(), messages: count, why: error.to_string() })),
    };
    Ok(reader.map_while(raw))
}
