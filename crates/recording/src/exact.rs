//! Values of a run as messages and back, to the last bit.

use std::io::Cursor;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use image::{DynamicImage, GrayImage, ImageFormat};
use nalgebra::{Matrix6, Point3, Vector2};
use pb3dp_bag::cdr::{Bytes, Later};
use pb3dp_bag::messages::LogLine;
use pb3dp_bag::run_messages::{self, ControlStep, Marked, Observed, OperatorEntry};
use pb3dp_bag::stops::{of_pose, pose};
use pb3dp_cell::commands::CommandSummary;
use pb3dp_cell::operator::MotionRequest;
use pb3dp_cell::percept::Percept;
use pb3dp_cell::perception::TargetSource;
use pb3dp_cell::spectator::RunEnd;
use pb3dp_cell::supervision::TransitionNote;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::frames::Frame;
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{ArmErrorKind, ArmState};
use pb3dp_kinematics::{DOF, JointVector};
use pb3dp_record::images::StoredImage;
use pb3dp_servo::TargetObservation;
use pb3dp_servo::supervisor::{
    Confidence, EstimateInput, Event, FrameInput, OperatorCommand, OperatorInput, OperatorRequest, State,
};

/// Names of the arms in messages.
pub const ARM_NAMES: [&str; 2] = ["vs-robot", "tc-robot"];

/// A time that can be subtracted. Clocks of runs are below 2^62 nanoseconds, 146 years.
pub fn signed(nanos: u64) -> i64 {
    i64::try_from(nanos).unwrap_or(i64::MAX).min(i64::MAX / 2)
}

