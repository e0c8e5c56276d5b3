//! Stereo pairs in one file, with their calibration if there is one.

use std::path::Path;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use image::RgbImage;
use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{
    CameraInfo, CompressedImage, Header, Image, JointState, Message, Point, Quaternion, RegionOfInterest, RosPose,
    Text, Time, Transform, TransformStamped, Transforms, Vector3 as RosVector,
};
use pb3dp_bag::run_messages::{SetupFile, SetupFiles};
use pb3dp_bag::sinks::{Finished, Sinks};
use pb3dp_bag::topics::ours;
use pb3dp_estimation_core::status::SCHEMA_VERSION;
use pb3dp_geometry::frames::Frame;
use pb3dp_geometry::{MonotonicTime, Pose, StereoRig};
use pb3dp_hal_api::{DeliveredImage, FramePair, PairExposure};
use pb3dp_kinematics::{Chain, JointVector};
use pb3dp_record::calibration_files::{
    CAMERAS_FILE, CalibrationFileError, CameraIdentity, RosCameraInfo, cameras_text, json_text, ros_camera_infos,
};
use pb3dp_record::recorded_exposure::RecordedExposure;

/// Frames of the cameras in transforms and headers.
pub(crate) const CAMERAS: [&str; 2] = ["cam_left", "cam_right"];
/// Frames of the bases of the arm with the cameras and of the arm with the target.
pub(crate) const BASES: [&str; 2] = ["vs_base", "tc_base"];
/// Topics of the measured joints of both arms.
pub(crate) const JOINTS: [&str; 2] = ["/vs_robot/joint_states", "/tc_robot/joint_states"];

/// Names of the joints of an arm, in their order.
pub(crate) fn joint_names(chain: &Chain) -> Vec<String> {
    chain.joint_names().into_iter().map(str::to_owned).collect()
}

/// What a recording states of itself.
#[derive(Clone, Debug, Default)]
pub struct About {
    /// All settings of the run with their origins, as a TOML file.
    pub setup_text: String,
    /// Version of the program.
    pub version: String,
    /// Time since 1970 at the zero of the run's clock.
    pub since_1970: Duration,
}

impl About {
    /// A recording by this program, of the commit `commit`, that begins at `now` on its clock.
    ///
    /// # Errors
    /// If the clock of the computer shows a time before 1970.
    pub fn new(setup_text: String, commit: &str, now: MonotonicTime) -> Result<Self> {
        let since_1970 =
            SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).context("the clock shows a time before 1970")?;
        Ok(Self {
            setup_text,
            version: format!("pb3dp {} ({commit})", env!("CARGO_PKG_VERSION")),
            since_1970: since_1970.saturating_sub(now.saturating_since(MonotonicTime::ZERO)),
        })
    }
}

/// Whether a recording with this path is one file, not a folder.
pub fn is_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// A recording of stereo pairs in one file, with their calibration if there is one.
pub struct PairRecording {
    pub(crate) sinks: Sinks,
    since_1970: Duration,
    infos: Option<[CameraInfo; 2]>,
    /// The exposure of both cameras that was recorded last.
    exposure: Option<PairExposure>,
}

impl PairRecording {
    /// Begins with what does not change. Pairs without a calibration are recorded, too, and those with one that ROS 2 cannot express.
    pub fn new(about: &About, rig: Option<&StereoRig>, sinks: Sinks) -> Self {
        let log_refusal = |error: &CalibrationFileError| {
            tracing::warn!(
                "the recording has no camera_info: {error}; its topic {} has the calibration",
                ours::CALIBRATION
            );
        };
        let infos = rig.and_then(|rig| ros_camera_infos(rig).inspect_err(log_refusal).ok());
        let infos = infos.map(|infos| [0, 1].map(|side| camera_info(CAMERAS[side], &infos[side])));
        let mut recording = Self { sinks, since_1970: about.since_1970, infos, exposure: None };
        let zero = MonotonicTime::ZERO;
        recording.push(ours::VERSION, zero, &Text { data: about.version.clone() });
        recording.push(ours::SCHEMA_VERSION, zero, &Text { data: SCHEMA_VERSION.to_string() });
        if let Some(rig) = rig {
            recording.push(ours::CALIBRATION, zero, &Text { data: json_text(rig) });
            let right = rig.cam_right_from_cam_left().inverse();
            let right = recording.transform(zero, CAMERAS[0], CAMERAS[1], &right);
            recording.push(ours::TF_STATIC, zero, &Transforms { transforms: vec![right] });
        }
        recording
    }

    /// Records the identities of the cameras, if they are known.
    pub fn cameras(&mut self, cameras: Option<&[CameraIdentity; 2]>) {
        let Some(cameras) = cameras else { return };
        let file = SetupFile { path: CAMERAS_FILE.to_owned(), data: Bytes(cameras_text(cameras).into_bytes()) };
        self.push(ours::FILES, MonotonicTime::ZERO, &SetupFiles { files: vec![file] });
    }

