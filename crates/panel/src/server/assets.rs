//! The files of the page, inside the binary.

use axum::http::Method;
use axum::response::Response;

use super::answers::of_kind;
use crate::refusal::Refusal;

macro_rules! files {
    ($($name:literal)*) => { &[$(($name, include_bytes!(concat!("../../assets/", $name)))),*] };
}

/// Every file of the folder `assets`.
const FILES: &[(&str, &[u8])] = files![
    "favicon.svg" "index.html" "panel.css"
    "js/cameras.js" "js/codes.js" "js/commands.js" "js/connection.js" "js/controls.js" "js/dom.js" "js/hold_to_run.js"
    "js/jog.js" "js/joints.js" "js/main.js" "js/pace.js" "js/plots.js" "js/pointing.js" "js/scene.js" "js/status.js"
    "js/token.js" "js/types.js" "js/view.js"
    "vendor/uplot/LICENSE" "vendor/uplot/uPlot.iife.min.js" "vendor/uplot/uPlot.min.css"
];

/// The file at a path.
///
/// # Errors
/// If there is none, or the method is not GET.
pub fn asset(method: &Method, path: &str) -> Result<Response, Refusal> {
    if !matches!(*method, Method::GET | Method::HEAD) {
        return Err(Refusal::Method { path: shortened(path), method: shortened(method.as_str()), allowed: "GET" });
    }
    let name = if path == "/" { "index.html" } else { path.trim_start_matches('/') };
    let file = FILES.iter().find(|file| file.0 == name).ok_or_else(|| Refusal::NotFound { path: shortened(path) })?;
    Ok(of_kind(kind_of(name), file.1))
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn paths(folder: &Path) -> Vec<std::path::PathBuf> {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        entries.flat_map(|path| if path.is_dir() { paths(&path) } else { vec![path] }).collect()
    }

    #[test]
    fn every_file_of_the_folder_is_in_the_program() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
        let mut found: Vec<String> =
            paths(&folder).iter().map(|path| path.strip_prefix(&folder).unwrap().display().to_string()).collect();
        found.sort_unstable();
        let mut listed: Vec<&str> = FILES.iter().map(|file| file.0).collect();
        listed.sort_unstable();
        assert_eq!(found, listed);
    }
}
