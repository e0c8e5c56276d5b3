//! Refusals of the panel: one line each with the value and the remedy, an HTTP status and a code.

use pb3dp_message_codes::{Coded, codes};
use pb3dp_servo::supervisor;

/// Why the panel refuses a request, or does not start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The address is reachable from other computers, and the panel is not protected.
    #[error(
        "{address} can be reached from other computers: this needs a token file and TLS; configure both, or use 127.0.0.1"
    )]
    Unprotected {
        /// The address.
        address: String,
    },
    /// The address cannot be used.
    #[error("{address} cannot be used for the panel ({cause}); use another address, or port 0 for any free port")]
    Address {
        /// The address.
        address: String,
        /// Message of the system.
        cause: String,
    },
    /// The system provides no thread or no event loop.
    #[error("no thread for the panel: {cause}")]
    Thread {
        /// Message of the system.
        cause: String,
    },
    /// The token or the certificate cannot be used.
    #[error("{what}")]
    Protection {
        /// What is wrong, with the remedy.
        what: String,
    },
    /// The request comes from a page of another origin.
    #[error("requests of pages from {origin:?} are refused; open the panel by its own address")]
    ForeignOrigin {
        /// The header.
        origin: String,
    },
    /// The host name is not one of this panel.
    #[error("the header `Host` is {host:?}; use localhost, an IP address, or a host name of the certificate")]
    ForeignHost {
        /// The header.
        host: String,
    },
    /// The token is missing or wrong.
    #[error("the token is missing or wrong; send `Authorization: Bearer TOKEN`")]
    NoToken,
    /// There is nothing at this path.
    #[error("{path:?} does not exist; docs/reference/panel-api.md lists all paths")]
    NotFound {
        /// The path, shortened.
        path: String,
    },
    /// The path has another method.
    #[error("{path}: the method {method} is not allowed; use {allowed}")]
    Method {
        /// The path.
        path: String,
        /// The method of the request.
        method: String,
        /// The methods of the path.
        allowed: &'static str,
    },
    /// The body is not announced as JSON.
    #[error("the content type is {kind:?}; send application/json")]
    ContentType {
        /// The header, shortened.
        kind: String,
    },
    /// The body is too large.
    #[error("the body has more than {limit} bytes; send less")]
    TooLarge {
        /// The limit, bytes.
        limit: usize,
    },
    /// The body is not the JSON of this request.
    #[error("the body is not understood: {cause}")]
    Body {
        /// Message of the parser.
        cause: String,
    },
    /// The body did not arrive in time.
    #[error("the body did not arrive within {limit_s} s; repeat the request")]
    SlowBody {
        /// The limit, seconds.
        limit_s: u64,
    },
    /// Too many requests.
    #[error("more than {limit} requests per second; send fewer")]
    TooMany {
        /// The limit, requests per second.
        limit: u32,
    },
    /// Too many connections.
    #[error("{limit} connections are open; close one (`stop` is always accepted)")]
    Connections {
        /// The limit.
        limit: usize,
    },
    /// The session does not hold the lease.
    #[error("this session does not hold the lease ({holder}); take it with POST /api/lease")]
    NotHolder {
        /// Who holds it, in words.
        holder: String,
    },
    /// Another session holds the lease.
    #[error("{name:?} (number {id}) holds the lease; use the action take-over, every arm then holds")]
    Held {
        /// Name of the holder.
        name: String,
        /// Number of the holder.
        id: u64,
    },
    /// The nonce of a heartbeat does not count.
    #[error("the nonce of this heartbeat is unknown, used or too old; answer the newest one")]
    Nonce,
    /// The command refers to another state.
    #[error("{command} refused: the page showed state number {shown}, now it is {current}; check, then repeat it")]
    OtherState {
        /// The command.
        command: &'static str,
        /// State number of the command.
        shown: u64,
        /// Present state number.
        current: u64,
    },
    /// The command refers to another target.
    #[error("{command} refused: the page showed {shown}, now it is {current}; check, then repeat it")]
    OtherTarget {
        /// The command.
        command: &'static str,
        /// Target of the command, in words.
        shown: String,
        /// Present target, in words.
        current: String,
    },
    /// The state that the command refers to is too old, or from the future.
    #[error(
        "{command} refused: the page showed a state that is {age_ms:.0} ms old, limit 0 to {limit_ms:.0} ms; reload the page"
    )]
    OldState {
        /// The command.
        command: &'static str,
        /// Age, milliseconds; negative for a future time.
        age_ms: f64,
        /// Limit, milliseconds.
        limit_ms: f64,
    },
    /// A command before this one was given later.
    #[error(
        "{command} refused: a command that was given {late_ms:.0} ms later came first; repeat it if you still want it"
    )]
    OutOfOrder {
        /// The command.
        command: &'static str,
        /// How much earlier than the other one, milliseconds.
        late_ms: f64,
    },
    /// Too many commands wait.
    #[error("{command} refused: {limit} commands are waiting; repeat it (`stop` and `hold` need no space)")]
    QueueFull {
        /// The command.
        command: &'static str,
        /// Size of the queue.
        limit: usize,
    },
    /// The arms are still being enabled, or the run is over.
    #[error("{command} refused: {why}")]
    NotRunning {
        /// The command.
        command: &'static str,
        /// The reason with the remedy.
        why: &'static str,
    },
    /// The button of hold-to-run is not pressed.
    #[error(
        "{command} refused: this setup moves arms only while the button is pressed; press it, then repeat the command"
    )]
    NotPressed {
        /// The command.
        command: &'static str,
    },
    /// No control step took the command in time.
    #[error(
        "{command}: no control step took the command within {limit_ms} ms; check the state, use the emergency stop if an arm moves"
    )]
    NotTaken {
        /// The command.
        command: &'static str,
        /// The limit, milliseconds.
        limit_ms: u64,
    },
    /// A preview that was not computed in time.
    #[error(
        "preview: not computed within {limit_ms} ms: this computer is too busy; mark the region again, or close other programs"
    )]
    PreviewLate {
        /// The limit, milliseconds.
        limit_ms: u64,
    },
    /// A later `stop` or `hold` overtook the command, or the program was suspended.
    #[error("{command} refused: {why}; check the state, then repeat it")]
    Overtaken {
        /// The command.
        command: &'static str,
        /// The reason.
        why: &'static str,
    },
    /// The supervisor refuses the command.
    #[error("{0}")]
    Supervisor(supervisor::Refusal),
    /// The region cannot be used.
    #[error("{why}")]
    Region {
        /// The reason with the remedy.
        why: String,
    },
    /// The images on which the region was drawn are no longer kept.
    #[error("frame pair {sequence} is no longer kept (the newest is {newest}); draw the region again on a newer image")]
    PairGone {
        /// The pair of the request.
        sequence: u64,
        /// The newest pair.
        newest: u64,
    },
    /// There are no images.
    #[error("no frame pair yet; check the cameras, or wait for the first pair")]
    NoImages,
    /// No target of this name.
    #[error("no target is saved as {name:?}; saved are: {known}")]
    NotSaved {
        /// The name.
        name: String,
        /// The saved names, in words.
        known: String,
    },
    /// A jog that is too large.
    #[error("jog refused: {what} is {value:.2} {unit}, limit {limit:.2} {unit}; use smaller steps")]
    Jog {
        /// Which quantity.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The limit.
        limit: f64,
        /// The unit of both.
        unit: &'static str,
    },
    /// A number out of its range.
    #[error("{key} is {value}, allowed is {least} to {most}")]
    Range {
        /// The key.
        key: &'static str,
        /// The value.
        value: f64,
        /// Smallest allowed value.
        least: f64,
        /// Largest allowed value.
        most: f64,
    },
    /// This panel has no such part.
    #[error("{what} is not available here: {why}")]
    NotHere {
        /// The part.
        what: &'static str,
        /// The reason.
        why: String,
    },
    /// The cameras refuse a change of a control.
    #[error("controls: {why}")]
    Control {
        /// The reason with the remedy.
        why: String,
    },
    /// Controls of cameras are changed only while no arm moves.
    #[error("controls refused: {why}")]
    MayMove {
        /// The reason with the remedy.
        why: &'static str,
    },
    /// Motion begins only after a change of a control is finished.
    #[error("{command} refused: a camera control is being set; repeat the command")]
    Changing {
        /// The command.
        command: &'static str,
    },
    /// A message of a WebSocket that breaks the protocol.
    #[error("the message is refused: {why}")]
    Protocol {
        /// The reason with the remedy.
        why: String,
    },
}

