//! The simulated world: its cameras and the true poses.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use nalgebra::Point3;
use pb3dp_camera_sim::{FaultyCamera, GeometricCamera, SimCameraConfig, SimStereoCamera};
use pb3dp_cell::cell::SimulatedCell;
use pb3dp_cell::perception::{PoseCamera, VisionInput};
use pb3dp_hal_api::{CameraError, Clock, StereoCamera};
use pb3dp_setup::setup::{FrameTiming, Leader, Pace, Setup, SimulatedWorld};
use pb3dp_sim::geometric::{GeometricFrame, GeometricTracker, PoseSigma};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::Scene;
use pb3dp_sim::targets;

use crate::parallel::parallel;

/// The simulated camera or its geometric substitute, and the outline of the target; sets all poses of the workcell to the true ones.
pub(super) fn wire_sight(
    setup: &Setup,
    world: &SimulatedWorld,
    cell: &mut SimulatedCell,
    clock: &Arc<dyn Clock>,
) -> Result<(VisionInput, Vec<Point3<f64>>)> {
    cell.follow_truth(&world.truth);
    let (poses, began) = (Box::new(cell.clone()), clock.now());
    let (clock, faults) = (Arc::clone(clock), world.faults.clone());
    let FrameTiming { period, exposure } = setup.rig.frames;
    let timing = SimCameraConfig { period, exposure, blur_moments: world.blur_moments, pairs: None };
    match setup.leader {
        Leader::Images(_) => {
            let scene = Scene::build(&world.scene).context("table [scene]")?;
            let outline_m = scene.target().outline_m.clone();
            let renderer = StereoRenderer::new(scene, *setup.true_rig(), &world.sensor, world.sensor_seed);
            let mut renderer = renderer.context("table [camera]")?;
            cell.scene = Some(Arc::new(renderer.clone()));
            if setup.pace != Pace::Fast {
                // A pair must be ready before the next one.
                renderer = renderer.with_run_both(parallel);
            }
            let camera = SimStereoCamera::new(renderer, poses, clock, timing)?;
            let camera: Box<dyn StereoCamera> = match faults.list.is_empty() {
                true => Box::new(camera),
                false => Box::new(FaultyCamera::new(camera, faults, began).context("table [camera]")?),
            };
            Ok((VisionInput::Images(camera), outline_m))
        }
        Leader::Geometric(config) => {
            let target = targets::model(&world.scene.target, world.scene.seed).context("table [scene]")?;
            let tracker = GeometricTracker::new(config, *setup.true_rig(), target.outline_m.clone())?;
            let camera = GeometricCamera::new(tracker, poses, clock, &timing)?.with_faults(faults, began)?;
            Ok((VisionInput::Geometric(Box::new(Poses(camera))), target.outline_m))
        }
    }
}

/// Adapts the backend's camera without images.
struct Poses(GeometricCamera);

impl PoseCamera for Poses {
    fn next_frame(&mut self, timeout: Duration) -> Result<GeometricFrame, CameraError> {
        self.0.next_frame(timeout)
    }

    fn noise(&self) -> PoseSigma {
        self.0.config().noise
    }
}
