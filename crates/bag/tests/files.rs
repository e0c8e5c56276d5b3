//! Files: written, broken off, recovered, and read as stereo pairs.

use std::path::Path;
use std::time::Duration;

use pb3dp_bag::BagError;
use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{
    CameraInfo, CompressedImage, Header, Image, Message, PolygonStamped, RegionOfInterest, Text,
};
use pb3dp_bag::pairs::{PairOptions, StereoBag};
use pb3dp_bag::reader::Bag;
use pb3dp_bag::recover::recover;
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_record::calibration_files::StatedCalibration;
use proptest::prelude::*;

use super::at;

fn header(millis: u64) -> Header {
    Header { stamp: at(millis).into(), frame_id: "cam".to_owned() }
}

/// A grey image of one value.
fn image(millis: u64, value: u8) -> Image {
    let (encoding, data) = ("mono8".to_owned(), Bytes(vec![value; 6]));
    Image { header: header(millis), height: 2, width: 3, encoding, is_bigendian: 0, step: 3, data }
}

fn writer(file: &Path) -> BagWriter {
    BagWriter::create(file, WhenFull::Wait).unwrap()
}

/// Pairs at 0, 33, 66 ... ms; the right images are half a millisecond later.
fn write_pairs(file: &Path, pairs: u64) {
    let mut writer = writer(file);
    for k in 0..pairs {
        writer.push(ours::LEFT_IMAGE, at(33 * k), &image(33 * k, k as u8));
        let right = Image {
            header: Header { stamp: (at(33 * k) + Duration::from_micros(500)).into(), ..header(0) },
            ..image(0, 100 + k as u8)
        };
        writer.push(ours::RIGHT_IMAGE, at(33 * k), &right);
    }
    let written = writer.finish().unwrap();
    assert_eq!((written.messages[ours::LEFT_IMAGE], written.dropped), (pairs, 0));
}

/// First grey value of the left and the right image, and the skew, of each pair.
fn pairs_of(path: &Path, options: PairOptions) -> Vec<(u8, u8, i64)> {
    let bag = StereoBag::open(path, options).unwrap();
    let pair = |pair: Result<pb3dp_bag::pairs::BagPair, BagError>| {
        let pair = pair.unwrap();
        let [left, right] = pair.images.unwrap();
        (left.as_raw()[0], right.as_raw()[0], pair.skew_nanos)
    };
    bag.pairs().map(pair).collect()
}

#[test]
fn what_is_written_is_read_with_times_and_skew() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("run.mcap");
    write_pairs(&file, 4);
    let bag = StereoBag::open(&file, PairOptions::default()).unwrap();
    assert!(!bag.bag().is_unfinished());
    assert_eq!(bag.pairs_max(), 4);
    let times: Vec<_> = bag.pairs().map(|pair| pair.unwrap().exposed_at).collect();
    assert_eq!(times, [0, 33, 66, 99].map(at));
    assert_eq!(pairs_of(&file, PairOptions::default())[2], (2, 102, 500_000));
    // Nothing is overwritten.
    assert!(matches!(BagWriter::create(&file, WhenFull::Drop), Err(BagError::Exists { .. })));
}

/// As the kernel leaves it after a kill: cut at any byte.
#[test]
fn a_file_that_was_cut_anywhere_is_read_and_recovered_up_to_its_last_whole_message() {
    let dir = tempfile::tempdir().unwrap();
    let (file, cut, whole) = (dir.path().join("run.mcap"), dir.path().join("cut.mcap"), dir.path().join("whole.mcap"));
    write_pairs(&file, 40);
    let bytes = std::fs::read(&file).unwrap();
    let messages = |file: &Path| Bag::open(file).unwrap().messages().filter(Result::is_ok).count();
    assert_eq!(messages(&file), 80);
    let mut before = 0;
    for length in (8..bytes.len()).step_by(97) {
        std::fs::write(&cut, &bytes[..length]).unwrap();
        let read = messages(&cut);
        assert!(read >= before && read <= 80, "{length}: {read}");
        before = read;
        let _ = std::fs::remove_file(&whole);
        let recovered = recover(&cut, &whole).unwrap();
        assert!(recovered.was_unfinished);
        assert_eq!(recovered.messages as usize, read, "{length}");
        assert_eq!(messages(&whole), read);
        assert!(!Bag::open(&whole).unwrap().is_unfinished());
    }
    assert_eq!(before, 80, "all messages are before the index");
    assert!(matches!(recover(&cut, &whole), Err(BagError::Exists { .. })));
}

