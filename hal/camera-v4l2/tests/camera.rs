//! Two emulated cameras as one stereo camera: contract, times, pairs, and all failures.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests")]

use std::sync::Arc;
use std::time::Duration;

use crate::support::{PERIOD_MILLIS, Rig, SECOND, SMALL, config, millis};
use pb3dp_camera_settings::{CameraName, Interval, SKEW_MAX, Setting, StampModel, StampSource, StereoConfig};
use pb3dp_camera_v4l2::controls::id;
use pb3dp_camera_v4l2::emulated::{Call, EmulatedCamera, EmulatedSystem, Faults};
use pb3dp_camera_v4l2::video::FieldOrder;
use pb3dp_camera_v4l2::{Side, V4l2StereoCamera};
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_conformance::{CameraExpectations, stereo_camera_suite};
use rustix::io::Errno;

fn refused(result: Result<V4l2StereoCamera, CameraError>) -> (CameraErrorKind, String) {
    let error = result.err().expect("it must be refused");
    (error.kind(), error.to_string())
}

#[test]
fn it_keeps_the_contract() {
    let rig = Rig::new();
    stereo_camera_suite(|| rig.opened(), &CameraExpectations::endless(40)).assert_passed();
    // The same in real time.
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let system = EmulatedSystem::new(clock.clone(), vec![EmulatedCamera::usual(0), EmulatedCamera::usual(1)]);
    let open = || V4l2StereoCamera::open(Arc::new(system.clone()), clock.clone(), &config()).unwrap();
    stereo_camera_suite(open, &CameraExpectations::endless(3)).assert_passed();
}

#[test]
fn pairs_carry_the_middle_of_the_exposure_on_the_program_s_clock() {
    for (source, stamps, expected_millis) in [
        (StampSource::StartOfExposure, StampModel::default(), 42.0),
        (StampSource::EndOfFrame, StampModel { readout: millis(9), delay: Duration::ZERO }, 29.0),
        (StampSource::StartOfExposure, StampModel { readout: millis(9), delay: millis(5) }, 37.0),
    ] {
        let rig = Rig::with(|_, camera| camera.source = source);
        let mut config = config();
        (config.left.stamps, config.right.stamps) = (stamps, stamps);
        let opened_at = rig.clock.now();
        let mut camera = rig.open(&config).unwrap();
        let pairs: Vec<FramePair> = (0..3).map(|_| camera.next_pair(SECOND).unwrap()).collect();
        for (k, pair) in pairs.iter().enumerate() {
            let found = pair.exposed_at.seconds_since(opened_at) * 1e3;
            let expected = expected_millis + k as f64 * PERIOD_MILLIS;
            assert!((found - expected).abs() < 1e-3, "{source:?}: pair {k} at {found} ms, expected {expected}");
            assert_eq!((pair.sequence, pair.skew_nanos), (k as u64, 2_000_000));
        }
        // Each image has the content of its own number.
        let level = |pair: &FramePair| (pair.left.get_pixel(7, 5).0, pair.right.get_pixel(63, 47).0);
        assert_ne!(level(&pairs[0]), level(&pairs[1]));
    }
}

#[test]
fn a_late_caller_gets_the_newest_pair_and_never_an_old_one() {
    let rig = Rig::new();
    let mut camera = rig.opened();
    camera.next_pair(SECOND).unwrap();
    // Fewer images than the buffers hold: the newest one is delivered at once.
    rig.clock.sleep_until(rig.clock.now() + millis(100));
    let (pair, took) = rig.timed(&mut camera);
    assert_eq!((pair.unwrap().sequence, took < 1.0), (3, true));
    assert_eq!(camera.counters().left.superseded, 2);
    // Many more: all buffered images are outdated.
    rig.clock.sleep_until(rig.clock.now() + SECOND);
    let now = rig.clock.now();
    let (pair, took) = rig.timed(&mut camera);
    let pair = pair.unwrap();
    assert!(pair.exposed_at.seconds_since(now) > -0.05 && took < 2.0 * PERIOD_MILLIS, "{pair:?} after {took} ms");
    assert_eq!(pair.sequence, 34);
    assert!(camera.counters().left.stale > 0, "{:?}", camera.counters());
}

