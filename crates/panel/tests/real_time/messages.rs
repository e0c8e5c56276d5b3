//! Answers as a whole. The published schema has its tests in `tests/python/test_panel_schema.py`.

use serde_json::{Value, json};

use super::cameras::{Cameras, EXPOSURE};
use crate::support::Rig;

/// The answers about the controls of [`Cameras`], which the Python tests check against the schema.
const CONTROLS_ANSWERS: &str = include_str!("../data/controls_answers.json");

#[test]
fn a_moving_state_has_the_poses_of_target_and_arms() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.start(&client);
    let state = client.wait_for("motion", |state| state["state"]["is_moving"] == true);
    assert!(state["target"]["cam_left_from_model"].is_array() && state["arms"][0]["position_deg"].is_array());
}

#[test]
fn the_answers_about_controls_are_those_that_the_schema_describes() {
    let expected: Value = serde_json::from_str(CONTROLS_ANSWERS).unwrap();
    let cameras = Cameras::new();
    let rig = cameras.rig();
    let client = rig.holder();
    assert_eq!(client.get("/api/controls").json(), expected["get"]);
    let body = json!({ "side": "left", "id": EXPOSURE, "value": 7, "seen": client.shown_state() });
    assert_eq!(client.post("controls", &body.to_string()).json(), expected["post"]);
    let refused = client.post("controls", r#"{"side":"left","id":1,"value":9000}"#).json();
    assert_eq!(refused, expected["refused"]);
}
