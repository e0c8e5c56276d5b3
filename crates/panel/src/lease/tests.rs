//! The lease of the panel: nonces, take-over, silence, hold-to-run and names.

use super::*;

/// Counts up, so that each token differs.
struct Counting(u8);

impl Random for Counting {
    fn fill(&mut self, bytes: &mut [u8]) -> bool {
        self.0 += 1;
        bytes.fill(self.0);
        true
    }
}

fn at(seconds: f64) -> MonotonicTime {
    MonotonicTime::from_secs_f64(seconds)
}

fn answer(nonce: Nonce) -> Heartbeat {
    Heartbeat { nonce, visible: true, pressed: false, needs_press: false }
}

/// A lease taken at 1 s, with its session and first nonce.
fn taken() -> (Lease, Counting, Session, Nonce) {
    let (mut lease, mut random) = (Lease::default(), Counting(0));
    let Taken { session, nonce, holder, is_take_over } = lease.take("lab PC", false, &mut random, at(1.0)).unwrap();
    assert_eq!((holder.id, holder.name.as_str(), is_take_over), (1, "lab PC", false));
    assert_eq!(lease.heartbeat_at(), Some(at(1.0)), "taking is a sign of life");
    (lease, random, session, nonce)
}

fn code<T>(result: Result<T, Refusal>) -> Option<&'static str> {
    result.err().map(|refusal| refusal.code())
}

const NOT_HOLDER: Option<&str> = Some("PB3DP-PAN-021");
const HELD: Option<&str> = Some("PB3DP-PAN-022");
const NONCE: Option<&str> = Some("PB3DP-PAN-023");

#[test]
fn each_nonce_counts_once() {
    let (mut lease, _, session, nonce) = taken();
    assert_eq!(lease.heartbeat(Some(session), answer(nonce), at(1.1)), Ok(Sign::Alive));
    assert_eq!(lease.heartbeat_at(), Some(at(1.1)));
    assert_eq!(code(lease.heartbeat(Some(session), answer(nonce), at(1.2))), NONCE, "replayed");
    assert_eq!(lease.heartbeat_at(), Some(at(1.1)), "a replayed heartbeat is no sign of life");
}

#[test]
fn only_the_two_newest_nonces_count_and_none_before_an_answered_one() {
    let (mut lease, mut random, session, first) = taken();
    let mut next = |lease: &mut Lease| lease.next_nonce(Some(session), &mut random, at(1.1)).unwrap();
    let (second, third) = (next(&mut lease), next(&mut lease));
    assert_eq!(code(lease.heartbeat(Some(session), answer(first), at(1.2))), NONCE, "too old");
    assert_eq!(lease.heartbeat(Some(session), answer(third), at(1.2)), Ok(Sign::Alive));
    assert_eq!(code(lease.heartbeat(Some(session), answer(second), at(1.3))), NONCE, "reordered");
    let foreign = Nonce::from_hex("ffffffffffffffff").unwrap();
    assert_eq!(code(lease.heartbeat(Some(session), answer(foreign), at(1.3))), NONCE, "never sent");
    assert_eq!(lease.heartbeat_at(), Some(at(1.2)));
}

#[test]
fn a_nonce_of_the_earlier_holder_does_not_count_after_a_take_over() {
    let (mut lease, mut random, session, nonce) = taken();
    assert_eq!(code(lease.take("tablet", false, &mut random, at(2.0))), HELD);
    let later = lease.take("tablet", true, &mut random, at(2.0)).unwrap();
    assert!(later.is_take_over);
    assert_eq!(later.holder.id, 2);
    assert_eq!(code(lease.heartbeat(Some(session), answer(nonce), at(2.1))), NOT_HOLDER, "wrong session");
    assert_eq!(code(lease.heartbeat(Some(later.session), answer(nonce), at(2.1))), NONCE, "nonce of another session");
    assert_eq!(code(lease.check(Some(session), at(2.1))), NOT_HOLDER);
    assert_eq!(code(lease.release(Some(session), at(2.1))), NOT_HOLDER, "it cannot end the lease of another");
    assert_eq!(lease.heartbeat(Some(later.session), answer(later.nonce), at(2.2)), Ok(Sign::Alive));
}