codes! {
    Refusal, "The operator panel" {
        Unprotected = "PB3DP-PAN-001": "The panel would be reachable from other computers without a token and encryption."; "Use a loopback address, or configure a token file and TLS.";
        Address = "PB3DP-PAN-002": "The address of the panel is in use, or does not belong to this computer."; "Give another address or port.";
        Thread = "PB3DP-PAN-003": "The system provides no thread or no event loop for the panel."; "Close other programs, or raise the limits of the user.";
        Protection = "PB3DP-PAN-004": "The token file, the certificate or its key cannot be used."; "Correct the file that the message names.";
        ForeignOrigin = "PB3DP-PAN-010": "A page of another origin has sent the request."; "Open the panel by the address that the program prints.";
        ForeignHost = "PB3DP-PAN-011": "The request names a host that is not this panel; a page may have redirected a name to this address."; "Open the panel by localhost, by an IP address, or by a host name of the certificate.";
        NoToken = "PB3DP-PAN-012": "The token of the request is missing or wrong."; "Send the token of the token file in the header `Authorization`.";
        NotFound = "PB3DP-PAN-013": "There is nothing at this path."; "Use a path of docs/reference/panel-api.md.";
        Method = "PB3DP-PAN-014": "The path does not accept this method. No GET request causes motion."; "Use the method that the message names.";
        ContentType = "PB3DP-PAN-015": "The body of a POST is not announced as JSON."; "Send the header `Content-Type: application/json`.";
        TooLarge = "PB3DP-PAN-016": "The body of the request is too large."; "Send less, for example a polygon with fewer corners.";
        Body = "PB3DP-PAN-017": "The body of the request is not the expected JSON, or has an unknown field."; "Correct the field that the message names.";
        SlowBody = "PB3DP-PAN-018": "The body of the request arrived too slowly."; "Check the connection, then repeat the request.";
        TooMany = "PB3DP-PAN-019": "One client sends too many requests."; "Send fewer requests.";
        Connections = "PB3DP-PAN-020": "Too many connections are open."; "Close other pages of the panel.";
        NotHolder = "PB3DP-PAN-021": "Only the session that holds the lease may command, and this session does not hold it."; "Take the lease, or take it over.";
        Held = "PB3DP-PAN-022": "Another session holds the lease."; "Agree with its operator, then take it over: every arm holds.";
        Nonce = "PB3DP-PAN-023": "A heartbeat answers a nonce that was not sent, was answered before, or is too old."; "Answer each nonce once, within 0.2 s.";
        OtherState = "PB3DP-PAN-024": "The state changed after the page showed it, so the command may no longer be what the operator wants."; "Check the new state, then repeat the command.";
        OtherTarget = "PB3DP-PAN-025": "The target changed after the page showed it."; "Check the new target, then repeat the command.";
        OldState = "PB3DP-PAN-026": "The command refers to a state that is too old, or has a future time."; "Check the connection of the page, or reload the page.";
        QueueFull = "PB3DP-PAN-027": "More commands wait than the control loop has taken."; "Repeat the command. `stop` and `hold` are always accepted.";
        NotRunning = "PB3DP-PAN-028": "Both arms are still being enabled, or the run is over, or this panel has no arms."; "Wait until the arms are enabled, or start a new run.";
        NotTaken = "PB3DP-PAN-029": "The control loop did not take the command in time."; "Check the state. If an arm moves, use the emergency stop.";
        Overtaken = "PB3DP-PAN-030": "A later `stop` or `hold` cancelled the command, or the program was suspended meanwhile."; "Check the state, then repeat the command.";
        Supervisor = "PB3DP-PAN-031": "The supervisor refuses the command. The message has the supervisor's own code."; "Do what the message says.";
        Region = "PB3DP-PAN-032": "The region cannot be read, or is outside the image, or is unsuitable."; "Draw the region again.";
        PairGone = "PB3DP-PAN-033": "The images on which the region was drawn are no longer in memory."; "Draw the region on a newer image.";
        NoImages = "PB3DP-PAN-034": "The cameras have not delivered a frame pair yet, or this run has no images."; "Check the cameras.";
        NotSaved = "PB3DP-PAN-035": "No target was chosen by this name since the start of the program."; "Use a name from the list, or choose the target in the image.";
        Jog = "PB3DP-PAN-036": "The jog is larger than one step or the whole offset may be."; "Use smaller steps.";
        Range = "PB3DP-PAN-037": "A number of the request is out of its range."; "Use a value in the range that the message names.";
        NotHere = "PB3DP-PAN-038": "This panel does not have the part that the request needs."; "Use a setup that has it.";
        NotPressed = "PB3DP-PAN-040": "The setup wants hold-to-run, and the last heartbeat says that the button is not pressed."; "Press the button and keep it pressed, then use `start` or `resume`.";
        Control = "PB3DP-PAN-041": "The camera does not have this control, does not accept or keep the value, or does not answer."; "Use a control and a value from the list; if the camera does not answer, check plug and cable.";
        MayMove = "PB3DP-PAN-042": "An arm moves, or may begin to by itself: another exposure or focus could cost the target."; "Use `hold`, then change the control.";
        OutOfOrder = "PB3DP-PAN-044": "The command was given before another one that arrived first."; "Check speed and offset, then repeat the command if you still want it.";
        PreviewLate = "PB3DP-PAN-045": "A preview was not computed in time: the computer is too busy."; "Mark the region again, or close other programs.";
        Changing = "PB3DP-PAN-043": "A control of a camera is being set, which could cost the target while an arm moves."; "Repeat the command.";
        Protocol = "PB3DP-PAN-039": "A WebSocket message breaks the protocol."; "Reload the page; scripts: follow docs/reference/panel-api.md.";
    }
}

