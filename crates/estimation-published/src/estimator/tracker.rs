//! The tracker of the published method: propagates the population, the region and the model frame from frame to frame.

use nalgebra::{Point3, Vector2};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, PlanePose, TrackEstimate};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::{Deadline, EstimateRequest, EstimationMethod, MarkedTarget};
use pb3dp_estimation_core::model_frame::model_frame_on_plane;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionMask, polygon};
use pb3dp_estimation_core::status::{Status, Verdict};
use pb3dp_geometry::frames::CamLeft;
use pb3dp_geometry::{ImageSize, Pinhole, Pose, StereoRig};

use super::backprojection::{Backprojection, ShiftLimits};
use super::core::Core;
use super::outline_fit::OutlineEdge;
use super::target::{Appearance, Carried, Target, pixel_of, with_normal};
use super::{NO_HYPOTHESIS, PublishedConfig};
use crate::observability::Landscape;
use crate::search::Found;
use crate::search::rmga::{Population, RmGa};

/// Tracks one target from frame to frame with the published method.
///
/// In each frame, the last pose, moved by the known motion of the camera, projects the first frame's outline into the new left
/// image. The pixels with the target's hues re-centre it (see [`TrackerConfig`](super::TrackerConfig)), and the model is
/// rebuilt inside it. The population, moved by the same motion, evolves for the configured generations. All individuals,
/// including the elite, are scored again.
///
/// In the frames after a loss, the target is searched in a window that doubles with every frame, up to the whole image, with a
/// new population and the generations of a cold start.
///
/// An estimate is confident only once a survey of the whole search range has found no rival, after the start and after every
/// loss. A target without a confident estimate is dropped after some frames and stays lost until it is marked again.
#[derive(Clone, Debug)]
pub struct PublishedTracker {
    core: Core,
    start: Option<Start>,
    target: Option<Target>,
    mask: RegionMask,
    /// Number of frames without a confident estimate since the start, or since the target was found again.
    unsure_frames: u32,
}

/// The request from which tracking started.
#[derive(Clone, Debug)]
struct Start {
    region: Region,
    range: SearchRange,
}

