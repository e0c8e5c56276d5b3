//! The WebSocket protocol of Foxglove: <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>.
//!
//! Its subprotocols `foxglove.websocket.v1` and `foxglove.sdk.v1` agree in the messages used here.

use std::net::IpAddr;

use serde_json::{Value, json};

use crate::encoded::Encoded;

/// Subprotocols, the preferred one first.
const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Pages on the internet that may connect: viewers of Foxglove in a browser.
const ORIGINS: [&str; 2] = ["https://app.foxglove.dev", "https://studio.foxglove.dev"];
/// First byte of a message of a channel.
const MESSAGE_DATA: u8 = 1;

/// What a client may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Request {
    /// Messages of a channel, under a number of the client's choice.
    Subscribe { id: u32, channel: u64 },
    /// The end of a subscription.
    Unsubscribe { id: u32 },
}

/// The subprotocol for a client that offers some, by commas.
pub(super) fn chosen(offered: &str) -> Option<&'static str> {
    SUBPROTOCOLS.into_iter().find(|known| offered.split(',').any(|one| one.trim() == *known))
}

/// Whether a page of this origin may connect. Otherwise every page that the operator visits could see what the cameras see.
///
/// Pages of this computer may, and those of the computer that the client connected to by its number (a name may be the attacker's), and
/// applications, whose origin is not a page.
pub(super) fn may_connect(origin: &str, host: &str) -> bool {
    if ORIGINS.contains(&origin) {
        return true;
    }
    let Some((scheme, rest)) = origin.split_once("://") else { return false };
    if !["http", "https"].contains(&scheme) {
        return true;
    }
    let of_page = host_name(rest);
    let is_local = |name: &str| name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback());
    let is_address = of_page.parse::<IpAddr>().is_ok();
    of_page == "localhost" || is_local(of_page) || (is_address && of_page == host_name(host))
}

/// The host of `host:port`, without the brackets of IPv6.
fn host_name(text: &str) -> &str {
    match text.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(rest),
        None => text.split(':').next().unwrap_or(text),
    }
}

pub(super) fn server_info() -> String {
    let name = concat!("pb3dp ", env!("CARGO_PKG_VERSION"));
    json!({"op": "serverInfo", "name": name, "capabilities": [], "metadata": {}}).to_string()
}

/// A channel with the topic, type and definition of a message.
pub(super) fn channel(id: u32, message: &Encoded) -> Value {
    let (name, definition) = (message.schema)();
    json!({
        "id": id, "topic": message.topic, "encoding": "cdr", "schemaName": name, "schema": definition, "schemaEncoding": "ros2msg",
    })
}

pub(super) fn advertise(channels: &[Value]) -> String {
    json!({"op": "advertise", "channels": channels}).to_string()
}

/// A message for the log of the viewer.
pub(super) fn warning(message: &str) -> String {
    json!({"op": "status", "level": 1, "message": message}).to_string()
}

/// A message of a channel.
pub(super) fn message_data(subscription: u32, message: &Encoded) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(13 + message.data.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&message.at.as_nanos().to_le_bytes());
    bytes.extend_from_slice(&message.data);
    bytes
}

/// The requests in a text of a client; all other operations ask for what this server does not offer, and are ignored.
///
/// # Errors
/// A text that is not of this protocol.
pub(super) fn requests(text: &str) -> Result<Vec<Request>, &'static str> {
    let value: Value = serde_json::from_str(text).map_err(|_| "not JSON")?;
    let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok()).ok_or("no number");
    let list = |key: &str| value[key].as_array().ok_or("no list");
    match value["op"].as_str().ok_or("no operation")? {
        "subscribe" => {
            let one = |one: &Value| {
                let channel = one["channelId"].as_u64().ok_or("no number")?;
                Ok(Request::Subscribe { id: number(&one["id"])?, channel })
            };
            list("subscriptions")?.iter().map(one).collect()
        }
        "unsubscribe" => {
            list("subscriptionIds")?.iter().map(|id| Ok(Request::Unsubscribe { id: number(id)? })).collect()
        }
        _ => Ok(Vec::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newer_subprotocol_is_chosen_and_others_are_refused() {
        assert_eq!(chosen("foxglove.websocket.v1, foxglove.sdk.v1"), Some("foxglove.sdk.v1"));
        assert_eq!(chosen("foxglove.websocket.v1"), Some("foxglove.websocket.v1"));
        assert_eq!(chosen("foxglove.sdk.v1.1,chat"), None);
    }

    #[test]
    fn pages_of_others_are_refused() {
        let check = |origin: &str, host: &str, expected: bool| {
            assert_eq!(may_connect(origin, host), expected, "{origin} at {host}");
        };
        check("http://localhost:8080", "127.0.0.1:8765", true);
        check("http://[::1]:8080", "localhost:8765", true);
        check("https://app.foxglove.dev", "localhost:8765", true);
        check("file://", "localhost:8765", true);
        check("http://192.168.1.5:8080", "192.168.1.5:8765", true);
        check("http://192.168.1.6:8080", "192.168.1.5:8765", false);
        check("https://evil.example", "127.0.0.1:8765", false);
        // A name that the attacker has turned to this computer.
        check("http://evil.example:8765", "evil.example:8765", false);
        check("http://localhost.evil.example", "127.0.0.1:8765", false);
        check("https://app.foxglove.dev.evil.example", "127.0.0.1:8765", false);
        check("null", "127.0.0.1:8765", false);
    }

    #[test]
    fn requests_are_read_and_everything_else_is_ignored_or_refused() {
        let subscribe = r#"{"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 3}]}"#;
        assert_eq!(requests(subscribe), Ok(vec![Request::Subscribe { id: 7, channel: 3 }]));
        let unsubscribe = r#"{"op": "unsubscribe", "subscriptionIds": [7, 8]}"#;
        assert_eq!(requests(unsubscribe).unwrap()[1], Request::Unsubscribe { id: 8 });
        assert_eq!(requests(r#"{"op": "advertise", "channels": [{"id": 1}]}"#), Ok(Vec::new()));
        for wrong in ["", "[]", "{}", r#"{"op": "subscribe"}"#, r#"{"op": "unsubscribe", "subscriptionIds": [-1]}"#] {
            assert!(requests(wrong).is_err(), "{wrong}");
        }
        assert!(requests(&"[".repeat(60_000)).is_err());
    }
}
