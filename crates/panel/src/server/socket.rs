//! The WebSocket: states, images, log lines and heartbeats. Each client has the newest only; one that does not read is closed.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::body::Bytes;
use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::response::Response;
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use pb3dp_servo::supervisor::OperatorCommand;
use tokio::sync::{broadcast, mpsc, watch};
use tokio::time::{MissedTickBehavior, interval, timeout};

use super::Peer;
use super::app::App;
use super::checks::{bearer, check_token};
use super::commands::taken_within;
use crate::encoded_pair::EncodedPair;
use crate::hub::Hub;
use crate::messages::requests::HeartbeatRequest;
use crate::messages::socket::{ClientMessage, ImageView, PROTOCOL, ServerMessage};
use crate::refusal::Refusal;
use crate::secrets::Session;
use crate::viewers::{ClientImages, FPS_MAX};

/// Largest message of a client, bytes.
const MESSAGE_MAX: usize = 16 * 1024;
/// Messages of a client per second: 10 heartbeats, and changes of the images.
const MESSAGES_PER_S: u32 = 100;
/// Time for the first message.
const HELLO_WITHIN: Duration = Duration::from_secs(5);
/// A client that sends nothing for this time is gone; it answers the pings at least.
const IDLE_MAX: Duration = Duration::from_secs(30);
/// Time between two nonces.
const BEAT_EVERY: Duration = Duration::from_millis(100);
/// Nonces between two pings.
const BEATS_PER_PING: u32 = 50;
/// Time in which a client takes a message.
const SEND_WITHIN: Duration = Duration::from_millis(500);
/// Answers that wait.
const ANSWERS_MAX: usize = 16;

/// `GET /api/events`.
pub async fn upgrade(
    State(App { hub, .. }): State<App>,
    Extension(peer): Extension<Peer>,
    headers: HeaderMap,
    socket: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
    _request: Request,
) -> Result<Response, Refusal> {
    let socket = socket
        .map_err(|error| Refusal::Protocol { why: format!("this path is a WebSocket: {}", error.body_text()) })?;
    let has_token = check_token(bearer(&headers), hub.config.protection.as_ref()).is_ok();
    let socket = socket.max_message_size(MESSAGE_MAX).max_frame_size(MESSAGE_MAX);
    Ok(socket.on_upgrade(move |socket| serve(socket, hub, peer, has_token)))
}

/// A connection, until it is dropped in whatever way.
struct Connection {
    hub: Arc<Hub>,
    id: u64,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.hub.viewers.set(self.id, ClientImages::NOTHING);
        self.hub.connection_closed(self.id);
    }
}

async fn serve(socket: WebSocket, hub: Arc<Hub>, peer: Peer, has_token: bool) {
    let connection = Connection { id: hub.next_connection(), hub: Arc::clone(&hub) };
    let (sink, stream) = socket.split();
    let (give_session, session) = watch::channel(None);
    let (give_wanted, wanted) = watch::channel(ClientImages::NOTHING);
    let (give_answers, answers) = mpsc::channel(ANSWERS_MAX);
    let mut reader = Reader {
        hub: Arc::clone(&hub),
        id: connection.id,
        peer: peer.address,
        has_token,
        session: give_session,
        wanted: give_wanted,
        answers: give_answers,
    };
    let mut stream = stream;
    if let Err(refusal) = reader.greet(&mut stream).await {
        tracing::info!(target: "pb3dp_panel::audit", peer = %peer.address, "WebSocket refused: {refusal}");
        let mut sink = sink;
        let _ = timeout(SEND_WITHIN, sink.send(text_of(&refused("hello", &refusal)))).await;
        let _ = timeout(SEND_WITHIN, sink.close()).await;
        return;
    }
    let writer = Writer { hub, id: connection.id, sink, session, wanted, answers };
    // The first end that is over ends the other one.
    tokio::select! {
        () = reader.run(stream) => {}
        () = writer.run() => {}
    }
}

/// Reads the messages of a client.
struct Reader {
    hub: Arc<Hub>,
    id: u64,
    peer: SocketAddr,
    has_token: bool,
    session: watch::Sender<Option<Session>>,
    wanted: watch::Sender<ClientImages>,
    answers: mpsc::Sender<ServerMessage>,
}

