//! Looking at more than the target's window: for a lost target, for others that look the same, and at the visible surface.

use nalgebra::{Point3, Vector2};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;

use super::DirectTracker;
use crate::predict::Expected;
use crate::target::{Ending, Target};

/// Longest time after which a pair confirms that the target was found elsewhere, seconds. Chosen by hand, not varied: a motion is foreseen so long.
const CONFIRMED_WITHIN_S: f64 = 0.25;

/// Depths at which a later pair looks for the surface, as shares of the distance of the target, and its largest tilt. Chosen by hand, not varied:
/// a relief of a fifth of the distance.
const SURFACE_DEPTHS: [f64; 2] = [0.8, 1.25];
const SURFACE_TILT_MAX_RAD: f64 = 1.2;

impl DirectTracker {
    /// Searches a lost target in a pair, the time `step_s` after the last one. If it is found where it was not expected, it must be the only
    /// one that looks so, and the next pair must confirm it.
    pub(super) fn search(
        &mut self,
        target: &mut Target,
        (expected, step_s): (&Expected, Option<f64>),
        (left, right): (ImageView<'_>, ImageView<'_>),
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Ending {
        self.load_both(left, right);
        let frame = self.frame();
        let before = target.estimate;
        let ending = target.search(expected, &frame, may_continue);
        if ending != Ending::Found || !target.is_unverified {
            return ending;
        }
        target.look_everywhere(&frame, may_continue);
        if target.has_twin {
            (target.estimate, target.is_unverified) = (before, false);
            return Ending::OneOfSeveral;
        }
        // A pair long after confirms nothing.
        target.is_unverified = step_s.is_some_and(|step_s| step_s <= CONFIRMED_WITHIN_S);
        ending
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
