//! One exposure for two emulated cameras: both together or none, adapted to the light, announced, and never too fast for a target.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use crate::support::{Rig, SECOND, config, millis};
use pb3dp_camera_settings::{PixelFormat, Setting, SharedExposure, StereoConfig};
use pb3dp_camera_v4l2::controls::id;
use pb3dp_camera_v4l2::emulated::{Call, EmulatedCamera};
use pb3dp_camera_v4l2::{ExposureEvent, ReopeningCamera, Side, V4l2StereoCamera};
use pb3dp_hal_api::{CameraErrorKind, FollowedTarget, FramePair, StereoCamera};
use rustix::io::Errno;

const TARGET_GREY: f64 = 100.0;

fn shared() -> StereoConfig {
    let mut config = config();
    for side in [&mut config.left, &mut config.right] {
        side.mode.format = PixelFormat::Grey;
        side.controls.exposure = Setting::Keep;
    }
    config.shared_exposure = Some(SharedExposure {
        target_grey: TARGET_GREY,
        time: [millis(1), millis(12)],
        gain: Some([16, 200]),
        blur_max_px: 2.0,
        nearest_m: 0.3,
        start: None,
    });
    config
}

/// Cameras in front of a scene with this light: the grey level is 100 at 10 ms and the gain 64.
fn lit(light: f64) -> Rig {
    Rig::with(|number, camera| {
        camera.light = Some(light);
        // The exposures before are not equal.
        set(camera, id::EXPOSURE_ABSOLUTE, 100 - 30 * number as i32);
        set(camera, id::GAIN, 64);
        camera.paint = |number, memory| {
            memory.fill(100);
            memory[0] = number as u8;
        };
    })
}

fn set(camera: &mut EmulatedCamera, id: u32, value: i32) {
    camera.controls.iter_mut().find(|(entry, _)| entry.id == id).unwrap().1 = value;
}

/// Exposure time, in units of the driver, and gain of both cameras.
fn values(rig: &Rig) -> [(i32, i32); 2] {
    [0, 1].map(|number| {
        let value =
            |camera: &mut EmulatedCamera, id| camera.controls.iter().find(|(entry, _)| entry.id == id).unwrap().1;
        rig.system.with(number, |camera| (value(camera, id::EXPOSURE_ABSOLUTE), value(camera, id::GAIN))).unwrap()
    })
}

fn mean(pair: &FramePair) -> [f64; 2] {
    [&pair.left, &pair.right]
        .map(|image| image.as_raw().iter().map(|grey| f64::from(*grey)).sum::<f64>() / image.as_raw().len() as f64)
}

/// A change with the time of the first pair that announces it.
type Announced = (f64, f64, bool);

/// Runs for some pairs; both cameras always have the same exposure. Returns the announced changes and the last pair.
fn run(rig: &Rig, camera: &mut V4l2StereoCamera, pairs: usize) -> (Vec<Announced>, FramePair) {
    let (mut announced, mut before) = (Vec::new(), None);
    let mut last = None;
    for _ in 0..pairs {
        let pair = camera.next_pair(SECOND).unwrap();
        let [left, right] = values(rig);
        assert_eq!(left, right);
        let exposure = pair.exposure.unwrap();
        assert_eq!(exposure.time, Duration::from_micros(100) * left.0.unsigned_abs());
        assert_eq!(exposure.gain, Some(left.1));
        if before.replace(exposure.changes).is_some_and(|before| before != exposure.changes) {
            announced.push((pair.exposed_at.as_secs_f64(), exposure.factor, exposure.is_settling));
        }
        last = Some(pair);
    }
    (announced, last.unwrap())
}

