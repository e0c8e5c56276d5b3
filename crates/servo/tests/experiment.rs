//! The experiment of Fig. 7 without images: each axis out and back by 100 mm and 20 degrees, observed with the noise of the
//! direct method on a colourful card at 500 mm, with an arm that has delay and lag.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use crate::common::{Cell, Plant, feed_forward, feed_forward_config};
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Hand, Model};
use pb3dp_servo::{ArmResponse, FeedForwardConfig, TargetObservation, TargetStateConfig};

const ARM: ArmResponse = ArmResponse { delay_s: 0.01, lag_s: 0.03 };
const LEAD_IN_S: f64 = 3.0;
const MOVE_S: f64 = 2.0;
const HOLD_S: f64 = 3.0;
/// Standard deviations of the observations, model axes: metres and radians. A stereo pair measures tilt least accurately.
const SIGMA: [f64; 6] = [1.5e-5, 1.5e-5, 4e-5, 1e-3, 1e-3, 4e-4];

/// 0 to 1 with zero speed and acceleration at both ends (minimum jerk).
fn smooth(share: f64) -> f64 {
    let x = share.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}

/// The target `t_s` after the start: x, y, z, then rotations about its own axes, each out and back.
fn target_at(home: &Pose<Base, Model>, t_s: f64) -> Pose<Base, Model> {
    let mut way = [0.0; 6];
    for (channel, way) in way.iter_mut().enumerate() {
        let out_s = LEAD_IN_S + 2.0 * (MOVE_S + HOLD_S) * channel as f64;
        let back_s = out_s + MOVE_S + HOLD_S;
        let size = if channel < 3 { 0.1 } else { 20f64.to_radians() };
        *way = size * (smooth((t_s - out_s) / MOVE_S) - smooth((t_s - back_s) / MOVE_S));
    }
    let shift = home.rotation() * Vector3::new(way[0], way[1], way[2]);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(way[3], way[4], way[5]));
    Pose::from_parts(home.translation_m() + shift, home.rotation() * turn)
}

/// Gaussian noise, the same in every run.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// RMS errors of the hand: mm and degrees.
#[derive(Debug, Default)]
struct Figures {
    moving_mm: f64,
    moving_deg: f64,
    hold_mm: f64,
    hold_deg: f64,
    /// Lag of the hand, s: error along the velocity of the desired hand, divided by this velocity.
    late_s: f64,
}

