//! Target motions: exact amplitudes, smoothness, and twists that are the derivative of the pose.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Target, World};
use pb3dp_sim::trajectory::{
    Channel, ExperimentAxes, MotionConfig, Sine, SineConfig, StepExperiment, StepExperimentConfig, Trajectory,
    TrajectoryError,
};
use proptest::prelude::*;

/// A target at some position, rotated about all three axes.
fn somewhere() -> Pose<World, Target> {
    Pose::from_parts(Vector3::new(0.9, -0.12, 0.83), UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -1.1, 0.7)))
}

fn fig7(axes: ExperimentAxes) -> StepExperiment {
    StepExperiment::new(StepExperimentConfig { axes, ..Default::default() }, somewhere()).unwrap()
}

/// Pose at `t_s` relative to the start: translation and rotation vector, both in `world`.
fn offset(trajectory: &dyn Trajectory, t_s: f64) -> (Vector3<f64>, Vector3<f64>) {
    let now = trajectory.pose_at(t_s);
    let turn = now.rotation() * somewhere().rotation().inverse();
    (now.translation_m() - somewhere().translation_m(), turn.scaled_axis())
}

#[test]
fn fig7_reaches_100_mm_and_20_degrees_on_each_world_axis_and_returns() {
    let experiment = fig7(ExperimentAxes::World);
    assert_eq!(experiment.duration_s(), 63.0);
    let (way, angle) = (0.1, 20f64.to_radians());
    for index in 0..6 {
        let mut expected = [0.0; 6];
        expected[index] = if index < 3 { way } else { angle };
        let out_s = 3.0 + 10.0 * index as f64 + 4.0;
        let (moved, turned) = offset(&experiment, out_s);
        let measured = [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z];
        for (m, e) in measured.iter().zip(expected) {
            assert!((m - e).abs() < 1e-12, "channel {index} at {out_s} s: {measured:?}");
        }
        let (moved, turned) = offset(&experiment, out_s + 5.0);
        assert!(moved.norm() < 1e-12 && turned.norm() < 1e-12, "channel {index} did not return");
    }
}

#[test]
fn axes_of_the_target_are_those_of_its_start_pose() {
    let experiment = fig7(ExperimentAxes::TargetAtStart);
    let start = somewhere();
    for (index, axis) in [(0, Vector3::x()), (1, Vector3::y()), (2, Vector3::z())] {
        let (moved, turned) = offset(&experiment, 7.0 + 10.0 * f64::from(index));
        assert!((moved - start.transform_vector(&(axis * 0.1))).norm() < 1e-12 && turned.norm() < 1e-12);
        let (moved, turned) = offset(&experiment, 37.0 + 10.0 * f64::from(index));
        assert!(moved.norm() < 1e-12);
        assert!((turned - start.transform_vector(&(axis * 20f64.to_radians()))).norm() < 1e-12);
    }
}

#[test]
fn marks_stand_where_the_moves_begin() {
    let experiment = fig7(ExperimentAxes::World);
    let marks = experiment.marks();
    assert_eq!(marks.len(), 12);
    assert_eq!((marks[0].number, marks[0].at_s, marks[0].label.as_str()), (1, 3.0, "x +100 mm"));
    assert_eq!((marks[11].number, marks[11].at_s, marks[11].label.as_str()), (12, 58.0, "rz back"));
    assert_eq!(marks[6].label, "rx +20 deg");
    for mark in marks {
        let speed = |t: f64| experiment.twist_at(t).to_vector().norm();
        assert!(speed(mark.at_s - 0.01) == 0.0, "moves before mark {}", mark.number);
        assert!(speed(mark.at_s + 0.01) > 0.0, "stationary after mark {}", mark.number);
    }
}

