//! Stereo pairs in one file, with their calibration if there is one.

use std::path::Path;
use std::time::Duration;

use image::RgbImage;
use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{
    CameraInfo, CompressedImage, Header, Image, Message, Point, Quaternion, RegionOfInterest, RosPose, Text, Time,
    Transform, TransformStamped, Transforms, Vector3 as RosVector,
};
use pb3dp_bag::sinks::{Finished, Sinks};
use pb3dp_bag::topics::ours;
use pb3dp_geometry::frames::Frame;
use pb3dp_geometry::{MonotonicTime, Pose, StereoRig};
use pb3dp_hal_api::FramePair;
use pb3dp_record::calibration_files::{CalibrationFileError, RosCameraInfo, json_text, ros_camera_infos};

/// Frames of the cameras in transforms and headers.
pub(crate) const CAMERAS: [&str; 2] = ["cam_left", "cam_right"];

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

/// Whether a recording with this path is one file, not a folder.
pub fn is_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// A recording of stereo pairs in one file, with their calibration if there is one.
pub struct PairRecording {
    pub(crate) sinks: Sinks,
    since_1970: Duration,
    infos: Option<[CameraInfo; 2]>,
}

impl PairRecording {
    /// Begins with what does not change. Pairs without a calibration are recorded, too, and those with one that ROS 2 cannot express.
    pub fn new(about: &About, rig: Option<&StereoRig>, sinks: Sinks) -> Self {
        let told = |error: &CalibrationFileError| {
            tracing::warn!(
                "the recording has no camera_info: {error}; its topic {} has the calibration",
                ours::CALIBRATION
            );
        };
        let infos = rig.and_then(|rig| ros_camera_infos(rig).inspect_err(told).ok());
        let infos = infos.map(|infos| [0, 1].map(|side| camera_info(CAMERAS[side], &infos[side])));
        let mut recording = Self { sinks, since_1970: about.since_1970, infos };
        let zero = MonotonicTime::ZERO;
        recording.push(ours::VERSION, zero, &Text { data: about.version.clone() });
        if let Some(rig) = rig {
            recording.push(ours::CALIBRATION, zero, &Text { data: json_text(rig) });
            let right = rig.cam_right_from_cam_left().inverse();
            let right = recording.transform(zero, CAMERAS[0], CAMERAS[1], &right);
            recording.push(ours::TF_STATIC, zero, &Transforms { transforms: vec![right] });
        }
        recording
    }

    /// Records a pair: images that the camera delivered as JPEG as they are.
    pub fn images(&mut self, pair: &FramePair) {
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
            let jpeg = &pair.jpegs[side];
            if jpeg.is_empty() {
                self.push(plain, at, &rgb8(header, image));
            } else {
                let image = CompressedImage { header, format: "jpeg".to_owned(), data: Bytes(jpeg.clone()) };
                self.push(compressed, at, &image);
            }
        }
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
