//! The law with feed-forward in a closed loop without images: no lag behind a moving target, no overshoot, and no velocity step
//! at start and stop.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use std::f64::consts::TAU;

use crate::common::{Cell, Plant, config, feed_forward, feed_forward_config, published, rotation};
use nalgebra::Vector3;
use pb3dp_computing::rng::SplitMix64;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Model};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::{
    ArmResponse, Command, ControlStep, ControllerConfig, FeedForwardConfig, FeedForwardGains, Gains, HoldReason,
    LawConfig, Limitation, Mode, ObservationVerdict,
};

/// 20 ms of dead time and 30 ms of lag, in steps of 2 ms.
const PLANT: Plant = Plant { delay_steps: 10, lag_s: 0.03 };
const ARM: ArmResponse = ArmResponse { delay_s: 0.02, lag_s: 0.03 };
/// Time from exposure to arrival.
const LATENCY_S: f64 = 0.05;

/// Target pose for the start pose of the hand.
fn home(cell: &Cell) -> Pose<Base, Model> {
    cell.target_for_hand_moved(Vector3::zeros(), rotation(0.0, 0.0, 0.0))
}

/// A target that swings by 60 mm and 0.15 rad with a period of 4 s, with a soft start after 1 s at rest.
fn swinging(home: &Pose<Base, Model>, elapsed_s: f64) -> Pose<Base, Model> {
    let t = (elapsed_s - 1.0).max(0.0);
    let size = (1.0 - (-t).exp()) * (TAU * t / 4.0).sin();
    let position = home.translation_m() + Vector3::new(0.02, 0.05, -0.025) * size;
    Pose::from_parts(position, rotation(0.1 * size, -0.08 * size, 0.07 * size) * home.rotation())
}

/// Position error (m) and orientation error (rad) of the hand.
fn off(cell: &Cell, target: &Pose<Base, Model>) -> (f64, f64) {
    let desired = *target * cell.config.model_from_hand_desired;
    let hand = cell.base_from_hand();
    ((desired.translation_m() - hand.translation_m()).norm(), desired.rotation().angle_to(&hand.rotation()))
}

/// Largest errors between two times of a run with the swinging target.
fn errors_before_the_swing(config: ControllerConfig, from_s: f64, to_s: f64) -> (f64, f64) {
    let mut cell = Cell::new(config, PLANT, LATENCY_S);
    let home = home(&cell);
    let mut worst = (0.0f64, 0.0f64);
    while cell.time_s < 5.0 + to_s {
        let target = swinging(&home, cell.time_s - 5.0);
        if cell.time_s > 5.0 + from_s {
            let (position, angle) = off(&cell, &target);
            worst = (worst.0.max(position), worst.1.max(angle));
        }
        cell.step(&target);
    }
    worst
}

/// The published law, with the gain for this arm and camera, lags by 0.27 s, which is 23 mm at 85 mm/s.
#[test]
fn a_moving_target_is_followed_without_lag() {
    let (position, angle) = errors_before_the_swing(feed_forward_config(feed_forward(ARM)), 5.0, 13.0);
    assert!(position < 0.0015 && angle < 0.003, "{position} m, {angle} rad");
    let law = LawConfig::Published(published(Gains::without_overshoot(0.1)));
    let (published, _) = errors_before_the_swing(ControllerConfig { law, ..config() }, 5.0, 13.0);
    assert!(published > 0.015, "{published} m");
}

/// Without a model of the arm the hand lags by delay and lag, and without the inversion of the lag by the lag.
#[test]
fn the_stated_arm_lag_is_the_one_that_removes_it() {
    let error = |arm: ArmResponse| {
        // A small gain makes the errors of the feed-forward visible.
        let gains = FeedForwardGains { position_per_s: 4.0, orientation_per_s: 4.0, ..FeedForwardGains::of(&ARM) };
        let law = FeedForwardConfig { arm, gains, ..feed_forward(ARM) };
        errors_before_the_swing(feed_forward_config(law), 5.0, 13.0).0
    };
    let right = error(ARM);
    let no_delay = error(ArmResponse { delay_s: 0.0, ..ARM });
    let nothing = error(ArmResponse { delay_s: 0.0, lag_s: 0.0 });
    assert!(no_delay > 1.2 * right && nothing > 1.7 * right, "{right} {no_delay} {nothing}");
}

