//! Who may talk to a gateway on TCP: strangers on the same computer, web pages, replayed connections, floods, and peers that only
//! keep the line busy. No one but the host with the key moves the arm, and nobody disturbs that host.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::BorrowedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use pb3dp_arm_pa10::arm::{AccessError, KeyedTcp};
use pb3dp_arm_pa10::driver::DriverState;
use pb3dp_arm_pa10_gateway::bus::{BusPort, FrameSocket};
use pb3dp_arm_pa10_gateway::service::{Access, BusOpener, GatewayServer, GatewayServerConfig, HostSide};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, SharedKey};
use pb3dp_arm_pa10_test_support::world::{
    ARM, Emulation, Host, LONG, gateway_config, home, keyed, ms, tcp_side, test_key,
};
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_hal_platform::tcp::{TcpConfig, TcpLink};
use pb3dp_hal_platform::transport::{ByteLink, Connector, Unplugged};
use pb3dp_test_support::in_real_time_beside_others;

const REALTIME: Realtime = Realtime { priority: Some(20), locks_memory: false, cpu: None };

/// Longest time in which a gateway closes a connection that does not open.
pub(super) const CLOSED_WITHIN: std::time::Duration = ms(3000);

pub(super) fn start(side: HostSide) -> (GatewayServer, Emulation) {
    let (gateway, controller) = FrameSocket::pair("bus").unwrap();
    let emulation = Emulation::start(Box::new(controller), Some(ms(400)));
    let mut port = Some(gateway);
    let opener: BusOpener =
        Box::new(move || Ok(Box::new(port.take().ok_or("it was opened before")?) as Box<dyn BusPort>));
    let config = GatewayServerConfig { gateway: gateway_config(), realtime: REALTIME };
    (GatewayServer::start(config, opener, side).unwrap(), emulation)
}

pub fn started() -> (GatewayServer, Emulation, SocketAddr) {
    let (side, address) = tcp_side();
    let (server, emulation) = start(side);
    (server, emulation, address)
}

fn has_moved(emulation: &Emulation) -> bool {
    (emulation.observed().position_rad - home()).amax() > 1e-6
}

/// A host without the key sends HELLO again and again; the gateway closes its connection, and the arm does not move.
fn assert_refused(mut host: Host, emulation: &Emulation) {
    let since = Instant::now();
    while !host.is_gone {
        assert!(since.elapsed() < CLOSED_WITHIN, "the connection stays open");
        assert!(host.link.hello().is_none(), "a stranger is greeted");
        host.link.open(pb3dp_hal_platform::realtime::now());
        host.run_for(ms(100), |host| host.is_gone);
    }
    assert!(!has_moved(emulation));
}

/// (a) Another program on this computer, which knows nothing but the port.
#[test]
fn a_stranger_drives_no_arm() {
    in_real_time_beside_others(|| {
        let (server, emulation, address) = started();
        let link = TcpLink::connect(&TcpConfig { address }).unwrap();
        assert_refused(Host::new(Box::new(link)), &emulation);
        assert_eq!(server.end().unwrap().bytes.frames, 0, "the cycle thread heard of it");
    });
}

/// (b) A web page that posts frames.
#[test]
fn a_web_page_drives_no_arm() {
    in_real_time_beside_others(|| {
        let (server, emulation, address) = started();
        let mut link = TcpLink::connect(&TcpConfig { address }).unwrap();
        let request = b"POST / HTTP/1.1\r\nHost: 127.0.0.1:4534\r\nContent-Length: 100000\r\n\r\n";
        assert_eq!(link.try_write(request).unwrap(), request.len());
        assert_refused(Host::new(Box::new(link)), &emulation);
        assert_eq!(server.end().unwrap().bytes.frames, 0, "the cycle thread heard of it");
    });
}

/// (c) A peer that sends a byte per half second.
#[test]
fn a_dripping_peer_locks_nobody_out() {
    in_real_time_beside_others(|| {
        let (_server, _emulation, address) = started();
        let mut drip = TcpStream::connect(address).unwrap();
        let since = Instant::now();
        while since.elapsed() < ms(1500) {
            drip.write_all(&[0xA5]).ok();
            std::thread::sleep(ms(300));
        }
        let mut host = Host::new(keyed(address).connect().unwrap());
        host.open();
        host.lead_to_moving();
    });
}

