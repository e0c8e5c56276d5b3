//! The truth of a first pose in simulation: the plane of least squares through the true visible surface inside the marked region.
//!
//! The pose of a target that is no plane is that of its plane of least squares (docs/method.md), so it depends on the region: a part of a
//! crab's shell is tilted against its rim. One definition holds for runs, the panel and the accuracy benchmark
//! ([`GroundTruth::plane_in`]).
//!
//! [`GroundTruth::plane_in`]: pb3dp_sim::raster::GroundTruth::plane_in

use std::collections::VecDeque;

use anyhow::Result;
use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_estimation_core::model_frame::model_frame_on_plane;
use pb3dp_estimation_core::region::{Region, RegionConfig, RegionMask};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model, Target, World};
use pb3dp_setup::setup::Setup;
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, ScenePoses};

use crate::capturing::Captured;
use crate::perception::View;
use crate::selection::{Choice, Selection};

/// Pairs whose true poses are kept: an operator draws on an image for some seconds.
const KEPT: usize = 300;

/// The true surface of a simulated target.
#[derive(Debug)]
pub struct TrueSurface {
    renderer: StereoRenderer,
    /// Sequence numbers of the newest pairs, and the true poses then.
    poses: VecDeque<(u64, Pose<CamLeft, Target>)>,
    /// The plane of the present target.
    target_from_plane: Option<Pose<Target, Model>>,
}

impl TrueSurface {
    /// That of a scene.
    pub fn new(renderer: StereoRenderer) -> Self {
        Self { renderer, poses: VecDeque::with_capacity(KEPT), target_from_plane: None }
    }

    /// That of the world of a setup; `None` if there is none, or it has no images.
    ///
    /// # Errors
    /// A scene that cannot be built.
    pub fn of(setup: &Setup) -> Result<Option<Self>> {
        let Some(world) = setup.world.as_ref().filter(|_| setup.leader.needs_images()) else { return Ok(None) };
        let scene = Scene::build(&world.scene)?;
        Ok(Some(Self::new(StereoRenderer::new(scene, *setup.true_rig(), &world.sensor, world.sensor_seed)?)))
    }

    /// The plane of the present target, as a frame with z along its normal, away from the cameras, after a pair. `region`: the region of a new
    /// target. `None` if that shows nothing that moves with the target.
    pub fn see(
        &mut self,
        chosen: Option<&Choice>,
        region: Option<&Region>,
        captured: &Captured,
    ) -> Option<Pose<Target, Model>> {
        if self.poses.len() == KEPT {
            self.poses.pop_front();
        }
        self.poses.extend(captured.cam_left_from_target.map(|pose| (captured.frame.sequence, pose)));
        if let Some(region) = region {
            let selection = match chosen {
                Some(Choice::Marked(selection)) => selection.clone(),
                _ => Selection { region: region.clone(), drawn_on: None, model: None },
            };
            self.target_from_plane = self.plane(&selection, captured);
        }
        self.target_from_plane
    }

    fn plane(&mut self, selection: &Selection, captured: &Captured) -> Option<Pose<Target, Model>> {
        let View::Images(newest) = &captured.view else { return None };
        let pair = selection.drawn_on.as_ref().unwrap_or(newest);
        let (_, cam_left_from_target) = *self.poses.iter().rev().find(|(sequence, _)| *sequence == pair.sequence)?;
        let region = selection.region.rasterize(&pair.left, &RegionConfig::default()).ok()?;
        let cam_left_from_plane = self.visible_surface(&region, &cam_left_from_target)?;
        Some(cam_left_from_target.inverse() * cam_left_from_plane)
    }

    fn visible_surface(
        &mut self,
        region: &RegionMask,
        cam_left_from_target: &Pose<CamLeft, Target>,
    ) -> Option<Pose<CamLeft, Model>> {
        let world_from_cam_left = Pose::<World, CamLeft>::coincident();
        let poses = ScenePoses { world_from_cam_left, world_from_target: world_from_cam_left * *cam_left_from_target };
        let visible_surface = self.renderer.ground_truth(&poses);
        let camera = self.renderer.rig().left();
        let plane = visible_surface.plane_in(camera, |[u, v]| region.contains(u as i32, v as i32))?;
        let ray = camera.unproject(&region.centroid_px()?).ok()?;
        model_frame_on_plane(ray / plane.dot(&ray), &-plane.normalize())
    }
}

/// A frame on a plane, turned about its normal until its x axis is that of another frame.
pub fn turned_as(pose: &Pose<CamLeft, Model>, like: &Pose<CamLeft, Model>) -> Pose<CamLeft, Model> {
    let x = pose.inverse().transform_vector(&like.transform_vector(&Vector3::x()));
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), x.y.atan2(x.x));
    *pose * Pose::<Model, Model>::from_parts(Vector3::zeros(), turn)
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
