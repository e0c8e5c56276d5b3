//! Recordings of emulated cameras.

use std::os::unix::fs::symlink;
use std::sync::Mutex;

use clap::Parser as _;
use pb3dp_bag::messages::{Image, Text};
use pb3dp_bag::pairs::{PairOptions, StereoBag, decoded};
use pb3dp_bag::topics::ours;
use pb3dp_camera_v4l2::emulated::EmulatedCamera;
use pb3dp_record::calibration_files::{StatedCalibration, load_stereo, save_opencv};
use pb3dp_record::dataset::load_sequence;

use super::super::emulated_rig::{case, images, number_in, system, system_of_one, typed, typed_of_one, typed_of_setup};
use super::*;
use crate::cli::{Cli, Command};

/// A folder for recordings, and the arguments that lead there.
struct Place {
    folder: tempfile::TempDir,
    calibration: String,
}

impl Place {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), calibration: case().calibration.display().to_string() }
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("sequence")
    }

    fn args(&self, more: &[&str]) -> RecordArgs {
        let out = self.out().display().to_string();
        let words = [
            &["--format", "RGB3", "--calib", &self.calibration, "--out", &out, "--queue", "20", "--writers", "2"],
            more,
        ]
        .concat();
        typed(&words)
    }
}

fn never() -> bool {
    false
}

#[test]
fn every_pair_is_kept_as_it_was_and_track_reads_it() {
    let place = Place::new();
    let case = case();
    let corners: Vec<String> = case.region_polygon_left_px.iter().map(|[u, v]| format!("{u},{v}")).collect();
    let range = format!("{},{}", case.search.z_min_m * 1e3, case.search.z_max_m * 1e3);
    let region = format!("poly:{}", corners.join(";"));
    let args = place.args(&["--pairs", "6", "--region", &region, "--z-range", &range]);
    let (system, clock) = system(|_, _| {});
    let line = recorded(system, clock, &args, &mut never).unwrap();
    assert_eq!((line.pairs, line.wrong()), (6, None));
    assert!(line.text().starts_with("6 pairs in 0.17 s (30.00 per second), 0 missing"), "{}", line.text());
    let sequence = load_sequence(&place.out()).unwrap();
    assert_eq!((sequence.frames(), sequence.skew_s.as_slice()), (6, [1e-3; 6].as_slice()));
    let size = ImageSize { width: 640, height: 480 };
    for frame in 0..6 {
        let read = sequence.load_images(frame, size).unwrap();
        assert_eq!((number_in(&read.left), number_in(&read.right)), (frame, frame));
        for (read, painted) in [&read.left, &read.right].into_iter().zip(images()) {
            assert_eq!(read.as_raw()[8..], painted.as_raw()[8..], "frame {frame}");
        }
        let since = sequence.times_s[frame as usize] - sequence.times_s[0];
        assert!((since - frame as f64 / 30.0).abs() < 1e-6, "frame {frame} after {since} s");
    }
    let out = place.out().display().to_string();
    let cli = Cli::try_parse_from(["pb3dp", "track", "--json", "--sequence", &out]).unwrap();
    let Command::Track(track) = &cli.command else { panic!("{cli:?}") };
    assert_eq!(crate::commands::track::run(track).unwrap(), ExitCode::SUCCESS);
}

