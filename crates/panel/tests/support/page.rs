//! The WebSocket of a page.

use std::net::{SocketAddr, TcpStream};
use std::time::Instant;

use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

use super::client::{Client, TIMEOUT};

/// The WebSocket of a page.
pub struct Page {
    pub socket: WebSocket<TcpStream>,
}

impl Page {
    /// Connects and says hello.
    pub fn open(client: &Client) -> Self {
        let mut page = Self::connect(client.address, None).unwrap();
        page.send(json!({ "type": "hello", "protocol": 1, "session": client.session }));
        let answer = page.next_of("answer");
        assert_eq!((&answer["to"], &answer["accepted"]), (&json!("hello"), &json!(true)), "{answer}");
        page
    }

    /// Connects and says hello; the answer may come after other messages.
    pub fn open_without_answer(client: &Client) -> Self {
        let mut page = Self::connect(client.address, None).unwrap();
        page.send(json!({ "type": "hello", "protocol": 1, "session": client.session }));
        page
    }

    /// Connects with an origin.
    pub fn connect(address: SocketAddr, origin: Option<&str>) -> Result<Self, String> {
        let stream = TcpStream::connect(address).map_err(|error| error.to_string())?;
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        let mut request = format!("ws://{address}/api/events").into_client_request().unwrap();
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().unwrap());
        }
        let (socket, _) = tungstenite::client(request, stream).map_err(|error| error.to_string())?;
        Ok(Self { socket })
    }

    pub fn send(&mut self, message: Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    /// The next message, text as JSON or bytes.
    pub fn next(&mut self) -> Result<Result<Value, Vec<u8>>, String> {
        loop {
            match self.socket.read().map_err(|error| error.to_string())? {
                Message::Text(text) => return Ok(Ok(serde_json::from_str(&text).unwrap())),
                Message::Binary(bytes) => return Ok(Err(bytes.to_vec())),
                Message::Close(_) => return Err("closed".to_owned()),
                _ => {}
            }
        }
    }

    /// The next text message of a type.
    pub fn next_of(&mut self, kind: &str) -> Value {
        let start = Instant::now();
        while start.elapsed() < TIMEOUT {
            if let Ok(message) = self.next().unwrap()
                && message["type"] == kind
            {
                return message;
            }
        }
        panic!("no message of type {kind}");
    }

    /// The next binary message.
    pub fn next_image(&mut self) -> Vec<u8> {
        let start = Instant::now();
        while start.elapsed() < TIMEOUT {
            if let Err(bytes) = self.next().unwrap() {
                return bytes;
            }
        }
        panic!("no image");
    }

    /// Answers the next heartbeat.
    pub fn beat(&mut self, visible: bool, pressed: bool) -> Value {
        let nonce = self.next_of("heartbeat")["nonce"].clone();
        self.send(json!({ "type": "heartbeat", "nonce": nonce, "visible": visible, "pressed": pressed }));
        nonce
    }
}