impl PublishedTracker {
    /// Creates a tracker for a calibrated pair, rectified or not, with or without lens distortion.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(rig: &StereoRig, config: PublishedConfig) -> Result<Self, EstimationError> {
        let core = Core::new(rig, config, Kernels::best())?;
        let mask = RegionMask::empty(ImageSize { width: 0, height: 0 });
        Ok(Self { core, start: None, target: None, mask, unsure_frames: 0 })
    }

    /// The parameters.
    pub fn config(&self) -> &PublishedConfig {
        self.core.config()
    }

    fn take_target(
        &mut self,
        left: ImageView<'_>,
        right: ImageView<'_>,
        MarkedTarget { region, range, .. }: MarkedTarget<'_>,
        deadline: &mut Deadline<'_>,
    ) -> Result<TrackEstimate, EstimationError> {
        self.target = None;
        let taken = self.core.take(left, right, region)?;
        self.mask = taken.mask;
        let mut estimate = TrackEstimate {
            warnings: taken.warnings.into_iter().map(EstimateWarning::Region).collect(),
            ..self.blank_estimate(&taken.outline_px)
        };
        if let Some(reason) = self.core.lack_of_hue() {
            return Ok(TrackEstimate { reason, ..estimate });
        }
        let config = self.core.config().clone();
        let mut rmga = RmGa::new(config.rmga, *range)?;
        let mut population = Population::random(&config.rmga);
        let generations = config.cold_start.generations;
        let Some(found) = self.core.search(&mut rmga, &mut population, generations, deadline)? else {
            return Ok(TrackEstimate { reason: NO_HYPOTHESIS.to_owned(), ..estimate });
        };
        let landscape = self.core.survey(&found, range)?;
        let Verdict { status, reason } = landscape.verdict(&config.observability);
        (estimate.status, estimate.reason) = (status, reason);
        (estimate.psi, estimate.fitness) = (Some(found.psi), Some(found.fitness));
        if status != Status::NotObservable {
            let target = self.first_target(&taken.outline_px, &found, &landscape, rmga, population);
            estimate.cam_left_from_model = target.as_ref().map(|target| target.cam_left_from_model);
            self.target = target;
        }
        Ok(estimate)
    }

    fn follow(
        &mut self,
        target: &mut Target,
        left: ImageView<'_>,
        right: ImageView<'_>,
        motion: Option<&Pose<CamLeft, CamLeft>>,
        deadline: &mut Deadline<'_>,
    ) -> Result<TrackEstimate, EstimationError> {
        self.core.load(left, right)?;
        let old_centre_px = self.core.model_centre_px();
        if let Some(motion) = motion {
            target.move_camera(motion);
        }
        let carried = match self.carry_region(target) {
            Ok(carried) => carried,
            Err(reason) => return Ok(self.lost(target, reason, &[])),
        };
        self.core.remake_model(&self.mask);
        if let Some(reason) = self.core.lack_of_hue() {
            return Ok(self.lost(target, reason, &carried.outline_px));
        }
        let new_centre_px = self.core.model_centre_px();
        if let Some(motion) = motion {
            let rays = (self.core.pair().left_ray(&old_centre_px), self.core.pair().left_ray(&new_centre_px));
            target.move_population(motion, &rays.0, &rays.1);
        }
        let mut generations = self.core.config().rmga.generations;
        if target.lost_frames > 0 {
            target.population.scatter();
            generations = self.core.config().cold_start.generations;
        }
        let Some(found) = self.core.search(&mut target.rmga, &mut target.population, generations, deadline)? else {
            return Ok(self.lost(target, NO_HYPOTHESIS.to_owned(), &carried.outline_px));
        };
        if found.fitness < target.fitness_floor {
            let (fitness, floor) = (found.fitness, target.fitness_floor);
            let reason = format!("the fitness has fallen to {fitness:.3}, below {floor:.3}");
            let lost = self.lost(target, reason, &carried.outline_px);
            return Ok(TrackEstimate { psi: Some(found.psi), fitness: Some(fitness), ..lost });
        }
        self.accept(target, &found, &carried)
    }

    /// Stores an estimate and evaluates it.
    fn accept(
        &mut self,
        target: &mut Target,
        found: &Found,
        carried: &Carried,
    ) -> Result<TrackEstimate, EstimationError> {
        let mut estimate = self.blank_estimate(&carried.outline_px);
        let centre_ray = self.core.pair().left_ray(&self.core.model_centre_px());
        let origin_ray = self.core.pair().left_ray(&carried.origin_px);
        let plane = found.psi.inverse_depth_plane(&centre_ray);
        let Some(plane) = plane.and_then(|q| PlanePose::from_inverse_depth_plane(q, &origin_ray)) else {
            return Ok(self.lost(target, NO_HYPOTHESIS.to_owned(), &carried.outline_px));
        };
        let jump = plane.z_m / target.cam_left_from_model.translation_m().z - 1.0;
        if !target.was_assured && jump.abs() > self.core.config().observability.depth_spread_max {
            self.retake(target, found, carried)?;
        } else {
            let rotation = with_normal(&target.reference_rotation, &-plane.normal_in_cam_left);
            target.cam_left_from_model = Pose::from_parts(origin_ray * plane.z_m, rotation);
        }
        target.lost_frames = 0;
        let verdict = self.judge(target, found)?;
        estimate.cam_left_from_model = (verdict.status != Status::NotObservable).then_some(target.cam_left_from_model);
        (estimate.status, estimate.reason) = (verdict.status, verdict.reason);
        (estimate.psi, estimate.fitness) = (Some(found.psi), Some(found.fitness));
        Ok(estimate)
    }

    /// Reinitialises the target from the region of this frame, because its depth was that of a rival and the size of its
    /// outline was therefore wrong. The model frame is redefined here.
    fn retake(&mut self, target: &mut Target, found: &Found, carried: &Carried) -> Result<(), EstimationError> {
        let range = *target.rmga.codec().range();
        let landscape = self.core.survey(found, &range)?;
        let (rmga, population) = (target.rmga.clone(), target.population.clone());
        if let Some(anew) = self.first_target(&carried.outline_px, found, &landscape, rmga, population) {
            *target = anew;
        }
        Ok(())
    }

    /// Status of the estimate for a frame. Continuity rules out other peaks only once the whole search range has been surveyed
    /// without finding a rival. Until then it is surveyed in every frame.
    fn judge(&mut self, target: &mut Target, found: &Found) -> Result<Verdict, EstimationError> {
        let range = *target.rmga.codec().range();
        let config = self.core.config().tracked_observability();
        let verdict = if target.is_assured {
            let spread = self.core.spread_nearby(found, &range)?;
            config.verdict_nearby(&spread)
        } else {
            self.core.survey(found, &range)?.verdict(&config)
        };
        target.is_assured |= verdict.status.depth_is_sure();
        target.was_assured |= target.is_assured;
        self.unsure_frames = if target.is_assured { 0 } else { self.unsure_frames + 1 };
        let contrast_min = self.core.config().tracker.contrast_min;
        if verdict.status.depth_is_sure() && target.appearance.mass_per_area < contrast_min {
            let reason = format!(
                "the region cannot be re-centred: its hue contrast to the surroundings is only {:.2} (limit {contrast_min:.2})",
                target.appearance.mass_per_area
            );
            return Ok(Verdict { status: Status::Ambiguous, reason });
        }
        Ok(verdict)
    }

    /// Propagates the region to the new frame; the result is in `self.mask`.
    fn carry_region(&mut self, target: &mut Target) -> Result<Carried, String> {
        let visible_share_min = self.core.config().tracker.visible_share_min;
        let out_of_sight = || "the target is outside the image".to_owned();
        let pinhole = *self.core.pair().left();
        let mut carried = target.region_in(&pinhole).ok_or_else(out_of_sight)?;
        let mut covered_px = self.rasterize(&carried.outline_px);
        if let Some(shift_px) = self.recentre(target, &carried.mass_centre_px, covered_px)? {
            target.outline_roll_rad = self.turn_outline(target, &pinhole, &shift_px);
            carried = target.region_in(&pinhole).ok_or_else(out_of_sight)?;
            carried.shift(&shift_px);
            covered_px = self.rasterize(&carried.outline_px);
        }
        let visible = self.mask.area_px() as f64 / covered_px.max(1) as f64;
        if visible < visible_share_min {
            let (percent, limit) = (100.0 * visible, 100.0 * visible_share_min);
            return Err(format!("only {percent:.0} % of the region is inside the image (limit {limit:.0} %)"));
        }
        Ok(carried)
    }

    /// Rotation of the outline after it is re-centred.
    fn turn_outline(&self, target: &Target, pinhole: &Pinhole, shift_px: &Vector2<f64>) -> f64 {
        let hue = self.core.left_hue();
        target.outline_edge.fit(target.outline_roll_rad, |point| {
            let pixel = pixel_of(&target.cam_left_from_model, pinhole, point).map(|pixel| pixel + shift_px);
            pixel.map_or(0.0, |pixel| target.appearance.colours.weight_at(hue, &pixel))
        })
    }

    /// Displacement of the target's pixels; `None` if they cannot be distinguished from the background.
    fn recentre(
        &self,
        target: &Target,
        expected_px: &Vector2<f64>,
        covered_px: usize,
    ) -> Result<Option<Vector2<f64>>, String> {
        let config = self.core.config().tracker;
        let appearance = &target.appearance;
        if appearance.mass_per_area < config.contrast_min {
            return Ok(None);
        }
        let area = covered_px as f64;
        let widening = f64::from(1_u32 << target.lost_frames.min(8));
        let shift_max_px = config.shift_max_share * area.sqrt() * widening;
        let limits = ShiftLimits { steps_max: config.shift_steps_max, shift_max_px };
        let hue = self.core.left_hue();
        let mut window = self.mask.dilate(config.window_margin_px);
        let mut start_px = Vector2::zeros();
        if target.lost_frames > 0 {
            // First the centroid of everything that looks like the target in a wide window, then the usual steps from there.
            let wide = grown_box(&self.mask, (shift_max_px.ceil() as u32).max(config.window_margin_px));
            if let Some((shift_px, _)) = appearance.colours.mean_shift(hue, &wide, expected_px, limits) {
                start_px = shift_px;
                window = window.translate(shift_px.x.round() as i32, shift_px.y.round() as i32);
            }
        }
        let start_px = start_px.map(f64::round);
        let found = appearance.colours.mean_shift(hue, &window, &(expected_px + start_px), limits);
        let share = found.map_or(0.0, |(_, mass)| mass.sum_px / (appearance.mass_per_area * area.max(1.0)));
        match found {
            Some((shift_px, _)) if share >= config.mass_share_min => Ok(Some(start_px + shift_px)),
            _ => {
                let (percent, limit) = (100.0 * share, 100.0 * config.mass_share_min);
                Err(format!("only {percent:.0} % of the target's pixels were found by hue (limit {limit:.0} %)"))
            }
        }
    }

    /// Rasterises an outline into `self.mask`; returns the number of pixels that it covers, inside and outside the image.
    fn rasterize(&mut self, outline_px: &[Vector2<f64>]) -> usize {
        self.mask.reset(self.core.pair().left_size());
        polygon::fill(outline_px, &mut self.mask)
    }

    /// The target as it is in `self.mask`, whose outline is given; `None` if a part of it is not in front of the camera.
    fn first_target(
        &self,
        outline_px: &[Vector2<f64>],
        found: &Found,
        landscape: &Landscape,
        rmga: RmGa,
        population: Population,
    ) -> Option<Target> {
        let pair = *self.core.pair();
        let centre_px = self.core.model_centre_px();
        let centre_ray = pair.left_ray(&centre_px);
        let q = found.psi.inverse_depth_plane(&centre_ray)?;
        let plane = PlanePose::from_inverse_depth_plane(q, &centre_ray)?;
        let cam_left_from_model = model_frame_on_plane(centre_ray * plane.z_m, &plane.normal_in_cam_left)?;
        let model_from_cam_left = cam_left_from_model.inverse();
        let on_plane = |pixel: &Vector2<f64>| {
            let ray = pair.left_ray(pixel);
            let point_in_cam_left = Point3::from(ray * plane.depth_on_ray(&ray)?);
            Some(model_from_cam_left.transform_point(&point_in_cam_left).coords.xy())
        };
        let outline_in_model_m: Option<Vec<_>> = outline_px.iter().map(on_plane).collect();
        let outline_in_model_m = outline_in_model_m?;
        let config = self.core.config();
        let window = self.mask.dilate(config.tracker.window_margin_px);
        let around = RegionMask::from_fn(window.size(), |x, y| {
            window.contains(x as i32, y as i32) && !self.mask.contains(x as i32, y as i32)
        });
        let colours = Backprojection::learn(self.core.left_hue(), &self.mask, &around);
        let mass = colours.mass(self.core.left_hue(), &window, &Vector2::zeros());
        let (sum_px, mass_px) = mass.map_or((0.0, centre_px), |mass| (mass.sum_px, mass.centroid_px));
        let height = landscape.fitness_highest - landscape.fitness_median;
        let is_assured = landscape.verdict(&config.observability).status.depth_is_sure();
        Some(Target {
            rmga,
            population,
            cam_left_from_model,
            reference_rotation: cam_left_from_model.rotation(),
            outline_edge: OutlineEdge::new(&outline_in_model_m, plane.z_m / pair.left().fx),
            outline_in_model_m,
            outline_roll_rad: 0.0,
            appearance: Appearance {
                colours,
                mass_centre_in_model_m: on_plane(&mass_px)?,
                mass_per_area: sum_px / self.mask.area_px().max(1) as f64,
            },
            fitness_floor: landscape.fitness_median + config.tracker.height_share_min * height,
            lost_frames: 0,
            is_assured,
            was_assured: is_assured,
        })
    }

    fn lost(&self, target: &mut Target, reason: String, outline_px: &[Vector2<f64>]) -> TrackEstimate {
        target.lost_frames = target.lost_frames.saturating_add(1);
        target.is_assured = false;
        TrackEstimate { status: Status::Lost, reason, ..self.blank_estimate(outline_px) }
    }

    fn blank_estimate(&self, undistorted_outline_px: &[Vector2<f64>]) -> TrackEstimate {
        let camera = self.core.left_camera();
        let raw = |pixel: &Vector2<f64>| camera.project(&Point3::from(self.core.pair().left_ray(pixel)));
        TrackEstimate {
            outline_px: undistorted_outline_px.iter().filter_map(raw).collect(),
            ..TrackEstimate::without_pose(Status::NotObservable, String::new())
        }
    }
}

