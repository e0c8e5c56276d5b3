//! What goes wrong with cameras, on request: the same faults for rendered pictures and for the camera without pictures.
//!
//! Faults are data: a kind, and from when until when. What is random about them follows from a seed and the number of the pair.

mod delivery;
mod pictures;

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_sim::noise::{hash, unit};

pub(crate) use delivery::{Delivered, Delivery};
pub use pictures::FaultyCamera;

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
    pub(crate) fn are(self) -> [bool; 2] {
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
    /// The same pictures come again and again as new ones.
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
        /// Its width as a share of the picture's, 0 to 1.
        width_share: f64,
        /// It moves across the pictures in the time of the fault; otherwise it hangs in their middle.
        crosses: bool,
    },
    /// The right picture is not where the calibration has it: to first order what is wrong with the angles of one eye, the
    /// baseline or a focal length.
    Miscalibrated {
        /// To the right, pixels.
        columns_px: f64,
        /// Downwards, pixels.
        rows_px: f64,
        /// About the picture's centre, radians.
        roll_rad: f64,
        /// From the picture's centre.
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

impl CameraFaults {
    /// Whether every number can be.
    ///
    /// # Errors
    /// `Unusable`, with the fault, the number and what is allowed.
    pub fn validate(&self) -> Result<(), CameraError> {
        for fault in &self.list {
            let name = fault.kind.name();
            let refuse = |message: String| Err(CameraError::new(CameraErrorKind::Unusable, message));
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

/// The faults of a camera that began at a time.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    faults: CameraFaults,
    began: MonotonicTime,
}

impl Plan {
    pub(crate) fn new(faults: CameraFaults, began: MonotonicTime) -> Result<Self, CameraError> {
        faults.validate()?;
        Ok(Self { faults, began })
    }

    /// What goes wrong with the pair of this number that was exposed at this time.
    pub(crate) fn at(&self, sequence: u64, exposed_at: MonotonicTime) -> Vec<CameraFault> {
        let age = exposed_at.saturating_since(self.began);
        let active = self.faults.list.iter().enumerate().filter(|(_, fault)| (fault.from..fault.until).contains(&age));
        active.filter(|(index, fault)| self.befalls(*index, &fault.kind, sequence)).map(|(_, fault)| *fault).collect()
    }

    /// How far through its time a fault is, 0 to 1.
    pub(crate) fn progress(&self, fault: &CameraFault, exposed_at: MonotonicTime) -> f64 {
        let age = exposed_at.saturating_since(self.began).saturating_sub(fault.from);
        age.as_secs_f64() / (fault.until - fault.from).as_secs_f64()
    }

    /// Whether a fault that happens to a share of the pairs happens to this one.
    fn befalls(&self, index: usize, kind: &CameraFaultKind, sequence: u64) -> bool {
        let share = match *kind {
            CameraFaultKind::Dropped { share }
            | CameraFaultKind::Repeated { share, .. }
            | CameraFaultKind::Torn { share } => share,
            _ => return true,
        };
        unit(hash(&[self.faults.seed, index as u32, sequence as u32, (sequence >> 32) as u32])) < share
    }
}

/// Where the bar hangs in the left and the right picture: first column and the one behind the last, as shares of the width.
pub(crate) fn bar(width_share: f64, crosses: bool, progress: f64) -> [[f64; 2]; 2] {
    /// How much farther left it is in the right picture, as a share of the width: a bar 350 to 400 mm before usual cameras.
    const DISPARITY: f64 = 0.3;
    let centre =
        if crosses { progress * (1.0 + DISPARITY + width_share) - (DISPARITY + width_share) / 2.0 } else { 0.5 };
    [0.5, -0.5].map(|side| {
        let middle = centre + side * DISPARITY;
        [middle - 0.5 * width_share, middle + 0.5 * width_share]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(kind: CameraFaultKind, from_millis: u64, until_millis: u64) -> CameraFault {
        CameraFault { kind, from: Duration::from_millis(from_millis), until: Duration::from_millis(until_millis) }
    }

    #[test]
    fn faults_have_their_time_and_their_share() {
        let list =
            vec![fault(CameraFaultKind::Frozen, 100, 200), fault(CameraFaultKind::Dropped { share: 0.25 }, 0, 900_000)];
        let began = MonotonicTime::from_nanos(5_000_000_000);
        let plan = Plan::new(CameraFaults { list, seed: 3 }, began).unwrap();
        let at = |millis: u64, sequence| plan.at(sequence, began + Duration::from_millis(millis));
        let has = |millis, kind: CameraFaultKind| at(millis, 0).iter().any(|fault| fault.kind == kind);
        for (millis, frozen) in [(99, false), (100, true), (199, true), (200, false)] {
            assert_eq!(has(millis, CameraFaultKind::Frozen), frozen, "{millis}");
        }
        let dropped = (0..4000).filter(|&sequence| !at(1000, sequence).is_empty()).count();
        assert!((900..1100).contains(&dropped), "{dropped}");
        let other = Plan::new(CameraFaults { seed: 4, ..plan.faults.clone() }, began).unwrap();
        let differs = |sequence| at(1000, sequence) != other.at(sequence, began + Duration::from_secs(1));
        assert!((0..100).any(differs), "another seed drops others");
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

    #[test]
    fn a_bar_goes_through_both_pictures() {
        let seen = |progress| bar(0.2, true, progress).map(|[first, end]| end > 1e-9 && first < 1.0 - 1e-9);
        for (progress, expected) in [
            (0.0, [false, false]),
            (0.1, [true, false]),
            (0.5, [true, true]),
            (0.9, [false, true]),
            (1.0, [false, false]),
        ] {
            assert_eq!(seen(progress), expected, "{progress}");
        }
        let [left, right] = bar(0.5, false, 0.7);
        assert!((left[0] - 0.4).abs() < 1e-12 && (right[1] - 0.6).abs() < 1e-12, "{left:?} {right:?}");
    }
}
