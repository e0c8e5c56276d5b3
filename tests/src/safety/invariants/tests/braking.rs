//! Arms that something else than their commands brakes.

use super::*;

#[test]
fn an_arm_that_stops_by_itself_brakes_as_its_brakes_do() {
    let braking = |stops_by_itself: bool| {
        let mut speed: f64 = 0.5;
        run(
            1.0,
            |_, _| false,
            move |step| {
                let arm = &mut step.arms[TARGET_ARM];
                speed = if step.t_s > 0.5 { (speed - 20.0 * PERIOD_S).max(0.0) } else { speed };
                arm.velocity_rad_per_s[2] = speed;
                arm.position_rad[2] += 0.5 * step.t_s.min(0.5);
                arm.stops_by_itself = stops_by_itself && (0.5..0.62).contains(&step.t_s);
            },
        )
    };
    let found = found_in(&braking(false));
    assert!(found.iter().any(|violation| violation.invariant == Invariant::Acceleration), "{found:?}");
    let found = found_in(&braking(true));
    assert!(found.iter().all(|violation| violation.invariant != Invariant::Acceleration), "{found:?}");
}

/// A joint at 0.5 rad/s that loses its speed within 30 ms behind a lag of 30 ms, as the drives follow the watchdog of the arm.
#[test]
fn a_watchdog_may_slow_an_arm_down_only_when_a_command_is_late() {
    let fades = |late_arm: usize, command_age_s: f64| {
        let mut speed = 0.5;
        run(1.0, always, move |step| {
            let left = 1.0 - ((step.t_s - 0.5) / 0.03).clamp(0.0, 1.0);
            speed += (0.5 * left - speed) * PERIOD_S / 0.03;
            let arm = &mut step.arms[TARGET_ARM];
            arm.velocity_rad_per_s[2] = speed;
            arm.position_rad[2] += speed * step.t_s.min(0.5);
            step.arms[late_arm].command_age_s = if (0.48..0.53).contains(&step.t_s) { command_age_s } else { 0.0 };
        })
    };
    let broken = |truth: &Truth| {
        let found = found_in(truth);
        found.iter().any(|violation| violation.invariant == Invariant::Acceleration)
    };
    assert!(!broken(&fades(TARGET_ARM, 0.03)));
    assert!(broken(&fades(TARGET_ARM, 0.02)), "the command is not late");
    assert!(broken(&fades(HAND_ARM, 0.03)), "only the other arm hears nothing");
    // In a window of 100 ms that begins within the fade the drive loses the rest of its speed, and brakes meanwhile.
    let brakes_on = |rate: f64, since_s: f64| {
        run(
            1.0,
            |_, _| false,
            move |step| {
                let faded = 0.15 * (1.0 - (-(step.t_s - 0.5).max(0.0) / 0.03).exp());
                let arm = &mut step.arms[TARGET_ARM];
                arm.velocity_rad_per_s[2] = (0.5 - faded - rate * (step.t_s - since_s).max(0.0)).max(0.0);
                arm.commands_disturbed = true;
                arm.command_age_s = if (0.48..0.5).contains(&step.t_s) { 0.03 } else { 0.0 };
            },
        )
    };
    assert!(!broken(&brakes_on(2.0, 0.5)));
    assert!(broken(&brakes_on(6.0, 0.79)), "the fade is over");
    // From the other direction: an arm does not gain speed by its watchdog.
    let gains = run(1.0, always, |step| {
        step.arms[TARGET_ARM].command_age_s = 0.03;
        step.arms[TARGET_ARM].velocity_rad_per_s[2] = if step.t_s > 0.5 { 0.5 } else { 0.1 };
    });
    assert!(broken(&gains));
}
