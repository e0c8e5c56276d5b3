//! Bodies of the POST requests. Unknown fields are refused.

use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::staleness::ShownState;

/// `POST /api/lease`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeaseRequest {
    /// What to do.
    pub action: LeaseAction,
    /// Name of the new holder, for all clients to see; for `take` and `take-over`.
    pub name: Option<String>,
}

/// What to do with the lease.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum LeaseAction {
    /// Take a lease that is free.
    Take,
    /// Take the lease from its holder; every arm holds.
    TakeOver,
    /// Give it back; every arm holds.
    Release,
}

/// `POST /api/heartbeat`, for scripts.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeartbeatRequest {
    /// The nonce to answer.
    pub nonce: String,
    /// Whether the page is visible; a script is.
    #[serde(default = "yes")]
    pub visible: bool,
    /// Whether the operator presses the button of hold-to-run.
    #[serde(default)]
    pub pressed: bool,
}

fn yes() -> bool {
    true
}

/// `POST /api/select`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelectRequest {
    /// `rect:X,Y,W,H`, `poly:X1,Y1;X2,Y2;...` or `click:X,Y`.
    pub region: Option<String>,
    /// The pair on which it was drawn; default: the newest.
    pub sequence: Option<u64>,
    /// Name of the target, to choose it again by `saved`.
    pub name: Option<String>,
    /// Name of a target chosen before, instead of a region.
    pub saved: Option<String>,
    /// What the operator saw.
    #[serde(rename = "seen")]
    pub shown: ShownState,
}

/// `POST /api/start`, `resume`, `reset`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShownRequest {
    /// What the operator saw.
    #[serde(rename = "seen")]
    pub shown: ShownState,
}

/// `POST /api/hold`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HoldRequest {
    /// Holds the camera arm alone.
    #[serde(default)]
    pub hand_only: bool,
    /// Accepted so that a script can send it with every command; not read, because a hold only ends motion.
    #[serde(default)]
    #[serde(rename = "seen")]
    pub shown: IgnoredAny,
}

/// `POST /api/speed`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpeedRequest {
    /// Share of what the setup allows, percent.
    pub percent: f64,
    /// What the operator saw.
    #[serde(rename = "seen")]
    pub shown: ShownState,
}

/// `POST /api/jog`: absolute offset of the desired pose of the hand, in axes of the hand.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JogRequest {
    /// Along x, y and z, millimetres.
    pub offset_mm: [f64; 3],
    /// Rotation vector, degrees.
    pub offset_deg: [f64; 3],
    /// What the operator saw.
    #[serde(rename = "seen")]
    pub shown: ShownState,
}

/// `POST /api/preview`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PreviewRequest {
    /// As in [`SelectRequest`]; without it, nothing is computed: drawing begins.
    pub region: Option<String>,
    /// The pair on which it is drawn; default: the newest. The pair is kept for the selection.
    pub sequence: Option<u64>,
}

/// `POST /api/push`: where the simulated target is pushed to, relative to its start.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PushRequest {
    /// Along x, y and z, millimetres.
    pub offset_mm: [f64; 3],
    /// About the normal, degrees.
    #[serde(default)]
    pub turn_deg: f64,
    /// As in [`HoldRequest`]: a push moves no arm by itself.
    #[serde(default)]
    #[serde(rename = "seen")]
    pub shown: IgnoredAny,
}

/// `POST /api/controls`: a control of a real camera.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlRequest {
    /// The camera.
    pub side: CameraSide,
    /// Number of the control.
    pub id: u32,
    /// New value, in units of the driver.
    pub value: i32,
    /// As in [`HoldRequest`]: the server itself checks that no arm may move.
    #[serde(default)]
    #[serde(rename = "seen")]
    pub shown: IgnoredAny,
}

/// One of the two cameras.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum CameraSide {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl CameraSide {
    /// 0: left, 1: right.
    pub fn index(self) -> usize {
        self as usize
    }
}
