//! When arms must be stationary.

use super::super::rules::Rules;
use super::super::truth::{HAND_ARM, Joints, Step};
use super::{Found, Invariant, Place};

pub(super) fn check(rules: &Rules, steps: &[Step], found: &mut Found) {
    for arm in 0..2 {
        let told_s = |step: &Step| match step.arms[arm].latched_since_s {
            Some(_) => 0.0,
            None => rules.told_other_s,
        };
        let latched = |step: &Step| step.arms.iter().any(|arm| arm.latched_since_s.is_some());
        // The latch ends the exception for a joint that moves by itself.
        // Without servos only the brake stops a joint: the latch determines how long it may fall.
        let drives = |step: &Step| step.arms[arm].obeys && step.arms[arm].servo_on;
        let silent = |step: &Step| drives(step) && !step.arms[arm].may_go;
        let blind =
            |step: &Step| arm == HAND_ARM && drives(step) && step.pose_age_s > rules.pose_age_max_s && !step.may_search;
        let mut latch = MustRest::new(Invariant::RestAfterLatch, arm);
        let mut word = MustRest::new(Invariant::RestWithoutWord, arm);
        let mut pose = MustRest::new(Invariant::RestWithoutPose, arm);
        for step in steps {
            latch.look(rules, step, latched(step).then(|| told_s(step)), found);
            word.look(rules, step, silent(step).then_some(0.0), found);
            pose.look(rules, step, blind(step).then_some(0.0), found);
        }
        for pair in steps.windows(2) {
            let was_latched = pair[0].arms[arm].latched_since_s.is_some();
            let is_latched = pair[1].arms[arm].latched_since_s.is_some();
            if was_latched && !is_latched && pair[1].resets <= pair[0].resets {
                let t_s = pair[1].t_s;
                let place = Place { invariant: Invariant::LatchCleared, arm: Some(arm), joint: None, t_s };
                let resets = f64::from(pair[1].resets);
                found.push(place, (resets, f64::from(pair[0].resets) + 1.0), "resets so far, and required number");
            }
        }
    }
}

/// One reason for standstill, from its start to its end.
struct MustRest {
    invariant: Invariant,
    arm: usize,
    /// When the arm must be stationary.
    from_s: Option<f64>,
    /// Its position at that time.
    rested_rad: Option<Joints>,
}

impl MustRest {
    fn new(invariant: Invariant, arm: usize) -> Self {
        Self { invariant, arm, from_s: None, rested_rad: None }
    }

    /// `reason`: delay until the arm reacts, seconds; none without a reason.
    fn look(&mut self, rules: &Rules, step: &Step, reason: Option<f64>, found: &mut Found) {
        let Some(heard_s) = reason else {
            (self.from_s, self.rested_rad) = (None, None);
            return;
        };
        let truth = &step.arms[self.arm];
        let arm_rules = &rules.arms[self.arm];
        let from_s = *self.from_s.get_or_insert_with(|| {
            let within_s = (0..7).map(|joint| {
                let speed = truth.velocity_rad_per_s[joint];
                arm_rules.rests_within_s(joint, speed, rules.rest_rad_per_s)
            });
            step.t_s + heard_s + rules.cycle_s + within_s.fold(0.0, f64::max)
        });
        if step.t_s <= from_s {
            return;
        }
        let rested_rad = *self.rested_rad.get_or_insert(truth.position_rad);
        for (joint, rested_rad) in rested_rad.iter().enumerate() {
            let speed = truth.velocity_rad_per_s[joint].abs();
            let crept = (truth.position_rad[joint] - rested_rad).abs();
            let place = Place { invariant: self.invariant, arm: Some(self.arm), joint: Some(joint), t_s: step.t_s };
            if speed > rules.rest_rad_per_s {
                found.push(place, (speed, rules.rest_rad_per_s), "rad/s");
            } else if crept > rules.creep_rad {
                found.push(place, (crept, rules.creep_rad), "rad, crept");
            }
        }
    }
}