#[test]
fn damaged_short_and_lost_images_are_left_out_and_counted() {
    let rig = Rig::new();
    let mut camera = rig.opened();
    camera.next_pair(SECOND).unwrap();
    let mut next = |number, change: fn(&mut Faults)| {
        rig.faults(number, change);
        // After a lost image nothing arrives for two periods, which counts as silence; the pair follows directly.
        let pair = camera.next_pair(SECOND).or_else(|_| camera.next_pair(millis(1))).unwrap();
        (pair.sequence, camera.counters())
    };
    let (sequence, counters) = next(0, |faults| faults.damaged = 1);
    assert_eq!((sequence, counters.left.damaged, counters.right.unpaired), (2, 1, 1));
    let (sequence, counters) = next(1, |faults| faults.short = 1);
    assert_eq!((sequence, counters.right.short, counters.left.superseded), (4, 1, 1));
    let (sequence, counters) = next(1, |faults| faults.lost = 1);
    assert_eq!((sequence, counters.right.lost, counters.left.lost), (6, 1, 0));
    let (sequence, counters) = next(0, |faults| faults.repeated = 1);
    assert_eq!((sequence, counters.left.repeated, counters.pairs), (7, 1, 5));
}

#[test]
fn numbers_that_begin_again_lose_nothing() {
    let rig = Rig::with(|_, camera| camera.first_sequence = u32::MAX - 2);
    let mut camera = rig.opened();
    let sequences: Vec<u64> = (0..8).map(|_| camera.next_pair(SECOND).unwrap().sequence).collect();
    assert_eq!(sequences, (0..8).collect::<Vec<u64>>());
    assert_eq!((camera.counters().left.lost, camera.counters().left.repeated), (0, 0));
}

#[test]
fn wrong_stamps_are_refused_with_the_reason() {
    let rig = Rig::with(|_, camera| camera.faults.stamps_late_nanos = 32_000_000);
    let mut camera = rig.opened();
    let error = camera.next_pair(SECOND).unwrap_err();
    assert_eq!(error.kind(), CameraErrorKind::Timeout);
    assert!(error.to_string().contains("its timestamps lie in the future"), "{error}");
    assert!(camera.counters().left.future > 20 && camera.counters().pairs == 0);

    let rig = Rig::with(|_, camera| camera.source = StampSource::Unknown);
    let error = rig.opened().next_pair(SECOND).unwrap_err();
    assert!(error.to_string().contains("does not use CLOCK_MONOTONIC"), "{error}");

    // Timestamps that go back once: that image is dropped, and no time is delivered twice.
    let rig = Rig::new();
    let mut camera = rig.opened();
    let before = camera.next_pair(SECOND).unwrap();
    rig.faults(0, |faults| faults.stamps_late_nanos = -50_000_000);
    let after = camera.next_pair(SECOND).map(|pair| pair.exposed_at);
    assert!(after.as_ref().is_ok_and(|at| *at > before.exposed_at) || after.is_err(), "{after:?}");
    assert!(camera.counters().left.not_newer > 0);
}

#[test]
fn pairs_too_far_apart_are_refused_with_what_they_cost() {
    let rig = Rig::with(|number, camera| camera.phase = millis(40 + 12 * number as u64));
    let mut camera = rig.opened();
    let error = camera.next_pair(SECOND).unwrap_err();
    assert_eq!(error.kind(), CameraErrorKind::BadPair);
    let expected =
        "right was exposed 12.0 ms after left, at most 5.0 ms is allowed; at 100 mm/s the target moves by 1.20 mm";
    assert!(error.to_string().contains(expected), "{error}");
    assert_eq!(camera.counters().skew_refused, 1);
    // A wider limit accepts them.
    drop(camera);
    let mut camera = rig.open(&StereoConfig { skew_max: millis(15), ..config() }).unwrap();
    assert_eq!(camera.next_pair(SECOND).unwrap().skew_nanos, 12_000_000);
    drop(camera);
    // A limit as long as the frame period is meaningless.
    let (kind, message) = refused(rig.open(&StereoConfig { skew_max: millis(34), ..config() }));
    assert_eq!(kind, CameraErrorKind::Unusable);
    assert!(message.contains("must be shorter than the frame period"), "{message}");
}

