//! Cameras that are reopened after one of them was lost.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::Arc;
use std::time::Duration;

use crate::support::{PERIOD_MILLIS, Rig, SECOND, SMALL, config, millis};
use pb3dp_camera_settings::Setting;
use pb3dp_camera_v4l2::controls::{Focus, id};
use pb3dp_camera_v4l2::emulated::{Call, EmulatedCamera};
use pb3dp_camera_v4l2::{ReopeningCamera, Side};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_hal_conformance::{CameraExpectations, stereo_camera_suite};
use rustix::io::Errno;

const LOOKED_FOR: Duration = Duration::from_secs(10);

fn reopening(rig: &Rig, reopen_for: Duration) -> ReopeningCamera {
    ReopeningCamera::open(Arc::new(rig.system.clone()), rig.clock.clone(), config(), reopen_for).unwrap()
}

/// Takes pairs for this duration: returns their number, the last message, and the newest pair. No pair is older than the previous
/// ones or than its delivery allows.
fn take(rig: &Rig, camera: &mut ReopeningCamera, duration: Duration, last: &mut (u64, MonotonicTime)) -> (u32, String) {
    let (end, mut came, mut error_text) = (rig.clock.now() + duration, 0, String::new());
    let mut pair = FramePair::black(SMALL);
    while rig.clock.now() < end {
        match camera.next_pair_into(&mut pair, millis(66)) {
            Ok(()) => {
                assert!(
                    (pair.sequence, pair.exposed_at) > *last && pair.exposed_at > last.1,
                    "{pair:?} after {last:?}"
                );
                let age = rig.clock.now().seconds_since(pair.exposed_at);
                assert!(age < 0.1, "a pair was {age} s old when it was delivered");
                *last = (pair.sequence, pair.exposed_at);
                came += 1;
            }
            Err(error) => {
                assert_eq!(error.kind(), CameraErrorKind::Timeout, "{error}");
                error_text = error.to_string();
            }
        }
    }
    (came, error_text)
}

#[test]
fn it_keeps_the_contract() {
    let rig = Rig::new();
    stereo_camera_suite(|| reopening(&rig, LOOKED_FOR), &CameraExpectations::endless(40)).assert_passed();
}

#[test]
fn pairs_go_on_behind_those_before_once_the_plug_is_in_again() {
    for number in 0..2 {
        let rig = Rig::new();
        let mut camera = reopening(&rig, LOOKED_FOR);
        let mut last = (0, MonotonicTime::ZERO);
        assert!(take(&rig, &mut camera, SECOND, &mut last).0 > 25);
        let before = last;
        rig.faults(number, |faults| faults.is_unplugged = true);
        let (came, error_text) = take(&rig, &mut camera, SECOND * 3, &mut last);
        assert_eq!(came, 0);
        assert!(
            error_text.contains(&format!("serial:SN000{number}")) && error_text.contains("no pairs until"),
            "{error_text}"
        );
        // A new device does not have the settings of the old one.
        rig.system
            .with(number, |camera| {
                camera.faults.is_unplugged = false;
                let exposure = camera.controls.iter_mut().find(|(entry, _)| entry.id == id::EXPOSURE_ABSOLUTE);
                exposure.unwrap().1 = 5000;
            })
            .unwrap();
        let (came, _) = take(&rig, &mut camera, SECOND, &mut last);
        assert!((20..=30).contains(&came), "{came}");
        assert_eq!(camera.reopened(), 1);
        // Numbers count periods.
        let periods = last.1.seconds_since(before.1) * 1e3 / PERIOD_MILLIS;
        let numbers = (last.0 - before.0) as f64;
        assert!((numbers - periods).abs() < 2.0, "{numbers} numbers in {periods} periods");
    }
}

