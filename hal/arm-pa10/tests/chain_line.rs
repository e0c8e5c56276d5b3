//! A gateway that reads slowly, and clocks that jump: nothing moves on stale commands, and a stop names its cause.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverState, Request};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, StopCause};
use pb3dp_arm_pa10_test_support::chain::Chain;
use pb3dp_arm_pa10_test_support::injection::{Braking, Dice, braking_time, joints, last_motion};
use pb3dp_kinematics::JointVector;

/// Detection times: three answers of 10 ms by the host, a command of 50 ms by the gateway.
const NOTICED: Duration = Duration::from_millis(50);

/// Maximum duration of the driver's stop order and of the closing of the brakes.
const STOPPED: Duration = Duration::from_millis(800);

fn wanted() -> JointVector {
    JointVector::from([0.1, -0.2, 0.1, 0.2, 0.3, -0.2, 0.3])
}

fn moving() -> Chain {
    // The controller has no watchdog.
    let mut chain = Chain::new(WireFormat::BigEndian6x10, None, joints());
    // The clocks start late, so that a jump back by hours does not fall below zero.
    chain.inject("line host-clock 200000s");
    chain.inject("line gateway-clock 200000s");
    chain.prepare();
    chain.wanted = Some(wanted());
    chain.next_host_cycle = chain.now;
    chain.run(Duration::from_millis(300));
    assert_eq!(chain.driver.state(), DriverState::Moving, "{:?}", chain.driver.latched());
    chain
}

/// Host and gateway exchange about 5000 bytes per second.
const RATES: [u32; 10] = [0, 1, 50, 500, 2000, 4000, 4500, 4700, 4800, 100_000];

/// The host commands another velocity and then zero: the motion of the arm shows the age of the commands that it follows.
#[test]
fn a_gateway_that_reads_slowly_moves_nothing_on_stale_commands() {
    let mut stopped = 0;
    for rate in RATES {
        let place = format!("{rate} bytes per second");
        let mut chain = moving();
        chain.inject(&format!("line slow-reader {rate}B/s"));
        let took = time_to_rest(&mut chain);
        if chain.driver.state() == DriverState::Moving {
            // The gateway reads fast enough: it follows new commands.
            assert!(rate > 4000, "{place}");
            chain.wanted = Some(JointVector::zeros());
            let at = chain.now;
            chain.run(Duration::from_millis(500));
            let took = last_motion(&chain.plant, at).saturating_since(at);
            let allowed = braking_time(Braking::Servos, &wanted().abs()) + NOTICED;
            assert!(took <= allowed, "{place}: {took:?} to rest, {allowed:?} allowed");
            continue;
        }
        stopped += 1;
        // A rate that is slightly too low is detected later.
        let allowed = Duration::from_millis(if rate <= 500 { 120 } else { 700 });
        assert!(took <= allowed, "{place}: {took:?} to rest, {allowed:?} allowed");
        assert!(chain.driver.state().is_latched() && chain.driver.latched().is_some(), "{place}");
        assert!(chain.is_at_rest() && chain.controller.is_braked(), "{place}: {:?}", chain.gateway.status());
        // The gateway reads the waiting bytes, and does not act on them.
        let before = chain.plant.lock().unwrap().state().position_rad;
        chain.inject("line slow-reader off");
        chain.run(Duration::from_millis(500));
        assert!(chain.unread.is_empty());
        let way = (chain.plant.lock().unwrap().state().position_rad - before).amax();
        assert!(way < 1e-3 && chain.controller.is_braked(), "{place}: {way}");
        chain.wanted = None;
        chain.open();
        chain.request(Request::Reset);
        chain.settle();
        assert_eq!(chain.driver.state(), DriverState::Connected, "{place}: {:?}", chain.driver.latched());
    }
    assert!(stopped >= 6, "{stopped}");
}

/// Runs for 3 s; returns the time of the last motion of the joints.
fn time_to_rest(chain: &mut Chain) -> Duration {
    let (begin, step) = (chain.now, Duration::from_millis(10));
    let mut last = begin;
    while chain.now < begin + Duration::from_secs(3) {
        chain.run(step);
        if !chain.is_at_rest() {
            last = chain.now;
        }
    }
    last.saturating_since(begin)
}

