//! The files of the page, inside the binary.

use axum::http::Method;
use axum::response::Response;
use rust_embed::RustEmbed;

use super::answers::of_kind;
use crate::refusal::Refusal;

#[derive(RustEmbed)]
#[folder = "assets/"]
struct Assets;

/// The file at a path.
///
/// # Errors
/// If there is none, or the method is not GET.
pub fn asset(method: &Method, path: &str) -> Result<Response, Refusal> {
    if !matches!(*method, Method::GET | Method::HEAD) {
        return Err(Refusal::Method { path: shortened(path), method: shortened(method.as_str()), allowed: "GET" });
    }
    let name = if path == "/" { "index.html" } else { path.trim_start_matches('/') };
    let file = Assets::get(name).ok_or_else(|| Refusal::NotFound { path: shortened(path) })?;
    Ok(of_kind(kind_of(name), file.data.into_owned()))
}

/// The first characters, for messages.
pub fn shortened(text: &str) -> String {
    text.chars().take(80).collect()
}

fn kind_of(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, ending)| ending) {
        Some("html") => "text/html; charset=utf-8",
        Some("js" | "mjs") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("json" | "map") => "application/json",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("ico") => "image/x-icon",
        Some("woff2") => "font/woff2",
        Some("webmanifest") => "application/manifest+json",
        Some("txt" | "md") => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}
