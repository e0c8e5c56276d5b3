//! Raw images: the direct method against the plain path, which rectifies whole images; unusual and absurd calibrations.

use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation::rig_watch::RowMeter;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionMask};
use pb3dp_estimation_core::rig_errors::ROLL;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_geometry::frames::{CamLeft, CamRight, Model};
use pb3dp_geometry::maps::{PixelMap, RemapTable};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

use crate::common::{self, Look};

fn range() -> SearchRange {
    SearchRange::new(0.35, 0.7, 0.785).unwrap()
}

fn target() -> Pose<CamLeft, Model> {
    common::target_at((8.0, -6.0, 480.0), (12.0, -15.0, 20.0))
}

/// Depth at the centroid and normal in `cam_left`, and the status.
fn estimate(rig: &StereoRig, shot: &common::Shot, region: &Region) -> (f64, Vector3<f64>, Vector2<f64>, Status) {
    let mut estimator = DirectEstimator::new(rig, DirectConfig::default()).unwrap();
    let found = estimator.estimate(EstimateRequest::new_target(&shot.left, &shot.right, region, &range())).unwrap();
    let pose = found.pose.unwrap_or_else(|| panic!("{}", found.reason));
    (pose.z_m, pose.inverse_depth_plane, found.centroid_px, found.status)
}

fn outline(rig: &StereoRig) -> Region {
    Region::Polygon { vertices_px: common::outline_px(rig, &target()) }
}

/// The plain path: every pixel of the rectified image by its table, with a cubic kernel.
fn rectified(map: &PixelMap, raw: &RgbImage) -> RgbImage {
    let table = map.table();
    let size = table.size();
    RgbImage::from_fn(size.width, size.height, |u, v| Rgb(cubic(&table, raw, u, v).unwrap_or_default()))
}

fn cubic(table: &RemapTable, raw: &RgbImage, u: u32, v: u32) -> Option<[u8; 3]> {
    let at = table.source(u, v)?;
    let (x, y) = (at.x.floor(), at.y.floor());
    if x < 1.0 || y < 1.0 || x > f64::from(raw.width()) - 3.0 || y > f64::from(raw.height()) - 3.0 {
        return None;
    }
    let weights = |t: f64| {
        let (t2, t3) = (t * t, t * t * t);
        [0.5 * (2.0 * t2 - t - t3), 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * (t + 4.0 * t2 - 3.0 * t3), 0.5 * (t3 - t2)]
    };
    let (columns, rows) = (weights(at.x - x), weights(at.y - y));
    let mut sum = [0.0; 3];
    for (j, i) in (0..4).flat_map(|j| (0..4).map(move |i| (j, i))) {
        let pixel = raw.get_pixel(x as u32 + i as u32 - 1, y as u32 + j as u32 - 1).0;
        sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += columns[i] * rows[j] * f64::from(value));
    }
    Some(sum.map(|value| value.round().clamp(0.0, 255.0) as u8))
}

#[test]
fn planes_agree_with_those_of_fully_rectified_images() {
    let pose = target();
    for rig in [common::general_rig(), common::distorted_rig()] {
        let shot = common::render(&rig, Some(&pose), Look::Speckled);
        let (z_m, plane, centroid_px, status) = estimate(&rig, &shot, &outline(&rig));
        let rectification = rig.rectify().unwrap();
        let left_mask = RegionMask::from_fn(rig.left().size(), {
            let mask = outline(&rig).rasterize(&shot.left, &DirectConfig::default().region).unwrap();
            move |x, y| mask.contains(x as i32, y as i32)
        });
        let bytes = |mask: &RegionMask| {
            let size = mask.size();
            (0..size.height)
                .flat_map(|y| (0..size.width).map(move |x| (x, y)))
                .map(|(x, y)| if mask.contains(x as i32, y as i32) { 255 } else { 0 })
                .collect::<Vec<u8>>()
        };
        let table = rectification.left.table();
        let size = table.size();
        let mut mapped = vec![0; (size.width * size.height) as usize];
        table.remap_mask(&bytes(&left_mask), left_mask.size(), &mut mapped).unwrap();
        let mask = GrayImage::from_fn(size.width, size.height, |x, y| Luma([mapped[(y * size.width + x) as usize]]));
        let plain = common::Shot {
            left: rectified(&rectification.left, &shot.left),
            right: rectified(&rectification.right, &shot.right),
        };
        let (_, plain_plane, _, plain_status) = estimate(&rectification.rig, &plain, &Region::Mask(mask));
        let back = rectification.cam_left_rect_from_cam_left.inverse();
        let plain_plane = back.transform_vector(&plain_plane);
        let angle = common::angle_deg(&plane, &plain_plane);
        let ray = rig.left().unproject(&centroid_px).unwrap();
        let plain_z_m = 1.0 / plain_plane.dot(&ray);
        assert!(angle < 0.25 && (plain_z_m - z_m).abs() < 2e-4, "{angle} degrees, {z_m} and {plain_z_m} m");
        assert_eq!((status, plain_status), (Status::Ok, Status::Ok));
        let truth_m = common::true_depth_m(&rig, &pose, &centroid_px);
        assert!((z_m - truth_m).abs() < 1e-3, "{z_m} m, true {truth_m} m");
    }
}

