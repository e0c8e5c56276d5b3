//! A calibration that is that of no cameras, a drawing's say: by what is seen with it no real arm moves unless somebody says so.

use anyhow::{Result, bail};
use pb3dp_arm_pa10::arm::ArmMonitor;
use pb3dp_arm_pa10_protocol::gateway_protocol::HelloReply;
use pb3dp_setup::setup::Setup;

/// How the firmware of a gateway calls itself that is emulated in this program; it moves nothing.
pub(super) const EMULATION: &str = "pb3dp emulation";
/// How that of `pb3dp mock-arm` calls itself, before its version.
pub const MOCK_ARM: &str = "mock-arm";

/// Looks at what is at the other ends of the arms' lines.
///
/// # Errors
/// The first arm that is not known to be emulated.
pub(super) fn look_at_arms(says: &str, monitors: &[(&'static str, ArmMonitor)]) -> Result<()> {
    let firmware = |hello: &HelloReply| hello.firmware.as_str().to_owned();
    let arms = monitors.iter().map(|(name, monitor)| (*name, monitor.snapshot().gateway.as_ref().map(firmware)));
    refuse_real(says, arms)
}

/// Each arm with the name of its gateway's firmware, if it has a gateway.
fn refuse_real<'a>(says: &str, mut arms: impl Iterator<Item = (&'a str, Option<String>)>) -> Result<()> {
    let is_emulated = |firmware: &String| [EMULATION, MOCK_ARM].iter().any(|name| firmware.starts_with(name));
    if let Some((name, _)) = arms.find(|(_, firmware)| !firmware.as_ref().is_some_and(is_emulated)) {
        bail!(
            "{name} may not move: camera.calibration is that of no cameras ({says}), so what is seen is not where it seems to be; calibrate \
             the cameras and name the file, or add --nominal-calibration if nothing in the cell can be hurt by it"
        );
    }
    tracing::warn!(
        "camera.calibration is that of no cameras ({says}); both arms are emulated, else this would be refused"
    );
    Ok(())
}

/// Lets real arms move by the calibration of no cameras, if that is said.
pub fn accept_nominal(setup: &mut Setup, is_accepted: bool) {
    if let Some(says) = setup.rig.nominal_calibration.take_if(|_| is_accepted) {
        tracing::warn!("--nominal-calibration: arms move by what is seen with a calibration of no cameras ({says})");
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
        let told = |arms: [Option<&str>; 2]| {
            let arms = ["vs-robot", "tc-robot"].into_iter().zip(arms.map(|firmware| firmware.map(str::to_owned)));
            refuse_real("none: a drawing", arms).map_err(|refusal| refusal.to_string())
        };
        assert_eq!(told([Some("pb3dp emulation"), Some("mock-arm 0.1.0")]), Ok(()));
        // A gateway of ours has a real controller behind it, and an arm on a bus of this computer says nothing of itself.
        for (arms, name) in [
            ([Some("pb3dp gateway 0.1.0"), Some("mock-arm 0.1.0")], "vs-robot"),
            ([Some("mock-arm 0.1.0"), Some("PA-10 gateway")], "tc-robot"),
            ([Some("mock-arm 0.1.0"), None], "tc-robot"),
        ] {
            let refusal = told(arms).unwrap_err();
            assert!(refusal.starts_with(&format!("{name} may not move")), "{refusal}");
            assert!(refusal.contains("(none: a drawing)") && refusal.contains("--nominal-calibration"), "{refusal}");
        }
        // Joints in this process have no line.
        refuse_real("none", std::iter::empty()).unwrap();
    }
}