#[test]
fn before_and_behind_the_motion_the_target_stands_at_its_start() {
    let experiment = fig7(ExperimentAxes::TargetAtStart);
    for t in [-5.0, 0.0, 2.9, 63.0, 1e4] {
        let (moved, turned) = offset(&experiment, t);
        assert!(moved.norm() < 1e-12 && turned.norm() < 1e-12, "at {t} s");
        assert_eq!(experiment.twist_at(t).to_vector().norm(), 0.0);
    }
}

#[test]
fn a_sudden_move_is_done_when_it_begins() {
    let config = StepExperimentConfig {
        channels: vec![Channel::Z, Channel::Rx],
        move_s: 0.0,
        hold_s: 2.0,
        lead_in_s: 1.0,
        axes: ExperimentAxes::World,
        ..Default::default()
    };
    let steps = MotionConfig::Steps(config);
    assert!(steps.is_sudden() && !MotionConfig::Steps(StepExperimentConfig::default()).is_sudden());
    let experiment = steps.begin_at(somewhere()).unwrap();
    assert_eq!(experiment.duration_s(), 9.0);
    let marks: Vec<f64> = experiment.marks().iter().map(|mark| mark.at_s).collect();
    assert_eq!(marks, [1.0, 3.0, 5.0, 7.0]);
    for (t_s, moved_m, turned_deg) in [
        (-1.0, 0.0, 0.0),
        (0.999, 0.0, 0.0),
        (1.0, 0.1, 0.0),
        (2.999, 0.1, 0.0),
        (3.0, 0.0, 0.0),
        (5.0, 0.0, 20.0),
        (6.999, 0.0, 20.0),
        (7.0, 0.0, 0.0),
        (99.0, 0.0, 0.0),
    ] {
        let (moved, turned) = offset(&*experiment, t_s);
        assert!((moved - Vector3::new(0.0, 0.0, moved_m)).norm() < 1e-12, "at {t_s} s: {moved}");
        assert!((turned.norm().to_degrees() - turned_deg).abs() < 1e-9, "at {t_s} s: {turned}");
        assert_eq!(experiment.twist_at(t_s).to_vector().norm(), 0.0, "at {t_s} s");
    }
}

#[test]
fn sine_reaches_its_amplitude_a_quarter_period_into_the_steady_part() {
    let config = SineConfig {
        channel: Channel::Y,
        amplitude: -0.1,
        period_s: 4.0,
        periods: 3,
        lead_in_s: 1.0,
        axes: ExperimentAxes::World,
    };
    let sine = Sine::new(config, somewhere()).unwrap();
    assert_eq!(sine.steady_s(), (5.0, 17.0));
    assert_eq!(sine.duration_s(), 21.0);
    let (moved, _) = offset(&sine, 6.0);
    assert!((moved - Vector3::new(0.0, -0.1, 0.0)).norm() < 1e-12, "{moved}");
    let (moved, _) = offset(&sine, 8.0);
    assert!((moved - Vector3::new(0.0, 0.1, 0.0)).norm() < 1e-12, "{moved}");
    assert_eq!(sine.marks()[1].label, "y -100 mm every 4 s");
    assert_eq!(sine.twist_at(21.5).to_vector().norm(), 0.0);
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let refused = |change: fn(&mut StepExperimentConfig)| {
        let mut config = StepExperimentConfig::default();
        change(&mut config);
        StepExperiment::new(config, somewhere()).unwrap_err().to_string()
    };
    assert!(refused(|c| c.move_s = 0.01).contains("move_s is 0.01; allowed is 0, or 0.05 to 600 s"));
    assert!(
        refused(|c| (c.move_s, c.hold_s) = (0.0, 0.0)).contains("hold_s is 0; allowed is 0.05 to 600 s after sudden")
    );
    assert!(refused(|c| c.translation_m = f64::NAN).contains("translation_m is NaN"));
    assert!(refused(|c| c.rotation_rad = 3.2).contains("rotation_rad is 3.2"));
    assert!(refused(|c| c.hold_s = -1.0).contains("hold_s"));
    assert!(refused(|c| c.channels.clear()).contains("channels is empty"));
    let nowhere = Pose::from_translation(Vector3::new(0.0, f64::INFINITY, 0.0));
    let error = StepExperiment::new(StepExperimentConfig::default(), nowhere).unwrap_err();
    assert!(matches!(error, TrajectoryError::Parameter { key: "world_from_target", .. }));
    assert_eq!(Channel::from_name("rz"), Some(Channel::Rz));
    assert_eq!(Channel::from_name("roll"), None);
}

