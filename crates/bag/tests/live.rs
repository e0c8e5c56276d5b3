//! A run that viewers watch while it goes on, by real connections.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use pb3dp_bag::cdr::from_bytes;
use pb3dp_bag::live::Live;
use pb3dp_bag::messages::{Image, Message as _, Text};
use pb3dp_bag::recent::{Recent, RecentOptions};
use pb3dp_bag::sinks::Sinks;
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_bag::{BagError, reader::Bag};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

use super::{at, image_of};

const LINE: &str = "/line";

fn sinks() -> Sinks {
    Sinks::new(None, None, Some(Live::serve("127.0.0.1:0".parse().unwrap()).unwrap()))
}

fn text(data: &str) -> Text {
    Text { data: data.to_owned() }
}

/// A viewer with the channels that it has seen.
struct Viewer {
    socket: WebSocket<TcpStream>,
    channels: BTreeMap<String, u64>,
}

/// Why a handshake was refused: the status of HTTP.
fn connect(sinks: &Sinks, protocol: &str, origin: Option<&str>) -> Result<Viewer, u16> {
    let address = sinks.live().unwrap().address();
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let mut request = format!("ws://{address}").into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocol.parse().unwrap());
    if let Some(origin) = origin {
        request.headers_mut().insert("origin", origin.parse().unwrap());
    }
    match tungstenite::client::client(request, stream) {
        Ok((socket, _)) => Ok(Viewer { socket, channels: BTreeMap::new() }),
        Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
            Err(response.status().as_u16())
        }
        Err(error) => panic!("{error}"),
    }
}

/// A viewer that has the topics and has subscribed to them, each with 100 more than the number of its channel.
fn viewer(sinks: &Sinks, topics: &[&str]) -> Viewer {
    let mut viewer = connect(sinks, "foxglove.sdk.v1", None).unwrap();
    let info = viewer.json();
    assert_eq!((info["op"].as_str(), info["capabilities"].as_array().map(Vec::len)), (Some("serverInfo"), Some(0)));
    while topics.iter().any(|topic| !viewer.channels.contains_key(*topic)) {
        viewer.json();
    }
    viewer.subscribe(topics);
    viewer
}

impl Viewer {
    fn json(&mut self) -> serde_json::Value {
        let Message::Text(text) = self.socket.read().unwrap() else { panic!("no text") };
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        for channel in value["channels"].as_array().into_iter().flatten() {
            assert_eq!(
                (channel["encoding"].as_str(), channel["schemaEncoding"].as_str()),
                (Some("cdr"), Some("ros2msg"))
            );
            self.channels.insert(channel["topic"].as_str().unwrap().to_owned(), channel["id"].as_u64().unwrap());
        }
        value
    }

    fn send(&mut self, value: &serde_json::Value) {
        self.socket.send(Message::text(value.to_string())).unwrap();
    }

    fn subscribe(&mut self, topics: &[&str]) {
        let one =
            |topic: &&str| serde_json::json!({"id": 100 + self.channels[*topic], "channelId": self.channels[*topic]});
        let all: Vec<_> = topics.iter().map(one).collect();
        self.send(&serde_json::json!({"op": "subscribe", "subscriptions": all}));
    }

    /// The next message: its topic, its time and the encoded message.
    fn message(&mut self) -> (String, u64, Vec<u8>) {
        let Message::Binary(bytes) = self.socket.read().unwrap() else { panic!("no message") };
        assert_eq!(bytes[0], 1);
        let id = u64::from(u32::from_le_bytes(bytes[1..5].try_into().unwrap()));
        let topic = self.channels.iter().find(|(_, channel)| **channel + 100 == id).unwrap().0.clone();
        (topic, u64::from_le_bytes(bytes[5..13].try_into().unwrap()), bytes[13..].to_vec())
    }

    fn line(&mut self) -> String {
        let (topic, _, data) = self.message();
        assert_eq!(topic, LINE);
        from_bytes::<Text>(&data).unwrap().data
    }

    /// Waits for the end of the connection.
    fn ends(&mut self) {
        while self.socket.read().is_ok() {}
    }
}

/// Pushes lines until a viewer has one: then its subscription is there.
fn until_received(sinks: &mut Sinks, viewer: &mut Viewer) {
    viewer.socket.get_ref().set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let began = Instant::now();
    loop {
        sinks.push(LINE, at(0), &text("waiting"));
        match viewer.socket.read() {
            Ok(Message::Binary(_)) => break,
            Ok(_) => {}
            Err(_) => assert!(began.elapsed() < Duration::from_secs(10)),
        }
    }
    while viewer.socket.read().is_ok() {}
    viewer.socket.get_ref().set_read_timeout(Some(Duration::from_secs(10))).unwrap();
}

/// A run with one line, and its first viewer.
fn watched() -> (Sinks, Viewer) {
    let mut sinks = sinks();
    sinks.push(LINE, at(0), &text("first"));
    let viewer = viewer(&sinks, &[LINE]);
    (sinks, viewer)
}

