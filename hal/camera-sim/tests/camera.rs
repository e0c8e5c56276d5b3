//! The simulated camera: contract, times, and behaviour with a late caller.
#![allow(clippy::unwrap_used, clippy::panic)] // clippy allows them in #[test] functions only, not in their helpers.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use nalgebra::{Matrix3, Vector3};
use pb3dp_camera_sim::{GeometricCamera, SimCameraConfig, SimStereoCamera};
use pb3dp_geometry::frames::{CamLeft, World};
use pb3dp_geometry::{Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig};
use pb3dp_hal_api::{CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_hal_clock::{SystemClock, VirtualClock};
use pb3dp_hal_conformance::{CameraExpectations, stereo_camera_suite};
use pb3dp_sim::geometric::{GeometricConfig, GeometricTracker, PoseSigma};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{PoseSource, Scene, SceneConfig, ScenePoses};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::TargetConfig;

const PERIOD: Duration = Duration::from_millis(30);
const EXPOSURE: Duration = Duration::from_millis(6);
const SECOND: Duration = Duration::from_secs(1);

fn renderer() -> StereoRenderer {
    let pinhole = Pinhole { fx: 110.0, fy: 110.0, cx: 47.5, cy: 35.5 };
    let camera = Camera::new(ImageSize { width: 96, height: 72 }, pinhole, Distortion::None).unwrap();
    let rig = StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap();
    let scene = Scene::build(&SceneConfig::new(TargetConfig::card())).unwrap();
    StereoRenderer::new(scene, rig, &SensorConfig::IDEAL, 1).unwrap()
}

/// The target moves to the right at half a metre per second; every request is recorded.
#[derive(Clone, Default)]
struct Mover {
    asked: Arc<Mutex<Vec<MonotonicTime>>>,
    broken: bool,
}

impl PoseSource for Mover {
    fn poses_at(&mut self, at: MonotonicTime) -> ScenePoses {
        self.asked.lock().unwrap().push(at);
        let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let world_from_cam_left: Pose<World, CamLeft> = Pose::from_rotation_matrix(&axes, Vector3::new(0.0, 0.0, 0.5));
        let x = if self.broken { f64::NAN } else { 0.5 * at.as_secs_f64() };
        let world_from_target = world_from_cam_left * Pose::from_translation(Vector3::new(x, 0.0, 0.5));
        ScenePoses { world_from_cam_left, world_from_target }
    }
}

fn config(blur_moments: u32, pairs: Option<u64>) -> SimCameraConfig {
    SimCameraConfig { period: PERIOD, exposure: EXPOSURE, blur_moments, pairs }
}

fn camera(renderer: &StereoRenderer, clock: Arc<dyn Clock>, mover: &Mover, config: SimCameraConfig) -> SimStereoCamera {
    SimStereoCamera::new(renderer.clone(), Box::new(mover.clone()), clock, config).unwrap()
}

fn millis(ms: u64) -> MonotonicTime {
    MonotonicTime::from_nanos(ms * 1_000_000)
}

#[test]
fn keeps_the_contract_with_either_clock() {
    let renderer = renderer();
    let on_virtual = |pairs, moments| {
        let renderer = renderer.clone();
        move || camera(&renderer, Arc::new(VirtualClock::new()), &Mover::default(), config(moments, pairs))
    };
    stereo_camera_suite(on_virtual(Some(5), 1), &CameraExpectations::recording_of(5)).assert_passed();
    stereo_camera_suite(
        on_virtual(None, 3),
        &CameraExpectations { repeatable: true, ..CameraExpectations::endless(4) },
    )
    .assert_passed();
    let on_system = || camera(&renderer, Arc::new(SystemClock::new()), &Mover::default(), config(1, None));
    stereo_camera_suite(on_system, &CameraExpectations::endless(5)).assert_passed();
}

#[test]
fn pairs_carry_the_middle_of_the_exposure_for_which_the_poses_were_asked() {
    let clock = Arc::new(VirtualClock::new());
    clock.sleep_until(millis(1000));
    let mover = Mover::default();
    let mut camera = camera(&renderer(), clock.clone(), &mover, config(1, None));
    for k in 0..3 {
        let pair = camera.next_pair(SECOND).unwrap();
        assert_eq!(pair.sequence, k);
        assert_eq!(pair.exposed_at, millis(1000 + 30 * k + 3));
        assert_eq!(clock.now(), millis(1000 + 30 * k + 6));
    }
    assert_eq!(*mover.asked.lock().unwrap(), [millis(1003), millis(1033), millis(1063)]);
}

#[test]
fn motion_blur_asks_for_moments_around_the_middle() {
    let mover = Mover::default();
    let mut blurred = camera(&renderer(), Arc::new(VirtualClock::new()), &mover, config(3, None));
    let pair = blurred.next_pair(SECOND).unwrap();
    assert_eq!(*mover.asked.lock().unwrap(), [millis(1), millis(3), millis(5)]);
    assert_eq!(pair.exposed_at, millis(3));
    let sharp = camera(&renderer(), Arc::new(VirtualClock::new()), &mover, config(1, None)).next_pair(SECOND).unwrap();
    assert_ne!(pair.left, sharp.left);
}

#[test]
fn an_exposure_taken_beforehand_is_delivered_whenever_it_is_asked_for() {
    let (clock, mover) = (Arc::new(VirtualClock::new()), Mover::default());
    let [mut taken, mut at_once] = [0; 2].map(|_| camera(&renderer(), clock.clone(), &mover, config(2, Some(2))));
    assert_eq!((taken.expose(SECOND), clock.now()), (Some(millis(3)), millis(6)));
    let expected = at_once.next_pair(SECOND).unwrap();
    let asked = mover.asked.lock().unwrap().len();
    // In time for the third exposure.
    clock.sleep_until(millis(70));
    let pair = taken.next_pair(SECOND).unwrap();
    assert!(pair.left == expected.left && pair.right == expected.right);
    assert_eq!((pair.sequence, pair.exposed_at), (0, millis(3)));
    assert_eq!(mover.asked.lock().unwrap().len(), asked, "no pose is asked for later");
    // The next pair is the newest one, and the stream ends once it is asked for another one.
    assert_eq!(taken.next_pair(SECOND).unwrap().sequence, 2);
    assert_eq!(taken.expose(SECOND), None);
    assert_eq!(taken.next_pair(SECOND).unwrap_err().kind(), CameraErrorKind::EndOfStream);
}

#[test]
fn a_late_caller_loses_pairs_but_gets_the_newest() {
    let clock = Arc::new(VirtualClock::new());
    let mut camera = camera(&renderer(), clock.clone(), &Mover::default(), config(1, None));
    let mut pair = FramePair::black(camera.info().size);
    let mut next_at = |ms: u64| {
        clock.sleep_until(millis(ms));
        camera.next_pair_into(&mut pair, SECOND).unwrap();
        (pair.sequence, pair.exposed_at, clock.now())
    };
    assert_eq!(next_at(0), (0, millis(3), millis(6)));
    // Slightly late: the exposure that has just ended is still the newest.
    assert_eq!(next_at(50), (1, millis(33), millis(50)));
    // Very late: 2, 3 and 4 are lost, exposure 5 ended at 156 ms.
    assert_eq!(next_at(170), (5, millis(153), millis(170)));
    // Early again: the call waits.
    assert_eq!(next_at(171), (6, millis(183), millis(186)));
}

#[test]
fn waiting_ends_with_the_time_out() {
    let clock = Arc::new(VirtualClock::new());
    let mut camera = camera(&renderer(), clock.clone(), &Mover::default(), config(1, None));
    camera.next_pair(SECOND).unwrap();
    let error = camera.next_pair(Duration::from_millis(10)).unwrap_err();
    assert_eq!((error.kind(), clock.now()), (CameraErrorKind::Timeout, millis(16)));
    assert_eq!(camera.next_pair(Duration::from_millis(20)).unwrap().sequence, 1);
}

#[test]
fn poses_that_are_not_finite_cost_one_pair_each() {
    let mover = Mover { broken: true, ..Mover::default() };
    let mut camera = camera(&renderer(), Arc::new(VirtualClock::new()), &mover, config(1, None));
    for _ in 0..2 {
        let error = camera.next_pair(SECOND).unwrap_err();
        assert_eq!(error.kind(), CameraErrorKind::BadPair);
        assert!(error.to_string().contains("not finite"), "{error}");
    }
}

#[test]
fn configurations_out_of_range_are_refused_with_the_value() {
    let renderer = renderer();
    let check = |config: SimCameraConfig, part: &str| {
        let clock = Arc::new(VirtualClock::new());
        let result = SimStereoCamera::new(renderer.clone(), Box::new(Mover::default()), clock, config);
        let Err(error) = result else { panic!("accepted, expected {part}") };
        assert_eq!(error.kind(), CameraErrorKind::Unusable);
        assert!(error.to_string().contains(part), "{error}");
    };
    check(SimCameraConfig { period: Duration::ZERO, exposure: Duration::ZERO, ..config(1, None) }, "period");
    check(SimCameraConfig { exposure: Duration::from_millis(31), ..config(1, None) }, "31ms");
    check(config(0, None), "is 0; set 1 to 64");
    check(config(65, None), "is 65; set 1 to 64");
}

/// The camera without images gives the same frames as the other one, at the same times, with the same pose requests.
#[test]
fn without_images_frames_come_at_the_same_times() {
    let config = SimCameraConfig { pairs: None, ..config(1, None) };
    let geometric = GeometricConfig {
        noise: PoseSigma { lateral_m: 1e-4, depth_m: 5e-4, tilt_rad: 2e-3, about_normal_rad: 1e-3 },
        lock: PoseSigma::default(),
        in_view_share_min: 0.5,
        turned_max_rad: 1.0,
        z_min_m: 0.2,
        z_max_m: 0.8,
        seed: 3,
    };
    let (renderer, movers) = (renderer(), [Mover::default(), Mover::default()]);
    let clocks = [Arc::new(VirtualClock::new()), Arc::new(VirtualClock::new())];
    let mut images = camera(&renderer, clocks[0].clone(), &movers[0], config.clone());
    let outline_m = renderer.scene().target().outline_m.clone();
    let tracker = GeometricTracker::new(geometric, *renderer.rig(), outline_m).unwrap();
    let mut without =
        GeometricCamera::new(tracker.clone(), Box::new(movers[1].clone()), clocks[1].clone(), &config).unwrap();
    for late in [0, 0, 100, 7, 0] {
        for clock in &clocks {
            clock.sleep_until(clock.now() + Duration::from_millis(late));
        }
        let pair = images.next_pair(SECOND).unwrap();
        let frame = without.next_frame(SECOND).unwrap();
        assert_eq!((frame.sequence, frame.exposed_at), (pair.sequence, pair.exposed_at));
        assert_eq!(clocks[0].now(), clocks[1].now());
        let truth = movers[1].clone().poses_at(frame.exposed_at);
        assert_eq!(frame.cam_left_from_target, truth.world_from_cam_left.inverse() * truth.world_from_target);
        let off =
            frame.sighting.cam_left_from_model.unwrap().translation_m() - frame.cam_left_from_target.translation_m();
        assert!(off.norm() > 0.0 && off.norm() < 5e-3, "{off}");
    }
    let timeout = without.next_frame(Duration::from_millis(2)).unwrap_err();
    assert_eq!(timeout.kind(), CameraErrorKind::Timeout);
    let broken = Mover { broken: true, ..Mover::default() };
    let mut without = GeometricCamera::new(tracker, Box::new(broken), Arc::new(VirtualClock::new()), &config).unwrap();
    assert_eq!(without.next_frame(SECOND).unwrap_err().kind(), CameraErrorKind::BadPair);
}
