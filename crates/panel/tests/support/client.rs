//! A plain HTTP client of the panel, as a script is one.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Time in which anything that is to happen has happened, also on a busy machine.
pub const TIMEOUT: Duration = Duration::from_secs(10);

/// An answer.
#[derive(Debug)]
pub struct Reply {
    pub status: u16,
    pub head: String,
    pub body: String,
}

impl Reply {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.body))
    }

    pub fn code(&self) -> String {
        self.json()["code"].as_str().unwrap_or_default().to_owned()
    }

    #[track_caller]
    pub fn is_refused(&self, status: u16, code: &str) {
        assert_eq!((self.status, self.code().as_str()), (status, code), "{}", self.body);
    }

    #[track_caller]
    pub fn is_accepted(&self) {
        assert_eq!(self.status, 200, "{}", self.body);
    }
}

/// A client; it may hold the lease.
pub struct Client {
    pub address: SocketAddr,
    pub session: Option<String>,
    pub nonce: Option<String>,
    /// How long [`Self::wait_for`] waits.
    pub patience: Duration,
    beating: Option<(Arc<AtomicBool>, JoinHandle<()>)>,
}

impl Client {
    pub fn new(address: SocketAddr) -> Self {
        Self { address, session: None, nonce: None, patience: TIMEOUT, beating: None }
    }

    /// Sends a request with these further lines in its head.
    pub fn request(&self, method: &str, path: &str, head: &str, body: &str) -> Reply {
        let host = if head.lines().any(|line| line.starts_with("Host:")) {
            String::new()
        } else {
            format!("Host: {}\r\n", self.address)
        };
        let session = self.session.as_ref().map(|session| format!("PB3DP-Session: {session}\r\n")).unwrap_or_default();
        let text = format!(
            "{method} {path} HTTP/1.1\r\n{host}{session}Connection: close\r\nContent-Length: {}\r\n{head}\r\n{body}",
            body.len()
        );
        raw(self.address, text.as_bytes())
    }

    pub fn get(&self, path: &str) -> Reply {
        self.request("GET", path, "", "")
    }

    pub fn post(&self, command: &str, body: &str) -> Reply {
        self.request("POST", &format!("/api/{command}"), "Content-Type: application/json\r\n", body)
    }

    /// A command on what this client sees now.
    pub fn command(&self, command: &str, mut body: Value) -> Reply {
        body["seen"] = self.shown_state();
        self.post(command, &body.to_string())
    }

    pub fn state(&self) -> Value {
        self.get("/api/state").json()
    }

    /// What this client saw, for a command.
    pub fn shown_state(&self) -> Value {
        shown_in(&self.state())
    }

    pub fn wait_for(&self, what: &str, mut is: impl FnMut(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            let state = self.state();
            if is(&state) {
                return state;
            }
            assert!(start.elapsed() < self.patience, "{what}: {state}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Takes the lease.
    pub fn take(&mut self, name: &str) {
        self.lease("take", name).is_accepted();
    }

    /// Takes the lease or takes it over.
    pub fn lease(&mut self, action: &str, name: &str) -> Reply {
        let reply = self.post("lease", &json!({ "action": action, "name": name }).to_string());
        if reply.status == 200 {
            let answer = reply.json();
            self.session = answer["session"].as_str().map(str::to_owned);
            self.nonce = answer["nonce"].as_str().map(str::to_owned);
        }
        reply
    }

    /// One heartbeat.
    pub fn beat(&mut self) -> Reply {
        let reply = self.post("heartbeat", &json!({ "nonce": self.nonce }).to_string());
        if reply.status == 200 {
            self.nonce = reply.json()["nonce"].as_str().map(str::to_owned);
        }
        reply
    }

    /// Sends heartbeats until [`Self::fall_silent`].
    pub fn keep_alive(&mut self) {
        let mut other = Self::new(self.address);
        (other.session, other.nonce) = (self.session.clone(), self.nonce.take());
        let is_over = Arc::new(AtomicBool::new(false));
        let observed = is_over.clone();
        let thread = std::thread::spawn(move || {
            while !observed.load(Ordering::SeqCst) {
                other.beat();
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        self.beating = Some((is_over, thread));
    }

    pub fn fall_silent(&mut self) {
        if let Some((is_over, thread)) = self.beating.take() {
            is_over.store(true, Ordering::SeqCst);
            thread.join().unwrap();
        }
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.fall_silent();
    }
}

pub fn shown_in(state: &Value) -> Value {
    json!({ "state": state["state"]["number"], "target": state["target"]["id"], "time_ms": state["time_ms"] })
}

/// Sends bytes and reads the answer until its end.
pub fn raw(address: SocketAddr, bytes: &[u8]) -> Reply {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    // The server may answer and close before it has read all.
    let _ = stream.write_all(bytes);
    read_reply(&mut stream)
}

/// Reads one answer.
pub fn read_reply(stream: &mut TcpStream) -> Reply {
    let mut all = Vec::new();
    let mut part = [0; 4096];
    loop {
        let text = String::from_utf8_lossy(&all);
        if let Some((head, body)) = text.split_once("\r\n\r\n") {
            let length =
                head.lines().find_map(|line| line.to_ascii_lowercase().strip_prefix("content-length: ")?.parse().ok());
            if length.is_some_and(|length: usize| body.len() >= length) {
                break;
            }
        }
        match stream.read(&mut part) {
            Ok(0) | Err(_) => break,
            Ok(count) => all.extend_from_slice(&part[..count]),
        }
    }
    let text = String::from_utf8_lossy(&all).into_owned();
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
    Reply { status, head: head.to_owned(), body: body.to_owned() }
}
