//! What goes wrong with simulated cameras, as data: a kind, and from when until when.
//!
//! What is random about it follows from a seed and the number of the pair.

use std::time::Duration;

/// Which eye it happens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eyes {
    /// The left one.
    Left,
    /// The right one.
    Right,
    /// Both.
    Both,
}

impl Eyes {
    /// Whether the left and the right eye are among them.
    pub fn are(self) -> [bool; 2] {
        [self != Self::Right, self != Self::Left]
    }
}

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CameraFaultKind {
    /// This share of the pairs does not come, 0 to 1.
    Dropped {
        /// Of the pairs.
        share: f64,
    },
    /// In the place of this share of the pairs the one before comes again, 0 to 1.
    Repeated {
        /// Of the pairs.
        share: f64,
        /// With the number and time of the pair that should have come; otherwise with its own.
        as_new: bool,
    },
    /// Pairs come later than they should by so many periods of the camera.
    Late {
        /// How many, 1 to 100.
        pairs: u32,
    },
    /// The lower rows of this share of the pairs are still those of the pair before, 0 to 1.
    Torn {
        /// Of the pairs.
        share: f64,
    },
    /// The right eye shows the pair before.
    Skewed {
        /// What the camera says of it: right time less left time, nanoseconds.
        stamped_nanos: i64,
    },
    /// The same images come again and again as new ones.
    Frozen,
    /// No light.
    Black {
        /// Where.
        eyes: Eyes,
    },
    /// Too much light everywhere.
    Saturated {
        /// Where.
        eyes: Eyes,
    },
    /// A step of exposure or gain.
    Brightness {
        /// Where.
        eyes: Eyes,
        /// All grey levels times this, 0 to 100.
        factor: f64,
    },
    /// A bar hangs before the target, nearer to the cameras.
    Occluder {
        /// Its width as a share of the image's, 0 to 1.
        width_share: f64,
        /// It moves across the images in the time of the fault; otherwise it hangs in their middle.
        crosses: bool,
    },
    /// The right image is not where the calibration has it: to first order what is wrong with the angles of one eye, the
    /// baseline or a focal length.
    Miscalibrated {
        /// To the right, pixels.
        columns_px: f64,
        /// Downwards, pixels.
        rows_px: f64,
        /// About the image's centre, radians.
        roll_rad: f64,
        /// From the image's centre.
        scale: f64,
    },
}

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

    fn numbers(&self) -> [Option<(&'static str, f64, f64, f64)>; 4] {
        let one = |number| [Some(number), None, None, None];
        match *self {
            Self::Dropped { share } | Self::Repeated { share, .. } | Self::Torn { share } => {
                one(("share", share, 0.0, 1.0))
            }
            Self::Late { pairs } => one(("pairs", f64::from(pairs), 1.0, 100.0)),
            Self::Brightness { factor, .. } => one(("factor", factor, 0.0, 100.0)),
            Self::Occluder { width_share, .. } => one(("width_share", width_share, 0.0, 1.0)),
            Self::Miscalibrated { columns_px, rows_px, roll_rad, scale } => [
                Some(("columns_px", columns_px, -500.0, 500.0)),
                Some(("rows_px", rows_px, -500.0, 500.0)),
                Some(("roll_rad", roll_rad, -0.5, 0.5)),
                Some(("scale", scale, 0.5, 2.0)),
            ],
            Self::Skewed { .. } | Self::Frozen | Self::Black { .. } | Self::Saturated { .. } => [None; 4],
        }
    }
}

/// A fault and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFault {
    /// What goes wrong.
    pub kind: CameraFaultKind,
    /// From then on, since the camera began.
    pub from: Duration,
    /// Until then, since the camera began.
    pub until: Duration,
}

/// All that goes wrong with a camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraFaults {
    /// In any order; several at once are possible.
    pub list: Vec<CameraFault>,
    /// Selects what is random.
    pub seed: u32,
}

/// Why a fault cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CameraFaultError(String);

impl CameraFaults {
    /// Whether every number can be.
    ///
    /// # Errors
    /// The fault, the number and what is allowed.
    pub fn validate(&self) -> Result<(), CameraFaultError> {
        for fault in &self.list {
            let name = fault.kind.name();
            let refuse = |message: String| Err(CameraFaultError(message));
            if fault.until <= fault.from {
                return refuse(format!(
                    "camera fault {name}: it ends at {:?} and begins at {:?}; let it end later",
                    fault.until, fault.from
                ));
            }
            let numbers = fault.kind.numbers();
            if let Some((key, value, min, max)) =
                numbers.into_iter().flatten().find(|(_, value, min, max)| !(min..=max).contains(&value))
            {
                return refuse(format!("camera fault {name}: {key} is {value}: set it between {min} and {max}"));
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
        assert_eq!(wrong, "camera fault torn: share is 1.5: set it between 0 and 1");
        assert!(refusal(fault(CameraFaultKind::Frozen, 5, 5)).contains("let it end later"));
        let nan = CameraFaultKind::Brightness { eyes: Eyes::Both, factor: f64::NAN };
        assert!(refusal(fault(nan, 0, 1)).contains("factor is NaN"));
    }
}
