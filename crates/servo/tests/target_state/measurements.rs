//! Late, missing, repeated, wrong and invalid measurements.

use nalgebra::{Matrix6, Vector3, Vector6};
use pb3dp_allocation_count::requests;
use pb3dp_geometry::frames::{Base, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose, so3};
use pb3dp_servo::{MeasurementVerdict, NotPredictable, PoseMeasurement, Prediction, TargetState, TargetStateConfig};
use proptest::prelude::*;

use super::bench::{Noise, askew, at_s, coarse, fig7, measured, model_from_hand, pose_of};

const CONFIG_HISTORY: usize = 12;

fn config() -> TargetStateConfig {
    TargetStateConfig { history_measurements: CONFIG_HISTORY, ..TargetStateConfig::default() }
}

/// Measurements of a target that starts to move; the one of frame 20 is an outlier.
fn sequence(frames: u32) -> Vec<PoseMeasurement> {
    let mut noise = Noise::new(7);
    let mut all = Vec::new();
    for frame in 0..frames {
        let t = f64::from(frame) / 30.0;
        let mut measurement = measured(&mut noise, at_s(t), &pose_of(fig7(t + 2.5)), &coarse());
        if frame == 20 {
            measurement.base_from_model =
                measurement.base_from_model * Pose::from_translation(Vector3::new(0.02, 0.0, 0.03));
        }
        all.push(measurement);
    }
    all
}

fn fed<'a>(measurements: impl IntoIterator<Item = &'a PoseMeasurement>) -> TargetState {
    let mut filter = TargetState::new(config()).unwrap();
    for measurement in measurements {
        filter.observe(measurement);
    }
    filter
}

fn ahead(filter: &TargetState) -> Prediction {
    filter.at(filter.newest_at().unwrap() + std::time::Duration::from_millis(80)).unwrap()
}

#[test]
fn late_measurements_give_the_state_of_measurements_in_order() {
    let all = sequence(40);
    let in_order = fed(&all);
    // Two measurements swapped, one delayed by 8 frames, and the outlier delayed by 3.
    let mut late = all.clone();
    late.swap(10, 11);
    let held = late.remove(25);
    late.insert(33, held);
    let outlier = late.remove(20);
    late.insert(23, outlier);
    assert_eq!(ahead(&fed(&late)), ahead(&in_order));
    assert_eq!(fed(&late[..24]).consecutive_outliers(), fed(&all[..24]).consecutive_outliers());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]
    #[test]
    fn any_order_within_the_history_gives_the_same_state(keys in prop::collection::vec(0.0..9.0f64, 30)) {
        let all = sequence(30);
        let mut shuffled: Vec<usize> = (1..30).collect();
        shuffled.sort_by(|&a, &b| (a as f64 + keys[a]).total_cmp(&(b as f64 + keys[b])));
        let filter = fed(std::iter::once(&all[0]).chain(shuffled.iter().map(|&i| &all[i])));
        prop_assert_eq!(ahead(&filter), ahead(&fed(&all)));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]
    #[test]
    fn whatever_is_measured_the_state_stays_a_state(
        frames in prop::collection::vec(
            (0u64..400_000_000, prop::array::uniform6(-1.0..1.0f64), -9.0..3.0f64, prop::array::uniform6(-9.0..9.0f64)),
            1..60,
        )
    ) {
        let mut filter = TargetState::new(config()).unwrap();
        let mut nanos = 0;
        for (step, motion, size, scales) in frames {
            // Mostly forwards, a third of the steps back; poses from micrometres to very far away, variances from 1e-18 to 1e18.
            nanos = if step % 3 == 0 { nanos / 8 * 7 } else { nanos + step };
            let base_from_model = askew().perturbed_in_from(&(Vector6::from(motion) * 10f64.powf(size)));
            let root = Matrix6::from_fn(|i, j| ((3 * i + 5 * j) as f64).cos() * 10f64.powf(scales[i]));
            let covariance = root * root.transpose();
            filter.observe(&PoseMeasurement { at: MonotonicTime::from_nanos(nanos), base_from_model, covariance });
            let newest = filter.newest_at().unwrap();
            let time = newest + std::time::Duration::from_millis(step % 500);
            let prediction = filter.at(time).unwrap();
            prop_assert_eq!(filter.base_from_model_at(time).unwrap(), prediction.base_from_model);
            prop_assert!(prediction.base_from_model.is_finite(), "{prediction:?}");
            prop_assert!(prediction.twist.to_vector().iter().all(|x| x.is_finite()), "{prediction:?}");
            prop_assert!(prediction.covariance.cholesky().is_some(), "{prediction:?}");
            let probabilities = [prediction.linear_motion, prediction.angular_motion];
            prop_assert!(probabilities.iter().all(|p| (0.0..=1.0 + 1e-12).contains(p)), "{prediction:?}");
        }
    }
}

