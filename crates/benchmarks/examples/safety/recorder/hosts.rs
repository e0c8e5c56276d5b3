//! The record when a host ends or dies, and when a new one begins.

use std::time::Duration;

use pb3dp_arm_pa10::arm::ArmMonitor;
use pb3dp_cell::cell::SimulatedCell;
use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{Condition, State};

use system_tests::safety::who_may_move::WhoMayMove;

use super::Recorder;
use crate::faults::Kind;
use crate::rig::SEARCH_MAX_S;
use crate::scenario::Scenario;

impl Recorder {
    /// By how much the content of the pairs is older than their stamps, seconds.
    pub(super) fn content_late_s(&self, at: MonotonicTime) -> f64 {
        /// Period of the pairs, seconds.
        const PERIOD_S: f64 = 1.0 / 30.0;
        let times = self.began_at.iter().zip(&self.ended_at);
        let late = self.scenario.faults.iter().zip(times).filter_map(|(fault, (began, ended))| {
            let is_on = began.is_some_and(|began| began <= at) && ended.is_none_or(|ended| ended > at);
            let Kind::OldContent(pairs) = fault.kind else { return None };
            is_on.then_some(pairs as f64 * PERIOD_S)
        });
        late.fold(0.0, f64::max)
    }

    /// Enabling, which began at this time, has failed: the record begins with it, and nobody may move an arm.
    pub fn not_enabled(&mut self, since: MonotonicTime, why: &anyhow::Error, now: MonotonicTime) {
        if self.begin.is_none() {
            self.begin_at(since);
        }
        self.failed(why, now);
        self.noticed_enabling = true;
    }

    /// The control loop has ended: both arms are stopped since the last control step.
    pub fn ended(&mut self, now: MonotonicTime) {
        self.ends_at.get_or_insert(self.next.min(now));
    }

    /// The process of the host dies. Nobody stops the arms before the gateways miss it.
    pub fn dies(&mut self, now: MonotonicTime) {
        const MISSED: Duration = Duration::from_millis(100);
        self.ends_at = Some(now + MISSED);
        self.absent_s = Some((self.t_s(now), f64::INFINITY));
    }

    /// Nobody knows any more what the host that has died knew: latches of its supervisor and drivers have ended with it, without a reset. Those of
    /// gateways and controllers stay, and no arm has a host that could move it.
    pub fn forget_host(&mut self, now: MonotonicTime) {
        self.catch_up(now);
        (self.monitors, self.stopped_at) = ([None, None], None);
        self.resets_before += 1;
    }

    /// The operator resets an arm without a running host.
    pub fn reset_alone(&mut self, arm: &str, now: MonotonicTime) {
        self.note(now, format!("{arm}: reset by the operator"));
        self.resets_before += 1;
        self.reset_at = now;
        self.catch_up(now);
    }

    /// A new host has connected both arms. Nothing may move before its control loop begins.
    pub fn connected(&mut self, monitors: [Option<ArmMonitor>; 2], cell: SimulatedCell) {
        (self.monitors, self.cell) = (monitors, cell);
        self.counted = self.count();
    }

    /// The control loop of a new host begins: as at the begin of a run, nothing may move without the operator's commands.
    pub fn begin_again(&mut self, now: MonotonicTime) {
        self.catch_up(now);
        self.resets_before += self.permission.resets();
        self.permission = permission_of(&self.scenario);
        (self.ends_at, self.stopped_at, self.has_failed) = (None, None, false);
        (self.stepped_at, self.heartbeat_at, self.newest) = (now, None, None);
        self.exposed.clear();
        self.spoiled.clear();
        (self.state, self.says_why, self.found) = (State::Idle, true, [false; Condition::COUNT]);
        let until_s = self.t_s(now);
        self.absent_s = self.absent_s.map(|(from_s, _)| (from_s, until_s));
    }
}

/// The model of who may move in a run that begins.
pub(super) fn permission_of(scenario: &Scenario) -> WhoMayMove {
    WhoMayMove::new(scenario.has_person, if scenario.searches { SEARCH_MAX_S } else { 0.0 })
}