impl EstimationMethod for PublishedTracker {
    type Answer = TrackEstimate;

    /// A marked target is searched without a start value. If its pose is not observable, the same region is tried again for a
    /// few frames. Of the prior, only the motion of the camera is used.
    fn answer(&mut self, request: &mut EstimateRequest<'_>) -> Result<TrackEstimate, EstimationError> {
        let EstimateRequest { left, right, target, prior, ref mut deadline, .. } = *request;
        if let Some(marked) = target {
            marked.range.validate()?;
            self.unsure_frames = 0;
            self.start = Some(Start { region: marked.region.clone(), range: *marked.range });
            return self.take_target(left, right, marked, deadline);
        }
        let limit = self.core.config().tracker.assure_frames_max;
        if self.start.is_some() && self.unsure_frames >= limit {
            self.target = None;
            let reason = format!("no confident pose within {limit} frames, the target is dropped: mark it again");
            return Ok(TrackEstimate { status: Status::Lost, reason, ..self.blank_estimate(&[]) });
        }
        let Some(mut target) = self.target.take() else {
            let Start { region, range } = self.start.clone().ok_or(EstimationError::NotStarted)?;
            self.unsure_frames += 1;
            let again =
                self.take_target(left, right, MarkedTarget { region: &region, range: &range, model: None }, deadline)?;
            return Ok(TrackEstimate { warnings: Vec::new(), ..again });
        };
        let outcome = self.follow(&mut target, left, right, prior.cam_left_prev_from_cam_left_now.as_ref(), deadline);
        self.target = Some(target);
        outcome
    }

    fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        *self = Self::new(rig, self.config().clone())?;
        Ok(())
    }
}

/// The mask's bounding box, enlarged by `margin_px` on all sides.
fn grown_box(mask: &RegionMask, margin_px: u32) -> RegionMask {
    let mut grown = RegionMask::empty(mask.size());
    if let Some(bounds) = mask.bbox() {
        let (x, y, margin) = (i64::from(bounds.x), i64::from(bounds.y), i64::from(margin_px));
        for row in (y - margin).max(0)..(y + i64::from(bounds.height) + margin).min(i64::from(mask.size().height)) {
            grown.insert_span(row, x - margin, x + i64::from(bounds.width) + margin);
        }
    }
    grown
}
