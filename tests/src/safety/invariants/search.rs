//! How a hand may search for its target: close to the position of the loss, and slowly.

use super::super::rules::Rules;
use super::super::truth::{HAND_ARM, Step};
use super::{Found, Invariant, Place};

pub(super) fn check(rules: &Rules, steps: &[Step], found: &mut Found) {
    let arm_rules = &rules.arms[HAND_ARM];
    let flange_m = |step: &Step| arm_rules.body.build.flange(&step.arms[HAND_ARM].position_rad).translation_m;
    let may = |step: &Step| {
        let arm = &step.arms[HAND_ARM];
        step.may_search && step.pose_age_s > rules.pose_age_max_s && arm.obeys() && arm.servo_on
    };
    // When a hand that moved at the loss must have braked, and the position from which it then searches.
    let mut braked_s: Option<f64> = None;
    let mut began_m: Option<[f64; 3]> = None;
    for pair in steps.windows(2) {
        let step = &pair[1];
        if !may(step) {
            (braked_s, began_m) = (None, None);
            continue;
        }
        let braked_s = *braked_s.get_or_insert_with(|| {
            let speeds = step.arms[HAND_ARM].velocity_rad_per_s.iter().enumerate();
            let within_s = speeds.map(|(joint, speed)| arm_rules.rests_within_s(joint, *speed, rules.rest_rad_per_s));
            step.t_s + rules.cycle_s + within_s.fold(0.0, f64::max)
        });
        let (before_m, now_m) = (flange_m(&pair[0]), flange_m(step));
        let passed_s = step.t_s - pair[0].t_s;
        let speed = if passed_s > 0.0 { distance_m(&before_m, &now_m) / passed_s } else { 0.0 };
        let is_fast = speed > rules.search_m_per_s;
        if began_m.is_none() && is_fast && step.t_s <= braked_s {
            continue;
        }
        let place = Place { invariant: Invariant::Search, arm: Some(HAND_ARM), joint: None, t_s: step.t_s };
        let far_m = distance_m(began_m.get_or_insert(now_m), &now_m);
        if far_m > rules.search_reach_m {
            found.push(place, (far_m, rules.search_reach_m), "m from the start of the search");
        }
        if is_fast {
            found.push(place, (speed, rules.search_m_per_s), "m/s");
        }
    }
}

fn distance_m(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}
