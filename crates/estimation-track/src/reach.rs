//! Plausibility of a candidate for a lost target.

use nalgebra::Point3;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use super::distinct::beyond_chance;
use super::judge::Fit;

/// Largest distance that a lost target may have moved, as a share of its distance from the camera, and the increase per second:
/// images do not show how large the world is. Chosen by hand, not varied: 50 mm and 2 m/s at half a metre. With more, other
/// objects are accepted; with less, a target that accelerates stays lost.
const REACH: f64 = 0.1;
const SPEED_MAX_PER_S: f64 = 4.0;
/// Largest angle that it may have rotated, radians (20 degrees), and the increase per second. Chosen by hand, not varied:
/// as for the distance.
const REACH_RAD: f64 = 0.35;
const SPEED_MAX_RAD_PER_S: f64 = 6.0;
/// Closer than this to the predicted pose, a candidate need not match better than noise allows: a share of the target's radius,
/// and of its distance from the camera. Chosen by hand, not varied: 20 mm for a square of 100 mm half a metre away. With more,
/// background near the target is accepted; with less, a poor image loses a target that coasts.
pub(super) const NEAR_RADII: f64 = 0.3;
const NEAR: f64 = 0.04;
/// Share of the way that the prediction moves the target, by which the target may be farther from it: a prediction errs by as much
/// as the velocity changes. Chosen by hand, not varied: half.
const NEAR_SHARE_OF_WAY: f64 = 0.5;
/// The same for the rotation. Chosen by hand, not varied: 9 degrees.
pub(super) const NEAR_RAD: f64 = 0.15;
/// Farther away, both images must correlate with the view by at least this. Chosen by hand, not varied: with less, other
/// texture is accepted; with more, a target in other light stays lost.
const AFAR_CORRELATION_MIN: f64 = 0.75;
/// Farther away, both images must show at least this share of its points as inliers. Chosen by hand, not varied: as for the
/// correlation; a target that is a third hidden is still found.
const AFAR_INLIERS_MIN: f64 = 0.65;
/// Farther away, the correlation must also exceed chance by this many standard deviations. Derived: a search tests some
/// hundred thousand positions, and chance exceeds 5 once in 3.5 million.
const BEYOND_CHANCE_MIN: f64 = 5.0;

/// A candidate for a lost target.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting<'a> {
    pub(super) fit: &'a Fit,
    /// Number of independent points of the target's texture.
    pub(super) independent: f64,
    /// Distance from the predicted pose, metres and radians.
    pub(super) way_m: f64,
    pub(super) turn_rad: f64,
    /// Distance within which the target is near the predicted pose, metres, see [`near_m`].
    pub(super) near_m: f64,
    /// Distance from the camera, metres.
    pub(super) distance_m: f64,
    /// Time since the target was last found, seconds.
    pub(super) away_s: f64,
    /// Whether a similar object is known.
    pub(super) has_twin: bool,
}

