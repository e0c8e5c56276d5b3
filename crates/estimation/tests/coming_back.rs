//! A target that comes back after it was hidden: elsewhere, turned in all ways, nearer or farther.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_geometry::{Pose, StereoRig, so3};

use crate::moving_plane::{Disc, Shot, plane, region_of, render_discs, vga_rig};

/// Largest error of a pose that is `ok`, millimetres and degrees.
const DISTANCE_MAX_MM: f64 = 0.2;
const ANGLE_MAX_DEG: f64 = 0.2;

const DISC: Disc = Disc { radius_m: 0.08, fineness: 0.5 };

fn first() -> Pose<CamLeft, Target> {
    Pose::from_parts(Vector3::new(-0.03, 0.02, 0.5), so3::exp(&Vector3::new(0.15, -0.2, 0.1)))
}

/// Poses within 30 degrees and 0.6 to 1.7 of the first distance, in other parts of the image.
fn returns() -> [Pose<CamLeft, Target>; 6] {
    let at = |x, y, z, turn: [f64; 3]| Pose::from_parts(Vector3::new(x, y, z), so3::exp(&turn.into()));
    [
        at(0.06, -0.04, 0.55, [-0.2, 0.1, 0.25]),
        at(-0.09, -0.05, 0.68, [0.3, -0.25, 0.5]),
        at(0.05, 0.03, 0.36, [0.2, 0.15, -0.25]),
        at(0.1, 0.06, 0.7, [0.1, -0.45, -0.2]),
        at(0.04, -0.03, 0.4, [0.45, -0.1, -0.1]),
        at(-0.02, 0.05, 0.6, [-0.25, -0.3, 0.35]),
    ]
}

/// A tracker whose target is hidden.
struct Hidden {
    rig: StereoRig,
    tracker: DirectTracker,
    target_from_model: Pose<Target, Model>,
    prior: FramePrior,
    frame: u32,
}

impl Hidden {
    /// The target is hidden for some pairs after it was marked.
    fn for_pairs(pairs: u32, dt_s: Option<f64>) -> Self {
        let rig = vga_rig(1.0);
        let (left, right) = shot(&rig, &[first()], 0);
        let mut tracker =
            DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
        let region = region_of(&DISC, &rig, &first());
        let started = tracker.start_from_plane(&left, &right, &region, &plane(&first())).expect("start");
        let target_from_model = first().inverse() * started.cam_left_from_model.expect("a pose");
        let prior = FramePrior { dt_s, ..FramePrior::default() };
        let mut hidden = Self { rig, tracker, target_from_model, prior, frame: 0 };
        for _ in 0..pairs {
            assert_eq!(hidden.answer(None, 0).0.status, Status::Lost, "frame {}", hidden.frame);
        }
        hidden
    }

    /// The answer to the next pair, in which a strip of `covered_px` hides the left side of the target, and its error, millimetres and
    /// degrees.
    fn answer(&mut self, target: Option<&Pose<CamLeft, Target>>, covered_px: u32) -> (TrackEstimate, [f64; 2]) {
        self.frame += 1;
        let discs: Vec<_> = target.copied().into_iter().collect();
        let (mut left, mut right) = shot(&self.rig, &discs, self.frame);
        if let Some(pose) = target {
            let Region::Polygon { vertices_px } = region_of(&DISC, &self.rig, pose) else { panic!("a polygon") };
            let from = vertices_px.iter().map(|px| px.x).fold(f64::INFINITY, f64::min) as u32;
            let full_px = self.rig.left().pinhole().fx * self.rig.baseline_m() / pose.translation_m().z;
            let from_right =
                (f64::from(from) - full_px + self.rig.right().pinhole().cx - self.rig.left().pinhole().cx) as u32;
            for (image, from) in [(&mut left, from), (&mut right, from_right)] {
                let strip = (from..from + covered_px).flat_map(|x| (0..480).map(move |y| (x, y)));
                strip.for_each(|(x, y)| image.put_pixel(x, y, Rgb([90, 90, 90])));
            }
        }
        let found = self.tracker.estimate(EstimateRequest::next_frame(&left, &right, &self.prior)).expect("update");
        let error = found.cam_left_from_model.zip(target).map_or([f64::INFINITY; 2], |(pose, target)| {
            let error = (*target * self.target_from_model).inverse() * pose;
            [1e3 * error.translation_m().norm(), error.rotation_angle_rad().to_degrees()]
        });
        (found, error)
    }
}

fn shot(rig: &StereoRig, discs: &[Pose<CamLeft, Target>], frame: u32) -> (RgbImage, RgbImage) {
    render_discs(rig, &DISC, discs, &Shot { cam_left_from_target: None, frame, right_gain: 0.9 })
}

/// Stills have no times, and a recording with few pairs per second has long ones: one pair is enough.
#[test]
fn a_target_that_comes_back_turned_and_at_another_distance_is_found_in_its_first_pair() {
    for (index, pose) in returns().iter().enumerate() {
        for (hidden, dt_s) in [(1, None), (2, Some(0.2))] {
            let (found, [mm, deg]) = Hidden::for_pairs(hidden, dt_s).answer(Some(pose), 0);
            assert_eq!(found.status, Status::Ok, "pose {index}, {dt_s:?}: {}", found.reason);
            assert!(mm < DISTANCE_MAX_MM && deg < ANGLE_MAX_DEG, "pose {index}: {mm} mm, {deg} degrees");
        }
    }
}

/// At the rate of a video nothing flies: what a pair shows farther away than a target can have moved is not believed.
#[test]
fn a_target_of_a_video_does_not_jump_across_the_image() {
    let (found, _) = Hidden::for_pairs(1, Some(1.0 / 30.0)).answer(Some(&returns()[3]), 0);
    assert_eq!(found.status, Status::Lost, "{}", found.reason);
}

/// A pair that does not show all of the target could show another one: the next has to confirm it.
#[test]
fn a_target_that_comes_back_half_hidden_is_confirmed_by_the_next_pair() {
    let mut hidden = Hidden::for_pairs(2, Some(0.2));
    let to = returns()[0];
    let (found, [mm, deg]) = hidden.answer(Some(&to), 40);
    assert_eq!(found.status, Status::Ambiguous, "{}", found.reason);
    assert!(found.reason.contains("the next pair has to confirm it"), "{}", found.reason);
    assert!(mm < DISTANCE_MAX_MM && deg < ANGLE_MAX_DEG, "{mm} mm, {deg} degrees");
    let (confirmed, _) = hidden.answer(Some(&to), 40);
    assert_eq!(confirmed.status, Status::Ok, "{}", confirmed.reason);
}
