//! The lease, commands, and what refuses them.

use std::time::Duration;

use pb3dp_cell::perception::TargetSource;
use pb3dp_estimation_core::region::Region;
use pb3dp_servo::supervisor::{OperatorCommand, State};
use serde_json::json;

use crate::support::Rig;

#[test]
fn without_the_lease_only_stop_is_obeyed() {
    let rig = Rig::new();
    let client = rig.client();
    let observed = client.shown_state();
    for (command, body) in [
        ("select", json!({ "region": "rect:200,150,120,90", "seen": observed })),
        ("start", json!({ "seen": observed })),
        ("resume", json!({ "seen": observed })),
        ("re-align", json!({ "seen": observed })),
        ("reset", json!({ "seen": observed })),
        ("hold", json!({})),
        ("heartbeat", json!({ "nonce": "0123456789abcdef" })),
        ("speed", json!({ "percent": 10, "seen": observed })),
        ("jog", json!({ "offset_mm": [1, 0, 0], "offset_deg": [0, 0, 0], "seen": observed })),
    ] {
        client.post(command, &body.to_string()).is_refused(403, "PB3DP-PAN-021");
    }
    assert!(rig.observed.lock().unwrap().commands.is_empty());
    for body in ["{}", "", r#"{"seen":null}"#, "{ not json", r#"{"unknown":1}"#] {
        assert_eq!(client.post("stop", body).status, 200, "from everybody, as often as one likes: {body:?}");
    }
    rig.wait_for_state(State::Stopped);
}

#[test]
fn a_target_is_selected_started_held_resumed_and_stopped() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.start(&client);
    let (region, drawn_on) = rig.observed.lock().unwrap().regions[0].clone();
    assert_eq!(region, Region::Rectangle { x: 200, y: 150, width: 120, height: 90 });
    assert!(drawn_on.is_some(), "the pair on which it was drawn");
    // A hold is not refused because of an old or damaged `observed`.
    client.post("hold", r#"{"seen":{"state":0,"target":null}}"#).is_accepted();
    assert_eq!(rig.state(), State::Holding);
    client.wait_for("ready", |state| state["state"]["is_ready"] == true && state["state"]["name"] == "holding");
    for command in ["resume", "re-align"] {
        assert_eq!(client.command(command, json!({})).json()["line"], format!("{command}: approaching"));
    }
    client.post("stop", "{}").is_accepted();
    assert_eq!(rig.state(), State::Stopped);
    client.wait_for("stopped", |state| state["state"]["name"] == "stopped" && state["state"]["is_latched"] == true);
    client.command("reset", json!({})).is_accepted();
    assert_eq!(rig.state(), State::Idle);
}

#[test]
fn a_select_while_an_arm_moves_holds_every_arm_first() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.start(&client);
    let reply = client.command("select", json!({ "region": "click:320,240", "name": "cup" }));
    assert_eq!((reply.status, reply.json()["line"].as_str()), (200, Some("select: selecting")), "{}", reply.body);
    {
        let observed = rig.observed.lock().unwrap();
        let last = &observed.commands[observed.commands.len() - 2..];
        assert_eq!([last[0].0, last[1].0], [OperatorCommand::Hold, OperatorCommand::Select]);
    }
    rig.wait_for("the second target", |observed| observed.regions.len() == 2);
    let state = client.wait_for("its name", |state| state["target"]["name"] == "cup" && state["target"]["id"] == 2);
    assert_eq!(state["saved"], json!(["cup"]));
    client.wait_for("ready", |state| state["state"]["is_ready"] == true);
    client.command("select", json!({ "saved": "cup" })).is_accepted();
    rig.wait_for("the saved target", |observed| observed.regions.len() == 3);
    assert_eq!(client.command("select", json!({ "saved": "box" })).code(), "PB3DP-PAN-035");
}

