//! Status of an estimate: one vocabulary for all methods.

use std::fmt;

/// Confidence class that an estimator assigns to its own estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Status {
    /// Depth and tilt are determined.
    Ok,
    /// The depth is determined, the tilt is not.
    WeakTilt,
    /// Depth and tilt are determined, but not all shifts and turns in the plane: the spin of a disc, a shift along stripes. Which ones,
    /// the estimate tells.
    PartlyObserved,
    /// Two or more poses explain the images equally well: other depths, or, in tracking, poses that are a period of the texture apart. The
    /// reported one may be wrong.
    Ambiguous,
    /// This method cannot determine the pose from these images; no pose is reported.
    NotObservable,
    /// The tracker has lost its target; no pose is reported.
    Lost,
    /// The input was rejected; no pose is reported.
    Error,
}

impl Status {
    /// The name used in files and logs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::WeakTilt => "weak-tilt",
            Self::PartlyObserved => "partly-observed",
            Self::Ambiguous => "ambiguous",
            Self::NotObservable => "not-observable",
            Self::Lost => "lost",
            Self::Error => "error",
        }
    }

    /// Whether the depth is reliable enough to be used.
    pub fn depth_is_sure(self) -> bool {
        matches!(self, Self::Ok | Self::WeakTilt | Self::PartlyObserved)
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// A status and its reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// Confidence class of the estimate.
    pub status: Status,
    /// The measured reason for the status, as text.
    pub reason: String,
}