#[test]
fn a_pose_out_of_this_world_is_an_outlier() {
    let all = sequence(15);
    let mut filter = fed(&all);
    let base_from_model = Pose::from_translation(Vector3::new(1e300, -1e300, 1e200));
    let far = PoseMeasurement { at: at_s(0.5), base_from_model, covariance: coarse() };
    assert!(matches!(filter.observe(&far), MeasurementVerdict::Outlier { .. }));
    assert!(ahead(&filter).base_from_model.translation_m().norm() < 2.0);
}

#[test]
fn what_is_older_than_the_history_or_there_already_is_not_used() {
    let all = sequence(40);
    let mut filter = fed(all.iter().filter(|measurement| measurement.at != all[26].at));
    let before = ahead(&filter);
    assert_eq!(filter.observe(&all[10]), MeasurementVerdict::TooOld);
    assert_eq!(filter.observe(&all[26]), MeasurementVerdict::TooOld, "only the oldest stored one is before it");
    assert_eq!(filter.observe(&all[33]), MeasurementVerdict::Duplicate);
    assert_eq!(ahead(&filter), before);
}

#[test]
fn missing_measurements_widen_the_covariance() {
    let all = sequence(40);
    let full = ahead(&fed(&all));
    let gappy = ahead(&fed(all.iter().enumerate().filter(|(i, _)| i % 5 == 4).map(|(_, measurement)| measurement)));
    assert!(gappy.covariance.trace() > 1.5 * full.covariance.trace(), "{gappy:?} {full:?}");
    let apart = gappy.base_from_model.inverse() * full.base_from_model;
    assert!(apart.translation_m().norm() < 5e-3 && apart.rotation_angle_rad() < 0.02, "{apart:?}");
}

#[test]
fn outliers_are_counted_and_change_nothing() {
    let all = sequence(20);
    let mut filter = fed(&all);
    for wrong in 1..=5u32 {
        let at = at_s(f64::from(19 + wrong) / 30.0);
        let off = Pose::from_parts(Vector3::new(0.0, 0.0, 0.05), so3::exp(&Vector3::new(0.0, 0.2, 0.0)));
        let jumped = PoseMeasurement { at, base_from_model: all[19].base_from_model * off, covariance: coarse() };
        let before = filter.at(at).unwrap().base_from_model;
        let verdict = filter.observe(&jumped);
        assert!(matches!(verdict, MeasurementVerdict::Outlier { nis } if nis > 80.0), "{verdict:?}");
        let after = filter.at(at).unwrap().base_from_model;
        // The weights of the hypotheses still change; the measurements are not used.
        assert!((before.inverse() * after).log().norm() < 2e-4);
        assert_eq!((filter.consecutive_outliers(), filter.newest_accepted_at()), (wrong, Some(all[19].at)));
    }
    let back = PoseMeasurement { at: at_s(25.0 / 30.0), ..all[19] };
    assert!(matches!(filter.observe(&back), MeasurementVerdict::Accepted { .. }));
    assert_eq!((filter.consecutive_outliers(), filter.newest_accepted_at()), (0, Some(back.at)));
}

#[test]
fn bad_numbers_are_named_and_change_nothing() {
    let all = sequence(15);
    let mut filter = fed(&all);
    let before = ahead(&filter);
    let next = PoseMeasurement { at: at_s(0.5), ..all[14] };
    let mut wrong = next;
    wrong.base_from_model = Pose::from_translation(Vector3::new(0.1, f64::NAN, 0.0));
    assert_eq!(filter.observe(&wrong), MeasurementVerdict::NotFinite);
    for (i, j, value) in [(0, 0, f64::NAN), (5, 5, f64::INFINITY), (3, 3, -1e-6), (0, 1, 1e-2)] {
        let mut wrong = next;
        wrong.covariance[(i, j)] = value;
        assert_eq!(filter.observe(&wrong), MeasurementVerdict::BadCovariance, "{value} at {i}, {j}");
    }
    assert_eq!(ahead(&filter), before);
    let mut first = TargetState::new(config()).unwrap();
    assert_eq!(first.observe(&PoseMeasurement { covariance: Matrix6::zeros(), ..next }), MeasurementVerdict::Began);
    assert!(ahead(&first).covariance.cholesky().is_some(), "the minimum standard deviations are used");
}