/// Without a region and a saved name: the target of the setup, and no other name for the target that is followed.
#[test]
fn a_select_without_a_region_chooses_the_target_of_the_setup_and_names_nothing() {
    let rig = Rig::new();
    let client = rig.holder();
    let select = |body: serde_json::Value| client.command("select", body);
    let reply = select(json!({}));
    reply.is_refused(400, "PB3DP-PAN-032");
    assert!(reply.body.contains("camera.region"), "{}", reply.body);
    assert_eq!(rig.count_of(OperatorCommand::Select), 0);
    for (count, name) in [(1, "cup"), (2, "box")] {
        select(json!({ "region": "click:320,240", "name": name })).is_accepted();
        client.wait_for("its name", |state| state["target"]["name"] == name && state["target"]["id"] == count);
    }
    for name in ["cup", "box", "bowl"] {
        let reply = select(json!({ "name": name }));
        reply.is_refused(400, "PB3DP-PAN-017");
        assert!(reply.body.contains("saved are: cup, box"), "{}", reply.body);
    }
    assert_eq!(rig.count_of(OperatorCommand::Select), 2);
    let of_setup = TargetSource::Region(Region::Click { x: 7, y: 7 });
    rig.panel.as_ref().unwrap().selections().set_target_of_setup(&of_setup);
    select(json!({})).is_accepted();
    rig.wait_for("the target of the setup", |observed| observed.setup_selected == 1 && observed.regions.len() == 2);
    client.wait_for("no name", |state| state["target"]["name"].is_null());
}

#[test]
fn a_refused_select_does_not_reach_the_estimation() {
    let rig = Rig::new();
    let client = rig.holder();
    client.post("stop", "{}").is_accepted();
    client.wait_for("stopped", |state| state["state"]["name"] == "stopped");
    client.command("select", json!({ "region": "rect:200,150,120,90" })).is_refused(409, "PB3DP-SUP-101");
    assert!(rig.observed.lock().unwrap().regions.is_empty());
}

#[test]
fn stale_replayed_and_duplicated_commands_are_refused() {
    let rig = Rig::new();
    let client = rig.holder();
    let observed = client.shown_state();
    let select = |observed: &serde_json::Value| {
        client.post("select", &json!({ "region": "rect:200,150,120,90", "seen": observed }).to_string())
    };
    let time_ms = observed["time_ms"].as_f64().unwrap();
    for (key, value, code) in [
        ("state", json!(99), "PB3DP-PAN-024"),
        ("target", json!(1), "PB3DP-PAN-025"),
        ("time_ms", json!(time_ms + 5000.0), "PB3DP-PAN-026"),
        ("time_ms", json!(time_ms - 2500.0), "PB3DP-PAN-026"),
    ] {
        let mut other = observed.clone();
        other[key] = value;
        select(&other).is_refused(409, code);
    }
    // Without what was seen.
    client.post("start", "{}").is_refused(400, "PB3DP-PAN-017");
    assert!(rig.observed.lock().unwrap().commands.is_empty());
    rig.start(&client);
    // The same request again, as a proxy or a double click sends it.
    select(&observed).is_refused(409, "PB3DP-PAN-024");
    assert_eq!(rig.state(), State::Approaching);
}

#[test]
fn a_start_that_arrives_after_a_later_hold_is_refused() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.select(&client);
    let start = json!({ "seen": client.shown_state() }).to_string();
    // The operator gave `start`, then `hold`; the network delivers them in the other order. The state does not change by the hold.
    client.post("hold", "{}").is_accepted();
    client.post("start", &start).is_refused(409, "PB3DP-PAN-024");
    assert_eq!(rig.state(), State::Selecting);
}

#[test]
fn a_take_over_holds_every_arm_and_ends_the_earlier_session() {
    let rig = Rig::new();
    let first = rig.holder();
    rig.start(&first);
    let mut second = rig.client();
    let reply = second.lease("take", "tablet");
    reply.is_refused(409, "PB3DP-PAN-022");
    assert!(reply.body.contains("test"), "it names the holder: {}", reply.body);
    assert_eq!(rig.state(), State::Approaching);
    second.lease("take-over", "tablet").is_accepted();
    rig.wait_for_rest();
    assert_eq!(rig.count_of(OperatorCommand::Hold), 1);
    let state = first.wait_for("the new holder", |state| state["operator"]["holder"]["id"] == 2);
    assert_eq!(state["operator"]["holder"]["name"], "tablet");
    first.command("resume", json!({})).is_refused(403, "PB3DP-PAN-021");
}

