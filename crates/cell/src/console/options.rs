//! What a console needs besides its lines.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use pb3dp_geometry::ImageSize;

use crate::selection::{Selection, Selections};

/// What a console needs besides its lines.
pub struct ConsoleOptions {
    /// Set by `quit` and by the end of the input.
    pub interrupt: Arc<AtomicBool>,
    /// Text behind each answer.
    pub prompt: &'static str,
    /// For `select REGION`; `None` if the target cannot be chosen.
    pub targets: Option<ConsoleTargets>,
}

/// For the command `select REGION`.
pub struct ConsoleTargets {
    /// Size of the left image.
    pub size: ImageSize,
    /// Receives the target once the supervisor has accepted the command.
    pub selections: Selections,
}

/// The target of the last `select REGION`, until the supervisor has decided.
pub(super) type Drawn = Arc<Mutex<Option<Selection>>>;
