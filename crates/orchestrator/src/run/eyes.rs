//! What a run sees with: pictures and a method that looks at them, or the truth with noise.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use nalgebra::{Point3, Vector2};
use pb3dp_camera_sim::{GeometricCamera, GeometricFrame, Hindrance};
use pb3dp_estimation::estimator::{FramePrior, Tracker};
use pb3dp_estimation::published::TrackEstimate;
use pb3dp_estimation::region::Region;
use pb3dp_estimation::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_hal_api::{CameraError, CameraErrorKind, FramePair, StereoCamera};
use pb3dp_servo::supervisor::FrameInput;

use super::compared::{Frame, Onlooker};
use super::recording::Recording;
use super::strip::Strip;
use crate::config::setup::{Leader, Setup};
use crate::follower::Follower;

/// Where frames come from.
pub enum Sight {
    /// A camera that delivers pictures.
    Pictures(Box<dyn StereoCamera>),
    /// The truth with noise: no picture is rendered.
    Geometric(Box<GeometricCamera>),
}

/// Frames, and who estimates the pose from them.
pub enum Eyes {
    /// Pictures, and a method that looks at them.
    Pictures(Box<PictureEyes>),
    /// The truth with noise.
    Geometric(Box<GeometricEyes>),
}

/// Pictures, the method that leads the hand, those that look on, and what is kept of the pictures.
pub struct PictureEyes {
    camera: Box<dyn StereoCamera>,
    target_outline_m: Vec<Point3<f64>>,
    follower: Follower,
    onlookers: Vec<Onlooker>,
    pair: FramePair,
    /// The pair before; black before the first one.
    before: FramePair,
    /// Whether two pictures of the same scene differ.
    has_noise: bool,
    strip: Strip,
    recording: Option<Recording>,
}

/// The truth with noise.
pub struct GeometricEyes {
    camera: Box<GeometricCamera>,
    frame: Option<GeometricFrame>,
    /// Above this standard deviation a tilt is not sure, radians.
    tilt_sigma_sure_rad: f64,
}

impl Eyes {
    /// Eyes that have seen nothing yet. Every pair is also written to the folder `record`, if given.
    ///
    /// # Errors
    /// A parameter of a method out of its range, a leader that does not go with `sight`, or a recording of pictures that there are
    /// not.
    pub fn new(
        setup: &Setup,
        (sight, target_outline_m): (Sight, Vec<Point3<f64>>),
        strip: Strip,
        record: Option<&Path>,
    ) -> Result<Self> {
        match (setup.leader, sight) {
            (Leader::Pictures(method), Sight::Pictures(camera)) => Ok(Self::Pictures(Box::new(PictureEyes {
                follower: Follower::new(Tracker::new(method, &setup.rig, &setup.estimator)?, setup.range),
                onlookers: Onlooker::all_of(setup)?,
                pair: FramePair::black(camera.info().size),
                before: FramePair::black(camera.info().size),
                has_noise: setup.sensor.read_noise_grey > 0.0 || setup.sensor.shot_noise_grey > 0.0,
                camera,
                target_outline_m,
                strip,
                recording: record.map(|folder| Recording::new(folder, setup)),
            }))),
            (Leader::Geometric(_), Sight::Geometric(_)) if record.is_some() => {
                bail!("--record: with estimator.method = {:?} there are no pictures to record", setup.leader.name())
            }
            (Leader::Geometric(_), Sight::Geometric(camera)) => Ok(Self::Geometric(Box::new(GeometricEyes {
                camera,
                frame: None,
                tilt_sigma_sure_rad: setup.estimator.direct.track.tilt_sigma_sure_deg.to_radians(),
            }))),
            (leader, _) => bail!("estimator.method = {:?} does not go with this camera", leader.name()),
        }
    }

    /// Waits for the next frame; its number and times.
    ///
    /// # Errors
    /// If it does not come, or a picture is the one before, byte for byte: noise makes no picture twice, so the camera is frozen,
    /// whatever its numbers and times say.
    pub fn wait_for_frame(&mut self, timeout: Duration) -> Result<FrameInput, CameraError> {
        match self {
            Self::Pictures(eyes) => eyes.wait_for_pair(timeout),
            Self::Geometric(eyes) => {
                let frame = eyes.frame.insert(eyes.camera.next_frame(timeout)?);
                if !frame.is_new {
                    return Err(frozen(frame.sequence, "both pictures are"));
                }
                let skew_s = frame.skew_nanos as f64 * 1e-9;
                Ok(FrameInput { sequence: frame.sequence, at: frame.exposed_at, skew_s })
            }
        }
    }

    /// What an operator would draw around the target in the newest frame, as long as it was not taken; nothing where nobody looks
    /// at pictures.
    ///
    /// # Errors
    /// If a part of it is not before the camera.
    pub fn region(&self, setup: &Setup, cam_left_from_target: &Pose<CamLeft, Target>) -> Result<Option<Region>> {
        match self {
            Self::Pictures(eyes) if !eyes.follower.is_started() => {
                Ok(Some(Region::Polygon { vertices_px: eyes.outline_px(setup, cam_left_from_target)? }))
            }
            _ => Ok(None),
        }
    }

