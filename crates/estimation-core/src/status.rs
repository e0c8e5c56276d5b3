//! Status of an estimate: one vocabulary for all methods.
//!
//! | status | pose | what the servo may use |
//! |---|---|---|
//! | `ok` | yes | all of it |
//! | `weak-tilt` | yes | position and rotation about the viewing direction; the tilt has its standard deviation |
//! | `partly-observed` | yes | the directions that `observed` names |
//! | `weak-depth` | yes | nothing |
//! | `ambiguous` | yes | nothing |
//! | `miscalibrated` | perhaps | nothing; the supervisor holds until the operator has calibrated |
//! | `not-observable`, `lost`, `error` | no | nothing |
//!
//! A reader that meets another word must treat it as one of those of which nothing may be used.

use std::fmt;
use std::str::FromStr;

/// Number of the form of results, in JSON lines, recordings and the panel's API. It rises when a status or a field gets another meaning or
/// goes away; a new status or field does not raise it.
pub const SCHEMA_VERSION: u32 = 1;

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
    /// The direction of the target is determined, its depth is not.
    WeakDepth,
    /// Two or more poses explain the images equally well: other depths, or, in tracking, poses that are a period of the texture apart. The
    /// reported one may be wrong.
    Ambiguous,
    /// The images contradict the calibration; a pose may be reported, but is not to be used.
    Miscalibrated,
    /// This method cannot determine the pose from these images; no pose is reported.
    NotObservable,
    /// The tracker has lost its target; no pose is reported.
    Lost,
    /// The input was rejected; no pose is reported.
    Error,
}

impl Status {
    /// All statuses.
    pub const ALL: [Self; 9] = [
        Self::Ok,
        Self::WeakTilt,
        Self::PartlyObserved,
        Self::WeakDepth,
        Self::Ambiguous,
        Self::Miscalibrated,
        Self::NotObservable,
        Self::Lost,
        Self::Error,
    ];

    /// The name used in files and logs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::WeakTilt => "weak-tilt",
            Self::PartlyObserved => "partly-observed",
            Self::WeakDepth => "weak-depth",
            Self::Ambiguous => "ambiguous",
            Self::Miscalibrated => "miscalibrated",
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

/// A word that is no status.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no status that this version knows")]
pub struct UnknownStatus(pub String);

impl FromStr for Status {
    type Err = UnknownStatus;
    fn from_str(word: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|status| status.as_str() == word).ok_or_else(|| UnknownStatus(word.to_owned()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_status_has_its_own_name() {
        for status in Status::ALL {
            assert_eq!(status.as_str().parse(), Ok(status));
        }
        let error = "fine".parse::<Status>().unwrap_err().to_string();
        assert_eq!(error, "\"fine\" is no status that this version knows");
    }
}
