//! The panel as the operator of a run. The control thread calls it: no method waits, locks or allocates.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use pb3dp_cell::operator::{MotionRequest, Operator};
use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::supervisor::{
    Condition, Decision, OperatorCommand, OperatorInput, OperatorRequest, Permission, State, Transition,
};

use crate::control_link::{ControlEnds, ControlLink, GivenCommand, Outcome, ShownDecision, TakenCommand};

/// Longest silence of the page: five heartbeats.
pub const SILENT_AFTER: Duration = Duration::from_millis(500);
/// Pause between two control steps after which the commands that wait are discarded: they were given while this program was suspended.
/// The limit of `clock_stepped` in `configs`. At half of it a loaded machine discards commands; at double a fault can come and be cleared
/// unseen.
const SUSPENDED_AFTER: Duration = Duration::from_millis(200);
/// Time after such a pause in which commands are discarded: requests that wait in sockets are read within it. At double an operator
/// would notice it.
const DISCARDS_FOR: Duration = Duration::from_millis(300);

/// Operator commands from the panel.
pub struct PanelOperator {
    link: Arc<ControlLink>,
    ends: ControlEnds,
    motion: MotionRequest,
    /// Time at which commands were first accepted.
    begun_at: Option<MonotonicTime>,
    /// Time of the last control step.
    listened_at: Option<MonotonicTime>,
    /// Commands received before are discarded, except `stop` and the holds.
    discarded_until: MonotonicTime,
    /// Commands up to this number precede a `stop` or `hold` that was taken, and are dropped.
    overtaken: u64,
    /// A `select` that waits until the arms hold.
    select_after_hold: Option<GivenCommand>,
    /// The command that this control step obeys or refuses; number 0: the hold before a `select`.
    commanded: Option<(u64, OperatorCommand)>,
    /// State number: counts changes of state, holds and stops.
    number: u64,
    /// Trouble not reported yet because the queue was full.
    untold: Option<Option<String>>,
}

impl PanelOperator {
    pub(crate) fn new(link: Arc<ControlLink>, ends: ControlEnds) -> Self {
        let number = link.number.load(Ordering::SeqCst);
        Self {
            link,
            ends,
            motion: MotionRequest::default(),
            begun_at: None,
            listened_at: None,
            discarded_until: MonotonicTime::ZERO,
            overtaken: 0,
            select_after_hold: None,
            commanded: None,
            number,
            untold: None,
        }
    }

    /// `stop` before everything, then the holds, then the queue in its order.
    fn next_command(&mut self, last: Option<&Decision>, now: MonotonicTime) -> Option<OperatorRequest> {
        let link = Arc::clone(&self.link);
        for command in [OperatorCommand::Stop, OperatorCommand::Hold, OperatorCommand::HoldHand] {
            let Some((id, at)) = link.slot_of(command).and_then(|slot| slot.take()) else { continue };
            self.overtaken = self.overtaken.max(id);
            if let Some(select) = self.select_after_hold.take() {
                self.report(select.id, select.command, Outcome::Overtaken);
            }
            self.commanded = Some((id, command));
            return Some(OperatorRequest { command, at });
        }
        if let Some(select) = self.select_after_hold.take() {
            // The hold was a command of this panel, so the number that the operator saw no longer counts.
            self.commanded = Some((select.id, select.command));
            return Some(OperatorRequest { command: select.command, at: now });
        }
        while let Ok(given) = self.ends.commands.pop() {
            if given.id <= self.overtaken {
                self.report(given.id, given.command, Outcome::Overtaken);
            } else if given.at < self.discarded_until {
                self.report(given.id, given.command, Outcome::Suspended);
            } else if given.shown_state != self.number {
                self.report(given.id, given.command, Outcome::OtherState);
            } else if given.command == OperatorCommand::Select && last.is_some_and(may_move) {
                self.select_after_hold = Some(given);
                self.commanded = Some((0, OperatorCommand::Hold));
                return Some(OperatorRequest { command: OperatorCommand::Hold, at: now });
            } else {
                self.commanded = Some((given.id, given.command));
                return Some(OperatorRequest { command: given.command, at: given.at });
            }
        }
        None
    }

    fn report(&mut self, id: u64, command: OperatorCommand, outcome: Outcome) {
        // More results than anybody reads are dropped; the log has all decisions.
        let (number, taken_at) = (self.number, Instant::now());
        let _ = self.ends.results.push(TakenCommand { id, command, outcome, number, taken_at });
    }

    /// Passes on a trouble; the newest one waits for space.
    fn pass_on(&mut self, trouble: Option<String>) {
        self.untold = match self.ends.troubles.push(trouble) {
            Ok(()) => None,
            Err(rtrb::PushError::Full(trouble)) => Some(trouble),
        };
    }
}

/// Whether an arm may move after this decision.
fn may_move(decision: &Decision) -> bool {
    let searches = matches!(decision.permission, Permission::Move { .. });
    let carries = !matches!(decision.state, State::Idle | State::Selecting) && !decision.no_arm_may_move;
    decision.state.is_moving() || searches || carries
}

impl Operator for PanelOperator {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let begun_at = *self.begun_at.get_or_insert(now);
        self.link.has_begun.store(true, Ordering::SeqCst);
        let before = self.listened_at.replace(now).unwrap_or(now);
        if now < before || now.saturating_since(before) > SUSPENDED_AFTER {
            self.discarded_until = now + DISCARDS_FOR;
        }
        if let Some(jog) = self.ends.jog.take() {
            self.motion.hand_from_hand_shifted = jog;
        }
        self.motion.speed_share = self.link.speed_share();
        // A heartbeat that came after the begin of this step has a later time.
        let heartbeat_at = self.link.heartbeat_at().map(|heartbeat_at| heartbeat_at.min(now));
        let request = self
            .next_command(last, now)
            .map(|request| OperatorRequest { at: request.at.max(begun_at).min(now), ..request });
        OperatorInput { request, heartbeat_at, silent_after: Some(SILENT_AFTER) }
    }

    fn show(&mut self, decision: &Decision) {
        let commanded = self.commanded.take();
        let has_ended_motion = commanded.is_some_and(|(_, command)| command.ends_motion());
        // A `start` that was given before a `hold` and arrives after it must find another number, also if the state stays the same.
        self.number += u64::from(decision.transition.is_some() || has_ended_motion);
        self.link.number.store(self.number, Ordering::SeqCst);
        self.link.may_move.store(may_move(decision), Ordering::SeqCst);
        let resumes_by_itself = decision.state.is_resting() && !decision.why.waits_for_resume();
        self.link.may_begin_to_move.store(may_move(decision) || resumes_by_itself, Ordering::SeqCst);
        if let Some(Transition { at, cause: Some(cause), .. }) = decision.transition
            && cause.condition == Condition::ClockStepped
        {
            self.discarded_until = at + DISCARDS_FOR;
        }
        self.ends.shown.give(ShownDecision { decision: *decision, number: self.number });
        // Who gets the result finds the state that follows from it.
        if let Some((id, command)) = commanded {
            self.report(id, command, Outcome::Decided(*decision));
        }
        if let Some(trouble) = self.untold.take() {
            self.pass_on(trouble);
        }
    }

    fn tell(&mut self, trouble: Option<String>) {
        self.pass_on(trouble);
    }

    fn motion(&self) -> MotionRequest {
        self.motion
    }

    fn is_person(&self) -> bool {
        true
    }

    fn can_fall_silent(&self) -> bool {
        true
    }
}

impl Drop for PanelOperator {
    fn drop(&mut self) {
        self.link.is_over.store(true, Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests;
