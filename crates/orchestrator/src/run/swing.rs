//! The hand swings by some millimetres before a target that rests: what is recorded tells the delays of the rig.
//!
//! The same parts as of a run, with limiter, guard and coupling; only what leads the hand is fixed beforehand, and the arm with the
//! target holds.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use pb3dp_geometry::frames::{Base, CamLeft, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{ArmError, ArmErrorKind, Clock, JointCommand, JointState};
use pb3dp_kinematics::{Damping, JointVector, damped_pseudo_inverse};
use pb3dp_servo::TargetObservation;
use pb3dp_servo::identification::{Excitation, GivenVelocity};

use super::live::enter_control_thread;
use super::looking::Looking;
use super::strip::Strip;
use crate::config::setup::{Pace, Setup};
use crate::wiring::{DrivenArm, Parts};

/// Before the hand begins to swing: the target is taken, and the arm has come to rest.
const LEAD_IN: Duration = Duration::from_secs(1);
/// Behind the end: what was told last still has to be seen.
const LEAD_OUT: Duration = Duration::from_millis(500);
/// Observations on their way to the record.
const OBSERVATIONS_MAX: usize = 64;
/// Joint samples on their way to the side that looks.
const JOINTS_MAX: usize = 1000;

/// One estimate that was stood by.
#[derive(Clone, Copy, Debug)]
pub struct SeenPose {
    /// Stamp of the pair: the middle of its exposure, as the camera says.
    pub at: MonotonicTime,
    /// The first control step that had it.
    pub used_at: MonotonicTime,
    /// What was estimated.
    pub cam_left_from_model: Pose<CamLeft, Model>,
}

/// What was recorded.
#[derive(Debug, Default)]
pub struct Swung {
    /// What the arm with the cameras was told.
    pub given: Vec<GivenVelocity>,
    /// What was measured of it.
    pub joints: Vec<JointState>,
    /// What was seen.
    pub seen: Vec<SeenPose>,
    /// Pairs without an estimate that was stood by.
    pub untrusted: usize,
}

/// Swings the hand, and stops both arms on every way out.
///
/// # Errors
/// If an arm, the camera or the estimator fails for good; the arms are stopped first.
pub fn run(setup: &Setup, parts: Parts, motion: Excitation) -> Result<Swung> {
    let Parts { clock, camera, vs, tc, cell, target_outline_m, emulated, interrupt, .. } = parts;
    let strip = Strip::default();
    let mut looking = Looking::new(setup, (camera, cell, target_outline_m), (strip, clock.now()), None)?;
    let mut swinging = Swinging::new(setup, (vs, tc), motion)?;
    if let Err(error) = swinging.enable() {
        swinging.stop().ok();
        return Err(error);
    }
    let begin = clock.now();
    looking.begin_at(begin);
    swinging.begin = begin + LEAD_IN;
    let end = swinging.begin + Duration::from_secs_f64(motion.duration_s()) + LEAD_OUT;
    let swung = if setup.pace == Pace::Live {
        in_the_machines_time(&clock, (looking, swinging), (begin, end), &interrupt)
    } else {
        in_simulated_time(&clock, (looking, swinging), (begin, end), &interrupt)
    };
    drop(emulated);
    swung
}

/// Both arms with the fixed motion.
struct Swinging<'a> {
    setup: &'a Setup,
    vs: Box<dyn DrivenArm>,
    tc: Box<dyn DrivenArm>,
    motion: Excitation,
    damping: Damping,
    /// Where the hand was at the beginning: its axes there are those of the motion.
    base_from_hand_at_begin: Pose<Base, Hand>,
    begin: MonotonicTime,
    joints: JointState,
    record: Swung,
    last_seen_at: Option<MonotonicTime>,
}

