//! Images with faults in the direct method: it has no confidence, or it is right within its covariance, or the error is one
//! that no method could detect.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point3, UnitQuaternion, Vector3, Vector6};
use pb3dp_camera_sim::{FaultyCamera, SimStereoCamera};
use pb3dp_cell::follower::Follower;
use pb3dp_estimation::estimator::{FramePrior, Method, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig};
use pb3dp_hal_api::{Clock, StereoCamera};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_setup::setup::{Setup, read_setup};
use pb3dp_sim::camera_faults::{AffectedCameras, CameraFault, CameraFaultKind, CameraFaults};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{PoseSource, Scene, ScenePoses};
use pb3dp_sim::targets::TargetConfig;
use system_tests::repository;

const PERIOD: Duration = Duration::from_millis(33);
/// Pairs 5 to 8 have the fault.
const SUFFER: std::ops::Range<u32> = 5..9;

/// A target 500 mm in front of the cameras that moves to the right and rotates.
#[derive(Clone, Copy)]
struct Passing;

impl Passing {
    fn at(at: MonotonicTime) -> Pose<CamLeft, Target> {
        let t = at.as_secs_f64();
        let facing = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.15 + 0.1 * t, 0.05));
        Pose::from_parts(Vector3::new(0.04 + 0.05 * t, 0.004, 0.5), facing)
    }
}

impl PoseSource for Passing {
    fn poses_at(&mut self, at: MonotonicTime) -> ScenePoses {
        let world_from_target = Self::at(at).relabel();
        ScenePoses { world_from_cam_left: Pose::from_translation(Vector3::zeros()), world_from_target }
    }
}

fn setup() -> Setup {
    let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
    let pinhole = Pinhole { fx: 370.0, fy: 370.0, cx: 159.5, cy: 119.5 };
    let camera = Camera::new(ImageSize { width: 320, height: 240 }, pinhole, Distortion::None).unwrap();
    setup.rig.stereo = StereoRig::new(camera, camera, *setup.rig.stereo.cam_right_from_cam_left()).unwrap();
    setup.world.as_mut().unwrap().scene.target = TargetConfig::card();
    setup
}

/// Answer for a pair, and its error relative to the truth: metres and radians, of the pose relative to that of pair 3.
struct PairResult {
    number: u32,
    estimate: TrackEstimate,
    error: Option<Vector6<f64>>,
}

impl PairResult {
    fn is_sure(&self) -> bool {
        self.error.is_some() && self.estimate.status.depth_is_sure()
    }

    /// Whether the covariance admits the error, with the trust of configs/sim.toml in it. Chosen: the largest measured value is
    /// 6.7; of six independent numbers one in a hundred exceeds 16.8, and the gate of the servo's filter is at 80.
    fn is_right(&self) -> bool {
        self.normalised_error() < 12.0
    }

    fn normalised_error(&self) -> f64 {
        let (error, mut covariance) = (self.error.unwrap(), self.estimate.covariance.unwrap() * 2.5);
        for i in 0..6 {
            covariance[(i, i)] += if i < 3 { 1e-8 } else { 0.06f64.to_radians().powi(2) };
        }
        error.dot(&(covariance.try_inverse().unwrap() * error))
    }
}

/// Tracks the target through 13 pairs, of which those of [`SUFFER`] have a fault.
fn follow(kind: CameraFaultKind) -> Vec<PairResult> {
    let mut target_from_model = None;
    let mut pair_results = Vec::new();
    track(kind, SUFFER, |number, estimate, cam_left_from_target| {
        let found = estimate.cam_left_from_model;
        if number == 3 {
            target_from_model = Some(cam_left_from_target.inverse() * found.unwrap());
        }
        let error = found
            .zip(target_from_model)
            .map(|(found, target_from_model)| (found.inverse() * *cam_left_from_target * target_from_model).log());
        pair_results.push(PairResult { number, estimate, error });
    });
    pair_results
}

/// Status, and angle between found and true normal in degrees, of each of 13 pairs with a fault.
fn started_with(kind: CameraFaultKind) -> Vec<(Status, f64)> {
    let mut all = Vec::new();
    track(kind, 0..13, |_, estimate, cam_left_from_target| {
        let normal = |rotation: UnitQuaternion<f64>| rotation * Vector3::z();
        let found = estimate.cam_left_from_model.unwrap();
        let angle_rad = normal(found.rotation()).angle(&normal(cam_left_from_target.rotation()));
        // The target's frame may face the cameras or not.
        all.push((estimate.status, angle_rad.min(std::f64::consts::PI - angle_rad).to_degrees()));
    });
    all
}