#[test]
fn whichever_side_is_first_the_nearest_images_are_paired() {
    for phases in [[40, 44], [44, 40], [40, 71], [71, 40], [40, 140]] {
        let rig = Rig::with(|number, camera| camera.phase = millis(phases[number]));
        let mut camera = rig.opened();
        for _ in 0..5 {
            let pair = camera.next_pair(SECOND).unwrap();
            assert!(pair.skew_nanos.abs() <= 4_000_000, "{phases:?}: {} ns", pair.skew_nanos);
        }
    }
}

#[test]
fn the_drift_of_free_running_cameras_is_measured() {
    let rig = Rig::with(|number, camera| camera.slowness = if number == 1 { 2e-4 } else { 0.0 });
    let mut camera = rig.opened();
    for _ in 0..120 {
        camera.next_pair(SECOND).unwrap();
    }
    let drift = camera.counters().drift.unwrap();
    assert!((drift.rate - 2e-4).abs() < 2e-6, "{drift:?}");
    let left = drift.seconds_until(SKEW_MAX).unwrap();
    assert!((left - (0.005 - drift.skew_s) / 2e-4).abs() < 0.2, "{left} s");
    // When the predicted time is over, pairs are refused; half a period later they match again.
    let mut refused_pairs = 0;
    for _ in 0..6000 {
        refused_pairs += u32::from(camera.next_pair(SECOND).is_err());
    }
    let counters = camera.counters();
    assert!(refused_pairs > 1000 && counters.pairs > 1000, "{counters:?}");
    assert!(counters.skew_max_nanos <= 5_000_000);
}

#[test]
fn the_loss_of_a_camera_is_reported_within_two_periods_and_it_can_be_opened_again() {
    let faults: [fn(&mut Faults); 5] = [
        |faults| faults.is_unplugged = true,
        |faults| faults.ends = true,
        |faults| faults.has_stopped = true,
        |faults| faults.calls = [(Call::Dequeue, Errno::IO)].into(),
        |faults| faults.calls = [(Call::Queue, Errno::NODEV)].into(),
    ];
    for number in [0, 1] {
        for (k, fault) in faults.iter().enumerate() {
            let rig = Rig::new();
            let mut camera = rig.opened();
            camera.next_pair(SECOND).unwrap();
            rig.faults(number, fault);
            let (result, took) = rig.timed(&mut camera);
            let error = result.unwrap_err();
            assert_eq!(error.kind(), CameraErrorKind::Disconnected, "fault {k}: {error}");
            assert!(took <= 2.0 * PERIOD_MILLIS, "fault {k}: {took} ms");
            assert!(error.to_string().contains(&format!("serial:SN000{number}")), "fault {k}: {error}");
            rig.faults(number, |faults| *faults = Faults::default());
            let again = camera.next_pair(SECOND).unwrap_err();
            assert_eq!((again.kind(), again.to_string()), (CameraErrorKind::Disconnected, error.to_string()));
            // The old object still exists, and holds no device.
            rig.opened().next_pair(SECOND).unwrap();
        }
    }
}

#[test]
fn both_cameras_unplugged_at_once_and_a_rig_that_is_not_there() {
    let rig = Rig::new();
    let mut camera = rig.opened();
    camera.next_pair(SECOND).unwrap();
    rig.faults(0, |faults| faults.is_unplugged = true);
    rig.faults(1, |faults| faults.is_unplugged = true);
    assert_eq!(rig.timed(&mut camera).0.unwrap_err().kind(), CameraErrorKind::Disconnected);
    let (kind, message) = refused(rig.open(&config()));
    assert_eq!(kind, CameraErrorKind::Disconnected);
    assert_eq!(message, "serial:SN0000: no such camera; check plug and cable; available cameras: none");
}

#[test]
fn a_silent_camera_is_reported_two_periods_after_its_last_image_and_continues_when_it_sends_again() {
    for number in [0, 1] {
        let rig = Rig::new();
        let mut camera = rig.opened();
        camera.next_pair(SECOND).unwrap();
        rig.faults(number, |faults| faults.is_silent = true);
        for _ in 0..3 {
            let (result, took) = rig.timed(&mut camera);
            let error = result.unwrap_err();
            assert_eq!(error.kind(), CameraErrorKind::Timeout, "{error}");
            assert!(
                error.to_string().starts_with(&format!("serial:SN000{number} (/dev/video{number}): no good image for")),
                "{error}"
            );
            assert!(took <= 2.0 * PERIOD_MILLIS + 0.01, "{took} ms");
        }
        rig.faults(number, |faults| faults.is_silent = false);
        let now = rig.clock.now();
        let pair = (0..3).find_map(|_| camera.next_pair(SECOND).ok()).unwrap();
        assert!(pair.exposed_at.seconds_since(now) > -0.04, "an image from before the silence");
        assert!(pair.skew_nanos.abs() <= 5_000_000);
    }
}

