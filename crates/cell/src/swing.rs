//! The hand swings by some millimetres in front of a stationary target; the recorded data gives the delays of the rig.
//!
//! Uses the same parts as a run, with limiter, guard and coupling. Only the motion of the hand is predefined, and the arm with the target
//! holds.

use std::time::Duration;

use anyhow::Result;
use pb3dp_geometry::frames::{Base, CamLeft, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{EnablePosition, JointCommand, JointState};
use pb3dp_kinematics::{Damping, JointVector, damped_pseudo_inverse};
use pb3dp_servo::TargetObservation;
use pb3dp_servo::identification::{Excitation, GivenVelocity};
use pb3dp_setup::setup::Setup;

use super::both_arms::BothArms;
use super::halves::{Mover, RunContext};
use super::parts::Parts;
use super::percept::Percept;
use super::vision::Vision;

/// Time before the motion: the target is initialised and the arm comes to a stop.
const LEAD_IN: Duration = Duration::from_secs(1);
/// Time after the motion, in which the last command becomes visible.
const LEAD_OUT: Duration = Duration::from_millis(500);

/// One confident estimate.
#[derive(Clone, Copy, Debug)]
pub struct ObservedPose {
    /// Stamp of the pair: mid-exposure time from the camera.
    pub at: MonotonicTime,
    /// The first control step that used it.
    pub used_at: MonotonicTime,
    /// Estimated pose.
    pub cam_left_from_model: Pose<CamLeft, Model>,
}

/// Recorded data.
#[derive(Debug, Default)]
pub struct Swung {
    /// Commands to the arm with the cameras.
    pub given: Vec<GivenVelocity>,
    /// Its measured joints.
    pub joints: Vec<JointState>,
    /// Confident estimates.
    pub observed: Vec<ObservedPose>,
    /// Pairs without a confident estimate.
    pub untrusted: usize,
}

/// From the start of enabling until both arms are stopped.
pub fn duration(motion: &Excitation) -> Duration {
    LEAD_IN + Duration::from_secs_f64(motion.duration_s()) + LEAD_OUT
}

/// Swings the hand; stops both arms on every exit path.
///
/// # Errors
/// If an arm, the camera or the estimator fails permanently; the arms are stopped first.
pub fn run(setup: &Setup, parts: Parts, motion: Excitation) -> Result<Swung> {
    let Parts { clock, camera, camera_controls, vs, tc, cell, marking, emulated, interrupt, .. } = parts;
    let vision_input = (camera, cell, marking);
    let Vision { mut capturing, estimating } = Vision::new(setup, vision_input, &clock)?;
    let mut estimating = estimating.with_controls(camera_controls);
    let arms = BothArms::new(setup, (vs, tc), clock.now());
    let mut swinging = Swinging::new(setup, arms, motion)?;
    let run_context = RunContext { setup, clock: &clock, duration: duration(&motion), interrupt: &interrupt };
    // The motion half keeps the estimates.
    let (ended, _) = run_context.run((&mut capturing, &mut estimating, &mut ()), &mut swinging);
    // The arms are dropped before the emulators at the other end of their links.
    let Swinging { arms, record, .. } = swinging;
    drop(arms);
    drop(emulated);
    ended.map(|()| record)
}

/// The motion half with the predefined motion.
struct Swinging<'a> {
    setup: &'a Setup,
    arms: BothArms,
    motion: Excitation,
    damping: Damping,
    /// Pose of the hand at the start; its axes are those of the motion.
    base_from_hand_at_begin: Pose<Base, Hand>,
    /// Start time of the motion.
    begin: MonotonicTime,
    record: Swung,
    last_observed_at: Option<MonotonicTime>,
}

impl<'a> Swinging<'a> {
    fn new(setup: &'a Setup, arms: BothArms, motion: Excitation) -> Result<Self> {
        let seconds = duration(&motion).as_secs_f64() + 1.0;
        // The thread that moves the arms must not allocate.
        let steps = (seconds / setup.control_period.as_secs_f64()) as usize;
        let frames = (seconds / setup.rig.frames.period.as_secs_f64()) as usize;
        let record = Swung {
            given: Vec::with_capacity(steps),
            joints: Vec::with_capacity(steps),
            observed: Vec::with_capacity(frames),
            untrusted: 0,
        };
        Ok(Self {
            motion,
            damping: Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?,
            base_from_hand_at_begin: base_from_hand(setup, arms.vs.joints()),
            begin: MonotonicTime::ZERO,
            record,
            last_observed_at: None,
            arms,
            setup,
        })
    }
}

fn base_from_hand(setup: &Setup, joints: &JointState) -> Pose<Base, Hand> {
    setup.rig.arms.vs.chain.forward(&joints.position_rad) * setup.controller.flange_from_hand
}

/// Adds an item if there is space; drops it otherwise.
fn keep<T>(kept: &mut Vec<T>, item: T) {
    if kept.len() < kept.capacity() {
        kept.push(item);
    }
}

impl Mover for Swinging<'_> {
    type Step = JointState;

    fn enable(&mut self) -> Result<bool> {
        let are_on = self.arms.enable(EnablePosition::Start)?;
        self.base_from_hand_at_begin = base_from_hand(self.setup, self.arms.vs.joints());
        Ok(are_on)
    }

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin + LEAD_IN;
    }

    fn observe(&mut self, percept: Percept, now: MonotonicTime) {
        let Some(TargetObservation { at, cam_left_from_model, trusted, .. }) = percept.observation else { return };
        if self.last_observed_at.is_some_and(|last| at <= last) {
            return;
        }
        self.last_observed_at = Some(at);
        if trusted {
            keep(&mut self.record.observed, ObservedPose { at, used_at: now, cam_left_from_model });
        } else {
            self.record.untrusted += 1;
        }
    }

    fn step(&mut self, now: MonotonicTime) -> Result<JointState> {
        self.swing(now).map_err(|failure| self.arms.traced(failure))
    }

    fn stop(&mut self) -> Result<()> {
        self.arms.stop()
    }
}

impl Swinging<'_> {
    /// One step of the motion.
    fn swing(&mut self, now: MonotonicTime) -> Result<JointState> {
        self.arms.tc.exchange(JointCommand::Hold)?;
        let twist = self.motion.twist_at(now.seconds_since(self.begin)).expressed_in(&self.base_from_hand_at_begin);
        let (chain, joints) = (&self.setup.rig.arms.vs.chain, self.arms.vs.joints());
        let frames = chain.joint_frames(&joints.position_rad);
        let jacobian = chain.jacobian_at(&frames, &base_from_hand(self.setup, joints).translation_m().into());
        let velocity_rad_per_s = damped_pseudo_inverse(&jacobian, &self.damping) * twist.to_vector();
        let measured = self.arms.vs.exchange(JointCommand::Velocity(velocity_rad_per_s))?;
        // An arm that did not answer holds.
        let velocity_rad_per_s = measured.map_or(JointVector::zeros(), |_| velocity_rad_per_s);
        keep(&mut self.record.given, GivenVelocity { at: now, velocity_rad_per_s });
        if let Some(joints) = measured {
            keep(&mut self.record.joints, joints);
        }
        Ok(*self.arms.vs.joints())
    }
}
