//! `pb3dp track`: a region through a recorded stereo sequence.

use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result};
use nalgebra::Vector2;
use pb3dp_estimation::estimator::{FramePrior, Method, Tracker};
use pb3dp_estimation::plane_hypothesis::SearchRange;
use pb3dp_estimation::published::TrackEstimate;
use pb3dp_estimation::region::Region;
use pb3dp_estimation::status::Status;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_hal_api::{CameraErrorKind, FramePair};
use pb3dp_record::dataset::{Sequence, load_sequence};
use pb3dp_record::images::{PictureFormat, save};
use pb3dp_record::metrics::{MotionSummary, compare_motion};
use pb3dp_record::overlay::{Animation, AnimationLimits};
use serde::Serialize;

use super::estimate::estimator_config;
use super::estimate::job::{overridden, range_of_dataset};
use super::estimate::output::print_line;
use super::pair::check_pictures;
use crate::cli::{MethodArgs, TrackArgs};
use crate::cpu_time::timed;
use crate::picture::{Annotation, annotate, polygon_px};
use crate::wiring::wire_replay;

/// Runs the command. The exit code is a failure if a frame could not be read; all others are worked on all the same.
///
/// # Errors
/// Bad arguments or configuration, a sequence that can not be used at all, exchanged pictures, or a region that is refused.
pub fn run(args: &TrackArgs) -> Result<ExitCode> {
    let method = Method::from_name(&args.method.method)?;
    let sequence = load_sequence(&args.sequence)?;
    if !sequence.other_keys.is_empty() {
        tracing::warn!("sequence.json has keys that are not known and not used: {}", sequence.other_keys.join(", "));
    }
    let (mut camera, calibration) = wire_replay(&sequence, args.pace)?;
    for note in &calibration.notes {
        tracing::info!("{note}");
    }
    let rig = calibration.rig;
    let mut walk = Walk::new(Tracker::new(method, &rig, &estimator_config(&args.method)?)?, &sequence, &args.method);
    let mut overlays = Overlays::open(&args.method)?;
    if !args.method.json {
        print_line(TrackLine::HEADING)?;
    }
    let mut pair = FramePair::black(rig.left().size());
    let mut poses = Vec::new();
    for (frame, &t_s) in sequence.times_s.iter().enumerate() {
        let line = match camera.next_pair_into(&mut pair, PAIR_TIMEOUT) {
            Ok(()) => {
                let (estimate, millis) = walk.step(frame, &rig, &pair)?;
                if let Err(error) = overlays.add(frame, t_s, &pair, &rig, &estimate) {
                    tracing::warn!("frame {frame}: no picture: {error:#}");
                }
                poses.push(estimate.cam_left_from_model);
                TrackLine::of(frame, t_s, &estimate, millis)
            }
            Err(error) if error.kind() == CameraErrorKind::BadPair => {
                walk.unread += 1;
                tracing::error!("frame {frame}: {:#}", anyhow::Error::from(error));
                poses.push(None);
                TrackLine::of_error(frame, t_s)
            }
            Err(error) => return Err(error.into()),
        };
        print_line(&if args.method.json { serde_json::to_string(&line)? } else { line.human() })?;
    }
    overlays.close()?;
    walk.report(&sequence, &poses);
    Ok(if walk.unread == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// A replay does not wait for pictures, so this only bounds what can not happen.
const PAIR_TIMEOUT: Duration = Duration::from_secs(10);

/// The tracker on its way through the frames.
struct Walk {
    tracker: Tracker,
    region: Region,
    range: SearchRange,
    /// The first frame that could be read.
    first: Option<usize>,
    last_status: Status,
    rotation_about_normal_observed: bool,
    /// Frames that could not be read.
    unread: usize,
}

impl Walk {
    fn new(tracker: Tracker, sequence: &Sequence, args: &MethodArgs) -> Self {
        let vertices_px = sequence.region_polygon_left_px.iter().map(|&[u, v]| Vector2::new(u, v)).collect();
        Self {
            tracker,
            region: Region::Polygon { vertices_px },
            range: overridden(range_of_dataset(&sequence.search), args),
            first: None,
            last_status: Status::Ok,
            rotation_about_normal_observed: true,
            unread: 0,
        }
    }

    /// The estimate for a frame with the CPU time that it took, milliseconds.
    fn step(&mut self, frame: usize, rig: &StereoRig, pair: &FramePair) -> Result<(TrackEstimate, f64)> {
        let context = || format!("frame {frame}");
        let is_first = self.first.is_none();
        if is_first {
            check_pictures(&context(), rig, &pair.left, &pair.right).with_context(context)?;
            if frame > 0 {
                tracing::warn!("the region belongs to frame 0, which can not be read; it is used in frame {frame}");
            }
            self.first = Some(frame);
        }
        let (estimate, millis) = timed(|| match is_first {
            true => self.tracker.start(&pair.left, &pair.right, &self.region, &self.range),
            false => self.tracker.update(&pair.left, &pair.right, &FramePrior::default()),
        });
        let estimate = estimate.with_context(context)?;
        self.tell(frame, &estimate);
        Ok((estimate, millis))
    }

    /// Warnings, and the reason whenever the status changes.
    fn tell(&mut self, frame: usize, estimate: &TrackEstimate) {
        for warning in &estimate.warnings {
            tracing::warn!("frame {frame}: {warning}");
        }
        if estimate.status != self.last_status {
            match estimate.status {
                Status::Ok => tracing::info!("frame {frame}: ok: {}", estimate.reason),
                status => tracing::warn!("frame {frame}: {status}: {}", estimate.reason),
            }
        }
        self.last_status = estimate.status;
        self.rotation_about_normal_observed &= estimate.rotation_about_normal_observed;
    }

    /// The table of motion errors and what the method does not observe, on standard error.
    fn report(&self, sequence: &Sequence, poses: &[Option<Pose<CamLeft, Model>>]) {
        let mut text = String::new();
        if let Some(truth) = &sequence.cam_left_from_model {
            text += "\nErrors of the motion since the first frame with a pose:\n";
            text += &match MotionSummary::of(&compare_motion(poses, truth)) {
                Some(summary) => summary.text_table(),
                None => "no frame has a pose: nothing to compare with the truth\n".to_owned(),
            };
        }
        if !self.rotation_about_normal_observed {
            text += "The rotation about the model's normal is not observed by this method: it is held at its first value.\n";
        }
        // Nobody can be told if standard error is closed.
        let _ = std::io::Write::write_all(&mut std::io::stderr().lock(), text.as_bytes());
    }
}

/// The result of one frame, in the units of the interface; the order of the fields is that of the JSON line.
#[derive(Clone, Debug, Serialize)]
pub struct TrackLine {
    /// Counts from 0.
    pub frame: usize,
    /// Mid-exposure, seconds.
    pub t_s: f64,
    /// `ok`, `weak-tilt`, `ambiguous`, `not-observable`, `lost` or `error`.
    pub status: &'static str,
    /// Row-major homogeneous matrix, millimetres.
    pub cam_left_from_model: Option<[f64; 16]>,
    /// Covariance of the pose, row-major, order translation (mm) then rotation (radians).
    pub covariance: Option<Vec<f64>>,
    /// Fitness, eq. (10).
    pub fitness: Option<f64>,
    /// CPU time of one thread from images in memory to pose, milliseconds.
    pub ms: Option<f64>,
}

impl TrackLine {
    const HEADING: &'static str =
        "frame      t s  status           x mm      y mm      z mm  rotation vector deg         fitness       ms";

    fn of_error(frame: usize, t_s: f64) -> Self {
        Self { frame, t_s, status: "error", cam_left_from_model: None, covariance: None, fitness: None, ms: None }
    }

    fn of(frame: usize, t_s: f64, estimate: &TrackEstimate, ms: f64) -> Self {
        Self {
            status: estimate.status.as_str(),
            cam_left_from_model: estimate.cam_left_from_model.as_ref().map(row_major_mm),
            covariance: estimate.covariance.map(|m| {
                let unit = |i: usize| if i < 3 { 1e3 } else { 1.0 };
                (0..36).map(|k| m[(k / 6, k % 6)] * unit(k / 6) * unit(k % 6)).collect()
            }),
            fitness: estimate.fitness,
            ms: Some(ms),
            ..Self::of_error(frame, t_s)
        }
    }

    fn human(&self) -> String {
        let number = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |x| format!("{x:.decimals$}"));
        let at = |k: usize| number(self.cam_left_from_model.map(|m| m[k]), 2);
        let turn = self.cam_left_from_model.map_or("-".into(), |m| {
            let rotation = nalgebra::Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
            let v = nalgebra::Rotation3::from_matrix_unchecked(rotation).scaled_axis().map(f64::to_degrees);
            format!("{:+.2} {:+.2} {:+.2}", v.x, v.y, v.z)
        });
        format!(
            "{:>5} {:>8.3}  {:<14} {:>9} {:>9} {:>9}  {:<25} {:>8} {:>8}",
            self.frame,
            self.t_s,
            self.status,
            at(3),
            at(7),
            at(11),
            turn,
            number(self.fitness, 3),
            number(self.ms, 2)
        )
    }
}

/// The homogeneous matrix of a pose, row by row, translation in millimetres.
pub fn row_major_mm(pose: &Pose<CamLeft, Model>) -> [f64; 16] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|k| m[(k / 4, k % 4)] * if k % 4 == 3 && k < 12 { 1e3 } else { 1.0 })
}

