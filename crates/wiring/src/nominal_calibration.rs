//! Nominal calibration, for instance from a drawing: real arms refuse to move with it unless the operator accepts it.

use anyhow::{Result, bail};
use pb3dp_arm_pa10::arm::ArmMonitor;
use pb3dp_arm_pa10_protocol::gateway_protocol::HelloReply;
use pb3dp_setup::setup::Setup;

/// Firmware name of a gateway that is emulated in this process; it moves no real arm.
pub(super) const EMULATION: &str = "pb3dp emulation";
/// Firmware name of `pb3dp mock-arm`, without its version.
pub const MOCK_ARM: &str = "mock-arm";

/// Checks whether the arms are emulated.
///
/// # Errors
/// The first arm that is not known to be emulated.
pub(super) fn look_at_arms(says: &str, monitors: &[(&'static str, ArmMonitor)]) -> Result<()> {
    let firmware = |hello: &HelloReply| hello.firmware.as_str().to_owned();
    let arms = monitors.iter().map(|(name, monitor)| (*name, monitor.snapshot().gateway.as_ref().map(firmware)));
    refuse_real(says, arms)
}

/// Each arm with the firmware name of its gateway, once it has answered.
fn refuse_real<'a>(says: &str, mut arms: impl Iterator<Item = (&'a str, Option<String>)>) -> Result<()> {
    let is_emulated = |firmware: &String| [EMULATION, MOCK_ARM].iter().any(|name| firmware.starts_with(name));
    if let Some((name, _)) = arms.find(|(_, firmware)| !firmware.as_ref().is_some_and(is_emulated)) {
        bail!(
            "{name} may not move: camera.calibration is nominal ({says}), so all estimated poses are wrong; calibrate the cameras \
             and set the file, or use --nominal-calibration if no person or device in the workcell is at risk"
        );
    }
    tracing::warn!("camera.calibration is nominal ({says}); accepted because both arms are emulated");
    Ok(())
}

/// Permits motion of real arms with a nominal calibration, if accepted.
pub fn accept_nominal(setup: &mut Setup, is_accepted: bool) {
    if let Some(says) = setup.rig.nominal_calibration.take_if(|_| is_accepted) {
        tracing::warn!("--nominal-calibration: the arms move with a nominal camera calibration ({says})");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_rig_has_the_calibration_of_no_cameras_until_somebody_accepts_it() {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/rig.toml");
        let mut setup = pb3dp_setup::setup::read_setup(&file).unwrap();
        assert!(
            setup
                .rig
                .nominal_calibration
                .as_ref()
                .is_some_and(|says| says.starts_with("none: the numbers of the drawing"))
        );
        accept_nominal(&mut setup, false);
        assert!(setup.rig.nominal_calibration.is_some());
        accept_nominal(&mut setup, true);
        assert_eq!(setup.rig.nominal_calibration, None);
    }

    #[test]
    fn only_emulated_arms_move_by_the_calibration_of_no_cameras() {
        let warning_for = |arms: [Option<&str>; 2]| {
            let arms = ["vs-robot", "tc-robot"].into_iter().zip(arms.map(|firmware| firmware.map(str::to_owned)));
            refuse_real("none: a drawing", arms).map_err(|refusal| refusal.to_string())
        };
        assert_eq!(warning_for([Some("pb3dp emulation"), Some("mock-arm 0.1.0")]), Ok(()));
        // A gateway of this project has a real controller behind it; `None`: the gateway has not told its firmware.
        for (arms, name) in [
            ([Some("pb3dp gateway 0.1.0"), Some("mock-arm 0.1.0")], "vs-robot"),
            ([Some("mock-arm 0.1.0"), Some("PA-10 gateway")], "tc-robot"),
            ([Some("mock-arm 0.1.0"), None], "tc-robot"),
        ] {
            let refusal = warning_for(arms).unwrap_err();
            assert!(refusal.starts_with(&format!("{name} may not move")), "{refusal}");
            assert!(refusal.contains("(none: a drawing)") && refusal.contains("--nominal-calibration"), "{refusal}");
        }
        // Joints in this process have no link.
        refuse_real("none", std::iter::empty()).unwrap();
    }
}
