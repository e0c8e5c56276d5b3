//! The newest seconds of a run, kept at a fault.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use pb3dp_bag::BagError;
use pb3dp_bag::encoded::Encoder;
use pb3dp_bag::messages::Text;
use pb3dp_bag::reader::{Bag, RawMessage};
use pb3dp_bag::recent::{Recent, RecentOptions};
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::WhenFull;

use super::{at, image_of};

fn start(bytes_max: u64) -> Recent {
    Recent::start(RecentOptions { bytes_max, when_full: WhenFull::Wait, ..RecentOptions::default() }).unwrap()
}

/// Two minutes of a run at 10 Hz: an image of 100 kB and a line each time.
fn run(recent: &mut Recent) {
    let mut encoder = Encoder::default();
    recent.push(&encoder.encode(ours::SETUP, at(0), &Text { data: "[camera]".to_owned() }));
    for k in 0..1200 {
        recent.push(&encoder.encode(ours::LEFT_IMAGE, at(100 * k), &image_of(100_000, k as u8)));
        recent.push(&encoder.encode("/line", at(100 * k), &Text { data: k.to_string() }));
    }
}

fn messages(file: &Path) -> BTreeMap<String, Vec<RawMessage>> {
    let bag = Bag::open(file).unwrap();
    assert!(!bag.is_unfinished());
    let mut all: BTreeMap<String, Vec<RawMessage>> = BTreeMap::new();
    for message in bag.messages().map(Result::unwrap) {
        all.entry(message.channel.topic.clone()).or_default().push(message);
    }
    all
}

#[test]
fn a_fault_leaves_the_last_thirty_seconds_in_a_whole_file() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("fault.mcap");
    let mut recent = start(1 << 30);
    run(&mut recent);
    let kept = recent.keep(&file).unwrap().finish().unwrap();
    assert_eq!((kept.messages, kept.duration), (603, Duration::from_secs(30)));
    let kept = messages(&file);
    let lines: Vec<u32> = kept["/line"].iter().map(|line| line.sequence).collect();
    assert_eq!(lines, (900..=1200).collect::<Vec<_>>());
    assert_eq!(kept[ours::LEFT_IMAGE].len(), 301);
    // The setup is from the begin of the run; the file begins with it.
    let setup = &kept[ours::SETUP][0];
    assert_eq!((setup.log_nanos, setup.publish_nanos), (at(89_900).as_nanos(), at(0).as_nanos()));
}

#[test]
fn images_make_room_for_everything_else() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("fault.mcap");
    let mut recent = start(5_000_000);
    run(&mut recent);
    recent.keep(&file).unwrap().finish().unwrap();
    let kept = messages(&file);
    let images: Vec<u32> = kept[ours::LEFT_IMAGE].iter().map(|image| image.sequence).collect();
    assert_eq!((kept["/line"].len(), kept[ours::SETUP].len()), (301, 1));
    assert_eq!(images, (1152..=1200).collect::<Vec<_>>());
}

#[test]
fn a_second_fault_has_a_file_of_its_own_once_the_first_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let files = [dir.path().join("fault.mcap"), dir.path().join("fault_2.mcap")];
    let mut recent = start(1 << 30);
    run(&mut recent);
    let first = recent.keep(&files[0]).unwrap();
    let refused = recent.keep(&files[1]);
    assert!(matches!(refused, Err(BagError::Keeping { .. })), "30 MB are written within some microseconds");
    first.finish().unwrap();
    recent.push(&Encoder::default().encode("/line", at(120_000), &Text { data: "after".to_owned() }));
    assert_eq!(recent.keep(&files[1]).unwrap().finish().unwrap().messages, 602);
    // Nothing is overwritten.
    let exists = recent.keep(&files[0]).unwrap().finish();
    assert!(matches!(exists, Err(BagError::Exists { .. })));
    // A folder that is not there, and then another try.
    assert!(recent.keep(&dir.path().join("no/fault.mcap")).unwrap().finish().is_err());
    // The end of the run waits for the file.
    let last = dir.path().join("fault_3.mcap");
    let keeping = recent.keep(&last).unwrap();
    drop(recent);
    assert_eq!(messages(&last)["/line"].len(), 301);
    assert_eq!(keeping.finish().unwrap().file, last);
}

#[test]
fn neither_a_message_nor_a_fault_holds_the_caller_up() {
    let dir = tempfile::tempdir().unwrap();
    let mut recent = start(1 << 30);
    run(&mut recent);
    let mut encoder = Encoder::default();
    let began = Instant::now();
    let keeping = recent.keep(&dir.path().join("fault.mcap")).unwrap();
    let line = Text { data: "during".to_owned() };
    for k in 0..300 {
        recent.push(&encoder.encode("/line", at(120_000 + k), &line));
    }
    let took = began.elapsed();
    keeping.finish().unwrap();
    // 30 MB take longer than this to write; on a loaded machine, too.
    println!("{took:?} of {:?}", began.elapsed());
    assert!(took < Duration::from_millis(100), "{took:?}");
    assert_eq!(recent.dropped(), 0);
}