fn camera(size: ImageSize, focal_px: [f64; 2], centre_px: [f64; 2], distortion: Distortion) -> Camera {
    let pinhole = Pinhole { fx: focal_px[0], fy: focal_px[1], cx: centre_px[0], cy: centre_px[1] };
    Camera::new(size, pinhole, distortion).unwrap()
}

fn check_accuracy(name: &str, rig: &StereoRig, depth_max_m: f64) {
    let pose = target();
    let shot = common::render(rig, Some(&pose), Look::Speckled);
    let (z_m, plane, centroid_px, _) = estimate(rig, &shot, &outline(rig));
    let truth_m = common::true_depth_m(rig, &pose, &centroid_px);
    let angle = common::angle_deg(&plane, &pose.transform_vector(&Vector3::z()));
    assert!((z_m - truth_m).abs() < depth_max_m && angle < 2.0, "{name}: {z_m} m, true {truth_m} m, {angle} degrees");
}

const BROWN: Distortion = Distortion::BrownConrady5 { coefficients: [-0.24, 0.09, 0.0011, -0.0007, -0.01] };
const FISHEYE: Distortion = Distortion::Equidistant { coefficients: [0.02, -0.011, 0.004, -0.001] };

#[test]
fn vertical_baselines_work_in_both_directions() {
    let size = ImageSize { width: 320, height: 240 };
    for direction in [1.0, -1.0] {
        let left = camera(size, [402.0, 398.5], [157.2, 121.4], BROWN);
        let right = camera(size, [391.0, 393.5], [163.1, 117.2], FISHEYE);
        let rotation = UnitQuaternion::from_euler_angles(0.02 * direction, -0.013, 0.021);
        let centre_in_cam_left = Vector3::new(0.003, 0.05 * direction, 0.002);
        let pose: Pose<CamRight, CamLeft> = Pose::from_parts(-(rotation * centre_in_cam_left), rotation);
        check_accuracy("vertical", &StereoRig::new(left, right, pose).unwrap(), 2e-3);
    }
}

#[test]
fn cameras_of_different_size_work() {
    let left = camera(ImageSize { width: 320, height: 240 }, [402.0, 398.5], [157.2, 121.4], BROWN);
    let right = camera(ImageSize { width: 470, height: 310 }, [531.0, 528.5], [238.1, 151.2], FISHEYE);
    let rotation = UnitQuaternion::from_euler_angles(0.013, -0.055, 0.021);
    let pose: Pose<CamRight, CamLeft> = Pose::from_parts(Vector3::new(-0.097, 0.004, 0.006), rotation);
    check_accuracy("sizes", &StereoRig::new(left, right, pose).unwrap(), 1e-3);
}

/// Depth, true depth and status of a target at `centre_mm`, and its pixel.
fn at_the_edge(rig: &StereoRig, centre_mm: (f64, f64, f64), depth_m: [f64; 2]) -> (f64, f64, Status, Vector2<f64>) {
    let pose = common::target_at(centre_mm, (5.0, 15.0, 20.0));
    let shot = common::render(rig, Some(&pose), Look::Speckled);
    let region = Region::Polygon { vertices_px: common::outline_px(rig, &pose) };
    let pixel = rig.left().project(&Point3::from(pose.translation_m())).unwrap();
    let mut estimator = DirectEstimator::new(rig, DirectConfig::default()).unwrap();
    let range = SearchRange::new(depth_m[0], depth_m[1], 0.785).unwrap();
    let found = estimator.estimate(EstimateRequest::new_target(&shot.left, &shot.right, &region, &range)).unwrap();
    let z_m = found.pose.as_ref().unwrap_or_else(|| panic!("{pixel}: {}", found.reason)).z_m;
    (z_m, common::true_depth_m(rig, &pose, &found.centroid_px), found.status, pixel)
}