#[test]
fn images_without_a_partner_are_left_out_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("run.mcap");
    let mut writer = writer(&file);
    // The right camera misses one image and then comes 4 ms late.
    for (left, right) in [(0, Some(1)), (33, None), (66, Some(64)), (99, Some(103)), (132, Some(132))] {
        writer.push(ours::LEFT_IMAGE, at(left), &image(left, left as u8));
        if let Some(right) = right {
            writer.push(ours::RIGHT_IMAGE, at(right), &image(right, right as u8));
        }
    }
    writer.finish().unwrap();
    let bag = StereoBag::open(&file, PairOptions::default()).unwrap();
    let mut pairs = bag.pairs();
    let found: Vec<_> = pairs.by_ref().map(|pair| pair.unwrap().skew_nanos / 1_000_000).collect();
    assert_eq!((found, pairs.left_out().images), (vec![1, -2, 0], 3));
    let wider = PairOptions { within: Duration::from_millis(5), ..PairOptions::default() };
    assert_eq!(pairs_of(&file, wider).len(), 4);
}

#[test]
fn deep_and_compressed_images_are_converted() {
    let dir = tempfile::tempdir().unwrap();
    let (deep, jpeg) = (dir.path().join("deep.mcap"), dir.path().join("jpeg.mcap"));
    let mut deep_images = writer(&deep);
    for (topic, values) in [(ours::LEFT_IMAGE, [100_u16, 500, 900]), (ours::RIGHT_IMAGE, [300, 500, 1100])] {
        let data = Bytes(values.iter().flat_map(|value| value.to_le_bytes()).collect());
        let (encoding, step) = ("mono16".to_owned(), 6);
        let image = Image { header: header(0), height: 1, width: 3, encoding, is_bigendian: 0, step, data };
        deep_images.push(topic, at(0), &image);
    }
    deep_images.finish().unwrap();
    let stated = PairOptions { range: Some("100,1120".parse().unwrap()), ..PairOptions::default() };
    assert_eq!(pairs_of(&deep, stated), [(0, 50, 0)]);
    // Measured on both images: 100 to 1100.
    let bag = StereoBag::open(&deep, PairOptions::default()).unwrap();
    let mut pairs = bag.pairs();
    let [left, right] = pairs.next().unwrap().unwrap().images.unwrap();
    assert_eq!([left.as_raw()[0], left.as_raw()[6], right.as_raw()[6]], [0, 204, 255]);
    let notes = pairs.take_notes();
    assert!(notes.len() == 1 && notes[0].contains("100,1100") && notes[0].contains("--range"), "{notes:?}");

    let mut file = Vec::new();
    let grey = image::GrayImage::from_pixel(16, 8, image::Luma([77]));
    grey.write_to(&mut std::io::Cursor::new(&mut file), image::ImageFormat::Jpeg).unwrap();
    let compressed =
        |bytes: &[u8]| CompressedImage { header: header(0), format: "jpeg".to_owned(), data: Bytes(bytes.to_vec()) };
    let mut jpegs = writer(&jpeg);
    jpegs.push(ours::LEFT_COMPRESSED, at(0), &compressed(&file));
    jpegs.push(ours::RIGHT_COMPRESSED, at(0), &compressed(&file));
    // A damaged image costs its own pair only.
    jpegs.push(ours::LEFT_COMPRESSED, at(33), &CompressedImage { header: header(33), ..compressed(&file[..99]) });
    jpegs.push(ours::RIGHT_COMPRESSED, at(33), &CompressedImage { header: header(33), ..compressed(&file) });
    jpegs.finish().unwrap();
    let bag = StereoBag::open(&jpeg, PairOptions::default()).unwrap();
    let pairs: Vec<_> = bag.pairs().map(|pair| pair.unwrap().images).collect();
    assert_eq!(pairs[0].as_ref().unwrap()[0].as_raw()[..3], [77; 3]);
    let error = pairs[1].as_ref().unwrap_err();
    assert!(
        matches!(error, BagError::Image { .. }) && error.to_string().contains("/left/image_raw/compressed"),
        "{error}"
    );
}

