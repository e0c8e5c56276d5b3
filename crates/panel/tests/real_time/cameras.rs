//! Controls of the cameras, and checks of the images.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_cell::camera_controls::{
    CameraControl, ControlDesk, ControlEnd, ControlKind, ControlMode, ControlRequest, ControlUnit, control_desk,
};
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::SystemClock;
use pb3dp_panel::{About, Panel, PanelConfig};
use pb3dp_servo::supervisor::State;
use serde_json::json;

use crate::support::{Client, Rig, TIMEOUT, setup};

const EXPOSURE: u32 = 0x009A_0902;
/// Answers about the controls of [`Cameras`].
const CONTROLS_ANSWERS: &str = include_str!("../data/controls_answers.json");

/// The owner of two cameras: a thread that answers between two pairs, as the capture thread of a run.
struct Cameras {
    desk: ControlDesk,
    /// Stops it from answering, as a camera whose driver hangs.
    is_hung: Arc<AtomicBool>,
    set: Arc<Mutex<Vec<(usize, u32, i32)>>>,
    is_over: Arc<AtomicBool>,
    /// The clock of the panel; the cameras answer once they have it.
    clock: Arc<OnceLock<Arc<SystemClock>>>,
    thread: Option<JoinHandle<()>>,
}

impl Cameras {
    fn new() -> Self {
        let (desk, end) = control_desk();
        let [is_hung, is_over] = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        let set = Arc::<Mutex<Vec<_>>>::default();
        end.show(|shown| {
            for (camera, name) in shown.cameras.iter_mut().zip(["bus:left", "bus:right"]) {
                (camera.name, camera.controls) = (name.to_owned(), vec![exposure(40)]);
            }
        });
        let clock = Arc::<OnceLock<Arc<SystemClock>>>::default();
        let (hung, over, kept, of_panel) = (is_hung.clone(), is_over.clone(), set.clone(), clock.clone());
        let thread = std::thread::spawn(move || serve(&end, (&hung, &over), &kept, &of_panel));
        Self { desk, is_hung, set, is_over, clock, thread: Some(thread) }
    }

    fn rig(&self) -> Rig {
        let rig = Rig::with(|config| config.cameras = Some(self.desk.clone()), true);
        assert!(self.clock.set(rig.clock.clone()).is_ok());
        rig
    }

    fn set(&self) -> Vec<(usize, u32, i32)> {
        self.set.lock().unwrap().clone()
    }
}

impl Drop for Cameras {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        let joined = self.thread.take().unwrap().join();
        assert!(joined.is_ok() || std::thread::panicking());
    }
}

fn exposure(value: i32) -> CameraControl {
    CameraControl {
        id: EXPOSURE,
        name: "Exposure Time, Absolute".to_owned(),
        kind: ControlKind::Integer,
        min: 1,
        max: 5000,
        step: 1,
        default: 100,
        value: Some(value),
        unit: Some(ControlUnit { name: "ms", factor: 0.1 }),
        mode: Some(ControlMode::Manual),
        is_locked: false,
        moves_the_lens: false,
        menu: Vec::new(),
    }
}

fn serve(
    end: &ControlEnd,
    (is_hung, is_over): (&AtomicBool, &AtomicBool),
    set: &Mutex<Vec<(usize, u32, i32)>>,
    clock: &OnceLock<Arc<SystemClock>>,
) {
    while !is_over.load(Ordering::SeqCst) {
        std::thread::sleep(Duration::from_millis(5));
        let Some(clock) = clock.get().filter(|_| !is_hung.load(Ordering::SeqCst)) else { continue };
        while let Some(pending) = end.next(clock.now()) {
            let result = match pending.request {
                ControlRequest::Read => Ok(()),
                ControlRequest::Set { value, .. } if value > 5000 => {
                    Err("bus:left: `Exposure Time, Absolute` cannot be 9000; its range is 1 to 5000".to_owned())
                }
                ControlRequest::Set { side, id, value } => {
                    set.lock().unwrap().push((side, id, value));
                    end.show(|shown| shown.cameras[side].controls[0].value = Some(value));
                    Ok(())
                }
            };
            (pending.answer)(result);
        }
    }
}

fn change(client: &Client, side: &str, value: i32) -> crate::support::client::Reply {
    client.post("controls", &json!({ "side": side, "id": EXPOSURE, "value": value }).to_string())
}

