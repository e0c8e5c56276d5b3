//! A protected panel: token and TLS.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;

use pb3dp_panel::{Certificate, Protection};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use serde_json::json;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

use crate::support::{Rig, TIMEOUT};

const TOKEN: &str = "0123456789abcdefghij";

type Stream = StreamOwned<ClientConnection, TcpStream>;

fn protected() -> Rig {
    let host_names = vec!["robot.lab.example".to_owned()];
    let protection = Protection { token: TOKEN.to_owned(), certificate: Certificate::Own, host_names };
    Rig::with(|config| config.protection = Some(protection), false)
}

fn connect(rig: &Rig) -> Stream {
    let mut roots = RootCertStore::empty();
    let pem = rig.panel.as_ref().unwrap().certificate_pem().unwrap();
    roots.add(CertificateDer::from_pem_slice(pem.as_bytes()).unwrap()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let config = builder.with_root_certificates(roots).with_no_client_auth();
    let name = ServerName::try_from("localhost").unwrap();
    let socket = TcpStream::connect(rig.address()).unwrap();
    socket.set_read_timeout(Some(TIMEOUT)).unwrap();
    StreamOwned::new(ClientConnection::new(Arc::new(config), name).unwrap(), socket)
}

fn status(rig: &Rig, method: &str, path: &str, head: &str) -> u16 {
    let mut stream = connect(rig);
    let text = format!(
        "{method} {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n{head}Content-Length: 2\r\n\r\n{{}}"
    );
    stream.write_all(text.as_bytes()).unwrap();
    let mut answer = Vec::new();
    // The end without a farewell is an error of this client, after the answer.
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0)
}

#[test]
fn every_request_needs_the_token_but_the_files_of_the_page() {
    let rig = protected();
    let panel = rig.panel.as_ref().unwrap();
    assert!(panel.url().starts_with("https://127.0.0.1:"));
    assert_eq!(panel.fingerprint().unwrap().len(), 32 * 3 - 1);
    let right = format!("Authorization: Bearer {TOKEN}\r\n");
    for (method, path) in [("GET", "/api/state"), ("GET", "/api/info"), ("POST", "/api/stop"), ("POST", "/api/lease")] {
        assert_eq!(status(&rig, method, path, ""), 401, "{path}");
        assert_eq!(status(&rig, method, path, "Authorization: Bearer 0123456789abcdefghiJ\r\n"), 401, "{path}");
        assert_eq!(status(&rig, method, &format!("{path}?token={TOKEN}"), ""), 401, "never in the URL");
    }
    assert_eq!(status(&rig, "GET", "/", ""), 200);
    assert_eq!(status(&rig, "GET", "/api/info", &right), 200);
    assert_eq!(status(&rig, "GET", "/api/info", &format!("{right}Origin: http://localhost\r\n")), 403, "not encrypted");
    assert_eq!(status(&rig, "GET", "/api/info", &format!("{right}Origin: https://localhost\r\n")), 200);
    assert_eq!(rig.client().get("/").status, 0, "no answer without TLS");
}

#[test]
fn a_page_sends_the_token_in_its_first_message() {
    let rig = protected();
    let open = |hello: serde_json::Value| {
        let request = "wss://localhost/api/events".into_client_request().unwrap();
        let (mut socket, _): (WebSocket<Stream>, _) = tungstenite::client(request, connect(&rig)).unwrap();
        socket.send(Message::text(hello.to_string())).unwrap();
        let Message::Text(text) = socket.read().unwrap() else { panic!("no text") };
        serde_json::from_str::<serde_json::Value>(&text).unwrap()
    };
    let refused = open(json!({ "type": "hello", "protocol": 1 }));
    assert_eq!((&refused["accepted"], &refused["code"]), (&json!(false), &json!("PB3DP-PAN-012")));
    let accepted = open(json!({ "type": "hello", "protocol": 1, "token": TOKEN }));
    assert_eq!(accepted["accepted"], true);
}
