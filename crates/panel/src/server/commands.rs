//! The POST requests. Each command is in the audit log with its session, peer and outcome; a session is named by the number of its lease.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Extension;
use axum::extract::{Request, State};
use axum::response::Response;
use pb3dp_cell::selection::Selection;
use pb3dp_servo::supervisor::OperatorCommand;
use serde::Serialize;
use tokio::sync::oneshot;

use super::answers::json;
use super::app::App;
use super::checks::session_in;
use super::rate::Client;
use super::{Peer, body};
use crate::hub::Hub;
use crate::lease::{Holder, NAME_MAX, Taken};
use crate::messages::requests::{
    HeartbeatRequest, HoldRequest, JogRequest, LeaseAction, LeaseRequest, PreviewRequest, PushRequest, SelectRequest,
    ShownRequest, SpeedRequest,
};
use crate::messages::state::{HolderState, JogState};
use crate::moving::{check_jog, check_push, check_speed};
use crate::operator::SILENT_AFTER;
use crate::pending::{Answer, Chosen, CommandAnswer};
use crate::preview_job::PreviewJob;
use crate::refusal::Refusal;
use crate::region::region_in;
use crate::secrets::{Nonce, Session};
use crate::staleness::ShownState;
use crate::target_state::hand_shift;

/// Time in which a control step takes a command: many steps even of a slow simulation.
const TAKEN_WITHIN: Duration = Duration::from_millis(1000);
/// Time in which a preview is answered: its own limit and that of the one before.
const PREVIEWED_WITHIN: Duration = Duration::from_secs(10);

/// Answer of a request.
pub type Answered = Result<Response, Refusal>;

/// A command of a client, for checks and the audit log.
pub struct Asked {
    command: &'static str,
    session: Option<Session>,
    peer: Peer,
}

impl Asked {
    /// A command of this request.
    pub fn new(command: &'static str, request: &Request, peer: Peer) -> Self {
        Self { command, session: session_in(request.headers()), peer }
    }

    /// Counts the request, but not `stop` and `hold`.
    ///
    /// # Errors
    /// If the client sends too many.
    pub fn count(&self, app: &App) -> Result<(), Refusal> {
        let session = self.session.filter(|session| app.hub.check_holder(Some(*session)).is_ok());
        app.rates.count(Client::new(self.peer.address.ip(), session), Instant::now())
    }

    /// The session of the request.
    pub fn session(&self) -> Option<Session> {
        self.session
    }

    /// Writes the outcome to the audit log and passes it on.
    ///
    /// # Errors
    /// That of the outcome.
    pub fn audit<T>(&self, holder: Option<&Holder>, outcome: Result<T, Refusal>) -> Result<T, Refusal> {
        let (command, peer) = (self.command, self.peer.address);
        let (id, name) = holder.map_or((0, ""), |holder| (holder.id, holder.name.as_str()));
        match &outcome {
            Ok(_) => tracing::info!(target: "pb3dp_panel::audit", holder = id, name, %peer, "{command}: accepted"),
            Err(why) => {
                tracing::warn!(target: "pb3dp_panel::audit", holder = id, name, %peer, code = why.code(), "{command}: {why}");
            }
        }
        outcome
    }

    /// Carries out a command of the holder on what it saw. Between the checks and the command nothing else runs on this thread.
    async fn of_holder(
        self,
        app: &App,
        shown: Option<ShownState>,
        give: impl FnOnce(&Hub) -> Result<Answer, Refusal>,
    ) -> Answered {
        let hub = &app.hub;
        let holder = hub.check_holder(self.session);
        let given = holder.clone().and_then(|_| {
            shown.map_or(Ok(()), |shown| hub.check_shown(self.command, &shown))?;
            give(hub)
        });
        let outcome = match given {
            Ok(answer) => result_within(self.command, answer).await,
            Err(refusal) => Err(refusal),
        };
        self.audit(holder.ok().as_ref(), outcome)
    }
}

/// Waits for the result of a command.
async fn result_within(command: &'static str, answer: Answer) -> Answered {
    taken_within(command, answer).await.map(|answer| json(&answer))
}

/// Waits until a control step has taken a command.
///
/// # Errors
/// If it refuses the command, or is too slow.
pub async fn taken_within(command: &'static str, answer: Answer) -> Result<CommandAnswer, Refusal> {
    match tokio::time::timeout(TAKEN_WITHIN, answer).await {
        Ok(Ok(result)) => result,
        _ => Err(Refusal::NotTaken { command, limit_ms: TAKEN_WITHIN.as_millis() as u64 }),
    }
}

#[derive(Serialize)]
struct LeaseAnswer {
    session: Option<String>,
    holder: Option<HolderState>,
    nonce: Option<String>,
    silent_after_ms: u64,
}

