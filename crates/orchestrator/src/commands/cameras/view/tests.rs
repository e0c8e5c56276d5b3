//! The page over a real socket, with emulated cameras behind it.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use pb3dp_camera_v4l2::controls::id;
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem};
use pb3dp_hal_clock::SystemClock;
use serde_json::Value;

use super::*;

/// A page that is open, in the machine's time.
struct Page {
    address: SocketAddr,
    system: EmulatedSystem,
}

/// Answers of a server: status, head, and what follows it.
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&self.body)))
    }

    #[track_caller]
    fn refused(&self, status: u16, part: &str) {
        let error = self.json()["error"].as_str().unwrap().to_owned();
        assert!(self.status == status && error.contains(part), "{} {error}, expected {status} {part}", self.status);
    }
}

/// Opens a page, does something with it, and closes it.
fn with_page(work: impl FnOnce(&Page)) {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let system = EmulatedSystem::new(clock.clone(), vec![EmulatedCamera::usual(0), EmulatedCamera::usual(1)]);
    let choice: CameraChoice =
        super::super::emulated_rig::typed(&["--format", "YUYV", "--size", "64x48", "--skew-max", "30"]);
    let config = choice.chosen().unwrap().config;
    let video: Arc<dyn VideoSystem> = Arc::new(system.clone());
    let mut open = || V4l2StereoCamera::open(Arc::clone(&video), Arc::clone(&clock), &config);
    let camera = open().unwrap();
    let (state, states) = watch::channel(Arc::new(State::new(camera.info())));
    let (images, newest) = watch::channel(None);
    let (ask, asks) = sync_channel(ASKS_MAX);
    let sources = Sources { states, images: newest, ask };
    let server = Server::start(SocketAddr::from(([127, 0, 0, 1], 0)), sources).unwrap();
    let page = Page { address: server.address(), system };
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let clock = clock.as_ref();
        let show = Show { clock, state, images, asks };
        let over = &is_over;
        scope.spawn(move || show.run(camera, &mut open, &mut || over.load(Ordering::SeqCst)).unwrap());
        // Closed also after a failure, which would wait for ever else.
        let worked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(&page)));
        is_over.store(true, Ordering::SeqCst);
        if let Err(panic) = worked {
            std::panic::resume_unwind(panic);
        }
    });
    drop(server);
    assert!(TcpStream::connect(page.address).is_err(), "the page is closed");
}

impl Page {
    fn send(&self, bytes: &[u8]) -> TcpStream {
        let mut socket = TcpStream::connect(self.address).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        // A server that has seen enough may close before the end.
        let _ = socket.write_all(bytes);
        socket
    }

    fn raw(&self, request: &[u8]) -> Answer {
        let mut bytes = Vec::new();
        // A server that closes while it is still written to ends the reading by an error.
        let _ = self.send(request).read_to_end(&mut bytes);
        let split =
            bytes.windows(4).position(|four| four == b"\r\n\r\n").unwrap_or_else(|| panic!("no answer: {bytes:?}"));
        let head = String::from_utf8(bytes[..split].to_vec()).unwrap().to_lowercase();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        Answer { status, head, body: bytes[split + 4..].to_vec() }
    }

    fn request(&self, method: &str, path: &str, more: &str, body: &str) -> Answer {
        let length = if body.is_empty() { String::new() } else { format!("Content-Length: {}\r\n", body.len()) };
        let host = self.address;
        let text = format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}{length}\r\n{body}");
        self.raw(text.as_bytes())
    }

    fn get(&self, path: &str) -> Answer {
        self.request("GET", path, "", "")
    }

    fn post(&self, path: &str, body: &str) -> Answer {
        self.request("POST", path, "Content-Type: application/json\r\n", body)
    }

    /// Asks until the answer is as it should be: images need their time.
    fn until(&self, path: &str, is_good: impl Fn(&Answer) -> bool) -> Answer {
        for _ in 0..400 {
            let answer = self.get(path);
            if is_good(&answer) {
                return answer;
            }
            std::thread::sleep(Duration::from_millis(25));
        }
        let answer = self.get(path);
        panic!("{path}: {} {}", answer.status, String::from_utf8_lossy(&answer.body));
    }
}

