//! Records a run as an MCAP file with ROS 2 messages: images as the cameras delivered them, calibration, estimates, joints, commands,
//! changes of state, and the settings.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use nalgebra::Matrix6;
use pb3dp_bag::BagError;
use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{
    CameraInfo, CompressedImage, DiagnosticStatus, Diagnostics, Header, Image, JointState, KeyValue, Level, LogLine,
    Point, Point32, Polygon, PolygonStamped, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion,
    RegionOfInterest, RosPose, Text, Time, Transform, TransformStamped, Transforms, Vector3 as RosVector,
};
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull, Written};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::frames::{CamLeft, Flange, Frame};
use pb3dp_geometry::{MonotonicTime, Pose, StereoRig};
use pb3dp_hal_api::FramePair;
use pb3dp_kinematics::Chain;
use pb3dp_record::calibration_files::{CalibrationFileError, RosCameraInfo, json_text, ros_camera_infos};
use pb3dp_setup::setup::{Pace, Setup};

use super::moving::Moved;
use super::noting::{PairEstimate, outline_px};
use crate::annotation::polygon_px;
use crate::perception::View;

/// Frames in transforms and headers.
const CAMERAS: [&str; 2] = ["cam_left", "cam_right"];
const TARGET: &str = "target";
const BASE: &str = "vs_base";

/// Where and how a run is recorded.
#[derive(Clone, Debug)]
pub struct RecordTo<'a> {
    /// A file with the extension `mcap`, or the folder of a sequence.
    pub path: &'a Path,
    /// All settings of the run with their origins, as a TOML file.
    pub setup_text: String,
    /// Version of the program.
    pub version: String,
    /// Time since 1970 at the zero of the run's clock.
    pub since_1970: Duration,
}

impl<'a> RecordTo<'a> {
    /// A sequence folder.
    pub fn folder(path: &'a Path) -> Self {
        Self { path, setup_text: String::new(), version: String::new(), since_1970: Duration::ZERO }
    }

    /// Whether the path is a file, not a folder.
    pub fn is_file(path: &Path) -> bool {
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
    }
}

/// A recording of stereo pairs in one file, with their calibration if there is one.
pub struct PairRecording {
    writer: BagWriter,
    since_1970: Duration,
    infos: Option<[CameraInfo; 2]>,
}

/// A recording of a run in one file.
pub struct BagRecording {
    pairs: PairRecording,
    joint_names: [Vec<String>; 2],
    /// The arm that carries the cameras, and their mounting.
    vs_chain: Chain,
    flange_from_cam_left: Pose<Flange, CamLeft>,
    is_failure_reported: bool,
}

impl BagRecording {
    /// Creates the file and writes what does not change.
    ///
    /// # Errors
    /// If the file exists or cannot be written.
    pub fn new(to: &RecordTo<'_>, setup: &Setup) -> Result<Self> {
        let when_full = if setup.pace == Pace::Fast { WhenFull::Wait } else { WhenFull::Drop };
        let pairs = PairRecording::new(to, Some(&setup.rig.stereo), when_full).context("--record")?;
        let vs = &setup.rig.arms.vs;
        let names = |chain: &Chain| chain.joint_names().into_iter().map(str::to_owned).collect();
        let mut recording = Self {
            pairs,
            joint_names: [names(&vs.chain), names(&setup.rig.arms.tc.chain)],
            vs_chain: vs.chain.clone(),
            flange_from_cam_left: setup.controller.flange_from_hand * setup.controller.hand_from_cam_left,
            is_failure_reported: false,
        };
        recording.pairs.push(ours::SETUP, MonotonicTime::ZERO, &Text { data: to.setup_text.clone() });
        Ok(recording)
    }

