//! Arbitrary and damaged messages are refused, never obeyed and never fatal.

use pb3dp_panel::messages::requests::{
    ControlRequest, HeartbeatRequest, HoldRequest, JogRequest, LeaseRequest, PreviewRequest, PushRequest, SeenRequest,
    SelectRequest, SpeedRequest,
};
use pb3dp_panel::messages::socket::ClientMessage;
use pb3dp_panel::region::region_in;
use proptest::prelude::*;
use serde_json::json;

/// Parses as every message.
fn parse_all(bytes: &[u8]) {
    let _ = serde_json::from_slice::<LeaseRequest>(bytes);
    let _ = serde_json::from_slice::<HeartbeatRequest>(bytes);
    let _ = serde_json::from_slice::<SelectRequest>(bytes);
    let _ = serde_json::from_slice::<SeenRequest>(bytes);
    let _ = serde_json::from_slice::<HoldRequest>(bytes);
    let _ = serde_json::from_slice::<SpeedRequest>(bytes);
    let _ = serde_json::from_slice::<JogRequest>(bytes);
    let _ = serde_json::from_slice::<PreviewRequest>(bytes);
    let _ = serde_json::from_slice::<PushRequest>(bytes);
    let _ = serde_json::from_slice::<ControlRequest>(bytes);
    let _ = serde_json::from_slice::<ClientMessage>(bytes);
}

fn valid() -> Vec<String> {
    let seen = json!({ "state": 17, "target": 2, "time_ms": 123_456.7 });
    [
        json!({ "action": "take", "name": "lab" }),
        json!({ "region": "poly:1,2;30,4;5,60", "sequence": 12, "name": "cup", "seen": seen }),
        json!({ "offset_mm": [1, 2, 3], "offset_deg": [0.1, 0.2, 0.3], "seen": seen }),
        json!({ "type": "images", "left": true, "right": true, "view": "rectified", "fps_max": 30 }),
        json!({ "type": "heartbeat", "nonce": "0123456789abcdef", "visible": true }),
    ]
    .map(|message| message.to_string())
    .to_vec()
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        parse_all(&bytes);
    }

    #[test]
    fn damaged_messages_are_read_or_refused(which in 0..5_usize, at in 0..100_usize, byte in any::<u8>(), cut in 0..100_usize) {
        let mut bytes = valid()[which].clone().into_bytes();
        let index = at % bytes.len();
        bytes[index] = byte;
        parse_all(&bytes);
        bytes.truncate(cut);
        parse_all(&bytes);
    }

    #[test]
    fn any_region_is_read_or_refused(text in "(rect|poly|click|mask)?:?[-0-9eE.,;+ naif]{0,60}") {
        let size = pb3dp_geometry::ImageSize { width: 640, height: 480 };
        if let Ok(region) = region_in(&text, size) {
            // What is accepted can be drawn, or is refused with a reason.
            let image = image::RgbImage::new(640, 480);
            let _ = region.rasterize(&image, &pb3dp_estimation_core::region::RegionConfig::default());
        }
    }
}

#[test]
fn no_message_is_another_one() {
    let hold = json!({ "hand_only": true }).to_string();
    assert!(serde_json::from_str::<SeenRequest>(&hold).is_err());
    assert!(serde_json::from_str::<SeenRequest>("{}").is_err());
    let doubled = r#"{"hand_only":true,"hand_only":false}"#;
    assert!(serde_json::from_str::<HoldRequest>(doubled).is_err(), "a repeated field");
    let doubled = r#"{"type":"hello","protocol":1,"session":null,"session":"x"}"#;
    assert!(serde_json::from_str::<ClientMessage>(doubled).is_err());
}