#[test]
fn both_cameras_are_brought_back_to_the_target_when_the_light_halves() {
    let rig = lit(1.0);
    let mut camera = rig.open(&shared()).unwrap();
    assert_eq!(values(&rig), [(100, 64); 2], "both begin with the exposure of the left camera");
    let (announced, pair) = run(&rig, &mut camera, 60);
    assert_eq!(announced, vec![]);
    assert!(mean(&pair).iter().all(|grey| (grey - TARGET_GREY).abs() < 2.0), "{:?}", mean(&pair));
    camera.set_following(FollowedTarget::Confident);
    for number in 0..2 {
        rig.system.with(number, |camera| camera.light = Some(0.5)).unwrap();
    }
    let (announced, pair) = run(&rig, &mut camera, 45 * 30);
    let grey = mean(&pair);
    assert!(grey.iter().all(|grey| (grey / TARGET_GREY - 1.0).abs() <= 0.11), "{grey:?} after {announced:?}");
    assert!((grey[0] - grey[1]).abs() < 1e-9);
    // First the time, up to its limit, then the gain.
    assert!(values(&rig)[0].0 == 120 && values(&rig)[0].1 > 64, "{:?}", values(&rig));
    // Slowly, in small steps, and each one is announced in the pair after it.
    assert!(announced.len() >= 3, "{announced:?}");
    assert!(announced.windows(2).all(|two| two[1].0 - two[0].0 >= 0.99), "{announced:?}");
    assert!(announced.iter().all(|(_, factor, is_settling)| *is_settling && (1.0..=1.1).contains(factor)));
    let mut changed = 0;
    while let Some(event) = camera.take_exposure_event() {
        assert!(event.to_string().contains("the target is 100") && !event.is_warning(), "{event}");
        changed += 1;
    }
    assert_eq!(changed, 8, "older events are dropped");
    // It rests.
    assert_eq!(run(&rig, &mut camera, 120).0, vec![]);
}

#[test]
fn without_a_target_the_exposure_settles_at_once_also_at_its_limits() {
    let rig = lit(0.3);
    let mut camera = rig.open(&shared()).unwrap();
    camera.settle_exposure().unwrap();
    let (announced, _) = run(&rig, &mut camera, 30);
    assert_eq!(announced, vec![]);
    // The limits are reached, and this is reported once.
    let events: Vec<ExposureEvent> = std::iter::from_fn(|| camera.take_exposure_event()).collect();
    assert_eq!(values(&rig), [(120, 200); 2]);
    let warnings: Vec<String> = events.iter().filter(|event| event.is_warning()).map(ToString::to_string).collect();
    assert!(
        warnings.len() == 1 && warnings[0].contains("too dark") && warnings[0].contains("12.0 ms, gain 200"),
        "{warnings:?}"
    );
}

#[test]
fn a_change_that_a_camera_refuses_leaves_both_as_they_were() {
    for fault in ["right refuses", "right forgets", "left refuses"] {
        let rig = lit(0.5);
        let mut camera = rig.open(&shared()).unwrap();
        let before = values(&rig);
        let side = usize::from(fault.starts_with("right"));
        rig.faults(side, |faults| {
            if fault.ends_with("forgets") {
                faults.forgetful = vec![id::EXPOSURE_ABSOLUTE];
            } else {
                faults.calls.insert(Call::SetControl, Errno::INVAL);
            }
        });
        let mut refused = 0;
        for _ in 0..60 {
            match camera.next_pair(SECOND) {
                Ok(pair) => {
                    assert_eq!(values(&rig), before, "{fault}");
                    assert_eq!(pair.exposure.unwrap().changes, 0);
                }
                Err(error) => {
                    // The camera that refuses every call cannot be restored by a call either, though it has the old value.
                    assert_eq!(error.kind(), CameraErrorKind::BadPair, "{error}");
                    assert!(error.to_string().contains("no pair is delivered until both have the same one"), "{error}");
                    refused += 1;
                }
            }
        }
        assert_eq!(refused > 0, fault.ends_with("refuses"), "{fault}");
        rig.faults(side, |faults| *faults = pb3dp_camera_v4l2::emulated::Faults::default());
        for _ in 0..10 {
            camera.next_pair(SECOND).unwrap();
        }
        assert_eq!(values(&rig), before, "{fault}");
        let event = camera.take_exposure_event();
        assert!(refused > 0 || matches!(event, Some(ExposureEvent::Failed(_))), "{fault}: {event:?}");
        // After ten seconds it is tried again, and works now.
        for _ in 0..600 {
            camera.next_pair(SECOND).unwrap();
        }
        assert!(values(&rig)[0] != before[0] && values(&rig)[0] == values(&rig)[1], "{fault}: {:?}", values(&rig));
    }
}