/// Pictures per frame and one animated picture of all.
struct Overlays {
    target: Option<(std::path::PathBuf, Animation)>,
}

impl Overlays {
    fn open(args: &MethodArgs) -> Result<Self> {
        let Some(folder) = &args.overlay else { return Ok(Self { target: None }) };
        std::fs::create_dir_all(folder).with_context(|| format!("{}: can not be created", folder.display()))?;
        Ok(Self { target: Some((folder.clone(), Animation::new(AnimationLimits::default()))) })
    }

    fn add(
        &mut self,
        frame: usize,
        t_s: f64,
        pair: &FramePair,
        rig: &StereoRig,
        estimate: &TrackEstimate,
    ) -> Result<()> {
        let Some((folder, animation)) = &mut self.target else { return Ok(()) };
        let outline_px = polygon_px(&estimate.outline_px);
        let fitness = estimate.fitness.map_or(String::new(), |fitness| format!("  fitness {fitness:.3}"));
        let annotation = Annotation {
            outline_px: &outline_px,
            cam_left_from_model: estimate.cam_left_from_model,
            label: format!("frame {frame}  {t_s:.3} s  {}{fitness}", estimate.status),
            is_bad: estimate.cam_left_from_model.is_none(),
        };
        let picture = annotate(&pair.left, &pair.right, rig, &annotation);
        save(&picture, &folder.join(format!("frame_{frame:04}.png")), PictureFormat::Png)?;
        animation.push(t_s, &picture);
        Ok(())
    }

    fn close(self) -> Result<()> {
        let Some((folder, animation)) = self.target else { return Ok(()) };
        if animation.frames() > 0 {
            animation.write(&folder.join("sequence.png"))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn matrices_are_row_major_in_millimetres() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let m = row_major_mm(&Pose::from_parts(Vector3::new(0.1, -0.2, 0.5), turn));
        let expected = [0.0, -1.0, 0.0, 100.0, 1.0, 0.0, 0.0, -200.0, 0.0, 0.0, 1.0, 500.0, 0.0, 0.0, 0.0, 1.0];
        assert!(m.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{m:?}");
    }
}
