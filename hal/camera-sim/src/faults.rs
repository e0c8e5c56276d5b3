//! Injected camera faults: the same faults for rendered images and for the camera without images.

mod delivery;
mod images;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_sim::camera_faults::{CameraFault, CameraFaultKind, CameraFaults};
use pb3dp_sim::noise::{hash, unit};

pub(crate) use delivery::{Delivered, Delivery};
pub use images::FaultyCamera;

/// The fault plan of a camera, with its start time.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    faults: CameraFaults,
    began: MonotonicTime,
}

impl Plan {
    pub(crate) fn new(faults: CameraFaults, began: MonotonicTime) -> Result<Self, CameraError> {
        faults.validate().map_err(|error| CameraError::new(CameraErrorKind::Unusable, error.to_string()))?;
        Ok(Self { faults, began })
    }

    /// The faults of the pair with this number and exposure time.
    pub(crate) fn at(&self, sequence: u64, exposed_at: MonotonicTime) -> Vec<CameraFault> {
        let age = exposed_at.saturating_since(self.began);
        let active = self.faults.list.iter().enumerate().filter(|(_, fault)| (fault.from..fault.until).contains(&age));
        active.filter(|(index, fault)| self.befalls(*index, &fault.kind, sequence)).map(|(_, fault)| *fault).collect()
    }

    /// Progress of a fault through its duration, 0 to 1.
    pub(crate) fn progress(&self, fault: &CameraFault, exposed_at: MonotonicTime) -> f64 {
        let age = exposed_at.saturating_since(self.began).saturating_sub(fault.from);
        age.as_secs_f64() / fault.until.saturating_sub(fault.from).as_secs_f64()
    }

    /// Whether a fault that affects a share of the pairs affects this one.
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

/// Position of the bar in the left and the right image: first column and one past the last, as shares of the width.
pub(crate) fn bar(width_share: f64, crosses: bool, progress: f64) -> [[f64; 2]; 2] {
    /// Shift to the left in the right image, as a share of the width: a bar 350 to 400 mm in front of usual cameras.
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
    use std::time::Duration;

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
        assert!((0..100).any(differs), "another seed drops other pairs");
    }

    #[test]
    fn a_bar_goes_through_both_images() {
        let band = |progress| bar(0.2, true, progress).map(|[first, end]| end > 1e-9 && first < 1.0 - 1e-9);
        for (progress, expected) in [
            (0.0, [false, false]),
            (0.1, [true, false]),
            (0.5, [true, true]),
            (0.9, [false, true]),
            (1.0, [false, false]),
        ] {
            assert_eq!(band(progress), expected, "{progress}");
        }
        let [left, right] = bar(0.5, false, 0.7);
        assert!((left[0] - 0.4).abs() < 1e-12 && (right[1] - 0.6).abs() < 1e-12, "{left:?} {right:?}");
    }
}
