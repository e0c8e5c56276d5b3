//! What a console needs besides its lines.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use pb3dp_geometry::ImageSize;

use crate::selection::Selections;

/// What a console needs besides its lines.
pub struct ConsoleOptions {
    /// Set by `quit` and by the end of the input.
    pub interrupt: Arc<AtomicBool>,
    /// Text behind each answer.
    pub prompt: &'static str,
    /// For `select`; `None` if the target cannot be chosen.
    pub targets: Option<ConsoleTargets>,
}

/// For the command `select`.
#[derive(Clone)]
pub struct ConsoleTargets {
    /// Size of the left image.
    pub size: ImageSize,
    /// Receives the target once the supervisor has accepted the command.
    pub selections: Selections,
}
