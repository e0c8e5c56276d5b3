//! Commands from their request to their result.

use std::sync::atomic::Ordering;
use std::time::Duration;

use pb3dp_cell::selection::{Choice, Selection};
use pb3dp_estimation_core::method::KnownModel;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_servo::supervisor::{Decision, OperatorCommand};
use tokio::sync::oneshot;

use crate::control_link::{COMMANDS_MAX, GivenCommand, Outcome, TakenCommand};
use crate::hub::{Hub, SAVED_MAX, Targets};
use crate::messages::state::JogState;
use crate::pending::{Answer, Chosen, CommandAnswer, PendingCommand};
use crate::refusal::Refusal;

/// Time in which the panel gets the first estimate of a selection; after it `start` no longer waits for it.
const SELECTION_TIME: Duration = Duration::from_secs(2);

impl Hub {
    /// Gives a command to the control thread; the caller has checked the lease and what the operator saw. The control thread compares
    /// `shown_state` once more, but not for commands that only end motion.
    ///
    /// # Errors
    /// If the command cannot be given now.
    pub fn give_command(
        &self,
        command: OperatorCommand,
        shown_state: u64,
        chosen: Option<Chosen>,
    ) -> Result<Answer, Refusal> {
        let name = command.name();
        if let Some(Chosen { selection: None, name }) = &chosen {
            self.check_target_of_setup(name.as_deref())?;
        }
        let (answer, result) = oneshot::channel();
        if let Some(done) = self.before_or_without_arms(command, &chosen)? {
            // The receiver is in scope.
            let _ = answer.send(Ok(done));
            return Ok(result);
        }
        if command == OperatorCommand::Start {
            self.check_no_selection_is_awaited()?;
        }
        let starts = matches!(command, OperatorCommand::Start | OperatorCommand::Resume);
        if starts && self.changes.are_pending() {
            return Err(Refusal::Changing { command: name });
        }
        if starts && self.config.hold_to_run && !self.is_pressed.load(Ordering::SeqCst) {
            return Err(Refusal::NotPressed { command: name });
        }
        let given = GivenCommand { id: self.link.next_id(), command, at: self.now(), shown_state };
        let has_room = self.pending.push(PendingCommand { id: given.id, command, chosen, answer });
        if !has_room && !command.ends_motion() {
            return Err(Refusal::QueueFull { command: name, limit: COMMANDS_MAX });
        }
        match self.link.slot_of(command) {
            Some(slot) => slot.give(given.id, given.at),
            None if self.link.queue(given) => {}
            None => {
                self.pending.remove(given.id);
                return Err(Refusal::QueueFull { command: name, limit: COMMANDS_MAX });
            }
        }
        Ok(result)
    }

    /// The result of a command where no control step can take it.
    fn before_or_without_arms(
        &self,
        command: OperatorCommand,
        chosen: &Option<Chosen>,
    ) -> Result<Option<CommandAnswer>, Refusal> {
        let name = command.name();
        let refused = |why| Err(Refusal::NotRunning { command: name, why });
        let done = |line: &str| {
            let number = self.link.number.load(Ordering::SeqCst);
            Ok(Some(CommandAnswer { command: name, line: line.to_owned(), number }))
        };
        if !self.about.has_arms() {
            return match (command, chosen) {
                (OperatorCommand::Select, Some(chosen)) => {
                    self.choose(chosen);
                    done("select: the target is being initialised")
                }
                _ if command.ends_motion() => done("this panel moves no arms"),
                _ => refused("this panel shows cameras without arms; use `pb3dp run --panel` to move arms"),
            };
        }
        if self.link.is_over.load(Ordering::SeqCst) {
            return match command.ends_motion() {
                true => done("the run is over, no arm moves"),
                false => refused("the run is over; start a new one"),
            };
        }
        if self.link.has_begun.load(Ordering::SeqCst) {
            return Ok(None);
        }
        match command {
            OperatorCommand::Stop => {
                self.config.interrupt.store(true, Ordering::SeqCst);
                done("enabling aborted: both arms stop, and the run ends")
            }
            OperatorCommand::Hold | OperatorCommand::HoldHand => {
                if let Some(slot) = self.link.slot_of(command) {
                    slot.give(self.link.next_id(), self.now());
                }
                done("both arms are still being enabled; they hold afterwards")
            }
            _ => refused("both arms are still being enabled; repeat it when they are enabled"),
        }
    }

    /// A `select` without a region or a saved name chooses the target that the setup names. It gives no name to what is followed.
    fn check_target_of_setup(&self, name: Option<&str>) -> Result<(), Refusal> {
        if name.is_some() {
            let targets = self.targets();
            let names: Vec<&str> = targets.saved.iter().map(|(name, _)| name.as_str()).collect();
            let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            let cause = format!(
                "`name` needs a `region`; to choose a saved target, give its name as `saved`; saved are: {known}"
            );
            return Err(Refusal::Body { cause });
        }
        if self.selections.target_of_setup().is_none() {
            let why = "select refused: the setup names no target (camera.region); give `region` or `saved`".to_owned();
            return Err(Refusal::Region { why });
        }
        Ok(())
    }

