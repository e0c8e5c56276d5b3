//! The table of the filter in docs/servo.md: `cargo test -p pb3dp-servo --test integration figures -- --nocapture`.

use nalgebra::Matrix6;
use pb3dp_servo::{MotionConfig, TargetStateConfig};

use super::bench::{FIG7_S, coarse, fig7, fig7_phase, fine, follow};

fn with_both(change: impl Fn(&mut MotionConfig)) -> TargetStateConfig {
    let mut config = TargetStateConfig::default();
    change(&mut config.linear);
    change(&mut config.angular);
    config
}

/// Effect of each part of the model over the motion of Fig. 7, with a seed that was not used to choose parameters.
#[test]
fn each_part_of_the_model_makes_the_hand_quieter() {
    let same = with_both(|part| part.across_share = 1.0);
    let singer = with_both(|part| (part.across_share, part.rest) = (1.0, None));
    let rows = [
        ("default", TargetStateConfig::default()),
        ("same noise in all directions", same),
        ("that, and only Singer", singer),
    ];
    for (name, covariance) in [("coarse", coarse()), ("fine", fine())] as [(&str, Matrix6<f64>); 2] {
        for delay_s in [0.066, 0.1] {
            let mut moving_before = 0.0;
            for (model, config) in &rows {
                let (moving, hold) = follow(config, &covariance, delay_s, FIG7_S, &fig7, &fig7_phase, 101);
                println!(
                    "| {name} | {:.0} | {model} | {:.2} | {:.3} | {:.2} | {:.3} |",
                    delay_s * 1e3,
                    moving.position_mm(),
                    moving.orientation_deg(),
                    hold.position_mm(),
                    hold.orientation_deg()
                );
                let case = format!("{name} {delay_s} {model}");
                assert!(moving.position_mm() > moving_before, "{case}");
                assert!((hold.position_mm() < 0.4) == config.linear.rest.is_some(), "{case}: {}", hold.position_mm());
                moving_before = moving.position_mm();
            }
        }
    }
}
