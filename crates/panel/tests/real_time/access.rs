//! Who may send what: origins, hosts, methods, addresses.

use std::net::SocketAddr;

use pb3dp_hal_clock::SystemClock;
use pb3dp_panel::{About, Certificate, Panel, PanelConfig, Protection, TlsFiles};

use crate::support::{Page, Rig, setup};

const POSTS: [&str; 14] = [
    "lease",
    "heartbeat",
    "select",
    "start",
    "resume",
    "re-align",
    "reset",
    "hold",
    "stop",
    "speed",
    "jog",
    "preview",
    "push",
    "controls",
];
const GETS: [&str; 7] =
    ["/", "/api/info", "/api/state", "/api/controls", "/api/cameras", "/api/epipolar?u=1&v=2", "/api/nothing"];
const JSON: &str = "Content-Type: application/json\r\n";

#[test]
fn a_foreign_origin_is_refused_on_every_path_also_stop() {
    let rig = Rig::new();
    let client = rig.holder();
    let port = rig.address().port();
    let origins = [
        "http://evil.example".to_owned(),
        "null".to_owned(),
        format!("https://127.0.0.1:{port}"),
        format!("http://127.0.0.1:{}", port ^ 1),
        format!("http://localhost:{port}"),
        format!("http://127.0.0.1:{port}.evil.example"),
    ];
    for origin in &origins {
        let head = format!("{JSON}Origin: {origin}\r\n");
        for post in POSTS {
            let reply = client.request("POST", &format!("/api/{post}"), &head, "{}");
            assert_eq!((reply.status, reply.code().as_str()), (403, "PB3DP-PAN-010"), "{post} {origin}");
        }
        for get in GETS {
            assert_eq!(client.request("GET", get, &head, "").status, 403, "{get} {origin}");
        }
        assert_eq!(client.request("OPTIONS", "/api/stop", &head, "").status, 403);
        assert!(Page::connect(rig.address(), Some(origin)).err().unwrap().contains("403"));
    }
    assert!(rig.observed.lock().unwrap().commands.is_empty(), "nothing reached the control thread");
    let two = format!("{JSON}Origin: http://127.0.0.1:{port}\r\nOrigin: http://evil.example\r\n");
    assert_eq!(client.request("POST", "/api/stop", &two, "{}").status, 403);
    let own = format!("{JSON}Origin: http://127.0.0.1:{port}\r\n");
    assert_eq!(client.request("POST", "/api/stop", &own, "{}").status, 200);
    assert!(Page::connect(rig.address(), Some(&format!("http://127.0.0.1:{port}"))).is_ok());
}

#[test]
fn a_host_name_of_somebody_else_is_refused() {
    let rig = Rig::new();
    let client = rig.client();
    let port = rig.address().port();
    for host in
        [format!("evil.example:{port}"), "evil.example".to_owned(), "localhost.evil.example".to_owned(), String::new()]
    {
        let head = format!("{JSON}Host: {host}\r\n");
        for (method, path) in [("GET", "/"), ("GET", "/api/state"), ("POST", "/api/stop"), ("GET", "/api/events")] {
            let reply = client.request(method, path, &head, "{}");
            assert_eq!((reply.status, reply.code().as_str()), (403, "PB3DP-PAN-011"), "{method} {path} {host:?}");
        }
    }
    for host in [format!("localhost:{port}"), "127.0.0.1".to_owned(), format!("[::1]:{port}")] {
        assert_eq!(client.request("GET", "/api/state", &format!("Host: {host}\r\n"), "").status, 200, "{host}");
    }
}

#[test]
fn a_get_causes_nothing_and_other_methods_are_refused() {
    let rig = Rig::new();
    let client = rig.holder();
    for post in POSTS {
        for method in ["GET", "HEAD", "PUT", "DELETE", "PATCH"] {
            // The controls can be read, too.
            if post == "controls" && matches!(method, "GET" | "HEAD") {
                continue;
            }
            let reply = client.request(method, &format!("/api/{post}"), JSON, "{}");
            assert_eq!(reply.status, 405, "{method} {post}");
        }
    }
    assert_eq!(client.post("info", "{}").status, 405);
    assert_eq!(client.request("POST", "/", JSON, "{}").status, 405);
    assert!(rig.observed.lock().unwrap().commands.is_empty());
}

#[test]
fn answers_have_the_headers_that_protect_the_page() {
    let rig = Rig::new();
    let page = rig.client().get("/");
    assert_eq!(page.status, 200);
    let head = page.head.to_ascii_lowercase();
    for line in [
        "content-security-policy: default-src 'self'; img-src 'self' blob: data:;",
        "frame-ancestors 'none'",
        "x-content-type-options: nosniff",
        "referrer-policy: no-referrer",
        "cache-control: no-cache",
        "content-type: text/html; charset=utf-8",
    ] {
        assert!(head.contains(line), "{line}: {head}");
    }
    assert!(!head.contains("unsafe-inline") && !head.contains("set-cookie") && !head.contains("access-control"));
    assert!(rig.client().get("/api/state").head.to_ascii_lowercase().contains("cache-control: no-store"));
    assert!(rig.client().get("/../Cargo.toml").status == 404);
}

#[test]
fn only_a_protected_panel_leaves_this_computer() {
    let start = |config: PanelConfig| {
        let about = About::of_setup(&setup(), "sim", "0.0.0");
        Panel::start(config, std::sync::Arc::new(SystemClock::new()), about).err().map(|refusal| refusal.code())
    };
    let address: SocketAddr = "0.0.0.0:0".parse().unwrap();
    assert_eq!(start(PanelConfig::at(address)), Some("PB3DP-PAN-001"));
    assert_eq!(start(PanelConfig::at("[::]:0".parse().unwrap())), Some("PB3DP-PAN-001"));
    let files = TlsFiles { certificate_pem: "no certificate".to_owned(), key_pem: String::new() };
    for (token, certificate) in [("x".repeat(32), Certificate::Given(files)), ("short".to_owned(), Certificate::Own)] {
        let protection = Some(Protection { token, certificate, host_names: Vec::new() });
        assert_eq!(start(PanelConfig { protection, ..PanelConfig::at(address) }), Some("PB3DP-PAN-004"));
    }
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    assert_eq!(start(PanelConfig::at(taken.local_addr().unwrap())), Some("PB3DP-PAN-002"));
}
