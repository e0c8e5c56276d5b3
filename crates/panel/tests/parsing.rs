//! Arbitrary and damaged messages are refused, never obeyed and never fatal.

use image::RgbImage;
use pb3dp_estimation_core::region::RegionConfig;
use pb3dp_geometry::{ImageSize, MonotonicTime};
use pb3dp_panel::messages::requests::{
    ControlRequest, HeartbeatRequest, HoldRequest, JogRequest, LeaseRequest, PreviewRequest, PushRequest,
    SelectRequest, ShownRequest, SpeedRequest,
};
use pb3dp_panel::messages::socket::ClientMessage;
use pb3dp_panel::region::region_in;
use pb3dp_panel::secrets::{Nonce, Session};
use pb3dp_panel::staleness::{Present, SHOWN_AGE_MAX, ShownState};
use proptest::prelude::*;
use serde_json::json;

const SIZE: ImageSize = ImageSize { width: 64, height: 48 };

/// Reads the bytes as every message, and uses what is accepted as the server does.
fn messages_survive(bytes: &[u8]) {
    let _ = serde_json::from_slice::<LeaseRequest>(bytes);
    let _ = serde_json::from_slice::<HoldRequest>(bytes);
    let _ = serde_json::from_slice::<PushRequest>(bytes);
    let _ = serde_json::from_slice::<ControlRequest>(bytes);
    if let Ok(ShownRequest { shown }) = serde_json::from_slice(bytes) {
        shown_survives(&shown);
    }
    if let Ok(SpeedRequest { shown, .. }) = serde_json::from_slice(bytes) {
        shown_survives(&shown);
    }
    if let Ok(JogRequest { shown, .. }) = serde_json::from_slice(bytes) {
        shown_survives(&shown);
    }
    if let Ok(SelectRequest { region, shown, .. }) = serde_json::from_slice(bytes) {
        shown_survives(&shown);
        region.iter().for_each(|region| region_survives(region));
    }
    if let Ok(PreviewRequest { region: Some(region), .. }) = serde_json::from_slice(bytes) {
        region_survives(&region);
    }
    if let Ok(HeartbeatRequest { nonce, .. }) = serde_json::from_slice(bytes) {
        secrets_survive(&nonce);
    }
    match serde_json::from_slice(bytes) {
        Ok(ClientMessage::Hello { session: Some(session), .. }) => secrets_survive(&session),
        Ok(ClientMessage::Heartbeat { nonce, .. }) => secrets_survive(&nonce),
        _ => {}
    }
    if let Ok(text) = std::str::from_utf8(bytes) {
        region_survives(text);
        secrets_survive(text);
    }
}

/// A region names no file, and what is accepted can be drawn or is refused with a reason.
fn region_survives(text: &str) {
    match region_in(text, SIZE) {
        Ok(region) => {
            assert!(!text.trim_start().starts_with("mask:"), "{text:?}");
            let _ = region.rasterize(&RgbImage::new(SIZE.width, SIZE.height), &RegionConfig::default());
        }
        Err(refusal) => assert!(!refusal.to_string().is_empty()),
    }
}

/// Only a command on the present state, target and time passes.
fn shown_survives(shown: &ShownState) {
    let present = Present { state: 17, target: Some(2), now: MonotonicTime::from_secs_f64(124.0), acted_on_ms: 0.0 };
    if shown.check("start", &present).is_ok() {
        let age_ms = 124_000.0 - shown.time_ms;
        assert!((-0.01..=SHOWN_AGE_MAX.as_secs_f64() * 1e3).contains(&age_ms), "{shown:?}");
        assert_eq!((shown.state, shown.target), (present.state, present.target));
    }
}

/// Two texts are the same secret only if they have the same digits.
fn secrets_survive(text: &str) {
    if let Some(session) = Session::from_hex(text) {
        assert_eq!(session.to_hex(), text.to_lowercase());
    }
    if let Some(nonce) = Nonce::from_hex(text) {
        assert_eq!(nonce.to_hex(), text.to_lowercase());
    }
}

fn valid() -> Vec<String> {
    let shown = json!({ "state": 17, "target": 2, "time_ms": 123_456.7 });
    [
        json!({ "action": "take", "name": "lab" }),
        json!({ "region": "poly:1,2;30,4;5,60", "sequence": 12, "name": "cup", "seen": shown }),
        json!({ "offset_mm": [1, 2, 3], "offset_deg": [0.1, 0.2, 0.3], "seen": shown }),
        json!({ "type": "images", "left": true, "right": true, "view": "rectified", "fps_max": 30 }),
        json!({ "type": "heartbeat", "nonce": "0123456789abcdef", "visible": true }),
    ]
    .map(|message| message.to_string())
    .to_vec()
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        messages_survive(&bytes);
    }

    #[test]
    fn damaged_messages_are_read_or_refused(which in 0..5_usize, at in 0..100_usize, byte in any::<u8>(), cut in 0..100_usize) {
        let mut bytes = valid()[which].clone().into_bytes();
        let index = at % bytes.len();
        bytes[index] = byte;
        messages_survive(&bytes);
        bytes.truncate(cut);
        messages_survive(&bytes);
    }

    #[test]
    fn any_region_is_read_or_refused(text in "(rect|poly|click|mask)?:?[-0-9eE.,;+ naif]{0,60}") {
        region_survives(&text);
    }
}

#[test]
fn no_message_is_another_one() {
    let hold = json!({ "hand_only": true }).to_string();
    assert!(serde_json::from_str::<ShownRequest>(&hold).is_err());
    assert!(serde_json::from_str::<ShownRequest>("{}").is_err());
    let doubled = r#"{"hand_only":true,"hand_only":false}"#;
    assert!(serde_json::from_str::<HoldRequest>(doubled).is_err(), "a repeated field");
    let doubled = r#"{"type":"hello","protocol":1,"session":null,"session":"x"}"#;
    assert!(serde_json::from_str::<ClientMessage>(doubled).is_err());
}
