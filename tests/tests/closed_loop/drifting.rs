//! Cameras that have moved since their calibration.

use std::time::Duration;

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_cell::drift::DriftSummary;
use pb3dp_cell::experiment;
use pb3dp_estimation::estimator::Method;
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_setup::setup::{DriftConfig, Setup};
use pb3dp_sim::trajectory::Channel;
use pb3dp_wiring::wire;

use super::support::{Pixels, quick_setup};

/// The drift that a run with these cameras detects, with the calibration of the original ones.
fn found(calibrated: &Setup, cameras: &Setup) -> Vec<DriftSummary> {
    experiment::run(calibrated, wire(cameras).unwrap(), Some(4.0), None).unwrap().log.drift
}

#[test]
fn a_run_finds_cameras_that_are_not_any_more_what_was_calibrated() {
    let drift = DriftConfig {
        every: Duration::from_millis(500),
        rows_max_px: 0.5,
        focus_max_px: 1.0,
        brightness_max_percent: 15.0,
        skew_max: Duration::from_millis(1),
    };
    let sound = Setup { drift: Some(drift), ..quick_setup(Method::Direct, Pixels::Few, &[Channel::Y]) };
    let unchanged = found(&sound, &sound);
    assert_eq!(unchanged.len(), 4, "{unchanged:#?}");
    assert!(unchanged.iter().all(|one| one.looks >= 7 && !one.was_too_far()), "{unchanged:#?}");

    // The right camera was knocked: it is pitched by 0.15 degrees, and its lens is smeared.
    let mut knocked = sound.clone();
    let angle_rad = 0.15_f64.to_radians();
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(angle_rad, 0.0, 0.0));
    let nod = Pose::from_parts(Vector3::zeros(), rotation);
    let (left, right) = (*sound.rig.stereo.left(), *sound.rig.stereo.right());
    knocked.rig.stereo = StereoRig::new(left, right, nod * *sound.rig.stereo.cam_right_from_cam_left()).unwrap();
    knocked.world.as_mut().unwrap().sensor.right.exposure *= 0.7;
    let changed = found(&sound, &knocked);
    let by_px = right.pinhole().fy * angle_rad;
    assert!((changed[0].at_last.unwrap() - by_px).abs() < 0.25 * by_px, "{by_px} px expected, {changed:#?}");
    assert!((changed[2].at_last.unwrap() + 30.0).abs() < 5.0, "{changed:#?}");
    let too_far: Vec<bool> = changed.iter().map(DriftSummary::was_too_far).collect();
    assert_eq!(too_far, [true, false, true, false], "{changed:#?}");
}