#[test]
fn without_a_session_nothing_passes() {
    let (mut lease, mut random, _, nonce) = taken();
    assert_eq!(code(lease.check(None, at(1.1))), NOT_HOLDER);
    assert_eq!(code(lease.heartbeat(None, answer(nonce), at(1.1))), NOT_HOLDER);
    assert_eq!(code(lease.next_nonce(None, &mut random, at(1.1))), NOT_HOLDER);
    let guessed = Session::from_hex("00000000000000000000000000000000");
    assert_eq!(code(lease.check(guessed, at(1.1))), NOT_HOLDER);
}

#[test]
fn a_hidden_page_is_silent_at_once_and_alive_again_when_it_is_shown() {
    let (mut lease, mut random, session, nonce) = taken();
    let hidden = Heartbeat { visible: false, ..answer(nonce) };
    assert_eq!(lease.heartbeat(Some(session), hidden, at(1.1)), Ok(Sign::Hidden));
    assert_eq!(lease.heartbeat_at(), None);
    let nonce = lease.next_nonce(Some(session), &mut random, at(1.2)).unwrap();
    assert_eq!(lease.heartbeat(Some(session), answer(nonce), at(1.3)), Ok(Sign::Alive));
    assert_eq!(lease.heartbeat_at(), Some(at(1.3)));
}

#[test]
fn with_hold_to_run_only_a_pressed_button_counts_while_an_arm_may_move() {
    let (mut lease, mut random, session, nonce) = taken();
    let released = Heartbeat { needs_press: true, ..answer(nonce) };
    assert_eq!(lease.heartbeat(Some(session), released, at(1.1)), Ok(Sign::Released));
    assert_eq!(lease.heartbeat_at(), Some(at(1.0)));
    let nonce = lease.next_nonce(Some(session), &mut random, at(1.2)).unwrap();
    let pressed = Heartbeat { needs_press: true, pressed: true, ..answer(nonce) };
    assert_eq!(lease.heartbeat(Some(session), pressed, at(1.3)), Ok(Sign::Alive));
    assert_eq!(lease.heartbeat_at(), Some(at(1.3)));
}

#[test]
fn a_lease_is_free_after_thirty_seconds_of_silence() {
    let (mut lease, mut random, session, nonce) = taken();
    assert_eq!(lease.expire(at(30.9)), None);
    assert!(lease.holder(at(30.9)).is_some());
    assert!(lease.holder(at(31.0)).is_none());
    assert_eq!(code(lease.heartbeat(Some(session), answer(nonce), at(31.0))), NOT_HOLDER, "too late");
    assert_eq!(lease.expire(at(31.0)).map(|holder| holder.id), Some(1));
    assert_eq!(lease.heartbeat_at(), None);
    let later = lease.take("tablet", false, &mut random, at(31.0)).unwrap();
    assert!(!later.is_take_over);
}

#[test]
fn a_released_lease_has_no_sign_of_life() {
    let (mut lease, mut random, session, _) = taken();
    assert!(lease.release(Some(session), at(1.5)).is_ok());
    assert_eq!((lease.holder(at(1.5)), lease.heartbeat_at()), (None, None));
    assert_eq!(code(lease.release(Some(session), at(1.6))), NOT_HOLDER);
    assert!(lease.take("tablet", false, &mut random, at(1.6)).is_ok());
}

#[test]
fn names_are_short_and_printable() {
    let (mut lease, mut random) = (Lease::default(), Counting(0));
    for wrong in ["", "  ", "a\nb", &"x".repeat(41)] {
        assert_eq!(code(lease.take(wrong, false, &mut random, at(0.0))), Some("PB3DP-PAN-017"), "{wrong:?}");
    }
    assert!(lease.take(&"ä".repeat(40), false, &mut random, at(0.0)).is_ok());
}
