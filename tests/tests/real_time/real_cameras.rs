//! A run with real cameras, whose drivers are emulated call by call: no truth, a marked region, and disconnected cameras.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::sync::{Arc, LazyLock};
use std::thread::sleep;
use std::time::Duration;

use pb3dp_camera_settings::Interval;
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem};
use pb3dp_cell::experiment::{Ended, conduct};
use pb3dp_cell::summary::summarize;
use pb3dp_cell::swing;
use pb3dp_geometry::{Camera, ImageSize, Pinhole, StereoRig};
use pb3dp_hal_clock::SystemClock;
use pb3dp_record::dataset::load_sequence;
use pb3dp_servo::identification::Excitation;
use pb3dp_setup::setup::{ArmLink, RealCameras, Setup, read_setup};
use pb3dp_test_support::programs_in_real_time_beside_others;
use pb3dp_wiring::wire_with;
use system_tests::repository;

/// Half of the size in `configs/rig.toml`, and half of its rate.
const SIZE: ImageSize = ImageSize { width: 320, height: 240 };
const RATE: Interval = Interval { numerator: 1, denominator: 15 };
/// A plane at 500 mm, at the start of the hand: 370 px times 100 mm over 500 mm.
const DISPARITY_PX: usize = 74;

/// Brightness of the scene: blocks of 5 pixels.
static SCENE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let width = SIZE.width as usize + DISPARITY_PX;
    let block = |u: usize, v: usize| {
        let mixed = (u / 5).wrapping_mul(0x9E37_79B1).wrapping_add((v / 5).wrapping_mul(0x85EB_CA77));
        (60 + (mixed ^ (mixed >> 13)).wrapping_mul(0xC2B2_AE35) / 65_536 % 130) as u8
    };
    (0..SIZE.height as usize).flat_map(|v| (0..width).map(move |u| block(u, v))).collect()
});

/// The scene from a column on; a clock in the first pixels makes each image different.
fn paint(from: usize, number: u64, memory: &mut [u8]) {
    let width = SIZE.width as usize;
    for (v, row) in memory.chunks_exact_mut(2 * width).enumerate() {
        let scene = &SCENE[v * (width + DISPARITY_PX) + from..];
        for (pixel, brightness) in row.chunks_exact_mut(2).zip(scene) {
            pixel.copy_from_slice(&[*brightness, 128]);
        }
    }
    for (k, byte) in memory.iter_mut().step_by(2).take(8).enumerate() {
        *byte = 16 + (number >> (4 * k) & 15) as u8 * 8;
    }
}

/// The rig of `configs/rig.toml` with smaller images, and simulated arms.
fn rig() -> (Setup, EmulatedSystem) {
    let mut setup = read_setup(&repository().join("configs/rig.toml")).unwrap();
    let side = |number: u32, paint: fn(u64, &mut [u8])| {
        let mut camera = EmulatedCamera::usual(number);
        camera.formats = vec![(*b"YUYV", vec![(SIZE, vec![RATE])])];
        camera.paint = paint;
        camera
    };
    let left = side(0, |number, memory| paint(0, number, memory));
    let right = side(1, |number, memory| paint(DISPARITY_PX, number, memory));
    let system = EmulatedSystem::new(Arc::new(SystemClock::new()), vec![left, right]);
    let cameras = cameras(&mut setup);
    for (number, side) in [&mut cameras.stereo.left, &mut cameras.stereo.right].into_iter().enumerate() {
        side.name = format!("bus:usb-emulated-{number}").parse().unwrap();
        (side.mode.size, side.mode.interval) = (SIZE, RATE);
    }
    // 50 mm to the right of the left camera: straight in front of the hand.
    cameras.region = Some("rect:157,80,80,80".parse().unwrap());
    let whole = setup.rig.stereo.left().pinhole();
    let half = Pinhole { fx: whole.fx / 2.0, fy: whole.fy / 2.0, cx: 159.5, cy: 119.5 };
    let camera = Camera::new(SIZE, half, *setup.rig.stereo.left().distortion()).unwrap();
    setup.rig.stereo = StereoRig::new(camera, camera, *setup.rig.stereo.cam_right_from_cam_left()).unwrap();
    setup.rig.frames.period = Duration::from_secs(1) / 15;
    (setup.rig.arms.vs.link, setup.rig.arms.tc.link) = (ArmLink::InProcess, ArmLink::InProcess);
    // The run resumes by itself: the policies of a rig wait for an operator after a second.
    setup.supervisor = read_setup(&repository().join("configs/hil.toml")).unwrap().supervisor;
    (setup, system)
}

fn cameras(setup: &mut Setup) -> &mut RealCameras {
    setup.rig.real_cameras.as_mut().unwrap()
}

