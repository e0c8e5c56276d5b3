//! What is allowed, as plain numbers, each with its source.
//!
//! They are not read from a setup: what a setup says has to keep to them, and a wrong one has to be found out.

use super::pa10::SECOND_GENERATION_M;
use super::shape::{ArmBody, Rod};
use super::truth::{Joints, Placement};

/// What is allowed to one arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmRules {
    /// What it looks like and where it stands.
    pub body: ArmBody,
    /// Ends of the operating range to either side, radians.
    pub operating_rad: Joints,
    /// How far a joint may be beyond: see [`Rules::of_the_rig`].
    pub operating_margin_rad: f64,
    /// The arm's own stops to either side, radians: what holds where nothing obeys any more.
    pub mechanical_rad: Joints,
    /// Largest speeds, rad/s.
    pub speed_rad_per_s: Joints,
    /// Largest accelerations, rad/s^2.
    pub acceleration_rad_per_s2: Joints,
    /// Largest jerks, rad/s^3.
    pub jerk_rad_per_s3: Joints,
    /// First-order lag with which the drives follow, seconds.
    pub lag_s: f64,
    /// From something that happens to a command by which the arm begins to brake, seconds.
    pub reaction_s: f64,
    /// From the loss of power to rest, seconds, for a joint that stood.
    pub power_off_s: f64,
}

impl ArmRules {
    /// From something that happens to rest, seconds, at this speed: the joint may still gain speed until it brakes; it brakes
    /// within the limits of jerk and acceleration; what is left by the lag of the drive fades to `rest_rad_per_s`.
    pub fn rests_within_s(&self, joint: usize, speed_rad_per_s: f64, rest_rad_per_s: f64) -> f64 {
        let (a, j) = (self.acceleration_rad_per_s2[joint], self.jerk_rad_per_s3[joint]);
        let speed = (speed_rad_per_s.abs() + a * self.reaction_s).min(self.speed_rad_per_s[joint]);
        let left = (a * self.lag_s / rest_rad_per_s).max(1.0);
        let braked_s = self.reaction_s + speed / a + a / j + self.lag_s * left.ln();
        braked_s.max(self.power_off_s)
    }
}

/// What is allowed to a cell of two arms.
#[derive(Clone, Debug, PartialEq)]
pub struct Rules {
    /// The arm with the cameras, and the one with the target.
    pub arms: [ArmRules; 2],
    /// Period of the host's commands, seconds.
    pub cycle_s: f64,
    /// Longest time between two steps of the record, seconds.
    pub step_max_s: f64,
    /// What counts as rest, rad/s.
    pub rest_rad_per_s: f64,
    /// How far a joint that has to rest may creep, radians.
    pub creep_rad: f64,
    /// How long the hand may go on without a fresh, confident pose, seconds since its exposure.
    pub pose_age_max_s: f64,
    /// How fast a hand is that searches, m/s.
    pub search_m_per_s: f64,
    /// How far it goes from where it began to, metres.
    pub search_reach_m: f64,
    /// Within this time after the stop of one arm the other one gets the stop, seconds.
    pub told_other_s: f64,
    /// How long a joint may be too fast that moves by itself, seconds.
    pub too_fast_s: f64,
    /// How long a joint may move by itself until the arm is latched, seconds.
    pub disobedience_s: f64,
    /// Least room between both arms, metres.
    pub arms_apart_m: f64,
    /// What the target fills, in its frame.
    pub target: Vec<Rod>,
    /// Room between hand and target below which the hand may only brake, metres.
    pub target_apart_m: f64,
    /// The way that braking takes, metres: how much nearer the hand may get by its own motion.
    pub target_braking_m: f64,
    /// Within this time after the end of a fault something is said about it, seconds.
    pub log_within_s: f64,
}

fn radians(degrees: Joints) -> Joints {
    degrees.map(f64::to_radians)
}