/// Whether all numbers are the same to the bit.
pub fn same_bits(one: &[f64], other: &[f64]) -> bool {
    one.len() == other.len() && one.iter().zip(other).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// The same; empty for none.
pub fn of_pose_if_any<A: Frame, B: Frame>(pose: Option<&Pose<A, B>>) -> Vec<f64> {
    pose.map_or(Vec::new(), |pose| of_pose(pose).to_vec())
}

/// The pose; none if the message has none.
///
/// # Errors
/// If there are not seven numbers, or they are no pose.
pub fn pose_if_any<A: Frame, B: Frame>(what: &str, numbers: &[f64]) -> Result<Option<Pose<A, B>>> {
    if numbers.is_empty() {
        return Ok(None);
    }
    let numbers: [f64; 7] =
        numbers.try_into().map_err(|_| anyhow::anyhow!("{what}: {} numbers, a pose has 7", numbers.len()))?;
    match pose(numbers) {
        Some(pose) => Ok(Some(pose)),
        None => bail!("{what}: {numbers:?} is no pose: the recording is damaged"),
    }
}

/// The columns of a matrix; empty for none.
pub fn of_covariance(covariance: Option<&Matrix6<f64>>) -> Vec<f64> {
    covariance.map_or(Vec::new(), |covariance| covariance.as_slice().to_vec())
}

/// The matrix; none if the message has none.
///
/// # Errors
/// If there are not 36 numbers.
pub fn covariance(what: &str, numbers: &[f64]) -> Result<Option<Matrix6<f64>>> {
    match numbers.len() {
        0 => Ok(None),
        36 => Ok(Some(Matrix6::from_column_slice(numbers))),
        count => bail!("{what}: {count} numbers, a covariance has 36"),
    }
}

/// Seven joints.
///
/// # Errors
/// If there are not seven numbers.
pub fn joints(what: &str, numbers: &[f64]) -> Result<JointVector> {
    if numbers.len() != DOF {
        bail!("{what}: {} numbers for {DOF} joints", numbers.len());
    }
    Ok(JointVector::from_column_slice(numbers))
}

/// Notes what a step observed.
pub fn note_percept(step: &mut ControlStep, percept: &Percept) {
    let observation = percept.observation.as_ref();
    step.observed = vec![of_percept(percept)];
    step.observed_directions =
        Later(observation.map_or_else(Vec::new, |observed_target| observed_target.observed.to_vec()));
    step.surface_from_model = Later(of_pose_if_any(percept.surface_from_model.as_ref()));
}

fn of_percept(percept: &Percept) -> Observed {
    let Percept { frame, estimate, observation, .. } = percept;
    let observed_target = observation.as_ref();
    Observed {
        sequence: frame.sequence,
        exposed_at_nanos: frame.at.as_nanos(),
        skew_s: frame.skew_s,
        target: estimate.target,
        confidence: match estimate.confidence {
            Confidence::Sure => "sure",
            Confidence::Doubtful => "doubtful",
            Confidence::NoPose => "no pose",
            Confidence::Miscalibrated => "miscalibrated",
        }
        .to_owned(),
        stated_covariance: of_covariance(estimate.covariance.as_ref()),
        cam_left_from_model: of_pose_if_any(
            observed_target.map(|observed_target| &observed_target.cam_left_from_model),
        ),
        trusted: observed_target.is_some_and(|observed_target| observed_target.trusted),
        covariance: of_covariance(observed_target.and_then(|observed_target| observed_target.covariance.as_ref())),
        rotation_about_normal_observed: observed_target.is_some_and(|observed_target| observed_target.observed[5]),
    }
}

/// The same back; none if the step observed nothing.
///
/// # Errors
/// Names the damaged field.
pub fn percept(step: &ControlStep) -> Result<Option<Percept>> {
    let Some(observed_target) = step.observed.first() else { return Ok(None) };
    let at = MonotonicTime::from_nanos(observed_target.exposed_at_nanos);
    let confidence = match observed_target.confidence.as_str() {
        "sure" => Confidence::Sure,
        "doubtful" => Confidence::Doubtful,
        "no pose" => Confidence::NoPose,
        "miscalibrated" => Confidence::Miscalibrated,
        other => bail!("observed.confidence: {other:?} is no confidence"),
    };
    let observation = pose_if_any("observed.cam_left_from_model", &observed_target.cam_left_from_model)?
        .map(|cam_left_from_model| -> Result<_> {
            Ok(TargetObservation {
                at,
                cam_left_from_model,
                trusted: observed_target.trusted,
                covariance: covariance("observed.covariance", &observed_target.covariance)?,
                observed: match &step.observed_directions.0[..] {
                    // Versions before wrote the last one only.
                    [] => [true, true, true, true, true, observed_target.rotation_about_normal_observed],
                    six => six.try_into().context("observed_directions: a pose has six directions")?,
                },
            })
        })
        .transpose()?;
    let stated = covariance("observed.stated_covariance", &observed_target.stated_covariance)?;
    Ok(Some(Percept {
        frame: FrameInput { sequence: observed_target.sequence, at, skew_s: observed_target.skew_s },
        estimate: EstimateInput { at, confidence, covariance: stated, target: observed_target.target },
        observation,
        surface_from_model: pose_if_any("surface_from_model", &step.surface_from_model.0)?,
    }))
}

/// What the operator has said, and the last sign of life.
pub fn operator_input(
    said: &[OperatorEntry],
    heard_at_nanos: &[u64],
    silent_after_nanos: &[u64],
) -> Result<OperatorInput> {
    let request = |said: &OperatorEntry| -> Result<_> {
        let word = OperatorCommand::ALL.into_iter().find(|word| word.name() == said.word);
        let word = word.with_context(|| format!("said: {:?} is no command of an operator", said.word))?;
        Ok(OperatorRequest { command: word, at: MonotonicTime::from_nanos(said.at_nanos) })
    };
    Ok(OperatorInput {
        request: said.first().map(request).transpose()?,
        heartbeat_at: heard_at_nanos.first().map(|nanos| MonotonicTime::from_nanos(*nanos)),
        silent_after: silent_after_nanos.first().map(|nanos| Duration::from_nanos(*nanos)),
    })
}

/// How the operator wants the hand to move; without an offset if the message has none.
pub fn motion(speed_share: f64, hand_from_hand_shifted: [f64; 7]) -> MotionRequest {
    MotionRequest { speed_share, hand_from_hand_shifted: pose(hand_from_hand_shifted).unwrap_or_else(Pose::coincident) }
}

/// The state of an arm in words.
pub fn of_state(state: ArmState) -> &'static str {
    match state {
        ArmState::Disabled => "disabled",
        ArmState::Enabled => "enabled",
        ArmState::Fault => "fault",
        ArmState::EStop => "emergency stop",
    }
}

/// The kind of a failure in words.
pub fn of_failure(kind: ArmErrorKind) -> &'static str {
    match kind {
        ArmErrorKind::Rejected => "rejected",
        ArmErrorKind::NotEnabled => "not enabled",
        ArmErrorKind::Timeout => "timeout",
        ArmErrorKind::Disconnected => "disconnected",
        // A kind that is added later stops the arm as well.
        _ => "fault",
    }
}

