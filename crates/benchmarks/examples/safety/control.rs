//! The control thread of a host with its faults, and those of lines, gateways and arms behind it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_cell::halves::Mover;
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::percept::Percept;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use crate::cameras;
use crate::faults::{Fault, Kind};
use crate::program_log::ProgramLog;
use crate::recorder::{Shared, lock};
use crate::scenario::Scenario;
use system_tests::safety::truth::ARM_NAMES;

/// Which faults have begun and ended, over all hosts of a run.
#[derive(Default)]
pub struct Happening {
    /// The first control step of the first host, from which the times of faults count.
    pub zero: Option<MonotonicTime>,
    /// When each fault actually began: while the arms are being enabled the control loop waits.
    pub begun_at: Vec<Option<MonotonicTime>>,
    pub ended: Vec<bool>,
    /// The process of the host has died.
    pub has_died: bool,
}

impl Happening {
    /// Nothing has happened yet.
    pub fn new(scenario: &Scenario) -> Self {
        let count = scenario.faults.len();
        Self { begun_at: vec![None; count], ended: vec![false; count], ..Self::default() }
    }
}

/// The control thread with its faults and those behind it.
pub struct Faulty<'a> {
    pub inner: Moving<'a>,
    pub scenario: &'a Scenario,
    pub clock: Arc<dyn Clock>,
    pub recorder: Shared,
    pub log: ProgramLog,
    pub ends: [Option<VirtualEnd>; 2],
    /// Ends the control loop.
    pub interrupt: Arc<AtomicBool>,
    pub begin: MonotonicTime,
    /// When the cell was wired; the arms are being enabled until `begin`.
    pub wired: MonotonicTime,
    pub happening: Happening,
}

impl Mover for Faulty<'_> {
    type Step = StepRecord;

    fn enable(&mut self) -> Result<bool> {
        let now = self.clock.now();
        let t_s = match self.happening.zero {
            Some(zero) => now.seconds_since(zero),
            None => now.seconds_since(self.wired) - cameras::LEAD_S,
        };
        self.begin_and_end_faults(now, t_s)?;
        let enabled = self.inner.enable();
        if let Err(why) = &enabled {
            // The control loop does not begin: the record begins with the enabling.
            lock(&self.recorder).not_enabled(self.wired, why, self.clock.now());
        }
        enabled
    }

    fn begin_at(&mut self, begin: MonotonicTime) {
        self.begin = begin;
        self.happening.zero.get_or_insert(begin);
        self.inner.begin_at(begin);
    }

    fn observe(&mut self, percept: Percept, now: MonotonicTime) {
        lock(&self.recorder).delivered(&percept);
        self.inner.observe(percept, self.shown(now));
    }

    fn step(&mut self, now: MonotonicTime) -> Result<StepRecord> {
        self.begin_and_end_faults(now, now.seconds_since(self.zero()))?;
        ensure!(!self.is_dead(), "the process of the host has died");
        let shown = self.shown(now);
        lock(&self.recorder).stepping([now, shown], self.clock.now());
        let stepped = self.inner.step(shown);
        if let Err(why) = &stepped {
            lock(&self.recorder).failed(why, self.clock.now());
        }
        stepped
    }

    fn stop(&mut self) -> Result<()> {
        // A process that has died stops nothing.
        if self.is_dead() {
            return Ok(());
        }
        self.inner.stop()
    }
}

impl Faulty<'_> {
    /// Time zero of the scenario.
    fn zero(&self) -> MonotonicTime {
        self.happening.zero.unwrap_or(self.begin)
    }

    fn end(&self, arm: usize) -> Result<&VirtualEnd> {
        self.ends[arm].as_ref().with_context(|| format!("{} has no line", ARM_NAMES[arm]))
    }

    /// Whether this host has died and another one follows.
    fn is_dead(&self) -> bool {
        self.scenario.restart.is_some() && self.interrupt.load(Ordering::SeqCst)
    }

    fn begin_and_end_faults(&mut self, now: MonotonicTime, t_s: f64) -> Result<()> {
        for index in 0..self.scenario.faults.len() {
            let fault = &self.scenario.faults[index];
            if self.happening.begun_at[index].is_none() && t_s >= fault.from_s {
                self.happening.begun_at[index] = Some(now);
                lock(&self.recorder).began(index, self.clock.now());
                self.begin_fault(fault)?;
            }
            let is_over = self.happening.begun_at[index].is_some_and(|begun| now.seconds_since(begun) >= fault.for_s);
            if is_over && !self.happening.ended[index] {
                self.happening.ended[index] = true;
                self.end_fault(fault)?;
                lock(&self.recorder).ceased(index, self.clock.now());
            }
        }
        Ok(())
    }

    fn on(&self, t_s: f64) -> impl Iterator<Item = &Fault> {
        self.scenario.faults.iter().filter(move |fault| fault.is_on(t_s))
    }

    /// The time that the clock of the control loop shows.
    fn shown(&self, now: MonotonicTime) -> MonotonicTime {
        let t_s = now.seconds_since(self.zero());
        let jumps_s = self.on(t_s).map(|fault| if let Kind::ClockJump(by_s) = fault.kind { by_s } else { 0.0 });
        let by_s: f64 = jumps_s.sum();
        let by = Duration::from_secs_f64(by_s.abs());
        if by_s < 0.0 { now - by } else { now + by }
    }

    fn begin_fault(&mut self, fault: &Fault) -> Result<()> {
        match &fault.kind {
            Kind::Overrun(by_s) => self.clock.sleep_until(self.clock.now() + Duration::from_secs_f64(*by_s)),
            Kind::EmergencyStopOfBoth => {
                for end in self.ends.iter().flatten() {
                    end.command_line("e-stop press")?;
                }
            }
            Kind::Unplugged(arm) => self.end(*arm)?.unplug(),
            Kind::GatewayRestart(arm) => self.end(*arm)?.restart_gateway(),
            Kind::HostDies if self.scenario.restart.is_some() => self.die(),
            Kind::HostDies => {
                for line in self.ends.iter().flatten().flat_map(|end| [(end, "line deaf on"), (end, "line silence on")])
                {
                    line.0.command_line(line.1)?;
                }
                lock(&self.recorder).dies(self.clock.now());
                self.interrupt.store(true, Ordering::SeqCst);
            }
            Kind::Arm { arm, line, .. } => self.end(*arm)?.command_line(line)?,
            Kind::Tampered(arm, towards, how) => self.end(*arm)?.tamper(*towards, *how),
            _ => {}
        }
        Ok(())
    }

    /// The process dies: it sends and writes nothing any more.
    fn die(&mut self) {
        let is_closed = self.scenario.restart.is_none_or(|restart| restart.is_closed);
        let now = self.clock.now();
        let mut recorder = lock(&self.recorder);
        recorder.dies(now);
        recorder.forget_host(now);
        self.ends.iter().flatten().for_each(|end| end.lose_program(is_closed));
        self.log.set_closed(true);
        self.interrupt.store(true, Ordering::SeqCst);
        self.happening.has_died = true;
    }

    fn end_fault(&self, fault: &Fault) -> Result<()> {
        match &fault.kind {
            Kind::EmergencyStopOfBoth => {
                for end in self.ends.iter().flatten() {
                    end.command_line("e-stop release")?;
                }
            }
            Kind::Unplugged(arm) => self.end(*arm)?.plug(),
            Kind::Arm { arm, end: Some(line), .. } => self.end(*arm)?.command_line(line)?,
            _ => {}
        }
        Ok(())
    }
}
