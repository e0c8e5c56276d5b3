//! A gateway that goes on with the last command when its host has gone: what a gateway must never do.

use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{KeyedTcp, read_shared_key};
use pb3dp_arm_pa10_gateway::service::{Access, Admission};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Frame, FrameParser, Received};
use pb3dp_hal_platform::realtime::now;
use pb3dp_hal_platform::tcp::TcpConfig;
use pb3dp_hal_platform::transport::{ByteLink, Connector};

use super::support::key_file;

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
        let key = read_shared_key(&key_file()).unwrap();
        let admission = Admission::by_tcp(listener, ArmId(1), Access::from_this_computer(key));
        let gateway = KeyedTcp { tcp: TcpConfig { address: gateway.parse().unwrap() }, key, arm: ArmId(1) };
        let is_running = Arc::new(AtomicBool::new(true));
        let is_plugged = Arc::new(AtomicBool::new(true));
        let (plug, parser) = (Arc::clone(&is_plugged), FrameParser::new(ArmId(1)));
        let mut relay = Relay { admission, gateway, upstream: None, plug, hosts, host: None, parser, last: None };
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
    admission: Admission,
    gateway: KeyedTcp,
    /// Opened with the first host: a connection without a HELLO is closed.
    upstream: Option<Box<dyn ByteLink>>,
    plug: Arc<AtomicBool>,
    hosts: Hosts,
    host: Option<Box<dyn ByteLink>>,
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
                match host.try_read(&mut buffer) {
                    Ok(count) => {
                        let last = &mut self.last;
                        self.parser.feed(&buffer[..count], |received| {
                            if let Received::Frame(frame) = received {
                                *last =
                                    (frame.frame_type == COMMAND).then_some((frame, Instant::now())).or(last.take());
                            }
                        });
                        self.pass_on(&buffer[..count]);
                    }
                    Err(_) => self.host = None,
                }
                let count = self.read_answers(&mut buffer);
                if let Some(host) = &mut self.host {
                    // A host that has gone is noticed by reading.
                    write_all(host.as_mut(), &buffer[..count]);
                }
                std::thread::sleep(Duration::from_micros(300));
            }
            None => {
                // A host that ends by itself says zero speeds before: all after the mode.
                let was_killed = self.last.is_some_and(|(frame, _)| frame.payload[1..].iter().any(|byte| *byte != 0));
                let listens = self.hosts == Hosts::All || !was_killed;
                if is_plugged
                    && listens
                    && let Some(admitted) = self.admission.poll(now(), None, &mut |_| {})
                {
                    self.host = Some(admitted.link);
                    if self.upstream.is_none() {
                        self.upstream = Some(self.gateway.connect().unwrap());
                    }
                    return;
                }
                self.feed();
                // Nobody wants the answers.
                while self.read_answers(&mut buffer) > 0 {}
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
            let bytes = frame.encode();
            self.pass_on(&bytes);
        }
    }

    fn pass_on(&mut self, bytes: &[u8]) {
        if let Some(upstream) = &mut self.upstream {
            write_all(upstream.as_mut(), bytes);
        }
    }

    fn read_answers(&mut self, buffer: &mut [u8; 512]) -> usize {
        self.upstream.as_mut().and_then(|upstream| upstream.try_read(buffer).ok()).unwrap_or(0)
    }
}

fn write_all(link: &mut dyn ByteLink, bytes: &[u8]) {
    let mut written = 0;
    while written < bytes.len() {
        match link.try_write(&bytes[written..]) {
            Ok(count) => written += count,
            Err(_) => return,
        }
    }
}
