//! Camera faults: the `[[camera.faults]]` of a setup, applied to poses as the cameras apply them to images.

use std::time::Duration;

use crate::faults::{Fault, Kind};
use crate::scenario::Dice;
use pb3dp_sim::camera_faults::{AffectedCameras, CameraFault, CameraFaultKind, CameraFaults};

/// Time from the start of the camera to the start of the control loop, seconds; both arms are enabled in this time.
pub const LEAD_S: f64 = 1.25;

/// Number of camera fault kinds.
pub const COUNT: usize = 11;

/// Draws one of the kinds.
pub fn draw(dice: &mut Dice) -> CameraFaultKind {
    let cameras = dice.pick(&[AffectedCameras::Left, AffectedCameras::Right, AffectedCameras::Both]);
    match dice.below(COUNT) {
        0 => CameraFaultKind::Dropped { share: dice.within(0.1, 1.0) },
        1 => CameraFaultKind::Repeated { share: dice.within(0.1, 1.0), as_new: dice.unit() < 0.5 },
        2 => CameraFaultKind::Late { pairs: 1 + dice.below(20) as u32 },
        3 => CameraFaultKind::Torn { share: dice.within(0.1, 1.0) },
        4 => {
            let is_stamped = dice.unit() < 0.7;
            let skew_s = dice.within(0.001, 0.05) * dice.sign();
            CameraFaultKind::Skewed { stamped_nanos: if is_stamped { (skew_s * 1e9) as i64 } else { 0 } }
        }
        5 => CameraFaultKind::Frozen,
        6 => CameraFaultKind::Black { cameras },
        7 => CameraFaultKind::Saturated { cameras },
        8 => CameraFaultKind::Brightness { cameras, factor: 10f64.powf(dice.within(-2.0, 1.5)) },
        9 => CameraFaultKind::Occluder { width_share: dice.within(0.1, 0.8), crosses: dice.unit() < 0.5 },
        _ => CameraFaultKind::Miscalibrated {
            columns_px: dice.within(-20.0, 20.0),
            rows_px: dice.within(-5.0, 5.0),
            roll_rad: dice.within(-0.05, 0.05),
            scale: dice.within(0.95, 1.05),
        },
    }
}

/// Name in tables.
pub fn name(kind: &CameraFaultKind) -> &'static str {
    match kind {
        CameraFaultKind::Dropped { .. } => "camera: pairs dropped",
        CameraFaultKind::Repeated { .. } => "camera: pairs repeated",
        CameraFaultKind::Late { .. } => "camera: pairs late",
        CameraFaultKind::Torn { .. } => "camera: pairs torn",
        CameraFaultKind::Skewed { .. } => "camera: exposures not synchronous",
        CameraFaultKind::Frozen => "camera: frozen",
        CameraFaultKind::Black { .. } => "camera: black",
        CameraFaultKind::Saturated { .. } => "camera: saturated",
        CameraFaultKind::Brightness { .. } => "camera: brightness",
        CameraFaultKind::Occluder { .. } => "camera: occluder in front of the target",
        CameraFaultKind::Miscalibrated { .. } => "camera: miscalibrated",
    }
}

/// Whether the fault affects every frame pair that is taken while it lasts; otherwise the effect on a pair decides.
pub fn is_of_each_pair(kind: &CameraFaultKind) -> bool {
    !matches!(
        kind,
        CameraFaultKind::Dropped { .. }
            | CameraFaultKind::Repeated { .. }
            | CameraFaultKind::Torn { .. }
            | CameraFaultKind::Brightness { .. }
            | CameraFaultKind::Occluder { .. }
    )
}

/// Configures a camera that starts at this time of the run, seconds: the first one [`LEAD_S`] before it.
pub fn plan(faults: &[Fault], seed: u64, starts_s: f64) -> CameraFaults {
    let since_s = |t_s: f64| Duration::from_secs_f64((t_s - starts_s).max(0.0));
    let list = faults.iter().filter_map(|fault| match fault.kind {
        Kind::Camera(kind) if fault.until_s() > starts_s => {
            Some(CameraFault { kind, from: since_s(fault.from_s), until: since_s(fault.until_s()) })
        }
        _ => None,
    });
    CameraFaults { list: list.collect(), seed: seed as u32 }
}