impl<'a> Swinging<'a> {
    fn new(setup: &'a Setup, (vs, tc): (Box<dyn DrivenArm>, Box<dyn DrivenArm>), motion: Excitation) -> Result<Self> {
        let position_rad = setup.vs.start_rad;
        let seconds = motion.duration_s() + (LEAD_IN + LEAD_OUT).as_secs_f64() + 1.0;
        // The thread that moves takes nothing from the heap.
        let steps = (seconds / setup.control_period.as_secs_f64()) as usize;
        let frames = (seconds / setup.camera.period.as_secs_f64()) as usize;
        let record = Swung {
            given: Vec::with_capacity(steps),
            joints: Vec::with_capacity(steps),
            seen: Vec::with_capacity(frames),
            untrusted: 0,
        };
        Ok(Self {
            vs,
            tc,
            motion,
            damping: Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?,
            base_from_hand_at_begin: setup.vs.chain.forward(&position_rad) * setup.controller.flange_from_hand,
            begin: MonotonicTime::ZERO,
            joints: JointState { at: MonotonicTime::ZERO, position_rad, velocity_rad_per_s: JointVector::zeros() },
            record,
            last_seen_at: None,
            setup,
        })
    }

    fn enable(&mut self) -> Result<()> {
        self.vs.enable().context("vs-robot: enable")?;
        self.tc.enable().context("tc-robot: enable")?;
        self.joints = self.vs.exchange(JointCommand::Hold).context("vs-robot")?;
        self.tc.exchange(JointCommand::Hold).context("tc-robot")?;
        self.base_from_hand_at_begin = self.base_from_hand();
        Ok(())
    }

    fn base_from_hand(&self) -> Pose<Base, Hand> {
        self.setup.vs.chain.forward(&self.joints.position_rad) * self.setup.controller.flange_from_hand
    }

    fn observe(&mut self, now: MonotonicTime, observation: &TargetObservation) {
        if self.last_seen_at.is_some_and(|last| observation.at <= last)
            || self.record.seen.len() == self.record.seen.capacity()
        {
            return;
        }
        self.last_seen_at = Some(observation.at);
        if !observation.trusted {
            self.record.untrusted += 1;
            return;
        }
        let TargetObservation { at, cam_left_from_model, .. } = *observation;
        self.record.seen.push(SeenPose { at, used_at: now, cam_left_from_model });
    }

    fn step(&mut self, now: MonotonicTime) -> Result<JointState> {
        borne(self.tc.exchange(JointCommand::Hold)).context("tc-robot")?;
        let twist = self.motion.twist_at(now.seconds_since(self.begin)).expressed_in(&self.base_from_hand_at_begin);
        let chain = &self.setup.vs.chain;
        let frames = chain.joint_frames(&self.joints.position_rad);
        let jacobian = chain.jacobian_at(&frames, &self.base_from_hand().translation_m().into());
        let velocity_rad_per_s = damped_pseudo_inverse(&jacobian, &self.damping) * twist.to_vector();
        if self.record.given.len() < self.record.given.capacity() {
            self.record.given.push(GivenVelocity { at: now, velocity_rad_per_s });
        }
        if let Some(joints) = borne(self.vs.exchange(JointCommand::Velocity(velocity_rad_per_s))).context("vs-robot")? {
            self.joints = joints;
            if self.record.joints.len() < self.record.joints.capacity() {
                self.record.joints.push(joints);
            }
        }
        Ok(self.joints)
    }

    fn stop(&mut self) -> Result<()> {
        // Closing the brakes of one takes time in which the other one must not wait for its next velocity.
        for arm in [&mut self.vs, &mut self.tc] {
            arm.exchange(JointCommand::Hold).ok();
        }
        let vs = self.vs.stop().context("vs-robot: stop");
        let tc = self.tc.stop().context("tc-robot: stop");
        vs.and(tc)
    }
}

/// A reply that is only late or lost is nothing: the arm holds meanwhile, and stops by itself when it happens too often.
fn borne(measured: Result<JointState, ArmError>) -> Result<Option<JointState>, ArmError> {
    match measured {
        Err(error) if error.kind() == ArmErrorKind::Timeout => Ok(None),
        other => other.map(Some),
    }
}

