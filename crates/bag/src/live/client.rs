//! One viewer: its connection, its subscriptions, and what it has still to get. Nothing here waits.

use std::collections::{BTreeMap, VecDeque};
use std::io::ErrorKind;
use std::net::TcpStream;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;
use tungstenite::handshake::server::{Callback, ErrorResponse, Request as HttpRequest, Response, ServerHandshake};
use tungstenite::handshake::{HandshakeError, MidHandshake};
use tungstenite::http::{HeaderValue, StatusCode};
use tungstenite::protocol::{CloseFrame, WebSocketConfig, frame::coding::CloseCode};
use tungstenite::{Error, Message, WebSocket};

use super::protocol::{self, Request};
use crate::backlog::{Backlog, Limits};
use crate::encoded::{Description, Encoded};

/// Bytes of images and others that wait for a slow viewer: 4 pairs of raw colour images of 640x480. The lag of a slow viewer grows with it.
const BACKLOG_BYTES_MAX: u64 = 8 << 20;
/// Bytes that must not be dropped: channels, and messages that describe the run. More wait only for a client that does not read.
const CONTROL_BYTES_MAX: usize = 4 << 20;
/// Longest message of a client: a subscription to all channels is far shorter.
const RECEIVED_BYTES_MAX: usize = 64 << 10;
/// Messages of a client within a second.
const RECEIVED_PER_SECOND_MAX: u32 = 200;
/// Messages that are received or sent in a turn, before the other clients have theirs.
const PER_TURN: usize = 32;
/// Time for the handshake.
const GREETING_MAX: Duration = Duration::from_secs(5);
/// Time for one message: a viewer that takes none for so long is disconnected.
const STALLED_MAX: Duration = Duration::from_secs(60);

/// What all clients can subscribe to.
#[derive(Default)]
pub(super) struct Offer {
    /// Channels by number, from 0.
    pub(super) channels: Vec<Value>,
    pub(super) by_topic: BTreeMap<&'static str, u32>,
    pub(super) topics: Vec<&'static str>,
    pub(super) description: Description,
}

/// What the system reports of a connection.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ready {
    pub(super) to_read: bool,
    pub(super) to_write: bool,
}

/// Chooses the subprotocol, and refuses pages of others.
#[derive(Debug)]
struct Greeter;

impl Callback for Greeter {
    fn on_request(self, request: &HttpRequest, mut response: Response) -> Result<Response, ErrorResponse> {
        let header = |name: &str| request.headers().get(name).map(|value| value.to_str().unwrap_or_default());
        let refusal = |status: StatusCode, why: &str| {
            let mut refusal = ErrorResponse::new(Some(why.to_owned()));
            *refusal.status_mut() = status;
            refusal
        };
        let host = header("host").unwrap_or_default();
        if header("origin").is_some_and(|origin| !protocol::may_connect(origin, host)) {
            return Err(refusal(StatusCode::FORBIDDEN, "pages of this origin may not connect"));
        }
        let Some(chosen) = protocol::chosen(header("sec-websocket-protocol").unwrap_or_default()) else {
            let why = "the subprotocol foxglove.sdk.v1 or foxglove.websocket.v1 is needed";
            return Err(refusal(StatusCode::BAD_REQUEST, why));
        };
        response.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(chosen));
        Ok(response)
    }
}

enum Link {
    Greeting(MidHandshake<ServerHandshake<TcpStream, Greeter>>),
    Open(WebSocket<TcpStream>),
}

pub(super) struct Client {
    /// `None` only within a turn.
    link: Option<Link>,
    since: Instant,
    /// What is sent first and never dropped.
    control: VecDeque<Message>,
    control_bytes: usize,
    backlog: Backlog,
    /// Numbers of the client by channel.
    subscriptions: BTreeMap<u32, u32>,
    /// Since when a message is partly sent.
    stalled_since: Option<Instant>,
    /// The connection may have more to read than the system knows of.
    has_more: bool,
    second: Instant,
    received: u32,
}