#[test]
fn a_plug_that_has_no_rights_yet_is_tried_again() {
    let rig = Rig::new();
    let mut camera = reopening(&rig, LOOKED_FOR);
    let mut last = (0, MonotonicTime::ZERO);
    take(&rig, &mut camera, SECOND, &mut last);
    rig.faults(1, |faults| faults.is_unplugged = true);
    take(&rig, &mut camera, SECOND, &mut last);
    rig.faults(1, |faults| {
        faults.is_unplugged = false;
        faults.calls.insert(Call::Open, Errno::ACCESS);
    });
    let (came, error_text) = take(&rig, &mut camera, SECOND, &mut last);
    assert!(came == 0 && error_text.contains("cannot be queried"), "{came} came: {error_text}");
    rig.faults(1, |faults| faults.calls.clear());
    assert!(take(&rig, &mut camera, SECOND, &mut last).0 > 20);
}

/// Pulls both plugs, and changes the cameras before they are plugged in again.
fn plugged_in_again(
    rig: &Rig,
    camera: &mut ReopeningCamera,
    change: impl Fn(usize, &mut EmulatedCamera),
) -> (u32, String) {
    let mut last = (0, MonotonicTime::ZERO);
    assert!(take(rig, camera, SECOND, &mut last).0 > 20);
    (0..2).for_each(|number| rig.faults(number, |faults| faults.is_unplugged = true));
    assert_eq!(take(rig, camera, SECOND, &mut last).0, 0);
    for number in 0..2 {
        rig.system.with(number, |camera| change(number, camera)).unwrap();
        rig.faults(number, |faults| faults.is_unplugged = false);
    }
    take(rig, camera, SECOND, &mut last)
}

fn in_port(port: usize) -> impl Fn(usize, &mut EmulatedCamera) {
    move |number, camera| camera.capability.bus = format!("usb-emulated-{}", (number + port) % 2)
}

/// Cameras that are named by their ports, with these serial numbers.
fn at_ports(numbers: [Option<&str>; 2]) -> (Rig, ReopeningCamera) {
    let rig = Rig::with(|number, camera| camera.entry.serial = numbers[number].map(str::to_owned));
    let mut config = config();
    (config.left.name, config.right.name) =
        ("bus:usb-emulated-0".parse().unwrap(), "bus:usb-emulated-1".parse().unwrap());
    let camera = ReopeningCamera::open(Arc::new(rig.system.clone()), rig.clock.clone(), config, SECOND * 60).unwrap();
    (rig, camera)
}

/// The calibration belongs to the cameras of the start: exchanged cables give no pair until they are exchanged again.
#[test]
fn exchanged_cables_are_noticed_by_the_serial_numbers() {
    let (rig, mut camera) = at_ports([Some("A"), Some("B")]);
    assert!(camera.are_distinguished());
    let (came, error_text) = plugged_in_again(&rig, &mut camera, in_port(1));
    assert!(came == 0 && error_text.contains("left has serial number B, not A"), "{came} came: {error_text}");
    assert_eq!(camera.reopened(), 0);
    (0..2).for_each(|number| rig.system.with(number, |camera| in_port(0)(number, camera)).unwrap());
    assert!(take(&rig, &mut camera, SECOND, &mut (0, MonotonicTime::ZERO)).0 > 20);
    assert_eq!(camera.reopened(), 1);
}

/// A camera with a number of its own may use another port; one without is its port.
#[test]
fn cameras_are_identified_by_number_or_by_port() {
    let rig = Rig::new();
    let mut camera = reopening(&rig, LOOKED_FOR);
    assert!(plugged_in_again(&rig, &mut camera, |_, camera| camera.capability.bus += ".4").0 > 20);
    for numbers in [[None, None], [Some("same"), Some("same")]] {
        let rig = Rig::with(|number, camera| camera.entry.serial = numbers[number].map(str::to_owned));
        let mut config = config();
        (config.left.name, config.right.name) = ("/dev/video0".parse().unwrap(), "/dev/video1".parse().unwrap());
        let system = Arc::new(rig.system.clone());
        let mut camera = ReopeningCamera::open(system, rig.clock.clone(), config, LOOKED_FOR).unwrap();
        assert!(!camera.are_distinguished());
        let (came, error_text) = plugged_in_again(&rig, &mut camera, in_port(1));
        assert!(
            came == 0 && error_text.contains("left has port usb-emulated-1, not usb-emulated-0"),
            "{came} came: {error_text}"
        );
    }
    let (rig, mut camera) = at_ports([Some("A"), Some("B")]);
    let (came, error_text) = plugged_in_again(&rig, &mut camera, |number, camera| {
        camera.entry.serial = Some(["A", "C"][number].to_owned());
    });
    assert!(came == 0 && error_text.contains("right has serial number C, not B"), "{came} came: {error_text}");
}