/// One thread: control steps and frames in the order of their times.
fn in_simulated_time(
    clock: &Arc<dyn Clock>,
    (mut looking, mut swinging): (Looking<'_>, Swinging<'_>),
    (begin, end): (MonotonicTime, MonotonicTime),
    interrupt: &AtomicBool,
) -> Result<Swung> {
    let setup = swinging.setup;
    let mut arriving: VecDeque<(MonotonicTime, TargetObservation)> = VecDeque::new();
    let (mut next_control, mut next_frame) = (begin, begin + setup.camera.exposure);
    let mut swing = || -> Result<()> {
        while next_control.min(next_frame) <= end && !interrupt.load(Ordering::SeqCst) {
            if next_control <= next_frame {
                clock.sleep_until(next_control);
                while let Some((_, observation)) = arriving.front().filter(|(due, _)| *due <= next_control) {
                    swinging.observe(next_control, observation);
                    arriving.pop_front();
                }
                looking.push_joints(swinging.step(next_control)?);
                next_control = next_control + setup.control_period;
            } else {
                let observation = looking.look()?.and_then(|seen| seen.observation());
                arriving.extend(observation.map(|seen| (clock.now() + setup.estimate_latency, seen)));
                next_frame = next_frame + setup.camera.period;
            }
        }
        Ok(())
    };
    let swung = swing();
    let stopped = swinging.stop();
    swung.and(stopped)?;
    Ok(swinging.record)
}

/// Looking and moving have a thread each, as in a run.
fn in_the_machines_time(
    clock: &Arc<dyn Clock>,
    (mut looking, swinging): (Looking<'_>, Swinging<'_>),
    (begin, end): (MonotonicTime, MonotonicTime),
    interrupt: &AtomicBool,
) -> Result<Swung> {
    let (seen_in, seen_out) = sync_channel(OBSERVATIONS_MAX);
    let (joints_in, joints_out) = sync_channel(JOINTS_MAX);
    let mover = Mover { clock, swinging, seen: seen_out, joints: joints_in, interrupt };
    std::thread::scope(|scope| {
        // However this thread ends, the other one ends, too, and stops the arms.
        let _over = Over(interrupt);
        let thread = std::thread::Builder::new()
            .name("control".to_owned())
            .spawn_scoped(scope, || mover.run((begin, end)))
            .context("no thread for the arms")?;
        let looked = look_on(&mut looking, (&seen_in, &joints_out), interrupt);
        interrupt.store(true, Ordering::SeqCst);
        let swung = thread
            .join()
            .unwrap_or_else(|_| Err(anyhow!("the thread of the arms has failed by a mistake of the program")))?;
        looked.map(|()| swung)
    })
}

fn look_on(
    looking: &mut Looking<'_>,
    (seen_in, joints_out): (&SyncSender<TargetObservation>, &Receiver<JointState>),
    is_over: &AtomicBool,
) -> Result<()> {
    while !is_over.load(Ordering::SeqCst) {
        for joints in joints_out.try_iter() {
            looking.push_joints(joints);
        }
        if let Some(observation) = looking.look()?.and_then(|seen| seen.observation()) {
            seen_in.try_send(observation).ok();
        }
    }
    Ok(())
}

/// Says that it is over when it is dropped.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

struct Mover<'a> {
    clock: &'a Arc<dyn Clock>,
    swinging: Swinging<'a>,
    seen: Receiver<TargetObservation>,
    joints: SyncSender<JointState>,
    interrupt: &'a AtomicBool,
}

impl Mover<'_> {
    fn run(mut self, (begin, end): (MonotonicTime, MonotonicTime)) -> Result<Swung> {
        enter_control_thread();
        let _over = Over(self.interrupt);
        let stepped = self.step_until((begin, end));
        let stopped = self.swinging.stop();
        stepped.and(stopped)?;
        Ok(self.swinging.record)
    }

    fn step_until(&mut self, (begin, end): (MonotonicTime, MonotonicTime)) -> Result<()> {
        let period = self.swinging.setup.control_period;
        let mut due = begin;
        while due <= end && !self.interrupt.load(Ordering::SeqCst) {
            self.clock.sleep_until(due);
            let now = self.clock.now();
            while let Ok(observation) = self.seen.try_recv() {
                self.swinging.observe(now, &observation);
            }
            let joints = self.swinging.step(now)?;
            self.joints.try_send(joints).ok();
            due = due + period;
            // Times that have passed are left out.
            while due + period <= self.clock.now() {
                due = due + period;
            }
        }
        Ok(())
    }
}