fn info(millis: u64, shift: f64) -> CameraInfo {
    CameraInfo {
        header: header(millis),
        height: 480,
        width: 640,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.05, -0.1, 0.001, -0.002, 0.0],
        k: [610.0, 0.0, 315.0, 0.0, 612.0, 243.0, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [600.0, 0.0, 320.0, shift, 0.0, 600.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        binning_x: 0,
        binning_y: 0,
        roi: RegionOfInterest::default(),
    }
}

#[test]
fn the_calibration_is_that_of_the_camera_infos() {
    let dir = tempfile::tempdir().unwrap();
    let [raw, rectified, bare, loose] =
        ["raw", "rectified", "bare", "loose"].map(|name| dir.path().join(name).with_extension("mcap"));
    let write = |file: &Path, images: [&'static str; 2], infos: [&'static str; 2], shift: f64| {
        let mut writer = writer(file);
        for (side, topic) in images.into_iter().enumerate() {
            writer.push(topic, at(0), &image(0, 0));
            if !infos[side].is_empty() {
                writer.push(infos[side], at(0), &info(0, if side == 0 { 0.0 } else { shift }));
            }
        }
        writer.finish().unwrap();
        StereoBag::open(file, PairOptions::default()).unwrap().calibration(&StatedCalibration::default())
    };
    let infos = [ours::LEFT_INFO, ours::RIGHT_INFO];
    let found = write(&raw, [ours::LEFT_IMAGE, ours::RIGHT_IMAGE], infos, -72.0).unwrap();
    // -fx B = -72: a baseline of 120 mm.
    assert!((found.rig.baseline_m() - 0.12).abs() < 1e-12);
    assert_eq!(found.rig.left().pinhole().fx, 610.0);
    let found = write(&rectified, ["/left/image_rect", "/right/image_rect"], infos, -72.0).unwrap();
    assert_eq!(found.rig.left().pinhole().fx, 600.0, "rectified images have the rectified camera");
    let error = write(&bare, [ours::LEFT_IMAGE, ours::RIGHT_IMAGE], ["", ours::RIGHT_INFO], -72.0).unwrap_err();
    assert!(
        error.to_string().contains("no topic /left/camera_info") && error.to_string().contains("--calib"),
        "{error}"
    );
    let error = write(&loose, [ours::LEFT_IMAGE, ours::RIGHT_IMAGE], infos, 0.0).unwrap_err();
    assert!(matches!(error, BagError::Calibration { .. }), "{error}");
}

/// Images of 3x2 pixels, whose sensor has 6x4, without and with compression.
#[test]
fn binning_of_a_camera_info_is_applied() {
    let dir = tempfile::tempdir().unwrap();
    let mut png = std::io::Cursor::new(Vec::new());
    image::GrayImage::new(3, 2).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let compressed = CompressedImage { header: header(0), format: "png".to_owned(), data: Bytes(png.into_inner()) };
    let binned = |shift: f64| CameraInfo {
        width: 6,
        height: 4,
        k: [10.0, 0.0, 2.5, 0.0, 10.0, 1.5, 0.0, 0.0, 1.0],
        p: [10.0, 0.0, 2.5, shift, 0.0, 10.0, 1.5, 0.0, 0.0, 0.0, 1.0, 0.0],
        binning_x: 2,
        binning_y: 2,
        ..info(0, shift)
    };
    for name in ["plain.mcap", "compressed.mcap"] {
        let file = dir.path().join(name);
        let mut writer = writer(&file);
        let topics = [(ours::LEFT_COMPRESSED, ours::LEFT_IMAGE), (ours::RIGHT_COMPRESSED, ours::RIGHT_IMAGE)];
        let damaged = CompressedImage { data: Bytes(vec![1; 9]), ..compressed.clone() };
        writer.push(ours::LEFT_COMPRESSED, at(0), &damaged);
        for (side, (topic_compressed, topic)) in topics.into_iter().enumerate() {
            match name {
                "plain.mcap" => writer.push(topic, at(0), &image(0, 0)),
                _ => writer.push(topic_compressed, at(0), &compressed),
            }
            writer.push([ours::LEFT_INFO, ours::RIGHT_INFO][side], at(0), &binned(-(side as f64)));
        }
        writer.finish().unwrap();
        let found =
            StereoBag::open(&file, PairOptions::default()).unwrap().calibration(&StatedCalibration::default()).unwrap();
        let pinhole = found.rig.left().pinhole();
        assert_eq!((pinhole.fx, pinhole.cx, pinhole.cy), (5.0, 1.0, 0.5));
        assert!((found.rig.baseline_m() - 0.1).abs() < 1e-12 && found.notes[0].contains("binning 2x2"));
    }
}

#[test]
fn what_is_no_recording_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |name: &str, content: &[u8], parts: &[&str]| {
        let path = dir.path().join(name);
        std::fs::write(&path, content).unwrap();
        let message = StereoBag::open(&path, PairOptions::default()).unwrap_err().to_string();
        assert!(parts.iter().chain(&[name]).all(|part| message.contains(part)), "{message}");
    };
    refused("photo.mcap", b"\x89PNG\r\n", &["no MCAP file"]);
    refused("empty.mcap", b"", &["no MCAP file"]);
    refused("old.db3", b"SQLite format 3\0", &["rosbags-convert"]);
    let bag = dir.path().join("bag");
    std::fs::create_dir(&bag).unwrap();
    std::fs::write(bag.join("metadata.yaml"), "").unwrap();
    assert!(Bag::is_one(&bag));
    assert!(matches!(Bag::open(&bag), Err(BagError::NoMcap { .. })));
    std::fs::write(bag.join("bag_0.db3"), "").unwrap();
    assert!(matches!(Bag::open(&bag), Err(BagError::Sqlite { .. })));
    let text_only = dir.path().join("words.mcap");
    let mut only_text = writer(&text_only);
    only_text.push(ours::VERSION, at(0), &Text { data: "pb3dp".to_owned() });
    only_text.finish().unwrap();
    let error = StereoBag::open(&text_only, PairOptions::default()).unwrap_err();
    assert!(error.to_string().contains("two topics with images are needed"), "{error}");
    let missing = StereoBag::open(&dir.path().join("nothing.mcap"), PairOptions::default()).unwrap_err();
    assert!(matches!(missing, BagError::Io { .. }), "{missing}");
}

