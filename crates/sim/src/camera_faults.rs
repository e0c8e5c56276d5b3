//! Faults of simulated cameras as data: a kind, a start time and an end time.
//!
//! Random choices follow from a seed and the number of the pair.

use std::ops::RangeInclusive;
use std::time::Duration;

/// The camera or cameras affected by a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AffectedCameras {
    /// The left camera.
    Left,
    /// The right camera.
    Right,
    /// Both.
    Both,
}

impl AffectedCameras {
    /// Whether the left and the right camera are affected.
    pub fn are(self) -> [bool; 2] {
        [self != Self::Right, self != Self::Left]
    }
}

/// The kind of a camera fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraFaultKind {
    /// This share of the pairs is dropped, 0 to 1.
    Dropped {
        /// Share of the pairs.
        share: f64,
    },
    /// This share of the pairs is replaced by the previous pair, 0 to 1.
    Repeated {
        /// Share of the pairs.
        share: f64,
        /// Whether the repeated pair carries the number and time of the missing pair; otherwise it keeps its own.
        as_new: bool,
    },
    /// Pairs are delivered late by this number of camera periods.
    Late {
        /// Delay in periods, 1 to 100.
        pairs: u32,
    },
    /// The lower rows of this share of the pairs still show the previous pair, 0 to 1.
    Torn {
        /// Share of the pairs.
        share: f64,
    },
    /// The right camera shows the previous pair.
    Skewed {
        /// Time difference reported by the camera: right time minus left time, nanoseconds.
        stamped_nanos: i64,
    },
    /// The same images are delivered repeatedly as new ones.
    Frozen,
    /// Black images: no light.
    Black {
        /// Affected cameras.
        cameras: AffectedCameras,
    },
    /// Saturated images.
    Saturated {
        /// Affected cameras.
        cameras: AffectedCameras,
    },
    /// A step of exposure or gain.
    Brightness {
        /// Affected cameras.
        cameras: AffectedCameras,
        /// Factor on all grey levels, 0 to 100.
        factor: f64,
    },
    /// A bar occludes the target, nearer to the cameras.
    Occluder {
        /// Width of the bar as a share of the image width, 0 to 1.
        width_share: f64,
        /// Whether the bar moves across the images during the fault; otherwise it stays in their middle.
        crosses: bool,
    },
    /// The right image is displaced relative to the calibration: to first order the effect of wrong camera angles, a wrong
    /// baseline or a wrong focal length.
    Miscalibrated {
        /// To the right, pixels.
        columns_px: f64,
        /// Downwards, pixels.
        rows_px: f64,
        /// About the image's centre, radians.
        roll_rad: f64,
        /// Scale about the image centre.
        scale: f64,
    },
}

/// Allowed lateness of pairs: their number.
pub const PAIRS_LATE: RangeInclusive<u32> = 1..=100;

impl CameraFaultKind {
    /// The name in setups and logs.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Dropped { .. } => "dropped",
            Self::Repeated { .. } => "repeated",
            Self::Late { .. } => "late",
            Self::Torn { .. } => "torn",
            Self::Skewed { .. } => "skewed",
            Self::Frozen => "frozen",
            Self::Black { .. } => "black",
            Self::Saturated { .. } => "saturated",
            Self::Brightness { .. } => "brightness",
            Self::Occluder { .. } => "occluder",
            Self::Miscalibrated { .. } => "miscalibrated",
        }
    }

    fn numbers(&self) -> [Option<(&'static str, f64, RangeInclusive<f64>)>; 4] {
        let one = |number| [Some(number), None, None, None];
        let (pairs_min, pairs_max) = PAIRS_LATE.into_inner();
        match *self {
            Self::Dropped { share } | Self::Repeated { share, .. } | Self::Torn { share } => {
                one(("share", share, 0.0..=1.0))
            }
            Self::Late { pairs } => one(("pairs", f64::from(pairs), f64::from(pairs_min)..=f64::from(pairs_max))),
            Self::Brightness { factor, .. } => one(("factor", factor, 0.0..=100.0)),
            Self::Occluder { width_share, .. } => one(("width_share", width_share, 0.0..=1.0)),
            Self::Miscalibrated { columns_px, rows_px, roll_rad, scale } => [
                Some(("columns_px", columns_px, -500.0..=500.0)),
                Some(("rows_px", rows_px, -500.0..=500.0)),
                Some(("roll_deg", roll_rad.to_degrees(), -30.0..=30.0)),
                Some(("scale", scale, 0.5..=2.0)),
            ],
            Self::Skewed { .. } | Self::Frozen | Self::Black { .. } | Self::Saturated { .. } => [const { None }; 4],
        }
    }
}

/// A fault with its start and end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFault {
    /// The kind of the fault.
    pub kind: CameraFaultKind,
    /// Start, since the start of the camera.
    pub from: Duration,
    /// End, since the start of the camera.
    pub until: Duration,
}

/// All faults of a camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFaults {
    /// The faults in any order; several may be active at once.
    pub list: Vec<CameraFault>,
    /// Seed of the random choices.
    pub seed: u32,
}

/// Why a fault was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CameraFaultError(String);

impl CameraFaults {
    /// Checks every number.
    ///
    /// # Errors
    /// The fault, the number and the allowed range.
    pub fn validate(&self) -> Result<(), CameraFaultError> {
        for fault in &self.list {
            let name = fault.kind.name();
            let refuse = |message: String| Err(CameraFaultError(message));
            if fault.until <= fault.from {
                return refuse(format!(
                    "camera fault {name}: ends at {:?}, but begins at {:?}; set a later end",
                    fault.until, fault.from
                ));
            }
            let numbers = fault.kind.numbers();
            if let Some((key, value, allowed)) =
                numbers.into_iter().flatten().find(|(_, value, allowed)| !allowed.contains(value))
            {
                let (min, max) = allowed.into_inner();
                return refuse(format!("camera fault {name}: {key} is {value}; set it between {min} and {max}"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(kind: CameraFaultKind, from_millis: u64, until_millis: u64) -> CameraFault {
        CameraFault { kind, from: Duration::from_millis(from_millis), until: Duration::from_millis(until_millis) }
    }

    #[test]
    fn a_fault_that_can_not_be_is_refused() {
        let refusal = |fault| CameraFaults { list: vec![fault], seed: 0 }.validate().unwrap_err().to_string();
        let wrong = refusal(fault(CameraFaultKind::Torn { share: 1.5 }, 0, 1));
        assert_eq!(wrong, "camera fault torn: share is 1.5; set it between 0 and 1");
        assert!(refusal(fault(CameraFaultKind::Frozen, 5, 5)).contains("set a later end"));
        let nan = CameraFaultKind::Brightness { cameras: AffectedCameras::Both, factor: f64::NAN };
        assert!(refusal(fault(nan, 0, 1)).contains("factor is NaN"));
    }
}