#[test]
fn a_recording_says_what_the_setup_says_of_the_target_unless_it_is_typed() {
    let place = Place::new();
    let size = ImageSize { width: 640, height: 480 };
    let range =
        pb3dp_estimation_core::plane_hypothesis::SearchRange { z_min_m: 0.35, z_max_m: 0.65, tilt_max_rad: 0.5 };
    let with = |region: &str| ChosenTarget { region: Some(region.parse().unwrap()), range: Some(range) };
    let lines_of = |more: &[&str], target: &ChosenTarget| {
        let SequenceDraft { region_polygon_left_px, search, .. } = draft(&place.args(more), target, size).unwrap();
        (region_polygon_left_px[0], [search.z_min_m, search.z_max_m, search.tilt_max_rad])
    };
    let of_setup = with("rect:100,120,80,60");
    assert_eq!(lines_of(&[], &of_setup), ([100.0, 120.0], [0.35, 0.65, 0.5]));
    let typed = ["--region", "rect:7,8,90,90", "--z-range", "400,500", "--tilt-max", "10"];
    assert_eq!(lines_of(&typed, &of_setup), ([7.0, 8.0], [0.4, 0.5, 10_f64.to_radians()]));
    // A point is no polygon; nothing is said without a setup.
    assert_eq!(lines_of(&[], &with("click:300,200")), ([240.0, 180.0], [0.35, 0.65, 0.5]));
    assert_eq!(lines_of(&[], &ChosenTarget::default()), ([240.0, 180.0], [0.3, 0.8, 60_f64.to_radians()]));
    let outside = draft(&place.args(&[]), &with("rect:600,120,80,60"), size).unwrap_err().to_string();
    assert!(outside.contains("camera.region: the corner 680,120 is outside"), "{outside}");
}

#[test]
fn an_end_by_hand_is_an_end_in_order() {
    let place = Place::new();
    let mut calls = 0;
    let mut is_over = || {
        calls += 1;
        calls > 4
    };
    let (system, clock) = system(|_, _| {});
    let line = recorded(system, clock, &place.args(&["--jpeg", "90"]), &mut is_over).unwrap();
    assert_eq!((line.pairs, line.wrong()), (4, None));
    assert!(load_sequence(&place.out()).unwrap().image_files(3).0.ends_with("left_0003.jpg"));
    let (system, clock) = super::super::emulated_rig::system(|_, _| {});
    let error = recorded(system, clock, &place.args(&[]), &mut never).unwrap_err();
    assert!(format!("{error:#}").contains("give an empty folder"), "{error:#}");
}

/// The options that a refused calibration asks for.
#[test]
fn what_the_calibration_leaves_unstated_can_be_stated() {
    let Place { folder, calibration } = Place::new();
    let rig = load_stereo(&[calibration.into()]).unwrap().rig;
    let file = folder.path().join("stereo.yml");
    save_opencv(&rig, &file).unwrap();
    let text = std::fs::read_to_string(&file).unwrap().replace("units: m\n", "").replace("T: !!", "was_T: !!");
    std::fs::write(&file, text + "T: [-12, 0, 0]\n").unwrap();
    let place = Place { calibration: file.display().to_string(), folder };
    let chosen = |args: RecordArgs| args.cameras.chosen(&args.calibration.stated());
    let refused = format!("{:#}", chosen(place.args(&[])).unwrap_err());
    assert!(refused.contains("--calib-unit mm or --calib-unit cm"), "{refused}");
    let stated = chosen(place.args(&["--calib-unit", "cm"])).unwrap().rig.unwrap();
    assert!((stated.baseline_m() - 0.12).abs() < 1e-12);
    let of_setup = chosen(typed_of_setup(&["--calib-unit", "cm", "--out", "x"])).unwrap_err().to_string();
    assert!(of_setup.contains("have no effect: they are about the file of --calib"), "{of_setup}");
}

#[test]
fn seconds_are_those_of_the_cameras() {
    let place = Place::new();
    let (system, clock) = system(|_, _| {});
    let line = recorded(system, clock, &place.args(&["--seconds", "0.3"]), &mut never).unwrap();
    assert!((7..=9).contains(&line.pairs), "{line:?}");
}

/// A writer into the place, and cameras, for the recorder itself.
fn parts(place: &Place, plan: &[&str]) -> (V4l2StereoCamera, Arc<dyn Clock>, SequenceWriter) {
    let args = place.args(plan);
    let Chosen { config, rig, target, .. } = args.cameras.chosen(&StatedCalibration::default()).unwrap();
    let rig = rig.unwrap();
    let (system, clock) = system(|_, _| {});
    let camera = V4l2StereoCamera::open(system, clock.clone(), &config).unwrap();
    let draft = draft(&args, &target, rig.left().size()).unwrap();
    (camera, clock, SequenceWriter::create(&args.out, &rig, draft).unwrap())
}

