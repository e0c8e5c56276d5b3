//! Consistency of the covariances: Monte Carlo chi-square tests, symmetry, and long runs.

use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{Base, Model};
use pb3dp_geometry::{Pose, so3};
use pb3dp_servo::{
    MeasurementConfig, MeasurementVerdict, MotionConfig, PoseMeasurement, SurpriseConfig, TargetState,
    TargetStateConfig,
};

use super::bench::{Noise, askew, at_s, diagonal, fine, measured};

/// Only Singer's model, with the reported covariance unchanged.
fn singer() -> TargetStateConfig {
    TargetStateConfig {
        linear: MotionConfig {
            acceleration_sigma_per_s2: 0.3,
            correlation_time_s: 0.5,
            across_share: 1.0,
            start_velocity_sigma_per_s: 0.2,
            rest: None,
        },
        angular: MotionConfig {
            acceleration_sigma_per_s2: 2.0,
            correlation_time_s: 0.4,
            across_share: 1.0,
            start_velocity_sigma_per_s: 1.0,
            rest: None,
        },
        measurement: MeasurementConfig {
            covariance_factor: 1.0,
            position_sigma_min_m: 1e-6,
            orientation_sigma_min_rad: 1e-6,
        },
        surprise: SurpriseConfig { exponent: 0.0, ..TargetStateConfig::default().surprise },
        gate_nis: 1e4,
        ..TargetStateConfig::default()
    }
}

/// A target that moves according to Singer's model, integrated in steps of 1 ms.
struct Wanderer {
    base_from_model: Pose<Base, Model>,
    velocity: [Vector3<f64>; 2],
    acceleration: [Vector3<f64>; 2],
    parts: [MotionConfig; 2],
}

impl Wanderer {
    fn new(config: &TargetStateConfig, noise: &mut Noise) -> Self {
        let parts = [config.linear, config.angular];
        Self {
            base_from_model: askew(),
            velocity: parts.map(|part| noise.vector() * part.start_velocity_sigma_per_s),
            acceleration: parts.map(|part| noise.vector() * part.acceleration_sigma_per_s2),
            parts,
        }
    }

    fn millisecond(&mut self, noise: &mut Noise) {
        let h = 1e-3;
        let mut moved = [Vector3::zeros(); 2];
        for (i, part) in self.parts.iter().enumerate() {
            let keeps = (-h / part.correlation_time_s).exp();
            let kick = part.acceleration_sigma_per_s2 * (1.0 - keeps * keeps).sqrt();
            let next = self.acceleration[i] * keeps + noise.vector() * kick;
            let push = (self.acceleration[i] + next) * 0.5;
            moved[i] = self.velocity[i] * h + push * (0.5 * h * h);
            self.velocity[i] += push * h;
            self.acceleration[i] = next;
        }
        let rotation = so3::exp(&moved[1]) * self.base_from_model.rotation();
        self.base_from_model = Pose::from_parts(self.base_from_model.translation_m() + moved[0], rotation);
    }
}

/// Noise with correlation between position and orientation.
fn correlated() -> Matrix6<f64> {
    let mut covariance = diagonal(4e-4, 9e-4, 0.015, 0.008);
    for (i, j, correlation) in [(0, 4, 0.8), (1, 3, -0.7), (2, 5, 0.4)] {
        let both = correlation * (covariance[(i, i)] * covariance[(j, j)]).sqrt();
        covariance[(i, j)] = both;
        covariance[(j, i)] = both;
    }
    covariance
}

/// Squared Mahalanobis distance of a pose error.
fn nees(found: &Pose<Base, Model>, covariance: &Matrix6<f64>, truth: &Pose<Base, Model>) -> f64 {
    let error = (found.inverse() * *truth).log();
    error.dot(&covariance.cholesky().unwrap().solve(&error))
}

/// Whether `mean` is within 4 standard deviations of the mean of `count` chi-square deviates with 6 degrees of freedom.
fn is_chi_square(mean: f64, count: usize) -> bool {
    (mean - 6.0).abs() < 4.0 * (12.0 / count as f64).sqrt()
}

#[test]
fn errors_and_innovations_are_as_large_as_the_covariances_say() {
    let (config, covariance) = (singer(), correlated());
    let (runs, frames) = (200, 60);
    let (mut nis_sum, mut nees_now, mut nees_later) = (0.0, 0.0, 0.0);
    for seed in 0..runs {
        let mut noise = Noise::new(seed as u64);
        let mut target = Wanderer::new(&config, &mut noise);
        let mut filter = TargetState::new(config).unwrap();
        for frame in 0..frames {
            let at = at_s(0.033 * f64::from(frame));
            match filter.observe(&measured(&mut noise, at, &target.base_from_model, &covariance)) {
                MeasurementVerdict::Accepted { nis } => nis_sum += nis,
                verdict => assert_eq!((verdict, frame), (MeasurementVerdict::Began, 0)),
            }
            if frame + 1 < frames {
                (0..33).for_each(|_| target.millisecond(&mut noise));
            }
        }
        let now_s = 0.033 * f64::from(frames - 1);
        let now = filter.at(at_s(now_s)).unwrap();
        nees_now += nees(&now.base_from_model, &now.covariance, &target.base_from_model);
        (0..100).for_each(|_| target.millisecond(&mut noise));
        let later = filter.at(at_s(now_s + 0.1)).unwrap();
        nees_later += nees(&later.base_from_model, &later.covariance, &target.base_from_model);
    }
    let innovations = runs * (frames as usize - 1);
    let (nis, now, later) = (nis_sum / innovations as f64, nees_now / runs as f64, nees_later / runs as f64);
    println!("NIS {nis:.3}, NEES {now:.3}, after 0.1 s {later:.3}");
    assert!(is_chi_square(nis, innovations), "NIS {nis} of {innovations}");
    assert!(is_chi_square(now, runs) && is_chi_square(later, runs), "NEES {now}, after 0.1 s {later}");
}