/// Tracks the target through 13 pairs, some of them with a fault; `take` gets number, estimate and true pose.
fn track(
    kind: CameraFaultKind,
    pairs: std::ops::Range<u32>,
    mut take: impl FnMut(u32, TrackEstimate, &Pose<CamLeft, Target>),
) {
    let setup = setup();
    let scene = Scene::build(&setup.world.as_ref().unwrap().scene).unwrap();
    let outline: Vec<Point3<f64>> = scene.target().outline_m.clone();
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let renderer = StereoRenderer::new(scene, setup.rig.stereo, &setup.world.as_ref().unwrap().sensor, 7).unwrap();
    let config = pb3dp_camera_sim::SimCameraConfig { period: PERIOD, ..pb3dp_camera_sim::SimCameraConfig::default() };
    let camera = SimStereoCamera::new(renderer, Box::new(Passing), clock.clone(), config).unwrap();
    let fault = CameraFault { kind, from: PERIOD * pairs.start, until: PERIOD * pairs.end };
    let faults = CameraFaults { list: vec![fault], seed: 2 };
    let mut camera = FaultyCamera::new(camera, faults, clock.now()).unwrap();
    let tracker = Tracker::new(Method::Direct, &setup.rig.stereo, &setup.estimator).unwrap();
    let mut follower = Follower::new(tracker, setup.range);
    for number in 0..13 {
        let Ok(pair) = camera.next_pair(PERIOD * 2) else { continue };
        let cam_left_from_target = Passing::at(pair.exposed_at);
        let pixel = |point: &Point3<f64>| {
            setup.rig.stereo.left().project(&cam_left_from_target.transform_point(point)).unwrap()
        };
        let region = Region::Polygon { vertices_px: outline.iter().map(pixel).collect() };
        let prior = FramePrior { dt_s: (number > 0).then_some(PERIOD.as_secs_f64()), ..FramePrior::of_motion(None) };
        let region = (!follower.is_started()).then_some(&region);
        let estimate = follower.look(&pair.left, &pair.right, region, &prior, &mut || true).unwrap();
        take(number, estimate, &cam_left_from_target);
    }
}

fn line(pair_results: &PairResult) -> String {
    let PairResult { number, estimate, error } = pair_results;
    let error = error.map(|xi| {
        format!("{:.2} mm, {:.2} deg", xi.fixed_rows::<3>(0).norm() * 1e3, xi.fixed_rows::<3>(3).norm().to_degrees())
    });
    format!("pair {number}: {}, {}; error {error:?}", estimate.status, estimate.reason)
}

/// No wrong pose is reported as confident, during the fault or afterwards, and all pairs afterwards have a pose. In at
/// least this many of the pairs with the fault the method is confident and right.
fn is_borne(kind: CameraFaultKind, sure_at_least: usize) -> Vec<PairResult> {
    let pair_results = follow(kind);
    for pair_results in &pair_results[4..] {
        assert!(!pair_results.is_sure() || pair_results.is_right(), "{}: {}", kind.name(), line(pair_results));
    }
    let after: Vec<&PairResult> =
        pair_results.iter().filter(|pair_results| pair_results.number >= SUFFER.end).collect();
    assert_eq!(after.len(), 4, "{}", kind.name());
    for pair_results in after {
        assert!(pair_results.is_sure(), "{}: not confident after the fault, {}", kind.name(), line(pair_results));
    }
    let sure = suffering(&pair_results).filter(|pair_results| pair_results.is_sure()).count();
    assert!(sure >= sure_at_least, "{}: confident in {sure} pairs with the fault", kind.name());
    pair_results
}

fn suffering(pair_results: &[PairResult]) -> impl Iterator<Item = &PairResult> {
    pair_results.iter().filter(|pair_results| SUFFER.contains(&pair_results.number))
}

/// In no pair with the fault is the method confident.
fn is_reported(kind: CameraFaultKind) {
    let pair_results = is_borne(kind, 0);
    assert_eq!(suffering(&pair_results).count(), SUFFER.len(), "{}", kind.name());
    for pair_results in suffering(&pair_results) {
        assert!(!pair_results.is_sure(), "{}: {}", kind.name(), line(pair_results));
    }
}

#[test]
fn images_without_a_target_are_no_pose() {
    is_reported(CameraFaultKind::Black { cameras: AffectedCameras::Right });
    is_reported(CameraFaultKind::Saturated { cameras: AffectedCameras::Both });
    is_reported(CameraFaultKind::Occluder { width_share: 0.7, crosses: false });
}