#[test]
fn images_that_come_up_to_nine_tenths_of_a_period_late_are_no_silence() {
    let rig = Rig::with(|number, camera| {
        camera.lateness = match number {
            0 => |image| millis(image * 7919 % 31),
            _ => |image| millis(image * 104_729 % 31),
        }
    });
    let mut camera = rig.opened();
    for k in 0..1000 {
        camera.next_pair(SECOND).unwrap_or_else(|error| panic!("pair {k}: {error}"));
    }
    assert_eq!(camera.counters().left.lost + camera.counters().right.lost, 0);
}

#[test]
fn only_damaged_images_are_reported_as_damage() {
    let rig = Rig::new();
    let mut camera = rig.opened();
    camera.next_pair(SECOND).unwrap();
    rig.faults(1, |faults| faults.damaged = 1000);
    let (result, took) = rig.timed(&mut camera);
    let error = result.unwrap_err();
    assert!(
        error.to_string().ends_with("the driver marks images as damaged") && took <= 84.0,
        "{error} after {took} ms"
    );
}

#[test]
fn a_camera_that_never_begins_has_the_time_of_the_call() {
    let rig = Rig::with(|number, camera| camera.faults.is_silent = number == 1);
    let (result, took) = rig.timed(&mut rig.opened());
    let error = result.unwrap_err();
    assert_eq!(error.kind(), CameraErrorKind::Timeout);
    assert!(
        error.to_string().contains("serial:SN0001 (/dev/video1): no image yet") && (took - 1000.0).abs() < 1.0,
        "{error}, {took} ms"
    );
}

#[test]
fn devices_that_can_not_be_had_say_why_and_what_to_do() {
    for (call, errno, kind, advice) in [
        (Call::Open, Errno::ACCESS, CameraErrorKind::Unusable, "one device cannot be queried"),
        (Call::SetFormat, Errno::BUSY, CameraErrorKind::Unusable, "used by another program (`fuser -v"),
        (Call::RequestBuffers, Errno::BUSY, CameraErrorKind::Unusable, "used by another program"),
        (Call::Start, Errno::NOSPC, CameraErrorKind::Unusable, "not enough USB bandwidth"),
        (Call::Start, Errno::NODEV, CameraErrorKind::Disconnected, "the camera is disconnected"),
        (Call::SetFormat, Errno::NOMEM, CameraErrorKind::Unusable, "the driver refused the request"),
    ] {
        let rig = Rig::new();
        rig.faults(1, |faults| faults.calls = [(call, errno)].into());
        let (found, message) = refused(rig.open(&config()));
        assert!(found == kind && message.contains(advice) && message.contains("SN0001"), "{call:?} {errno}: {message}");
        // No device is held after a failure.
        rig.faults(1, |faults| *faults = Faults::default());
        rig.opened().next_pair(SECOND).unwrap();
    }
    // A second program that really holds the device.
    let rig = Rig::new();
    let first = rig.opened();
    let (_, message) = refused(rig.open(&config()));
    assert!(
        message.starts_with("serial:SN0000 (/dev/video0): ") && message.contains("used by another program"),
        "{message}"
    );
    drop(first);
    rig.opened().next_pair(SECOND).unwrap();
}

