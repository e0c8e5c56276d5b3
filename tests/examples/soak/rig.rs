//! Both arms with the wiring of a run, and the true motion of their joints.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_cell::cell::ArmSite;
use pb3dp_cell::live::CONTROL_THREAD;
use pb3dp_cell::parts::ArmControl;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmErrorKind, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_middleware::StartPose;
use pb3dp_hal_platform::realtime::{Realtime, enter};
use pb3dp_kinematics::JointVector;
use pb3dp_setup::setup::read_setup;
use pb3dp_wiring::arm::{WiredArms, wire_arms};
use system_tests::repository;

use crate::figures::Figures;

/// An arm is stationary if every joint is slower than this, rad/s.
pub const AT_REST_RAD_PER_S: f64 = 1e-3;
/// Time for which the joints are observed after a stop.
const WATCHED: Duration = Duration::from_millis(500);
/// A control step that starts later than this counts as a missed deadline.
pub const DEADLINE: Duration = Duration::from_millis(5);
/// A stop within this time after a missed deadline may be a reaction to it.
const LATE_FOR: Duration = Duration::from_millis(200);
/// Joints return to their start with this rate, 1/s.
const BACK_PER_S: f64 = 0.3;
/// One of this many replies of a gateway is lost on lines with losses, and never more in a row.
const LINE_LOSS_ONE_OF: u32 = 100;
const LINE_LOSSES_IN_A_ROW_MAX: u8 = 2;
/// Largest number of attempts to enable the arms.
const TRIES: usize = 40;

/// An arm has refused to continue.
pub struct Stopped {
    /// When the control loop got the report.
    pub at: MonotonicTime,
    /// Kind of the error.
    pub kind: ArmErrorKind,
    /// Message of the error.
    pub message: String,
    /// Whether a thread missed a deadline shortly before: then the arms may stop because of it.
    pub was_late: bool,
}

/// Both arms.
pub struct Rig {
    /// The clock of all parts.
    pub clock: Arc<dyn Clock>,
    period: Duration,
    wired: WiredArms,
    homes_rad: [JointVector; 2],
    joints_rad: [JointVector; 2],
    watcher: Watcher,
    next: MonotonicTime,
    begin: MonotonicTime,
    /// Time of the last missed deadline.
    missed_at: Option<MonotonicTime>,
    /// Number of cycles of links and emulated arms that started later than a deadline.
    late_elsewhere: u64,
    line_losses: Option<LineLosses>,
}

/// Which replies of the gateways are lost on their lines.
struct LineLosses {
    random: SplitMix64,
    in_a_row: [u8; 2],
}

