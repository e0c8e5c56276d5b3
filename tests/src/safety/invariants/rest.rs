//! When arms must be stationary.

use super::super::rules::Rules;
use super::super::truth::{HAND_ARM, Step};
use super::{Found, Invariant, Place};

pub(super) fn check(rules: &Rules, steps: &[Step], found: &mut Found) {
    for arm in 0..2 {
        let commanded_s = |step: &Step| match step.arms[arm].latched_since_s {
            Some(_) => 0.0,
            None => rules.commanded_other_s,
        };
        let latched = |step: &Step| step.arms.iter().any(|arm| arm.latched_since_s.is_some());
        let silent = |step: &Step| !step.arms[arm].may_go;
        let blind = |step: &Step| arm == HAND_ARM && step.pose_age_s > rules.pose_age_max_s && !step.may_search;
        let inhibited = |step: &Step| arm == HAND_ARM && step.is_inhibited;
        let [mut latch, mut command, mut pose, mut condition] = [
            Invariant::RestAfterLatch,
            Invariant::HoldWithoutCommand,
            Invariant::RestWithoutPose,
            Invariant::RestWhileInhibited,
        ]
        .map(|invariant| MustRest::new(invariant, arm));
        for step in steps {
            latch.look(rules, step, latched(step).then(|| commanded_s(step)), found);
            command.look(rules, step, silent(step).then_some(0.0), found);
            pose.look(rules, step, blind(step).then_some(0.0), found);
            condition.look(rules, step, inhibited(step).then_some(0.0), found);
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

/// Images that are older than their stamps seem to move with the hand. The hand may move by them until this is noticed; then it comes to
/// rest.
pub(super) fn late_images(rules: &Rules, steps: &[Step], found: &mut Found) {
    let mut rests = MustRest::new(Invariant::LateImages, HAND_ARM);
    let mut moved_s = 0.0;
    for pair in steps.windows(2) {
        let (before, step) = (&pair[0], &pair[1]);
        let is_late = step.content_late_s >= rules.content_late_s;
        let moves = step.arms[HAND_ARM].velocity_rad_per_s.iter().any(|speed| speed.abs() > rules.rest_rad_per_s);
        moved_s = match (is_late, moves) {
            (false, _) => 0.0,
            (true, true) => moved_s + step.t_s - before.t_s,
            (true, false) => moved_s,
        };
        rests.look(rules, step, (moved_s > rules.late_motion_s).then_some(0.0), found);
    }
}

/// One reason for standstill, from its start to its end.
struct MustRest {
    invariant: Invariant,
    arm: usize,
    /// By joint, when it must be stationary, and its position at that time.
    joints: [Option<(f64, Option<f64>)>; 7],
}

impl MustRest {
    fn new(invariant: Invariant, arm: usize) -> Self {
        Self { invariant, arm, joints: [None; 7] }
    }

    /// `reason`: delay until the arm reacts, seconds; none without a reason.
    fn look(&mut self, rules: &Rules, step: &Step, reason: Option<f64>, found: &mut Found) {
        for joint in 0..7 {
            self.look_at_joint(rules, (step, joint), reason, found);
        }
    }

    fn look_at_joint(&mut self, rules: &Rules, (step, joint): (&Step, usize), reason: Option<f64>, found: &mut Found) {
        let truth = &step.arms[self.arm];
        // The latch ends the exceptions for a joint that moves by itself, and for one that only its brake can stop: it determines how
        // long the joint may fall.
        let obeys = truth.driven[joint] && !truth.disobeys[joint];
        let heartbeat_s = reason.filter(|_| obeys || self.invariant == Invariant::RestAfterLatch);
        let Some(heartbeat_s) = heartbeat_s else {
            self.joints[joint] = None;
            return;
        };
        let speed = truth.velocity_rad_per_s[joint];
        let (from_s, rested_rad) = self.joints[joint].get_or_insert_with(|| {
            let within_s = rules.arms[self.arm].rests_within_s(joint, speed, rules.rest_rad_per_s);
            (step.t_s + heartbeat_s + rules.cycle_s + within_s, None)
        });
        if step.t_s <= *from_s {
            return;
        }
        let crept = (truth.position_rad[joint] - *rested_rad.get_or_insert(truth.position_rad[joint])).abs();
        let place = Place { invariant: self.invariant, arm: Some(self.arm), joint: Some(joint), t_s: step.t_s };
        if speed.abs() > rules.rest_rad_per_s {
            found.push(place, (speed.abs(), rules.rest_rad_per_s), "rad/s");
        } else if crept > rules.creep_rad {
            found.push(place, (crept, rules.creep_rad), "rad, crept");
        }
    }
}