/// Twist by central differences of the pose, in `world`.
fn difference(trajectory: &dyn Trajectory, t_s: f64, step_s: f64) -> nalgebra::Vector6<f64> {
    let (a, b) = (trajectory.pose_at(t_s - step_s), trajectory.pose_at(t_s + step_s));
    let linear = (b.translation_m() - a.translation_m()) / (2.0 * step_s);
    let angular = (b.rotation() * a.rotation().inverse()).scaled_axis() / (2.0 * step_s);
    pb3dp_geometry::Twist::<World>::new(linear, angular).to_vector()
}

/// Twist is the derivative of the pose, and the acceleration has no jump.
fn check_smooth(trajectory: &dyn Trajectory, t_s: f64, jerk_bound: f64) -> Result<(), TestCaseError> {
    let h = 1e-4;
    let twist = trajectory.twist_at(t_s).to_vector();
    let error = (twist - difference(trajectory, t_s, h)).norm();
    prop_assert!(error < 1e-8 + jerk_bound * h * h, "twist error {error} at {t_s} s");
    let (before, after) = (trajectory.twist_at(t_s - h).to_vector(), trajectory.twist_at(t_s + h).to_vector());
    let jump = (after - 2.0 * twist + before).norm() / h;
    prop_assert!(jump <= 2.0 * jerk_bound * h + 1e-8, "acceleration jumps by {jump} at {t_s} s");
    Ok(())
}

proptest! {
    #[test]
    fn steps_are_smooth(
        t in 0.0..30.0f64, at_mark in 0usize..8, near in -2e-4..2e-4f64,
        way in -0.3..0.3f64, turn in -1.0..1.0f64, move_s in 0.5..3.0f64, hold_s in 0.0..2.0f64,
    ) {
        let channels = vec![Channel::Z, Channel::Rx, Channel::X, Channel::Ry];
        let axes = ExperimentAxes::TargetAtStart;
        let config = StepExperimentConfig {
            channels, translation_m: way, rotation_rad: turn, move_s, hold_s, lead_in_s: 0.5, axes,
        };
        let experiment = StepExperiment::new(config, somewhere()).unwrap();
        // The third derivative of 10 s^3 - 15 s^4 + 6 s^5 is at most 60.
        let jerk = 60.0 * way.abs().max(turn.abs()) / move_s.powi(3);
        check_smooth(&experiment, t, jerk)?;
        let mark_s = experiment.marks()[at_mark].at_s;
        check_smooth(&experiment, mark_s + near, jerk)?;
        check_smooth(&experiment, mark_s + move_s + near, jerk)?;
    }

    #[test]
    fn sines_are_smooth(
        t in 0.0..30.0f64, near in -2e-4..2e-4f64, amplitude in -0.3..0.3f64, period_s in 1.0..5.0f64,
        channel in prop::sample::select(&Channel::ALL[..]),
    ) {
        let config = SineConfig {
            channel, amplitude, period_s, periods: 2, lead_in_s: 0.5, axes: ExperimentAxes::World,
        };
        let sine = Sine::new(config, somewhere()).unwrap();
        // Third derivative of envelope times sine by the product rule, each factor at its maximum.
        let tau = std::f64::consts::TAU;
        let jerk = amplitude.abs() * (60.0 + 3.0 * 5.78 * tau + 3.0 * 1.875 * tau.powi(2) + tau.powi(3)) / period_s.powi(3);
        check_smooth(&sine, t, jerk)?;
        for mark in sine.marks() {
            check_smooth(&sine, mark.at_s + near, jerk)?;
        }
    }
}