    /// Records a pair, its images as the camera has delivered them.
    pub fn images(&mut self, pair: &FramePair) {
        self.exposure(pair);
        let right_at = MonotonicTime::from_nanos(pair.exposed_at.as_nanos().saturating_add_signed(pair.skew_nanos));
        let sides = [
            (&pair.left, pair.exposed_at, [ours::LEFT_IMAGE, ours::LEFT_COMPRESSED, ours::LEFT_INFO]),
            (&pair.right, right_at, [ours::RIGHT_IMAGE, ours::RIGHT_COMPRESSED, ours::RIGHT_INFO]),
        ];
        for (side, (image, at, [plain, compressed, info])) in sides.into_iter().enumerate() {
            let header = self.header(at, CAMERAS[side]);
            let camera = self.infos.as_ref().map(|infos| infos[side].clone());
            if let Some(camera) = camera {
                self.push(info, at, &CameraInfo { header: header.clone(), ..camera });
            }
            let delivered = &pair.delivered[side];
            match delivered.jpeg() {
                Some(jpeg) => {
                    let image = CompressedImage { header, format: "jpeg".to_owned(), data: Bytes(jpeg.to_vec()) };
                    self.push(compressed, at, &image);
                }
                None => self.push(plain, at, &plain_image(header, image, delivered)),
            }
        }
    }

    /// Records the exposure of a pair if it differs from that of the pair before: the first pair after a change, and the first one in which
    /// both images certainly have it.
    fn exposure(&mut self, pair: &FramePair) {
        let Some(exposure) = pair.exposure.filter(|exposure| self.exposure != Some(*exposure)) else { return };
        self.exposure = Some(exposure);
        let PairExposure { time, gain, changes, factor, is_settling } = exposure;
        let (sequence, exposure_millis) = (pair.sequence, time.as_secs_f64() * 1e3);
        let recorded = RecordedExposure { sequence, exposure_millis, gain, changes, factor, is_settling };
        self.push(ours::EXPOSURE, pair.exposed_at, &Text { data: recorded.text() });
    }

    /// Records an older pair on which the operator drew, without compression.
    pub(crate) fn drawn_on(&mut self, pair: &FramePair) {
        for (side, image) in [&pair.left, &pair.right].into_iter().enumerate() {
            let header = self.header(pair.exposed_at, CAMERAS[side]);
            self.push(ours::DRAWN_ON[side], pair.exposed_at, &rgb8(header, image));
        }
    }

    /// Whether the recording has ended before [`Self::finish`]: its file cannot be written any more.
    pub fn is_over(&self) -> bool {
        self.sinks.is_over()
    }

    /// Finishes all files.
    pub fn finish(self) -> Finished {
        self.sinks.finish()
    }

    /// Records the joints of an arm, without velocities if they are not known.
    pub(crate) fn joint_state(
        &mut self,
        topic: &'static str,
        at: MonotonicTime,
        names: &[String],
        [position_rad, velocity_rad_per_s]: [Option<&JointVector>; 2],
    ) {
        let values = |joints: Option<&JointVector>| {
            joints.map(|joints| joints.as_slice()[..names.len()].to_vec()).unwrap_or_default()
        };
        let state = JointState {
            header: self.header(at, ""),
            name: names.to_vec(),
            position: values(position_rad),
            velocity: values(velocity_rad_per_s),
            effort: Vec::new(),
        };
        self.push(topic, at, &state);
    }

    pub(crate) fn push<M: Message>(&mut self, topic: &'static str, at: MonotonicTime, message: &M) {
        self.sinks.push(topic, at + self.since_1970, message);
    }

    pub(crate) fn stamp(&self, at: MonotonicTime) -> Time {
        (at + self.since_1970).into()
    }

    pub(crate) fn header(&self, at: MonotonicTime, frame: &str) -> Header {
        Header { stamp: self.stamp(at), frame_id: frame.to_owned() }
    }

    pub(crate) fn transform<A: Frame, B: Frame>(
        &self,
        at: MonotonicTime,
        parent: &str,
        child: &str,
        pose: &Pose<A, B>,
    ) -> TransformStamped {
        let RosPose { position: Point { x, y, z }, orientation } = ros_pose(pose);
        let transform = Transform { translation: RosVector { x, y, z }, rotation: orientation };
        TransformStamped { header: self.header(at, parent), child_frame_id: child.to_owned(), transform }
    }
}

pub(crate) fn ros_pose<A: Frame, B: Frame>(pose: &Pose<A, B>) -> RosPose {
    let (translation, rotation) = (pose.translation_m(), pose.rotation());
    RosPose {
        position: Point { x: translation.x, y: translation.y, z: translation.z },
        orientation: Quaternion { x: rotation.i, y: rotation.j, z: rotation.k, w: rotation.w },
    }
}

/// The image as the camera has delivered it.
fn plain_image(header: Header, image: &RgbImage, delivered: &DeliveredImage) -> Image {
    if delivered.encoding.is_empty() {
        return rgb8(header, image);
    }
    let (width, height) = image.dimensions();
    // Rows have no padding.
    let step = (delivered.bytes.len() / height.max(1) as usize) as u32;
    let (encoding, data) = (delivered.encoding.to_owned(), Bytes(delivered.bytes.clone()));
    Image { header, height, width, encoding, is_bigendian: 0, step, data }
}

fn rgb8(header: Header, image: &RgbImage) -> Image {
    let (width, height) = image.dimensions();
    let data = Bytes(image.as_raw().clone());
    Image { header, height, width, encoding: "rgb8".to_owned(), is_bigendian: 0, step: 3 * width, data }
}

fn camera_info(frame: &str, info: &RosCameraInfo) -> CameraInfo {
    CameraInfo {
        header: Header { stamp: Time::default(), frame_id: frame.to_owned() },
        height: info.size.height,
        width: info.size.width,
        distortion_model: info.distortion_model.to_owned(),
        d: info.distortion.clone(),
        k: info.camera_matrix,
        r: info.rectification,
        p: info.projection,
        binning_x: 0,
        binning_y: 0,
        roi: RegionOfInterest::default(),
    }
}