/// Largest overshoot of the hand, as a share of the initial error.
fn overshoot(arm: ArmResponse, gain_per_s: f64) -> f64 {
    let mut law = feed_forward(arm);
    law.gains.position_per_s = gain_per_s;
    law.gains.orientation_per_s = gain_per_s;
    // Accurate observations, and almost no initial velocity in the filter: the loop overshoots, not the prediction.
    law.target.linear.start_velocity_sigma_per_s = 1e-4;
    law.target.angular.start_velocity_sigma_per_s = 1e-4;
    let mut cell = Cell::new(feed_forward_config(law), PLANT, LATENCY_S);
    let by = Vector3::new(0.02, -0.01, 0.015);
    let target = cell.target_for_hand_moved(by, rotation(0.0, 0.0, 0.0));
    let begin = cell.base_from_hand().translation_m();
    let mut farthest = 0.0f64;
    for _ in 0..1500 {
        cell.step(&target);
        let gone = (cell.base_from_hand().translation_m() - begin).dot(&by) / by.norm_squared();
        farthest = farthest.max(gone);
    }
    farthest - 1.0
}

#[test]
fn delay_and_lag_are_compensated_and_the_default_gain_bears_half_of_them_unknown() {
    // Five times the largest gain without overshoot and without compensation (7.4), and above pi / (2 T) = 31.
    let known = overshoot(ARM, 40.0);
    assert!(known < 0.01, "{known}");
    let nothing = ArmResponse { delay_s: 0.0, lag_s: 0.0 };
    let unknown = overshoot(nothing, 40.0);
    assert!(unknown > 0.05, "{unknown}");
    let slow = Gains::without_overshoot(ARM.delay_s + ARM.lag_s).position_per_s;
    let unknown = overshoot(nothing, slow);
    assert!(unknown < 0.01, "{unknown}");
    // A model with 0.5 and 1.5 times the true delay and lag.
    for factor in [0.5, 1.5] {
        let arm = ArmResponse { delay_s: factor * ARM.delay_s, lag_s: factor * ARM.lag_s };
        let wrong = overshoot(arm, ARM.gain_without_overshoot());
        assert!(wrong < 0.02, "{factor}: {wrong}");
    }
}

/// Largest change of a commanded joint speed from one step to the next, rad/s.
#[derive(Default)]
struct Changes {
    last: Option<JointVector>,
    largest: f64,
}

impl Changes {
    fn note(&mut self, step: &ControlStep) {
        let now = match step.command {
            Command::Velocity(velocity) => velocity,
            Command::Hold => JointVector::zeros(),
        };
        if let Some(last) = self.last {
            self.largest = self.largest.max((now - last).amax());
        }
        self.last = Some(now);
    }
}

/// The target already moves at the first observation: the hand accelerates softly, arrives, and follows, without a step.
#[test]
fn lock_start_and_arrival_make_no_step() {
    let mut config = feed_forward_config(feed_forward(ARM));
    config.speed.soft_start_s = 0.5;
    config.approach.speed.linear_m_per_s = 0.06;
    config.approach.done_within_m = 0.02;
    config.approach.done_within_rad = 0.1;
    let mut cell = Cell::new(config, PLANT, LATENCY_S);
    let home = cell.target_for_hand_moved(Vector3::new(0.06, -0.08, 0.05), rotation(0.05, 0.0, 0.1));
    let (mut changes, mut modes) = (Changes::default(), Vec::new());
    let mut first = None;
    while cell.time_s < 12.0 {
        let target = swinging(&home, cell.time_s - 5.0 + 2.3);
        let step = cell.step(&target);
        if let Command::Velocity(velocity) = step.command {
            first.get_or_insert((velocity, step.limited_by));
        }
        changes.note(&step);
        if modes.last() != Some(&step.mode) {
            modes.push(step.mode);
        }
    }
    assert_eq!(first, Some((JointVector::zeros(), Some(Limitation::SoftStart))));
    assert_eq!(modes, [Mode::Idle, Mode::Locking, Mode::Approaching, Mode::Tracking]);
    // The target's own acceleration is 0.2 m/s^2; with 0.8 m/s^2 of corrections that is about 2 rad/s^2, 0.004 rad/s a step; new
    // images correct the prediction at once.
    assert!(changes.largest < 0.03, "{} rad/s", changes.largest);
    let (position, _) = off(&cell, &swinging(&home, cell.time_s - 5.0 + 2.3));
    assert!(position < 0.002, "{position}");
}

