//! The first pair of a target: its plane, its relief, and what else looks like it.

use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation_core::Argument;
use pb3dp_estimation_core::error::{EstimationError, check_image_sizes};
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate, PlanePose, TrackEstimate};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, KnownModel, MarkedTarget, SurfacePoint};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionMask};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_views::image_plane::PixelWindow;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::{DirectTracker, blank};
use crate::images::is_grey;
use crate::surface::{Surface, model_frame};
use crate::target::{Ending, Target};

/// Margin at initialisation: the relief may extend beyond the plane's outline in the right image. Chosen by hand, not
/// varied: reliefs that reach farther are cut off.
const MARGIN_START_PX: u32 = 40;
/// Largest number of attempts to find one surface in the remainder of a region with several. Chosen by hand, not varied:
/// time of a start grows with it.
const PARTS_MAX: usize = 4;
/// Smallest share of a region's points that can be taken for what was marked. Chosen with figures: of 200 real targets with a sure pose two have
/// less, and of 16 regions of a rendered shell two; all four were wrong. With 40 %, most rectangles across a depth edge are not followed.
const PART_MIN: f64 = 0.2;
/// Largest share of the side of a square as large as the region that is excluded at each of its borders. Chosen by hand, not varied:
/// 6 px of a square of 50 px, 2 px of one of 20 px.
const EROSION_SHARE_MAX: f64 = 0.12;
/// Smallest number of points of a target. Chosen by hand, not varied: five for each of eight values of an alignment.
const POINTS_MIN: usize = 40;

/// How a target begins.
#[derive(Clone, Copy, Default)]
struct Begin<'a, 'r> {
    /// The frame of a target that is no plane is that of its visible surface in this pair.
    request: Option<&'a EstimateRequest<'r>>,
    /// The frame that the target had before.
    known: Option<&'a KnownModel>,
    /// No plane was found: what is certainly one surface is a target, and nothing else.
    must_be_surface: bool,
}

/// A surface and the pose of its frame.
type FirstSurface = (Surface, Pose<CamLeft, Model>);

impl DirectTracker {
    /// Initialises a new target. If the plane is not observable there is no target, and the status reports it. Exception: the
    /// region has a relief, and plane and relief together explain both images. The relief is always estimated, whatever the
    /// deadline.
    pub(super) fn start(&mut self, request: &mut EstimateRequest<'_>) -> Result<TrackEstimate, EstimationError> {
        let MarkedTarget { region, range, model } = request.marked()?;
        let (left, right) = (request.left, request.right);
        self.target = None;
        self.was_started = true;
        let found = self.estimator.plane(request)?;
        let refused = TrackEstimate {
            status: found.status,
            reason: found.reason.clone(),
            warnings: warnings_of(&found),
            ..blank()
        };
        let sure = found.pose.filter(|_| found.status.depth_is_sure());
        let Some(plane) = sure.or_else(|| self.unsure_plane(&found)) else { return Ok(refused) };
        let has_time = request.deadline.may_continue();
        let how = Begin { request: has_time.then_some(&*request), known: model, must_be_surface: sure.is_none() };
        let mut estimate = self.begin((left, right), region, &plane, &how)?;
        estimate.warnings.splice(0..0, refused.warnings.iter().cloned());
        if sure.is_none() {
            let solid_pose = estimate.cam_left_from_model.filter(|_| estimate.status.depth_is_sure());
            let outside = solid_pose.and_then(|pose| self.surface_outside(&pose, range));
            if solid_pose.is_some() && outside.is_none() {
                return Ok(self.with_errors_of_plane(estimate, &found));
            }
            self.target = None;
            return Ok(TrackEstimate { reason: outside.unwrap_or(refused.reason), ..refused });
        }
        let is_worse = estimate.status == Status::Ok && found.status != Status::Ok;
        let (status, reason) =
            if is_worse { (found.status, found.reason.clone()) } else { (estimate.status, estimate.reason) };
        Ok(self.with_errors_of_plane(TrackEstimate { status, reason, ..estimate }, &found))
    }

