//! From frame to frame.

use image::RgbImage;
use nalgebra::{Matrix3, Matrix6, Point3, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Pose, StereoRig};

use super::align::{Aligner, Estimate, Knowledge, Problem};
use super::config::DirectTrackerConfig;
use super::images::{EyeImages, LEVELS};
use super::normal::Free;
use super::predict::{FramePrior, Motion};
use super::surface::{Surface, model_frame};
use super::view::View;
use crate::cpu::Kernels;
use crate::direct::image_plane::PixelWindow;
use crate::error::EstimationError;
use crate::estimate::PlanePose;
use crate::published::TrackEstimate;
use crate::region::{Region, RegionConfig};
use crate::status::Status;

/// Follows one target.
#[derive(Clone, Debug)]
pub struct DirectTracker {
    rig: StereoRig,
    config: DirectTrackerConfig,
    kernels: Kernels,
    images: [EyeImages; 2],
    target: Option<Target>,
}

#[derive(Clone, Debug)]
struct Target {
    surface: Surface,
    views: Vec<View>,
    aligner: Aligner,
    estimate: Estimate,
    knowledge: Knowledge,
    motion: Motion,
    frame: u64,
    outline_in_model: Vec<Point3<f64>>,
    covariance: Option<Matrix6<f64>>,
}

impl DirectTracker {
    /// A tracker for a calibrated pair.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(rig: &StereoRig, config: DirectTrackerConfig) -> Result<Self, EstimationError> {
        config.validate()?;
        Ok(Self { rig: *rig, config, kernels: Kernels::best(), images: Default::default(), target: None })
    }

    /// Takes a target whose plane is known.
    ///
    /// # Errors
    /// A region that can not serve.
    pub fn start_from_plane(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: &Region,
        plane: &PlanePose,
    ) -> Result<TrackEstimate, EstimationError> {
        let mask = region.rasterize(left, &RegionConfig::default())?;
        let outline_px = region.outline_px(&mask);
        let centroid = mask.centroid_px().unwrap_or_default();
        let eroded = mask.erode(self.config.erosion_px);
        let bounds = mask.bbox().unwrap_or(crate::region::PixelBox { x: 0, y: 0, width: 1, height: 1 });
        let window = PixelWindow {
            x: bounds.x as i32,
            y: bounds.y as i32,
            width: bounds.width as usize,
            height: bounds.height as usize,
        };
        self.images[0].update(left, window.grown(16), self.kernels);
        let q = plane.inverse_depth_plane;
        let centre_ray = self.rig.left().unproject(&centroid)?;
        let pose = model_frame(&q, &centre_ray).ok_or(EstimationError::NotStarted)?;
        let mut surface = Surface::choose(&self.images[0], &eroded, &self.rig, q, &pose, self.config.points);
        let mut aligner = Aligner::new(&surface, self.kernels);
        let mut view = View::empty(std::array::from_fn(|level| surface.levels[level].groups.len()));
        view.cam_left_from_model = pose;
        for level in 0..LEVELS {
            aligner.project_left(&mut surface, level, &self.rig, &pose);
            view.take_level(level, &self.images[0], &aligner.seen[level]);
        }
        let model_from_first = pose.inverse();
        let outline_in_model = outline_px
            .iter()
            .filter_map(|px| {
                let ray = self.rig.left().unproject(px).ok()?;
                Some(model_from_first.transform_point(&Point3::from(ray * plane.depth_on_ray(&ray)?)))
            })
            .collect();
        let mut target = Target {
            surface,
            views: vec![view],
            aligner,
            estimate: Estimate::at(pose),
            knowledge: Knowledge {
                row_offset_px: 0.0,
                row_information: 1.0 / (0.5 * 0.5),
                shape_information: Matrix3::identity() * 1e-3,
            },
            motion: Motion::resting(pose),
            frame: 0,
            outline_in_model,
            covariance: None,
        };
        self.load(left, right, &target, &pose, 24);
        for _ in 0..3 {
            let Target { surface, views, aligner, estimate, knowledge, .. } = &mut target;
            let mut problem = Problem { surface, view: &views[0], images: &self.images, rig: &self.rig, knowledge };
            let aligned = aligner.align(&mut problem, estimate, 0..=2, (Free::Surface, 6), &mut || true);
            if let Some(aligned) = aligned {
                let step: Vector3<f64> = aligned.last.unknowns.fixed_rows::<3>(7).into_owned();
                target.surface.plane += step;
                target.surface.rebuild();
            }
        }
        target.learn(&self.images, &self.rig, Free::Surface, Vector3::zeros());
        let estimate = target.report(&self.rig);
        self.target = Some(target);
        Ok(estimate)
    }

    fn load(&mut self, left: &RgbImage, right: &RgbImage, target: &Target, pose: &Pose<CamLeft, Model>, margin: u32) {
        let right_pose = *self.rig.cam_right_from_cam_left() * *pose;
        for (eye, (image, camera, isometry)) in
            [(left, self.rig.left(), pose.isometry()), (right, self.rig.right(), right_pose.isometry())]
                .into_iter()
                .enumerate()
        {
            let window = target.window(camera, isometry).grown(margin);
            self.images[eye].update(image, window, self.kernels);
        }
    }

    /// Follows the target into the next pair.
    ///
    /// # Errors
    /// Not started.
    pub fn update(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        prior: &FramePrior,
    ) -> Result<TrackEstimate, EstimationError> {
        let mut target = self.target.take().ok_or(EstimationError::NotStarted)?;
        target.frame += 1;
        let predicted = target.motion.predict(prior);
        self.load(left, right, &target, &predicted, if target.motion.is_known() { 24 } else { 40 });
        target.estimate.cam_left_from_model = predicted;
        let report = {
            let Target { surface, views, aligner, estimate, knowledge, .. } = &mut target;
            let mut problem = Problem { surface, view: &views[0], images: &self.images, rig: &self.rig, knowledge };
            aligner.align(
                &mut problem,
                estimate,
                0..=LEVELS - 1,
                (Free::Everything, self.config.steps_max),
                &mut || true,
            )
        };
        if let Some(aligned) = report {
            let shape = aligned.last.unknowns.fixed_rows::<3>(7).into_owned();
            target.learn(&self.images, &self.rig, Free::Everything, shape);
            let found = target.estimate.cam_left_from_model;
            target.motion.learn(&found, prior);
        }
        let estimate = target.report(&self.rig);
        self.target = Some(target);
        Ok(estimate)
    }
}

