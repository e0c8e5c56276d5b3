//! Records a run as an MCAP file with ROS 2 messages: images as the cameras delivered them, calibration, estimates, joints, commands,
//! changes of state, the settings; and what a replay needs, to the bit.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use nalgebra::Matrix6;
use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{
    DiagnosticStatus, Diagnostics, KeyValue, Level, LogLine, Point32, Polygon, PolygonStamped, PoseStamped,
    PoseWithCovariance, PoseWithCovarianceStamped, Text, Transforms,
};
use pb3dp_bag::run_messages::{RunBegin, SetupFile, SetupFiles};
use pb3dp_bag::sinks::{Finished, Sinks};
use pb3dp_bag::topics::ours;
use pb3dp_cell::annotation::polygon_px;
use pb3dp_cell::estimate_log::{PairEstimate, outline_px};
use pb3dp_cell::journal::TruePoses;
use pb3dp_cell::moving::StepRecord;
use pb3dp_cell::parts::Parts;
use pb3dp_cell::perception::View;
use pb3dp_cell::selection::{Choice, Selections};
use pb3dp_cell::spectator::{RunEnd, Spectator};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::frames::{CamLeft, Flange, Frame};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::Chain;
use pb3dp_record::images::FILE_MAX_BYTES;
use pb3dp_record::regular_file::read_regular;
use pb3dp_setup::setup::Setup;

use crate::estimates::pair_result;
use crate::exact::{of_change, of_end, of_marking};
use crate::pairs::{About, BASES, CAMERAS, JOINTS, PairRecording, joint_names, ros_pose};
use crate::steps::Steps;
use crate::tap::{RunInputs, tap};

/// Frames in transforms and headers.
const TARGET: &str = "target";
/// Topics of the commands of both arms.
const COMMANDS: [&str; 2] = ["/vs_robot/joint_commands", "/tc_robot/joint_commands"];

/// A recording of a run in one file.
struct RunRecording {
    pairs: PairRecording,
    steps: Steps,
    begin: RunBegin,
    /// Time of the last step.
    last_at: MonotonicTime,
    /// Folder for the newest seconds at each fault.
    faults: PathBuf,
    /// Number of the last fault that is kept.
    kept: usize,
    joint_names: [Vec<String>; 2],
    /// The arm that carries the cameras, and their mounting.
    vs_chain: Chain,
    flange_from_cam_left: Pose<Flange, CamLeft>,
    is_failure_reported: bool,
}

/// Who gets the messages of a run, and where files of faults go.
#[derive(Debug, Default)]
pub struct RecordTo {
    /// The recording, the newest seconds and viewers, each if it is wanted.
    pub sinks: Sinks,
    /// Folder for the newest seconds at each fault.
    pub faults: PathBuf,
}

/// Records a run with these parts, from its begin on.
///
/// # Errors
/// If a file that the settings name cannot be read.
pub fn record_run(about: &About, setup: &Setup, parts: Parts, to: RecordTo) -> Result<Parts> {
    let begin = RunBegin {
        begin_nanos: 0,
        since_1970_nanos: u64::try_from(about.since_1970.as_nanos()).unwrap_or(u64::MAX),
        is_person: parts.operator.is_person(),
        can_fall_silent: parts.operator.can_fall_silent(),
        marking: of_marking(&parts.marking),
        target_of_setup: parts
            .selections
            .as_ref()
            .and_then(Selections::target_of_setup)
            .map(of_marking)
            .into_iter()
            .collect(),
    };
    let inputs = RunInputs { vs: parts.vs, tc: parts.tc, operator: parts.operator };
    let (recorder, RunInputs { vs, tc, operator }) = recorder(about, setup, (begin, inputs), to)?;
    let mut spectators = parts.spectators;
    spectators.push(recorder);
    Ok(Parts { vs, tc, operator, spectators, ..parts })
}

/// A recording of a run that begins like this, and its parts for the run.
///
/// # Errors
/// As [`record_run`].
pub(crate) fn recorder(
    about: &About,
    setup: &Setup,
    (begin, inputs): (RunBegin, RunInputs),
    to: RecordTo,
) -> Result<(Box<dyn Spectator>, RunInputs)> {
    let (inputs, events) = tap(inputs);
    let recording = RunRecording::new(about, setup, (begin, Steps::new(events)), to)?;
    Ok((Box::new(recording), inputs))
}

