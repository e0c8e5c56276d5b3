//! Answers: JSON, refusals, and the headers that every answer has.

use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::messages::ErrorAnswer;
use crate::refusal::Refusal;

/// What the page may load: its own files, and images that it makes of messages. No inline script or style.
const CONTENT_SECURITY_POLICY: &str = "default-src 'self'; img-src 'self' blob: data:; connect-src 'self'; \
     object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Headers of every answer.
const HEADERS: [(HeaderName, &str); 6] = [
    (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
];

/// Adds the headers that every answer has; nothing of the API is cached, and files are checked each time.
pub fn with_headers(mut response: Response, is_api: bool) -> Response {
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    let cache = if is_api { "no-store" } else { "no-cache" };
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(cache));
    response
}

/// A JSON object.
pub fn json(value: &impl Serialize) -> Response {
    json_with(StatusCode::OK, value)
}

/// JSON text.
pub fn json_text(text: String) -> Response {
    of_kind("application/json", text)
}

/// Content of a kind.
pub fn of_kind(kind: &'static str, content: impl Into<Body>) -> Response {
    let mut response = Response::new(content.into());
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

fn json_with(status: StatusCode, value: &impl Serialize) -> Response {
    let mut response = match serde_json::to_string(value) {
        Ok(text) => json_text(text),
        Err(error) => {
            tracing::error!("an answer of the panel cannot be written: {error}; this is a bug, please report it");
            json_text("{}".to_owned())
        }
    };
    *response.status_mut() = status;
    response
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        json_with(status, &ErrorAnswer { error: self.to_string(), code: self.code() })
    }
}