    /// Follows the target in the newest frame, or takes the one in `region`.
    ///
    /// # Errors
    /// If the method fails for good, or there was no frame.
    pub fn estimate(&mut self, region: Option<&Region>, prior: &FramePrior) -> Result<TrackEstimate> {
        match self {
            Self::Pictures(eyes) => Ok(eyes.follower.look(&eyes.pair.left, &eyes.pair.right, region, prior)?),
            Self::Geometric(eyes) => eyes.estimate(),
        }
    }

    /// Keeps what is wanted of the newest frame; those who look on look at it.
    ///
    /// # Errors
    /// If the recording can not be written.
    pub fn keep(&mut self, setup: &Setup, frame: &Frame<'_>, estimate: &TrackEstimate) -> Result<()> {
        let Self::Pictures(eyes) = self else { return Ok(()) };
        eyes.strip.offer(frame.t_s, &eyes.pair, &setup.rig, estimate);
        for onlooker in &mut eyes.onlookers {
            onlooker.look(&eyes.pair, frame);
        }
        eyes.record(setup, &frame.cam_left_from_target)
    }

    /// Completes the recording; what was recorded until a failure is the best hint at its cause.
    ///
    /// # Errors
    /// If it can not be written.
    pub fn finish_recording(&mut self) -> Result<()> {
        match self {
            Self::Pictures(eyes) => eyes.recording.take().map_or(Ok(()), Recording::finish),
            Self::Geometric(_) => Ok(()),
        }
    }

    /// The kept pictures, and those who looked on.
    pub fn finish(self) -> (Strip, Vec<Onlooker>) {
        match self {
            Self::Pictures(eyes) => (eyes.strip, eyes.onlookers),
            Self::Geometric(_) => (Strip::default(), Vec::new()),
        }
    }
}

fn frozen(sequence: u64, which: &str) -> CameraError {
    let message = format!(
        "camera: {which} the same as before, byte for byte, in pair {sequence}: it is frozen, or sees nothing at all; look after it"
    );
    CameraError::new(CameraErrorKind::BadPair, message)
}

impl PictureEyes {
    fn wait_for_pair(&mut self, timeout: Duration) -> Result<FrameInput, CameraError> {
        std::mem::swap(&mut self.before, &mut self.pair);
        if let Err(error) = self.camera.next_pair_into(&mut self.pair, timeout) {
            // What is in the buffer may be anything.
            std::mem::swap(&mut self.before, &mut self.pair);
            return Err(error);
        }
        let FramePair { sequence, exposed_at, skew_nanos, .. } = self.pair;
        // Pictures that differ do so in their first pixels: this costs nothing.
        let same = [self.pair.left == self.before.left, self.pair.right == self.before.right];
        match same.map(|same| same && self.has_noise) {
            [true, true] => return Err(frozen(sequence, "both pictures are")),
            [true, false] => return Err(frozen(sequence, "the left picture is")),
            [false, true] => return Err(frozen(sequence, "the right picture is")),
            [false, false] => (),
        }
        Ok(FrameInput { sequence, at: exposed_at, skew_s: skew_nanos as f64 * 1e-9 })
    }

    fn outline_px(&self, setup: &Setup, cam_left_from_target: &Pose<CamLeft, Target>) -> Result<Vec<Vector2<f64>>> {
        let pixel = |point: &Point3<f64>| setup.rig.left().project(&cam_left_from_target.transform_point(point));
        let vertices_px: Option<Vec<_>> = self.target_outline_m.iter().map(pixel).collect();
        vertices_px.context("the target is not in front of the camera at the beginning")
    }

    /// Writes the pair down with the truth, if a recording is wanted.
    fn record(&mut self, setup: &Setup, cam_left_from_target: &Pose<CamLeft, Target>) -> Result<()> {
        let Some(recording) = &self.recording else { return Ok(()) };
        let outline_px = match recording.is_open() {
            true => None,
            false => Some(self.outline_px(setup, cam_left_from_target)?),
        };
        let Some(recording) = &mut self.recording else { return Ok(()) };
        recording.push(&self.pair, cam_left_from_target, outline_px)
    }
}

impl GeometricEyes {
    fn estimate(&self) -> Result<TrackEstimate> {
        let frame = self.frame.as_ref().context("no frame was waited for")?;
        let sighting = &frame.sighting;
        let noise = self.camera.config().noise;
        let found = match (frame.hindrance, sighting.cam_left_from_model) {
            (Some(Hindrance::Blind(why)), _) => Err(why.to_owned()),
            (_, found) => found.map_err(|out_of_view| out_of_view.to_string()),
        };
        let (status, reason) = match (&found, frame.hindrance) {
            (Ok(_), Some(Hindrance::Doubtful(why))) => (Status::Ambiguous, why.to_owned()),
            (Ok(_), _) if noise.tilt_rad > self.tilt_sigma_sure_rad => {
                (Status::WeakTilt, "of the configured noise".to_owned())
            }
            (Ok(_), _) => (Status::Ok, "the true pose with the configured noise".to_owned()),
            (Err(why), _) if sighting.is_locked => (Status::Lost, why.clone()),
            (Err(why), _) => (Status::NotObservable, why.clone()),
        };
        let found = found.ok();
        Ok(TrackEstimate {
            status,
            reason,
            warnings: Vec::new(),
            cam_left_from_model: found,
            covariance: found.map(|_| noise.covariance()),
            psi: None,
            fitness: None,
            outline_px: found.map_or_else(Vec::new, |_| self.camera.outline_px(&frame.cam_left_from_target)),
            rotation_about_normal_observed: found.is_some(),
        })
    }
}