impl Sighting<'_> {
    /// Whether a target that was never lost can have moved there between two frames: a poor fit far from the predicted pose is
    /// another object, or a mirrored tilt.
    pub(super) fn can_have_moved(&self) -> bool {
        self.is_near() || self.is_clear()
    }

    /// Whether a target can have moved there from one frame to the next: not faster than anything moves, and where another one looks the
    /// same, not away from where it is expected. `step_s`: time between the frames, seconds; `None` if it is not known.
    pub(super) fn is_within_step(&self, step_s: Option<f64>) -> bool {
        let is_slow = step_s.is_none_or(|step_s| {
            self.way_m <= self.near_m.max(SPEED_MAX_PER_S * step_s * self.distance_m)
                && self.turn_rad <= NEAR_RAD.max(SPEED_MAX_RAD_PER_S * step_s)
        });
        is_slow && (self.is_near() || !self.has_twin)
    }

    /// Whether the target can have moved there since it was last found. Far from the predicted pose, the match must also be
    /// clear: noise is no excuse for a poor correlation there, and a target with little distinctive texture is not recognised
    /// there.
    pub(super) fn can_be_the_target(&self) -> bool {
        self.is_near() || self.is_within_reach() && self.is_clear() && !self.has_twin
    }

    /// Whether the candidate is either the target or its twin.
    pub(super) fn is_one_of_two(&self) -> bool {
        self.has_twin && self.is_within_reach() && self.is_clear()
    }

    fn is_within_reach(&self) -> bool {
        self.way_m <= reach(self.away_s) * self.distance_m && self.turn_rad <= reach_rad(self.away_s)
    }

    /// Whether a candidate away from the target could be mistaken for it.
    pub(super) fn is_another(&self) -> bool {
        self.way_m > self.near_m && self.is_clear()
    }

    /// Whether the candidate is near the predicted pose.
    pub(super) fn is_near(&self) -> bool {
        self.way_m <= self.near_m && self.turn_rad <= NEAR_RAD
    }

    fn is_clear(&self) -> bool {
        let lowest = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
        let (correlation, share) = (lowest(&self.fit.correlation), lowest(&self.fit.inlier_share));
        correlation >= AFAR_CORRELATION_MIN
            && share >= AFAR_INLIERS_MIN
            && beyond_chance(correlation, share, self.independent) >= BEYOND_CHANCE_MIN
    }
}

/// Largest distance that a lost target may have moved in this time, as a share of its distance from the camera.
pub(super) fn reach(away_s: f64) -> f64 {
    REACH + SPEED_MAX_PER_S * away_s
}

/// Largest angle that it may have rotated, radians.
pub(super) fn reach_rad(away_s: f64) -> f64 {
    REACH_RAD + SPEED_MAX_RAD_PER_S * away_s
}

/// Distance from the predicted pose within which a target of this radius and distance is near it, metres, if the prediction moves
/// it by `moved_m`.
pub(super) fn near_m(radius_m: f64, distance_m: f64, moved_m: f64) -> f64 {
    (NEAR_RADII * radius_m).min(NEAR * distance_m) + NEAR_SHARE_OF_WAY * moved_m
}

