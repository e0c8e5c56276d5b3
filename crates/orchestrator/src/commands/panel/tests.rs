//! The panel on emulated cameras, over a real socket.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::Duration;

use pb3dp_camera_v4l2::controls::id;
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem};
use serde_json::{Value, json};

use super::*;
use crate::commands::cameras::emulated_rig::typed;

/// An open panel, whose client holds the lease.
struct Page {
    address: SocketAddr,
    session: String,
    system: EmulatedSystem,
}

/// Opens a panel on two emulated cameras without a calibration, does something with it, and closes it.
fn with_page(work: impl FnOnce(&Page)) {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let system = EmulatedSystem::new(clock.clone(), vec![EmulatedCamera::usual(0), EmulatedCamera::usual(1)]);
    let choice: CameraChoice = typed(&["--format", "YUYV", "--size", "64x48", "--skew-max", "30"]);
    let chosen = choice.to_show(&Default::default()).unwrap();
    let (camera, desk) = open_cameras(&chosen.config, (Arc::new(system.clone()), clock.clone())).unwrap();
    let source = of_cameras(chosen, camera, desk);
    let config = PanelConfig::at("127.0.0.1:0".parse().unwrap());
    let (is_over, (tell, outcomes)) = (AtomicBool::new(false), channel());
    std::thread::scope(|scope| {
        let over = &is_over;
        let serving = scope.spawn(move || {
            let mut opened = |panel: &Panel| Ok(tell.send(panel.address())?);
            serve(source, (config, clock), &mut opened, &mut || over.load(Ordering::SeqCst))
        });
        let mut page = Page { address: outcomes.recv().unwrap(), session: String::new(), system };
        // Closed also after a failure, which would wait for ever otherwise.
        let worked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let (status, lease) = page.post("lease", &json!({ "action": "take", "name": "test" }));
            assert_eq!(status, 200, "{lease}");
            page.session = lease["session"].as_str().unwrap().to_owned();
            work(&page);
        }));
        is_over.store(true, Ordering::SeqCst);
        serving.join().unwrap().unwrap();
        if let Err(panic) = worked {
            std::panic::resume_unwind(panic);
        }
    });
}

impl Page {
    fn request(&self, method: &str, path: &str, body: &str) -> (u16, Value) {
        let mut socket = TcpStream::connect(self.address).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let (host, length) = (self.address, body.len());
        let session =
            if self.session.is_empty() { String::new() } else { format!("PB3DP-Session: {}\r\n", self.session) };
        let head = format!(
            "{method} /api/{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Type: application/json\r\n{session}\
             Content-Length: {length}\r\n\r\n{body}"
        );
        socket.write_all(head.as_bytes()).unwrap();
        let mut text = String::new();
        socket.read_to_string(&mut text).unwrap();
        let status = text.split(' ').nth(1).unwrap().parse().unwrap();
        let body = text.split_once("\r\n\r\n").unwrap().1;
        (status, serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {text}")))
    }

    fn get(&self, path: &str) -> Value {
        self.request("GET", path, "").1
    }

    fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        self.request("POST", path, &body.to_string())
    }

    fn set(&self, side: &str, id: u32, value: i32) -> (u16, Value) {
        self.post("controls", &json!({ "side": side, "id": id, "value": value }))
    }

    fn until(&self, path: &str, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        for _ in 0..400 {
            let answer = self.get(path);
            if is(&answer) {
                return answer;
            }
            std::thread::sleep(Duration::from_millis(25));
        }
        panic!("{what}: {:#}", self.get(path));
    }
}

fn control(answer: &Value, side: usize, id: u32) -> Value {
    let controls = answer["cameras"][side]["controls"].as_array().unwrap();
    controls.iter().find(|control| control["id"] == id).unwrap_or_else(|| panic!("{id:#x}: {answer:#}")).clone()
}

#[test]
fn controls_of_real_cameras_are_shown_set_and_read_back() {
    with_page(|page| {
        let is_read = |answer: &Value| answer["cameras"][1]["controls"].as_array().is_some_and(|all| !all.is_empty());
        let before = page.until("controls", "controls", is_read);
        assert_eq!((&before["may_change"], &before["cameras"][1]["name"]), (&json!(true), &json!("serial:SN0001")));
        let exposure = control(&before, 1, id::EXPOSURE_ABSOLUTE);
        assert_eq!((&exposure["value"], &exposure["unit"]), (&json!(40), &json!({ "name": "ms", "factor": 0.1 })));
        assert_eq!((&exposure["mode"], &control(&before, 1, id::GAIN)["value"]), (&json!("manual"), &json!(64)));
        let (status, after) = page.set("right", id::GAIN, 77);
        assert_eq!((status, control(&after, 1, id::GAIN)["value"].as_i64()), (200, Some(77)), "{after}");
        assert_eq!(after["line"], "right `Gain` is 77");
        assert_eq!(control(&after, 0, id::GAIN)["value"], 64, "the other camera keeps its value");
        let (status, auto) = page.set("right", id::EXPOSURE_AUTO, 3);
        assert_eq!((status, &control(&auto, 1, id::EXPOSURE_ABSOLUTE)["mode"]), (200, &json!("auto")), "{auto}");
        page.system.with(0, |camera| camera.faults.forgetful.push(id::GAIN));
        for (id, value, part) in [
            (id::EXPOSURE_ABSOLUTE, 0, "its range is 1 to 5000"),
            (5, 1, "it has no control 0x00000005"),
            (id::GAIN, 9, "but the driver reports"),
        ] {
            let (status, refused) = page.set("left", id, value);
            assert!(status == 409 && refused["code"] == "PB3DP-PAN-041", "{refused}");
            assert!(refused["error"].as_str().unwrap().contains(part), "{refused}");
        }
    });
}

#[test]
fn cameras_without_a_calibration_are_shown_and_choose_no_target() {
    with_page(|page| {
        let cameras = page.get("info")["cameras"].clone();
        assert_eq!((&cameras["calibrated"], &cameras["size_px"]), (&json!(false), &json!([64, 48])));
        page.until("state", "images", |state| state["images"]["sequence"].as_u64() > Some(3));
        let check = page.until("cameras", "a check", |answer| answer["check"].is_object())["check"].clone();
        let rows = check["findings"].as_array().unwrap().iter().find(|finding| finding["check"] == "rows").unwrap();
        assert_eq!((&rows["passed"], check["skew_ms"].is_number()), (&json!(null), true), "{check}");
        let (status, refused) = page.post("preview", &json!({ "region": "click:3,4" }));
        assert!(status == 409 && refused["error"].as_str().unwrap().contains("not calibrated"), "{refused}");
    });
}

#[test]
fn cameras_that_are_unplugged_are_reported_and_come_back() {
    with_page(|page| {
        page.until("state", "images", |state| state["images"]["sequence"].as_u64() > Some(1));
        page.system.with(0, |camera| camera.faults.is_unplugged = true);
        let is_reported = |answer: &Value| answer["problem"].as_str().is_some_and(|text| text.contains("camera"));
        page.until("controls", "a problem", is_reported);
        let (status, refused) = page.set("left", id::GAIN, 9);
        assert!(status == 409 && refused["code"] == "PB3DP-PAN-041", "{refused}");
        page.system.with(0, |camera| camera.faults.is_unplugged = false);
        let before = page.get("state")["images"]["sequence"].as_u64();
        page.until("state", "new images", |state| state["images"]["sequence"].as_u64() > before);
        page.until("controls", "no problem", |answer| answer["problem"].is_null());
        assert_eq!(page.set("left", id::GAIN, 9).0, 200);
    });
}
