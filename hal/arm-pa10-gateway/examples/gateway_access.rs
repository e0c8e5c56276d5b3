//! Cost of the records against the cycle, and the answers of a gateway to its host with and without an attack, in one run:
//! `cargo run --release -p pb3dp-arm-pa10 --example gateway_access`. A number after `--` is the number of random strings that the
//! attacker sends; without it the attack has a fixed duration.
//!
//! Host and gateway have a priority of SCHED_FIFO if permitted, as on a rig; the attacker has none.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement")]

use std::hint::black_box;
use std::io::Write as _;
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::KeyedTcp;
use pb3dp_arm_pa10_gateway::bus::{BusPort, FrameSocket};
use pb3dp_arm_pa10_gateway::service::{BusOpener, GatewayServer, GatewayServerConfig, HostSide};
use pb3dp_arm_pa10_protocol::gateway_protocol::{Agreement, ArmId, Hello, HostMessage, OVERHEAD, SharedKey, Side};
use pb3dp_arm_pa10_test_support::world::{ARM, Emulation, asked_limits, gateway_config, home, keyed, ms, tcp_side};
use pb3dp_hal_platform::realtime::{Realtime, enter, now};
use pb3dp_hal_platform::transport::{ByteLink, Connector, wait};

/// Lengths of COMMAND and STATE with their envelopes.
const COMMAND_BYTES: usize = OVERHEAD + 29;
const STATE_BYTES: usize = OVERHEAD + 108;

/// Answers in each part of the measurement.
const ANSWERS: u32 = 400;

/// Parts without and with an attack, in turn.
const PARTS: usize = 3;

/// What the attacker does at present.
#[derive(Default)]
struct Attack {
    is_on: AtomicBool,
    is_over: AtomicBool,
    connections: AtomicU64,
    strings: AtomicU64,
}

fn main() {
    let strings = std::env::args().nth(1).map_or(0, |text| text.parse().unwrap());
    cost();
    let (side, address) = tcp_side();
    latency(side, &keyed(address), strings);
}

/// Time to seal and to open one frame, microseconds.
fn seal_and_open_us(bytes: usize) -> (f64, f64) {
    const ROUNDS: u32 = 50_000;
    let agreement = Agreement::new(SharedKey::new(&[3; 32]).unwrap(), ArmId(1), [1; 32], [2; 32]);
    let ((mut sealer, _), (_, mut opener)) = (agreement.records(Side::Host), agreement.records(Side::Gateway));
    let frame = vec![0x55; bytes];
    let (mut sealing, mut opening) = (Duration::ZERO, Duration::ZERO);
    for _ in 0..ROUNDS {
        let start = Instant::now();
        let record = sealer.seal(black_box(&frame));
        let sealed = Instant::now();
        opener.feed(&record, |frame| assert_eq!(black_box(frame.len()), bytes)).unwrap();
        sealing += sealed - start;
        opening += sealed.elapsed();
    }
    let us = |time: Duration| time.as_secs_f64() * 1e6 / f64::from(ROUNDS);
    (us(sealing), us(opening))
}

fn cost() {
    let (seal_command, open_command) = seal_and_open_us(COMMAND_BYTES);
    let (seal_state, open_state) = seal_and_open_us(STATE_BYTES);
    println!("COMMAND ({COMMAND_BYTES} bytes): seal {seal_command:.2} us, open {open_command:.2} us");
    println!("STATE ({STATE_BYTES} bytes): seal {seal_state:.2} us, open {open_state:.2} us");
    for (side, us) in [("gateway", open_command + seal_state), ("host", seal_command + open_state)] {
        println!("{side}, per exchange: {us:.2} us = {:.3} % of 2 ms, {:.3} % of 10 ms", us / 20.0, us / 100.0);
    }
}