fn wait_for_viewers(sinks: &Sinks, count: usize) {
    let began = Instant::now();
    while sinks.live().unwrap().viewers() != count {
        assert!(began.elapsed() < Duration::from_secs(10), "{} viewers", sinks.live().unwrap().viewers());
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_viewer_gets_what_describes_the_run_and_then_every_message_as_in_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let files = [dir.path().join("run.mcap"), dir.path().join("fault.mcap")];
    let live = Live::serve("127.0.0.1:0".parse().unwrap()).unwrap();
    let recent = Recent::start(RecentOptions { when_full: WhenFull::Wait, ..RecentOptions::default() }).unwrap();
    let writer = BagWriter::create(&files[0], WhenFull::Wait).unwrap();
    let mut sinks = Sinks::new(Some(writer), Some(recent), Some(live));
    sinks.push(ours::SETUP, at(0), &text("[camera]"));
    sinks.push(LINE, at(1), &text("before"));
    for protocol in ["foxglove.sdk.v1", "foxglove.websocket.v1"] {
        assert!(connect(&sinks, protocol, None).is_ok());
    }
    let mut viewer = viewer(&sinks, &[LINE, ours::SETUP]);
    let (topic, time, data) = viewer.message();
    assert_eq!((topic.as_str(), time), (ours::SETUP, at(0).as_nanos()));
    assert_eq!(from_bytes::<Text>(&data).unwrap().data, "[camera]");
    for k in 0..100 {
        sinks.push(LINE, at(2 + k), &text(&k.to_string()));
    }
    for k in 0..100 {
        assert_eq!(viewer.line(), k.to_string());
    }
    // A topic that begins later is announced.
    sinks.push(ours::LEFT_IMAGE, at(200), &image_of(900_000, 7));
    assert_eq!(viewer.json()["channels"][0]["schemaName"], Image::name());
    viewer.subscribe(&[ours::LEFT_IMAGE]);
    viewer.send(&serde_json::json!({"op": "unsubscribe", "subscriptionIds": [100 + viewer.channels[LINE]]}));
    std::thread::sleep(Duration::from_millis(200));
    sinks.push(LINE, at(201), &text("not subscribed any more"));
    sinks.push(ours::LEFT_IMAGE, at(202), &image_of(900_000, 8));
    let (topic, time, received) = viewer.message();
    assert_eq!((topic.as_str(), time), (ours::LEFT_IMAGE, at(202).as_nanos()));
    sinks.keep(&files[1]).unwrap();
    let finished = sinks.finish();
    assert_eq!((finished.recent_dropped, finished.live_dropped), (0, 0));
    assert_eq!(finished.written.unwrap().unwrap().messages[LINE], 102);
    assert_eq!(finished.kept[0].as_ref().unwrap().messages, 105);
    for file in files {
        let last = Bag::open(&file).unwrap().messages().last().unwrap().unwrap();
        assert_eq!((last.sequence, last.data), (2, received.clone()));
    }
    viewer.ends();
}

#[test]
fn pages_of_others_and_other_protocols_are_refused() {
    let sinks = sinks();
    assert_eq!(connect(&sinks, "chat", None).err(), Some(400));
    assert_eq!(connect(&sinks, "foxglove.sdk.v1", Some("https://evil.example")).err(), Some(403));
    assert!(connect(&sinks, "chat, foxglove.sdk.v1", Some("http://localhost:8080")).is_ok());
    let address = sinks.live().unwrap().address();
    assert!(matches!(Live::serve(address), Err(BagError::Serve { address: at, .. }) if at == address));
}

#[test]
fn a_hostile_client_ends_its_own_connection_only() {
    let (mut sinks, mut good) = watched();
    until_received(&mut sinks, &mut good);
    let address = sinks.live().unwrap().address();
    for garbage in [&b"\x00\xff\x13\x37 garbage\r\n\r\n"[..], b"GET / HTTP/1.1\r\n\r\n", &[b'a'; 200_000]] {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let _ = stream.write_all(garbage);
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
    }
    let texts = [
        "no JSON".to_owned(),
        "[1]".to_owned(),
        "a".repeat(100_000),
        r#"{"op":"subscribe","subscriptions":7}"#.to_owned(),
    ];
    for text in texts {
        let mut bad = viewer(&sinks, &[LINE]);
        bad.socket.send(Message::text(text)).unwrap();
        bad.ends();
    }
    // A frame that announces 2^62 bytes.
    let mut bad = viewer(&sinks, &[LINE]);
    let frame = [&[0x82, 0xFF][..], &(1_u64 << 62).to_be_bytes(), &[1, 2, 3, 4, 5]].concat();
    bad.socket.get_mut().write_all(&frame).unwrap();
    bad.ends();
    // Too many messages.
    let mut bad = viewer(&sinks, &[LINE]);
    while bad.socket.send(Message::text(r#"{"op":"getParameters"}"#)).is_ok() {}
    // What has no effect: data of a client, unknown operations, channels that are not there or subscribed already.
    let mut odd = viewer(&sinks, &[LINE]);
    odd.socket.send(Message::binary(vec![1; 50_000])).unwrap();
    odd.send(&serde_json::json!({"op": "setParameters", "parameters": [{"name": "x", "value": 1}]}));
    odd.send(&serde_json::json!({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}, {"id": 2, "channelId": 0}]}));
    until_received(&mut sinks, &mut odd);
    until_received(&mut sinks, &mut good);
    sinks.push(LINE, at(9), &text("still here"));
    assert_eq!(good.line(), "still here");
    while odd.line() != "still here" {}
}

#[test]
fn a_client_that_says_nothing_or_little_is_disconnected() {
    let sinks = sinks();
    let mut silent = TcpStream::connect(sinks.live().unwrap().address()).unwrap();
    let mut slow = TcpStream::connect(sinks.live().unwrap().address()).unwrap();
    let began = Instant::now();
    silent.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    while slow.write_all(b"G").is_ok() && began.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(200));
    }
    assert_eq!(silent.read(&mut [0]).unwrap(), 0);
    assert!(began.elapsed() < Duration::from_secs(20));
    assert_eq!(sinks.live().unwrap().viewers(), 0);
}

