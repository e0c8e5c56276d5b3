//! Invariants of the driver for any sequence of events.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, BadReply, DriverState, Request};
use pb3dp_arm_pa10_protocol::codec::{CommAlarm, CommWord, ServoAlarm, ServoWord};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, Kind, kind, velocity};
use proptest::prelude::*;

/// An event for the driver.
#[derive(Clone, Copy, Debug)]
enum Happening {
    Request(Request),
    MoveFor(u64),
    Wait(u64),
    Stall(u64),
    Drop(u32),
    Silence(bool),
    Servo(usize, u16),
    Comm(u16),
    Bad,
    Unplugged,
    WrongArm,
}

fn happenings() -> impl Strategy<Value = Happening> {
    let request = prop_oneof![
        Just(Request::Connect),
        Just(Request::Enable),
        Just(Request::ReleaseBrakes),
        Just(Request::Move(velocity())),
        Just(Request::Hold),
        Just(Request::Stop),
        Just(Request::Reset),
        Just(Request::Disconnect),
    ];
    let alarm = prop_oneof![
        3 => Just(0u16),
        1 => proptest::sample::select(ServoAlarm::LISTED.to_vec()).prop_map(|alarm| ServoWord(0).with_alarm(alarm).0),
    ];
    let comm = prop_oneof![
        3 => Just(0u16),
        1 => proptest::sample::select(CommAlarm::LISTED.to_vec()).prop_map(|alarm| CommWord(1).with_alarm(alarm).0),
    ];
    prop_oneof![
        8 => request.prop_map(Happening::Request),
        3 => (1u64..150).prop_map(Happening::MoveFor),
        6 => (1u64..2500).prop_map(Happening::Wait),
        1 => (1u64..300).prop_map(Happening::Stall),
        2 => (1u32..4).prop_map(Happening::Drop),
        1 => any::<bool>().prop_map(Happening::Silence),
        1 => (0usize..7, alarm).prop_map(|(axis, word)| Happening::Servo(axis, word)),
        1 => comm.prop_map(Happening::Comm),
        1 => Just(Happening::Bad),
        1 => Just(Happening::Unplugged),
        1 => Just(Happening::WrongArm),
    ]
}

fn let_happen(bench: &mut Bench, happening: Happening) {
    match happening {
        Happening::Request(request) => drop(bench.driver.handle_request(bench.now, request)),
        Happening::MoveFor(ms) => bench.run_moving(Duration::from_millis(ms)),
        Happening::Wait(ms) => bench.run(Duration::from_millis(ms)),
        Happening::Stall(ms) => bench.now = bench.now + Duration::from_millis(ms),
        Happening::Drop(count) => bench.peer.drop_next = count,
        Happening::Silence(silent) => bench.peer.answers = !silent,
        Happening::Servo(axis, word) => bench.peer.servo[axis] = ServoWord(word),
        Happening::Comm(word) => bench.peer.comm = CommWord(word),
        Happening::Bad => bench.driver.handle_bad_reply(BadReply::Damaged),
        Happening::Unplugged => bench.driver.handle_unplugged(bench.now),
        Happening::WrongArm => bench.driver.handle_wrong_arm(bench.now, 9),
    }
}

/// Brakes open only within S and E, after 100 cycles with brakes on and 200 ms at speed 0, and close before E.
fn check_order(kinds: &[Kind]) -> Result<(), TestCaseError> {
    let (mut braked, mut rest, mut rest_before_brake, mut open) = (0, 0, 0, false);
    for (index, kind) in kinds.iter().enumerate() {
        match kind {
            Kind::Start => (braked, rest) = (0, 0),
            Kind::Braked | Kind::Off => {
                prop_assert!(!open || rest_before_brake >= 5, "{index}: the brakes close on a moving arm");
                open = false;
                rest = 0;
                braked += 1;
            }
            Kind::Rest => {
                prop_assert!(open || braked >= 100, "{index}: the brakes open after {braked} cycles");
                open = true;
                rest += 1;
                rest_before_brake += 1;
            }
            Kind::Motion => {
                prop_assert!(rest >= 20, "{index}: motion after {rest} cycles of speed 0");
                rest_before_brake = 0;
            }
            Kind::End => {
                prop_assert!(!open, "{index}: the control mode ends with open brakes");
                braked = 0;
            }
            Kind::Clear | Kind::Limits => prop_assert!(!open, "{index}: alarms are cleared with open brakes"),
            Kind::Other => prop_assert!(false, "{index}: a message that nobody expects"),
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn the_order_of_messages_is_kept_and_a_stop_is_always_possible(
        happenings in prop::collection::vec(happenings(), 1..40), up: bool
    ) {
        let mut bench = Bench::new();
        if up {
            bench.lead_to(DriverState::Moving);
        }
        for happening in happenings {
            let latched_before = bench.driver.state().is_latched();
            let_happen(&mut bench, happening);
            let is_reset = matches!(happening, Happening::Request(Request::Reset));
            let runs = matches!(happening, Happening::Wait(_) | Happening::MoveFor(_));
            if latched_before && !is_reset && !runs {
                prop_assert!(bench.driver.state().is_latched(), "{happening:?} led out of a latched state");
            }
            prop_assert_eq!(bench.driver.state().is_latched(), bench.driver.latched().is_some());
        }
        prop_assert_eq!(bench.driver.handle_request(bench.now, Request::Stop), Ok(()));
        bench.run(Duration::from_secs(3));
        prop_assert_eq!(bench.driver.activity(), Activity::None);
        let state = bench.driver.state();
        prop_assert!(!matches!(state, DriverState::Enabled | DriverState::Holding | DriverState::Moving), "{state:?}");
        let sent = bench.sent.len();
        bench.run(Duration::from_secs(1));
        prop_assert_eq!(bench.sent.len(), sent, "something is sent after the stop");
        // The controller answers again.
        bench.peer.answers = true;
        bench.peer.drop_next = 0;
        bench.run(Duration::from_secs(1));
        let kinds: Vec<Kind> = bench.sent.iter().map(|(_, message)| kind(message)).collect();
        check_order(&kinds)?;
    }
}