/// Opening a pipe would wait for its writer.
#[test]
fn a_pipe_is_no_recording_and_blocks_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("pipe.mcap");
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
    assert!(Bag::is_one(&pipe));
    for path in [&pipe as &Path, dir.path()] {
        let error = Bag::open(path).unwrap_err();
        assert!(error.to_string().contains("pipe.mcap: it is a named pipe (FIFO)"), "{error}");
    }
}

/// The files of a split recording follow each other by their numbers.
#[test]
fn a_folder_of_rosbag2_is_one_recording() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("metadata.yaml"), "").unwrap();
    for (number, first) in [(2, 0), (10, 3)] {
        let mut writer = writer(&dir.path().join(format!("bag_{number}.mcap")));
        for k in first..first + 3 {
            writer.push(ours::LEFT_IMAGE, at(33 * k), &image(33 * k, k as u8));
            writer.push(ours::RIGHT_IMAGE, at(33 * k), &image(33 * k, k as u8));
        }
        writer.finish().unwrap();
    }
    let found: Vec<u8> = pairs_of(dir.path(), PairOptions::default()).iter().map(|(left, ..)| *left).collect();
    assert_eq!(found, [0, 1, 2, 3, 4, 5]);
    assert_eq!(Bag::open(dir.path()).unwrap().topics()[0].ros_type, Image::name());
}