    /// Reason if half of the recovered surface is nearer or farther than the depth range: from a wrong plane, a relief may
    /// reach a target outside the range.
    fn surface_outside(&self, pose: &Pose<CamLeft, Model>, range: &SearchRange) -> Option<String> {
        let depth_m = |point: &SurfacePoint| pose.transform_point(&point.position_in_model_m).z;
        let mut depths_m: Vec<f64> = self.surface().iter().map(depth_m).collect();
        depths_m.sort_unstable_by(f64::total_cmp);
        let z_m = *depths_m.get(depths_m.len() / 2)?;
        (!(range.z_min_m..=range.z_max_m).contains(&z_m)).then(|| {
            format!(
                "the fitted surface is {:.0} mm away, outside the depth range of {:.0} to {:.0} mm: widen it ({})",
                1e3 * z_m,
                1e3 * range.z_min_m,
                1e3 * range.z_max_m,
                Argument::DepthRange
            )
        })
    }

    /// The plane of a region that is not planar: a start value for its relief, which is then decisive.
    fn unsure_plane(&self, found: &PlaneEstimate) -> Option<PlanePose> {
        let is_no_plane = found.status == Status::NotObservable || found.warnings.contains(&EstimateWarning::NoPlane);
        let psi = found.psi.filter(|_| is_no_plane)?;
        let ray = self.rig.left().unproject(&found.centroid_px).ok()?;
        PlanePose::from_inverse_depth_plane(psi.inverse_depth_plane(&ray)?, &ray)
    }