/// Runs for this time; `fate` acts meanwhile.
fn run(setup: &Setup, system: &EmulatedSystem, seconds: f64, fate: impl FnOnce() + Send) -> Ended {
    let parts = wire_with(setup, Arc::new(system.clone())).unwrap().parts;
    std::thread::scope(|scope| {
        scope.spawn(fate);
        conduct(setup, parts, Some(seconds), None).unwrap()
    })
}

fn plug(system: &EmulatedSystem, number: usize, is_in: bool) {
    system.with(number, |camera| camera.faults.is_unplugged = !is_in).unwrap();
}

#[test]
fn what_real_cameras_see_is_recorded_and_can_be_read() {
    programs_in_real_time_beside_others(records);
}

fn records() {
    let (setup, system) = rig();
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("recording");
    let parts = wire_with(&setup, Arc::new(system)).unwrap().parts;
    let Ended { outcome, how, .. } = conduct(&setup, parts, Some(2.0), Some(&folder)).unwrap();
    how.unwrap();
    let sequence = load_sequence(&folder).unwrap();
    assert!(!sequence.is_unfinished && sequence.frames() > 10, "{} frames", sequence.frames());
    assert!(sequence.frames() as usize <= outcome.log.leading.frames.len() + 1);
    // The region is the marked one, and the truth is unknown.
    let side = |axis: usize| sequence.region_polygon_left_px.iter().map(move |corner| corner[axis]);
    let ends = [0, 1].map(|axis| [side(axis).fold(f64::MAX, f64::min), side(axis).fold(f64::MIN, f64::max)]);
    let is_near = |found: f64, expected: f64| (found - expected).abs() < 3.0;
    let marked = [[157.0, 237.0], [80.0, 160.0]];
    assert!(
        ends.iter().flatten().zip(marked.iter().flatten()).all(|(found, expected)| is_near(*found, *expected)),
        "{ends:?}"
    );
    assert!(sequence.cam_left_from_model.is_none());
    assert!((sequence.search.z_min_m - setup.range.z_min_m).abs() < 1e-9, "{:?}", sequence.search);
    // Each pair is a painted one, left and right with the same number, 67 ms or a multiple of that after the previous pair.
    let number = |image: &image::RgbImage| (0..8).map(|u| u32::from(image.get_pixel(u, 0)[0])).collect::<Vec<_>>();
    let read = |frame| sequence.load_images(frame, SIZE).unwrap();
    for frame in 1..sequence.frames() {
        let (before, now) = (read(frame - 1), read(frame));
        assert_eq!(number(&now.left), number(&now.right), "frame {frame}");
        assert_ne!(number(&now.left), number(&before.left), "frame {frame}");
        let periods = (sequence.times_s[frame as usize] - sequence.times_s[frame as usize - 1]) * 15.0;
        assert!((periods - periods.round()).abs() < 0.01 && periods > 0.9, "frame {frame}: {periods} periods");
    }
}

#[test]
fn a_hand_is_swung_before_the_region_that_is_marked() {
    programs_in_real_time_beside_others(swings);
}

fn swings() {
    let (setup, system) = rig();
    let parts = wire_with(&setup, Arc::new(system)).unwrap().parts;
    let swung = swing::run(&setup, parts, Excitation::new(3e-3, 6.0).unwrap()).unwrap();
    assert!(swung.observed.len() > 40 && swung.joints.len() > 400, "{} seen", swung.observed.len());
    // Pose of the marked region: straight in front of the hand, at 500 mm, in images that never change.
    let first = swung.observed[0].cam_left_from_model.translation_m();
    assert!((first.z - 0.5).abs() < 0.01 && (first.x - 0.05).abs() < 0.01, "{first}");
    let joint = |k: usize| swung.joints.iter().map(move |sample| sample.position_rad[k]);
    let way = (0..7).map(|k| joint(k).fold(f64::MIN, f64::max) - joint(k).fold(f64::MAX, f64::min)).fold(0.0, f64::max);
    assert!(way > 1e-3, "no joint has moved by more than {way} rad");
}

#[test]
fn a_hand_holds_its_place_rests_while_a_camera_is_away_and_goes_on() {
    programs_in_real_time_beside_others(holds_rests_and_goes_on);
}