    /// `start` right after `select` must not follow the target before.
    fn check_no_selection_is_awaited(&self) -> Result<(), Refusal> {
        let refused = || {
            Err(Refusal::OtherTarget {
                command: "start",
                shown: "the target before".to_owned(),
                current: "one that is being initialised".to_owned(),
            })
        };
        if self.selections.is_awaited() {
            return refused();
        }
        // The panel gets an estimate later than the control thread.
        let mut targets = self.targets();
        let Some((marked_before, at)) = targets.awaited else { return Ok(()) };
        let is_taken = self.watched.marked.load(Ordering::SeqCst) > marked_before;
        if is_taken || self.now().saturating_since(at) > SELECTION_TIME {
            targets.awaited = None;
            return Ok(());
        }
        refused()
    }

    /// Passes on the result of a command.
    pub fn resolve(&self, taken: &TakenCommand) {
        for pending in self.pending.take(taken) {
            let (command, ago_ms) = (pending.command.name(), taken.taken_at.elapsed().as_secs_f64() * 1e3);
            tracing::info!(target: "pb3dp_panel::audit", "{command}: taken by a control step {ago_ms:.1} ms ago");
            let result = self.result_of(&pending, taken);
            // Who asked may be gone; the audit log has the result.
            let _ = pending.answer.send(result);
        }
    }

    fn result_of(&self, pending: &PendingCommand, taken: &TakenCommand) -> Result<CommandAnswer, Refusal> {
        let command = pending.command.name();
        let decision = match &taken.outcome {
            Outcome::Decided(decision) => decision,
            Outcome::OtherState => return Err(Refusal::Overtaken { command, why: "the state changed meanwhile" }),
            Outcome::Overtaken => return Err(Refusal::Overtaken { command, why: "a later stop or hold came first" }),
            Outcome::Suspended => {
                return Err(Refusal::Overtaken { command, why: "this program was suspended, or its clock stepped" });
            }
        };
        if let Some(refusal) = decision.refused {
            return Err(Refusal::Supervisor(refusal));
        }
        if let (OperatorCommand::Select, Some(chosen)) = (pending.command, &pending.chosen) {
            self.choose(chosen);
        }
        Ok(CommandAnswer { command, line: answer_text(pending.command, decision), number: taken.number })
    }

    /// Gives an accepted selection to the estimation. A new target begins without a jog.
    fn choose(&self, chosen: &Chosen) {
        *self.jog() = JogState::default();
        self.link.set_jog(Pose::coincident());
        let mut targets = self.targets();
        targets.name.clone_from(&chosen.name);
        let Some(selection) = &chosen.selection else {
            targets.awaited = None;
            self.selections.give(Choice::OfSetup);
            return;
        };
        if let Some(name) = &chosen.name {
            targets.saved.retain(|(saved, _)| saved != name);
            targets.saved.push_back((name.clone(), selection.clone()));
            if targets.saved.len() > SAVED_MAX {
                targets.saved.pop_front();
            }
        }
        targets.awaited = Some((self.watched.marked.load(Ordering::SeqCst), self.now()));
        self.selections.give(Choice::Marked(selection.clone()));
    }
}

impl Hub {
    /// Keeps the present view of the followed target, if it has a name: chosen again later, the target is searched for as it was last seen
    /// well, not as it was seen from where the hand began. Its frame `model` stays the one of the first time.
    pub fn renew_saved(&self) {
        let Some(newest) = self.watched.newest() else { return };
        let size = self.about.stereo.left().size();
        let (width, height) = (f64::from(size.width), f64::from(size.height));
        let outline_px = &newest.estimate.outline_px;
        let is_whole = outline_px.len() >= 3
            && outline_px.iter().all(|p| (0.0..width).contains(&p.x) && (0.0..height).contains(&p.y));
        if newest.estimate.status != Status::Ok || !is_whole {
            return;
        }
        let Ok(pair) = self.watched.pairs.get(Some(newest.sequence)) else { return };
        // The estimate may still be that of the target before.
        if self.check_no_selection_is_awaited().is_err() {
            return;
        }
        let mut targets = self.targets();
        let Targets { name: Some(name), saved, .. } = &mut *targets else { return };
        if let Some((_, selection)) = saved.iter_mut().find(|(saved, _)| saved == name) {
            let region = Region::Polygon { vertices_px: outline_px.clone() };
            let known = newest.estimate.cam_left_from_model.zip(newest.estimate.first_pose_covariance);
            let model = known.map(|(cam_left_from_model, first_pose_covariance)| {
                Box::new(KnownModel { cam_left_from_model, first_pose_covariance })
            });
            *selection = Selection { region, drawn_on: Some(pair), model };
        }
    }
}

fn answer_text(command: OperatorCommand, decision: &Decision) -> String {
    match &decision.transition {
        Some(transition) => format!("{}: {}", command.name(), transition.to),
        None if command == OperatorCommand::Hold && decision.no_arm_may_move => {
            format!("hold: both arms hold, the state is {}", decision.state)
        }
        None => format!("{}: no change, the state is {}", command.name(), decision.state),
    }
}
