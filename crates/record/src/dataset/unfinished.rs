//! The log of an unfinished recording: if the program is killed, it remains in place of `sequence.json`.
//!
//! The first line is an object with the constant keys of `sequence.json`; each further line is one frame. A line is written
//! before the images of its frame, so the last frames may have no images.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::json::JsonFile;
use super::{DatasetError, FramePattern, UNFINISHED_FILE};
use crate::regular_file::{open_regular, read_regular};
use crate::text_file::TEXT_MAX_BYTES;

/// End of a PNG file: its last chunk (PNG specification, section 11.2.5).
const PNG_END: [u8; 12] = [0, 0, 0, 0, b'I', b'E', b'N', b'D', 0xAE, 0x42, 0x60, 0x82];
/// End of a JPEG file: the marker EOI (ITU-T T.81, table B.1).
const JPEG_END: [u8; 2] = [0xFF, 0xD9];

/// The log of a running recording.
#[derive(Debug)]
pub(super) struct Log {
    file: File,
    path: PathBuf,
    /// Length of the complete lines, bytes.
    length: u64,
}

impl Log {
    /// Creates a log.
    pub(super) fn create(folder: &Path, head: &Value) -> Result<Self, DatasetError> {
        let path = folder.join(UNFINISHED_FILE);
        // Append mode: after truncation the next line is written at the new end.
        let opened = File::create(&path).and_then(|_| OpenOptions::new().append(true).open(&path));
        let file = opened.map_err(|source| not_written(&path, source))?;
        let mut log = Self { file, path, length: 0 };
        log.append(head).inspect_err(|_| log.remove())?;
        Ok(log)
    }

    /// Logs a frame. A frame number that was already logged replaces the earlier frame and removes all frames after it.
    pub(super) fn note(
        &mut self,
        frame: u64,
        (t_s, skew_s): (f64, f64),
        pose: Option<[f64; 16]>,
    ) -> Result<(), DatasetError> {
        let mut line = json!({"frame": frame, "t_s": t_s, "skew_s": skew_s});
        if let Some(pose) = pose {
            line["cam_left_from_model"] = json!(pose);
        }
        self.append(&line)
    }

    /// Writes a line completely or not at all.
    fn append(&mut self, line: &Value) -> Result<(), DatasetError> {
        let text = format!("{line}\n");
        self.file.write_all(text.as_bytes()).map_err(|source| {
            // If truncation fails as well, the loader skips the incomplete line.
            let _ = self.file.set_len(self.length);
            not_written(&self.path, source)
        })?;
        self.length += text.len() as u64;
        Ok(())
    }

    /// Removes the log, after `sequence.json` is written or if there is no frame.
    pub(super) fn remove(&self) {
        // A log that remains is ignored if there is a `sequence.json`.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn not_written(path: &Path, source: std::io::Error) -> DatasetError {
    DatasetError::Io { file: path.to_owned(), action: "write", source }
}

/// The content of a log in the form of `sequence.json`: the frames up to the last one whose images are complete.
///
/// # Errors
/// A log that cannot be read, or whose first line is damaged.
pub(super) fn read(folder: &Path) -> Result<JsonFile, DatasetError> {
    let path = folder.join(UNFINISHED_FILE);
    let read = read_regular(&path, TEXT_MAX_BYTES);
    let bytes = read.map_err(|source| DatasetError::Io { file: path.clone(), action: "read", source })?;
    let mut lines = bytes.split(|byte| *byte == b'\n');
    let head = serde_json::from_slice(lines.next().unwrap_or_default());
    let mut root: Map<String, Value> = head.map_err(|source| DatasetError::Syntax { file: path.clone(), source })?;
    let mut frames: Vec<Value> = Vec::new();
    // After the last complete line there is an incomplete line or nothing.
    for line in lines.map_while(|line| serde_json::from_slice::<Value>(line).ok()) {
        let number = line["frame"].as_u64().and_then(|number| usize::try_from(number).ok());
        let Some(number) = number.filter(|number| *number <= frames.len()) else { break };
        frames.truncate(number);
        frames.push(line);
    }
    let pattern = |key: &str| root.get(key).and_then(Value::as_str).and_then(FramePattern::parse);
    if let (Some(left), Some(right)) = (pattern("left"), pattern("right")) {
        let is_there = |pattern: &FramePattern, frame: usize| is_whole(&folder.join(pattern.name(frame as u64)));
        while frames.last().is_some() && [&left, &right].iter().any(|side| !is_there(side, frames.len() - 1)) {
            frames.pop();
        }
    }
    let column = |key: &str| frames.iter().map(|frame| frame[key].clone()).collect::<Vec<Value>>();
    root.insert("frames".to_owned(), json!(frames.len()));
    root.insert("times_s".to_owned(), json!(column("t_s")));
    root.insert("skew_s".to_owned(), json!(column("skew_s")));
    if frames.first().is_some_and(|frame| frame.get("cam_left_from_model").is_some()) {
        root.insert("truth".to_owned(), json!({"cam_left_from_model": column("cam_left_from_model")}));
    }
    Ok(JsonFile::of(path, Value::Object(root)))
}

/// Whether an image file is complete.
fn is_whole(file: &Path) -> bool {
    let mut end = [0; PNG_END.len()];
    let read = open_regular(file).and_then(|mut file| {
        file.seek(SeekFrom::End(-(end.len() as i64)))?;
        file.read_exact(&mut end)
    });
    read.is_ok() && (end == PNG_END || end.ends_with(&JPEG_END))
}