impl Reader {
    /// Waits for `hello`.
    async fn greet(&mut self, stream: &mut SplitStream<WebSocket>) -> Result<(), Refusal> {
        let no_hello = || Refusal::Protocol { why: format!("no hello within {} s", HELLO_WITHIN.as_secs()) };
        let first = timeout(HELLO_WITHIN, stream.next()).await.map_err(|_| no_hello())?;
        let Some(Ok(Message::Text(text))) = first else { return Err(no_hello()) };
        match parse(&text)? {
            message @ ClientMessage::Hello { .. } => self.take(message),
            _ => Err(Refusal::Protocol { why: "the first message must be hello".to_owned() }),
        }
    }

    async fn run(&mut self, mut stream: SplitStream<WebSocket>) {
        let mut second = interval(Duration::from_secs(1));
        second.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut count = 0;
        loop {
            let message = tokio::select! {
                _ = second.tick() => {
                    count = 0;
                    continue;
                }
                message = timeout(IDLE_MAX, stream.next()) => message,
            };
            count += 1;
            let Ok(Some(Ok(message))) = message else { return };
            if count > MESSAGES_PER_S {
                return;
            }
            let (to, taken) = match message {
                Message::Text(text) => match parse(&text) {
                    Ok(message) => (name_of(&message), self.take(message)),
                    Err(refusal) => ("message", Err(refusal)),
                },
                Message::Binary(_) => ("message", Err(Refusal::Protocol { why: "clients send text only".to_owned() })),
                Message::Ping(_) | Message::Pong(_) => continue,
                Message::Close(_) => return,
            };
            if let Err(refusal) = taken {
                // More answers than the client reads are left out.
                let _ = self.answers.try_send(refused(to, &refusal));
            }
        }
    }

    fn take(&mut self, message: ClientMessage) -> Result<(), Refusal> {
        match message {
            ClientMessage::Hello { protocol, session, token } => {
                if protocol != PROTOCOL {
                    let why = format!("protocol {protocol} is not supported, this is {PROTOCOL}; reload the page");
                    return Err(Refusal::Protocol { why });
                }
                if !self.has_token {
                    check_token(token.as_deref(), self.hub.config.protection.as_ref())?;
                    self.has_token = true;
                }
                let session = session.as_deref().and_then(Session::from_hex);
                let is_holder = session.is_some() && self.hub.check_holder(session).is_ok();
                let mut commander = self.hub.commander();
                if is_holder {
                    // The newest page of a session answers its heartbeats.
                    *commander = Some(self.id);
                } else if *commander == Some(self.id) {
                    *commander = None;
                }
                drop(commander);
                self.session.send_replace(session.filter(|_| is_holder));
                let error = (session.is_some() && !is_holder).then(|| self.hub.check_holder(session).err()).flatten();
                let _ = self.answers.try_send(ServerMessage::Answer {
                    to: "hello",
                    accepted: true,
                    error: error.as_ref().map(ToString::to_string),
                    code: error.as_ref().map(Refusal::code),
                });
            }
            ClientMessage::Images { left, right, view, fps_max, heat } => {
                let fps_max = fps_max.filter(|fps| *fps > 0.0).unwrap_or(30.0).min(FPS_MAX);
                let heat = heat && left && view == ImageView::Raw;
                let wanted = ClientImages { sides: [left, right], view, fps_max, heat };
                self.hub.viewers.set(self.id, wanted);
                self.wanted.send_replace(wanted);
            }
            ClientMessage::Heartbeat { nonce, visible, pressed } => {
                let session = *self.session.borrow();
                self.hub.heartbeat(session, &HeartbeatRequest { nonce, visible, pressed })?;
            }
            ClientMessage::Stop {} => {
                tracing::info!(target: "pb3dp_panel::audit", peer = %self.peer, "stop by WebSocket");
                let answer = self.hub.give_command(OperatorCommand::Stop, 0, None)?;
                let answers = self.answers.clone();
                // Meanwhile the connection goes on.
                tokio::spawn(async move {
                    let was_taken = match taken_within("stop", answer).await {
                        Ok(_) => ServerMessage::Answer { to: "stop", accepted: true, error: None, code: None },
                        Err(refusal) => refused("stop", &refusal),
                    };
                    let _ = answers.try_send(was_taken);
                });
            }
        }
        Ok(())
    }
}

/// Sends to a client.
struct Writer {
    hub: Arc<Hub>,
    id: u64,
    sink: SplitSink<WebSocket, Message>,
    session: watch::Receiver<Option<Session>>,
    wanted: watch::Receiver<ClientImages>,
    answers: mpsc::Receiver<ServerMessage>,
}