fn latency(side: HostSide, host: &KeyedTcp, strings: u64) {
    let address = host.tcp.address;
    let (gateway, controller) = FrameSocket::pair("bus").unwrap();
    let emulation = Emulation::start(Box::new(controller), Some(ms(400)));
    let mut port = Some(gateway);
    let opener: BusOpener = Box::new(move || Ok(Box::new(port.take().ok_or("once")?) as Box<dyn BusPort>));
    // Before this thread has a priority, which its threads would inherit.
    let attack = Arc::new(Attack::default());
    let its_attack = Arc::clone(&attack);
    let attacker = std::thread::spawn(move || attack_on_command(address, &its_attack));
    let realtime = Realtime { priority: Some(20), locks_memory: false, cpu: None };
    for missing in enter(&Realtime { priority: Some(10), ..realtime }) {
        println!("{missing}");
    }
    let server =
        GatewayServer::start(GatewayServerConfig { gateway: gateway_config(), realtime }, opener, side).unwrap();
    let mut owner = host.clone().connect().unwrap();
    let mut sequence = 0;
    let hello = Hello { cycle_us: 10_000, limits: asked_limits() };
    ask(owner.as_mut(), &HostMessage::Hello(hello), &mut sequence);
    let (mut calm, mut attacked) = (Vec::new(), Vec::new());
    let mut part = 0;
    while part < PARTS || attack.strings.load(Ordering::SeqCst) < strings {
        part += 1;
        if part <= PARTS {
            answers(owner.as_mut(), &mut sequence, &mut calm);
        }
        attack.is_on.store(true, Ordering::SeqCst);
        answers(owner.as_mut(), &mut sequence, &mut attacked);
        attack.is_on.store(false, Ordering::SeqCst);
    }
    attack.is_over.store(true, Ordering::SeqCst);
    attacker.join().unwrap();
    show("without attack", &mut calm);
    show("under attack", &mut attacked);
    println!(
        "{} connections of the attacker, {} random strings; p99 {:.2} times",
        attack.connections.load(Ordering::SeqCst),
        attack.strings.load(Ordering::SeqCst),
        p99(&attacked) / p99(&calm)
    );
    let observed = emulation.observed();
    assert!(observed.is_braked && observed.position_rad == home(), "the arm moved, or its brakes opened");
    drop(server);
}

fn ask(link: &mut dyn ByteLink, message: &HostMessage, sequence: &mut u16) -> Duration {
    let start = Instant::now();
    link.try_write(&message.frame(ARM, *sequence, now().as_nanos() / 1000).encode()).unwrap();
    *sequence = sequence.wrapping_add(1);
    let mut buffer = [0; 512];
    while link.try_read(&mut buffer).unwrap() == 0 {
        wait(Some(&*link), false, None, ms(50));
    }
    start.elapsed()
}

fn answers(link: &mut dyn ByteLink, sequence: &mut u16, into: &mut Vec<f64>) {
    for _ in 0..ANSWERS {
        into.push(ask(link, &HostMessage::Heartbeat, sequence).as_secs_f64() * 1e6);
        std::thread::sleep(ms(5));
    }
}

/// Opens connections as fast as one thread can: HTTP, half-open sockets, a frame without its end, and mostly random strings.
fn attack_on_command(address: SocketAddr, attack: &Attack) {
    let (mut open, mut count, mut state) = (Vec::new(), 0u64, 1u64);
    let mut random = [0u8; 200];
    while !attack.is_over.load(Ordering::SeqCst) {
        if !attack.is_on.load(Ordering::SeqCst) {
            open.clear();
            std::thread::sleep(ms(1));
            continue;
        }
        let Ok(mut stream) = TcpStream::connect_timeout(&address, ms(100)) else { continue };
        stream.set_nonblocking(true).unwrap();
        count += 1;
        attack.connections.store(count, Ordering::SeqCst);
        let bytes: &[u8] = match count % 20 {
            0 => b"GET / HTTP/1.1\r\n\r\n",
            1 => &[],
            2 => &[0xA5, 0x5A, 1],
            _ => {
                // xorshift64 (Marsaglia 2003).
                for byte in &mut random {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    *byte = state as u8;
                }
                attack.strings.fetch_add(1, Ordering::SeqCst);
                &random[..1 + state as usize % (random.len() - 1)]
            }
        };
        stream.write_all(bytes).ok();
        open.push(stream);
        if open.len() > 200 {
            open.drain(..100);
        }
    }
}

fn p99(sorted: &[f64]) -> f64 {
    sorted[sorted.len() * 99 / 100]
}

fn show(name: &str, latencies_us: &mut [f64]) {
    latencies_us.sort_by(f64::total_cmp);
    let (median, p99) = (latencies_us[latencies_us.len() / 2], p99(latencies_us));
    let max = latencies_us[latencies_us.len() - 1];
    println!("{name}: median {median:.0} us, p99 {p99:.0} us, max {max:.0} us of {} answers", latencies_us.len());
}
