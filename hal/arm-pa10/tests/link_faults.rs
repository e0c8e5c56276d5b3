//! All faults of a line, in virtual time: tolerated faults are counted, others stop the arm in time.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, DriverState, FaultCause, Request, Trip};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_test_support::link_rig::{CYCLE, Line, Rig, TICK, Way, good_line, ms, velocity};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

fn rig() -> Rig {
    Rig::new(WireFormat::BigEndian6x10)
}

/// Follows commands for this time, or until the driver refuses them.
fn follow(rig: &mut Rig, time: Duration) {
    let end = rig.now + time;
    while rig.now < end && (rig.driver.state(), rig.driver.activity()) == (DriverState::Moving, Activity::None) {
        if rig.driver.handle_request(rig.now, Request::Move(velocity())).is_err() {
            return;
        }
        rig.run(CYCLE);
    }
}

/// Fault of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Harm {
    Drop,
    Corrupt,
    Truncate,
    Delay,
    Duplicate,
    Garbage,
    WrongArm,
    WrongSequence,
}

const HARMS: [Harm; 8] = [
    Harm::Drop,
    Harm::Corrupt,
    Harm::Truncate,
    Harm::Delay,
    Harm::Duplicate,
    Harm::Garbage,
    Harm::WrongArm,
    Harm::WrongSequence,
];

impl Harm {
    /// Whether the frame is lost.
    fn costs_the_frame(self) -> bool {
        !matches!(self, Self::Duplicate | Self::Garbage)
    }

    fn apply(self, bytes: Vec<u8>) -> Vec<(Duration, Vec<u8>)> {
        let usual = ms(2);
        match self {
            Self::Drop => Vec::new(),
            Self::Corrupt => vec![(usual, changed(bytes, 20))],
            Self::Truncate => vec![(usual, bytes[..bytes.len() / 2].to_vec())],
            Self::Delay => vec![(ms(14), bytes)],
            Self::Duplicate => vec![(usual, bytes.clone()), (ms(4), bytes)],
            Self::Garbage => vec![(usual, [vec![0xA5, 0x5A, 1, 2, 0x82, 108, 0, 0], bytes].concat())],
            Self::WrongArm => vec![(usual, signed(changed(bytes, 3)))],
            Self::WrongSequence => vec![(usual, signed(changed(bytes, 7)))],
        }
    }
}

fn changed(mut bytes: Vec<u8>, at: usize) -> Vec<u8> {
    bytes[at] ^= 0x11;
    bytes
}

/// With recomputed checksums: a valid frame with wrong content. The checksums are computed bit by bit, as the specification of
/// the protocol describes them.
fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
    let crc = |data: &[u8], width: u32, polynomial: u32, initial: u32| {
        let top = 1u32 << (width - 1);
        data.iter().fold(initial, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte) << (width - 8), |crc, _| {
                let shifted = crc << 1 & ((top << 1) - 1);
                if crc & top != 0 { shifted ^ polynomial } else { shifted }
            })
        })
    };
    bytes[16] = (crc(&bytes[2..16], 8, 0x2F, 0xFF) ^ 0xFF) as u8;
    let end = bytes.len() - 2;
    let check = crc(&bytes[2..end], 16, 0x1021, 0xFFFF) as u16;
    bytes[end..].copy_from_slice(&check.to_le_bytes());
    bytes
}

/// Applies the fault to this number of answers in a row, then to none.
fn harm_answers(harm: Harm, count: u32) -> Line {
    let mut left = count;
    let mut good = good_line();
    Box::new(move |way, bytes| {
        if way == Way::ToHost && left > 0 && !bytes.is_empty() {
            left -= 1;
            return harm.apply(bytes);
        }
        good(way, bytes)
    })
}

#[test]
fn two_harmed_answers_in_a_row_are_tolerated_and_counted() {
    for harm in HARMS.into_iter().filter(|harm| *harm != Harm::WrongArm) {
        let mut rig = rig();
        rig.lead_to_moving();
        let before = *rig.driver.counters();
        rig.line = harm_answers(harm, 2);
        follow(&mut rig, ms(300));
        assert_eq!(rig.driver.state(), DriverState::Moving, "{harm:?}: {:?}", rig.driver.latched());
        let after = rig.driver.counters();
        let lost = after.lost - before.lost;
        assert_eq!(lost, if harm.costs_the_frame() { 2 } else { 0 }, "{harm:?}");
        let noticed = (after.damaged - before.damaged) + (after.late - before.late) + lost;
        assert!(noticed >= 2, "{harm:?}: {after:?}");
    }
}