/// It sends much, too, so that its requests wait when it no longer takes answers.
#[test]
fn a_client_that_asks_and_does_not_read_is_disconnected_and_takes_no_time() {
    let (mut sinks, mut bad) = watched();
    let wrong: Vec<_> = (0..1000).map(|k| serde_json::json!({"id": k, "channelId": 99})).collect();
    let request = serde_json::json!({"op": "subscribe", "subscriptions": wrong}).to_string();
    let began = Instant::now();
    bad.socket.get_ref().set_write_timeout(Some(Duration::from_secs(10))).unwrap();
    while bad.socket.send(Message::text(request.clone())).is_ok() && began.elapsed() < Duration::from_secs(10) {}
    wait_for_viewers(&sinks, 0);
    let mut good = viewer(&sinks, &[LINE]);
    until_received(&mut sinks, &mut good);
}

#[test]
fn connections_too_many_are_closed_and_the_others_stay() {
    let (mut sinks, mut good) = watched();
    let address = sinks.live().unwrap().address();
    let many: Vec<TcpStream> = (0..100).map(|_| TcpStream::connect(address).unwrap()).collect();
    wait_for_viewers(&sinks, 16);
    until_received(&mut sinks, &mut good);
    drop(many);
    wait_for_viewers(&sinks, 1);
    let mut later = viewer(&sinks, &[LINE]);
    until_received(&mut sinks, &mut later);
}

/// Images of 900 kB with a line each, at 60 Hz: what a pair of cameras delivers. The times of the caller, sorted, microseconds.
fn times_of_caller(sinks: &mut Sinks, images: u64) -> Vec<u128> {
    let image = image_of(900_000, 1);
    let mut times = Vec::new();
    for k in 0..images {
        let began = Instant::now();
        sinks.push(ours::LEFT_IMAGE, at(k), &image);
        sinks.push(LINE, at(k), &text(&k.to_string()));
        times.push(began.elapsed().as_micros());
        std::thread::sleep(Duration::from_millis(5));
    }
    times.sort_unstable();
    times
}

#[test]
fn viewers_that_read_nothing_hold_nobody_up() {
    let mut sinks = sinks();
    sinks.push(LINE, at(0), &text("first"));
    sinks.push(ours::LEFT_IMAGE, at(0), &image_of(10, 0));
    let mut stalled = Vec::new();
    let (mut encoder, image) = (pb3dp_bag::encoded::Encoder::default(), image_of(900_000, 1));
    let began = Instant::now();
    (0..200).for_each(|k| drop(encoder.encode(ours::LEFT_IMAGE, at(k), &image)));
    println!("encoding alone: mean {} us", began.elapsed().as_micros() / 200);
    for count in 0..3 {
        let times = times_of_caller(&mut sinks, 200);
        println!("{count} stalled viewers: median {} us, most {} us", times[100], times[199]);
        assert!(times[100] < 20_000, "{times:?}");
        stalled.push(viewer(&sinks, &[LINE, ours::LEFT_IMAGE]));
    }
    // One that reads gets every line meanwhile.
    let mut good = viewer(&sinks, &[LINE]);
    until_received(&mut sinks, &mut good);
    times_of_caller(&mut sinks, 100);
    for k in 0..100 {
        assert_eq!(good.line(), k.to_string());
    }
    // A stalled one goes on with what the system held and with the newest messages: of the lines none is missing at the end.
    let mut last = None;
    sinks.push(LINE, at(9999), &text("last"));
    while last.as_deref() != Some("last") {
        let (topic, _, data) = stalled[0].message();
        if topic == LINE {
            last = Some(from_bytes::<Text>(&data).unwrap().data);
        }
    }
    assert_eq!(sinks.finish().live_dropped, 0);
}