    /// Records a pair with its estimate.
    pub fn seen(&mut self, seen: &PairEstimate) {
        let at = seen.captured.frame.at;
        if let View::Images(pair) = &seen.captured.view {
            self.pairs.images(pair);
        }
        if let Some(region) = &seen.region {
            let corners = polygon_px(&outline_px(region.clone(), &seen.estimate));
            let points = corners.iter().map(|[u, v]| Point32 { x: *u as f32, y: *v as f32, z: 0.0 }).collect();
            let header = self.pairs.header(at, CAMERAS[0]);
            self.pairs.push(ours::REGION, at, &PolygonStamped { header, polygon: Polygon { points } });
        }
        self.status(seen, at);
        if let Some(found) = &seen.estimate.cam_left_from_model {
            let covariance = seen.estimate.covariance.map_or([0.0; 36], |c| in_camera_axes(found, &c));
            let pose = PoseWithCovariance { pose: ros_pose(found), covariance };
            let header = self.pairs.header(at, CAMERAS[0]);
            self.pairs.push(ours::POSE, at, &PoseWithCovarianceStamped { header, pose });
            let transforms = vec![self.pairs.transform(at, CAMERAS[0], TARGET, found)];
            self.pairs.push(ours::TF, at, &Transforms { transforms });
        }
        if let Some(truth) = &seen.captured.cam_left_from_target {
            let header = self.pairs.header(at, CAMERAS[0]);
            self.pairs.push(ours::TRUTH, at, &PoseStamped { header, pose: ros_pose(truth) });
        }
        self.report_failure();
    }

    /// Records a control step.
    pub fn moved(&mut self, step: &Moved) {
        let at = step.at;
        let topics = [
            ["/vs_robot/joint_states", "/vs_robot/joint_commands"],
            ["/tc_robot/joint_states", "/tc_robot/joint_commands"],
        ];
        for (side, [measured, commanded]) in topics.into_iter().enumerate() {
            let arm = &step.arms[side];
            let names = self.joint_names[side].clone();
            let count = names.len();
            let velocity =
                if side == 0 { step.vs_joints.velocity_rad_per_s.as_slice()[..count].to_vec() } else { Vec::new() };
            let state = JointState {
                header: self.pairs.header(at, ""),
                name: names.clone(),
                position: arm.position_rad.as_slice()[..count].to_vec(),
                velocity,
                effort: Vec::new(),
            };
            self.pairs.push(measured, at, &state);
            // A hold is a command without velocities.
            let velocity =
                arm.requested_rad_per_s.map(|velocity| velocity.as_slice()[..count].to_vec()).unwrap_or_default();
            let header = self.pairs.header(at, "");
            let command = JointState { header, name: names, position: Vec::new(), velocity, effort: Vec::new() };
            self.pairs.push(commanded, at, &command);
        }
        let base_from_cam_left = self.vs_chain.forward(&step.arms[0].position_rad) * self.flange_from_cam_left;
        let transforms = vec![self.pairs.transform(at, BASE, CAMERAS[0], &base_from_cam_left)];
        self.pairs.push(ours::TF, at, &Transforms { transforms });
        if let Some(transition) = &step.decision.transition {
            let msg = format!("{} -> {} ({}): {}", transition.from, transition.to, transition.event, step.decision.why);
            let (name, file, function) = ("supervisor".to_owned(), String::new(), String::new());
            let line = LogLine { stamp: self.pairs.stamp(at), level: 20, name, msg, file, function, line: 0 };
            self.pairs.push(ours::EVENTS, at, &line);
        }
    }

    /// Finishes the file.
    ///
    /// # Errors
    /// If it could not be written.
    pub fn finish(self) -> Result<()> {
        let written = self.pairs.finish().context("--record")?;
        let all: u64 = written.messages.values().sum();
        tracing::info!("{all} messages recorded: {}", written.file.display());
        if written.dropped > 0 {
            tracing::warn!("--record: {} messages are missing: the disk was too slow", written.dropped);
        }
        Ok(())
    }

    /// A full disk is reported at once, but does not end the run.
    fn report_failure(&mut self) {
        if !self.is_failure_reported && self.pairs.is_over() {
            self.is_failure_reported = true;
            tracing::error!(
                "--record: the recording has ended early, its file cannot be written any more; the run goes on"
            );
        }
    }

    fn status(&mut self, seen: &PairEstimate, at: MonotonicTime) {
        let estimate = &seen.estimate;
        let level = match estimate.status {
            Status::Ok => 0,
            Status::Lost | Status::NotObservable => 2,
            _ => 1,
        };
        let mut values = vec![
            ("status", estimate.status.to_string()),
            ("target", seen.target.to_string()),
            ("latency_ms", format!("{:.3}", seen.latency_millis)),
            ("age_ms", format!("{:.3}", seen.age_millis)),
        ];
        values.extend(estimate.fitness.map(|fitness| ("fitness", fitness.to_string())));
        values.extend(
            estimate.observed.map(|observed| ("observed", observed.map(|is| u8::from(is).to_string()).join(" "))),
        );
        let values = values.into_iter().map(|(key, value)| KeyValue { key: key.to_owned(), value }).collect();
        let message = format!("{}: {}", estimate.status, estimate.reason);
        let status = DiagnosticStatus {
            level: Level(level),
            name: "pb3dp".to_owned(),
            message,
            hardware_id: String::new(),
            values,
        };
        let header = self.pairs.header(at, CAMERAS[0]);
        self.pairs.push(ours::STATUS, at, &Diagnostics { header, status: vec![status] });
    }
}

