//! A gateway with TLS: nobody reads the frames, no other gateway is believed, and nobody disturbs the host by its handshake.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::BorrowedFd;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use pb3dp_arm_pa10::arm::{AccessError, KeyedTcp};
use pb3dp_arm_pa10::driver::{DriverState, Request};
use pb3dp_arm_pa10_gateway::service::{Access, HostSide, OPENING_MAX};
use pb3dp_arm_pa10_protocol::gateway_protocol::Dialect;
use pb3dp_arm_pa10_test_support::tls::{new_certificate, side_with, tls_side};
use pb3dp_arm_pa10_test_support::world::{ARM, Emulation, Host, LONG, home, keyed, ms, tcp_side, test_key};
use pb3dp_hal_platform::tcp::TcpLink;
use pb3dp_hal_platform::transport::{ByteLink, Connector, Unplugged};
use pb3dp_message_codes::Coded as _;
use pb3dp_test_support::in_real_time_beside_others;

use super::gateway_access::{CLOSED_WITHIN, start};

/// What passed on the line, in both directions.
#[derive(Clone, Default)]
struct Capture(Arc<Mutex<Vec<u8>>>, Arc<Mutex<Vec<u8>>>);

/// A line that somebody listens to.
struct Tapped(TcpLink, Capture);

impl ByteLink for Tapped {
    fn name(&self) -> &str {
        self.0.name()
    }
    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        let count = self.0.try_read(buffer)?;
        self.1.0.lock().unwrap().extend_from_slice(&buffer[..count]);
        Ok(count)
    }
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        let count = self.0.try_write(bytes)?;
        self.1.1.lock().unwrap().extend_from_slice(&bytes[..count]);
        Ok(count)
    }
    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.0.fd()
    }
}

/// A host that moves the arm, disables it and goes, and what it read and wrote on the line.
fn run_and_capture(gateway: &KeyedTcp, emulation: &Emulation) -> [Vec<u8>; 2] {
    let capture = Capture::default();
    let link = Tapped(TcpLink::connect(&gateway.tcp).unwrap(), capture.clone());
    let mut host = Host::new(gateway.open(link).unwrap(), Dialect::GatewayV1);
    host.open();
    host.lead_to_moving();
    assert!(!emulation.observed().is_braked);
    host.do_it(Request::Stop);
    host.must_be(DriverState::Connected);
    assert!(emulation.observed().is_braked && !host.is_gone);
    [capture.0, capture.1].map(|bytes| bytes.lock().unwrap().clone())
}

/// Beginnings of frames of this arm in a capture.
fn frames_in(capture: &[u8]) -> usize {
    capture.windows(4).filter(|bytes| bytes[..3] == [0xA5, 0x5A, 1] && bytes[3] == ARM.0).count()
}

fn refusal(host: &KeyedTcp) -> AccessError {
    let since = Instant::now();
    let refused = host.open(TcpLink::connect(&host.tcp).unwrap()).err().unwrap();
    assert!(since.elapsed() < LONG, "{refused}");
    refused
}

#[test]
fn an_arm_goes_up_and_down_and_nobody_reads_its_frames() {
    in_real_time_beside_others(|| {
        let (side, host) = tls_side();
        let (server, emulation) = start(side);
        for capture in run_and_capture(&host, &emulation) {
            assert!(capture.len() > 2000, "{}", capture.len());
            assert_eq!(frames_in(&capture), 0);
        }
        assert!(server.end().unwrap().bytes.frames > 20);
        let (side, address) = tcp_side();
        let (_server, emulation) = start(side);
        for capture in run_and_capture(&keyed(address), &emulation) {
            assert!(frames_in(&capture) > 20, "the search finds frames without TLS");
        }
    });
}

/// A connection that moved the arm, sent once more to a gateway with the same certificate.
#[test]
fn a_replayed_tls_connection_drives_no_arm() {
    in_real_time_beside_others(|| {
        let (identity, certificate) = new_certificate();
        let (side, host) = side_with(identity.clone(), certificate.clone());
        let (server, emulation) = start(side);
        let [_, written] = run_and_capture(&host, &emulation);
        drop((server, emulation));
        let (side, host) = side_with(identity, certificate);
        let (server, emulation) = start(side);
        // The records of the client begin with their type and version: the handshake is replayed from each of them on.
        let records = written.windows(3).enumerate().filter(|(_, begin)| begin[1..] == [3, 3]).map(|(at, _)| at);
        for from in [0].into_iter().chain(records.take(4)).chain([written.len() / 2]) {
            assert_closed(host.tcp.address, &written[from..]);
        }
        assert!((emulation.observed().position_rad - home()).amax() < 1e-6);
        assert_eq!(server.end().unwrap().bytes.frames, 0, "the cycle thread heard of it");
    });
}

