//! Signs of life: who falls silent stops the arms within half a second.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use pb3dp_servo::supervisor::State;
use serde_json::json;

use crate::support::{Page, Rig};

/// Silence after which the arms are stopped, seconds.
const SILENCE_S: f64 = 0.5;
/// For the way of a heartbeat from the page to the control thread, seconds.
const ON_THE_WAY_S: f64 = 0.02;

/// From the last heartbeat to the rest of the arms, with the longest period of the control thread, seconds.
fn silence(rig: &Rig) -> (f64, f64) {
    let observed = rig.observed.lock().unwrap();
    (observed.rested_at.unwrap().seconds_since(observed.heartbeat_at.unwrap()), observed.longest_period_s)
}

fn stopped_in_time((silent_s, period_s): (f64, f64)) {
    let limit_s = SILENCE_S + period_s + ON_THE_WAY_S;
    assert!((SILENCE_S..limit_s).contains(&silent_s), "{silent_s} s of silence, with periods of up to {period_s} s");
}

/// A page whose browser answers every heartbeat.
struct Beating {
    is_pressed: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
    thread: JoinHandle<Page>,
}

impl Beating {
    fn start(mut page: Page) -> Self {
        let [is_pressed, is_over] = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        let (pressed, over) = (is_pressed.clone(), is_over.clone());
        let thread = std::thread::spawn(move || {
            while !over.load(Ordering::SeqCst) {
                page.beat(true, pressed.load(Ordering::SeqCst));
            }
            page
        });
        Self { is_pressed, is_over, thread }
    }

    /// No more answers; the socket stays open.
    fn end(self) -> Page {
        self.is_over.store(true, Ordering::SeqCst);
        self.thread.join().unwrap()
    }
}

#[test]
fn a_holder_without_heartbeats_stops_the_arms_within_half_a_second() {
    let rig = Rig::new();
    let mut client = rig.holder();
    rig.start(&client);
    client.fall_silent();
    rig.wait_for_rest();
    stopped_in_time(silence(&rig));
}

#[test]
fn a_half_open_socket_counts_as_silent() {
    let rig = Rig::new();
    let (client, page) = rig.holder_with_page();
    let beating = Beating::start(page);
    rig.start(&client);
    // The page is suspended: its socket stays open, and nobody answers.
    let page = beating.end();
    rig.wait_for_rest();
    stopped_in_time(silence(&rig));
    drop(page);
}

#[test]
fn a_page_that_beats_keeps_the_arms_moving_and_a_closed_one_holds_them_at_once() {
    let rig = Rig::new();
    let (client, page) = rig.holder_with_page();
    let beating = Beating::start(page);
    rig.start(&client);
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(rig.state(), State::Approaching, "no false stop");
    drop(beating.end());
    rig.wait_for_rest();
    let (silent_s, _) = silence(&rig);
    assert!(silent_s < SILENCE_S, "the end of the connection is noticed before the silence: {silent_s}");
}

#[test]
fn a_hidden_page_is_silent_at_once() {
    let rig = Rig::new();
    let (client, mut page) = rig.holder_with_page();
    page.beat(true, false);
    rig.wait_for("a heartbeat", |observed| observed.heartbeat_at.is_some());
    page.beat(false, false);
    rig.wait_for("silence", |observed| observed.heartbeat_at.is_none());
    let state = client.wait_for("no sign of life", |state| state["operator"]["heard_ms_ago"] == json!(null));
    assert_eq!(state["operator"]["holder"]["name"], "test", "the lease stays");
    page.beat(true, false);
    rig.wait_for("a heartbeat", |observed| observed.heartbeat_at.is_some());
}

#[test]
fn of_two_pages_of_one_session_the_newest_is_asked() {
    let rig = Rig::new();
    let (client, mut first) = rig.holder_with_page();
    first.next_of("heartbeat");
    let mut second = Page::open(&client);
    second.beat(true, false);
    // One nonce may be on its way; then the first page gets states only.
    let mut later = Vec::new();
    for _ in 0..20 {
        later.extend(first.next().unwrap());
    }
    let beats = later.iter().rev().take(8).filter(|message| message["type"] == "heartbeat").count();
    assert_eq!(beats, 0, "{later:?}");
    drop(first);
    second.beat(true, false);
    let watcher = Page::open(&rig.client());
    drop(watcher);
    second.beat(true, false);
}

#[test]
fn with_hold_to_run_a_released_button_holds_every_arm() {
    let rig = Rig::with(|config| config.hold_to_run = true, true);
    assert_eq!(rig.client().get("/api/info").json()["hold_to_run"], true);
    let (client, page) = rig.holder_with_page();
    let beating = Beating::start(page);
    assert_eq!(client.command("start", json!({})).code(), "PB3DP-PAN-040", "the button is not pressed yet");
    beating.is_pressed.store(true, Ordering::SeqCst);
    std::thread::sleep(Duration::from_millis(300));
    rig.start(&client);
    std::thread::sleep(Duration::from_millis(700));
    assert_eq!(rig.state(), State::Approaching);
    beating.is_pressed.store(false, Ordering::SeqCst);
    rig.wait_for_rest();
    assert_eq!(rig.state(), State::Holding);
    // While no arm moves, the button need not be pressed.
    std::thread::sleep(Duration::from_millis(700));
    assert_eq!(rig.state(), State::Holding);
    beating.end();
}