impl Refusal {
    /// HTTP status of the answer.
    pub fn status(&self) -> u16 {
        match self {
            Self::Unprotected { .. } | Self::Address { .. } | Self::Thread { .. } | Self::Protection { .. } => 500,
            Self::ForeignOrigin { .. } | Self::ForeignHost { .. } | Self::NotHolder { .. } => 403,
            Self::NoToken => 401,
            Self::NotFound { .. } => 404,
            Self::Method { .. } => 405,
            Self::ContentType { .. } => 415,
            Self::TooLarge { .. } => 413,
            Self::Body { .. } | Self::Region { .. } | Self::Jog { .. } | Self::Range { .. } | Self::Protocol { .. } => {
                400
            }
            Self::SlowBody { .. } => 408,
            Self::TooMany { .. } => 429,
            Self::Connections { .. } => 503,
            Self::NotTaken { .. } | Self::PreviewLate { .. } => 504,
            Self::Held { .. }
            | Self::Nonce
            | Self::OtherState { .. }
            | Self::OtherTarget { .. }
            | Self::OldState { .. }
            | Self::OutOfOrder { .. }
            | Self::QueueFull { .. }
            | Self::Control { .. }
            | Self::MayMove { .. }
            | Self::Changing { .. }
            | Self::NotRunning { .. }
            | Self::NotPressed { .. }
            | Self::Overtaken { .. }
            | Self::Supervisor(_)
            | Self::PairGone { .. }
            | Self::NoImages
            | Self::NotSaved { .. }
            | Self::NotHere { .. } => 409,
        }
    }

    /// The code: that of the supervisor if the supervisor refuses.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Supervisor(refusal) => refusal.code().code,
            other => other.message_code().code,
        }
    }
}