impl Rig {
    /// Arms as in `configs/hil.toml`, connected and with closed brakes.
    pub fn new(seed: u64) -> Result<Self> {
        let mut setup = read_setup(&repository().join("configs/hil.toml"))?;
        setup.reseed(seed);
        for arm in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc] {
            // Drives as fast as those of a real arm must be; the loop uses only its measurements.
            arm.plant.velocity_time_constant = Duration::from_millis(5);
            // The motions start where the last fault has left the joints.
            arm.limiter.start = StartPose::Anywhere;
        }
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let wired = wire_arms(&setup, &clock, None)?;
        for emulated in &wired.emulated {
            emulated.command_line("chance 1% at-most 2 drop 1").context("losses at random")?;
        }
        for shortfall in enter(&CONTROL_THREAD) {
            println!("{shortfall}");
        }
        let homes_rad = [setup.rig.arms.vs.start_rad, setup.rig.arms.tc.start_rad];
        let watcher = Watcher::start(wired.sites.clone(), Arc::clone(&clock))?;
        let now = clock.now();
        Ok(Self {
            period: setup.control_period,
            clock,
            wired,
            homes_rad,
            joints_rad: homes_rad,
            watcher,
            next: now,
            begin: now,
            missed_at: None,
            late_elsewhere: 0,
            line_losses: None,
        })
    }

    /// From now on one of a hundred replies of each gateway is lost, too, never three in a row.
    pub fn lose_replies_on_the_line(&mut self, seed: u64) {
        self.line_losses = Some(LineLosses { random: SplitMix64::new(seed), in_a_row: [0; 2] });
    }

    fn lose_on_the_line(&mut self) {
        let Some(losses) = &mut self.line_losses else { return };
        for (emulated, in_a_row) in self.wired.emulated.iter().zip(&mut losses.in_a_row) {
            let is_lost = losses.random.below(LINE_LOSS_ONE_OF) == 0 && *in_a_row < LINE_LOSSES_IN_A_ROW_MAX;
            *in_a_row = if is_lost { *in_a_row + 1 } else { 0 };
            if is_lost {
                // The line is one of those that were checked at the start.
                let _ = emulated.command_line("line drop 1");
            }
        }
    }

    fn arms(&mut self) -> [&mut Box<dyn ArmControl>; 2] {
        self.wired.driven.each_mut()
    }

    /// Enables both arms from any state.
    pub fn make_ready(&mut self, figures: &mut Figures) -> Result<()> {
        let mut last = String::new();
        for attempt in 0..TRIES {
            let mut ready = true;
            for arm in self.arms() {
                if matches!(arm.state(), ArmState::Fault | ArmState::EStop)
                    && let Err(error) = arm.reset()
                {
                    last = error.to_string();
                    ready = false;
                }
            }
            if ready {
                // Both at once: each takes more than a second to test its link.
                let enabled = std::thread::scope(|scope| {
                    let disabled = self.arms().into_iter().filter(|arm| arm.state() == ArmState::Disabled);
                    let threads: Vec<_> = disabled.map(|arm| scope.spawn(|| arm.enable())).collect();
                    threads.into_iter().map(|thread| thread.join()).collect::<Vec<_>>()
                });
                for outcome in enabled {
                    match outcome {
                        Ok(Ok(())) => {}
                        Ok(Err(error)) => last = error.to_string(),
                        Err(_) => bail!("a program error prevented enabling an arm"),
                    }
                }
            }
            if ready && self.arms().iter().all(|arm| arm.state() == ArmState::Enabled) {
                figures.enabled_after(attempt);
                self.begin = self.clock.now();
                self.next = self.begin;
                return Ok(());
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        bail!("the arms cannot be enabled again: {last}");
    }

    /// Moves both arms for a time.
    pub fn cycle_for(&mut self, duration: Duration, figures: &mut Figures) -> Result<(), Stopped> {
        let end = self.clock.now() + duration;
        while self.clock.now() < end {
            self.clock.sleep_until(self.next);
            let now = self.clock.now();
            let late = now.saturating_since(self.next);
            figures.cycle(late);
            if late > DEADLINE {
                self.missed_at = Some(now);
            }
            self.look_elsewhere(now, figures);
            self.next = self.next + self.period;
            if self.next < now {
                self.next = now + self.period;
            }
            self.lose_on_the_line();
            let swing = swing(now.seconds_since(self.begin));
            let mut stopped = None;
            for (index, arm) in self.wired.driven.each_mut().into_iter().enumerate() {
                let back = (self.homes_rad[index] - self.joints_rad[index]) * BACK_PER_S;
                match arm.exchange(JointCommand::Velocity(swing + back)) {
                    Ok(measured) => self.joints_rad[index] = measured.position_rad,
                    Err(error) if error.kind() == ArmErrorKind::Timeout => figures.late_reply(),
                    Err(error) => {
                        stopped = Some((self.clock.now(), error));
                        break;
                    }
                }
            }
            if let Some((at, error)) = stopped {
                self.look_elsewhere(at, figures);
                let was_late = self.missed_at.is_some_and(|missed| at.saturating_since(missed) < LATE_FOR);
                return Err(Stopped { at, kind: error.kind(), message: error.to_string(), was_late });
            }
        }
        Ok(())
    }

    /// Whether the thread of a link or of an emulated arm was late: a stop after that is not a fault of the arms.
    fn look_elsewhere(&mut self, now: MonotonicTime, figures: &mut Figures) {
        let links = self.wired.monitors.iter().map(|(_, monitor)| monitor.cycles_later_than(DEADLINE));
        let emulated = self.wired.emulated.iter().map(|emulated| emulated.wakes_later_than(DEADLINE));
        let late: u64 = links.chain(emulated).sum();
        if late > self.late_elsewhere {
            figures.late_elsewhere(late - self.late_elsewhere);
            self.late_elsewhere = late;
            self.missed_at = Some(now);
        }
    }

    /// Starts or ends a fault; returns the time.
    pub fn fault(&self, arm: usize, line: &str) -> Result<MonotonicTime> {
        let emulated = self.wired.emulated.get(arm).context("no such emulated arm")?;
        let at = self.clock.now();
        match line {
            "unplug" => emulated.unplug(),
            "plug" => emulated.plug(),
            line => emulated.command_line(line).with_context(|| line.to_owned())?,
        }
        Ok(at)
    }

    /// Time from a fault until all joints of both arms are stationary.
    pub fn rest_after(&self, at: MonotonicTime) -> Duration {
        self.clock.sleep_until(self.clock.now() + WATCHED);
        self.watcher.last_motion().saturating_since(at)
    }

    /// Adds the counters of the links.
    pub fn add_links(&self, figures: &mut Figures) {
        for (name, monitor) in &self.wired.monitors {
            figures.link(name, &monitor.snapshot().counters, &monitor.jitter());
        }
    }
}

/// Small motions of all joints, never stationary together.
fn swing(t_s: f64) -> JointVector {
    JointVector::from_fn(|joint, _| {
        let omega = 3.0 + 0.4 * joint as f64;
        0.12 * (omega * t_s).sin() * (t_s / 0.2).min(1.0)
    })
}

/// Samples the true joints every millisecond.
struct Watcher {
    last_motion: Arc<AtomicU64>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Watcher {
    fn start(sites: [ArmSite; 2], clock: Arc<dyn Clock>) -> Result<Self> {
        let (last_motion, is_over) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
        let (motion, over) = (Arc::clone(&last_motion), Arc::clone(&is_over));
        let work = move || {
            enter(&Realtime { priority: Some(30), locks_memory: false, cpu: None });
            while !over.load(Ordering::Relaxed) {
                let now = clock.now();
                let moves = sites.iter().filter_map(|site| site.joints.simulated()).any(|joints| {
                    let mut joints = joints.lock().unwrap_or_else(PoisonError::into_inner);
                    joints.advance_to(now);
                    joints.state().velocity_rad_per_s.amax() > AT_REST_RAD_PER_S
                });
                if moves {
                    motion.store(now.as_nanos(), Ordering::Relaxed);
                }
                clock.sleep_until(now + Duration::from_millis(1));
            }
        };
        let thread = std::thread::Builder::new().name("watcher".to_owned()).spawn(work)?;
        Ok(Self { last_motion, is_over, thread: Some(thread) })
    }

    fn last_motion(&self) -> MonotonicTime {
        MonotonicTime::from_nanos(self.last_motion.load(Ordering::Relaxed))
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}