impl RunRecording {
    /// Begins with what does not change.
    fn new(about: &About, setup: &Setup, (begin, steps): (RunBegin, Steps), to: RecordTo) -> Result<Self> {
        let pairs = PairRecording::new(about, Some(&setup.rig.stereo), to.sinks);
        let vs = &setup.rig.arms.vs;
        let mut recording = Self {
            pairs,
            steps,
            begin,
            last_at: MonotonicTime::ZERO,
            faults: to.faults,
            kept: 0,
            joint_names: [joint_names(&vs.chain), joint_names(&setup.rig.arms.tc.chain)],
            vs_chain: vs.chain.clone(),
            flange_from_cam_left: setup.controller.flange_from_hand * setup.controller.hand_from_cam_left,
            is_failure_reported: false,
        };
        recording.pairs.push(ours::SETUP, MonotonicTime::ZERO, &Text { data: about.setup_text.clone() });
        let read = |path: String| -> Result<SetupFile> {
            let data = read_regular(Path::new(&path), FILE_MAX_BYTES)
                .with_context(|| format!("--record: {path} cannot be read"))?;
            Ok(SetupFile { path, data: Bytes(data) })
        };
        let files = setup.layers.input_files().into_iter().map(read).collect::<Result<_>>()?;
        recording.pairs.push(ours::FILES, MonotonicTime::ZERO, &SetupFiles { files });
        Ok(recording)
    }

    /// Records the images of a pair, and those on which the operator drew, if they are older.
    fn images(&mut self, pair_estimate: &PairEstimate) {
        let View::Images(pair) = &pair_estimate.captured.view else { return };
        self.pairs.images(pair);
        if let Some(Choice::Marked(selection)) = &pair_estimate.chosen
            && let Some(drawn_on) = &selection.drawn_on
            && drawn_on.sequence != pair.sequence
        {
            self.pairs.drawn_on(drawn_on);
        }
    }

    /// Records the estimate of a pair for other programs.
    fn estimate(&mut self, pair_estimate: &PairEstimate) {
        let at = pair_estimate.captured.frame.at;
        if let Some(region) = &pair_estimate.region {
            let corners = polygon_px(&outline_px(region.clone(), &pair_estimate.estimate));
            let points = corners.iter().map(|[u, v]| Point32 { x: *u as f32, y: *v as f32, z: 0.0 }).collect();
            let header = self.pairs.header(at, CAMERAS[0]);
            self.pairs.push(ours::REGION, at, &PolygonStamped { header, polygon: Polygon { points } });
        }
        self.status(pair_estimate, at);
        if let Some(found) = &pair_estimate.estimate.cam_left_from_model {
            let covariance = pair_estimate.estimate.pose_covariance.map_or([0.0; 36], |c| in_camera_axes(found, &c));
            let pose = PoseWithCovariance { pose: ros_pose(found), covariance };
            let header = self.pairs.header(at, CAMERAS[0]);
            self.pairs.push(ours::POSE, at, &PoseWithCovarianceStamped { header, pose });
            let transforms = vec![self.pairs.transform(at, CAMERAS[0], TARGET, found)];
            // Written after the newest step, whose transform is on the same topic: some viewers read a topic in the order of its log times.
            self.pairs.push(ours::TF, at.max(self.last_at), &Transforms { transforms });
        }
        if let Some(truth) = &pair_estimate.captured.cam_left_from_target {
            let header = self.pairs.header(at, CAMERAS[0]);
            self.pairs.push(ours::TRUTH, at, &PoseStamped { header, pose: ros_pose(truth) });
        }
    }