#[test]
fn what_a_driver_changes_in_silence_is_refused() {
    let refusal = |change: fn(&mut EmulatedCamera)| {
        let (kind, message) = refused(
            Rig::with(|number, camera| {
                if number == 0 {
                    change(camera)
                }
            })
            .open(&config()),
        );
        assert_eq!(kind, CameraErrorKind::Unusable, "{message}");
        message
    };
    let message = refusal(|camera| camera.faults.other_size = Some((80, 60)));
    assert!(
        message.contains("requested YUYV of 64x48, the driver selected YUYV of 80x60; it offers YUYV 640x480 at 30"),
        "{message}"
    );
    let message = refusal(|camera| camera.formats = vec![(*b"H264", camera.formats[0].1.clone())]);
    assert!(message.contains("the driver selected H264 of 64x48"), "{message}");
    let message = refusal(|camera| camera.faults.other_interval = Some(Interval { numerator: 1, denominator: 25 }));
    assert!(
        message.contains("requested 30.000 images per second of YUYV 64x48, the driver selected 25.000"),
        "{message}"
    );
    let message =
        refusal(|camera| camera.faults.other_interval = Some(Interval { numerator: 1001, denominator: 30000 }));
    assert!(message.contains("the driver selected 29.970"), "{message}");
    let message = refusal(|camera| camera.faults.other_interval = Some(Interval::default()));
    assert!(message.contains("the driver selected 0.000"), "{message}");
    let message = refusal(|camera| camera.field = FieldOrder::Interlaced);
    assert!(message.contains("which tears moving objects"), "{message}");
    let message = refusal(|camera| camera.controls.retain(|(entry, _)| entry.id != id::EXPOSURE_ABSOLUTE));
    assert!(message.contains("it has no control for the exposure time"), "{message}");
    let message = refusal(|camera| camera.faults.forgetful = vec![id::EXPOSURE_ABSOLUTE]);
    assert!(message.contains("`Exposure Time, Absolute` was set to 40, but the driver reports 100"), "{message}");
    let message = refusal(|camera| camera.faults.forgetful = vec![id::AUTO_WHITE_BALANCE]);
    assert!(message.contains("`White Balance, Automatic` was set to 0, but the driver reports 1"), "{message}");
}

#[test]
fn rows_with_padding_and_the_stride_of_another_size_are_no_harm() {
    let rig = Rig::with(|_, camera| {
        camera.padding = 32;
        camera.paint = |_, memory| {
            // Grey images whose padding is bright pink.
            for row in memory.chunks_mut(160) {
                row[..128].fill(128);
                row[128..].fill(255);
            }
        };
    });
    let pair = rig.opened().next_pair(SECOND).unwrap();
    assert!(pair.left.pixels().chain(pair.right.pixels()).all(|pixel| pixel.0 == [130; 3]));
}

#[test]
fn automatic_modes_are_off_and_controls_follow_while_it_runs() {
    let rig = Rig::new();
    let mut camera = rig.opened();
    let value = |camera: &mut V4l2StereoCamera, id| {
        camera.controls(Side::Left).unwrap().iter().find(|control| control.entry.id == id).unwrap().value
    };
    for (id, expected) in [
        (id::EXPOSURE_AUTO, 1),
        (id::EXPOSURE_AUTO_PRIORITY, 0),
        (id::AUTO_WHITE_BALANCE, 0),
        (id::FOCUS_AUTO, 0),
        (id::EXPOSURE_ABSOLUTE, 40),
        (id::GAIN, 64),
    ] {
        assert_eq!(value(&mut camera, id), Some(expected), "{id:#x}");
    }
    let first = camera.next_pair(SECOND).unwrap();
    camera.set_control(Side::Left, id::GAIN, 90).unwrap();
    assert_eq!(value(&mut camera, id::GAIN), Some(90));
    // A longer exposure of the left camera: its middle is 3 ms later, and the skew is that much smaller.
    camera.set_control(Side::Left, id::EXPOSURE_ABSOLUTE, 100).unwrap();
    let second = camera.next_pair(SECOND).unwrap();
    let step = second.exposed_at.seconds_since(first.exposed_at) * 1e3;
    assert!((step - PERIOD_MILLIS - 3.0).abs() < 1e-3, "{step} ms");
    assert_eq!(second.skew_nanos, -1_000_000);
    let error = camera.set_control(Side::Right, id::GAIN, 300).unwrap_err();
    assert!(error.to_string().contains("`Gain` cannot be 300; its range is 0 to 255 in steps of 1"), "{error}");
    let error = camera.set_control(Side::Right, 0x1234, 1).unwrap_err();
    assert!(error.to_string().contains("it has no control 0x00001234"), "{error}");
}

