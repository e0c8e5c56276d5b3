//! Messages of the WebSocket at `/api/events`.

use serde::{Deserialize, Serialize};

/// Version of the protocol.
pub const PROTOCOL: u32 = 1;

/// A message of a client.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ClientMessage {
    /// The first message.
    Hello {
        /// Version of the protocol.
        protocol: u32,
        /// Session of the holder of the lease; null for others.
        #[serde(default)]
        session: Option<String>,
        /// Token, where the panel is protected and the client cannot send headers.
        #[serde(default)]
        token: Option<String>,
    },
    /// Which images the client wants.
    Images {
        /// Left images.
        left: bool,
        /// Right images.
        right: bool,
        /// Raw or rectified; default raw.
        #[serde(default)]
        view: ImageView,
        /// Highest rate; default 30.
        #[serde(default)]
        fps_max: Option<f64>,
        /// Also heat overlays of the residual in the left image, 5 per second; with raw images.
        #[serde(default)]
        heat: bool,
    },
    /// Answer to a heartbeat.
    Heartbeat {
        /// The nonce of the server.
        nonce: String,
        /// Whether the page is visible.
        visible: bool,
        /// Whether the operator presses the button of hold-to-run.
        #[serde(default)]
        pressed: bool,
    },
    /// As `POST /api/stop`, from everybody: a page has this connection already.
    Stop {},
}

/// Raw or rectified images.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum ImageView {
    /// As the camera delivers them.
    #[default]
    Raw,
    /// With horizontal epipolar lines, without distortion.
    Rectified,
}

/// A message of the server, but for states and images.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum ServerMessage {
    /// Answer the nonce at once.
    Heartbeat {
        /// The nonce.
        nonce: String,
    },
    /// New lines of the log.
    Log {
        /// The lines, oldest first.
        lines: Vec<LogLine>,
    },
    /// Answer to a message that was refused, or to `hello`.
    Answer {
        /// Which message it answers.
        to: &'static str,
        /// Whether it was accepted.
        accepted: bool,
        /// One line why not.
        #[serde(skip_serializing_if = "Option::is_none")]
        error: Option<String>,
        /// Code of that line.
        #[serde(skip_serializing_if = "Option::is_none")]
        code: Option<&'static str>,
    },
}

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogLine {
    /// Time on the run's clock.
    pub time_ms: f64,
    /// `info`, `warn` or `error`.
    pub level: &'static str,
    /// The text.
    pub text: String,
    /// Code of the message, if it has one.
    pub code: Option<String>,
}