    /// Records a control step for other programs.
    fn step(&mut self, step: &StepRecord) {
        let at = step.at;
        for (side, (measured, commanded)) in JOINTS.into_iter().zip(COMMANDS).enumerate() {
            let (arm, names) = (&step.arms[side], &self.joint_names[side]);
            let velocity = (side == 0).then_some(&step.vs_joints.velocity_rad_per_s);
            self.pairs.joint_state(measured, at, names, [Some(&arm.position_rad), velocity]);
            // A hold is a command without velocities.
            self.pairs.joint_state(commanded, at, names, [None, arm.requested_rad_per_s.as_ref()]);
        }
        let base_from_cam_left = self.vs_chain.forward(&step.arms[0].position_rad) * self.flange_from_cam_left;
        let transforms = vec![self.pairs.transform(at, BASES[0], CAMERAS[0], &base_from_cam_left)];
        self.pairs.push(ours::TF, at, &Transforms { transforms });
        if let Some(transition) = &step.decision.transition {
            let (from, to, event) = (transition.from.name(), transition.to.name(), transition.event.name());
            let msg = of_change(from, to, event, &step.decision.why.to_string());
            let (name, file, function) = ("supervisor".to_owned(), String::new(), String::new());
            let line = LogLine { stamp: self.pairs.stamp(at), level: 20, name, msg, file, function, line: 0 };
            self.pairs.push(ours::EVENTS, at, &line);
        }
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

    fn status(&mut self, pair_estimate: &PairEstimate, at: MonotonicTime) {
        let estimate = &pair_estimate.estimate;
        let level = match estimate.status {
            Status::Ok => 0,
            Status::Miscalibrated | Status::Lost | Status::NotObservable => 2,
            _ => 1,
        };
        let mut values = vec![
            ("status", estimate.status.to_string()),
            ("target", pair_estimate.target.to_string()),
            ("latency_ms", format!("{:.3}", pair_estimate.latency_millis)),
            ("age_ms", format!("{:.3}", pair_estimate.age_millis)),
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

impl Spectator for RunRecording {
    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin.begin_nanos = begin.as_nanos();
        // Before all others also for programs that sort by the time of writing.
        self.pairs.push(ours::BEGIN, MonotonicTime::ZERO, &self.begin);
    }

    fn estimated(&mut self, pair_estimate: &PairEstimate) {
        self.images(pair_estimate);
        self.estimate(pair_estimate);
        self.pairs.push(ours::PAIRS, pair_estimate.captured.frame.at, &pair_result(pair_estimate));
        self.report_failure();
    }

    fn moved(&mut self, step: &StepRecord, poses: Option<TruePoses>) {
        self.last_at = step.at;
        self.step(step);
        if let Some(message) = self.steps.finished(step, poses.as_ref()) {
            self.pairs.push(ours::STEPS, step.at, &message);
        }
    }

    fn finish(mut self: Box<Self>, end: &RunEnd) -> Result<()> {
        if let Some(step) = self.steps.unfinished() {
            self.last_at = MonotonicTime::from_nanos(step.at_nanos);
            self.pairs.push(ours::STEPS, self.last_at, &step);
        }
        self.pairs.push(ours::END, self.last_at, &of_end(end));
        if end.failure.is_some() {
            self.fault(self.kept + 1);
        }
        let Finished { written, kept, recent_dropped, live_dropped } = self.pairs.finish();
        for kept in kept {
            match kept {
                Ok(kept) => tracing::info!("the newest seconds at a fault: {}", kept.file.display()),
                Err(error) => tracing::warn!("the newest seconds at a fault: {error}"),
            }
        }
        tracing::debug!(
            "{recent_dropped} messages are missing in the newest seconds, {live_dropped} reached no viewer"
        );
        let Some(written) = written else { return Ok(()) };
        let written = written.context("--record")?;
        let all: u64 = written.messages.values().sum();
        let files: Vec<String> = written.files.iter().map(|file| file.display().to_string()).collect();
        tracing::info!("{all} messages recorded: {}", files.join(", "));
        if written.dropped > 0 {
            tracing::warn!("--record: {} messages are missing: the disk was too slow", written.dropped);
        }
        Ok(())
    }

    fn fault(&mut self, number: usize) {
        // The record of a fault can be due twice.
        if number <= self.kept {
            return;
        }
        self.kept = number;
        // A run that was killed leaves files in a folder that no later run moves away.
        let name = |number| if number == 1 { "fault.mcap".to_owned() } else { format!("fault-{number}.mcap") };
        let free = (1..).map(|number| self.faults.join(name(number))).find(|file| !file.exists());
        let kept = free.map_or(Ok(()), |file| self.pairs.sinks.keep(&file));
        if let Err(error) = kept {
            tracing::warn!("the newest seconds at a fault: {error}");
        }
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