    /// Initialises a new target from its plane, known to a few pixels of disparity.
    ///
    /// # Errors
    /// Images that do not match the calibration, or an unsuitable region.
    pub fn start_from_plane<'a>(
        &mut self,
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
        region: &Region,
        plane: &PlanePose,
    ) -> Result<TrackEstimate, EstimationError> {
        self.begin((left.into(), right.into()), region, plane, &Begin::default())
    }

    /// As [`Self::start_from_plane`].
    fn begin(
        &mut self,
        (left, right): (ImageView<'_>, ImageView<'_>),
        region: &Region,
        plane: &PlanePose,
        how: &Begin<'_, '_>,
    ) -> Result<TrackEstimate, EstimationError> {
        self.target = None;
        self.was_started = true;
        self.rig_at_rest = self.rig;
        check_image_sizes(&self.rig, left, right)?;
        let is_mixed = is_grey(left) != is_grey(right);
        self.images.iter_mut().for_each(|images| images.is_grey = is_mixed);
        let mask = region.rasterize(left, &self.region_config)?;
        let inner = mask.erode(self.erosion_px(&mask));
        // The origin is that of the region, also if only a part of it is followed.
        let centre_ray = self.rig.left().unproject(&mask.centroid_px().unwrap_or_default())?;
        let outline_px = region.outline_px(&mask);
        let q = plane.inverse_depth_plane;
        let Some(mut target) = self.first_target(left, right, &outline_px, [&mask, &inner], &centre_ray, q)? else {
            let reason = "the region has too little texture to track once its border is excluded".to_owned();
            return Ok(TrackEstimate { reason, ..blank() });
        };
        let pixels_whole = mask.area_px();
        let mut pixels = [mask, inner];
        let (mut is_part, mut share) = (false, 1.0);
        for round in 0..PARTS_MAX {
            let Some(part) = target.largest_part(round > 0) else { break };
            pixels = part.pixels(&target.surface.relief, &pixels, self.erosion_px(&pixels[0]) / 2);
            let [own, inside] = &pixels;
            let Some(next) = self.first_target(left, right, &outline_px, [own, inside], &centre_ray, part.plane)?
            else {
                let reason =
                    "the region contains several surfaces, each with too little texture to track: mark one of them";
                let reason = reason.to_owned();
                return Ok(TrackEstimate { reason, ..blank() });
            };
            target = next;
            (is_part, share) = (true, share * part.share);
        }
        if share < PART_MIN {
            return Ok(too_small_a_part(share));
        }
        if is_part && !target.is_curved() {
            // The part's plane was fitted to a relief that spans several surfaces.
            target.settle_on_plane(&self.frame());
        }
        if how.must_be_surface && !target.is_a_surface() {
            return Ok(blank());
        }
        if !self.place_model(&mut target, how) {
            let reason = "the region shows another surface than that of the target when it was followed: mark it again";
            return Ok(TrackEstimate { reason: reason.to_owned(), ..blank() });
        }
        self.load_both(left, right);
        let frame = self.frame();
        target.find_periods(&frame, &pixels[0]);
        target.find_ambiguous_views(&frame);
        self.remember(&target, left, right);
        let mut estimate = blank();
        self.target = Some(target);
        self.report(Ending::Found, &mut estimate);
        let pixels_followed = pixels[0].area_px();
        if pixels_followed < pixels_whole {
            let percent = 100.0 * pixels_followed as f64 / pixels_whole as f64;
            estimate.warnings.push(EstimateWarning::PartFollowed { percent });
        }
        Ok(estimate)
    }

    /// Places the frame `model` on the visible surface, or where it was before; `false` if that is elsewhere.
    fn place_model(&mut self, target: &mut Target, how: &Begin<'_, '_>) -> bool {
        let mut surface_plane = None;
        if let Some(request) = how.request.filter(|_| target.has_relief())
            && let Ok(Some(plane)) = self.estimator.plane_of_surface(request)
        {
            target.settle_on_surface(&self.frame(), &plane);
            surface_plane = Some(plane);
        }
        let surface_plane = surface_plane.filter(|_| target.is_on_surface);
        how.known.is_none_or(|known| target.restore_model(&self.frame(), known, surface_plane.as_ref()))
    }

    /// Width of the border that is excluded: less in a small region, which would lose most of its pixels.
    fn erosion_px(&self, region: &RegionMask) -> u32 {
        let share = EROSION_SHARE_MAX * (region.area_px() as f64).sqrt();
        self.config.erosion_px.min(share.round() as u32)
    }

    /// A target with points in the `inner` pixels of a region, near a plane; `None` if there are too few.
    fn first_target(
        &mut self,
        left: ImageView<'_>,
        right: ImageView<'_>,
        outline_px: &[Vector2<f64>],
        [mask, inner]: [&RegionMask; 2],
        centre_ray: &Vector3<f64>,
        q: Vector3<f64>,
    ) -> Result<Option<Target>, EstimationError> {
        let Some((surface, pose)) = self.first_surface(left, mask, inner, centre_ray, q)? else { return Ok(None) };
        let model_from_first = pose.inverse();
        let on_plane = |px: &Vector2<f64>| {
            let ray = self.rig.left().unproject(px).ok()?;
            let inverse_depth = q.dot(&ray);
            (inverse_depth > 0.0).then(|| model_from_first.transform_point(&Point3::from(ray / inverse_depth)))
        };
        let outline_in_model: Vec<Point3<f64>> = outline_px.iter().filter_map(on_plane).collect();
        self.load(left, right, &pose, &outline_in_model, MARGIN_START_PX);
        let frame = self.frame();
        Ok(Some(Target::first(surface, pose, outline_in_model, &frame, self.kernels)))
    }

    /// Points of the first left image, and the pose of the model frame; `None` if there are too few.
    fn first_surface(
        &mut self,
        left: ImageView<'_>,
        mask: &RegionMask,
        inner: &RegionMask,
        centre_ray: &Vector3<f64>,
        q: Vector3<f64>,
    ) -> Result<Option<FirstSurface>, EstimationError> {
        let Some(bounds) = mask.bbox() else { return Ok(None) };
        let window = PixelWindow {
            x: bounds.x as i32,
            y: bounds.y as i32,
            width: bounds.width as usize,
            height: bounds.height as usize,
        };
        self.images[0].update(left, window.grown(MARGIN_START_PX), self.kernels);
        let Some(pose) = model_frame(&q, centre_ray) else { return Ok(None) };
        let surface = Surface::choose(
            &self.images[0],
            inner,
            &self.rig,
            q,
            &pose,
            self.config.points,
            self.config.relief_sigma_px,
        );
        Ok((surface.points() >= POINTS_MIN).then_some((surface, pose)))
    }
}

fn too_small_a_part(share: f64) -> TrackEstimate {
    let (percent, limit) = (100.0 * share, 100.0 * PART_MIN);
    let reason =
        format!("only {percent:.0} % of the region is one surface (limit {limit:.0} %): mark one of its surfaces");
    TrackEstimate { status: Status::Ambiguous, reason, ..blank() }
}

/// Warnings of the cold start, without the planarity warning: a tracked surface need not be planar.
fn warnings_of(found: &PlaneEstimate) -> Vec<EstimateWarning> {
    found.warnings.iter().filter(|warning| **warning != EstimateWarning::NoPlane).cloned().collect()
}