/// `POST /api/lease`.
pub async fn lease(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("lease", &request, peer);
    asked.count(&app)?;
    let LeaseRequest { action, name } = body::read(request).await?;
    let silent_after_ms = SILENT_AFTER.as_millis() as u64;
    if action == LeaseAction::Release {
        let released = app.hub.release_lease(asked.session);
        let holder = released.as_ref().ok().cloned();
        asked.audit(holder.as_ref(), released)?;
        return Ok(json(&LeaseAnswer { session: None, holder: None, nonce: None, silent_after_ms }));
    }
    let name = name.ok_or_else(|| Refusal::Body { cause: "the field `name` is missing".to_owned() })?;
    let taken = app.hub.take_lease(&name, action == LeaseAction::TakeOver);
    let holder = taken.as_ref().ok().map(|taken| taken.holder.clone());
    let Taken { session, nonce, holder, .. } = asked.audit(holder.as_ref(), taken)?;
    Ok(json(&LeaseAnswer {
        session: Some(session.to_hex()),
        holder: Some(HolderState { id: holder.id, name: holder.name }),
        nonce: Some(nonce.to_hex()),
        silent_after_ms,
    }))
}

#[derive(Serialize)]
struct NonceAnswer {
    nonce: String,
}

/// `POST /api/heartbeat`.
pub async fn heartbeat(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("heartbeat", &request, peer);
    asked.count(&app)?;
    let heartbeat: HeartbeatRequest = body::read(request).await?;
    app.hub.heartbeat(asked.session, &heartbeat)?;
    app.hub.next_nonce(asked.session).map(Nonce::to_hex).map(|nonce| json(&NonceAnswer { nonce }))
}

/// `POST /api/select`.
pub async fn select(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("select", &request, peer);
    asked.count(&app)?;
    let request: SelectRequest = body::read(request).await?;
    let shown = request.shown;
    asked
        .of_holder(&app, Some(shown), |hub| {
            let chosen = chosen_by(hub, request)?;
            hub.give_command(OperatorCommand::Select, shown.state, Some(chosen))
        })
        .await
}

/// The target of a `select`: a region, a saved one, or none, which leaves it to the setup.
fn chosen_by(hub: &Hub, request: SelectRequest) -> Result<Chosen, Refusal> {
    let SelectRequest { region, sequence, name, saved, .. } = request;
    let is_short = |name: &String| (1..=NAME_MAX).contains(&name.chars().count());
    if name.as_ref().is_some_and(|name| !is_short(name) || name.chars().any(char::is_control)) {
        return Err(Refusal::Body { cause: format!("`name` needs 1 to {NAME_MAX} characters") });
    }
    match (region, saved) {
        (Some(_), Some(_)) => Err(Refusal::Body { cause: "give either `region` or `saved`".to_owned() }),
        (None, None) => Ok(Chosen { selection: None, name }),
        (Some(region), None) => {
            hub.about.check_calibrated("select")?;
            let region = region_in(&region, hub.about.stereo.left().size())?;
            let pair = hub.watched.pairs.get(sequence)?;
            Ok(Chosen { selection: Some(Selection { region, drawn_on: Some(pair), model: None }), name })
        }
        (None, Some(saved)) => {
            let targets = hub.targets();
            let found = targets.saved.iter().find(|(name, _)| *name == saved);
            let selection = found.map(|(_, selection)| selection.clone()).ok_or_else(|| {
                let names: Vec<&str> = targets.saved.iter().map(|(name, _)| name.as_str()).collect();
                let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
                Refusal::NotSaved { name: saved.chars().take(NAME_MAX).collect(), known }
            })?;
            Ok(Chosen { selection: Some(selection), name: Some(saved) })
        }
    }
}

/// `start`, `resume`, `re-align` and `reset`: they may cause motion, or lead to it.
async fn leading(app: App, peer: Peer, request: Request, command: OperatorCommand) -> Answered {
    let asked = Asked::new(command.name(), &request, peer);
    asked.count(&app)?;
    let ShownRequest { shown } = body::read(request).await?;
    asked.of_holder(&app, Some(shown), |hub| hub.give_command(command, shown.state, None)).await
}

/// `POST /api/start`.
pub async fn start(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    leading(app, peer, request, OperatorCommand::Start).await
}

/// `POST /api/resume`.
pub async fn resume(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    leading(app, peer, request, OperatorCommand::Resume).await
}

/// `POST /api/re-align`.
pub async fn realign(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    leading(app, peer, request, OperatorCommand::Realign).await
}

/// `POST /api/reset`.
pub async fn reset(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    leading(app, peer, request, OperatorCommand::Reset).await
}