#[test]
fn pairs_that_find_no_room_are_counted_and_fail_the_command() {
    let place = Place::new();
    let (mut camera, clock, writer) = parts(&place, &[]);
    // Nobody writes until ten pairs were taken.
    let gate = Mutex::new(());
    let mut closed = gate.lock().ok();
    let mut calls = 0;
    let mut is_over = || {
        calls += 1;
        if calls > 10 {
            closed = None;
        }
        calls > 10
    };
    let plan = Plan { pairs_max: None, time_max: None, queue: 3, writers: 2 };
    let save = |files: &pb3dp_record::dataset::FrameFiles, pair: &pb3dp_hal_api::FramePair| {
        drop(gate.lock());
        files.save(&pair.left, &pair.right)
    };
    let outcome = record(&mut camera, clock.as_ref(), writer, &plan, &save, &mut is_over);
    assert_eq!(outcome.missing, Missing { queue: 7, cameras: 0 });
    let line = Recorded::of(outcome, &place.out());
    assert_eq!(line.pairs, 3);
    let wrong = line.wrong().unwrap();
    assert!(wrong.contains("7 pairs were left out") && wrong.contains("--jpeg 90"), "{wrong}");
    assert_eq!(load_sequence(&place.out()).unwrap().frames(), 3);
}

#[test]
fn a_full_disk_ends_it_and_what_was_written_stays_whole() {
    let place = Place::new();
    std::fs::create_dir_all(place.out()).unwrap();
    // What is written there finds no room: that image, and the first try of the description.
    symlink("/dev/full", place.out().join("right_0005.png")).unwrap();
    symlink("/dev/full", place.out().join("sequence.json.partial")).unwrap();
    let (system, clock) = system(|_, _| {});
    let line = recorded(system, clock, &place.args(&["--pairs", "12"]), &mut never).unwrap();
    let wrong = line.wrong().unwrap();
    for part in ["the disk is full", "bytes are free", "right_0005.png", "4 pairs before it are kept in", "make room"] {
        assert!(wrong.contains(part), "{part:?} is missing: {wrong}");
    }
    assert_eq!(line.pairs, 4);
    let sequence = load_sequence(&place.out()).unwrap();
    assert_eq!(sequence.frames(), 4);
    assert!(sequence.load_images(3, ImageSize { width: 640, height: 480 }).is_ok());
    assert!(!place.out().join("left_0005.png").exists() && !place.out().join("left_0004.png").exists());
}

#[test]
fn a_camera_that_is_pulled_or_silent_ends_it_with_what_there_is() {
    for (what, expected) in [("pulled", "the camera is disconnected"), ("silent", "no data arrives")] {
        let place = Place::new();
        let (system, clock) = system(|_, _| {});
        let mut calls = 0;
        let pulled = Arc::clone(&system);
        let mut is_over = || {
            calls += 1;
            if calls == 4 {
                pulled.with(1, |camera| {
                    camera.faults.is_unplugged = what == "pulled";
                    camera.faults.is_silent = what == "silent";
                });
            }
            false
        };
        let line = recorded(system, clock, &place.args(&["--pairs", "9"]), &mut is_over).unwrap();
        let wrong = line.wrong().unwrap();
        assert!(wrong.contains(expected) && wrong.contains("3 pairs before it are kept"), "{what}: {wrong}");
        assert_eq!(load_sequence(&place.out()).unwrap().frames(), 3);
    }
}

#[test]
fn pairs_that_the_cameras_lose_are_counted_and_fail_the_command() {
    let place = Place::new();
    let (system, clock) = system(|_, _| {});
    let mut calls = 0;
    let losing = Arc::clone(&system);
    let mut is_over = || {
        calls += 1;
        if calls == 3 {
            losing.with(0, |camera| camera.faults.damaged = 1);
        }
        false
    };
    let line = recorded(system, clock, &place.args(&["--pairs", "6"]), &mut is_over).unwrap();
    assert_eq!((line.pairs, line.missing_cameras, line.missing_queue), (6, 1, 0));
    assert!(line.wrong().unwrap().contains("1 pairs did not come from the cameras"));
}

