//! A gateway that goes on with the last command when its host has gone: what a gateway must never do.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Frame, FrameParser, Received};

/// Between two commands.
const CYCLE: Duration = Duration::from_millis(10);
/// The type of COMMAND.
const COMMAND: u8 = 0x02;

/// Whom it listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hosts {
    /// Every host that connects.
    All,
    /// Nobody after one that was killed while it moved the arm.
    UntilAKill,
}

/// Stands before a sound gateway, and feeds its watchdog when nobody else does.
pub struct UnwatchedGateway {
    address: String,
    is_running: Arc<AtomicBool>,
    is_plugged: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl UnwatchedGateway {
    /// Before the gateway at this address.
    pub fn start(gateway: &str, hosts: Hosts) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let upstream = TcpStream::connect(gateway).unwrap();
        upstream.set_nodelay(true).unwrap();
        upstream.set_nonblocking(true).unwrap();
        let is_running = Arc::new(AtomicBool::new(true));
        let is_plugged = Arc::new(AtomicBool::new(true));
        let (plug, parser) = (Arc::clone(&is_plugged), FrameParser::new(ArmId(1)));
        let mut relay = Relay { listener, upstream, plug, hosts, host: None, parser, last: None };
        let goes_on = Arc::clone(&is_running);
        let thread = std::thread::spawn(move || {
            while goes_on.load(Ordering::SeqCst) {
                relay.turn();
            }
        });
        Self { address, is_running, is_plugged, thread: Some(thread) }
    }

    pub fn address(&self) -> String {
        self.address.clone()
    }

    /// Pulls the cable to the host, or plugs it in again.
    pub fn plug(&self, is_plugged: bool) {
        self.is_plugged.store(is_plugged, Ordering::SeqCst);
    }
}

impl Drop for UnwatchedGateway {
    fn drop(&mut self) {
        self.is_running.store(false, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

struct Relay {
    listener: TcpListener,
    upstream: TcpStream,
    plug: Arc<AtomicBool>,
    hosts: Hosts,
    host: Option<TcpStream>,
    parser: FrameParser,
    /// The last command, and when it came.
    last: Option<(Frame, Instant)>,
}

impl Relay {
    fn turn(&mut self) {
        let mut buffer = [0; 512];
        let is_plugged = self.plug.load(Ordering::SeqCst);
        if !is_plugged {
            self.host = None;
        }
        match &mut self.host {
            Some(host) => {
                match host.read(&mut buffer) {
                    Ok(0) => self.host = None,
                    Ok(count) => {
                        let last = &mut self.last;
                        self.parser.feed(&buffer[..count], |received| {
                            if let Received::Frame(frame) = received {
                                *last =
                                    (frame.frame_type == COMMAND).then_some((frame, Instant::now())).or(last.take());
                            }
                        });
                        self.upstream.write_all(&buffer[..count]).unwrap();
                    }
                    Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
                    Err(_) => self.host = None,
                }
                if let (Some(host), Ok(count)) = (&mut self.host, self.upstream.read(&mut buffer)) {
                    // A host that has gone is noticed by reading.
                    host.write_all(&buffer[..count]).ok();
                }
                std::thread::sleep(Duration::from_micros(300));
            }
            None => {
                // A host that ends by itself says zero speeds before: all after the mode.
                let was_killed = self.last.is_some_and(|(frame, _)| frame.payload[1..].iter().any(|byte| *byte != 0));
                let listens = self.hosts == Hosts::All || !was_killed;
                if is_plugged
                    && listens
                    && let Ok((host, _)) = self.listener.accept()
                {
                    host.set_nonblocking(true).unwrap();
                    host.set_nodelay(true).unwrap();
                    self.host = Some(host);
                    return;
                }
                self.feed();
                // Nobody wants the answers.
                while self.upstream.read(&mut buffer).is_ok_and(|count| count > 0) {}
                std::thread::sleep(CYCLE);
            }
        }
    }

    /// Sends the last command once more.
    fn feed(&mut self) {
        if let Some((frame, at)) = &mut self.last {
            let now = Instant::now();
            frame.sequence = frame.sequence.wrapping_add(1);
            frame.timestamp_us += (now - *at).as_micros() as u64;
            *at = now;
            self.upstream.write_all(&frame.encode()).unwrap();
        }
    }
}
