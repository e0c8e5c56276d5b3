//! Recordings that are divided into several files.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use pb3dp_bag::BagError;
use pb3dp_bag::messages::Text;
use pb3dp_bag::reader::{Bag, RawMessage};
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, Rotation, WhenFull, Written};

use super::{at, image_of};

const DESCRIPTION: [&str; 4] = [ours::SETUP, ours::VERSION, ours::CALIBRATION, ours::TF_STATIC];

/// A recording at 100 Hz: a line and an image of 20 kB each time, after the messages that describe the run.
fn record(file: &Path, rotation: Rotation, times: u64) -> Written {
    let mut writer = BagWriter::create_rotating(file, WhenFull::Wait, rotation).unwrap();
    for topic in DESCRIPTION {
        // An hour before the first image: the time does not count.
        writer.push(topic, at(0), &Text { data: topic.to_owned() });
    }
    for k in 0..times {
        let now = at(3_600_000 + 10 * k);
        writer.push(ours::LEFT_IMAGE, now, &image_of(20_000, k as u8));
        writer.push("/line", now, &Text { data: k.to_string() });
    }
    writer.finish().unwrap()
}

fn messages(path: &Path) -> Vec<RawMessage> {
    Bag::open(path).unwrap().messages().map(Result::unwrap).collect()
}

fn names(written: &Written) -> Vec<String> {
    written.files.iter().map(|file| file.file_name().unwrap().to_string_lossy().into_owned()).collect()
}

/// Each file has the description once, at the time of its first message; all others are there once and in order.
fn check(folder: &Path, written: &Written, times: u64) {
    assert_eq!((written.messages[ours::LEFT_IMAGE], written.messages[ours::SETUP]), (times, 1));
    let mut of_files = Vec::new();
    for file in &written.files {
        let bag = Bag::open(file).unwrap();
        assert!(!bag.is_unfinished());
        let counts: BTreeMap<&str, u64> = bag.topics().iter().map(|t| (t.name.as_str(), t.messages)).collect();
        assert!(DESCRIPTION.iter().all(|topic| counts[topic] == 1), "{}: {counts:?}", file.display());
        let messages = messages(file);
        if file != &written.file {
            let begin = messages[DESCRIPTION.len()].log_nanos;
            for repeated in &messages[..DESCRIPTION.len()] {
                assert!(DESCRIPTION.contains(&repeated.channel.topic.as_str()));
                let expected = (begin, at(0).as_nanos(), 1);
                assert_eq!((repeated.log_nanos, repeated.publish_nanos, repeated.sequence), expected);
            }
        }
        of_files.extend(messages);
    }
    // The folder has the same messages in the same order.
    assert!(Bag::is_one(folder));
    let key = |message: &RawMessage| (message.channel.topic.clone(), message.sequence, message.log_nanos);
    let of_folder: Vec<_> = messages(folder).iter().map(key).collect();
    assert_eq!(of_folder, of_files.iter().map(key).collect::<Vec<_>>());
    for topic in [ours::LEFT_IMAGE, "/line"] {
        let sequences: Vec<u64> =
            of_folder.iter().filter(|(name, ..)| name == topic).map(|(_, sequence, _)| u64::from(*sequence)).collect();
        assert_eq!(sequences, (1..=times).collect::<Vec<_>>(), "{topic}");
    }
}

#[test]
fn files_are_divided_by_size_and_nothing_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let rotation = Rotation { bytes_max: Some(1_000_000), duration_max: None };
    let written = record(&dir.path().join("run.mcap"), rotation, 600);
    assert_eq!(written.files.len(), 13);
    let some = [0, 1, 2, 10, 12].map(|index| names(&written)[index].clone());
    assert_eq!(some, ["run.mcap", "run_001.mcap", "run_002.mcap", "run_010.mcap", "run_012.mcap"]);
    for file in &written.files[..12] {
        let length = std::fs::metadata(file).unwrap().len();
        assert!((960_000..=1_010_000).contains(&length), "{}: {length}", file.display());
    }
    check(dir.path(), &written, 600);
}

#[test]
fn files_are_divided_by_time_and_nothing_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let rotation = Rotation { bytes_max: None, duration_max: Some(Duration::from_secs(1)) };
    // The name of the recording has a number already.
    let written = record(&dir.path().join("run_7.mcap"), rotation, 250);
    assert_eq!(names(&written), ["run_7.mcap", "run_7_001.mcap", "run_7_002.mcap"]);
    let images: Vec<usize> = written.files.iter().map(|file| messages(file).len()).collect();
    assert_eq!(images, [204, 204, 104]);
    check(dir.path(), &written, 250);
}

#[test]
fn more_than_a_thousand_files_keep_their_order() {
    let dir = tempfile::tempdir().unwrap();
    // Each message is longer than a file may be.
    let rotation = Rotation { bytes_max: Some(1), duration_max: None };
    let written = record(&dir.path().join("run.mcap"), rotation, 501);
    assert_eq!(names(&written)[1001], "run_1001.mcap");
    check(dir.path(), &written, 501);
}

#[test]
fn a_description_that_changes_is_repeated_as_it_is_then() {
    let dir = tempfile::tempdir().unwrap();
    let rotation = Rotation { bytes_max: Some(30_000), duration_max: None };
    let mut writer = BagWriter::create_rotating(&dir.path().join("run.mcap"), WhenFull::Wait, rotation).unwrap();
    for k in 0..4 {
        writer.push(ours::CALIBRATION, at(k), &Text { data: k.to_string() });
        writer.push(ours::LEFT_IMAGE, at(k), &image_of(20_000, 0));
    }
    let written = writer.finish().unwrap();
    let text = |file: &Path| -> Vec<String> {
        let texts = messages(file).into_iter().filter(|message| message.channel.topic == ours::CALIBRATION);
        texts.map(|message| pb3dp_bag::cdr::from_bytes::<Text>(&message.data).unwrap().data).collect()
    };
    let texts: Vec<Vec<String>> = written.files.iter().map(|file| text(file)).collect();
    assert_eq!(texts, [vec!["0", "1"], vec!["1", "2"], vec!["2", "3"], vec!["3"]]);
}

#[test]
fn files_of_an_earlier_recording_are_neither_overwritten_nor_continued() {
    let dir = tempfile::tempdir().unwrap();
    let rotation = Rotation { bytes_max: Some(1_000_000), duration_max: None };
    let old = dir.path().join("run_003.mcap");
    std::fs::write(&old, "old").unwrap();
    let refused = BagWriter::create_rotating(&dir.path().join("run.mcap"), WhenFull::Drop, rotation);
    assert!(matches!(refused, Err(BagError::Exists { file }) if file == old));
    // One that appears during the run ends the recording, and what was recorded until then is whole.
    let file = dir.path().join("other.mcap");
    let mut writer = BagWriter::create_rotating(&file, WhenFull::Wait, rotation).unwrap();
    let next = dir.path().join("other_001.mcap");
    std::fs::write(&next, "new").unwrap();
    for k in 0..100 {
        writer.push(ours::LEFT_IMAGE, at(k), &image_of(20_000, 0));
    }
    assert!(matches!(writer.finish(), Err(BagError::Exists { file }) if file == next));
    assert_eq!(std::fs::read(&next).unwrap(), b"new");
    assert_eq!(messages(&file).len(), 49);
}
