//! The limits, as plain numbers, each with its source.
//!
//! They are not read from a setup: a setup must meet them, and a wrong setup must be detected.

use super::pa10::SECOND_GENERATION_M;
use super::shape::{ArmBody, Build, Rod};
use super::truth::{Joints, Placement};

/// Limits of one arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmRules {
    /// Shape and base pose.
    pub body: ArmBody,
    /// Ends of the operating range, radians.
    pub operating_rad: Joints,
    /// Tolerance of the operating range: see [`Rules::of_the_rig`].
    pub operating_margin_rad: f64,
    /// Mechanical stops, radians: the range of a joint that does not obey any more.
    pub mechanical_rad: Joints,
    /// Largest speeds, rad/s.
    pub speed_rad_per_s: Joints,
    /// Largest accelerations, rad/s^2.
    pub acceleration_rad_per_s2: Joints,
    /// Largest jerks, rad/s^3.
    pub jerk_rad_per_s3: Joints,
    /// First-order lag of the drives, seconds.
    pub lag_s: f64,
    /// Whether the drives themselves keep the acceleration limit: at this limit the motion does not show the command.
    pub drives_clip: bool,
    /// Dry friction of the drives, rad/s: by so much a joint may be slower than commanded.
    pub friction_rad_per_s: f64,
    /// From an event to the command at which the arm starts to brake, seconds.
    pub reaction_s: f64,
    /// From the loss of power to standstill, seconds, for a stationary joint.
    pub power_off_s: f64,
}

impl ArmRules {
    /// An arm with six axes that carries the cameras, simulated in the process: `configs/arms/ur5e.toml`. Its seventh joint does not
    /// exist.
    ///
    /// * Ranges and speeds: data sheet of the UR5e (360 degrees, the elbow 180; 180 degrees/s), 5 to 10 degrees and 0.6 of the speed.
    /// * Accelerations and jerks: those of the PA-10. The drives have a lag of 25 ms, and keep the acceleration limit, also when the arm
    ///   stops by itself.
    pub fn with_six_axes() -> Self {
        let camera = Rod { ends_m: [[0.0, -0.05, 0.04], [0.0, 0.05, 0.04]], radius_m: 0.07 };
        let base = Placement { translation_m: [-0.84, 0.13, 0.45], ..Placement::IDENTITY };
        let speed = 0.6 * std::f64::consts::PI;
        Self {
            body: ArmBody { build: Build::Ur5e, base, radii_m: [0.09, 0.075, 0.065, 0.06], mounted: vec![camera] },
            operating_rad: radians([350.0, 350.0, 175.0, 350.0, 350.0, 350.0, 1.0]),
            operating_margin_rad: 0.2f64.to_radians(),
            mechanical_rad: radians([360.0, 360.0, 180.0, 360.0, 360.0, 360.0, 1.0]),
            speed_rad_per_s: [speed; 7],
            acceleration_rad_per_s2: [2.0, 2.0, 2.0, 5.0, 5.0, 5.0, 5.0],
            jerk_rad_per_s3: [80.0, 80.0, 80.0, 200.0, 200.0, 200.0, 200.0],
            lag_s: 0.025,
            drives_clip: true,
            friction_rad_per_s: 0.0,
            reaction_s: 0.030,
            power_off_s: 0.090,
        }
    }

    /// From an event to standstill, seconds, at this speed: the joint may still gain speed until it brakes; it brakes within
    /// the limits of jerk and acceleration; the residual speed from the lag of the drive decays to `rest_rad_per_s`.
    pub fn rests_within_s(&self, joint: usize, speed_rad_per_s: f64, rest_rad_per_s: f64) -> f64 {
        let (a, j) = (self.acceleration_rad_per_s2[joint], self.jerk_rad_per_s3[joint]);
        let speed = (speed_rad_per_s.abs() + a * self.reaction_s).min(self.speed_rad_per_s[joint]);
        let left = (a * self.lag_s / rest_rad_per_s).max(1.0);
        let braked_s = self.reaction_s + speed / a + a / j + self.lag_s * left.ln();
        braked_s.max(self.power_off_s)
    }
}

/// Limits of a workcell of two arms.
#[derive(Clone, Debug, PartialEq)]
pub struct Rules {
    /// The arm with the cameras, and the one with the target.
    pub arms: [ArmRules; 2],
    /// Period of the host's commands, seconds.
    pub cycle_s: f64,
    /// An arm whose command is older than this may be slowed down by its watchdog, seconds.
    pub fades_after_s: f64,
    /// The watchdog takes this time from any speed to standstill, seconds.
    pub fade_s: f64,
    /// Longest time between two steps of the record, seconds.
    pub step_max_s: f64,
    /// Speed below which an arm is stationary, rad/s.
    pub rest_rad_per_s: f64,
    /// Allowed creep of a stationary joint, radians.
    pub creep_rad: f64,
    /// Allowed time of motion without a fresh, confident pose, seconds since its exposure.
    pub pose_age_max_s: f64,
    /// Speed of a hand that searches, m/s.
    pub search_m_per_s: f64,
    /// Its largest distance from the start of the search, metres.
    pub search_reach_m: f64,
    /// Within this time after the stop of one arm the other one gets the stop, seconds.
    pub commanded_other_s: f64,
    /// A joint that moves by itself may be too fast for this time, seconds.
    pub too_fast_s: f64,
    /// And for this much longer while samples or commands may be lost or late, seconds.
    pub unobserved_s: f64,
    /// The arm of a joint that moves by itself is latched within this time, seconds.
    pub disobedience_s: f64,
    /// Minimum distance of both arms, metres.
    pub arms_apart_m: f64,
    /// The volume of the target, in its frame.
    pub target: Vec<Rod>,
    /// Distance of hand and target below which there is no pose, metres.
    pub target_apart_m: f64,
    /// Speed limit of the hand, m/s: so fast it may follow the prediction until the last pose is older than `pose_age_max_s`.
    pub hand_m_per_s: f64,
    /// Braking distance, metres: how much closer the hand may get by its own motion after that time.
    pub target_braking_m: f64,
    /// Content that is older than its stamp by this much makes the hand swing, seconds.
    pub content_late_s: f64,
    /// The hand moves no longer than this by such content, seconds.
    pub late_motion_s: f64,
    /// The log reports a fault within this time after its end, seconds.
    pub log_within_s: f64,
}