/// Sends bytes to a gateway, which closes the connection in time.
fn assert_closed(address: SocketAddr, bytes: &[u8]) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(CLOSED_WITHIN)).unwrap();
    stream.write_all(bytes).ok();
    let since = Instant::now();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).ok();
    assert!(since.elapsed() < CLOSED_WITHIN, "the connection stays open");
}

#[test]
fn incompatible_hosts_and_gateways_are_refused_with_the_reason() {
    let (side, host) = tls_side();
    let (server, _emulation) = start(side);
    let is_reported = |part: &str| {
        let since = Instant::now();
        while !server.try_message().is_some_and(|text| text.contains(part)) {
            assert!(since.elapsed() < LONG, "the log does not tell: {part}");
            std::thread::yield_now();
        }
        // The log has at most one line per second.
        std::thread::sleep(ms(1100));
    };
    let check = |host: &KeyedTcp, code: &str, part: &str| {
        let refused = refusal(host);
        assert_eq!(refused.message_code().code, code, "{refused}");
        assert!(refused.to_string().contains(part), "{refused}");
    };
    let (_, other) = new_certificate();
    check(&KeyedTcp { certificate: Some(other), ..host.clone() }, "PB3DP-ARM-610", "`gateway.certificate`");
    is_reported("it refuses the certificate of this gateway");
    check(&KeyedTcp { certificate: None, ..host.clone() }, "PB3DP-ARM-608", "name it in `gateway.certificate`");
    is_reported("it uses no TLS");
    let (side, address) = tcp_side();
    let (server, _emulation) = start(side);
    let host = KeyedTcp { certificate: host.certificate, ..keyed(address) };
    check(&host, "PB3DP-ARM-609", "set `access.tls`");
    let since = Instant::now();
    while !server.try_message().is_some_and(|text| text.contains("it uses TLS, and `access.tls` is not set")) {
        assert!(since.elapsed() < LONG, "the log does not tell of TLS");
        std::thread::yield_now();
    }
}

/// The list of addresses comes before TLS, and its refusal reaches a host with TLS.
#[test]
fn a_tls_host_that_is_not_on_the_list_is_refused_with_the_reason() {
    let (identity, certificate) = new_certificate();
    let access = Access { key: test_key(), peers: vec!["192.0.2.7".parse().unwrap()], tls: Some(identity) };
    let side = HostSide::listen("127.0.0.1:0".parse().unwrap(), ARM, access).unwrap();
    let host = KeyedTcp { certificate: Some(certificate), ..keyed(side.address().unwrap()) };
    let (_server, _emulation) = start(side);
    let refused = refusal(&host);
    assert!(matches!(refused, AccessError::PeerNotAllowed { .. }), "{refused}");
}

/// A first record of TLS that announces more bytes than follow.
const BEGIN: [u8; 12] = [22, 3, 1, 2, 0, 1, 0, 1, 0xFC, 3, 3, 7];

/// Handshakes that stall, drip, are garbage or of another kind, while a host moves the arm.
#[test]
fn wrong_handshakes_are_closed_and_disturb_nobody() {
    in_real_time_beside_others(|| {
        let (side, gateway) = tls_side();
        let address = gateway.tcp.address;
        let (server, emulation) = start(side);
        let mut host = Host::new(gateway.clone().connect().unwrap(), Dialect::GatewayV1);
        host.open();
        host.lead_to_moving();
        let strangers = std::thread::spawn(move || {
            let garbage = [0x5A; 3000];
            let huge = [[22, 3, 3, 0xFF, 0xFF].as_slice(), &garbage].concat();
            let cases: [&[u8]; 6] = [&[], &BEGIN, &[22], &garbage, &huge, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"];
            for bytes in cases {
                assert_closed(address, bytes);
            }
            let since = Instant::now();
            let mut drip = TcpStream::connect(address).unwrap();
            let mut bytes = BEGIN.iter().cycle();
            while drip.write_all(&[*bytes.next().unwrap()]).is_ok() {
                assert!(since.elapsed() < OPENING_MAX + CLOSED_WITHIN, "a dripping connection stays open");
                std::thread::sleep(ms(20));
            }
        });
        while !strangers.is_finished() {
            host.run_for(ms(50), |_| false);
        }
        strangers.join().unwrap();
        host.must_be(DriverState::Moving);
        assert!(!emulation.observed().is_braked && !host.is_gone);
        drop(server);
    });
}