/// Why a connection ends; a text is reported to the client.
struct Ended(Option<&'static str>);

impl Client {
    /// Begins with a connection that the system accepted.
    pub(super) fn new(stream: TcpStream, now: Instant) -> std::io::Result<Self> {
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        // A viewer whose computer is gone ends some time.
        rustix::net::sockopt::set_socket_keepalive(&stream, true)?;
        let config = WebSocketConfig::default()
            .read_buffer_size(4096)
            .write_buffer_size(0)
            .max_message_size(Some(RECEIVED_BYTES_MAX))
            .max_frame_size(Some(RECEIVED_BYTES_MAX));
        Ok(Self {
            link: Some(Link::Greeting(ServerHandshake::start(stream, Greeter, Some(config)))),
            since: now,
            control: VecDeque::new(),
            control_bytes: 0,
            backlog: Backlog::new(Limits { bytes_max: BACKLOG_BYTES_MAX, duration_max: None }),
            subscriptions: BTreeMap::new(),
            stalled_since: None,
            has_more: false,
            second: now,
            received: 0,
        })
    }

    pub(super) fn socket(&self) -> Option<BorrowedFd<'_>> {
        match self.link.as_ref()? {
            Link::Greeting(greeting) => Some(greeting.get_ref().get_ref().as_fd()),
            Link::Open(socket) => Some(socket.get_ref().as_fd()),
        }
    }

    /// What the next turn needs. A client that does not read is not read either.
    pub(super) fn needs(&self) -> Ready {
        Ready { to_read: self.stalled_since.is_none(), to_write: !self.is_idle() }
    }

    /// Whether the next turn has to read without a sign of the system.
    pub(super) fn has_more(&self) -> bool {
        self.has_more && self.stalled_since.is_none()
    }

    /// Whether nothing waits to be sent.
    pub(super) fn is_idle(&self) -> bool {
        self.stalled_since.is_none() && self.control.is_empty() && self.backlog.is_empty()
    }

    /// Announces new channels.
    pub(super) fn announce(&mut self, channels: &[Value]) {
        if matches!(self.link, Some(Link::Open(_))) {
            self.control(Message::text(protocol::advertise(channels)));
        }
    }

    /// Queues a message if the client has subscribed to its channel.
    pub(super) fn offer(&mut self, channel: u32, message: &Arc<Encoded>) {
        let Some(id) = self.subscriptions.get(&channel) else { return };
        if message.describes_the_run() {
            self.control(Message::binary(protocol::message_data(*id, message)));
        } else {
            self.backlog.push(Arc::clone(message));
        }
    }

    fn control(&mut self, message: Message) {
        self.control_bytes += message.len();
        self.control.push_back(message);
    }

    /// Reads and writes as much as the connection takes; false once it has ended.
    pub(super) fn turn(&mut self, ready: Ready, offer: &Offer, now: Instant) -> bool {
        let Err(Ended(why)) = self.try_turn(ready, offer, now) else { return true };
        if let (Some(why), Some(Link::Open(socket))) = (why, &mut self.link) {
            // As much as the connection takes: nobody waits for this client.
            let _ = socket.close(Some(CloseFrame { code: CloseCode::Policy, reason: why.into() }));
        }
        false
    }

    fn try_turn(&mut self, ready: Ready, offer: &Offer, now: Instant) -> Result<(), Ended> {
        if let Some(Link::Greeting(_)) = self.link {
            return self.greet(offer, now);
        }
        if (ready.to_read || self.has_more) && self.stalled_since.is_none() {
            self.read(offer, now)?;
        }
        if ready.to_write || self.stalled_since.is_none() {
            self.write(offer, now)?;
        }
        if self.control_bytes > CONTROL_BYTES_MAX || self.stalled_since.is_some_and(|since| now - since > STALLED_MAX) {
            return Err(Ended(Some("messages are not read")));
        }
        Ok(())
    }

    fn greet(&mut self, offer: &Offer, now: Instant) -> Result<(), Ended> {
        let Some(Link::Greeting(greeting)) = self.link.take() else { return Err(Ended(None)) };
        match greeting.handshake() {
            Ok(socket) => {
                self.link = Some(Link::Open(socket));
                self.control(Message::text(protocol::server_info()));
                self.announce(&offer.channels);
                self.write(offer, now)
            }
            Err(HandshakeError::Interrupted(greeting)) if now - self.since < GREETING_MAX => {
                self.link = Some(Link::Greeting(greeting));
                Ok(())
            }
            Err(_) => Err(Ended(None)),
        }
    }

    fn read(&mut self, offer: &Offer, now: Instant) -> Result<(), Ended> {
        self.has_more = false;
        for _ in 0..PER_TURN {
            let Some(Link::Open(socket)) = &mut self.link else { return Err(Ended(None)) };
            let message = match socket.read() {
                Ok(message) => message,
                Err(Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(Error::Capacity(_)) => return Err(Ended(Some("a message is too long"))),
                Err(_) => return Err(Ended(None)),
            };
            if now - self.second > Duration::from_secs(1) {
                (self.second, self.received) = (now, 0);
            }
            self.received += 1;
            if self.received > RECEIVED_PER_SECOND_MAX {
                return Err(Ended(Some("too many messages")));
            }
            // Binary messages are data of clients, which nothing here takes.
            if let Message::Text(text) = message {
                let requests = protocol::requests(&text).map_err(|why| Ended(Some(why)))?;
                requests.into_iter().for_each(|request| self.answer(request, offer));
            }
        }
        self.has_more = true;
        Ok(())
    }

    fn answer(&mut self, request: Request, offer: &Offer) {
        match request {
            Request::Subscribe { id, channel } => {
                let known = u32::try_from(channel).ok().filter(|channel| (*channel as usize) < offer.topics.len());
                let Some(channel) = known else {
                    return self.control(Message::text(protocol::warning(&format!("there is no channel {channel}"))));
                };
                if self.subscriptions.contains_key(&channel) || self.subscriptions.values().any(|used| *used == id) {
                    let why = format!("subscription {id} to channel {channel}: the number or channel is in use");
                    return self.control(Message::text(protocol::warning(&why)));
                }
                self.subscriptions.insert(channel, id);
                if let Some(message) = offer.description.of(offer.topics[channel as usize]) {
                    self.offer(channel, message);
                }
            }
            Request::Unsubscribe { id } => self.subscriptions.retain(|_, used| *used != id),
        }
    }

    fn write(&mut self, offer: &Offer, now: Instant) -> Result<(), Ended> {
        for _ in 0..PER_TURN {
            let Some(Link::Open(socket)) = &mut self.link else { return Err(Ended(None)) };
            let sent = if self.stalled_since.is_some() {
                socket.flush()
            } else if let Some(message) = self.control.pop_front() {
                self.control_bytes -= message.len();
                socket.send(message)
            } else if let Some(message) = self.backlog.pop() {
                let id = offer.by_topic.get(message.topic).and_then(|channel| self.subscriptions.get(channel));
                // No longer subscribed.
                let Some(id) = id else { continue };
                socket.send(Message::binary(protocol::message_data(*id, &message)))
            } else {
                return Ok(());
            };
            match sent {
                Ok(()) => self.stalled_since = None,
                // The connection holds the rest of the message.
                Err(Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => {
                    self.stalled_since.get_or_insert(now);
                    return Ok(());
                }
                Err(_) => return Err(Ended(None)),
            }
        }
        Ok(())
    }

    /// Ends the connection properly, if it takes that at once.
    pub(super) fn close(&mut self) {
        if let Some(Link::Open(socket)) = &mut self.link {
            let _ = socket.close(Some(CloseFrame { code: CloseCode::Away, reason: "the run has ended".into() }));
        }
    }
}