#[test]
fn a_target_that_is_no_longer_visible_is_followed_more_slowly_until_the_hand_holds() {
    let mut config = feed_forward_config(feed_forward(ARM));
    config.speed.soft_start_s = 0.4;
    let mut cell = Cell::new(config, PLANT, LATENCY_S);
    let home = home(&cell);
    while cell.time_s < 10.9 {
        let target = swinging(&home, cell.time_s - 5.0);
        cell.step(&target);
    }
    let observed_at = cell.newest.unwrap().at;
    let mut changes = Changes::default();
    let mut fading = 0;
    let last = loop {
        let step = cell.step_controller();
        changes.note(&step);
        fading += usize::from(step.limited_by == Some(Limitation::Fading));
        if let Mode::Holding(reason) = step.mode {
            break reason;
        }
        assert_eq!(step.mode, Mode::Tracking);
    };
    assert!(matches!(last, HoldReason::ObservationStale { age_s } if (0.3..0.305).contains(&age_s)), "{last:?}");
    assert!((70..=76).contains(&fading), "slower from 0.15 to 0.3 s: {fading} steps of 2 ms");
    assert!(changes.largest < 0.01, "step of {} rad/s", changes.largest);
    assert!(cell.now().seconds_since(observed_at) > 0.3);
    // Observed again during the deceleration: the hand accelerates softly.
    let mut cell = Cell::new(config, PLANT, LATENCY_S);
    let mut changes = Changes::default();
    while cell.time_s < 14.0 {
        let target = swinging(&home, cell.time_s - 5.0);
        let is_blind = (10.9..11.08).contains(&cell.time_s);
        let step = if is_blind { cell.step_controller() } else { cell.step(&target) };
        if cell.time_s > 10.9 {
            changes.note(&step);
            assert_eq!(step.mode, Mode::Tracking);
        }
    }
    assert!(changes.largest < 0.05, "{} rad/s", changes.largest);
}

/// An estimator that does not measure the rotation about the normal holds it in the image: in `base` it follows the hand.
#[test]
fn a_rotation_that_is_not_observed_does_not_lead_the_hand() {
    let mut cell = Cell::new(feed_forward_config(feed_forward(ARM)), PLANT, LATENCY_S);
    let home = home(&cell);
    let about_normal = |cell: &Cell, target: &Pose<Base, Model>| {
        let desired = *target * cell.config.model_from_hand_desired;
        let axis = target.transform_vector(&Vector3::z());
        (cell.base_from_hand().rotation() * desired.rotation().inverse()).scaled_axis().dot(&axis)
    };
    let mut in_flight = std::collections::VecDeque::new();
    let (mut exposures, mut farthest, mut worst) = (0u32, 0.0f64, 0.0f64);
    let mut random = SplitMix64::new(7);
    while cell.time_s < 35.0 {
        let target = swinging(&home, cell.time_s - 5.0);
        if cell.time_s - 5.0 + 1e-9 >= f64::from(exposures) / 30.0 {
            exposures += 1;
            let mut measured = cell.observe(&target);
            // The rotation of the first image is kept, with some noise.
            let turned = about_normal(&cell, &target) + random.between(-0.01, 0.01);
            let about = rotation(0.0, 0.0, turned);
            measured.cam_left_from_model = Pose::from_parts(
                measured.cam_left_from_model.translation_m(),
                measured.cam_left_from_model.rotation() * about,
            );
            (measured.covariance, measured.observed[5]) = (None, false);
            in_flight.push_back(measured);
        }
        let now = cell.now();
        while in_flight
            .front()
            .is_some_and(|measured: &pb3dp_servo::TargetObservation| now.seconds_since(measured.at) >= LATENCY_S)
        {
            cell.newest = in_flight.pop_front();
        }
        let step = cell.step_controller();
        assert!(
            step.observation == ObservationVerdict::Accepted || step.observation == ObservationVerdict::NoneNew,
            "{step:?}"
        );
        farthest = farthest.max(about_normal(&cell, &target).abs());
        if cell.time_s > 12.0 {
            let desired = target * cell.config.model_from_hand_desired;
            worst = worst.max((desired.translation_m() - cell.base_from_hand().translation_m()).norm());
        }
    }
    // The target itself rotates by 0.07 rad about the normal, and more about nearby axes, which is not observed.
    assert!(farthest < 0.25, "turned away by {farthest} rad");
    assert!(worst < 0.05, "{worst} m");
}

#[test]
fn an_invalid_covariance_and_an_outlier_are_reported_and_not_used() {
    let mut cell = Cell::new(feed_forward_config(feed_forward(ARM)), PLANT, LATENCY_S);
    let home = home(&cell);
    for _ in 0..300 {
        cell.step(&home);
    }
    let mut bad = cell.observe(&home);
    bad.covariance = bad.covariance.map(|covariance| -covariance);
    let step = cell.controller.step(&cell.joints, Some(&bad), cell.now());
    assert_eq!((step.observation, step.mode), (ObservationVerdict::BadCovariance, Mode::Tracking));
    cell.step_controller();
    let far = Pose::from_parts(home.translation_m() + Vector3::new(0.0, 0.05, 0.0), home.rotation());
    let step = cell.controller.step(&cell.joints, Some(&cell.observe(&far)), cell.now());
    assert!(
        matches!(step.observation, ObservationVerdict::Outlier { distance_squared } if distance_squared > 40.0),
        "{step:?}"
    );
    assert_eq!(step.mode, Mode::Tracking);
    let (position, _) = off(&cell, &home);
    assert!(position < 1e-4, "{position}");
}
