//! Runs the program and reads what it wrote; makes images for it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use image::RgbImage;
use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{CamLeft, Target, World};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_hal_platform::key_file::write_new_key;
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, SceneConfig, ScenePoses};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::TargetConfig;
use serde_json::Value;

/// Keys of a line of `estimate --json`, in order.
pub const ESTIMATE_KEYS: [&str; 19] = [
    "case",
    "method",
    "status",
    "z_mm",
    "normal",
    "fitness",
    "z_sigma_mm",
    "normal_sigma_deg",
    "ms",
    "centroid_px",
    "second_plane",
    "point_mm",
    "cam_left_from_model",
    "covariance",
    "pose_covariance",
    "observed",
    "row_offset_px",
    "reason",
    "warnings",
];
/// Keys of a line of `track --json`, in order.
pub const TRACK_KEYS: [&str; 15] = [
    "frame",
    "t_s",
    "status",
    "cam_left_from_model",
    "covariance",
    "first_pose_covariance",
    "pose_covariance",
    "surface_from_model",
    "surface_covariance",
    "surface_version",
    "observed",
    "fitness",
    "ms",
    "reason",
    "warnings",
];
/// What `estimate` may say of a case.
pub const STATUSES: [&str; 5] = ["ok", "weak-tilt", "ambiguous", "not-observable", "error"];

/// The key of emulated arms and gateways on TCP.
pub fn key_file() -> PathBuf {
    static FILE: OnceLock<PathBuf> = OnceLock::new();
    let new = || {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
        let (file, own) = (folder.join("gateway.key"), folder.join(format!("gateway-{}.key", std::process::id())));
        if !file.exists() {
            write_new_key(&own).unwrap();
            // Another test program may have been quicker: then its key stays.
            std::fs::hard_link(&own, &file).ok();
            std::fs::remove_file(&own).unwrap();
        }
        file
    };
    FILE.get_or_init(new).clone()
}

/// What the program left behind.
pub struct Finished {
    pub success: bool,
    pub stdout: String,
    pub stderr: String,
}

impl Finished {
    /// The JSON lines of standard output; each has exactly these keys in this order, and nothing else stands there.
    pub fn json_lines(&self, keys: &[&str]) -> Vec<Value> {
        self.stdout.lines().map(|line| json_line(line, keys)).collect()
    }

    /// Asserts a failure whose message holds all parts.
    pub fn assert_refused(&self, parts: &[&str]) {
        assert!(!self.success, "a failure was expected for {parts:?}; stdout:\n{}\n{}", self.stdout, self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "{part:?} is missing in:\n{}", self.stderr);
        }
    }

    /// Asserts success.
    pub fn assert_success(self) -> Self {
        assert!(self.success, "{}\n{}", self.stdout, self.stderr);
        self
    }
}

fn json_line(line: &str, keys: &[&str]) -> Value {
    let value: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    assert_eq!(value["schema_version"], 1, "{line}");
    assert_eq!(value.as_object().unwrap().len(), keys.len() + 1, "{line}");
    let places: Vec<_> = keys.iter().map(|key| line.find(&format!("\"{key}\":")).unwrap_or(usize::MAX)).collect();
    assert!(places.is_sorted() && places.last() < Some(&usize::MAX), "keys {keys:?} in this order: {line}");
    value
}

/// Runs the program; it may refuse, but it may not panic or be killed.
pub fn pb3dp<S: AsRef<OsStr>>(args: &[S]) -> Finished {
    let output = Command::new(env!("CARGO_BIN_EXE_pb3dp")).args(args).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let (stdout, stderr) = (text(output.stdout), text(output.stderr));
    let shown: Vec<_> = args.iter().map(|arg| arg.as_ref().to_string_lossy()).collect();
    assert!(!stderr.contains("panicked"), "{shown:?}:\n{stderr}");
    assert!(matches!(output.status.code(), Some(0..=2)), "{shown:?}: {}\n{stderr}", output.status);
    Finished { success: output.status.success(), stdout, stderr }
}

/// Arguments from literals and paths.
pub fn words(parts: &[&dyn AsRef<OsStr>]) -> Vec<std::ffi::OsString> {
    parts.iter().map(|part| part.as_ref().to_owned()).collect()
}