#[test]
fn what_can_not_be_recorded_is_refused_before_anything_is_written() {
    let place = Place::new();
    let refused = |args: &RecordArgs| {
        let (system, clock) = system(|_, _| {});
        format!("{:#}", recorded(system, clock, args, &mut never).unwrap_err())
    };
    assert!(refused(&place.args(&["--region", "rect:600,10,80,20"])).contains("the corner 680,10 is outside"));
    assert!(refused(&place.args(&["--region", "click:1,2"])).contains("a sequence has a polygon"));
    assert!(
        refused(&place.args(&["--size", "320x240"]))
            .contains("the images have 320x240 pixels, the calibration 640x480")
    );
    assert!(refused(&place.args(&["--rate", "60"])).contains("60.000 images per second"));
    let uncalibrated: RecordArgs = typed(&["--format", "RGB3", "--out", &place.out().display().to_string()]);
    assert!(refused(&uncalibrated).contains("give --calib FILE"));
    assert!(!place.out().exists());
}

/// One file, with the calibration and without.
#[test]
fn a_file_has_every_pair_as_it_was() {
    let place = Place::new();
    let of_file = |name: &str, calibration: &[&str]| {
        let out = place.folder.path().join(name);
        let text = out.display().to_string();
        let args = typed(&[&["--format", "RGB3", "--out", &text, "--pairs", "6"], calibration].concat());
        let (system, clock) = system(|_, _| {});
        let line = recorded(system, clock, &args, &mut never).unwrap();
        assert_eq!((line.pairs, line.wrong(), line.file), (6, None, Some(out.clone())));
        let bag = StereoBag::open(&out, PairOptions::default()).unwrap();
        for (number, pair) in bag.pairs().enumerate() {
            let pair = pair.unwrap();
            assert_eq!(pair.skew_nanos, 1_000_000);
            for (read, painted) in pair.images.unwrap().iter().zip(images()) {
                assert_eq!(number_in(read), number as u64);
                assert_eq!(read.as_raw()[8..], painted.as_raw()[8..]);
            }
        }
        bag
    };
    let with = of_file("with.mcap", &["--calib", &place.calibration]);
    let expected = load_stereo(&[place.calibration.clone().into()]).unwrap();
    assert_eq!(with.calibration(&StatedCalibration::default()).unwrap().rig.left(), expected.rig.left());
    let without = of_file("without.mcap", &[]);
    assert!(without.calibration(&StatedCalibration::default()).unwrap_err().to_string().contains("--calib"));
    let again = typed(&["--format", "RGB3", "--out", &place.folder.path().join("with.mcap").display().to_string()]);
    let (system, clock) = system(|_, _| {});
    let error = recorded(system, clock, &again, &mut never).unwrap_err();
    assert!(format!("{error:#}").contains("exists already"), "{error:#}");
    let of_folder = typed(&["--format", "RGB3", "--out", "new.mcap", "--jpeg", "90"]);
    let (system, clock) = super::super::emulated_rig::system(|_, _| {});
    let error = recorded(system, clock, &of_folder, &mut never).unwrap_err();
    assert!(error.to_string().starts_with("--jpeg: only a folder"), "{error:#}");
}

/// Bytes of an image that no format takes for another; each number has its own.
fn paint_bytes(number: u64, memory: &mut [u8]) {
    for (index, byte) in memory.iter_mut().enumerate() {
        *byte = ((index / 7 + index / 640 * 3) as u64 + 31 * number) as u8;
    }
}