#[test]
fn a_direction_that_is_not_observed_does_no_harm() {
    // The rotation about the normal is unobserved and wrong in every measurement; the other components are correct.
    let mut covariance = coarse();
    covariance[(5, 5)] = 1e8;
    let (mut blind, mut seeing) = (TargetState::new(config()).unwrap(), TargetState::new(config()).unwrap());
    let mut noise = Noise::new(2);
    for frame in 0..90 {
        let t = f64::from(frame) / 30.0;
        let measurement = measured(&mut noise, at_s(t), &pose_of(fig7(t + 1.0)), &coarse());
        let turned = measurement.base_from_model.perturbed_in_from(&Vector6::new(
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            1e-2 * noise.normal(),
        ));
        seeing.observe(&measurement);
        let verdict = blind.observe(&PoseMeasurement { at: measurement.at, base_from_model: turned, covariance });
        assert!(!matches!(verdict, MeasurementVerdict::Outlier { .. }), "{verdict:?} {frame}");
    }
    let (blind, seeing) = (ahead(&blind), ahead(&seeing));
    let apart = (seeing.base_from_model.inverse() * blind.base_from_model).log();
    assert!(apart.fixed_rows::<3>(0).norm() < 2e-4, "{apart}");
    assert!(apart.fixed_rows::<2>(3).norm() < 1e-3, "{apart}");
    assert!(blind.covariance[(5, 5)] > 1e3 * blind.covariance[(4, 4)], "{}", blind.covariance);
}

#[test]
fn there_is_no_prediction_without_a_target_or_beyond_the_horizon() {
    let mut filter = TargetState::new(config()).unwrap();
    assert_eq!(filter.at(at_s(1.0)), Err(NotPredictable::NoTarget));
    let all = sequence(40);
    for measurement in &all {
        filter.observe(measurement);
    }
    let newest = all[39].at.as_secs_f64();
    assert!(filter.at(at_s(newest + 0.4999)).is_ok());
    let error = filter.at(at_s(newest + 0.5001)).unwrap_err();
    assert_eq!(filter.base_from_model_at(at_s(newest + 0.5001)), Err(error));
    assert!(error.to_string().starts_with("the time is 0.500 s after the newest measurement"), "{error}");
    // A stored past state, without later measurements.
    let past = filter.at(all[35].at).unwrap();
    assert_eq!(past, fed(&all[..36]).at(all[35].at).unwrap());
    assert!(matches!(filter.at(all[20].at), Err(NotPredictable::TooOld { behind_s }) if behind_s > 0.1));
    filter.clear();
    assert_eq!((filter.at(all[39].at), filter.newest_at()), (Err(NotPredictable::NoTarget), None));
}

#[test]
fn after_a_long_gap_a_new_target_begins() {
    let all = sequence(20);
    let mut filter = fed(&all);
    let elsewhere = Pose::from_translation(Vector3::new(0.3, 0.0, 0.0)) * askew();
    let late = PoseMeasurement { at: at_s(19.0 / 30.0 + 2.01), base_from_model: elsewhere, covariance: coarse() };
    assert_eq!(filter.observe(&late), MeasurementVerdict::Began);
    let found = filter.at(late.at).unwrap().base_from_model;
    assert!((found.inverse() * elsewhere).log().norm() < 1e-12, "{found:?}");
    assert_eq!(filter.observe(&all[19]), MeasurementVerdict::TooOld);
}

#[test]
fn time_in_milliseconds_serves_as_well() {
    let mut rounded = sequence(60);
    for measurement in &mut rounded {
        measurement.at = MonotonicTime::from_nanos((measurement.at.as_nanos() + 500_000) / 1_000_000 * 1_000_000);
    }
    let (exact, rounded) = (fed(&sequence(60)), fed(&rounded));
    let at = at_s(59.0 / 30.0 + 0.08);
    let apart = exact.at(at).unwrap().base_from_model.inverse() * rounded.at(at).unwrap().base_from_model;
    // 0.1 m/s and 0.33 rad/s times half a millisecond.
    assert!(apart.translation_m().norm() < 1e-4 && apart.rotation_angle_rad() < 3e-4, "{apart:?}");
}