#[test]
fn a_released_lease_holds_every_arm() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.start(&client);
    let release = || client.post("lease", r#"{"action":"release"}"#);
    release().is_accepted();
    rig.wait_for_rest();
    assert_eq!(client.state()["operator"]["holder"], json!(null));
    release().is_refused(403, "PB3DP-PAN-021");
}

#[test]
fn speed_and_jog_reach_the_control_thread_within_their_limits() {
    let rig = Rig::new();
    let client = rig.holder();
    let speed = |percent: f64| client.command("speed", json!({ "percent": percent }));
    assert_eq!(speed(40.0).status, 200);
    rig.wait_for("the share", |observed| observed.motion.is_some_and(|motion| motion.speed_share == 0.4));
    assert_eq!(speed(120.0).code(), "PB3DP-PAN-037");
    let jog = |mm: f64| client.command("jog", json!({ "offset_mm": [mm, 0, 0], "offset_deg": [0, 0, 1] }));
    assert_eq!(jog(11.0).code(), "PB3DP-PAN-036");
    assert_eq!((jog(8.0).status, jog(8.0).status), (200, 200), "a repeated jog changes nothing");
    rig.wait_for("the offset", |observed| {
        observed.motion.is_some_and(|motion| (motion.hand_from_hand_shifted.translation_m().x - 0.008).abs() < 1e-12)
    });
    // Commands that overtake each other on their way: the earlier one changes nothing any more.
    let earlier = client.shown_state();
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(speed(10.0).status, 200);
    let late = |percent: f64| client.post("speed", &json!({ "percent": percent, "seen": earlier }).to_string());
    assert_eq!(late(40.0).code(), "PB3DP-PAN-044");
    assert_eq!(client.post("resume", &json!({ "seen": earlier }).to_string()).code(), "PB3DP-PAN-044");
    assert_eq!((late(5.0).status, speed(40.0).status), (200, 200), "slower is always possible");
    let state = client.wait_for("the jog", |state| state["control"]["jog"]["offset_mm"][0] == 8.0);
    assert_eq!(state["control"]["speed_percent"], 40.0);
}

#[test]
fn commands_before_the_first_step_are_refused_and_stop_ends_the_run() {
    let rig = Rig::with(|_| {}, false);
    let mut client = rig.client();
    client.take("test");
    client.wait_for("a state", |state| state["state"]["name"] == "starting");
    client.command("start", json!({})).is_refused(409, "PB3DP-PAN-028");
    client.post("stop", "{}").is_accepted();
    assert!(rig.interrupt.load(std::sync::atomic::Ordering::SeqCst));
}

#[test]
fn the_playground_has_a_request_of_its_own() {
    let push = r#"{"offset_mm":[10,0,-20],"turn_deg":90}"#;
    let rig = Rig::new();
    assert_eq!(rig.holder().post("push", push).code(), "PB3DP-PAN-038");
    drop(rig);
    let pushed = std::sync::Arc::new(std::sync::Mutex::new(None));
    let give_push = pushed.clone();
    let change = |config: &mut pb3dp_panel::PanelConfig| {
        config.push = Some(std::sync::Arc::new(move |offset_m, turn_rad| {
            *give_push.lock().unwrap() = Some((offset_m, turn_rad));
            Ok(())
        }));
    };
    let rig = Rig::with(change, true);
    assert_eq!(rig.client().post("push", push).code(), "PB3DP-PAN-021", "only the holder");
    let client = rig.holder();
    assert_eq!(client.get("/api/info").json()["playground"], true);
    assert_eq!(client.post("push", push).status, 200);
    let (offset_m, turn_rad) = pushed.lock().unwrap().unwrap();
    assert!((offset_m[0] - 0.01_f64).abs() < 1e-12 && (offset_m[2] + 0.02_f64).abs() < 1e-12);
    assert!((turn_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    assert_eq!(client.post("push", r#"{"offset_mm":[1000,0,0],"turn_deg":0}"#).code(), "PB3DP-PAN-037");
}