/// What the camera delivers is in the file, without the padding of its rows, and gives the same images again.
#[test]
fn a_file_has_the_bytes_of_the_camera() {
    let place = Place::new();
    for (fourcc, encoding, step) in [
        (*b"GREY", "mono8", 640),
        (*b"YUYV", "yuv422_yuy2", 1280),
        (*b"BA81", "bayer_bggr8", 640),
        (*b"RGB3", "rgb8", 1920),
    ] {
        let change = |_: usize, camera: &mut EmulatedCamera| {
            camera.formats[0].0 = fourcc;
            camera.padding = 24;
            camera.paint = paint_bytes;
        };
        let (name, out) = (encoding, place.folder.path().join(format!("{encoding}.mcap")));
        let format = std::str::from_utf8(&fourcc).unwrap();
        let args: RecordArgs = typed(&["--format", format, "--out", &out.display().to_string(), "--pairs", "3"]);
        let (system_of_file, clock) = system(change);
        assert_eq!(recorded(system_of_file, clock, &args, &mut never).unwrap().pairs, 3, "{name}");
        let (system, clock) = system(change);
        let config = args.cameras.chosen(&StatedCalibration::default()).unwrap().config;
        let mut camera = V4l2StereoCamera::open(system, clock, &config).unwrap();
        let bag = StereoBag::open(&out, PairOptions::default()).unwrap();
        let expected: Vec<_> = (0..3).map(|_| camera.next_pair(Duration::from_secs(1)).unwrap()).collect();
        for (pair, expected) in bag.pairs().zip(&expected) {
            assert_eq!(pair.unwrap().images.unwrap(), [expected.left.clone(), expected.right.clone()], "{name}");
        }
        let messages = bag.bag().messages_on(&[ours::LEFT_IMAGE]).unwrap();
        for (number, message) in messages.enumerate() {
            let image: Image = decoded(&message.unwrap()).unwrap();
            assert_eq!(
                (image.encoding.as_str(), image.step, image.data.0.len()),
                (encoding, step, 480 * step as usize)
            );
            let mut memory = vec![0; 480 * (step as usize + 24)];
            paint_bytes(number as u64, &mut memory);
            let rows = memory.chunks(step as usize + 24).map(|row| &row[..step as usize]);
            assert!(image.data.0.chunks(step as usize).eq(rows), "{name}");
        }
    }
}

/// Each view of one device is in the file as it was delivered, with the same stamp, and gives the same images again.
#[test]
fn a_file_has_both_views_of_one_device() {
    let place = Place::new();
    for (fourcc, layout, width, encoding, step) in [
        (*b"Y12 ", "side-by-side", 1280, "mono16", 1280),
        (*b"Y8I ", "interleaved", 640, "mono8", 640),
        (*b"NV12", "side-by-side", 1280, "rgb8", 1920),
    ] {
        let change = |camera: &mut EmulatedCamera| {
            camera.formats[0].0 = fourcc;
            camera.formats[0].1[0].0.width = width;
            (camera.padding, camera.paint) = (24, paint_bytes);
        };
        let out = place.folder.path().join(format!("{encoding}.mcap"));
        let format = std::str::from_utf8(&fourcc).unwrap().trim_end();
        let words = ["--format", format, "--out", &out.display().to_string(), "--pairs", "3"];
        let args: RecordArgs = typed_of_one(layout, &words);
        let (of_file, clock) = system_of_one(change);
        assert_eq!(recorded(of_file, clock, &args, &mut never).unwrap().pairs, 3, "{format}");
        let (system, clock) = system_of_one(change);
        let config = args.cameras.chosen(&StatedCalibration::default()).unwrap().config;
        let mut camera = V4l2StereoCamera::open(system, clock, &config).unwrap();
        let options = PairOptions { range: config.value_range(), ..PairOptions::default() };
        let bag = StereoBag::open(&out, options).unwrap();
        let mut found = 0;
        for pair in bag.pairs() {
            let (pair, expected) = (pair.unwrap(), camera.next_pair(Duration::from_secs(1)).unwrap());
            assert_eq!((pair.skew_nanos, expected.skew_nanos), (0, 0));
            assert!(expected.left != expected.right, "{format}: the views must differ");
            assert!(pair.images.unwrap() == [expected.left, expected.right], "{format}");
            found += 1;
        }
        assert_eq!(found, 3);
        let messages = bag.bag().messages_on(&[ours::LEFT_IMAGE, ours::RIGHT_IMAGE]).unwrap();
        let images: Vec<Image> = messages.map(|message| decoded(&message.unwrap()).unwrap()).collect();
        assert_eq!(images.len(), 6);
        for image in images {
            assert_eq!(
                (image.encoding.as_str(), image.step, image.data.0.len()),
                (encoding, step, 480 * step as usize)
            );
        }
    }
}