/// The refusals that a host can act on.
#[test]
fn refused_hosts_receive_the_reason() {
    let (side, address) = tcp_side();
    let (server, _emulation) = start(side);
    let refusal = |host: KeyedTcp| host.open(TcpLink::connect(&host.tcp).unwrap()).err().unwrap();
    let other = KeyedTcp { key: SharedKey::new(&[1; 32]).unwrap(), ..keyed(address) };
    assert!(matches!(refusal(other), AccessError::KeyMismatch { .. }));
    // The host closes first; the log of the gateway must name the keys, too.
    let begin = Instant::now();
    let is_reported = || server.try_message().is_some_and(|text| text.contains("most likely it has another key"));
    while !is_reported() {
        assert!(begin.elapsed() < LONG, "the log does not name the keys");
        std::thread::yield_now();
    }
    let other = KeyedTcp { arm: ArmId(ARM.0 + 1), ..keyed(address) };
    let refused = refusal(other).to_string();
    assert!(refused.contains("refused the connection: wrong-arm"), "{refused}");
    let access = Access { key: test_key(), peers: vec!["192.0.2.7".parse().unwrap()] };
    let side = HostSide::listen("127.0.0.1:0".parse().unwrap(), ARM, access).unwrap();
    let address = side.address().unwrap();
    let (_server, _emulation) = start(side);
    let refused = refusal(keyed(address));
    assert!(matches!(refused, AccessError::PeerNotAllowed { .. }), "{refused}");
    assert!(refused.to_string().contains("`access.peers`"), "{refused}");
}

/// What a host wrote to a connection.
struct Tapped(TcpLink, Arc<Mutex<Vec<u8>>>);

impl ByteLink for Tapped {
    fn name(&self) -> &str {
        self.0.name()
    }
    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        self.0.try_read(buffer)
    }
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        let count = self.0.try_write(bytes)?;
        self.1.lock().unwrap().extend_from_slice(&bytes[..count]);
        Ok(count)
    }
    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.0.fd()
    }
}

/// A connection that moved the arm, sent once more: whole, and from each record on.
#[test]
fn a_replayed_connection_drives_no_arm() {
    in_real_time_beside_others(|| {
        let (server, emulation, address) = started();
        let capture = Arc::new(Mutex::new(Vec::new()));
        let link = Tapped(TcpLink::connect(&TcpConfig { address }).unwrap(), Arc::clone(&capture));
        let mut host = Host::new(Box::new(keyed(address).open(link).unwrap()));
        host.open();
        host.lead_to_moving();
        drop(host);
        emulation.wait_for("braked", |observed| observed.is_braked);
        let (frames, rested) = (server.end().unwrap().bytes.frames, emulation.observed().position_rad);
        assert!(frames > 20, "{frames}");
        drop(emulation);
        let (server, emulation, address) = started();
        let capture = capture.lock().unwrap().clone();
        for from in [0, 51, 102, 102 + 51, capture.len() / 2] {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.set_read_timeout(Some(CLOSED_WITHIN)).unwrap();
            stream.write_all(&capture[from..]).ok();
            let mut answer = Vec::new();
            stream.read_to_end(&mut answer).ok();
        }
        assert!(!has_moved(&emulation), "{rested}");
        assert_eq!(server.end().unwrap().bytes.frames, 0, "the cycle thread heard of it");
    });
}

/// Attackers on this computer: half-open sockets, ports that are scanned, HTTP, garbage and frames without a key.
fn attack(address: SocketAddr, connections: usize, end: &AtomicBool) -> usize {
    let mut open = Vec::new();
    let mut count = 0;
    while count < connections && !end.load(Ordering::SeqCst) {
        count += 1;
        // It has the priority of the test, and must leave time to the others.
        if count.is_multiple_of(5) {
            std::thread::sleep(ms(1));
        }
        let Ok(mut stream) = TcpStream::connect_timeout(&address, ms(200)) else { continue };
        stream.set_nonblocking(true).unwrap();
        match count % 4 {
            0 => {}
            1 => drop(stream.write(b"GET / HTTP/1.1\r\n\r\n")),
            2 => drop(stream.write(&[0xA5, 0x5A, 1, 2, 1, 5])),
            _ => continue,
        }
        open.push(stream);
        if open.len() >= 100 {
            open.drain(..50);
        }
    }
    count
}

#[test]
fn nobody_disturbs_the_owner() {
    in_real_time_beside_others(|| {
        let (server, emulation, address) = started();
        let mut host = Host::new(keyed(address).connect().unwrap());
        host.open();
        host.lead_to_moving();
        let end = Arc::new(AtomicBool::new(false));
        let its_end = Arc::clone(&end);
        let attacker = std::thread::spawn(move || attack(address, 10_000, &its_end));
        host.run_for(ms(3000), |_| false);
        end.store(true, Ordering::SeqCst);
        host.must_be(DriverState::Moving);
        assert!(attacker.join().unwrap() > 100);
        assert!(!emulation.observed().is_braked);
        drop(server);
    });
}
