//! How a hand may look for its target: near to where it was lost, and slowly.

use super::super::pa10::links;
use super::super::rules::Rules;
use super::super::truth::{HAND_ARM, Step};
use super::{Found, Invariant, Place};

pub(super) fn check(rules: &Rules, steps: &[Step], found: &mut Found) {
    let lengths_m = &rules.arms[HAND_ARM].body.lengths_m;
    // Where the flange was when the hand began to be allowed to, and a step ago.
    let mut way: Option<([f64; 3], [f64; 3], f64)> = None;
    for step in steps {
        let arm = &step.arms[HAND_ARM];
        let may = step.may_search && step.pose_age_s > rules.pose_age_max_s && arm.obeys && arm.servo_on;
        if !may {
            way = None;
            continue;
        }
        let now_m = links(lengths_m, &arm.position_rad).flange.translation_m;
        let (began_m, before_m, before_s) = *way.get_or_insert((now_m, now_m, step.t_s));
        let place = Place { invariant: Invariant::Search, arm: Some(HAND_ARM), joint: None, t_s: step.t_s };
        let far_m = distance_m(&began_m, &now_m);
        if far_m > rules.search_reach_m {
            found.push(place, (far_m, rules.search_reach_m), "m from where it began");
        }
        let speed = if step.t_s > before_s { distance_m(&before_m, &now_m) / (step.t_s - before_s) } else { 0.0 };
        if speed > rules.search_m_per_s {
            found.push(place, (speed, rules.search_m_per_s), "m/s");
        }
        way = Some((began_m, now_m, step.t_s));
    }
}

fn distance_m(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}