#[test]
fn a_recording_states_the_skew_and_its_cost() {
    let place = Place::new();
    let (system, clock) = system(|side, camera| camera.phase = Duration::from_millis(40 + 4 * side as u64));
    let line = recorded(system, clock, &place.args(&["--pairs", "3"]), &mut never).unwrap();
    assert!((line.skew_max_ms - 4.0).abs() < 1e-9 && line.skew_refused == 0, "{line:?}");
    let baseline_mm = load_stereo(&[case().calibration]).unwrap().rig.baseline_m() * 1e3;
    let cost = format!(
        "skew at most 4.00 ms: at 100 mm/s and a distance of 500 mm this is a depth error of {:.2} mm; 0 pairs refused",
        0.4 * 500.0 / baseline_mm
    );
    assert!(line.text().contains(&cost), "{} has not {cost}", line.text());
    // Above the limit no pair is recorded, and the error says what to do.
    let place = Place::new();
    let (system, clock) = system_of_phases(8);
    let line = recorded(system, clock, &place.args(&["--pairs", "3"]), &mut never).unwrap();
    let wrong = line.wrong().unwrap();
    for part in [
        "right was exposed 8.0 ms after left, at most 5.0 ms is allowed",
        "a depth error of",
        "--skew-max) and move slowly",
    ] {
        assert!(wrong.contains(part), "{part} is not in {wrong}");
    }
    assert!(line.skew_refused > 10, "{line:?}");
    let (system, clock) = system_of_phases(8);
    let line = recorded(system, clock, &place.args(&["--pairs", "3", "--skew-max", "9"]), &mut never).unwrap();
    assert_eq!((line.pairs, line.wrong()), (3, None));
}

fn system_of_phases(apart_millis: u64) -> (Arc<pb3dp_camera_v4l2::emulated::EmulatedSystem>, Arc<dyn Clock>) {
    system(|side, camera| camera.phase = Duration::from_millis(40 + apart_millis * side as u64))
}

#[test]
fn a_shared_exposure_is_settled_first_and_each_change_is_recorded() {
    let place = Place::new();
    let file = place.folder.path().join("pairs.mcap");
    let args: RecordArgs = typed_of_setup(&[
        "--set",
        "camera.left.exposure_millis=\"shared\"",
        "--set",
        "camera.right.exposure_millis=\"shared\"",
        "--out",
        &file.display().to_string(),
        "--pairs",
        "150",
    ]);
    let (system, clock) = system(|_, camera| camera.light = Some(4.0));
    let (mut pairs, cameras) = (0, Arc::clone(&system));
    // The light falls by a third after a second.
    let mut darker = || {
        pairs += 1;
        if pairs == 30 {
            for side in 0..2 {
                cameras.with(side, |camera| camera.light = camera.light.map(|light| light / 1.5)).unwrap();
            }
        }
        false
    };
    let line = recorded(system, clock, &args, &mut darker).unwrap();
    assert_eq!((line.pairs, line.wrong()), (150, None));
    let bag = StereoBag::open(&file, PairOptions::default()).unwrap();
    let messages = bag.bag().messages().map(Result::unwrap).filter(|message| message.channel.topic == ours::EXPOSURE);
    let lines_of: Vec<serde_json::Value> =
        messages.map(|message| serde_json::from_str(&decoded::<Text>(&message).unwrap().data).unwrap()).collect();
    // That of the first pair; then for each change the first pair after it, and the first settled one.
    let number = |value: &serde_json::Value, key: &str| value[key].as_f64().unwrap();
    assert!(lines_of.len() >= 5 && lines_of[0]["is_settling"] == false, "{lines_of:?}");
    for two in lines_of[1..].chunks(2).filter(|two| two.len() == 2) {
        assert!(two[0]["is_settling"] == true && two[1]["is_settling"] == false, "{two:?}");
        assert!(two[0]["changes"] == two[1]["changes"] && (1.0..=1.1).contains(&number(&two[0], "factor")), "{two:?}");
    }
    let between: Vec<f64> = lines_of[1..].chunks(2).map(|two| number(&two[0], "sequence")).collect();
    assert!(between.windows(2).all(|two| two[1] - two[0] >= 29.0), "{between:?}");
}