#[test]
fn images_and_state_are_shown_live() {
    with_page(|page| {
        let html = page.get("/");
        assert!(html.status == 200 && html.head.contains("text/html"));
        let text = String::from_utf8(html.body).unwrap();
        assert!(text.contains("/left.mjpg") && !text.contains("http://") && !text.contains("https://"), "by itself");
        let state = page.until("/state", |answer| answer.json()["pairs"].as_u64() > Some(3)).json();
        assert_eq!(state["width_px"], 64);
        assert!((state["asked_hz"].as_f64().unwrap() - 30.0).abs() < 1e-6, "{state}");
        assert!(state["rate_hz"].as_f64().unwrap() > 0.0 && state["skew_ms"].as_f64().is_some(), "{state}");
        let jpeg = page.until("/right.jpg", |answer| answer.status == 200);
        let image = image::load_from_memory(&jpeg.body).unwrap();
        assert_eq!((image.width(), image.height()), (64, 48));
        // Three images of the stream, each whole.
        let host = page.address;
        let mut socket = page.send(format!("GET /left.mjpg HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes());
        let (mut bytes, mut piece) = (Vec::new(), [0; 4096]);
        let begins = |bytes: &[u8]| bytes.windows(3).filter(|three| *three == [0xFF, 0xD8, 0xFF]).count();
        while begins(&bytes) < 3 {
            let length = socket.read(&mut piece).unwrap();
            assert!(length > 0, "the stream has ended");
            bytes.extend_from_slice(&piece[..length]);
        }
        let text = String::from_utf8_lossy(&bytes).to_lowercase();
        assert!(text.contains("multipart/x-mixed-replace; boundary=pb3dp-next-image"), "{text:.400}");
        let parts = ["--pb3dp-next-image", "\r\ncontent-type: image/jpeg"].map(|each| text.matches(each).count());
        assert!(parts.iter().all(|count| *count >= 3), "{parts:?}");
    });
}

#[test]
fn an_image_is_whole_before_the_next_one_comes() {
    with_page(|page| {
        page.until("/left.jpg", |answer| answer.status == 200);
        for side in [0, 1] {
            page.system.with(side, |camera| camera.faults.is_silent = true);
        }
        page.until("/state", |answer| answer.json()["problem"].is_string());
        let host = page.address;
        let mut socket = page.send(format!("GET /left.mjpg HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes());
        let (mut bytes, mut piece) = (Vec::new(), [0; 4096]);
        // A browser waits for the boundary behind a part.
        let boundary = b"\r\n--pb3dp-next-image";
        while bytes.windows(boundary.len()).filter(|text| text == boundary).count() < 2 {
            let length = socket.read(&mut piece).unwrap();
            assert!(length > 0, "the stream has ended");
            bytes.extend_from_slice(&piece[..length]);
        }
        assert!(bytes.windows(3).any(|three| three == [0xFF, 0xD8, 0xFF]));
    });
}

#[test]
fn controls_are_shown_and_changed() {
    with_page(|page| {
        let value_of = |controls: &Value, id: u32| {
            let found = controls.as_array().unwrap().iter().find(|control| control["id"] == id).unwrap();
            found["value"].as_i64().unwrap()
        };
        let before = page.get("/controls/right").json();
        assert_eq!((value_of(&before, id::GAIN), value_of(&before, id::EXPOSURE_ABSOLUTE)), (64, 40));
        let change = |id: u32, value: i64| format!("{{\"id\": {id}, \"value\": {value}}}");
        let after = page.post("/controls/right", &change(id::GAIN, 77));
        assert_eq!((after.status, value_of(&after.json(), id::GAIN)), (200, 77));
        assert_eq!(value_of(&page.get("/controls/left").json(), id::GAIN), 64);
        // Every other viewer is informed that a request is pending.
        page.until("/state", |answer| answer.json()["control_changes"] == 1);
        page.post("/controls/left", &change(id::GAIN, 256)).refused(409, "its range is 0 to 255 in steps of 1");
        page.post("/controls/left", &change(5, 1)).refused(409, "it has no control 0x00000005");
        page.system.with(0, |camera| camera.faults.forgetful.push(id::GAIN));
        page.post("/controls/left", &change(id::GAIN, 9)).refused(409, "but the driver reports");
    });
}

#[test]
fn bad_requests_get_errors_with_names_and_harm_nobody() {
    with_page(|page| {
        page.get("/etc/passwd").refused(404, "/etc/passwd is not here");
        page.get("/controls/leftright").refused(404, "is not here");
        page.request("DELETE", "/state", "", "").refused(405, "DELETE is not for /state; use GET");
        page.request("PUT", "/controls/left", "", "").refused(405, "use GET or POST");
        page.request("POST", "/controls/left", "Content-Type: text/plain\r\n", "{}").refused(415, "\"text/plain\"");
        page.post("/controls/left", "{\"id\": 1").refused(400, "is not understood");
        page.post("/controls/left", "{\"id\": 1, \"value\": 1e99}").refused(400, "is not understood");
        page.post("/controls/left", "{\"id\": 1, \"value\": 1, \"more\": 1}").refused(400, "unknown field `more`");
        page.post("/controls/left", &"[".repeat(5000)).refused(413, "more than 4096 bytes");
        page.raw(b"GET / HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n").refused(403, "header `Host`");
        page.raw(b"GET / HTTP/1.1\r\nConnection: close\r\n\r\n").refused(403, "header `Host`");
        for garbage in [b"\x00\xFF\x16\x03\x01".as_slice(), b"GET\r\n\r\n", b"\r\n\r\n\r\n", &[b'A'; 40_000]] {
            let mut bytes = Vec::new();
            let mut socket = page.send(garbage);
            let _ = socket.shutdown(std::net::Shutdown::Write);
            let _ = socket.read_to_end(&mut bytes);
            assert!(!String::from_utf8_lossy(&bytes).contains(" 200 "), "{garbage:?}");
        }
        // Who connects and says nothing takes no place from others, until there are too many.
        let silent: Vec<TcpStream> = (0..20).map(|_| page.send(b"GET / HT")).collect();
        assert_eq!(page.get("/state").status, 200);
        drop(silent);
        assert_eq!(page.until("/left.jpg", |answer| answer.status == 200).status, 200);
    });
}

#[test]
fn cameras_that_are_pulled_are_told_and_come_back() {
    with_page(|page| {
        page.until("/state", |answer| answer.json()["pairs"].as_u64() > Some(1));
        page.system.with(0, |camera| camera.faults.is_unplugged = true);
        let is_told = |answer: &Answer| answer.json()["problem"].as_str().is_some_and(|text| text.contains("camera"));
        page.until("/state", is_told);
        page.until("/controls/left", |answer| answer.status == 503).refused(503, "the cameras are lost");
        page.system.with(0, |camera| camera.faults.is_unplugged = false);
        let pairs = page.get("/state").json()["pairs"].as_u64();
        page.until("/state", |answer| answer.json()["problem"].is_null() && answer.json()["pairs"].as_u64() > pairs);
        assert_eq!(page.get("/controls/left").status, 200);
        assert_eq!(page.get("/state").json()["control_changes"], 1);
    });
}

#[test]
fn a_port_that_is_taken_is_refused_with_what_to_do() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let (_, states) = watch::channel(Arc::new(State::new(&pb3dp_hal_api::StereoCameraInfo {
        name: "none".to_owned(),
        size: pb3dp_geometry::ImageSize { width: 1, height: 1 },
        period: None,
    })));
    let (_, images) = watch::channel(None);
    let (ask, _) = sync_channel(1);
    let error = Server::start(taken.local_addr().unwrap(), Sources { states, images, ask }).err().unwrap();
    assert!(format!("{error:#}").contains("give another --port"), "{error:#}");
}