/// Runs the experiment with this delay from exposure to arrival.
fn run(law: FeedForwardConfig, latency_s: f64) -> Figures {
    let mut config = feed_forward_config(law);
    config.model_from_hand_desired = Pose::from_translation(Vector3::new(0.0, 0.0, -0.5));
    config.speed.soft_start_s = 0.5;
    let mut cell = Cell::new(config, Plant { delay_steps: 1, lag_s: ARM.lag_s }, latency_s);
    cell.step_s = 0.01;
    let hand = cell.base_from_hand();
    let home = hand * config.model_from_hand_desired.inverse();
    let mut noise = Noise(1);
    let mut in_flight = std::collections::VecDeque::<TargetObservation>::new();
    let mut exposures = 0u32;
    let (mut moving, mut hold) = ([0.0; 3], [0.0; 3]);
    let (mut along, mut speed) = (0.0, 0.0);
    let end_s = LEAD_IN_S + 12.0 * (MOVE_S + HOLD_S);
    while cell.time_s < 5.0 + end_s {
        let t_s = cell.time_s - 5.0;
        let target = target_at(&home, t_s);
        let desired_at = |t_s: f64| -> Pose<Base, Hand> { target_at(&home, t_s) * config.model_from_hand_desired };
        let desired = desired_at(t_s);
        let error = desired.translation_m() - cell.base_from_hand().translation_m();
        let angle = desired.rotation().angle_to(&cell.base_from_hand().rotation());
        let phase = (t_s - LEAD_IN_S).rem_euclid(MOVE_S + HOLD_S);
        let sums = if phase < MOVE_S { Some(&mut moving) } else { (phase > MOVE_S + 1.0).then_some(&mut hold) };
        if let (true, Some([squares, angles, count])) = (t_s >= LEAD_IN_S, sums) {
            *squares += error.norm_squared();
            *angles += angle * angle;
            *count += 1.0;
            let velocity = (desired_at(t_s + 1e-3).translation_m() - desired_at(t_s - 1e-3).translation_m()) / 2e-3;
            along += error.dot(&velocity);
            speed += velocity.norm_squared();
        }
        if t_s + 1e-9 >= f64::from(exposures) / 30.0 {
            exposures += 1;
            let mut observed = cell.observe(&target);
            let xi = Vector6::from_fn(|i, _| SIGMA[i] * noise.normal());
            observed.cam_left_from_model = observed.cam_left_from_model.perturbed_in_from(&xi);
            let sigma = Vector6::from(SIGMA);
            // The estimators report slightly too small covariances.
            observed.covariance = Some(Matrix6::from_diagonal(&sigma.component_mul(&sigma)) / 2.5);
            in_flight.push_back(observed);
        }
        let now = cell.now();
        while in_flight.front().is_some_and(|observed| now.seconds_since(observed.at) >= latency_s) {
            cell.newest = in_flight.pop_front();
        }
        cell.step_controller();
    }
    let rms = |sum: f64, count: f64| (sum / count).sqrt();
    Figures {
        moving_mm: rms(moving[0], moving[2]) * 1e3,
        moving_deg: rms(moving[1], moving[2]).to_degrees(),
        hold_mm: rms(hold[0], hold[2]) * 1e3,
        hold_deg: rms(hold[1], hold[2]).to_degrees(),
        late_s: along / speed,
    }
}

/// 26 ms and 60 ms from exposure to arrival correspond to 66 and 100 ms from exposure to motion.
#[test]
fn the_hand_keeps_its_place_to_a_millimetre_while_the_target_moves() {
    let law = FeedForwardConfig { target: TargetStateConfig::default(), ..feed_forward(ARM) };
    let figures = run(law, 0.026);
    assert!(figures.moving_mm < 1.1 && figures.moving_deg < 0.15, "{figures:?}");
    assert!(figures.hold_mm < 0.25 && figures.hold_deg < 0.03, "{figures:?}");
    assert!(figures.late_s.abs() < 0.01, "{figures:?}");
    let figures = run(law, 0.06);
    assert!(figures.moving_mm < 1.5 && figures.moving_deg < 0.2, "{figures:?}");
    assert!(figures.hold_mm < 0.25 && figures.hold_deg < 0.03, "{figures:?}");
    assert!(figures.late_s.abs() < 0.01, "{figures:?}");
}

/// Table of gains in docs/servo.md: `cargo test -p pb3dp-servo --test integration experiment -- --nocapture`.
/// A larger gain follows better.
#[test]
fn a_larger_gain_makes_good_sooner_what_the_prediction_missed() {
    let gains_per_s = [7.0, 9.2, 15.0, 20.0, 30.0];
    println!("| *K*, 1/s | {} |", gains_per_s.map(|gain| gain.to_string()).join(" | "));
    for (delay_millis, latency_s) in [(66, 0.026), (100, 0.06)] {
        let moving_mm = gains_per_s.map(|gain| {
            let mut law = FeedForwardConfig { target: TargetStateConfig::default(), ..feed_forward(ARM) };
            (law.gains.position_per_s, law.gains.orientation_per_s) = (gain, gain);
            run(law, latency_s).moving_mm
        });
        println!("| mm at {delay_millis} ms | {} |", moving_mm.map(|mm| format!("{mm:.2}")).join(" | "));
        assert!(moving_mm.windows(2).all(|pair| pair[1] < pair[0]), "{moving_mm:?}");
    }
}