#[test]
fn three_harmed_answers_in_a_row_stop_the_arm_within_30_ms() {
    for harm in HARMS.into_iter().filter(|harm| harm.costs_the_frame()) {
        let mut rig = rig();
        rig.lead_to_moving();
        // The next exchange begins one cycle after this one.
        let sent = rig.driver.counters().sent;
        while rig.driver.counters().sent == sent {
            rig.run(TICK);
        }
        let from = rig.now - TICK + CYCLE;
        rig.line = harm_answers(harm, 3);
        follow(&mut rig, ms(300));
        let latched = *rig.driver.latched().unwrap_or_else(|| panic!("{harm:?} did not stop the arm"));
        match harm {
            Harm::WrongArm => assert_eq!(latched.trip, Trip::Fault(FaultCause::WrongArm { got: 2 ^ 0x11 })),
            _ => assert_eq!(latched.trip, Trip::Fault(FaultCause::LinkLost { misses: 3 }), "{harm:?}"),
        }
        let after = latched.at.saturating_since(from);
        assert!(after <= ms(30), "{harm:?}: {after:?}");
        rig.settle();
        assert_eq!(rig.gateway.speeds.amax(), 0.0, "{harm:?}");
    }
}

#[test]
fn an_answer_that_took_longer_holds_an_older_measurement() {
    let mut rig = rig();
    rig.lead_to_moving();
    follow(&mut rig, ms(200));
    let mut good = good_line();
    rig.line = Box::new(move |way, bytes| if way == Way::ToHost { vec![(ms(8), bytes)] } else { good(way, bytes) });
    follow(&mut rig, ms(200));
    let mut least = Duration::MAX;
    for _ in 0..20 {
        rig.run(TICK);
        least = least.min(rig.now.saturating_since(rig.driver.joints().unwrap().at));
    }
    // 6 ms more than the quickest answers, because the link cannot distinguish their delay from the clock offset, and 0.1 ms at
    // the gateway.
    assert!(least >= Duration::from_micros(6_100) && least <= ms(7), "{least:?}");
}

/// The gateway reports a completed operation as done, so every message can be repeated.
#[test]
fn one_lost_answer_anywhere_on_the_way_up_and_down_is_tolerated() {
    for lost in 0..170 {
        let mut rig = rig();
        let (mut count, mut good) = (0, good_line());
        rig.line = Box::new(move |way, bytes| {
            count += u32::from(way == Way::ToHost);
            if way == Way::ToHost && count == lost + 1 { Vec::new() } else { good(way, bytes) }
        });
        rig.lead_to_moving();
        rig.request(Request::Stop);
        rig.settle();
        assert_eq!(rig.driver.state(), DriverState::Connected, "{lost}: {:?}", rig.driver.latched());
        assert_eq!(rig.driver.counters().lost, 1, "{lost}");
        assert!(rig.gateway.rejected.is_empty(), "{lost}: {:?}", rig.gateway.rejected);
    }
}

/// 10 minutes at 100 Hz with 1 % of the exchanges lost, never three in a row: no fault.
#[test]
fn one_lost_exchange_in_a_hundred_is_no_fault() {
    for way in [Way::ToGateway, Way::ToHost] {
        let mut rig = rig();
        rig.lead_to_moving();
        let before = *rig.driver.counters();
        let mut rng = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
        let mut row = 0;
        let mut good = good_line();
        rig.line = Box::new(move |this_way, bytes| {
            if this_way == way {
                let lost = rng.next_u32().is_multiple_of(100) && row < 2;
                row = if lost { row + 1 } else { 0 };
                if lost {
                    return Vec::new();
                }
            }
            good(this_way, bytes)
        });
        follow(&mut rig, Duration::from_secs(600));
        assert_eq!(rig.driver.state(), DriverState::Moving, "{:?}", rig.driver.latched());
        let lost = rig.driver.counters().lost - before.lost;
        assert!((450..750).contains(&lost), "{way:?}: {lost} of 60000");
    }
}

/// Any combination of faults in both directions: no panic, the gateway receives a message that its table refuses only if a fault
/// caused it, and a stop ends the sequence.
#[test]
fn any_mixture_of_harm_ends_in_a_stop() {
    let harms = prop::collection::vec((0usize..16, any::<bool>()), 1..200);
    let mut runner = TestRunner::new(Config { failure_persistence: None, ..Config::with_cases(100) });
    let result = runner.run(&harms, |harms| {
        let mut rig = rig();
        rig.lead_to_moving();
        let mut plan = harms.into_iter();
        let mut good = good_line();
        rig.line = Box::new(move |way, bytes| {
            let harmed = plan.next().and_then(|(harm, to_host)| Some((*HARMS.get(harm)?, to_host)));
            match harmed {
                Some((harm, to_host)) if to_host == (way == Way::ToHost) && !bytes.is_empty() => harm.apply(bytes),
                _ => good(way, bytes),
            }
        });
        follow(&mut rig, ms(1500));
        rig.line = good_line();
        prop_assert_eq!(rig.driver.handle_request(rig.now, Request::Stop), Ok(()));
        rig.run(Duration::from_secs(3));
        prop_assert_eq!(rig.driver.activity(), Activity::None);
        prop_assert!(matches!(rig.driver.state(), DriverState::Connected | DriverState::Fault | DriverState::EStop));
        prop_assert_eq!(rig.gateway.speeds.amax(), 0.0);
        Ok(())
    });
    assert_eq!(result, Ok(()));
}