/// Rectified images of the size of the raw ones end at 41 degrees.
#[test]
fn equidistant_lenses_work_to_the_edge_of_the_field() {
    let size = ImageSize { width: 320, height: 240 };
    let left = camera(size, [182.0, 180.5], [157.2, 121.4], FISHEYE);
    let right = camera(size, [181.0, 183.5], [163.1, 117.2], FISHEYE);
    let rotation = UnitQuaternion::from_euler_angles(0.013, -0.025, 0.021);
    let rig = StereoRig::new(left, right, Pose::from_parts(Vector3::new(-0.057, 0.004, 0.003), rotation)).unwrap();
    for (x_mm, limit_m) in [(300.0, 4e-3), (330.0, 4e-3), (-330.0, 4e-3)] {
        let (z_m, truth_m, status, pixel) = at_the_edge(&rig, (x_mm, 20.0, 330.0), [0.24, 0.6]);
        assert!((z_m - truth_m).abs() < limit_m, "{pixel}: {z_m} m, true {truth_m} m, {status:?}");
        assert!((pixel.x - 160.0).abs() > 100.0, "{pixel}");
    }
}

/// The rows of rectified images are the columns of the raw ones, of which there are more.
#[test]
fn vertical_baselines_work_to_the_edge_of_the_field() {
    let size = ImageSize { width: 320, height: 240 };
    let left = camera(size, [402.0, 398.5], [157.2, 121.4], BROWN);
    let pose = Pose::from_translation(Vector3::new(0.002, -0.05, 0.001));
    let rig = StereoRig::new(left, left, pose).unwrap();
    for x_mm in [150.0, -150.0] {
        let (z_m, truth_m, status, pixel) = at_the_edge(&rig, (x_mm, 0.0, 480.0), [0.35, 0.7]);
        assert!((z_m - truth_m).abs() < 2e-3, "{pixel}: {z_m} m, true {truth_m} m, {status:?}");
        assert!((pixel.x - 160.0).abs() > 110.0, "{pixel}");
    }
}

/// The calibration states a roll of the right camera that is wrong by 0.8 degrees: the offset changes along the rows, and the tilt would be
/// wrong by ten times as much as with the roll corrected.
#[test]
fn a_wrong_roll_of_raw_images_is_measured_corrected_and_not_believed() {
    let rig = common::distorted_rig();
    let pose = target();
    let shot = common::render(&rig, Some(&pose), Look::Speckled);
    let roll: Pose<CamRight, CamRight> =
        Pose::from_parts(Vector3::zeros(), UnitQuaternion::from_euler_angles(0.0, 0.0, 0.014));
    let stated = StereoRig::new(*rig.left(), *rig.right(), roll * *rig.cam_right_from_cam_left()).unwrap();
    let mut estimator = Estimator::new(Method::Direct, &stated, &EstimatorConfig::default()).unwrap();
    let measured = estimator.look(&shot.left, &shot.right).unwrap();
    assert!(measured.matches >= 60 && (measured.errors[ROLL] + 0.014).abs() < 1e-3, "{measured:?}");
    let region = outline(&rig);
    let found = estimator.estimate(EstimateRequest::new_target(&shot.left, &shot.right, &region, &range())).unwrap();
    assert_eq!(found.status, Status::Miscalibrated, "{}", found.reason);
    assert!(found.reason.contains("roll -0.8"), "{}", found.reason);
    let z_m = found.pose.as_ref().unwrap_or_else(|| panic!("{}", found.reason)).z_m;
    let truth_m = common::true_depth_m(&rig, &pose, &found.centroid_px);
    assert!((z_m - truth_m).abs() < 5e-3, "{z_m} m, true {truth_m} m");
}

const ABSURD: [f64; 14] =
    [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0, 1e-300, 1e300, 1e-3, 0.5, 7.0, 300.0, 1e5, 1e8, -1e12];

struct Draw(SplitMix64);

impl Draw {
    /// Mostly a usual value.
    fn value(&mut self, usual: f64) -> f64 {
        let absurd = ABSURD[self.0.below(ABSURD.len() as u32) as usize];
        if self.0.chance(0.12) { absurd } else { usual * self.0.between(0.9, 1.1) }
    }

    fn camera(&mut self, size: ImageSize) -> Result<Camera, pb3dp_geometry::CameraError> {
        let f = f64::from(size.width) * 1.1;
        let (fx, fy) = (self.value(f), self.value(f));
        let (cx, cy) = (self.value(f64::from(size.width) / 2.0), self.value(f64::from(size.height) / 2.0));
        let distortion = match self.0.below(4) {
            0 => Distortion::None,
            1 => Distortion::BrownConrady5 { coefficients: [-0.2, 0.05, 1e-3, -1e-3, 0.0].map(|k| self.value(k)) },
            2 => {
                let usual = [0.4, -0.2, 0.001, -0.002, 0.05, 0.7, -0.1, 0.02];
                Distortion::BrownConrady8 { coefficients: usual.map(|k| self.value(k)) }
            }
            _ => Distortion::Equidistant { coefficients: [-0.01, 0.004, -0.002, 4e-4].map(|k| self.value(k)) },
        };
        Camera::new(size, Pinhole { fx, fy, cx, cy }, distortion)
    }