#[test]
fn it_is_given_up_after_its_time_and_at_once_without_any() {
    let lost = |reopen_for: Duration| {
        let rig = Rig::new();
        let mut camera = reopening(&rig, reopen_for);
        camera.next_pair(SECOND).unwrap();
        rig.faults(0, |faults| faults.is_unplugged = true);
        let begin = rig.clock.now();
        let error = loop {
            match camera.next_pair(millis(66)) {
                Ok(_) => {}
                Err(error) if error.kind() == CameraErrorKind::Timeout => {}
                Err(error) => break error,
            }
        };
        assert_eq!(error.kind(), CameraErrorKind::Disconnected, "{error}");
        // The state is final, even if the camera is connected again.
        rig.faults(0, |faults| faults.is_unplugged = false);
        assert_eq!(camera.next_pair(SECOND).unwrap_err().kind(), CameraErrorKind::Disconnected);
        (rig.clock.now().seconds_since(begin), error.to_string())
    };
    let (took_s, _) = lost(Duration::ZERO);
    assert!(took_s < 0.1, "{took_s}");
    let (took_s, error_text) = lost(SECOND * 2);
    assert!(
        (2.0..2.4).contains(&took_s) && error_text.contains("not available again within 2s"),
        "{took_s} s: {error_text}"
    );
}

#[test]
fn what_is_not_there_at_the_beginning_is_refused() {
    let rig = Rig::with(|number, camera| camera.faults.is_unplugged = number == 1);
    let opened = ReopeningCamera::open(Arc::new(rig.system.clone()), rig.clock.clone(), config(), LOOKED_FOR);
    assert_eq!(opened.err().unwrap().kind(), CameraErrorKind::Disconnected);
}

#[test]
fn cameras_are_known_by_number_place_and_focus_while_they_are_there() {
    let rig = Rig::with(|number, camera| {
        if number == 1 {
            camera.entry.serial = None;
            camera.controls.retain(|(entry, _)| ![id::FOCUS_ABSOLUTE, id::FOCUS_AUTO].contains(&entry.id));
        }
    });
    let mut requests = config();
    requests.right.name = "bus:usb-emulated-1".parse().unwrap();
    requests.left.controls.focus = Setting::Manual(30);
    let open = |requests| ReopeningCamera::open(Arc::new(rig.system.clone()), rig.clock.clone(), requests, LOOKED_FOR);
    let mut camera = open(requests.clone()).unwrap();
    let [left, right] = [Side::Left, Side::Right].map(|side| camera.identity(side).unwrap());
    assert_eq!(left.serial.as_deref(), Some("SN0000"));
    assert_eq!((left.place.as_str(), left.focus), ("usb-emulated-0", Focus::Fixed(30)));
    assert_eq!((right.serial, right.place.as_str(), right.focus), (None, "usb-emulated-1", Focus::ByHand));
    drop(camera);
    requests.left.controls.focus = Setting::Auto;
    let mut camera = open(requests).unwrap();
    assert_eq!(camera.identity(Side::Left).unwrap().focus, Focus::Automatic);
    rig.faults(0, |faults| faults.is_unplugged = true);
    take(&rig, &mut camera, SECOND, &mut (0, MonotonicTime::ZERO));
    assert_eq!(camera.identity(Side::Left).unwrap_err().kind(), CameraErrorKind::Disconnected);
}
