//! The published schema against real answers.

use pb3dp_servo::supervisor::State;
use serde_json::{Value, json};

use super::cameras::{Cameras, EXPOSURE};
use crate::support::{Page, Rig};

const SCHEMA: &str = include_str!("../../../../docs/reference/panel-api.schema.json");

/// The part of the schema with this name.
fn schema_of(name: &str) -> jsonschema::Validator {
    let mut schema: Value = serde_json::from_str(SCHEMA).unwrap();
    schema["$ref"] = json!(format!("#/$defs/{name}"));
    jsonschema::validator_for(&schema).unwrap()
}

fn check(name: &str, answer: &Value) {
    let schema = schema_of(name);
    let errors: Vec<String> =
        schema.iter_errors(answer).map(|error| format!("{}: {error}", error.instance_path())).collect();
    assert!(errors.is_empty(), "{name}: {errors:#?}\n{answer:#}");
}

#[test]
fn the_published_schema_describes_every_answer() {
    let rig = Rig::new();
    let mut client = rig.client();
    check("info", &client.get("/api/info").json());
    check("state", &client.state());
    let lease = client.lease("take", "test").json();
    check("lease_answer", &lease);
    check("nonce_answer", &client.beat().json());
    client.keep_alive();
    rig.start(&client);
    let state = client.wait_for("motion", |state| state["state"]["is_moving"] == true);
    check("state", &state);
    assert!(state["target"]["cam_left_from_model"].is_array() && state["arms"][0]["position_deg"].is_array());
    check("command_answer", &client.post("hold", "{}").json());
    check("error", &client.post("start", "{}").json());
    check("error", &client.get("/api/nothing").json());
    check("controls_answer", &client.get("/api/controls").json());
    check("cameras_answer", &client.get("/api/cameras").json());
    check("epipolar_answer", &client.get("/api/epipolar?u=320&v=240").json());
    check("preview", &client.post("preview", r#"{"region":"click:300,200"}"#).json());
    check("preview", &client.post("preview", r#"{"region":"rect:1,1,3,3"}"#).json());
    check("command_answer", &client.post("stop", "{}").json());
    rig.wait_for_state(State::Stopped);
    check("state", &client.wait_for("stopped", |state| state["state"]["name"] == "stopped"));
    let mut page = Page::open(&client);
    check("server_message", &page.next_of("state"));
    check("server_message", &page.next_of("heartbeat"));
    page.send(json!({ "type": "nonsense" }));
    check("server_message", &page.next_of("answer"));
}

#[test]
fn the_published_schema_describes_the_controls_of_cameras() {
    let cameras = Cameras::new();
    let rig = cameras.rig();
    let client = rig.holder();
    check("controls_answer", &client.get("/api/controls").json());
    let body = json!({ "side": "left", "id": EXPOSURE, "value": 7, "seen": client.seen() });
    assert!(schema_of("control").is_valid(&body));
    check("controls_answer", &client.post("controls", &body.to_string()).json());
    check("error", &client.post("controls", r#"{"side":"left","id":1,"value":9000}"#).json());
}

#[test]
fn the_published_schema_refuses_what_the_panel_refuses() {
    let seen = json!({ "state": 1, "target": null, "time_ms": 1.0 });
    for (name, ok) in [
        ("select", json!({ "region": "click:1,2", "seen": seen })),
        ("seen_request", json!({ "seen": seen })),
        ("hold", json!({ "hand_only": true })),
        ("lease", json!({ "action": "take-over", "name": "x" })),
        ("jog", json!({ "offset_mm": [1, 2, 3], "offset_deg": [0, 0, 0], "seen": seen })),
        ("speed", json!({ "percent": 3, "seen": seen })),
        ("control", json!({ "side": "right", "id": 9_963_776, "value": -1 })),
        ("client_message", json!({ "type": "images", "left": true, "right": false, "view": "rectified" })),
        ("client_message", json!({ "type": "heartbeat", "nonce": "0123456789abcdef", "visible": true })),
    ] {
        let schema = schema_of(name);
        assert!(schema.is_valid(&ok), "{name}: {ok}");
        let mut more = ok.clone();
        more["more"] = json!(1);
        assert!(!schema.is_valid(&more), "{name}: unknown fields");
    }
}
