//! All states and all events.

use pb3dp_servo::supervisor::table::{Event, Order, Outcome, State, outcome};

/// The expected table, written by groups instead of rows.
fn expected(state: State, event: Event) -> Outcome {
    use Event::*;
    use Outcome::{Refuse, Stay, To};
    use State::*;
    let latched = matches!(state, Stopped | Fault);
    let moving = matches!(state, Approaching | Tracking);
    match event {
        FaultFound if state != Fault => To(Fault, Order::RearmAndStop),
        Stop | StopFound if !latched => To(Stopped, Order::RearmAndStop),
        FaultFound | Stop | StopFound => Stay,
        Reset if latched => To(Idle, Order::Rearm),
        Reset => Stay,
        Select if latched || moving => Refuse,
        Select => To(Selecting, Order::Rearm),
        Start if state == Selecting => To(Approaching, Order::None),
        Start | Resume if moving => Stay,
        Resume if matches!(state, Holding | Lost) => To(Approaching, Order::None),
        Realign if moving => To(Approaching, Order::None),
        Start | Resume | Realign => Refuse,
        Hold | HoldFound if moving => To(Holding, Order::Rearm),
        Hold | HoldFound => Stay,
        StallFound if moving => To(Holding, Order::None),
        StallFailed if state == Holding => To(Holding, Order::Rearm),
        StallOver if state == Holding => To(Approaching, Order::None),
        StallFound | StallFailed | StallOver => Stay,
        LossFound if moving || state == Holding => To(Lost, Order::Rearm),
        LossFound => Stay,
        Reached if state == Approaching => To(Tracking, Order::None),
        Left if state == Tracking => To(Approaching, Order::None),
        CauseGone if state == Holding => To(Approaching, Order::None),
        TargetFound if state == Lost => To(Approaching, Order::None),
        Reached | Left | CauseGone | TargetFound => Stay,
    }
}

#[test]
fn every_event_does_in_every_state_what_it_should() {
    for state in State::ALL {
        for event in Event::ALL {
            assert_eq!(outcome(state, event), expected(state, event), "{state}, {event}");
        }
    }
}

#[test]
fn only_the_operators_reset_leads_out_of_a_latched_state_and_only_to_idle() {
    let mut out = 0;
    for state in State::ALL.into_iter().filter(|state| state.is_latched()) {
        for event in Event::ALL {
            match outcome(state, event) {
                Outcome::To(to, order) if event == Event::Reset => {
                    assert_eq!((to, order), (State::Idle, Order::Rearm));
                    out += 1;
                }
                // A fault that is detected in the state stopped is latched as well.
                Outcome::To(to, _) => assert!(to.is_latched(), "{state}, {event} leads to {to}"),
                Outcome::Stay | Outcome::Refuse => {}
            }
        }
    }
    assert_eq!(out, 2);
}

#[test]
fn motion_begins_by_start_resume_or_what_a_policy_lets_go_on_and_by_nothing_else() {
    for state in State::ALL.into_iter().filter(|state| !state.is_moving()) {
        for event in Event::ALL {
            let Outcome::To(to, _) = outcome(state, event) else { continue };
            if to.is_moving() {
                let begins = [Event::Start, Event::Resume, Event::CauseGone, Event::TargetFound, Event::StallOver];
                assert!(begins.contains(&event), "{event}");
                assert!(matches!(state, State::Selecting | State::Holding | State::Lost), "{state}");
                assert_eq!(to, State::Approaching, "not immediately at the speed of tracking");
            }
        }
    }
}

#[test]
fn whatever_ends_motion_drops_the_set_points() {
    for state in State::ALL.into_iter().filter(|state| state.is_moving()) {
        for event in Event::ALL {
            let Outcome::To(to, order) = outcome(state, event) else { continue };
            // Only a hold for a stall keeps the target.
            assert_eq!(order != Order::None, !to.is_moving() && event != Event::StallFound, "{state}, {event}");
            assert_eq!(order == Order::RearmAndStop, to.is_latched(), "{state}, {event}");
        }
    }
}

#[test]
fn stop_and_faults_are_obeyed_in_every_state_and_hold_ends_every_motion() {
    for state in State::ALL {
        for event in [Event::Stop, Event::StopFound, Event::FaultFound] {
            let after = match outcome(state, event) {
                Outcome::To(to, _) => to,
                Outcome::Stay => state,
                Outcome::Refuse => panic!("{state} refuses {event}"),
            };
            assert!(after.is_latched(), "{state}, {event}: {after}");
        }
        let held = outcome(state, Event::Hold);
        assert!(held == Outcome::Stay && !state.is_moving() || held == Outcome::To(State::Holding, Order::Rearm));
    }
}
