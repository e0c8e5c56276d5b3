//! Limits of size, number and time; nobody keeps `stop` from anybody.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use pb3dp_servo::supervisor::{OperatorCommand, State};
use serde_json::json;

use pb3dp_hal_api::Clock;

use crate::support::client::raw;
use crate::support::{Page, Rig, TIMEOUT};

const JSON: &str = "Content-Type: application/json\r\n";

#[test]
fn bodies_are_json_of_the_right_shape_and_size() {
    let rig = Rig::new();
    let client = rig.holder();
    for (kind, body, status) in [
        ("text/plain", "{}".to_owned(), 415),
        ("application/x-www-form-urlencoded", "{}".to_owned(), 415),
        ("application/json", "{".to_owned(), 400),
        ("application/json", "[1]".to_owned(), 400),
        ("application/json", r#"{"hand_only":true,"fast":true}"#.to_owned(), 400),
        ("application/json", r#"{"hand_only":"yes"}"#.to_owned(), 400),
        ("application/json", format!(r#"{{"hand_only":{}}}"#, " ".repeat(70_000)), 413),
        ("application/json; charset=utf-8", "{}".to_owned(), 200),
    ] {
        let reply = client.request("POST", "/api/hold", &format!("Content-Type: {kind}\r\n"), &body);
        assert_eq!(reply.status, status, "{kind}: {}", reply.body);
    }
    assert_eq!(client.request("POST", "/api/hold", "", "{}").status, 415);
    let nested = format!(r#"{{"region":{}"#, "[".repeat(30_000));
    assert_eq!(client.post("preview", &nested).status, 400);
    let reply = raw(
        rig.address(),
        format!("GET / HTTP/1.1\r\nHost: localhost\r\nX: {}\r\n\r\n", "x".repeat(40_000)).as_bytes(),
    );
    assert!(matches!(reply.status, 400 | 431 | 0), "{reply:?}");
    assert_eq!(client.state()["state"]["name"], "idle");
}

/// Connections that say nothing, from a program without any right, opened again as soon as they are closed.
fn occupy(address: SocketAddr, is_over: &AtomicBool) {
    let connect = || {
        let stream = TcpStream::connect(address).ok()?;
        stream.set_nonblocking(true).ok()?;
        Some(stream)
    };
    let mut streams: Vec<Option<TcpStream>> = (0..44).map(|_| connect()).collect();
    while !is_over.load(Ordering::SeqCst) {
        for stream in &mut streams {
            let is_closed = match stream.as_mut().map(|stream| stream.read(&mut [0])) {
                Some(Ok(count)) => count == 0,
                Some(Err(error)) => error.kind() != std::io::ErrorKind::WouldBlock,
                None => true,
            };
            if is_closed {
                *stream = connect();
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Ends the flood also when the test fails.
struct EndsWhenDropped(Arc<AtomicBool>);

impl Drop for EndsWhenDropped {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

#[test]
fn nobody_who_occupies_all_connections_keeps_stop_from_anybody() {
    let rig = Rig::new();
    let client = rig.holder();
    let mut page = Page::open(&rig.client());
    rig.start(&client);
    let is_over = Arc::<AtomicBool>::default();
    let (address, its_end) = (rig.address(), Arc::clone(&is_over));
    let flood = std::thread::spawn(move || occupy(address, &its_end));
    let end = EndsWhenDropped(is_over);
    std::thread::sleep(Duration::from_millis(300));
    let stranger = rig.client();
    let reply = stranger.get("/api/state");
    assert!(matches!(reply.status, 503 | 0), "{reply:?}");
    for _ in 0..20 {
        stranger.post("stop", "{}").is_accepted();
    }
    rig.wait_for_state(State::Stopped);
    // A page needs no new connection.
    let stops = rig.count_of(OperatorCommand::Stop);
    page.send(json!({ "type": "stop" }));
    let answer = page.next_of("answer");
    assert_eq!((&answer["to"], &answer["accepted"]), (&json!("stop"), &json!(true)), "{answer}");
    assert_eq!(rig.count_of(OperatorCommand::Stop), stops + 1);
    drop(end);
    flood.join().unwrap();
    let start = Instant::now();
    while stranger.get("/api/state").status != 200 {
        assert!(start.elapsed() < TIMEOUT);
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn forty_pages_are_not_served_and_the_first_ones_go_on() {
    let rig = Rig::new();
    let client = rig.client();
    let mut pages: Vec<Page> = (0..30).map(|_| Page::open(&client)).collect();
    let more: Vec<_> = (0..10).map(|_| Page::connect(rig.address(), None)).collect();
    assert!(more.iter().filter(|page| page.is_err()).count() >= 8);
    for page in &mut pages {
        page.next_of("state");
    }
}

#[test]
fn stop_is_taken_although_the_queue_is_full() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.is_paused.store(true, Ordering::SeqCst);
    std::thread::sleep(Duration::from_millis(20));
    let body = json!({ "seen": client.shown_state() }).to_string();
    let text = format!(
        "POST /api/reset HTTP/1.1\r\nHost: {}\r\nPB3DP-Session: {}\r\n{JSON}Content-Length: {}\r\n\r\n{body}",
        client.address,
        client.session.as_ref().unwrap(),
        body.len()
    );
    let waiting: Vec<TcpStream> = (0..16)
        .map(|_| {
            let mut stream = TcpStream::connect(rig.address()).unwrap();
            stream.write_all(text.as_bytes()).unwrap();
            stream
        })
        .collect();
    std::thread::sleep(Duration::from_millis(150));
    client.post("reset", &body).is_refused(409, "PB3DP-PAN-027");
    let stopping = {
        let stranger = rig.client();
        std::thread::spawn(move || stranger.post("stop", "{}"))
    };
    std::thread::sleep(Duration::from_millis(50));
    rig.is_paused.store(false, Ordering::SeqCst);
    assert_eq!(stopping.join().unwrap().status, 200);
    rig.wait_for_state(State::Stopped);
    assert_eq!(rig.observed.lock().unwrap().commands[0].0, OperatorCommand::Stop, "before all that waited");
    assert_eq!(rig.count_of(OperatorCommand::Reset), 0, "what waited was overtaken");
    drop(waiting);
}

#[test]
fn a_stop_reaches_the_control_thread_at_once_also_with_five_pages() {
    let rig = Rig::new();
    let client = rig.client();
    let pages: Vec<_> = (0..5)
        .map(|_| {
            let mut page = Page::open(&client);
            page.send(json!({ "type": "images", "left": true, "right": true, "heat": true }));
            std::thread::spawn(move || while page.next().is_ok() {})
        })
        .collect();
    let mut delays_s: Vec<f64> = (0..100)
        .map(|_| {
            let given_at = rig.clock.now();
            assert_eq!(client.post("stop", "{}").status, 200);
            let (_, taken_at) = *rig.observed.lock().unwrap().commands.last().unwrap();
            taken_at.seconds_since(given_at)
        })
        .collect();
    delays_s.sort_by(f64::total_cmp);
    println!("stop: median {:.1} ms, 99th percentile {:.1} ms", delays_s[50] * 1e3, delays_s[98] * 1e3);
    // A loaded machine delays single requests.
    assert!(delays_s[90] < 0.05, "{delays_s:?}");
    drop(rig);
    for page in pages {
        page.join().unwrap();
    }
}

#[test]
fn a_flood_is_refused_and_stop_is_not_part_of_it() {
    let rig = Rig::new();
    let client = rig.client();
    let body = r#"{"region":"rect:1,2,3"}"#;
    let statuses: Vec<u16> = (0..200).map(|_| client.post("preview", body).status).collect();
    assert!(statuses.contains(&429) && statuses[0] == 400);
    assert_eq!(client.post("stop", "{}").status, 200);
}

#[test]
fn a_hung_control_thread_is_reported() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.is_paused.store(true, Ordering::SeqCst);
    std::thread::sleep(Duration::from_millis(20));
    client.post("stop", "{}").is_refused(504, "PB3DP-PAN-029");
    rig.is_paused.store(false, Ordering::SeqCst);
    rig.wait_for_state(State::Stopped);
}

#[test]
fn commands_that_waited_while_the_program_was_suspended_are_discarded() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.is_paused.store(true, Ordering::SeqCst);
    std::thread::sleep(Duration::from_millis(20));
    let is_paused = rig.is_paused.clone();
    let waking = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(500));
        is_paused.store(false, Ordering::SeqCst);
    });
    client.command("select", json!({ "region": "rect:200,150,120,90" })).is_refused(409, "PB3DP-PAN-030");
    waking.join().unwrap();
    assert_eq!(rig.count_of(OperatorCommand::Select), 0);
}

#[test]
fn messages_that_break_the_protocol_end_the_connection_or_are_refused() {
    let rig = Rig::new();
    for first in
        [json!({ "type": "images", "left": true, "right": true }), json!({ "type": "hello", "protocol": 2 }), json!({})]
    {
        let mut page = Page::connect(rig.address(), None).unwrap();
        page.send(first.clone());
        let answer = page.next().unwrap().unwrap();
        assert_eq!((&answer["accepted"], &answer["code"]), (&json!(false), &json!("PB3DP-PAN-039")), "{first}");
        while page.next().is_ok() {}
    }
    let client = rig.client();
    let mut page = Page::open(&client);
    for wrong in [
        json!({ "type": "images", "left": true, "right": true, "quality": 100 }),
        json!({ "type": "start" }),
        json!({ "type": "stop", "hand_only": true }),
        json!({ "type": "heartbeat", "nonce": "0123456789abcdef", "visible": true }),
    ] {
        page.send(wrong.clone());
        let answer = page.next_of("answer");
        assert_eq!(answer["accepted"], false, "{wrong}");
    }
    page.send(json!({ "type": "hello", "protocol": 1, "session": "x".repeat(20_000) }));
    while page.next().is_ok() {}
    assert_eq!(client.state()["state"]["name"], "idle");
}