impl Writer {
    /// Sends until the client no longer reads.
    async fn run(mut self) {
        let mut states = self.hub.states.subscribe();
        let mut images = self.hub.images.subscribe();
        let mut log = self.hub.log_feed.subscribe();
        let mut beat = interval(BEAT_EVERY);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut beats, mut shown_at) = (0_u32, None);
        states.mark_changed();
        let lines = self.hub.last_log_lines();
        if !lines.is_empty() && self.send(text_of(&ServerMessage::Log { lines })).await.is_err() {
            return;
        }
        loop {
            // In this order: a late heartbeat holds the arms, a late image does not.
            let sent = tokio::select! {
                biased;
                _ = beat.tick() => {
                    beats = beats.wrapping_add(1);
                    self.beat(beats).await
                }
                Some(answer) = self.answers.recv() => self.send(text_of(&answer)).await,
                Ok(()) = states.changed() => {
                    let state = states.borrow_and_update().clone();
                    self.send(Message::Text(state)).await
                }
                lines = log.recv() => match lines {
                    Ok(lines) => self.send(text_of(&ServerMessage::Log { lines: lines.to_vec() })).await,
                    Err(broadcast::error::RecvError::Lagged(_)) => Ok(()),
                    Err(broadcast::error::RecvError::Closed) => return,
                },
                Ok(()) = images.changed() => {
                    let pair = images.borrow_and_update().clone();
                    let wanted = *self.wanted.borrow();
                    self.show(pair.as_deref(), wanted, &mut shown_at).await
                }
                else => return,
            };
            if sent.is_err() {
                return;
            }
        }
    }

    async fn send(&mut self, message: Message) -> Result<(), ()> {
        match timeout(SEND_WITHIN, self.sink.send(message)).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(()),
        }
    }

    /// A new nonce for the holder, and from time to time a ping.
    async fn beat(&mut self, beats: u32) -> Result<(), ()> {
        if beats.is_multiple_of(BEATS_PER_PING) {
            self.send(Message::Ping(Bytes::new())).await?;
        }
        let session = *self.session.borrow();
        let is_commander = *self.hub.commander() == Some(self.id);
        if session.is_none() || !is_commander {
            return Ok(());
        }
        match self.hub.next_nonce(session) {
            Ok(nonce) => self.send(text_of(&ServerMessage::Heartbeat { nonce: nonce.to_hex() })).await,
            // The lease has gone to somebody else; the state says so.
            Err(_) => Ok(()),
        }
    }

    async fn show(
        &mut self,
        pair: Option<&EncodedPair>,
        wanted: ClientImages,
        shown_at: &mut Option<f64>,
    ) -> Result<(), ()> {
        let Some(pair) = pair else { return Ok(()) };
        let at_s = pair.at.as_secs_f64();
        let interval_s = 0.9 / wanted.fps_max;
        if !wanted.is_anything() || shown_at.is_some_and(|before| (0.0..interval_s).contains(&(at_s - before))) {
            return Ok(());
        }
        for (message, is_wanted) in pair.messages[wanted.view as usize].iter().zip(wanted.sides) {
            if let (Some(bytes), true) = (message, is_wanted) {
                *shown_at = Some(at_s);
                self.send(Message::Binary(bytes.clone())).await?;
            }
        }
        if let (Some(heat), true) = (&pair.heat, wanted.heat) {
            self.send(Message::Binary(heat.clone())).await?;
        }
        Ok(())
    }
}

/// Reads a message of a client.
pub fn parse(text: &str) -> Result<ClientMessage, Refusal> {
    serde_json::from_str(text).map_err(|error| Refusal::Protocol { why: error.to_string() })
}

fn name_of(message: &ClientMessage) -> &'static str {
    match message {
        ClientMessage::Hello { .. } => "hello",
        ClientMessage::Images { .. } => "images",
        ClientMessage::Heartbeat { .. } => "heartbeat",
        ClientMessage::Stop {} => "stop",
    }
}

fn refused(to: &'static str, refusal: &Refusal) -> ServerMessage {
    ServerMessage::Answer { to, accepted: false, error: Some(refusal.to_string()), code: Some(refusal.code()) }
}

fn text_of(message: &ServerMessage) -> Message {
    Message::Text(serde_json::to_string(message).map_or_else(|_| Utf8Bytes::from_static("{}"), Utf8Bytes::from))
}
