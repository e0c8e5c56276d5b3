//! How far an answer can be trusted: one vocabulary for every method.

use std::fmt;

/// What an estimator says of its own answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Status {
    /// Depth and tilt are determined.
    Ok,
    /// The depth is determined, the tilt is not.
    WeakTilt,
    /// Two or more depths explain the images equally well; the given one may be wrong.
    Ambiguous,
    /// The images do not determine the pose with this method; no pose is given.
    NotObservable,
    /// A tracker has lost its target; no pose is given.
    Lost,
    /// The input was refused; no pose is given.
    Error,
}

impl Status {
    /// The name in files and logs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::WeakTilt => "weak-tilt",
            Self::Ambiguous => "ambiguous",
            Self::NotObservable => "not-observable",
            Self::Lost => "lost",
            Self::Error => "error",
        }
    }

    /// Whether the depth may be used.
    pub fn depth_is_sure(self) -> bool {
        matches!(self, Self::Ok | Self::WeakTilt)
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// A status and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// How far the answer can be trusted.
    pub status: Status,
    /// What was measured that led to the status, in words.
    pub reason: String,
}