#[test]
fn twist_and_acceleration_are_derivatives_of_the_prediction() {
    let model_from_hand =
        Pose::<Model, Hand>::from_parts(Vector3::new(0.03, -0.05, -0.5), so3::exp(&Vector3::new(0.2, -0.1, 0.4)));
    // Ends in the middle of a rotation about x.
    let mut filter = TargetState::new(config()).unwrap();
    let mut noise = Noise::new(1);
    for frame in 0..30 {
        let t = f64::from(frame) / 30.0;
        let tumble = (Vector3::new(0.2 * t, 0.1 * t * t, 0.0), Vector3::new(0.3 * t * t, 0.5 * t, -0.4 * t));
        filter.observe(&measured(&mut noise, at_s(t), &pose_of(tumble), &(coarse() * 0.01)));
    }
    let t = 29.0 / 30.0 + 0.1;
    let at = |seconds: f64| filter.at(at_s(seconds)).unwrap();
    let hand = |seconds: f64| at(seconds).base_from_model * model_from_hand;
    let h = 1e-3;
    let (before, now, after) = (hand(t - h), hand(t), hand(t + h));
    let linear = (after.translation_m() - before.translation_m()) / (2.0 * h);
    let angular = so3::log(&(after.rotation() * before.rotation().inverse())) / (2.0 * h);
    let twist = at(t).twist_of(&model_from_hand);
    assert!((twist.linear_m_per_s - linear).norm() < 1e-3 * linear.norm(), "{twist:?} {linear}");
    assert!((twist.angular_rad_per_s - angular).norm() < 1e-3 * angular.norm(), "{twist:?} {angular}");
    let push = (after.translation_m() + before.translation_m() - now.translation_m() * 2.0) / (h * h);
    let acceleration = at(t).acceleration_of(&model_from_hand);
    assert!((acceleration.linear_m_per_s2 - push).norm() < 0.02 * push.norm(), "{acceleration:?} {push}");
    let twirl = (at(t + h).twist.angular_rad_per_s - at(t - h).twist.angular_rad_per_s) / (2.0 * h);
    assert!((acceleration.angular_rad_per_s2 - twirl).norm() < 1e-3 * twirl.norm(), "{acceleration:?} {twirl}");
    assert!(linear.norm() > 0.1 && angular.norm() > 0.1 && push.norm() > 0.1);
}

#[test]
fn the_covariance_of_the_hand_is_that_of_sampled_poses() {
    let model_from_hand =
        Pose::<Model, Hand>::from_parts(Vector3::new(0.03, -0.05, -0.5), so3::exp(&Vector3::new(0.2, -0.1, 0.4)));
    let prediction = ahead(&fed(&sequence(40)));
    let expected = prediction.covariance_of(&model_from_hand);
    let (mut noise, samples) = (Noise::new(17), 20_000);
    let mut sum = Matrix6::zeros();
    for _ in 0..samples {
        let error = noise.with_covariance(&prediction.covariance);
        let hand = prediction.base_from_model * model_from_hand;
        let true_hand = prediction.base_from_model.perturbed_in_from(&error) * model_from_hand;
        let error = (hand.inverse() * true_hand).log();
        sum += error * error.transpose() / f64::from(samples);
    }
    for i in 0..6 {
        for j in 0..6 {
            let scale = (expected[(i, i)] * expected[(j, j)]).sqrt();
            assert!((sum[(i, j)] - expected[(i, j)]).abs() < 0.05 * scale, "{i} {j}: {sum} {expected}");
        }
    }
    // With the lever of 500 mm, tilt causes most of the uncertainty across the motion, which is along x.
    assert!(expected[(1, 1)] > 2.0 * prediction.covariance[(1, 1)], "{expected} {}", prediction.covariance);
}

#[test]
fn measurements_and_predictions_leave_the_heap_alone() {
    let all = sequence(60);
    let mut filter = TargetState::new(config()).unwrap();
    let before = requests();
    for (i, measurement) in all.iter().enumerate() {
        // Every third measurement arrives two frames late.
        let late = if i % 3 == 2 { all.get(i + 2) } else { None };
        filter.observe(late.unwrap_or(measurement));
        filter.observe(measurement);
        filter.at(measurement.at).unwrap();
    }
    assert_eq!(requests(), before);
    let probe: Pose<Base, Hand> = filter.at(all[59].at).unwrap().base_from_model * model_from_hand();
    drop(std::hint::black_box(Box::new(probe)));
    assert!(requests() > before, "the allocation counter works");
}