/// The same back.
pub fn failure(word: &str) -> Option<ArmErrorKind> {
    Some(match word {
        "rejected" => ArmErrorKind::Rejected,
        "not enabled" => ArmErrorKind::NotEnabled,
        "timeout" => ArmErrorKind::Timeout,
        "disconnected" => ArmErrorKind::Disconnected,
        "fault" => ArmErrorKind::Fault,
        _ => return None,
    })
}

/// A change of state as a line on `/pb3dp/events`.
pub fn of_change(from: &str, to: &str, event: &str, why: &str) -> String {
    format!("{from} -> {to} ({event}): {why}")
}

/// The change of state that a line tells, at this time since the begin of the run; none if it is not of this program.
pub fn change(line: &LogLine, t_s: f64) -> Option<TransitionNote> {
    let (from, rest) = line.msg.split_once(" -> ")?;
    let (to, rest) = rest.split_once(" (")?;
    let (event, why) = rest.split_once("): ")?;
    let state = |name: &str| State::ALL.into_iter().map(State::name).find(|known| *known == name);
    Some(TransitionNote {
        t_s,
        from: state(from)?,
        to: state(to)?,
        event: Event::ALL.into_iter().map(Event::name).find(|known| *known == event)?,
        why: why.to_owned(),
    })
}

/// A region.
pub fn of_region(region: &Region) -> Marked {
    let marked = |kind: &str, numbers: Vec<f64>| Marked { kind: kind.to_owned(), numbers, mask: Bytes::default() };
    match region {
        Region::Rectangle { x, y, width, height } => {
            marked("rectangle", vec![f64::from(*x), f64::from(*y), f64::from(*width), f64::from(*height)])
        }
        Region::Polygon { vertices_px } => {
            marked("polygon", vertices_px.iter().flat_map(|vertex| [vertex.x, vertex.y]).collect())
        }
        Region::Click { x, y } => marked("click", vec![f64::from(*x), f64::from(*y)]),
        Region::Mask(mask) => {
            let mut png = Cursor::new(Vec::new());
            // Into memory, a grey image can always be written.
            let written = mask.write_to(&mut png, ImageFormat::Png);
            let mask = Bytes(written.map_or(Vec::new(), |()| png.into_inner()));
            Marked { mask, ..marked("mask", Vec::new()) }
        }
    }
}

/// The region.
///
/// # Errors
/// Names what is damaged.
pub fn region(marked: &Marked) -> Result<Region> {
    let whole = |index: usize| marked.numbers.get(index).copied().unwrap_or(0.0);
    Ok(match marked.kind.as_str() {
        "rectangle" => Region::Rectangle {
            x: whole(0) as i32,
            y: whole(1) as i32,
            width: whole(2) as u32,
            height: whole(3) as u32,
        },
        "polygon" => {
            let corner = |pair: &[f64]| Vector2::new(pair[0], pair[1]);
            Region::Polygon { vertices_px: marked.numbers.chunks_exact(2).map(corner).collect() }
        }
        "click" => Region::Click { x: whole(0) as i32, y: whole(1) as i32 },
        "mask" => Region::Mask(mask(&marked.mask.0)?),
        other => bail!("region: {other:?} is no kind of region"),
    })
}

fn mask(png: &[u8]) -> Result<GrayImage> {
    match StoredImage::parse(Path::new("mask"), png).context("region: the mask cannot be used")? {
        StoredImage::Rgb(mask) => Ok(DynamicImage::from(mask).into_luma8()),
        StoredImage::Deep(_) => bail!("region: the mask has more than 8 bits per channel"),
    }
}

/// How a target is marked.
pub fn of_marking(marking: &TargetSource) -> Marked {
    let kind = |kind: &str| Marked { kind: kind.to_owned(), ..Marked::default() };
    match marking {
        TargetSource::Region(region) => of_region(region),
        TargetSource::Outline(points_m) => {
            let numbers = points_m.iter().flat_map(|point| [point.x, point.y, point.z]).collect();
            Marked { numbers, ..kind("outline") }
        }
        TargetSource::FromOperator => kind("awaited"),
        TargetSource::None => kind("nobody"),
    }
}

/// The same back.
///
/// # Errors
/// As [`region`].
pub fn marking(marked: &Marked) -> Result<TargetSource> {
    Ok(match marked.kind.as_str() {
        "awaited" => TargetSource::FromOperator,
        "nobody" => TargetSource::None,
        "outline" => TargetSource::Outline(
            marked.numbers.chunks_exact(3).map(|xyz| Point3::new(xyz[0], xyz[1], xyz[2])).collect(),
        ),
        _ => TargetSource::Region(region(marked)?),
    })
}

