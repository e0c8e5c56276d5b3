//! Plausibility of a candidate for a lost target.

use nalgebra::Point3;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use super::distinct::beyond_chance;
use super::judge::Fit;

/// Largest distance that a lost target may have moved, metres, and the increase per second. Chosen by hand, not varied:
/// with more, other objects are accepted; with less, a target that accelerates stays lost.
const REACH_M: f64 = 0.05;
const SPEED_MAX_M_PER_S: f64 = 2.0;
/// Largest angle that it may have rotated, radians (20 degrees), and the increase per second. Chosen by hand, not varied:
/// as for the distance.
const REACH_RAD: f64 = 0.35;
const SPEED_MAX_RAD_PER_S: f64 = 6.0;
/// Closer than this to the predicted pose, a candidate need not match better than noise allows. Chosen by hand, not varied:
/// with more, background near the target is accepted; with less, a poor image loses a target that coasts.
pub(super) const NEAR_M: f64 = 0.02;
/// The same for the rotation. Chosen by hand, not varied: 9 degrees.
const NEAR_RAD: f64 = 0.15;
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
        self.way_m <= REACH_M + SPEED_MAX_M_PER_S * self.away_s
            && self.turn_rad <= REACH_RAD + SPEED_MAX_RAD_PER_S * self.away_s
    }

    /// Whether a candidate away from the target could be mistaken for it.
    pub(super) fn is_another(&self) -> bool {
        self.way_m > NEAR_M && self.is_clear()
    }

    fn is_near(&self) -> bool {
        self.way_m <= NEAR_M && self.turn_rad <= NEAR_RAD
    }

    fn is_clear(&self) -> bool {
        let lowest = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
        let (correlation, share) = (lowest(&self.fit.correlation), lowest(&self.fit.inlier_share));
        correlation >= AFAR_CORRELATION_MIN
            && share >= AFAR_INLIERS_MIN
            && beyond_chance(correlation, share, self.independent) >= BEYOND_CHANCE_MIN
    }
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

    fn can_be(fit: &Fit, independent: f64, way_m: f64, turn_rad: f64, away_s: f64) -> bool {
        Sighting { fit, independent, way_m, turn_rad, away_s, has_twin: false }.can_be_the_target()
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
    fn what_fits_poorly_has_not_moved_far_in_a_frame() {
        let moved = |fit: &Fit, way_m, turn_rad| {
            Sighting { fit, independent: 300.0, way_m, turn_rad, away_s: 0.0, has_twin: false }.can_have_moved()
        };
        assert!(moved(&fit(0.7, 0.6), 0.01, 0.05), "half hidden");
        assert!(!moved(&fit(0.7, 0.6), 0.01, 0.6) && !moved(&fit(0.7, 0.6), 0.06, 0.05));
        assert!(moved(&fit(0.97, 0.95), 0.06, 0.6), "few frames per second");
    }

    #[test]
    fn a_target_with_a_twin_is_believed_only_where_it_is_expected() {
        let clear = fit(0.97, 0.95);
        let seen =
            |way_m| Sighting { fit: &clear, independent: 300.0, way_m, turn_rad: 0.0, away_s: 0.1, has_twin: true };
        assert!(seen(0.01).can_be_the_target() && !seen(0.1).can_be_the_target());
        assert!(seen(0.1).is_another() && !seen(0.01).is_another());
    }

    #[test]
    fn smooth_texture_is_not_told_from_other_smooth_texture() {
        for independent in [2.0, 8.0, 13.0] {
            assert!(!can_be(&fit(0.94, 0.75), independent, 0.1, 0.3, 0.2), "{independent}");
        }
        assert!(can_be(&fit(0.97, 0.95), 17.0, 0.1, 0.3, 0.2));
    }
}