/// `POST /api/hold`.
pub async fn hold(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("hold", &request, peer);
    let HoldRequest { hand_only, .. } = body::read(request).await?;
    let (name, command) =
        if hand_only { ("hold hand", OperatorCommand::HoldHand) } else { ("hold", OperatorCommand::Hold) };
    let asked = Asked { command: name, ..asked };
    asked.of_holder(&app, None, |hub| hub.give_command(command, 0, None)).await
}

/// `POST /api/stop`: from everybody, at any time.
pub async fn stop(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("stop", &request, peer);
    // Whatever the body says, and however slowly it comes.
    body::check_is_json(&request)?;
    let holder = app.hub.check_holder(asked.session).ok();
    let outcome = match app.hub.give_command(OperatorCommand::Stop, 0, None) {
        Ok(answer) => result_within("stop", answer).await,
        Err(refusal) => Err(refusal),
    };
    asked.audit(holder.as_ref(), outcome)
}

#[derive(Serialize)]
struct SpeedAnswer {
    percent: f64,
}

/// `POST /api/speed`.
pub async fn speed(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("speed", &request, peer);
    asked.count(&app)?;
    let SpeedRequest { percent, shown } = body::read(request).await?;
    let hub = &app.hub;
    let set = |_: &Holder| {
        check_speed(percent)?;
        // A lower speed is safe in any state.
        if percent > hub.link.speed_share() * 100.0 {
            hub.check_shown("speed", &shown)?;
        } else {
            hub.note_shown(&shown);
        }
        hub.link.set_speed_share(percent / 100.0);
        Ok(json(&SpeedAnswer { percent }))
    };
    let holder = hub.check_holder(asked.session);
    let outcome = holder.as_ref().map_err(Clone::clone).and_then(set);
    asked.audit(holder.ok().as_ref(), outcome)
}

/// `POST /api/jog`.
pub async fn jog(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("jog", &request, peer);
    asked.count(&app)?;
    let JogRequest { offset_mm, offset_deg, shown } = body::read(request).await?;
    let hub = &app.hub;
    let set = |_: &Holder| {
        hub.check_shown("jog", &shown)?;
        let mut jog = hub.jog();
        let wanted = JogState { offset_mm, offset_deg };
        check_jog(&jog, &wanted)?;
        *jog = wanted;
        hub.link.set_jog(hand_shift(&wanted));
        Ok(json(&wanted))
    };
    let holder = hub.check_holder(asked.session);
    let outcome = holder.as_ref().map_err(Clone::clone).and_then(set);
    asked.audit(holder.ok().as_ref(), outcome)
}

/// `POST /api/preview`: needs no lease; the newest request wins. Without a region the pair is kept for those to come.
pub async fn preview(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    Asked::new("preview", &request, peer).count(&app)?;
    let PreviewRequest { region, sequence } = body::read(request).await?;
    let hub: &Arc<Hub> = &app.hub;
    hub.about.check_calibrated("preview")?;
    let region = region.map(|region| region_in(&region, hub.about.stereo.left().size())).transpose()?;
    let pair = hub.watched.pairs.get(sequence)?;
    hub.watched.pairs.pin(&pair);
    let Some(region) = region else { return Ok(json(&Done {})) };
    let (answer, answered) = oneshot::channel();
    hub.previews.give(PreviewJob { region, pair, answer });
    match tokio::time::timeout(PREVIEWED_WITHIN, answered).await {
        Ok(Ok(preview)) => preview.map(|preview| json(&preview)),
        Ok(Err(_)) => Err(Refusal::Overtaken { command: "preview", why: "a newer preview replaced it" }),
        Err(_) => Err(Refusal::PreviewLate { limit_ms: PREVIEWED_WITHIN.as_millis() as u64 }),
    }
}

#[derive(Serialize)]
struct Done {}

/// `POST /api/push`: only in the playground.
pub async fn push(State(app): State<App>, Extension(peer): Extension<Peer>, request: Request) -> Answered {
    let asked = Asked::new("push", &request, peer);
    asked.count(&app)?;
    let PushRequest { offset_mm, turn_deg, .. } = body::read(request).await?;
    let hub = &app.hub;
    let Some(push) = &hub.config.push else {
        let why = "the target is pushed in the playground only".to_owned();
        return Err(Refusal::NotHere { what: "push", why });
    };
    check_push(offset_mm, turn_deg)?;
    let holder = hub.check_holder(asked.session)?;
    match push(offset_mm.map(|offset| offset * 1e-3), turn_deg.to_radians()) {
        // Twenty per second while somebody pushes: no lines in the log.
        Ok(()) => Ok(json(&Done {})),
        Err(why) => asked.audit(Some(&holder), Err(Refusal::NotHere { what: "push", why })),
    }
}
