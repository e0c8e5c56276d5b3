//! What an exchange costs the thread of a gateway that keeps the cycle, without and with TLS, on a line in memory.

use std::collections::VecDeque;
use std::os::fd::BorrowedFd;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use pb3dp_allocation_count::{bytes, requests};
use pb3dp_arm_pa10::arm::{GatewayIdentity, KeyedLink, PinnedCertificate, TlsLink};
use pb3dp_arm_pa10_protocol::gateway_protocol::{Agreement, ArmId, SharedKey, Side};
use pb3dp_arm_pa10_test_support::tls::new_certificate;
use pb3dp_hal_platform::realtime::{Realtime, enter};
use pb3dp_hal_platform::tcp::TcpConfig;
use pb3dp_hal_platform::transport::{ByteLink, Unplugged};

use super::{COMMAND_BYTES, STATE_BYTES, p99};

const ROUNDS: u16 = 50_000;

const HANDSHAKES: usize = 500;

type Queue = Arc<Mutex<VecDeque<u8>>>;

/// One end of a line without a system call.
struct Memory {
    incoming: Queue,
    outgoing: Queue,
}

impl ByteLink for Memory {
    fn name(&self) -> &str {
        "memory"
    }
    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        let mut incoming = self.incoming.lock().unwrap();
        let count = incoming.len().min(buffer.len());
        buffer.iter_mut().zip(incoming.drain(..count)).for_each(|(to, from)| *to = from);
        Ok(count)
    }
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.outgoing.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }
    fn fd(&self) -> Option<BorrowedFd<'_>> {
        None
    }
}

fn line() -> [Memory; 2] {
    let (one, other) = (Queue::default(), Queue::default());
    let host = Memory { incoming: Arc::clone(&one), outgoing: Arc::clone(&other) };
    [host, Memory { incoming: other, outgoing: one }]
}

/// Host and gateway after the TLS handshake, and the time that it took at the gateway.
fn encrypted(identity: &GatewayIdentity, certificate: &PinnedCertificate) -> ([TlsLink<Memory>; 2], Duration) {
    let [host, gateway] = line();
    let tcp = TcpConfig { address: "127.0.0.1:1".parse().unwrap() };
    let mut time = Duration::ZERO;
    let mut host = certificate.connect(host, &tcp).unwrap();
    let mut gateway = identity.accept(gateway).unwrap();
    let mut is_open = false;
    while !is_open {
        host.advance_handshake().unwrap();
        let start = Instant::now();
        is_open = gateway.advance_handshake().unwrap();
        time += start.elapsed();
    }
    ([host, gateway], time)
}

fn keyed<L: ByteLink>([host, gateway]: [L; 2]) -> (KeyedLink<L>, KeyedLink<L>) {
    let agreement = Agreement::new(SharedKey::new(&[3; 32]).unwrap(), ArmId(1), [1; 32], [2; 32]);
    (KeyedLink::new(host, &agreement, Side::Host), KeyedLink::new(gateway, &agreement, Side::Gateway))
}

pub fn cost() {
    // The longest exchange shall be its own time, and not that of other programs.
    enter(&Realtime { priority: Some(10), locks_memory: false, cpu: None });
    let plain = measure("gateway, per exchange", keyed(line()));
    let (identity, certificate) = new_certificate();
    let (ends, _) = encrypted(&identity, &certificate);
    let us = measure("gateway, per exchange, with TLS", keyed(ends)) - plain;
    println!("TLS adds {us:.2} us = {:.3} % of 2 ms, {:.3} % of 10 ms", us / 20.0, us / 100.0);
    let mut times: Vec<f64> =
        (0..HANDSHAKES).map(|_| encrypted(&identity, &certificate).1.as_secs_f64() * 1e6).collect();
    times.sort_by(f64::total_cmp);
    println!("TLS handshake, gateway: median {:.0} us, p99 {:.0} us", times[times.len() / 2], p99(&times));
}

/// The gateway reads a COMMAND and writes a STATE; the median, microseconds.
fn measure<L: ByteLink>(name: &str, (mut host, mut gateway): (KeyedLink<L>, KeyedLink<L>)) -> f64 {
    let (command, state) = ([0x55; COMMAND_BYTES], [0x55; STATE_BYTES]);
    let mut buffer = [0; 512];
    let mut times = Vec::with_capacity(ROUNDS.into());
    let (mut allocations, mut allocated) = (0, 0);
    for _ in 0..ROUNDS {
        host.try_write(&command).unwrap();
        let (at, start) = ((requests(), bytes()), Instant::now());
        while gateway.try_read(&mut buffer).unwrap() > 0 {}
        gateway.try_write(&state).unwrap();
        times.push(start.elapsed().as_secs_f64() * 1e6);
        allocations += requests() - at.0;
        allocated += bytes() - at.1;
        while host.try_read(&mut buffer).unwrap() > 0 {}
    }
    times.sort_by(f64::total_cmp);
    let (median, max) = (times[times.len() / 2], times[times.len() - 1]);
    println!(
        "{name}: median {median:.2} us, p99 {:.2} us, max {max:.0} us; {:.1} allocations of {} bytes together",
        p99(&times),
        allocations as f64 / f64::from(ROUNDS),
        allocated / usize::from(ROUNDS)
    );
    median
}