#[test]
fn an_unknown_exposure_is_refused_unless_it_is_stated() {
    let rig = Rig::new();
    let mut config = config();
    config.left.controls.exposure = Setting::Auto;
    let (_, message) = refused(rig.open(&config));
    assert!(message.contains("it does not report its exposure time"), "{message}");
    config.left.exposure = Some(millis(4));
    rig.open(&config).unwrap().next_pair(SECOND).unwrap();
}

#[test]
fn names_stay_and_ambiguous_ones_are_refused() {
    let mut swapped = config();
    (swapped.left.name, swapped.right.name) = ("bus:usb-emulated-1".parse().unwrap(), "/dev/video0".parse().unwrap());
    assert_eq!(Rig::new().open(&swapped).unwrap().info().name, "v4l2 bus:usb-emulated-1 + /dev/video0");
    let rig = Rig::with(|_, camera| camera.entry.serial = Some("SN0000".to_owned()));
    let (_, message) = refused(rig.open(&config()));
    assert!(message.contains("this name matches 2 cameras: /dev/video0 bus:usb-emulated-0"), "{message}");
    let mut same = config();
    same.right.name = "bus:usb-emulated-0".parse().unwrap();
    let (_, message) = refused(Rig::new().open(&same));
    assert!(message.contains("left and right are the same camera, /dev/video0"), "{message}");
    for wrong in ["video0", "bus:", "name:x", "serial:a#b"] {
        assert!(wrong.parse::<CameraName>().unwrap_err().to_string().contains(wrong), "{wrong}");
    }
    for name in ["bus:usb-0000:00:14.0-1.2#1", "serial:4F", "/dev/video7"] {
        assert_eq!(name.parse::<CameraName>().unwrap().to_string(), name);
    }
}

#[test]
fn names_that_udev_gives_lead_to_their_cameras() {
    let rig = Rig::new();
    rig.system.link("/dev/pb3dp/cam-left", "/dev/video0");
    rig.system.link("/dev/null", "/dev/null");
    let mut config = config();
    config.left.name = "/dev/pb3dp/cam-left".parse().unwrap();
    rig.open(&config).unwrap().next_pair(SECOND).unwrap();
    // The link disappears with its camera.
    config.left.name = "/dev/pb3dp/cam-middle".parse().unwrap();
    let (_, message) = refused(rig.open(&config));
    assert!(message.starts_with("/dev/pb3dp/cam-middle: no such camera; check plug"), "{message}");
    config.left.name = "/dev/null".parse().unwrap();
    let (_, message) = refused(rig.open(&config));
    assert!(message.starts_with("/dev/null: not a capture device; available cameras: /dev/video0"), "{message}");
}

#[test]
fn the_steady_state_takes_nothing_from_the_heap() {
    let rig = Rig::new();
    let mut camera = rig.opened();
    let mut pair = FramePair::black(SMALL);
    camera.next_pair_into(&mut pair, SECOND).unwrap();
    let before = pb3dp_allocation_count::requests();
    for _ in 0..100 {
        camera.next_pair_into(&mut pair, SECOND).unwrap();
    }
    assert_eq!(pb3dp_allocation_count::requests(), before);
}

#[test]
fn time_passes_without_harm() {
    // Twenty minutes in which images are sometimes lost, damaged or short.
    let rig = Rig::new();
    let mut camera = rig.opened();
    let mut pair = FramePair::black(SMALL);
    let (mut delivered, mut last) = (0_u64, None);
    for k in 0..36_000_u64 {
        if k % 97 == 0 {
            let number = (k / 97 % 2) as usize;
            rig.faults(number, |faults| match k % 3 {
                0 => faults.damaged = 1,
                1 => faults.short = 1,
                _ => faults.lost = 1,
            });
        }
        match camera.next_pair_into(&mut pair, SECOND) {
            Ok(()) => {
                assert!(last.is_none_or(|last| (pair.sequence, pair.exposed_at) > last));
                last = Some((pair.sequence, pair.exposed_at));
                delivered += 1;
            }
            Err(error) => assert_eq!(error.kind(), CameraErrorKind::Timeout, "{error}"),
        }
    }
    let counters = camera.counters();
    assert!(delivered > 35_000 && counters.pairs == delivered, "{counters:?}");
    let all = |side: pb3dp_camera_v4l2::StreamCounters| side.damaged + side.short + side.lost;
    assert!(all(counters.left) > 180 && all(counters.right) > 180, "{counters:?}");
}