    fn rig(&mut self, sizes: [ImageSize; 2]) -> Result<StereoRig, String> {
        let left = self.camera(sizes[0]).map_err(|error| error.to_string())?;
        let right = self.camera(sizes[1]).map_err(|error| error.to_string())?;
        let angles = [0.01, -0.03, 0.02].map(|angle| self.value(angle));
        let rotation = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
        let shift = Vector3::from([-0.1, 0.004, 0.006].map(|t| self.value(t)));
        StereoRig::new(left, right, Pose::from_parts(shift, rotation)).map_err(|error| error.to_string())
    }
}

fn noise(size: ImageSize, seed: u64) -> RgbImage {
    let mut rng = SplitMix64::new(seed);
    RgbImage::from_fn(size.width, size.height, |_, _| Rgb([0; 3].map(|_: u8| rng.next_u64() as u8)))
}

/// Every calibration is refused with a message, or gives an estimate: nothing overflows or panics, in a test build.
#[test]
fn absurd_calibrations_are_refused_or_survived() {
    let sizes = [(1, 1), (2, 7), (5, 4), (64, 48), (161, 117), (8192, 24), (24, 8192)];
    let sizes = sizes.map(|(width, height)| ImageSize { width, height });
    let images = sizes.map(|size| [noise(size, 1), noise(size, 2)]);
    let (mut refused, mut estimated) = (0, 0);
    for seed in 0..600 {
        let mut draw = Draw(SplitMix64::new(seed));
        let chosen = [0, 1].map(|_| draw.0.below(sizes.len() as u32) as usize);
        let chosen = if seed % 3 == 0 { chosen } else { [chosen[0]; 2] };
        let rig = match draw.rig(chosen.map(|index| sizes[index])) {
            Ok(rig) => rig,
            Err(message) => {
                assert!(message.len() > 20, "{message}");
                refused += 1;
                continue;
            }
        };
        let mut estimator = match DirectEstimator::new(&rig, DirectConfig::default()) {
            Ok(estimator) => estimator,
            Err(error) => {
                assert!(error.to_string().len() > 20, "{error}");
                refused += 1;
                continue;
            }
        };
        let [left, right] = [&images[chosen[0]][0], &images[chosen[1]][1]];
        let (width, height) = left.dimensions();
        let region = Region::Rectangle { x: 2, y: 3, width: width.min(90), height: height.min(70) };
        let range = SearchRange::new(0.3, 0.8, 0.7).unwrap();
        // A tiny region is refused; what matters is that the call returns.
        let _ = estimator.estimate(EstimateRequest::new_target(left, right, &region, &range));
        if u64::from(width) * u64::from(height) < 30_000 {
            let _ = RowMeter::new(&rig, Kernels::best()).and_then(|meter| meter.measure(left, right, None));
        }
        estimated += 1;
    }
    assert!(refused > 150 && estimated > 100, "{refused} refused, {estimated} estimated");
}

#[test]
fn messages_name_the_absurd_parameter() {
    let size = ImageSize { width: 320, height: 240 };
    let usual = Pinhole { fx: 300.0, fy: 301.0, cx: 157.0, cy: 121.0 };
    let message = |pinhole: Pinhole, distortion| Camera::new(size, pinhole, distortion).unwrap_err().to_string();
    for (pinhole, name) in [
        (Pinhole { fx: 0.0, ..usual }, "fx is 0"),
        (Pinhole { fy: f64::NAN, ..usual }, "fy is NaN"),
        (Pinhole { fx: 1e300, ..usual }, "fx is"),
        (Pinhole { fy: 1e-300, ..usual }, "fy is"),
        (Pinhole { cx: f64::INFINITY, ..usual }, "cx is inf"),
        (Pinhole { cy: -1e200, ..usual }, "cy is -"),
    ] {
        let message = message(pinhole, Distortion::None);
        assert!(message.contains(name), "{message}");
    }
    let huge = message(usual, Distortion::BrownConrady5 { coefficients: [0.1, 1e30, 0.0, 0.0, 0.0] });
    assert!(huge.contains("k2 is"), "{huge}");
    // The polynomial folds a few pixels from the principal point.
    let folding = Distortion::BrownConrady5 { coefficients: [-4000.0, 0.0, 0.0, 0.0, 0.0] };
    let camera = |distortion| Camera::new(size, usual, distortion).unwrap();
    let pose: Pose<CamRight, CamLeft> = Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0));
    let rig = StereoRig::new(camera(Distortion::None), camera(folding), pose).unwrap();
    let error = rig.rectify().unwrap_err().to_string();
    assert!(error.contains("right camera") && error.contains("distortion coefficients"), "{error}");
}