/// The answers are also those that the Python tests check against the schema.
#[test]
fn controls_are_listed_set_and_read_back() {
    let expected: serde_json::Value = serde_json::from_str(CONTROLS_ANSWERS).unwrap();
    let cameras = Cameras::new();
    let rig = cameras.rig();
    assert_eq!(rig.client().get("/api/controls").json(), expected["get"]);
    // Only the holder.
    change(&rig.client(), "left", 20).is_refused(403, "PB3DP-PAN-021");
    let client = rig.holder();
    let after = change(&client, "right", 55).json();
    assert_eq!(after["line"], "right `Exposure Time, Absolute` is 55");
    let value = |answer: &serde_json::Value, side: usize| answer["cameras"][side]["controls"][0]["value"].clone();
    assert_eq!((value(&after, 0), value(&after, 1)), (json!(40), json!(55)));
    assert_eq!(value(&rig.client().get("/api/controls").json(), 1), 55, "everybody sees it");
    let reply = change(&client, "left", 9000);
    reply.is_refused(409, "PB3DP-PAN-041");
    assert!(reply.body.contains("its range is 1 to 5000"), "{}", reply.body);
    for body in [
        json!({ "side": "middle", "id": 1, "value": 1 }),
        json!({ "side": "left", "id": -1, "value": 1 }),
        json!({ "side": "left", "id": 1, "value": 1e99 }),
        json!({ "side": "left", "id": 1, "value": 1, "more": 1 }),
        json!({ "side": "left", "id": 1 }),
    ] {
        assert_eq!(client.post("controls", &body.to_string()).code(), "PB3DP-PAN-017", "{body}");
    }
    let long = format!(r#"{{"side":"left",{}"id":1,"value":1}}"#, " ".repeat(70_000));
    assert_eq!(client.post("controls", &long).status, 413);
    assert_eq!(client.request("DELETE", "/api/controls", "", "").status, 405);
    assert_eq!(cameras.set(), [(1, EXPOSURE, 55)], "what was refused did not reach a camera");
    change(&client, "right", 40).is_accepted();
    let body = json!({ "side": "left", "id": EXPOSURE, "value": 7 });
    assert_eq!(client.command("controls", body).json(), expected["post"]);
    assert_eq!(client.post("controls", r#"{"side":"left","id":1,"value":9000}"#).json(), expected["refused"]);
}

#[test]
fn no_control_changes_while_an_arm_may_move() {
    let cameras = Cameras::new();
    let rig = cameras.rig();
    let client = rig.holder();
    rig.start(&client);
    let shown = client.get("/api/controls").json();
    assert!(shown["may_change"] == false && shown["why_not"].as_str().unwrap().contains("use hold first"), "{shown}");
    assert_eq!(shown["cameras"][0]["controls"][0]["value"], 40, "the values are still shown");
    change(&client, "left", 20).is_refused(409, "PB3DP-PAN-042");
    assert_eq!((cameras.set(), rig.state()), (vec![], State::Approaching));
    assert_eq!(client.post("hold", "{}").status, 200);
    // Settling takes 0.2 s.
    let start = Instant::now();
    while client.get("/api/controls").json()["may_change"] == false {
        assert!(start.elapsed() < TIMEOUT, "{:?}", rig.observed.lock().unwrap().last);
    }
    assert_eq!((rig.state(), change(&client, "left", 20).status), (State::Holding, 200));
    client.wait_for("ready", |state| state["state"]["is_ready"] == true && state["state"]["name"] == "holding");
    client.command("resume", json!({})).is_accepted();
    // The arm with the target goes on.
    assert_eq!(client.post("hold", r#"{"hand_only":true}"#).status, 200);
    assert_eq!(change(&client, "left", 30).code(), "PB3DP-PAN-042");
    assert_eq!(client.post("stop", "{}").status, 200);
    rig.wait_for_state(State::Stopped);
    assert_eq!(change(&client, "left", 30).status, 200);
    assert_eq!(cameras.set(), [(0, EXPOSURE, 20), (0, EXPOSURE, 30)]);
}

#[test]
fn motion_begins_only_after_a_change_is_finished() {
    let cameras = Cameras::new();
    let rig = cameras.rig();
    let client = rig.holder();
    rig.select(&client);
    cameras.is_hung.store(true, Ordering::SeqCst);
    std::thread::scope(|scope| {
        let changing = scope.spawn(|| change(&client, "left", 20));
        // The request needs a moment on its way.
        let start = || client.command("start", json!({}));
        std::thread::sleep(Duration::from_millis(300));
        start().is_refused(409, "PB3DP-PAN-043");
        assert_eq!(rig.state(), State::Selecting);
        cameras.is_hung.store(false, Ordering::SeqCst);
        assert_eq!(changing.join().unwrap().status, 200);
        assert_eq!(start().status, 200);
    });
    rig.wait_for_state(State::Approaching);
}

#[test]
fn what_no_camera_takes_in_time_is_never_set() {
    let cameras = Cameras::new();
    let rig = cameras.rig();
    let client = rig.holder();
    cameras.is_hung.store(true, Ordering::SeqCst);
    let reply = change(&client, "left", 20);
    reply.is_refused(409, "PB3DP-PAN-041");
    assert!(reply.body.contains("has not answered within 2500 ms"), "{}", reply.body);
    cameras.is_hung.store(false, Ordering::SeqCst);
    assert_eq!(change(&client, "left", 21).status, 200);
    assert_eq!(cameras.set(), [(0, EXPOSURE, 21)]);
    drop(cameras);
    let reply = change(&client, "left", 22);
    assert!(reply.code() == "PB3DP-PAN-041" && reply.body.contains("the cameras are closed"), "{}", reply.body);
}

#[test]
fn cameras_without_controls_say_why() {
    let rig = Rig::new();
    let shown = rig.client().get("/api/controls").json();
    assert!(shown["may_change"] == false && shown["cameras"] == json!([]), "{shown}");
    assert_eq!(shown["why_not"], "the cameras are simulated and have no controls");
    assert_eq!(change(&rig.holder(), "left", 1).code(), "PB3DP-PAN-038");
}

#[test]
fn bare_cameras_need_no_calibration_for_images_and_controls() {
    let cameras = Cameras::new();
    let setup = setup();
    let about = About { is_calibrated: false, ..About::of_cameras(setup.rig.stereo, "two", "0", setup.range) };
    let config = PanelConfig { cameras: Some(cameras.desk.clone()), ..PanelConfig::at("127.0.0.1:0".parse().unwrap()) };
    let clock = Arc::new(SystemClock::new());
    assert!(cameras.clock.set(clock.clone()).is_ok());
    let (panel, _, _) = Panel::start(config, clock, about).unwrap();
    let mut client = Client::new(panel.address());
    client.take("test");
    assert_eq!(client.get("/api/info").json()["cameras"]["calibrated"], false);
    let state = client.state();
    assert_eq!(state["state"]["may"], json!([]));
    assert!(state["why"]["line"].as_str().unwrap().contains("not calibrated"), "{state}");
    assert_eq!(change(&client, "left", 20).status, 200);
    let region = json!({ "region": "click:3,4" });
    let preview = client.post("preview", &region.to_string());
    for reply in [client.command("select", region), preview, client.get("/api/epipolar?u=1&v=2")] {
        assert!(reply.code() == "PB3DP-PAN-038" && reply.body.contains("not calibrated"), "{}", reply.body);
    }
}

#[test]
fn the_images_are_checked_against_the_limits() {
    let rig = Rig::new();
    let client = rig.client();
    let answer = client.get("/api/cameras").json();
    let check = &answer["check"];
    let findings = check["findings"].as_array().unwrap_or_else(|| panic!("{answer}"));
    let passed = |name: &str| findings.iter().find(|finding| finding["check"] == name).unwrap()["passed"].clone();
    assert_eq!(passed("brightness left"), true, "{answer:#}");
    assert_eq!(passed("brightness of both"), true, "{answer:#}");
    for name in ["sharpness right", "focus of both", "rows", "sides"] {
        assert!(findings.iter().any(|finding| finding["check"] == name), "{name}: {answer:#}");
    }
    assert!(check["sequence"].is_u64() && check["skew_ms"] == 0.0);
    // All who ask within a second share one check.
    assert_eq!(client.get("/api/cameras").json()["check"]["sequence"], check["sequence"]);
}
