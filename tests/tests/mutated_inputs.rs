//! Damaged recordings, calibrations and images: whatever a file contains, it is read or refused, with bounded memory and time.

use std::collections::BTreeMap;
use std::fs::{create_dir_all, write};
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Duration;

use image::{ImageFormat, Rgb, RgbImage};
use nalgebra::Vector3;
use pb3dp_bag::cdr::{Bytes, to_bytes};
use pb3dp_bag::messages::{CameraInfo, CompressedImage, Header, Image, Message, RegionOfInterest};
use pb3dp_bag::recover::recover;
use pb3dp_bag::topics::ours;
use pb3dp_camera_replay::{Recording, RecordingOptions, ReplayOptions};
use pb3dp_computing::rng::SplitMix64;
use pb3dp_geometry::{Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig};
use pb3dp_hal_api::{CameraErrorKind, StereoCamera};
use pb3dp_record::calibration_files::{
    load_stereo, load_stereo_for, ros_camera_infos, save_json, save_kalibr, save_opencv, save_ros_pair,
};
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter, WrittenFrame};
use pb3dp_record::images::{StoredFormat, StoredImage, check_header};
use pb3dp_test_support::sweep;
use rustix::time::{ClockId, clock_gettime};

const SIZE: ImageSize = ImageSize { width: 48, height: 32 };
const FRAMES: u64 = 3;

/// Processor time for one input, seconds. Measured in 56 000 inputs: at most 0.7 s.
const SECONDS_MAX: f64 = 10.0;
/// Memory for one input, bytes. Measured: at most 63 MB; a record may announce up to 512 MiB.
const BYTES_MAX: u64 = 1 << 30;

/// Numbers and words that are wrong nearly everywhere.
const TERMS: [&str; 14] = [
    "0",
    "-1",
    "1e308",
    "-1e-320",
    "nan",
    ".inf",
    "99999999999999999999",
    "65535",
    "2147483648",
    "0.5",
    "null",
    "\"x\"",
    "[]",
    "{}",
];

/// Changes bytes, and in texts also numbers and lines.
fn mutated(original: &[u8], rng: &mut SplitMix64) -> Vec<u8> {
    let mut bytes = original.to_vec();
    for _ in 0..=rng.below(4) {
        let at = rng.below(bytes.len().max(1) as u32) as usize;
        let end = bytes.len().min(at + 1 + rng.below(16) as usize);
        match (rng.below(8), bytes.get_mut(at)) {
            (_, None) => bytes.push(rng.below(256) as u8),
            (0, Some(byte)) => *byte ^= 1 << rng.below(8),
            (1, Some(byte)) => *byte = [0, 0x7F, 0x80, 0xFF][rng.below(4) as usize],
            (2, _) => bytes.truncate(at),
            (3, _) => drop(bytes.drain(at..end)),
            (4, _) => {
                let copied = bytes[at..end].to_vec();
                bytes.splice(at..at, copied);
            }
            (5, _) => {
                let number =
                    [0_u32, 1, 0xFFFF, 0x0FFF_FFFF, 0x7FFF_FFFF, u32::MAX][rng.below(6) as usize].to_le_bytes();
                let end = bytes.len().min(at + 4);
                bytes[at..end].copy_from_slice(&number[..end - at]);
            }
            _ => replace_term(&mut bytes, at, rng),
        }
    }
    bytes
}

/// Replaces the next number of a text.
fn replace_term(bytes: &mut Vec<u8>, from: usize, rng: &mut SplitMix64) {
    let is_number = |byte: &u8| byte.is_ascii_digit() || b"+-.eE".contains(byte);
    let Some(at) = bytes[from..].iter().position(u8::is_ascii_digit).map(|at| from + at) else { return };
    let end = bytes[at..].iter().position(|byte| !is_number(byte)).map_or(bytes.len(), |length| at + length);
    bytes.splice(at..end, TERMS[rng.below(TERMS.len() as u32) as usize].bytes());
}

fn rig() -> StereoRig {
    let pinhole = Pinhole { fx: 60.0, fy: 60.0, cx: 23.5, cy: 15.5 };
    let camera = Camera::new(SIZE, pinhole, Distortion::None).unwrap();
    StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap()
}

fn image() -> RgbImage {
    RgbImage::from_fn(SIZE.width, SIZE.height, |x, y| Rgb([(x * 5) as u8, (y * 7) as u8, (x ^ y) as u8]))
}

/// Files of a valid input by their names.
type Files = BTreeMap<String, Vec<u8>>;

/// An input, and how the program reads it.
struct Input {
    name: &'static str,
    files: Files,
    read: fn(&Path),
}

/// Plays a recording to its end, as `track` and `extract` do.
fn play(path: &Path) {
    let Ok(Recording { mut camera, .. }) =
        Recording::open(path, &[], &RecordingOptions::default(), ReplayOptions::default())
    else {
        return;
    };
    let ended = |kind| matches!(kind, CameraErrorKind::EndOfStream | CameraErrorKind::Unusable);
    while camera.next_pair(Duration::ZERO).map_or_else(|error| !ended(error.kind()), |_| true) {}
}