fn radians(degrees: Joints) -> Joints {
    degrees.map(f64::to_radians)
}

impl Rules {
    /// The workcell of the rig: two PA10-7CE, 2 m apart, face to face, with 0.6 of their speeds, and the lag and delay of the
    /// arms of `configs/sim.toml`.
    ///
    /// * Operating ranges: 3 to 7 degrees within the servo limits that MHI's model data and two drivers give.
    ///   The tolerance is 0.2 degrees: a braking joint moves on in each of the cycles in a row that may be lost.
    /// * Mechanical ranges and speeds: INRIA's `modele.sci` of the PA10-7CE; E2 is slower by NTUA's driver.
    /// * Accelerations: the requirements for this arm; no source states them.
    /// * `pose_age_max_s`: `[servo.timeouts] observation_s` and the policy `estimate_stale`, plus a cycle.
    /// * `fades_after_s`, `fade_s`: requirement R2 of this arm, whose watchdog slows an arm down from a command age of 20 ms on, and
    ///   has stopped it at 50 ms.
    /// * `power_off_s`: brakes of the emulated arm close in 50 ms, gravity accelerates a joint to 0.6 rad/s in that time, and
    ///   brakes decelerate at 50 rad/s^2.
    /// * `target_apart_m`: the smallest depth of the search, 350 mm, minus 50 mm between the camera's front and its pupil. A
    ///   closer target gives no pose, and the hand may follow the prediction until the last one is too old.
    /// * `hand_m_per_s`: `[servo.speed]`. `target_braking_m`: at this speed 0.4 m/s * (`lag_s` + `reaction_s`) is 24 mm, and braking with
    ///   2 rad/s^2 in a joint 0.8 m away, (0.4 m/s)^2 / (2 * 1.6 m/s^2), is 50 mm.
    /// * `search_m_per_s`, `search_reach_m`: 30 mm/s, and 50 mm back and aside ([servo.md](../../../docs/servo.md)), as the
    ///   runs request; a hand that is returned to its path is faster and farther by up to a third, or a fifth and 5 mm.
    /// * `too_fast_s`: five cycles. One until the first sample, one until the second sample confirms it, one by which
    ///   samples are old, one for the command to the brakes, and one of the record.
    /// * `unobserved_s`: a fault of the bus repeats up to 50 samples of 2 ms; a control loop that stands still is missed after 50 ms, and
    ///   brakes close in 50 ms.
    /// * `content_late_s`, `late_motion_s`: the requirement for a delay of 200 ms that the model does not know: held within 2 s of motion.
    ///   Smaller delays are noticed later, if the hand moves little.
    /// * `log_within_s`: 0.5 s for the reader, and the time for which the control loop stops both arms before it reports why: the
    ///   brakes of one arm take 0.2 s, and an arm that does not answer is given up after 0.5 s more.
    /// * `disobedience_s`: 0.05 rad of tracking error at 0.05 rad/s, 0.1 s for which it must last, and the decay meanwhile.
    pub fn of_the_rig() -> Self {
        let camera = Rod { ends_m: [[0.0, -0.05, 0.04], [0.0, 0.05, 0.04]], radius_m: 0.07 };
        let panel = |x_m: f64| Rod { ends_m: [[x_m, -0.15, 0.08], [x_m, 0.15, 0.08]], radius_m: 0.091 };
        let arm = |base: Placement, mounted: Vec<Rod>| ArmRules {
            body: ArmBody { build: Build::Pa10(SECOND_GENERATION_M), base, radii_m: [0.12, 0.11, 0.09, 0.07], mounted },
            operating_rad: radians([170.0, 88.0, 168.0, 131.0, 249.0, 159.0, 249.0]),
            operating_margin_rad: 0.2f64.to_radians(),
            mechanical_rad: radians([180.0, 97.0, 180.0, 143.0, 270.0, 180.0, 270.0]),
            speed_rad_per_s: [0.6, 0.6, 1.2, 1.2, 1.2, 3.77, 3.77],
            acceleration_rad_per_s2: [2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0],
            jerk_rad_per_s3: [80.0, 80.0, 80.0, 80.0, 200.0, 200.0, 200.0],
            lag_s: 0.030,
            drives_clip: false,
            friction_rad_per_s: 0.0,
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
            fades_after_s: 0.020,
            fade_s: 0.030,
            step_max_s: 0.002,
            rest_rad_per_s: 0.002,
            creep_rad: 0.003,
            pose_age_max_s: 0.310,
            search_m_per_s: 0.040,
            search_reach_m: 0.090,
            commanded_other_s: 0.030,
            too_fast_s: 0.05,
            unobserved_s: 0.1,
            disobedience_s: 2.0,
            arms_apart_m: 0.049,
            target: vec![Rod { ends_m: [[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0]], radius_m: 0.05 }],
            target_apart_m: 0.300,
            hand_m_per_s: 0.4,
            target_braking_m: 0.075,
            content_late_s: 0.15,
            late_motion_s: 2.0,
            log_within_s: 1.2,
        }
    }
}