/// Share of an outline's points inside the image that contains fewer of them, whether occluded or not.
pub(super) fn in_sight(outline: &[Point3<f64>], pose: &Pose<CamLeft, Model>, rig: &StereoRig) -> f64 {
    let right_pose = *rig.cam_right_from_cam_left() * *pose;
    let cameras = [(rig.left(), pose.isometry()), (rig.right(), right_pose.isometry())];
    let shares = cameras.map(|(camera, cam_from_model)| {
        let (width, height) = (f64::from(camera.size().width), f64::from(camera.size().height));
        let inside = |point: &&Point3<f64>| {
            let px = camera.project(&(cam_from_model * **point));
            px.is_some_and(|px| (0.0..width).contains(&px.x) && (0.0..height).contains(&px.y))
        };
        outline.iter().filter(inside).count() as f64 / outline.len().max(1) as f64
    });
    shares[0].min(shares[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(correlation: f64, share: f64) -> Fit {
        Fit { correlation: [0.97, correlation], inlier_share: [0.95, share, 0.95], ..Fit::default() }
    }

    /// A target with a radius of 70 mm, half a metre away.
    fn sighting(fit: &Fit, way_m: f64, turn_rad: f64, away_s: f64) -> Sighting<'_> {
        let near_m = near_m(0.07, 0.5, 0.0);
        Sighting { fit, independent: 300.0, way_m, turn_rad, near_m, distance_m: 0.5, away_s, has_twin: false }
    }

    fn can_be(fit: &Fit, independent: f64, way_m: f64, turn_rad: f64, away_s: f64) -> bool {
        Sighting { independent, ..sighting(fit, way_m, turn_rad, away_s) }.can_be_the_target()
    }

    #[test]
    fn a_world_ten_times_as_large_is_judged_alike() {
        let (poor, clear) = (fit(0.5, 0.5), fit(0.97, 0.95));
        for (fit, way_m) in [(&poor, 0.019), (&poor, 0.022), (&clear, 0.11), (&clear, 0.12)] {
            let small = sighting(fit, way_m, 0.1, 0.033);
            let near_m = near_m(0.7, 5.0, 0.0);
            let large = Sighting { way_m: 10.0 * way_m, near_m, distance_m: 5.0, ..small };
            assert_eq!(small.can_be_the_target(), large.can_be_the_target(), "{way_m}");
            assert_eq!(small.is_another(), large.is_another(), "{way_m}");
        }
    }

    #[test]
    fn near_is_less_for_a_small_target_and_more_for_a_fast_one() {
        assert!(near_m(0.01, 0.5, 0.0) < 0.004 && near_m(0.5, 0.5, 0.0) <= 0.02);
        assert!(near_m(0.01, 0.5, 0.02) > near_m(0.01, 0.5, 0.0) + 0.009);
    }

    #[test]
    fn where_it_is_expected_noise_may_hide_much_of_it() {
        assert!(can_be(&fit(0.5, 0.5), 5.0, 0.01, 0.1, 0.03));
        assert!(!can_be(&fit(0.5, 0.9), 300.0, 0.03, 0.1, 0.03));
        assert!(!can_be(&fit(0.9, 0.5), 300.0, 0.01, 0.2, 0.03));
    }

    #[test]
    fn it_is_not_believed_to_fly() {
        let clear = fit(0.97, 0.95);
        assert!(can_be(&clear, 300.0, 0.1, 0.5, 0.033));
        assert!(!can_be(&clear, 300.0, 0.2, 0.1, 0.033));
        assert!(!can_be(&clear, 300.0, 0.1, 1.0, 0.033));
        assert!(can_be(&clear, 300.0, 0.2, 1.0, 0.3), "with time it may have come there");
    }

    #[test]
    fn nothing_jumps_between_two_frames() {
        let clear = fit(0.97, 0.95);
        let within = |way_m, turn_rad, step_s| sighting(&clear, way_m, turn_rad, 0.0).is_within_step(step_s);
        let frame = Some(1.0 / 30.0);
        assert!(within(0.06, 0.05, frame) && !within(0.12, 0.05, frame), "2 m/s at half a metre");
        assert!(within(0.01, 0.15, frame) && !within(0.01, 0.3, frame), "344 degrees per second");
        assert!(within(0.12, 0.3, Some(0.1)), "few frames per second");
        assert!(within(0.12, 0.3, None), "without times nothing is known");
        let beside_a_twin =
            |way_m| Sighting { has_twin: true, ..sighting(&clear, way_m, 0.05, 0.0) }.is_within_step(frame);
        assert!(beside_a_twin(0.01) && !beside_a_twin(0.06));
    }

    #[test]
    fn what_fits_poorly_has_not_moved_far_in_a_frame() {
        let moved = |fit: &Fit, way_m, turn_rad| sighting(fit, way_m, turn_rad, 0.0).can_have_moved();
        assert!(moved(&fit(0.7, 0.6), 0.01, 0.05), "half hidden");
        assert!(!moved(&fit(0.7, 0.6), 0.01, 0.6) && !moved(&fit(0.7, 0.6), 0.06, 0.05));
        assert!(moved(&fit(0.97, 0.95), 0.06, 0.6), "few frames per second");
    }

    #[test]
    fn a_target_with_a_twin_is_believed_only_where_it_is_expected() {
        let clear = fit(0.97, 0.95);
        let sighting_at = |way_m| Sighting { has_twin: true, ..sighting(&clear, way_m, 0.0, 0.1) };
        assert!(sighting_at(0.01).can_be_the_target() && !sighting_at(0.1).can_be_the_target());
        assert!(sighting_at(0.1).is_another() && !sighting_at(0.01).is_another());
    }

    #[test]
    fn smooth_texture_is_not_distinguished_from_other_smooth_texture() {
        for independent in [2.0, 8.0, 13.0] {
            assert!(!can_be(&fit(0.94, 0.75), independent, 0.1, 0.3, 0.2), "{independent}");
        }
        assert!(can_be(&fit(0.97, 0.95), 17.0, 0.1, 0.3, 0.2));
    }
}