/// The root of the repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The real pairs of the repository.
pub fn real_cases() -> PathBuf {
    repository().join("tests/data/cases")
}

/// A copy of the real pairs that a test may damage.
pub fn copy_of_real_cases(to: &Path) {
    for case in folders(&real_cases()) {
        let copy = to.join(case.file_name().unwrap());
        std::fs::create_dir_all(&copy).unwrap();
        for file in std::fs::read_dir(&case).unwrap() {
            let file = file.unwrap().path();
            std::fs::copy(&file, copy.join(file.file_name().unwrap())).unwrap();
        }
    }
}

/// The folders in a folder, sorted.
pub fn folders(dir: &Path) -> Vec<PathBuf> {
    let mut found: Vec<_> = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| path.is_dir());
    found.sort();
    found
}

/// Keeps the first part of a file, as an interrupted copy does.
pub fn truncate(file: &Path, bytes: usize) {
    let whole = std::fs::read(file).unwrap();
    assert!(whole.len() > bytes);
    std::fs::write(file, &whole[..bytes]).unwrap();
}

/// `text` with its only occurrence of `from` replaced.
pub fn replaced(text: &str, from: &str, to: &str) -> String {
    assert_eq!(text.matches(from).count(), 1, "{from:?} stands once in the file");
    text.replace(from, to)
}

/// A stereo pair with unequal cameras, the right one turned a little.
pub fn rig() -> StereoRig {
    let size = ImageSize { width: 640, height: 480 };
    let camera = |fx, cx, cy| Camera::new(size, Pinhole { fx, fy: fx, cx, cy }, Distortion::None).unwrap();
    let turned = UnitQuaternion::from_euler_angles(0.004, -0.01, 0.003);
    let cam_right_from_cam_left = Pose::from_parts(Vector3::new(-0.1, 0.002, 0.001), turned);
    StereoRig::new(camera(740.0, 316.0, 242.0), camera(732.0, 323.0, 236.0), cam_right_from_cam_left).unwrap()
}

/// A renderer of `target` before the usual backdrop.
pub fn renderer(target: TargetConfig) -> StereoRenderer {
    let scene = Scene::build(&SceneConfig::new(target)).unwrap();
    StereoRenderer::new(scene, rig(), &SensorConfig::default(), 7).unwrap()
}

/// The target at `translation_m` before the left camera, turned by `rotation_vector_rad`; seen in a room with z up.
pub fn poses(translation_m: [f64; 3], rotation_vector_rad: [f64; 3]) -> (ScenePoses, Pose<CamLeft, Target>) {
    let turned = UnitQuaternion::from_scaled_axis(rotation_vector_rad.into());
    let cam_left_from_target = Pose::from_parts(translation_m.into(), turned);
    let upright = UnitQuaternion::from_euler_angles(-std::f64::consts::FRAC_PI_2, 0.0, -0.4);
    let world_from_cam_left = Pose::<World, CamLeft>::from_parts(Vector3::new(-0.3, 0.1, 1.0), upright);
    let world_from_target = world_from_cam_left * cam_left_from_target;
    (ScenePoses { world_from_cam_left, world_from_target }, cam_left_from_target)
}

/// One rendered pair.
pub fn render(renderer: &mut StereoRenderer, poses: &ScenePoses, frame: u64) -> (RgbImage, RgbImage) {
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    renderer.render_pair(poses, frame, &mut left, &mut right);
    (left, right)
}

/// Depth of the plane z = 0 of `target` on the ray of a left pixel, millimetres.
pub fn true_depth_mm(cam_left_from_target: &Pose<CamLeft, Target>, pixel: [f64; 2]) -> f64 {
    let ray = rig().left().unproject(&pixel.into()).unwrap();
    let normal = cam_left_from_target.transform_vector(&Vector3::z());
    normal.dot(&cam_left_from_target.translation_m()) / normal.dot(&ray) * 1e3
}

/// Numbers of a JSON array.
pub fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// The line without its time, which alone may differ between two runs.
pub fn without_time(mut line: Value) -> Value {
    line.as_object_mut().unwrap().remove("ms");
    line
}