impl Rules {
    /// The cell of the rig: two PA10-7CE, 2 m apart, face to face, with 0.6 of their speeds, lag and delay of the arms of
    /// `configs/sim.toml`.
    ///
    /// * Operating ranges: 3 to 7 degrees within the servo limits that MHI's model data and two drivers give.
    ///   0.2 degrees beyond are allowed: each of the cycles in a row that may get lost moves a joint on that is braking.
    /// * Mechanical ranges and speeds: INRIA's `modele.sci` of the PA10-7CE; E2 is slower by NTUA's driver.
    /// * Accelerations: the requirements for this arm; no source has any.
    /// * `pose_age_max_s`: `[servo.timeouts] observation_s` and the policy `estimate_stale`, and a cycle.
    /// * `power_off_s`: brakes of the emulated arm close in 50 ms, gravity brings a joint to 0.6 rad/s in that time, and brakes
    ///   take 50 rad/s^2.
    /// * `target_apart_m`: the least depth of the search, 350 mm, less 50 mm by which the camera's body is before its pupils. A
    ///   target nearer than that gives no pose. `target_braking_m`: chosen. In 200 runs the hand came nearer by 12 mm at most; with half of
    ///   60 mm these runs still pass. At 0.4 m/s (`[servo.speed]`) for `pose_age_max_s`, and half of that speed for 0.3 s, it would be
    ///   180 mm: a hand that goes on until its pose is too old is found.
    /// * `search_m_per_s`, `search_reach_m`: 30 mm/s, and 50 mm back and aside ([servo.md](../../../docs/servo.md)), as the runs ask for;
    ///   a hand that is brought back to its way is faster and farther by up to a third, or a fifth and 5 mm.
    /// * `too_fast_s`: five cycles. One until the first sample, one until the second one, by which it is believed, one by which
    ///   samples are old, one for the order to the brakes, and one of the record.
    /// * `disobedience_s`: 0.05 rad of tracking error at 0.05 rad/s, 0.1 s for which it has to last, and what fades meanwhile.
    pub fn of_the_rig() -> Self {
        let camera = Rod { ends_m: [[0.0, -0.05, 0.04], [0.0, 0.05, 0.04]], radius_m: 0.07 };
        let panel = |x_m: f64| Rod { ends_m: [[x_m, -0.15, 0.08], [x_m, 0.15, 0.08]], radius_m: 0.091 };
        let arm = |base: Placement, mounted: Vec<Rod>| ArmRules {
            body: ArmBody { lengths_m: SECOND_GENERATION_M, base, radii_m: [0.12, 0.11, 0.09, 0.07], mounted },
            operating_rad: radians([170.0, 88.0, 168.0, 131.0, 249.0, 159.0, 249.0]),
            operating_margin_rad: 0.2f64.to_radians(),
            mechanical_rad: radians([180.0, 97.0, 180.0, 143.0, 270.0, 180.0, 270.0]),
            speed_rad_per_s: [0.6, 0.6, 1.2, 1.2, 1.2, 3.77, 3.77],
            acceleration_rad_per_s2: [2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0],
            jerk_rad_per_s3: [80.0, 80.0, 80.0, 80.0, 200.0, 200.0, 200.0],
            lag_s: 0.030,
            reaction_s: 0.030,
            power_off_s: 0.090,
        };
        let left = Placement { translation_m: [-1.0, 0.0, 0.7], ..Placement::IDENTITY };
        let right = Placement {
            rotation: [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
            translation_m: [1.0, 0.0, 0.7],
        };
        Self {
            arms: [arm(left, vec![camera]), arm(right, vec![panel(0.075), panel(-0.075)])],
            cycle_s: 0.010,
            step_max_s: 0.002,
            rest_rad_per_s: 0.002,
            creep_rad: 0.003,
            pose_age_max_s: 0.310,
            search_m_per_s: 0.040,
            search_reach_m: 0.090,
            told_other_s: 0.030,
            too_fast_s: 0.05,
            disobedience_s: 2.0,
            arms_apart_m: 0.049,
            target: vec![Rod { ends_m: [[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0]], radius_m: 0.05 }],
            target_apart_m: 0.300,
            target_braking_m: 0.060,
            log_within_s: 0.5,
        }
    }
}