/// The end of a run.
pub fn of_end(end: &RunEnd) -> run_messages::RunEnd {
    let counts = |arm: &CommandSummary| [arm.velocities, arm.changed, arm.refused];
    run_messages::RunEnd {
        pairs_lost: end.pairs_lost,
        commands: end.commands.iter().flat_map(counts).collect(),
        failure: end.failure.clone().unwrap_or_default(),
    }
}

/// The same back.
pub fn end(message: &run_messages::RunEnd) -> RunEnd {
    let arms = message.commands.as_chunks::<3>().0.iter().zip(ARM_NAMES);
    let summary = |([velocities, changed, refused], name): (&[u64; 3], _)| CommandSummary {
        name,
        velocities: *velocities,
        changed: *changed,
        refused: *refused,
    };
    RunEnd {
        pairs_lost: message.pairs_lost,
        commands: arms.map(summary).collect(),
        failure: (!message.failure.is_empty()).then(|| message.failure.clone()),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use pb3dp_bag::cdr::{from_bytes, to_bytes};
    use pb3dp_geometry::frames::{CamLeft, Model};

    use super::*;

    /// A pose whose quaternion is not exactly of length one, as after many products.
    fn awkward() -> Pose<CamLeft, Model> {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.7));
        let turn = UnitQuaternion::new_unchecked(turn.into_inner() * (1.0 + 3e-16));
        Pose::from_parts(Vector3::new(0.1, -0.0, 0.5), turn)
    }

    fn observed_target() -> Percept {
        let at = MonotonicTime::from_nanos(1_234_567_891);
        let covariance = Matrix6::from_fn(|i, j| 1e-7 / (1.0 + i as f64 + 3.0 * j as f64));
        Percept {
            frame: FrameInput { sequence: 7, at, skew_s: -1e-5 },
            estimate: EstimateInput { at, confidence: Confidence::Doubtful, covariance: Some(covariance), target: 3 },
            observation: Some(TargetObservation {
                at,
                cam_left_from_model: awkward(),
                trusted: true,
                covariance: Some(covariance.transpose()),
                observed: [true, false, true, true, false, true],
            }),
            surface_from_model: Some(awkward().relabel()),
        }
    }

    fn bits(numbers: &[f64]) -> Vec<u64> {
        numbers.iter().map(|number| number.to_bits()).collect()
    }

    #[test]
    fn a_pose_returns_to_the_last_bit() {
        let numbers = of_pose(&awkward());
        let back = pose_if_any::<CamLeft, Model>("pose", &numbers).unwrap().unwrap();
        assert_eq!(bits(&of_pose(&back)), bits(&numbers));
        assert!(numbers[1].is_sign_negative(), "a zero keeps its sign");
    }

    #[test]
    fn a_result_of_a_pair_returns_to_the_last_bit() {
        let observed_target = observed_target();
        let noted = |observed_target: &Percept| {
            let mut step = ControlStep::default();
            note_percept(&mut step, observed_target);
            step
        };
        let bytes = to_bytes(&noted(&observed_target));
        let step: ControlStep = from_bytes(&bytes).unwrap();
        let back = percept(&step).unwrap().unwrap();
        assert_eq!(back.frame, observed_target.frame);
        assert_eq!(back.estimate, observed_target.estimate);
        assert_eq!(back.observation, observed_target.observation);
        assert_eq!(back.surface_from_model, observed_target.surface_from_model);
        let blind = Percept { observation: None, ..observed_target };
        assert!(percept(&noted(&blind)).unwrap().unwrap().observation.is_none());
        assert!(percept(&ControlStep::default()).unwrap().is_none());
    }

    /// A field that was added in the middle of a step once made every older recording unreadable.
    #[test]
    fn a_step_of_a_version_before_is_read() {
        let mut observed_target = Percept { surface_from_model: None, ..observed_target() };
        observed_target.observation.as_mut().unwrap().observed = [true, true, true, true, true, false];
        let mut step = ControlStep { world_from_target: vec![0.5; 7], ..ControlStep::default() };
        note_percept(&mut step, &observed_target);
        step.observed_directions = Later(Vec::new());
        let bytes = to_bytes(&step);
        // Both lists at the end are empty: four bytes each.
        let before: ControlStep = from_bytes(&bytes[..bytes.len() - 8]).unwrap();
        assert_eq!(before.world_from_target, step.world_from_target);
        let back = percept(&before).unwrap().unwrap();
        assert_eq!((back.observation, back.surface_from_model), (observed_target.observation, None));
    }

    #[test]
    fn regions_of_all_kinds_return() {
        let mut mask = GrayImage::new(4, 3);
        mask.put_pixel(2, 1, image::Luma([255]));
        let corner = |u, v| Vector2::new(u, v);
        let all = [
            Region::Rectangle { x: -3, y: 4, width: 50, height: 60 },
            Region::Polygon { vertices_px: vec![corner(1.5, 2.25), corner(30.0, 4.0), corner(0.1, 20.0)] },
            Region::Mask(mask),
            Region::Click { x: 12, y: -1 },
        ];
        for marked in all {
            assert_eq!(region(&of_region(&marked)).unwrap(), marked);
        }
        // Of an image that would have 400 million pixels, only the header.
        let png = [
            b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0N \0\0N \x08\0\0\0\0\xC6\x1B\x19\xE5".as_slice(),
            b"\0\0\0\0IDAT5\xAF\x06\x1E",
        ]
        .concat();
        let large = Marked { kind: "mask".to_owned(), numbers: Vec::new(), mask: Bytes(png) };
        let error = format!("{:#}", region(&large).unwrap_err());
        assert!(error.contains("mask") && error.contains("too large: 20000x20000 pixels"), "{error}");
        let unknown = Marked { kind: "circle".to_owned(), ..Marked::default() };
        assert!(region(&unknown).unwrap_err().to_string().contains("circle"));
    }

    #[test]
    fn damaged_numbers_are_refused_with_their_name() {
        let short = pose_if_any::<CamLeft, Model>("pose of x", &[1.0, 2.0]).unwrap_err().to_string();
        assert_eq!(short, "pose of x: 2 numbers, a pose has 7");
        let long = pose_if_any::<CamLeft, Model>("pose of x", &[0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0]);
        assert!(long.unwrap_err().to_string().contains("is no pose"));
        assert!(covariance("c", &[1.0; 35]).unwrap_err().to_string().contains("35 numbers"));
        assert!(joints("j", &[0.0; 6]).unwrap_err().to_string().contains("6 numbers for 7 joints"));
    }

    #[test]
    fn commands_of_the_operator_return_and_unknown_ones_are_refused() {
        let said = |word: &str| [OperatorEntry { word: word.to_owned(), at_nanos: 5 }];
        for word in OperatorCommand::ALL {
            let inputs = operator_input(&said(word.name()), &[9], &[]).unwrap();
            let request = inputs.request.unwrap();
            assert_eq!((request.command, request.at.as_nanos()), (word, 5));
            assert_eq!((inputs.heartbeat_at.map(MonotonicTime::as_nanos), inputs.silent_after), (Some(9), None));
        }
        assert!(operator_input(&said("go"), &[], &[]).unwrap_err().to_string().contains("\"go\""));
    }

    #[test]
    fn the_end_of_a_run_returns() {
        let arm = |name, velocities| CommandSummary { name, velocities, changed: 2, refused: 1 };
        let ended = RunEnd {
            pairs_lost: 4,
            commands: vec![arm(ARM_NAMES[0], 100), arm(ARM_NAMES[1], 90)],
            failure: Some("a wire broke".to_owned()),
        };
        assert_eq!(end(&of_end(&ended)), ended);
        assert_eq!(end(&of_end(&RunEnd::default())), RunEnd::default());
    }

    #[test]
    fn a_change_of_state_is_read_back() {
        let line = |msg: String| LogLine {
            stamp: pb3dp_bag::messages::Time { sec: 0, nanosec: 0 },
            level: 20,
            name: String::new(),
            msg,
            file: String::new(),
            function: String::new(),
            line: 0,
        };
        let why = "stopped: (so) it is): late; use reset";
        for (from, to, event) in [("tracking", "stopped", "stop-found"), ("idle", "selecting", "select")] {
            let read = change(&line(of_change(from, to, event, why)), 2.5).unwrap();
            assert_eq!((read.t_s, read.from, read.to, read.event, &*read.why), (2.5, from, to, event, why));
        }
        for (from, to, event) in [("tracking", "asleep", "stop-found"), ("tracking", "stopped", "nap")] {
            assert_eq!(change(&line(of_change(from, to, event, why)), 2.5), None);
        }
        assert_eq!(change(&line("tracking -> stopped".to_owned()), 2.5), None);
    }
}