impl PairRecording {
    /// Creates the file and writes what does not change. Pairs without a calibration are recorded, too, and those with one that ROS 2
    /// cannot express.
    ///
    /// # Errors
    /// If the file exists or cannot be written.
    pub fn new(to: &RecordTo<'_>, rig: Option<&StereoRig>, when_full: WhenFull) -> Result<Self, BagError> {
        let told = |error: &CalibrationFileError| {
            tracing::warn!(
                "the recording has no camera_info: {error}; its topic {} has the calibration",
                ours::CALIBRATION
            );
        };
        let infos = rig.and_then(|rig| ros_camera_infos(rig).inspect_err(told).ok());
        let infos = infos.map(|infos| [0, 1].map(|side| camera_info(CAMERAS[side], &infos[side])));
        let writer = BagWriter::create(to.path, when_full)?;
        let mut recording = Self { writer, since_1970: to.since_1970, infos };
        let zero = MonotonicTime::ZERO;
        recording.push(ours::VERSION, zero, &Text { data: to.version.clone() });
        if let Some(rig) = rig {
            recording.push(ours::CALIBRATION, zero, &Text { data: json_text(rig) });
            let right = rig.cam_right_from_cam_left().inverse();
            let right = recording.transform(zero, CAMERAS[0], CAMERAS[1], &right);
            recording.push("/tf_static", zero, &Transforms { transforms: vec![right] });
        }
        Ok(recording)
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
                let (width, height) = image.dimensions();
                let (encoding, data) = ("rgb8".to_owned(), Bytes(image.as_raw().clone()));
                let image = Image { header, height, width, encoding, is_bigendian: 0, step: 3 * width, data };
                self.push(plain, at, &image);
            } else {
                let image = CompressedImage { header, format: "jpeg".to_owned(), data: Bytes(jpeg.clone()) };
                self.push(compressed, at, &image);
            }
        }
    }

    /// Whether the recording has ended before [`Self::finish`]: its file cannot be written any more.
    pub fn is_over(&self) -> bool {
        self.writer.is_over()
    }

    /// Finishes the file.
    ///
    /// # Errors
    /// If it could not be written.
    pub fn finish(self) -> Result<Written, BagError> {
        self.writer.finish()
    }

    fn push<M: pb3dp_bag::messages::Message>(&mut self, topic: &'static str, at: MonotonicTime, message: &M) {
        self.writer.push(topic, at + self.since_1970, message);
    }

    fn stamp(&self, at: MonotonicTime) -> Time {
        (at + self.since_1970).into()
    }

    fn header(&self, at: MonotonicTime, frame: &str) -> Header {
        Header { stamp: self.stamp(at), frame_id: frame.to_owned() }
    }

    fn transform<A: Frame, B: Frame>(
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

fn ros_pose<A: Frame, B: Frame>(pose: &Pose<A, B>) -> RosPose {
    let (translation, rotation) = (pose.translation_m(), pose.rotation());
    RosPose {
        position: Point { x: translation.x, y: translation.y, z: translation.z },
        orientation: Quaternion { x: rotation.i, y: rotation.j, z: rotation.k, w: rotation.w },
    }
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

/// The covariance of ROS, of x, y, z and turns about these axes of the camera, from that of `xi` in `pose * exp(xi)`, along the axes of the
/// model.
fn in_camera_axes<A: Frame, B: Frame>(pose: &Pose<A, B>, covariance: &Matrix6<f64>) -> [f64; 36] {
    let rotation = pose.rotation_matrix();
    let mut turn = Matrix6::zeros();
    turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    let turned = turn * covariance * turn.transpose();
    // Symmetric: columns are rows.
    let mut rows = [0.0; 36];
    rows.copy_from_slice(turned.as_slice());
    rows
}
