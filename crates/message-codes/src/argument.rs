//! Arguments that messages ask for.

use std::fmt;
use std::sync::OnceLock;

/// What a message asks its reader to state. The program writes its option, and a package for another language its argument: see
/// [`spell_arguments`]. Without either the message has the name in this library.
///
/// ```
/// use pb3dp_message_codes::Argument;
///
/// assert_eq!(format!("widen the range ({})", Argument::DepthRange), "widen the range (SearchRange)");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Argument {
    /// The depths to search.
    DepthRange,
    /// The largest tilt to search.
    TiltLimit,
    /// The visible surface of a region, instead of its plane.
    VisibleSurface,
    /// The time between the exposures of both cameras.
    Skew,
    /// That the images are rectified.
    Rectified,
}

impl Argument {
    /// All arguments.
    pub const ALL: [Self; 5] = [Self::DepthRange, Self::TiltLimit, Self::VisibleSurface, Self::Skew, Self::Rectified];

    fn name_in_library(self) -> &'static str {
        match self {
            Self::DepthRange => "SearchRange",
            Self::TiltLimit => "SearchRange::tilt_max_rad",
            Self::VisibleSurface => "Estimator::visible_surface",
            Self::Skew => "FramePrior::skew_s",
            Self::Rectified => "StatedCalibration::rectified",
        }
    }
}

/// The name of each argument for the readers of this process.
type Spelling = fn(Argument) -> &'static str;

static SPELLING: OnceLock<Spelling> = OnceLock::new();

/// Sets how all messages of this process name arguments. A program does so once, at its start; later calls have no effect.
pub fn spell_arguments(spelling: Spelling) {
    let _ = SPELLING.set(spelling);
}

impl fmt::Display for Argument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(SPELLING.get().map_or_else(|| self.name_in_library(), |spelling| spelling(*self)))
    }
}