impl Target {
    fn window(&self, camera: &Camera, cam_from_model: &nalgebra::Isometry3<f64>) -> PixelWindow {
        let (mut low, mut high) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
        for point in &self.outline_in_model {
            if let Some(px) = camera.project(&(cam_from_model * point)) {
                (low, high) = (low.inf(&px), high.sup(&px));
            }
        }
        if low.x > high.x {
            return PixelWindow::default();
        }
        PixelWindow {
            x: low.x.floor() as i32,
            y: low.y.floor() as i32,
            width: (high.x - low.x).ceil() as usize + 1,
            height: (high.y - low.y).ceil() as usize + 1,
        }
    }

    fn learn(&mut self, images: &[EyeImages; 2], rig: &StereoRig, free: Free, shape: Vector3<f64>) {
        let Self { surface, views, aligner, estimate, knowledge, .. } = self;
        let problem = Problem { surface, view: &views[0], images, rig, knowledge };
        let Some((equations, _sums)) = aligner.examine(&problem, estimate) else { return };
        let prior = problem.prior(estimate);
        self.covariance = equations.covariance(&prior).map(|c| c.fixed_view::<6, 6>(0, 0).into_owned());
        if let Some(gained) = equations.surface_information(&prior, free) {
            let share = if free == Free::Surface { 1.0 } else { 0.1 };
            self.knowledge.shape_information += gained * share;
        }
        if free != Free::Surface {
            self.surface.plane += shape;
            self.surface.rebuild();
        }
    }

    fn report(&self, rig: &StereoRig) -> TrackEstimate {
        let pose = self.estimate.cam_left_from_model;
        TrackEstimate {
            status: Status::Ok,
            reason: String::new(),
            warnings: Vec::new(),
            cam_left_from_model: Some(pose),
            covariance: self.covariance,
            psi: None,
            fitness: None,
            outline_px: self
                .outline_in_model
                .iter()
                .filter_map(|p| rig.left().project(&pose.transform_point(p)))
                .collect(),
            rotation_about_normal_observed: true,
        }
    }
}
