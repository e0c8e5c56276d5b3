//! Looking at more than the target's window: for a lost target, for others that look the same, and at the visible surface.

use nalgebra::{Point3, Vector2};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;

use super::DirectTracker;
use crate::predict::Expected;
use crate::target::{Ending, Target};
use crate::visible_planes::{VisiblePlane, visible_planes};

/// Depths at which a later pair looks for the surface, as shares of the distance of the target, and its largest tilt. Chosen by hand, not varied:
/// a relief of a fifth of the distance.
const SURFACE_DEPTHS: [f64; 2] = [0.8, 1.25];
const SURFACE_TILT_MAX_RAD: f64 = 1.2;

/// A lost target is searched up to this factor nearer and farther than it was last and first seen. Chosen by hand, not varied: more than
/// between two frames, and not so much that chance has room.
const SEARCHED_FACTOR: f64 = 2.0;
/// The planes of the whole pair are searched once in this time, seconds, and in each pair if the times are not known. Chosen by hand, not varied:
/// a search takes longer than the other work on a lost frame, which at 30 frames per second has time for it in the next two.
const PLANES_EVERY_S: f64 = 0.1;

impl DirectTracker {
    /// Searches a lost target in a pair, the time `step_s` after the last one. If it is found where it was not expected, it must be the only
    /// one that looks so.
    pub(super) fn search(
        &mut self,
        target: &mut Target,
        (expected, step_s): (&Expected, Option<f64>),
        (left, right): (ImageView<'_>, ImageView<'_>),
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Ending {
        self.load_both(left, right);
        let before = target.estimate;
        let searches = |at_s: f64| (at_s / PLANES_EVERY_S + 1e-6).floor();
        let is_due = target.away_s.is_infinite()
            || step_s.is_none_or(|step_s| searches(target.away_s) > searches(target.away_s - step_s));
        let planes = if is_due && may_continue() { self.visible_planes(target, (left, right)) } else { Vec::new() };
        let frame = self.frame();
        let ending = target.search(expected, &planes, &frame, may_continue);
        if ending != Ending::Found || target.is_near(&expected.pose) {
            return ending;
        }
        target.look_everywhere(&frame, may_continue);
        if target.has_twin {
            (target.estimate, target.is_unverified) = (before, false);
            return Ending::OneOfSeveral;
        }
        ending
    }

    /// The planes on which a lost target may be.
    fn visible_planes(&mut self, target: &Target, (left, right): (ImageView<'_>, ImageView<'_>)) -> Vec<VisiblePlane> {
        let first = &target.views[0].cam_left_from_model;
        let [last_z_m, first_z_m] = [&target.motion.cam_left_from_model, first].map(|pose| pose.translation_m().z);
        let [z_min_m, z_max_m] = [last_z_m.min(first_z_m) / SEARCHED_FACTOR, last_z_m.max(first_z_m) * SEARCHED_FACTOR];
        let range = SearchRange { z_min_m, z_max_m, tilt_max_rad: SURFACE_TILT_MAX_RAD };
        let region = Region::Rectangle { x: 0, y: 0, width: left.width(), height: left.height() };
        let points = self.estimator.coarse_points(&EstimateRequest::new_target(left, right, &region, &range));
        visible_planes(&points.unwrap_or_default(), target.surface.radius_m, last_z_m)
    }

    /// Looks for others like the target that was found in this frame. The right image is needed only where the left one shows something alike.
    pub(super) fn look_around(
        &mut self,
        target: &mut Target,
        (left, right): (ImageView<'_>, ImageView<'_>),
        may_continue: &mut dyn FnMut() -> bool,
    ) {
        self.load_whole(0, left);
        let others = target.look_around(&self.frame());
        for (count, other) in others.into_iter().flatten().enumerate() {
            if count == 0 {
                self.load_whole(1, right);
            }
            target.examine_other(other, &self.frame(), may_continue);
        }
    }

    /// Looks at the surface of the target that was found in this pair.
    pub(super) fn look_at_surface(&mut self, target: &mut Target, (left, right): (ImageView<'_>, ImageView<'_>)) {
        let pose = target.estimate.cam_left_from_model;
        let (width, height) = (f64::from(left.width() - 1), f64::from(left.height() - 1));
        let in_image = |point: &Point3<f64>| {
            let px = self.rig.left().project(&pose.transform_point(point))?;
            ((0.0..=width).contains(&px.x) && (0.0..=height).contains(&px.y)).then_some(px)
        };
        // A part of the region has another plane than the whole.
        let outline: Option<Vec<Vector2<f64>>> = target.outline_in_model.iter().map(in_image).collect();
        let Some(vertices_px) = outline else { return };
        let [z_min_m, z_max_m] = SURFACE_DEPTHS.map(|share| share * pose.translation_m().z);
        let range = SearchRange { z_min_m, z_max_m, tilt_max_rad: SURFACE_TILT_MAX_RAD };
        let region = Region::Polygon { vertices_px };
        let surface = self.estimator.plane_of_surface(&EstimateRequest::new_target(left, right, &region, &range));
        target.take_surface(surface.ok().flatten().as_ref());
    }
}