/// A file with one message of these bytes on each image topic and each camera_info.
fn file_of_bytes(file: &Path, bytes: &[u8]) {
    let mut writer = mcap::WriteOptions::new().compression(None).create(std::fs::File::create(file).unwrap()).unwrap();
    let topics = [
        (ours::LEFT_IMAGE, Image::name()),
        (ours::RIGHT_IMAGE, Image::name()),
        (ours::LEFT_INFO, CameraInfo::name()),
        (ours::RIGHT_INFO, CameraInfo::name()),
        (ours::REGION, PolygonStamped::name()),
    ];
    for (topic, name) in topics {
        let schema = writer.add_schema(&name, "ros2msg", b"").unwrap();
        let channel_id = writer.add_channel(schema, topic, "cdr", &Default::default()).unwrap();
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 5, publish_time: 5 };
        writer.write_to_known_channel(&header, bytes).unwrap();
    }
    writer.finish().unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever the messages contain: a pair or an error, never a panic, and no memory for what is only announced.
    #[test]
    fn messages_of_any_bytes_are_refused_or_read(mut bytes in prop::collection::vec(any::<u8>(), 0..400), is_cdr in any::<bool>()) {
        if is_cdr && bytes.len() >= 4 {
            bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
        }
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("any.mcap");
        file_of_bytes(&file, &bytes);
        let bag = StereoBag::open(&file, PairOptions::default()).unwrap();
        let _ = (bag.calibration(&StatedCalibration::default()), bag.region(), bag.pairs().count());
    }

    /// An image whose header is sound, with any size, stride, encoding and data.
    #[test]
    fn images_of_any_size_are_refused_or_read(
        size in (0_u32..70, 0_u32..70),
        step in 0_u32..300,
        data in prop::collection::vec(any::<u8>(), 0..4000),
        encoding in prop::sample::select(vec!["mono8", "mono16", "rgb8", "bgra8", "rgb16", "yuv422", "yuyv", "bayer_rggb8", "bayer_gbrg16"]),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("any.mcap");
        let image = Image { header: header(0), height: size.1, width: size.0, encoding: encoding.to_owned(), is_bigendian: 1, step, data: Bytes(data) };
        file_of_bytes(&file, &pb3dp_bag::cdr::to_bytes(&image));
        let bag = StereoBag::open(&file, PairOptions::default()).unwrap();
        let pair = bag.pairs().next().unwrap().unwrap();
        if let Ok([left, right]) = pair.images {
            prop_assert_eq!((left.dimensions(), right.dimensions()), (size, size));
        }
    }

    /// A whole file of which any bytes have changed.
    #[test]
    fn a_damaged_file_is_refused_or_read(changes in prop::collection::vec((0_usize..2000, any::<u8>()), 1..20)) {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("any.mcap");
        write_pairs(&file, 4);
        let mut bytes = std::fs::read(&file).unwrap();
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        std::fs::write(&file, bytes).unwrap();
        if let Ok(bag) = StereoBag::open(&file, PairOptions::default()) {
            let _ = (bag.calibration(&StatedCalibration::default()), bag.pairs().take(100).count());
        }
        let _ = recover(&file, &dir.path().join("new.mcap"));
    }
}
