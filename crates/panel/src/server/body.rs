//! Bodies of POST requests: JSON of a known type, within limits.

use std::time::Duration;

use axum::extract::Request;
use axum::http::header;
use http_body_util::{BodyExt, LengthLimitError, Limited};
use serde::de::DeserializeOwned;

use super::assets::shortened;
use crate::refusal::Refusal;

/// Largest body, bytes.
pub const BODY_MAX: usize = 64 * 1024;
/// Time limit of a body.
const BODY_TIME: Duration = Duration::from_secs(5);

/// The body of a request; an empty one counts as `{}`.
///
/// # Errors
/// Another content type, a body that is too large, too slow or not understood.
pub async fn read<T: DeserializeOwned>(request: Request) -> Result<T, Refusal> {
    check_is_json(&request)?;
    let body = tokio::time::timeout(BODY_TIME, Limited::new(request.into_body(), BODY_MAX).collect()).await;
    let body = body.map_err(|_| Refusal::SlowBody { limit_s: BODY_TIME.as_secs() })?;
    let body = body.map_err(|error| match error.is::<LengthLimitError>() {
        true => Refusal::TooLarge { limit: BODY_MAX },
        false => Refusal::Body { cause: error.to_string() },
    })?;
    parse(&body.to_bytes())
}

/// Refuses a request whose body is not announced as JSON.
///
/// # Errors
/// Another content type.
pub fn check_is_json(request: &Request) -> Result<(), Refusal> {
    // Pages from elsewhere cannot send this type unasked.
    let kind = request.headers().get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    let is_json = kind.split(';').next().is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"));
    if is_json { Ok(()) } else { Err(Refusal::ContentType { kind: shortened(kind) }) }
}

/// JSON of a known type.
///
/// # Errors
/// What is wrong, with line and column.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Refusal> {
    let bytes = if bytes.iter().all(u8::is_ascii_whitespace) { b"{}" } else { bytes };
    serde_json::from_slice(bytes).map_err(|error| Refusal::Body { cause: error.to_string() })
}