fn play_and_recover(folder: &Path) {
    play(&folder.join("a.mcap"));
    let _ = recover(&folder.join("a.mcap"), &folder.join("recovered.mcap"));
}

fn read_calibration(folder: &Path) {
    let of_both = ["left.yaml", "right.yaml"].map(|name| folder.join(name));
    let files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    for files in [&files[..], &of_both, &[folder.to_path_buf()]] {
        let _ = (load_stereo(files), load_stereo_for(files, SIZE));
    }
}

fn read_images(folder: &Path) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let file = entry.unwrap().path();
        let _ = (StoredImage::load(&file), check_header(&file, SIZE, "the calibration"));
    }
}

fn encoded(format: ImageFormat) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    image().write_to(&mut file, format).unwrap();
    file.into_inner()
}

/// All messages of a small recording: topic, type, time in nanoseconds and content.
fn messages(compressed: bool) -> Vec<(&'static str, String, u64, Vec<u8>)> {
    let mut messages = Vec::new();
    let infos = ros_camera_infos(&rig()).unwrap();
    for frame in 0..FRAMES {
        let nanos = 33_000_000 * (frame + 1);
        let header = Header { stamp: MonotonicTime::from_nanos(nanos).into(), frame_id: "camera".to_owned() };
        let sides = [
            (ours::LEFT_INFO, ours::LEFT_IMAGE, ours::LEFT_COMPRESSED),
            (ours::RIGHT_INFO, ours::RIGHT_IMAGE, ours::RIGHT_COMPRESSED),
        ];
        for ((info_topic, plain, as_file), info) in sides.into_iter().zip(&infos) {
            let (height, width, header) = (SIZE.height, SIZE.width, header.clone());
            let camera = CameraInfo {
                header: header.clone(),
                height,
                width,
                distortion_model: info.distortion_model.to_owned(),
                d: info.distortion.clone(),
                k: info.camera_matrix,
                r: info.rectification,
                p: info.projection,
                binning_x: 1,
                binning_y: 1,
                roi: RegionOfInterest::default(),
            };
            messages.push((info_topic, CameraInfo::name(), nanos, to_bytes(&camera)));
            if compressed {
                let data = Bytes(encoded(if frame == 0 { ImageFormat::Png } else { ImageFormat::Jpeg }));
                let image = CompressedImage { header, format: String::new(), data };
                messages.push((as_file, CompressedImage::name(), nanos, to_bytes(&image)));
            } else {
                let (encoding, data) = ("rgb8".to_owned(), Bytes(image().into_raw()));
                let image = Image { header, height, width, encoding, is_bigendian: 0, step: 3 * width, data };
                messages.push((plain, Image::name(), nanos, to_bytes(&image)));
            }
        }
    }
    messages
}

fn mcap(messages: &[(&'static str, String, u64, Vec<u8>)], compression: Option<mcap::Compression>) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new().compression(compression).profile("ros2").create(&mut file).unwrap();
    for (topic, ros_type, nanos, data) in messages {
        let schema = writer.add_schema(ros_type, "ros2msg", b"").unwrap();
        let channel_id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap();
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: *nanos, publish_time: *nanos };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}

/// The files of a folder, without its subfolders.
fn files_of(folder: &Path) -> Files {
    let read =
        |entry: std::fs::DirEntry| (entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).unwrap());
    std::fs::read_dir(folder).unwrap().map(|entry| read(entry.unwrap())).collect()
}

fn sequence() -> Files {
    let folder = tempfile::tempdir().unwrap();
    let corners = [[10.0, 8.0], [30.0, 8.0], [30.0, 24.0], [10.0, 24.0]].to_vec();
    let search = SearchRange { z_min_m: 0.3, z_max_m: 1.0, tilt_max_rad: 0.5 };
    let draft = SequenceDraft { region_polygon_left_px: corners, search, images: StoredFormat::Png };
    let mut writer = SequenceWriter::create(folder.path(), &rig(), draft).unwrap();
    let image = image();
    for frame in 0..FRAMES {
        let exposed_at = MonotonicTime::from_nanos(33_000_000 * (frame + 1));
        let (left, right) = (&image, &image);
        writer.push(WrittenFrame { left, right, exposed_at, skew_nanos: 0, cam_left_from_model: None }).unwrap();
    }
    writer.finish().unwrap();
    files_of(folder.path())
}

fn calibrations() -> Vec<(&'static str, Files)> {
    let saved = |save: fn(&Path)| {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path());
        files_of(folder.path())
    };
    vec![
        ("ROS pair", saved(|to| save_ros_pair(&rig(), &to.join("left.yaml"), &to.join("right.yaml")).unwrap())),
        ("Kalibr", saved(|to| save_kalibr(&rig(), &to.join("camchain.yaml")).unwrap())),
        ("OpenCV", saved(|to| save_opencv(&rig(), &to.join("stereo.yml")).unwrap())),
        ("calib.json", saved(|to| save_json(&rig(), &to.join("calib.json")).unwrap())),
    ]
}