#[test]
fn images_that_are_harder_to_read_are_read_right_or_not_at_all() {
    for (cameras, factor) in [(AffectedCameras::Right, 0.7), (AffectedCameras::Both, 0.3), (AffectedCameras::Both, 1.6)]
    {
        is_borne(CameraFaultKind::Brightness { cameras, factor }, 4);
    }
    is_borne(CameraFaultKind::Occluder { width_share: 0.1, crosses: true }, 2);
    // Two of the four do not arrive at all.
    is_borne(CameraFaultKind::Late { pairs: 2 }, 2);
}

/// The right image is turned by an angle in degrees and scaled.
fn displaced(roll_deg: f64, scale: f64) -> CameraFaultKind {
    CameraFaultKind::Miscalibrated { columns_px: 0.0, rows_px: 0.0, roll_rad: roll_deg.to_radians(), scale }
}

/// Cameras that are knocked, and return to their place: no wrong pose is believed, and the status names them soon after the pose has jumped.
#[test]
fn rows_that_are_displaced_for_a_while_are_named() {
    let lower = CameraFaultKind::Miscalibrated { columns_px: 0.0, rows_px: 4.0, roll_rad: 0.0, scale: 1.0 };
    for kind in [lower, displaced(1.0, 1.0), displaced(0.0, 1.03)] {
        let pair_results = is_borne(kind, 0);
        let named = suffering(&pair_results)
            .filter(|pair_results| pair_results.estimate.status == Status::Miscalibrated)
            .count();
        assert!(named >= SUFFER.len() - 2, "{kind:?}: {:?}", pair_results.iter().map(line).collect::<Vec<_>>());
    }
}

/// Cameras that were turned or refocused before the run: a small error is corrected, a large one is named, and both poses are right.
#[test]
fn a_calibration_that_is_wrong_from_the_start_is_corrected_or_named() {
    for (kind, status) in [
        (displaced(0.0, 1.0), Status::Ok),
        (displaced(0.2, 1.0), Status::Ok),
        (displaced(1.0, 1.0), Status::Miscalibrated),
        (displaced(-2.0, 1.0), Status::Miscalibrated),
        (displaced(0.0, 1.02), Status::Miscalibrated),
    ] {
        let (statuses, errors): (Vec<_>, Vec<_>) = started_with(kind).into_iter().unzip();
        assert!(statuses.iter().all(|found| *found == status), "{kind:?}: {statuses:?}");
        let worst_deg = errors.into_iter().fold(0.0, f64::max);
        assert!(worst_deg < 1.0, "{kind:?}: the normal is off by {worst_deg} degrees");
    }
}

/// Both images torn at the same row show one bent target: only its motion of a period, 1.7 mm, can be wrong, over half of
/// its height, 20 mm.
#[test]
fn a_torn_pair_is_off_by_no_more_than_the_target_moved() {
    let pair_results = follow(CameraFaultKind::Torn { share: 1.0 });
    assert!(
        suffering(&pair_results).filter(|pair_results| pair_results.is_sure()).count() >= 3,
        "torn pairs have confident poses"
    );
    for pair_results in pair_results.iter().filter(|pair_results| pair_results.number > 3 && pair_results.is_sure()) {
        let error = pair_results.error.unwrap();
        let (off_m, turned_rad) = (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm());
        assert!(off_m < 1.7e-3 && turned_rad < 1.7 / 20.0, "{}", line(pair_results));
        assert!(SUFFER.contains(&pair_results.number) || pair_results.is_right(), "{}", line(pair_results));
    }
}

/// A shift along the rows looks like another depth: no method can detect it from the images. Its effect is known.
#[test]
fn what_no_image_tells_is_off_by_what_geometry_says() {
    let (disparity_px, columns_px) = (74.0, 1.0);
    let kind = CameraFaultKind::Miscalibrated { columns_px, rows_px: 0.0, roll_rad: 0.0, scale: 1.0 };
    let farther_mm = 500.0 * (disparity_px / (disparity_px - columns_px) - 1.0);
    let pair_results = follow(kind);
    assert!(
        suffering(&pair_results).filter(|pair_results| pair_results.is_sure()).count() >= 3,
        "the images do not show the fault"
    );
    for pair_results in suffering(&pair_results).filter(|pair_results| pair_results.is_sure()) {
        let off_mm = pair_results.error.unwrap().fixed_rows::<3>(0).norm() * 1e3;
        assert!((off_mm - farther_mm).abs() < 1.0, "{farther_mm} mm: {}", line(pair_results));
    }
    let last = pair_results.last().unwrap();
    assert!(last.is_sure() && last.is_right(), "{}", line(last));
}