#[test]
fn cameras_without_the_same_controls_are_refused_with_camera_control_and_remedy() {
    let refusal = |change: fn(usize, &mut EmulatedCamera)| {
        let rig = Rig::with(change);
        let error = rig.open(&shared()).err().unwrap();
        assert_eq!(error.kind(), CameraErrorKind::Unusable);
        error.to_string()
    };
    let text = refusal(|side, camera| {
        if side == 1 {
            camera.controls.retain(|(entry, _)| ![id::EXPOSURE_ABSOLUTE, id::EXPOSURE_AUTO].contains(&entry.id));
        }
    });
    assert!(text.contains("serial:SN0001") && text.contains("no control for the exposure time (0x009a0902)"), "{text}");
    let text = refusal(|side, camera| {
        if side == 1 {
            camera.controls.retain(|(entry, _)| entry.id != id::GAIN);
        }
    });
    for part in ["serial:SN0001", "no control for the gain (0x00980913)", "set gain of both cameras to a number"] {
        assert!(text.contains(part), "{part} is not in {text}");
    }
    let text = refusal(|side, camera| {
        let entry = camera.controls.iter_mut().find(|(entry, _)| entry.id == id::GAIN).unwrap();
        entry.0.max = 255 - 155 * side as i32;
    });
    assert!(
        text.contains("`Gain` has the range 0 to 100") && text.contains("0 to 255: equal numbers are not"),
        "{text}"
    );
    let text = refusal(|_, camera| {
        let entry = camera.controls.iter_mut().find(|(entry, _)| entry.id == id::EXPOSURE_ABSOLUTE).unwrap();
        entry.0.min = 200;
    });
    assert!(text.contains("no exposure time (in 0.1 ms) between 10 and 120 is possible"), "{text}");
}

#[test]
fn nobody_else_changes_the_exposure_of_one_camera() {
    let rig = lit(1.0);
    let mut camera = rig.open(&shared()).unwrap();
    for id in [id::EXPOSURE_ABSOLUTE, id::EXPOSURE_AUTO, id::GAIN] {
        let error = camera.set_control(Side::Left, id, 1).unwrap_err();
        assert!(error.to_string().contains("sets this control in both cameras together"), "{error}");
    }
    camera.set_control(Side::Left, id::FOCUS_ABSOLUTE, 20).unwrap();
}

#[test]
fn reopened_cameras_go_on_with_the_exposure_of_the_light() {
    let rig = lit(0.6);
    let open = ReopeningCamera::open(
        std::sync::Arc::new(rig.system.clone()),
        rig.clock.clone(),
        shared(),
        Duration::from_secs(60),
    );
    let mut camera = open.unwrap();
    camera.settle_exposure().unwrap();
    let before = values(&rig);
    assert!(before[0] == before[1] && before[0] != (100, 64), "{before:?}");
    rig.faults(0, |faults| faults.is_unplugged = true);
    assert!(camera.next_pair(SECOND).is_err());
    rig.faults(0, |faults| faults.is_unplugged = false);
    // A camera that was without power has its own values again.
    rig.system.with(0, |camera| set(camera, id::EXPOSURE_ABSOLUTE, 77)).unwrap();
    let pair = (0..100).find_map(|_| camera.next_pair(SECOND).ok()).unwrap();
    assert_eq!(values(&rig), before);
    let time = Duration::from_micros(100) * before[0].0.unsigned_abs();
    assert_eq!(pair.exposure.map(|exposure| (exposure.time, exposure.gain)), Some((time, Some(before[0].1))));
}
