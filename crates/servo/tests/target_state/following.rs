//! The motions of the experiments: quiet at rest, without lag in motion.

use nalgebra::Matrix6;
use pb3dp_servo::TargetStateConfig;

use crate::bench::{FIG7_S, coarse, fig7, fig7_phase, fine, follow};

/// Largest rms of the desired hand's position (mm) and orientation (degrees) in motion and in hold.
type Limits = [f64; 4];

fn check(name: &str, covariance: &Matrix6<f64>, delay_s: f64, limits: &Limits) {
    let config = TargetStateConfig::default();
    let (moving, still) = follow(&config, covariance, delay_s, FIG7_S, &fig7, &fig7_phase, 1);
    let found = [moving.position_mm(), moving.orientation_deg(), still.position_mm(), still.orientation_deg()];
    println!("{name}, {delay_s} s: {found:.3?}");
    for (found, limit) in found.iter().zip(limits) {
        assert!(found <= limit, "{name}, {delay_s} s: {found} beyond {limit}");
    }
}

#[test]
fn the_steps_of_fig_7_are_followed_over_the_delay() {
    check("coarse", &coarse(), 0.066, &[1.5, 0.17, 0.35, 0.04]);
    check("coarse", &coarse(), 0.1, &[2.0, 0.22, 0.4, 0.05]);
    check("fine", &fine(), 0.066, &[0.85, 0.1, 0.16, 0.02]);
    check("fine", &fine(), 0.1, &[1.2, 0.14, 0.2, 0.025]);
}