/// A recording in the layout of the EuRoC dataset.
fn euroc() -> Files {
    let mut files = Files::new();
    for (side, x) in [("cam0", 0.0), ("cam1", 0.1)] {
        let sensor = format!(
            "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, {x}, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\nresolution: [48, 32]\n\
             camera_model: pinhole\nintrinsics: [60.0, 60.0, 23.5, 15.5]\ndistortion_model: radial-tangential\n\
             distortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
        );
        files.insert(format!("{side}/sensor.yaml"), sensor.into_bytes());
        let times: Vec<u64> = (1..=FRAMES).map(|frame| 33_000_000 * frame).collect();
        let lines: String = times.iter().map(|nanos| format!("{nanos},{nanos}.png\n")).collect();
        files.insert(format!("{side}/data.csv"), format!("#timestamp [ns],filename\n{lines}").into_bytes());
        files.extend(times.iter().map(|nanos| (format!("{side}/data/{nanos}.png"), encoded(ImageFormat::Png))));
    }
    files
}

fn inputs() -> Vec<Input> {
    let recording = |name, compression, compressed| {
        let files = Files::from([("a.mcap".to_owned(), mcap(&messages(compressed), compression))]);
        Input { name, files, read: play_and_recover }
    };
    let mut inputs = vec![
        recording("MCAP", None, false),
        recording("MCAP with image files", None, true),
        recording("MCAP with zstd", Some(mcap::Compression::Zstd), false),
        recording("MCAP with lz4", Some(mcap::Compression::Lz4), false),
        Input { name: "sequence", files: sequence(), read: play },
        Input { name: "EuRoC", files: euroc(), read: play },
    ];
    inputs.extend(calibrations().into_iter().map(|(name, files)| Input { name, files, read: read_calibration }));
    let formats = [
        ("PNG", ImageFormat::Png),
        ("JPEG", ImageFormat::Jpeg),
        ("TIFF", ImageFormat::Tiff),
        ("BMP", ImageFormat::Bmp),
        ("PPM", ImageFormat::Pnm),
        ("WebP", ImageFormat::WebP),
    ];
    inputs.extend(formats.map(|(name, format)| Input {
        name,
        files: Files::from([("a".to_owned(), encoded(format))]),
        read: read_images,
    }));
    inputs
}

fn write_files(folder: &Path, files: &Files) {
    for (name, content) in files {
        let file = folder.join(name);
        create_dir_all(file.parent().unwrap()).unwrap();
        write(file, content).unwrap();
    }
}

/// A value of this process, bytes: `VmRSS`, `VmHWM`.
fn memory(of: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix(of)?.strip_prefix(':')).unwrap();
    1024 * line.trim().trim_end_matches(" kB").parse::<u64>().unwrap()
}

/// Reads files, and checks what that costs.
fn check(what: &str, files: &Files, read: fn(&Path)) {
    let folder = tempfile::tempdir().unwrap();
    write_files(folder.path(), files);
    let seconds = || {
        let now = clock_gettime(ClockId::ThreadCPUTime);
        now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
    };
    // The peak counts from here.
    write("/proc/self/clear_refs", "5").unwrap();
    let (begin_s, begin_bytes) = (seconds(), memory("VmRSS"));
    let result = catch_unwind(AssertUnwindSafe(|| read(folder.path())));
    let (taken_s, bytes) = (seconds() - begin_s, memory("VmHWM").saturating_sub(begin_bytes));
    assert!(result.is_ok(), "{what}: a panic");
    assert!(taken_s < SECONDS_MAX, "{what}: {taken_s:.1} s of processor time");
    assert!(bytes < BYTES_MAX, "{what}: {bytes} bytes");
}

#[test]
fn damaged_inputs_are_read_or_refused() {
    let inputs = inputs();
    let rounds = sweep(20, 150);
    for Input { name, files, read } in &inputs {
        check(name, files, *read);
        for round in 0..rounds {
            let mut rng = SplitMix64::new(round);
            let mut damaged = files.clone();
            let chosen = rng.below(files.len() as u32) as usize;
            let content = damaged.values_mut().nth(chosen).unwrap();
            *content = mutated(content, &mut rng);
            check(&format!("{name}, round {round}"), &damaged, *read);
        }
    }
}

/// Messages with any damage in a file without any: its check sums are right.
#[test]
fn damaged_messages_are_read_or_refused() {
    for compressed in [false, true] {
        let messages = messages(compressed);
        for round in 0..sweep(40, 300) {
            let mut rng = SplitMix64::new(round);
            let mut damaged = messages.clone();
            for _ in 0..=rng.below(3) {
                let chosen = rng.below(damaged.len() as u32) as usize;
                match rng.below(6) {
                    0 => drop(damaged.remove(chosen)),
                    1 => damaged.swap(0, chosen),
                    2 => damaged[chosen].2 = rng.next_u64(),
                    _ => damaged[chosen].3 = mutated(&damaged[chosen].3, &mut rng),
                }
            }
            let files = Files::from([("a.mcap".to_owned(), mcap(&damaged, None))]);
            check(&format!("messages, {compressed}, round {round}"), &files, play_and_recover);
        }
    }
}
