//! Distance of both arms, and of hand and target.

use super::super::rules::Rules;
use super::super::shape::{Rod, room_m};
use super::super::truth::{HAND_ARM, Joints, Placement, Step, TARGET_ARM};
use super::{Found, Invariant, Place};

pub(super) fn check(rules: &Rules, steps: &[Step], found: &mut Found) {
    arms_apart(rules, steps, found);
    target_apart(rules, steps, found);
}

/// Distance of two joint vectors, summed over the joints: no point of the arm moved farther than this times its reach.
fn turned_rad(a: &Joints, b: &Joints) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum()
}

/// A computed distance with the positions of that time: while nothing can have moved far enough to matter, it is reused.
struct Known {
    room_m: f64,
    joints_rad: [Joints; 2],
    target: Placement,
}

fn arms_apart(rules: &Rules, steps: &[Step], found: &mut Found) {
    let (mut first, mut second) = (Vec::new(), Vec::new());
    let reach_m = rules.arms.each_ref().map(|arm| arm.body.reach_m());
    let mut known: Option<Known> = None;
    for step in steps {
        let joints_rad = step.arms.each_ref().map(|arm| arm.position_rad);
        let moved_m = |known: &Known| -> f64 {
            (0..2).map(|arm| reach_m[arm] * turned_rad(&joints_rad[arm], &known.joints_rad[arm])).sum()
        };
        if known.as_ref().is_some_and(|known| known.room_m - moved_m(known) > rules.arms_apart_m) {
            continue;
        }
        rules.arms[HAND_ARM].body.place(&joints_rad[HAND_ARM], &mut first);
        rules.arms[TARGET_ARM].body.place(&joints_rad[TARGET_ARM], &mut second);
        let room_m = room_m(&first, &second);
        known = Some(Known { room_m, joints_rad, target: step.world_from_target });
        if room_m.is_nan() || room_m < rules.arms_apart_m {
            let place = Place { invariant: Invariant::ArmsApart, arm: None, joint: None, t_s: step.t_s };
            found.push(place, (room_m, rules.arms_apart_m), "");
        }
    }
}

/// Largest change of the target's position in one step, metres.
fn displaced_m(rules: &Rules, a: &Placement, b: &Placement) -> f64 {
    let norm = |numbers: &mut dyn Iterator<Item = f64>| numbers.map(|x| x * x).sum::<f64>().sqrt();
    let moved = norm(&mut a.translation_m.iter().zip(&b.translation_m).map(|(a, b)| a - b));
    let turned = norm(&mut a.rotation.iter().flatten().zip(b.rotation.iter().flatten()).map(|(a, b)| a - b));
    let farthest = rules.target.iter().flat_map(|rod| rod.ends_m).map(|end| norm(&mut end.into_iter()));
    moved + turned * farthest.fold(0.0, f64::max)
}

/// Below the minimum distance there is no pose. The hand may follow the prediction until the last pose is too old, and then only use its
/// braking distance; the target's own motion does not count.
fn target_apart(rules: &Rules, steps: &[Step], found: &mut Found) {
    let body = &rules.arms[HAND_ARM].body;
    let reach_m = body.reach_m();
    let mut rods = Vec::new();
    let mut known: Option<Known> = None;
    // Since when the target is too near, and how much closer the hand has come by its own motion: until the pose is too old, and after.
    let mut too_near_since_s = None;
    let (mut followed_m, mut braked_m) = (0.0, 0.0);
    for (index, step) in steps.iter().enumerate() {
        let joints_rad = step.arms.each_ref().map(|arm| arm.position_rad);
        let moved_m = |known: &Known| {
            reach_m * turned_rad(&joints_rad[HAND_ARM], &known.joints_rad[HAND_ARM])
                + displaced_m(rules, &step.world_from_target, &known.target)
        };
        if known.as_ref().is_some_and(|known| known.room_m - moved_m(known) > rules.target_apart_m) {
            continue;
        }
        let target: Vec<Rod> = rules.target.iter().map(|rod| rod.placed(&step.world_from_target)).collect();
        let mut room_of = |joints_rad: &Joints| {
            body.place(joints_rad, &mut rods);
            // The other invariant covers base and links up to the wrist.
            room_m(&rods[3..], &target)
        };
        let now_m = room_of(&joints_rad[HAND_ARM]);
        known = Some(Known { room_m: now_m, joints_rad, target: step.world_from_target });
        if now_m >= rules.target_apart_m {
            too_near_since_s = None;
            (followed_m, braked_m) = (0.0, 0.0);
            continue;
        }
        let since_s = *too_near_since_s.get_or_insert(step.t_s);
        let is_pose_too_old = step.t_s - since_s > rules.pose_age_max_s;
        if let Some(before) = index.checked_sub(1).map(|before| &steps[before]) {
            let nearer_m = (room_of(&before.arms[HAND_ARM].position_rad) - now_m).max(0.0);
            *if is_pose_too_old { &mut braked_m } else { &mut followed_m } += nearer_m;
        }
        let limits = [(followed_m, rules.hand_m_per_s * rules.pose_age_max_s), (braked_m, rules.target_braking_m)];
        for (value, limit) in limits.into_iter().filter(|(value, limit)| value > limit) {
            let place = Place { invariant: Invariant::TargetApart, arm: Some(HAND_ARM), joint: None, t_s: step.t_s };
            found.push(place, (value, limit), format!("{now_m:.3} m remain"));
        }
    }
}