fn holds_rests_and_goes_on() {
    let (setup, system) = rig();
    let Ended { outcome, how, .. } = run(&setup, &system, 9.0, || {
        sleep(Duration::from_secs(4));
        plug(&system, 1, false);
        sleep(Duration::from_millis(1500));
        plug(&system, 1, true);
    });
    how.unwrap();
    let summary = summarize(&outcome.log, &outcome.plan);
    let steps: Vec<(&str, &str)> = summary.supervisor.transitions.iter().map(|step| (step.from, step.to)).collect();
    let summary_text = format!("{steps:?}, {:?}, {:?}", summary.frames_by_status, summary.supervisor.transitions);
    let moving = |state: &str| ["approaching", "tracking"].contains(&state);
    let rests = steps
        .iter()
        .position(|(from, to)| moving(from) && *to == "holding")
        .unwrap_or_else(|| panic!("{summary_text}"));
    assert!(summary.supervisor.transitions[rests].why.contains("frame pair"), "{summary_text}");
    assert!(steps[rests..].iter().any(|(_, to)| moving(to)), "{summary_text}");
    assert!(summary.supervisor.steps_found["frame_stale"] > 50 && summary.pairs_lost >= 8, "{summary_text}");
    // The hand is at its desired pose by its own images, which never change: neither the pose nor the calibration drifts.
    let (first, last) = (outcome.log.control.first().unwrap(), outcome.log.control.last().unwrap());
    let moved = (last.world_from_hand.translation_m() - first.world_from_hand.translation_m()).norm();
    assert!(moved < 0.02 && last.t_s > 8.5, "{moved} m in {} s", last.t_s);
    assert!(summary.frames > 50 && summary.frames_without_pose < summary.frames / 4, "{summary_text}");
    // The cameras were checked every two seconds.
    assert_eq!(summary.drift.len(), 4, "{:?}", summary.drift);
    assert!(summary.drift.iter().all(|one| one.looks + one.blind_looks >= 2), "{:?}", summary.drift);
    // The truth is unknown.
    assert!(summary.without_truth && summary.lock.is_none() && summary.channels.is_empty(), "{summary:?}");
    assert!(summary.tracking_position_mm.is_none() && summary.estimation_depth_mm.is_none(), "{summary:?}");
}

#[test]
fn a_hand_does_not_go_on_with_exchanged_cameras() {
    programs_in_real_time_beside_others(rests_with_exchanged_cameras);
}

/// Both cables are pulled and plugged in exchanged: cameras with serial numbers differ from the calibrated ones, and without numbers
/// their images do.
fn rests_with_exchanged_cameras() {
    for has_numbers in [true, false] {
        let (setup, system) = rig();
        let numbers = |number: usize| has_numbers.then(|| format!("SN{number}"));
        (0..2).for_each(|number| system.with(number, |camera| camera.entry.serial = numbers(number)).unwrap());
        let Ended { outcome, how, .. } = run(&setup, &system, 8.0, || {
            sleep(Duration::from_secs(4));
            (0..2).for_each(|number| plug(&system, number, false));
            sleep(Duration::from_millis(300));
            (0..2).for_each(|number| {
                let port = format!("usb-emulated-{}", 1 - number);
                system.with(number, |camera| camera.capability.bus = port).unwrap();
                plug(&system, number, true);
            });
        });
        how.unwrap();
        let summary = summarize(&outcome.log, &outcome.plan);
        let steps: Vec<_> = summary.supervisor.transitions.iter().map(|step| step.to).collect();
        let moved = steps.iter().rposition(|to| ["approaching", "tracking"].contains(to));
        let rests = steps.iter().rposition(|to| *to == "holding");
        assert!(moved.is_some() && rests > moved, "{steps:?}");
        // Each one that is refused is compared in four orders.
        assert!(summary.pairs_lost > 10, "{} pairs lost", summary.pairs_lost);
    }
}

#[test]
fn a_camera_that_is_not_waited_for_ends_the_run_with_both_arms_stopped() {
    programs_in_real_time_beside_others(ends_with_its_camera);
}

fn ends_with_its_camera() {
    let (mut setup, system) = rig();
    cameras(&mut setup).reopen_for = Duration::ZERO;
    let Ended { outcome, how, .. } = run(&setup, &system, 60.0, || {
        sleep(Duration::from_secs(2));
        plug(&system, 0, false);
    });
    let failure = format!("{:#}", how.unwrap_err());
    assert!(failure.contains("camera: bus:usb-emulated-0") && failure.contains("check its plug"), "{failure}");
    assert!(outcome.log.control.last().unwrap().t_s < 10.0);
}

#[test]
fn cameras_that_can_not_serve_are_refused_before_an_arm_is_switched_on() {
    let refused = |change: &dyn Fn(&mut Setup, &EmulatedSystem)| {
        let (mut setup, system) = rig();
        change(&mut setup, &system);
        let error = wire_with(&setup, Arc::new(system)).map(|_| ()).unwrap_err();
        format!("{error:#}")
    };
    let text = refused(&|setup, _| cameras(setup).region = None);
    assert!(text.contains("no target is marked") && text.contains("--region"), "{text}");
    let text = refused(&|setup, _| {
        let stereo = &mut cameras(setup).stereo;
        std::mem::swap(&mut stereo.left.name, &mut stereo.right.name);
    });
    assert!(text.contains("left and right look exchanged") && text.contains("right.device"), "{text}");
    let text = refused(&|_, system| plug(system, 1, false));
    assert!(text.contains("bus:usb-emulated-1: no such camera"), "{text}");
}
