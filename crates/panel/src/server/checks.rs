//! Checks of every request: host, origin, token, further connections.

use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::Ordering;
use std::time::Instant;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::answers::with_headers;
use super::app::App;
use super::assets::shortened;
use super::{CONNECTIONS_MAX, Peer};
use crate::config::Protection;
use crate::hub::Hub;
use crate::refusal::Refusal;
use crate::secrets::{Session, is_same};

/// Header with the session.
const SESSION: HeaderName = HeaderName::from_static("pb3dp-session");

/// Refuses a request before anybody reads its body, and adds the headers of every answer.
pub async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let is_api = request.uri().path().starts_with("/api/");
    let response = match check(&app.hub, &request) {
        Ok(()) => next.run(request).await,
        Err(refusal) => {
            if app.refusals.may_log(Instant::now()) {
                let path = shortened(request.uri().path());
                tracing::warn!(target: "pb3dp_panel::audit", path, "refused: {refusal}");
            }
            refusal.into_response()
        }
    };
    with_headers(response, is_api)
}

fn check(hub: &Hub, request: &Request) -> Result<(), Refusal> {
    let path = request.uri().path();
    let protection = hub.config.protection.as_ref();
    check_host(request.headers(), protection)?;
    check_origin(request.headers(), protection.is_some())?;
    // A browser cannot send this header with a WebSocket: the token is in its first message then. The files of the page have no secret;
    // the page asks for the token.
    if path.starts_with("/api/") && path != "/api/events" {
        check_token(bearer(request.headers()), protection)?;
    }
    let is_urgent = matches!(path, "/api/stop" | "/api/hold");
    let peer = request.extensions().get::<Peer>();
    if let Some(peer) = peer.filter(|_| is_urgent) {
        peer.has_asked.store(true, Ordering::SeqCst);
    }
    if peer.is_some_and(|peer| peer.is_urgent_only) && !is_urgent {
        return Err(Refusal::Connections { limit: CONNECTIONS_MAX });
    }
    Ok(())
}

/// A page from elsewhere may give its own name the address of this computer (DNS rebinding); an address it cannot invent.
fn check_host(headers: &HeaderMap, protection: Option<&Protection>) -> Result<(), Refusal> {
    let mut hosts = headers.get_all(header::HOST).iter();
    let host = hosts.next().and_then(|host| host.to_str().ok()).unwrap_or_default();
    let name = name_in(host);
    let is_address = name.parse::<IpAddr>().is_ok();
    let is_of_certificate =
        protection.is_some_and(|protection| protection.host_names.iter().any(|known| known.eq_ignore_ascii_case(name)));
    if hosts.next().is_none() && (is_address || name.eq_ignore_ascii_case("localhost") || is_of_certificate) {
        return Ok(());
    }
    Err(Refusal::ForeignHost { host: shortened(host) })
}

/// The host without port and brackets; empty if the rest is no port.
fn name_in(host: &str) -> &str {
    if let Ok(SocketAddr::V6(_)) = host.parse::<SocketAddr>() {
        return host.trim_start_matches('[').rsplit_once("]:").map_or("", |(name, _)| name);
    }
    if let Some(name) = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
        return name;
    }
    match host.split_once(':') {
        None => host,
        Some((name, port)) if port.parse::<u16>().is_ok() => name,
        Some(_) => "",
    }
}

/// Only a page of this panel may send requests; a script sends no such header.
fn check_origin(headers: &HeaderMap, is_https: bool) -> Result<(), Refusal> {
    let mut origins = headers.get_all(header::ORIGIN).iter();
    let Some(origin) = origins.next() else { return Ok(()) };
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let own = format!("{}://{host}", if is_https { "https" } else { "http" });
    let origin = String::from_utf8_lossy(origin.as_bytes());
    if origins.next().is_none() && origin == own {
        return Ok(());
    }
    Err(Refusal::ForeignOrigin { origin: shortened(&origin) })
}

/// The token of a request.
pub fn bearer(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ")
}

/// Checks a token, if the panel has one.
///
/// # Errors
/// If it is missing or wrong.
pub fn check_token(token: Option<&str>, protection: Option<&Protection>) -> Result<(), Refusal> {
    let Some(protection) = protection else { return Ok(()) };
    match token {
        Some(token) if is_same(token.as_bytes(), protection.token.as_bytes()) => Ok(()),
        _ => Err(Refusal::NoToken),
    }
}

/// The session of a request.
pub fn session_in(headers: &HeaderMap) -> Option<Session> {
    Session::from_hex(headers.get(SESSION)?.to_str().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_are_read_with_and_without_a_port() {
        for (host, name) in [
            ("localhost", "localhost"),
            ("localhost:8087", "localhost"),
            ("127.0.0.1:8087", "127.0.0.1"),
            ("[::1]:8087", "::1"),
            ("[::1]", "::1"),
            ("127.0.0.1:8087.evil.example", ""),
            ("localhost.evil.example", "localhost.evil.example"),
            ("", ""),
        ] {
            assert_eq!(name_in(host), name, "{host}");
        }
    }
}