#[test]
fn a_covariance_that_is_too_small_shows() {
    // Shows that the test above can fail: the noise is twice as large as reported.
    let config = singer();
    let mut noise = Noise::new(3);
    let mut filter = TargetState::new(config).unwrap();
    let (mut sum, frames) = (0.0, 300);
    for frame in 0..frames {
        let mut measurement = measured(&mut noise, at_s(0.033 * f64::from(frame)), &askew(), &correlated());
        measurement.covariance *= 0.25;
        if let MeasurementVerdict::Accepted { nis } = filter.observe(&measurement) {
            sum += nis;
        }
    }
    assert!(!is_chi_square(sum / f64::from(frames), frames as usize));
}

#[test]
fn from_a_wrong_start_the_state_converges_to_a_steady_motion() {
    // A noise-free screw motion about an oblique axis: pose and velocity converge, also beyond 180 degrees.
    let config = TargetStateConfig { gate_nis: 1e4, ..TargetStateConfig::default() };
    let mut filter = TargetState::new(config).unwrap();
    let (speed, spin) = (Vector3::new(0.05, -0.08, 0.03), Vector3::new(0.5, 0.9, -0.7));
    let truth = |t: f64| {
        Pose::<Base, Model>::from_parts(askew().translation_m() + speed * t, so3::exp(&(spin * t)) * askew().rotation())
    };
    for frame in 0..150 {
        let t = f64::from(frame) / 30.0;
        filter.observe(&PoseMeasurement { at: at_s(t), base_from_model: truth(t), covariance: fine() });
    }
    let t = 149.0 / 30.0 + 0.1;
    let prediction = filter.at(at_s(t)).unwrap();
    let apart = prediction.base_from_model.inverse() * truth(t);
    assert!(spin.norm() * t > 6.0);
    assert!(apart.translation_m().norm() < 1e-4 && apart.rotation_angle_rad() < 1e-3, "{apart:?}");
    assert!((prediction.twist.linear_m_per_s - speed).norm() < 1e-3, "{prediction:?}");
    assert!((prediction.twist.angular_rad_per_s - spin).norm() < 1e-2, "{prediction:?}");
    assert!(prediction.linear_motion > 0.99 && prediction.angular_motion > 0.99, "{prediction:?}");
}

#[test]
fn another_base_frame_gives_the_same_motion_in_other_coordinates() {
    let new_from_old = Pose::<Base, Base>::from_parts(
        Vector3::new(-0.4, 1.1, 0.2),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.8, -1.7, 0.5)),
    );
    let config = TargetStateConfig::default();
    let (mut one, mut other) = (TargetState::new(config).unwrap(), TargetState::new(config).unwrap());
    let mut noise = Noise::new(11);
    let mut target = Wanderer::new(&singer(), &mut noise);
    for frame in 0..60 {
        let measurement = measured(&mut noise, at_s(0.033 * f64::from(frame)), &target.base_from_model, &correlated());
        one.observe(&measurement);
        other.observe(&PoseMeasurement { base_from_model: new_from_old * measurement.base_from_model, ..measurement });
        (0..33).for_each(|_| target.millisecond(&mut noise));
    }
    let at = at_s(0.033 * 59.0 + 0.08);
    let (one, other) = (one.at(at).unwrap(), other.at(at).unwrap());
    let apart = (new_from_old * one.base_from_model).inverse() * other.base_from_model;
    assert!(apart.log().norm() < 1e-9, "{apart:?}");
    let turned = one.twist.expressed_in(&new_from_old);
    assert!((turned.to_vector() - other.twist.to_vector()).norm() < 1e-8);
    assert!((one.covariance - other.covariance).amax() < 1e-6 * one.covariance.amax());
}

#[test]
fn a_target_at_rest_for_an_hour_keeps_a_covariance() {
    let config = TargetStateConfig::default();
    let mut filter = TargetState::new(config).unwrap();
    let mut noise = Noise::new(5);
    let mut worst = 0.0f64;
    for frame in 0..36_000u32 {
        let at = at_s(f64::from(frame) / 10.0);
        let verdict = filter.observe(&measured(&mut noise, at, &askew(), &fine()));
        if frame % 1000 == 999 {
            let prediction = filter.at(at_s(f64::from(frame) / 10.0 + 0.07)).unwrap();
            assert_eq!(prediction.covariance, prediction.covariance.transpose());
            let smallest = prediction.covariance.symmetric_eigenvalues().min();
            assert!(smallest > 0.0, "{smallest} after {frame} frames");
            assert!(matches!(verdict, MeasurementVerdict::Accepted { .. }), "{verdict:?}");
            worst = worst.max((prediction.base_from_model.inverse() * askew()).log().norm());
        }
    }
    assert!(worst < 1e-3, "{worst}");
}