/// After a jump the arm follows its commands within the watchdog's time, or is stopped and latched with a cause.
fn judge(chain: &mut Chain, place: &str) -> bool {
    for turn in 0..40 {
        let velocity = if turn % 2 == 0 { -wanted() } else { wanted() };
        chain.wanted = chain.wanted.map(|_| velocity);
        chain.run(Duration::from_millis(300));
        let commanded = chain.controller.commanded_rad_per_s();
        match chain.driver.state() {
            // The measured velocity is compared with the command of 0.3 s ago.
            DriverState::Moving => assert!((commanded - velocity).amax() < 0.02, "{place}: {commanded:?}"),
            state => {
                assert!(state.is_latched() && chain.driver.latched().is_some(), "{place}: {state:?}");
                break;
            }
        }
    }
    if chain.driver.state() == DriverState::Moving {
        chain.wanted = None;
        chain.request(Request::Stop);
        chain.settle();
        chain.run(Duration::from_millis(300));
        assert!(chain.is_at_rest() && chain.controller.is_braked(), "{place}");
        return true;
    }
    chain.wanted = None;
    chain.run(STOPPED);
    assert!(chain.is_at_rest() && chain.controller.is_braked(), "{place}: {:?}", chain.gateway.status());
    let before = chain.plant.lock().unwrap().state().position_rad;
    chain.run(Duration::from_secs(12));
    assert!((chain.plant.lock().unwrap().state().position_rad - before).amax() < 1e-3, "{place}: moves by itself");
    false
}

const JUMPS: [&str; 14] = [
    "1ms", "-1ms", "15ms", "-15ms", "300ms", "-300ms", "5s", "-3s", "3600s", "-3600s", "90000s", "-90000s", "1e8s",
    "-1e8s",
];

/// Forwards and backwards, by milliseconds up to more than the range of the clock, which then wraps around.
#[test]
fn a_clock_that_jumps_moves_nothing_on_stale_commands() {
    for side in ["host-clock", "gateway-clock"] {
        for jump in JUMPS {
            let place = format!("{side} {jump}");
            let mut chain = moving();
            chain.inject(&format!("line {side} {jump}"));
            let goes_on = judge(&mut chain, &place);
            assert!(goes_on || !jump.ends_with("1ms"), "{place}: {:?}", chain.driver.latched());
            println!("{place}: {}", if goes_on { "goes on" } else { "stops" });
            if !goes_on {
                chain.open();
                chain.request(Request::Reset);
                chain.settle();
                assert_eq!(chain.driver.state(), DriverState::Connected, "{place}: {:?}", chain.driver.latched());
            }
        }
    }
}

/// The gateway refuses a command whose timestamp is too old, and the arm stops as after a lost host.
#[test]
fn a_host_whose_clock_jumps_back_is_not_followed() {
    let mut chain = moving();
    let at = chain.now;
    let fastest = chain.plant.lock().unwrap().state().velocity_rad_per_s.abs().sup(&wanted().abs());
    chain.inject("line host-clock -2s");
    chain.run(Duration::from_millis(700));
    let status = chain.gateway.status();
    // The host, whose commands are refused, may report the fault before the gateway detects silence.
    assert!(matches!(status.cause, StopCause::HostSilent | StopCause::HostFault), "{status:?}");
    assert_eq!(status.state, GatewayState::Fault);
    let took = last_motion(&chain.plant, at).saturating_since(at);
    let allowed = braking_time(Braking::Servos, &fastest) + NOTICED + Duration::from_millis(20);
    assert!(took <= allowed, "{took:?} to rest, {allowed:?} allowed");
    assert!(chain.driver.state().is_latched());
}

/// Clocks that jump repeatedly at random times.
#[test]
fn clocks_that_jump_by_chance_never_let_an_arm_run_away() {
    let mut stopped = 0;
    for seed in 0..6 {
        let mut chain = moving();
        let mut dice = Dice { seed, count: 0 };
        for side in ["host-clock", "gateway-clock"] {
            let jump = (dice.unit() - 0.5) * 7200.0;
            chain.inject(&format!("chance 0.5% at-most 1 line {side} {jump:.3}s"));
        }
        stopped += u32::from(!judge(&mut chain, &format!("seed {seed}")));
    }
    assert!(stopped > 0, "no clock has jumped far enough to be noticed");
}
