//! Image capture of a run: stereo pairs, or true poses with noise, each with its true target pose.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{CameraError, CameraErrorKind, FramePair, StereoCamera};
use pb3dp_servo::supervisor::FrameInput;
use pb3dp_setup::setup::Setup;

use super::cell::SimulatedCell;
use super::halves::Capture;
use super::losses::Losses;
pub use super::perception::Captured;
use super::perception::{PoseCamera, VisionInput};
use crate::perception::View;

/// A camera with its loss count.
pub struct Capturing {
    camera: Camera,
    cell: SimulatedCell,
    has_truth: bool,
    timeout: Duration,
    pairs_lost: u64,
    losses: Losses,
    /// Mid-exposure of the next pair and the true target pose then, if they were taken beforehand.
    exposed: Option<(MonotonicTime, Pose<CamLeft, Target>)>,
}

enum Camera {
    Images(ImageCamera),
    Geometric(Box<dyn PoseCamera>),
}

struct ImageCamera {
    camera: Box<dyn StereoCamera>,
    /// The previous pair; black before the first one.
    before: Arc<FramePair>,
    /// Allocated pairs: those without an owner are used again.
    pool: Vec<Arc<FramePair>>,
    /// Whether noise makes two images of the same scene differ.
    has_noise: bool,
}

impl Capturing {
    /// A camera without any frame yet.
    pub fn new(setup: &Setup, vision_input: VisionInput, cell: SimulatedCell) -> Self {
        let camera = match vision_input {
            VisionInput::Images(camera) => Camera::Images(ImageCamera {
                before: Arc::new(FramePair::black(camera.info().size)),
                pool: Vec::new(),
                has_noise: setup
                    .world
                    .as_ref()
                    .is_none_or(|world| world.sensor.read_noise_grey > 0.0 || world.sensor.shot_noise_grey > 0.0),
                camera,
            }),
            VisionInput::Geometric(camera) => Camera::Geometric(camera),
        };
        let (timeout, has_truth) = (setup.rig.frames.period * 2, setup.world.is_some());
        Self { camera, cell, has_truth, timeout, pairs_lost: 0, losses: Losses::default(), exposed: None }
    }

    /// Pairs that the camera could not deliver.
    pub fn pairs_lost(&self) -> u64 {
        self.pairs_lost
    }

    fn cam_left_from_target_at(&self, at: MonotonicTime) -> Pose<CamLeft, Target> {
        self.cell.world_from_cam_left_at(at).inverse() * self.cell.world_from_target_at(at)
    }

    /// Fails if the frame does not arrive, or if an image equals the previous one byte for byte: noise makes every image unique, so the
    /// camera is frozen, whatever its sequence numbers and times are.
    fn wait(&mut self) -> Result<(FrameInput, View), CameraError> {
        match &mut self.camera {
            Camera::Images(camera) => camera.wait(self.timeout),
            Camera::Geometric(camera) => {
                let frame = camera.next_frame(self.timeout)?;
                if !frame.is_new {
                    return Err(frozen(frame.sequence, "both images are"));
                }
                let skew_s = frame.skew_nanos as f64 * 1e-9;
                let input = FrameInput { sequence: frame.sequence, at: frame.exposed_at, skew_s };
                Ok((input, View::Geometric(Box::new(frame))))
            }
        }
    }
}

impl Capture for Capturing {
    fn capture(&mut self) -> Result<Option<Captured>> {
        match self.wait() {
            Ok((frame, view)) => {
                if let Some(line) = self.losses.pair_has_come() {
                    tracing::info!("{line}");
                }
                let exposed = self.exposed.take().filter(|(at, _)| *at == frame.at).map(|(_, pose)| pose);
                let cam_left_from_target =
                    self.has_truth.then(|| exposed.unwrap_or_else(|| self.cam_left_from_target_at(frame.at)));
                Ok(Some(Captured { frame, cam_left_from_target, view }))
            }
            Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {
                self.pairs_lost += 1;
                if let Some(line) = self.losses.add(&error.to_string()) {
                    tracing::warn!("{line}");
                }
                Ok(None)
            }
            Err(error) => Err(error).context("camera"),
        }
    }

    fn expose(&mut self) -> bool {
        let Camera::Images(camera) = &mut self.camera else { return false };
        let exposed_at = camera.camera.expose(self.timeout);
        self.exposed = exposed_at.map(|at| (at, self.cam_left_from_target_at(at)));
        exposed_at.is_some()
    }
}

fn frozen(sequence: u64, which: &str) -> CameraError {
    let message = format!(
        "camera: {which} identical to the previous pair, byte for byte, in pair {sequence}: the camera is frozen or dark; check it"
    );
    CameraError::new(CameraErrorKind::BadPair, message)
}

impl ImageCamera {
    fn wait(&mut self, timeout: Duration) -> Result<(FrameInput, View), CameraError> {
        let mut taken = self.free_pair();
        let Some(pair) = Arc::get_mut(&mut taken) else {
            return Err(CameraError::new(CameraErrorKind::Unusable, "camera: bug: a free pair is shared, report it"));
        };
        let came = self.camera.next_pair_into(pair, timeout);
        self.pool.push(Arc::clone(&taken));
        // After an error the content of the buffer is undefined.
        came?;
        let before = std::mem::replace(&mut self.before, Arc::clone(&taken));
        let FramePair { sequence, exposed_at, skew_nanos, .. } = *taken;
        // Different images differ in their first pixels, so this comparison is cheap.
        let same = [taken.left == before.left, taken.right == before.right];
        match same.map(|same| same && self.has_noise) {
            [true, true] => return Err(frozen(sequence, "both images are")),
            [true, false] => return Err(frozen(sequence, "the left image is")),
            [false, true] => return Err(frozen(sequence, "the right image is")),
            [false, false] => (),
        }
        let input = FrameInput { sequence, at: exposed_at, skew_s: skew_nanos as f64 * 1e-9 };
        Ok((input, View::Images(taken)))
    }

    /// A pair without an owner from the pool; a new one if there is none.
    fn free_pair(&mut self) -> Arc<FramePair> {
        match self.pool.iter_mut().position(|pair| Arc::get_mut(pair).is_some()) {
            Some(index) => self.pool.swap_remove(index),
            None => Arc::new(FramePair::black(self.camera.info().size)),
        }
    }
}
