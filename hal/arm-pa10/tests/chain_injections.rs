//! Faults at random times, through the gateway: host, line, bus and arm fail, and the true joints stop in time.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverState, Request};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Frame, FrameParser, Received};
use pb3dp_arm_pa10_test_support::chain::{ARM, Chain, Spoil, Way};
use pb3dp_arm_pa10_test_support::injection::{
    Braking, Dice, Stop, braking_time, controller_alarm, joints, last_motion, servo_alarm, table_line,
};

/// Which part detects the fault, and the permitted time until the arm begins to brake.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Finder {
    /// The gateway on the bus: three cycles, or a status word.
    Gateway,
    /// The host watchdog of the gateway: at 50 ms the arm is stationary.
    HostWatchdog,
    /// The host: three answers of 10 ms.
    Host,
}

impl Finder {
    /// R3 and R4.
    fn time(self) -> Duration {
        Duration::from_millis(match self {
            Self::Gateway => 0,
            Self::HostWatchdog => 50,
            Self::Host => 30,
        })
    }
}

/// Beginning and end of a fault.
enum Fault {
    /// At the controller.
    Arm(fn(&mut Dice) -> String, &'static str),
    /// The controller receives nothing for up to a second, and has no time-out: the arm stops in time after that.
    DeafForAWhile,
    /// On the line between host and gateway.
    Line(fn(u32) -> Spoil),
    /// The link is lost, and both sides detect it.
    Unplugged,
    /// The host process is frozen.
    Frozen,
}

struct Kind {
    name: &'static str,
    fault: Fault,
    finder: Finder,
    braking: Braking,
}

fn kinds() -> Vec<Kind> {
    use Braking::{Brakes, Servos};
    use Finder::{Gateway, Host, HostWatchdog};
    let other = |name, fault, finder, braking| Kind { name, fault, finder, braking };
    let arm = |name, begin, end, braking| other(name, Fault::Arm(begin, end), Gateway, braking);
    let line = |name, spoil, finder| other(name, Fault::Line(spoil), finder, Servos);
    vec![
        arm("bus: drop", |_| "drop 1000000".into(), "drop 0", Servos),
        arm("bus: delay", |dice| format!("delay 1000000 {}us", 6500 + dice.below(60_000)), "delay 0 0s", Servos),
        arm("bus: truncate", |_| "truncate 1000000".into(), "truncate 0", Servos),
        arm("bus: wrong-sequence", |_| "wrong-sequence 1000000".into(), "wrong-sequence 0", Servos),
        arm("bus: wrong-letter", |_| "wrong-letter 1000000".into(), "wrong-letter 0", Servos),
        arm("bus: wrong-node", |_| "wrong-node 1000000".into(), "wrong-node 0", Servos),
        arm("bus: silence", |_| "silence on".into(), "silence off", Servos),
        arm("bus: deaf", |_| "deaf 1000000".into(), "deaf 0", Servos),
        other("bus: deaf for a while, nobody watches", Fault::DeafForAWhile, Gateway, Brakes),
        arm("arm: power", |_| "power off".into(), "power on", Brakes),
        arm("arm: time-out", |_| "time-out".into(), "drop 0", Servos),
        arm("arm: e-stop", |_| "e-stop press".into(), "e-stop release", Brakes),
        arm("arm: limit-switch", |_| "limit-switch open".into(), "limit-switch close", Servos),
        arm("arm: alarm", |dice| servo_alarm(dice, ""), "", Brakes),
        arm("arm: alarm reported", |dice| servo_alarm(dice, " reported"), "", Servos),
        arm("arm: controller-alarm", |dice| controller_alarm(dice, " reported"), "controller-alarm off", Servos),
        line("line: dead both ways", |_| Box::new(|_, _| vec![]), HostWatchdog),
        line("line: dead to the gateway", |_| one_way(Way::ToGateway, |_, _| vec![]), HostWatchdog),
        line("line: dead to the host", |_| one_way(Way::ToHost, |_, _| vec![]), Host),
        line(
            "line: corrupt",
            |seed| {
                spoiled(seed, |dice, mut bytes| {
                    let at = dice.below(bytes.len());
                    bytes[at] ^= 1 << dice.below(8);
                    vec![(Duration::ZERO, bytes)]
                })
            },
            HostWatchdog,
        ),
        line(
            "line: truncate",
            |seed| {
                spoiled(seed, |dice, mut bytes| {
                    bytes.truncate(dice.below(bytes.len()));
                    vec![(Duration::ZERO, bytes)]
                })
            },
            HostWatchdog,
        ),
        line("line: late to the host", |_| one_way(Way::ToHost, |_, bytes| late(25, bytes)), Host),
        line("line: late to the gateway", |_| one_way(Way::ToGateway, |_, bytes| late(70, bytes)), HostWatchdog),
        line(
            "line: answers of another arm",
            |_| one_way(Way::ToHost, |_, bytes| vec![(Duration::ZERO, readdressed(&bytes))]),
            Host,
        ),
        line(
            "line: commands for another arm",
            |_| one_way(Way::ToGateway, |_, bytes| vec![(Duration::ZERO, readdressed(&bytes))]),
            HostWatchdog,
        ),
        other("line: unplugged", Fault::Unplugged, Gateway, Servos),
        other("host: frozen", Fault::Frozen, HostWatchdog, Servos),
    ]
}

fn late(by_ms: u64, bytes: Vec<u8>) -> Vec<(Duration, Vec<u8>)> {
    vec![(Duration::from_millis(by_ms), bytes)]
}

type Change = fn(&mut Dice, Vec<u8>) -> Vec<(Duration, Vec<u8>)>;

fn spoiled(seed: u32, change: Change) -> Spoil {
    let mut dice = Dice { seed, count: 0 };
    Box::new(move |_, bytes| change(&mut dice, bytes))
}

fn one_way(way: Way, change: Change) -> Spoil {
    let mut dice = Dice { seed: 0, count: 0 };
    Box::new(move |of, bytes| if of == way { change(&mut dice, bytes) } else { vec![(Duration::ZERO, bytes)] })
}

/// A valid frame with the number of another arm.
fn readdressed(bytes: &[u8]) -> Vec<u8> {
    let mut found = None;
    FrameParser::new(ARM).feed(bytes, |received| found = Some(received));
    let Some(Received::Frame(frame)) = found else { return bytes.to_vec() };
    Frame { arm: ArmId(ARM.0 + 1), ..frame }.encode().as_slice().to_vec()
}

fn move_about(chain: &mut Chain, dice: &mut Dice, time: Duration) {
    let end = chain.now + time;
    while chain.now < end {
        let position = chain.plant.lock().unwrap().state().position_rad;
        chain.wanted = Some(dice.velocity(&position));
        chain.next_host_cycle = chain.next_host_cycle.max(chain.now);
        let piece = Duration::from_millis(40 + dice.below(100) as u64);
        chain.run(piece.min(end.saturating_since(chain.now)));
    }
}

/// One injection: the time until the arm is stationary, and the permitted time.
fn inject(chain: &mut Chain, kind: &Kind, dice: &mut Dice) -> [Duration; 2] {
    chain.prepare();
    let moving_for = Duration::from_micros(50_000 + dice.below(250_000) as u64);
    move_about(chain, dice, moving_for);
    assert_eq!(chain.driver.state(), DriverState::Moving, "{}: before it, {:?}", kind.name, chain.driver.latched());
    let mut at = chain.now;
    if matches!(kind.fault, Fault::DeafForAWhile) {
        chain.inject("deaf 1000000");
        chain.run(Duration::from_micros(10_000 + dice.below(990_000) as u64));
        chain.inject("deaf 0");
        at = chain.now;
    }
    let velocity = chain.plant.lock().unwrap().state().velocity_rad_per_s.abs();
    let commanded = chain.controller.commanded_rad_per_s().abs();
    let wanted = chain.wanted.map_or(commanded, |wanted| wanted.abs());
    let fastest = velocity.sup(&wanted).sup(&commanded);
    let mut end = String::new();
    match &kind.fault {
        Fault::Arm(begin, ends) => {
            let line = begin(dice);
            end = match line.split_whitespace().collect::<Vec<_>>()[..] {
                ["alarm", axis, ..] => format!("alarm {axis} off"),
                _ => (*ends).to_owned(),
            };
            chain.inject(&line);
        }
        Fault::DeafForAWhile => {}
        Fault::Line(spoil) => chain.spoil = Some(spoil(dice.seed + dice.count)),
        Fault::Unplugged => {
            chain.spoil = Some(Box::new(|_, _| vec![]));
            chain.driver.handle_unplugged(chain.now);
            chain.gateway.handle_host_gone(chain.now);
        }
        Fault::Frozen => chain.frozen = true,
    }
    chain.run(Duration::from_millis(800));
    let took = last_motion(&chain.plant, at).saturating_since(at);
    let place = format!("{} at {at:?}, seed {}", kind.name, dice.seed);
    assert!(chain.is_at_rest() && chain.controller.is_braked(), "{place}: {:?}", chain.gateway.status());
    chain.frozen = false;
    chain.run(Duration::from_millis(1000));
    assert!(chain.driver.state().is_latched(), "{place}: {:?}", chain.driver.state());
    chain.wanted = None;
    chain.spoil = None;
    if !end.is_empty() {
        chain.inject(&end);
    }
    chain.run(Duration::from_millis(200));
    assert!(chain.driver.state().is_latched() && chain.controller.is_braked(), "{place}: it went by itself");
    chain.open();
    chain.request(Request::Reset);
    chain.settle();
    assert_eq!(chain.driver.state(), DriverState::Connected, "{place}: {:?}", chain.driver.latched());
    [took, braking_time(kind.braking, &fastest) + kind.finder.time() + Duration::from_millis(20)]
}

const INJECTIONS_PER_KIND: u32 = 24;

#[test]
fn whatever_fails_between_host_and_arm_the_arm_comes_to_rest_in_time() {
    for (index, kind) in kinds().iter().enumerate() {
        let mut stops = Vec::new();
        let mut dice = Dice { seed: 5000 + 10 * index as u32, count: 0 };
        // If messages do not arrive, only the controller can stop the arm; otherwise its watchdog is not needed.
        let watchdog = (kind.name == "bus: deaf").then(|| Duration::from_millis(6));
        let mut chain = Chain::new(WireFormat::BigEndian6x10, watchdog, joints());
        for injection in 0..INJECTIONS_PER_KIND {
            let [took, allowed] = inject(&mut chain, kind, &mut dice);
            assert!(took <= allowed, "{} {injection}: {took:?} to rest, {allowed:?} allowed", kind.name);
            stops.push(Stop { took, allowed });
        }
        println!("{}", table_line(kind.name, &stops));
    }
}

/// With a controller without a watchdog, and with one whose watchdog permits a cycle of 2 ms.
#[test]
fn a_gateway_moves_the_emulated_arm() {
    for format in WireFormat::ALL {
        for watchdog in [None, Some(Duration::from_millis(6))] {
            let mut chain = Chain::new(format, watchdog, joints());
            chain.prepare();
            let mut dice = Dice { seed: 9, count: 0 };
            let before = chain.plant.lock().unwrap().state().position_rad;
            move_about(&mut chain, &mut dice, Duration::from_secs(3));
            assert_eq!(chain.driver.state(), DriverState::Moving, "{:?}", chain.driver.latched());
            assert!((chain.plant.lock().unwrap().state().position_rad - before).amax() > 0.05);
            chain.wanted = None;
            chain.request(Request::Stop);
            chain.settle();
            chain.run(Duration::from_millis(300));
            assert_eq!(chain.driver.state(), DriverState::Connected);
            assert!(chain.controller.is_braked() && chain.is_at_rest());
            let counters = chain.controller.counters();
            assert_eq!(
                [counters.forbidden, counters.malformed, counters.odd, counters.released, counters.watchdog_trips],
                [0; 5]
            );
        }
    }
}

/// At most two lost replies in a row, late replies within the cycle, repeated and overtaken ones, and words that only inform.
#[test]
fn what_is_tolerated_leads_to_no_fault() {
    for line in [
        "drop 2",
        "delay 1000 1500us",
        "slow 1500us",
        "duplicate 1000",
        "reorder 8",
        "truncate 2",
        "wrong-sequence 2",
        "wrong-letter 2",
        "wrong-node 2",
        "teaching-switch on",
        "power-temperature high",
        "torque 3 -40Nm",
    ] {
        let mut dice = Dice { seed: 77, count: 0 };
        for _ in 0..4 {
            let mut chain = Chain::new(WireFormat::BigEndian6x10, Some(Duration::from_millis(6)), joints());
            chain.prepare();
            let moving_for = Duration::from_micros(50_000 + dice.below(50_000) as u64);
            move_about(&mut chain, &mut dice, moving_for);
            chain.inject(line);
            move_about(&mut chain, &mut dice, Duration::from_millis(500));
            assert_eq!(chain.driver.state(), DriverState::Moving, "{line}: {:?}", chain.driver.latched());
            assert_eq!(chain.controller.counters().watchdog_trips, 0, "{line}");
        }
    }
}

/// 1 % of the replies on the bus and of the frames on the line lost, never three in a row, over 10 simulated minutes.
#[test]
fn one_percent_of_losses_everywhere_is_no_fault() {
    let mut chain = Chain::new(WireFormat::BigEndian6x10, Some(Duration::from_millis(6)), joints());
    chain.prepare();
    chain.inject("chance 1% at-most 2 drop 1");
    let mut dice = Dice { seed: 40, count: 0 };
    let mut in_a_row = 0;
    // A frame lost in either direction is one lost answer.
    chain.spoil = Some(Box::new(move |way, bytes| {
        let lost = dice.unit() < 0.005 && in_a_row < 2;
        if lost {
            in_a_row += 1;
        } else if way == Way::ToHost {
            in_a_row = 0;
        }
        if lost { vec![] } else { vec![(Duration::ZERO, bytes)] }
    }));
    let mut motion = Dice { seed: 41, count: 0 };
    let end = chain.now + Duration::from_secs(600);
    while chain.now < end {
        move_about(&mut chain, &mut motion, Duration::from_secs(1));
        assert_eq!(chain.driver.state(), DriverState::Moving, "{:?}", chain.driver.latched());
    }
    let lost = chain.driver.counters().lost;
    assert!((450..750).contains(&lost), "{lost}");
}
