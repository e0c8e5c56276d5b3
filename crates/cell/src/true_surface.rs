//! The truth of a first pose in simulation: the plane of least squares through the true visible surface inside the marked region.
//!
//! The pose of a target that is no plane is that of its plane of least squares (docs/method.md), so it depends on the region: a part of a
//! crab's shell is tilted against its rim. One definition holds for runs, the panel and the accuracy benchmark
//! ([`GroundTruth::plane_in`]).
//!
//! [`GroundTruth::plane_in`]: pb3dp_sim::raster::GroundTruth::plane_in

use std::collections::VecDeque;

use nalgebra::Vector3;
use pb3dp_estimation_core::model_frame::model_frame_on_plane;
use pb3dp_estimation_core::region::{RegionConfig, RegionMask};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model, Target, World};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::ScenePoses;

use crate::capturing::Captured;
use crate::perception::View;
use crate::selection::Selection;

/// Pairs whose true poses are kept: an operator draws on an image for some seconds.
const KEPT: usize = 300;

/// The true surface of a simulated target.
#[derive(Debug)]
pub struct TrueSurface {
    renderer: StereoRenderer,
    /// Sequence numbers of the newest pairs, and the true poses then.
    poses: VecDeque<(u64, Pose<CamLeft, Target>)>,
}

impl TrueSurface {
    /// That of a scene.
    pub fn new(renderer: StereoRenderer) -> Self {
        Self { renderer, poses: VecDeque::with_capacity(KEPT) }
    }

    /// Keeps the true pose of a pair.
    pub fn note(&mut self, captured: &Captured) {
        let Some(pose) = captured.cam_left_from_target else { return };
        if self.poses.len() == KEPT {
            self.poses.pop_front();
        }
        self.poses.push_back((captured.frame.sequence, pose));
    }

    /// The plane of a region in a pair, as a frame with z along its normal, away from the cameras. `None` if the region shows nothing that moves
    /// with the target.
    pub fn plane(&mut self, selection: &Selection, captured: &Captured) -> Option<Pose<Target, Model>> {
        let View::Images(newest) = &captured.view else { return None };
        let pair = selection.drawn_on.as_ref().unwrap_or(newest);
        let (_, cam_left_from_target) = *self.poses.iter().rev().find(|(sequence, _)| *sequence == pair.sequence)?;
        let region = selection.region.rasterize(&pair.left, &RegionConfig::default()).ok()?;
        let cam_left_from_plane = self.seen(&region, &cam_left_from_target)?;
        Some(cam_left_from_target.inverse() * cam_left_from_plane)
    }

    fn seen(
        &mut self,
        region: &RegionMask,
        cam_left_from_target: &Pose<CamLeft, Target>,
    ) -> Option<Pose<CamLeft, Model>> {
        let world_from_cam_left = Pose::<World, CamLeft>::coincident();
        let poses = ScenePoses { world_from_cam_left, world_from_target: world_from_cam_left * *cam_left_from_target };
        let seen = self.renderer.ground_truth(&poses);
        let camera = self.renderer.rig().left();
        let plane = seen.plane_in(camera, |[u, v]| region.contains(u as i32, v as i32))?;
        let ray = camera.unproject(&region.centroid_px()?).ok()?;
        model_frame_on_plane(ray / plane.dot(&ray), &-plane.normalize())
    }
}

/// True pose of the model frame: on the true plane, on the ray of the estimated origin.
pub fn true_model_frame(
    cam_left_from_model: &Pose<CamLeft, Model>,
    cam_left_from_plane: &Pose<CamLeft, Model>,
) -> Option<Pose<CamLeft, Model>> {
    let away = cam_left_from_plane.transform_vector(&Vector3::z());
    let origin = cam_left_from_model.translation_m();
    let ray = origin / origin.z;
    let true_depth_m = away.dot(&cam_left_from_plane.translation_m()) / away.dot(&ray);
    model_frame_on_plane(ray * true_depth_m, &-away)
}
