//! The tables `[[camera.faults]]`: faults of the simulated cameras.

use std::time::Duration;

use serde::Deserialize;

use super::super::load::{Checker, whole};
use pb3dp_sim::camera_faults::{AffectedCameras, CameraFault, CameraFaultKind, CameraFaults, PAIRS_LATE};

/// One fault; each kind has its own keys, and all have a time span.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum FaultSection {
    Dropped { from_s: f64, until_s: f64, share: f64 },
    Repeated { from_s: f64, until_s: f64, share: f64, as_new: bool },
    Late { from_s: f64, until_s: f64, pairs: i64 },
    Torn { from_s: f64, until_s: f64, share: f64 },
    Skewed { from_s: f64, until_s: f64, stamped_millis: f64 },
    Frozen { from_s: f64, until_s: f64 },
    Black { from_s: f64, until_s: f64, cameras: AffectedCamerasName },
    Saturated { from_s: f64, until_s: f64, cameras: AffectedCamerasName },
    Brightness { from_s: f64, until_s: f64, cameras: AffectedCamerasName, factor: f64 },
    Occluder { from_s: f64, until_s: f64, width_share: f64, crosses: bool },
    Miscalibrated { from_s: f64, until_s: f64, columns_px: f64, rows_px: f64, roll_deg: f64, scale: f64 },
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum AffectedCamerasName {
    Left,
    Right,
    Both,
}

impl From<AffectedCamerasName> for AffectedCameras {
    fn from(name: AffectedCamerasName) -> Self {
        match name {
            AffectedCamerasName::Left => Self::Left,
            AffectedCamerasName::Right => Self::Right,
            AffectedCamerasName::Both => Self::Both,
        }
    }
}

/// All faults of a setup.
pub(super) fn build(sections: &[FaultSection], check: &mut Checker) -> CameraFaults {
    let built = sections.iter().enumerate().map(|(index, section)| section.build(index, check));
    let faults = CameraFaults { list: built.collect(), ..CameraFaults::default() };
    if let (true, Err(error)) = (check.is_clean(), faults.validate()) {
        check.refuse(format!("camera.faults: {error}"));
    }
    faults
}

impl FaultSection {
    fn build(&self, index: usize, check: &mut Checker) -> CameraFault {
        use CameraFaultKind as Kind;
        let (kind, from_s, until_s) = match *self {
            Self::Dropped { from_s, until_s, share } => (Kind::Dropped { share }, from_s, until_s),
            Self::Repeated { from_s, until_s, share, as_new } => (Kind::Repeated { share, as_new }, from_s, until_s),
            Self::Late { from_s, until_s, pairs } => {
                check.count(&format!("camera.faults[{index}].pairs"), pairs, PAIRS_LATE);
                (Kind::Late { pairs: whole(pairs) }, from_s, until_s)
            }
            Self::Torn { from_s, until_s, share } => (Kind::Torn { share }, from_s, until_s),
            Self::Skewed { from_s, until_s, stamped_millis } => {
                check.number(&format!("camera.faults[{index}].stamped_millis"), stamped_millis, -1000.0..=1000.0);
                (Kind::Skewed { stamped_nanos: (stamped_millis * 1e6) as i64 }, from_s, until_s)
            }
            Self::Frozen { from_s, until_s } => (Kind::Frozen, from_s, until_s),
            Self::Black { from_s, until_s, cameras } => (Kind::Black { cameras: cameras.into() }, from_s, until_s),
            Self::Saturated { from_s, until_s, cameras } => {
                (Kind::Saturated { cameras: cameras.into() }, from_s, until_s)
            }
            Self::Brightness { from_s, until_s, cameras, factor } => {
                (Kind::Brightness { cameras: cameras.into(), factor }, from_s, until_s)
            }
            Self::Occluder { from_s, until_s, width_share, crosses } => {
                (Kind::Occluder { width_share, crosses }, from_s, until_s)
            }
            Self::Miscalibrated { from_s, until_s, columns_px, rows_px, roll_deg, scale } => {
                let roll_rad = roll_deg.to_radians();
                (Kind::Miscalibrated { columns_px, rows_px, roll_rad, scale }, from_s, until_s)
            }
        };
        for (key, value) in [("from_s", from_s), ("until_s", until_s)] {
            check.number(&format!("camera.faults[{index}].{key}"), value, 0.0..=86_400.0);
        }
        let time = |seconds: f64| Duration::try_from_secs_f64(seconds).unwrap_or_default();
        CameraFault { kind, from: time(from_s), until: time(until_s) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::read_setup;
    use super::*;

    /// The repository's setup with these faults; or why it is refused.
    fn read(faults: &str) -> Result<CameraFaults, String> {
        let configs = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("robots")).unwrap();
        std::fs::copy(configs.join("robots/pa10_gen2.urdf"), folder.path().join("robots/pa10_gen2.urdf")).unwrap();
        let text = std::fs::read_to_string(configs.join("sim.toml")).unwrap();
        let file = folder.path().join("sim.toml");
        std::fs::write(&file, text.replace("[camera.left]", &format!("{faults}\n[camera.left]"))).unwrap();
        read_setup(&file).map(|setup| setup.world.as_ref().unwrap().faults.clone()).map_err(|error| error.to_string())
    }

    #[test]
    fn faults_are_read_with_their_times() {
        assert_eq!(read("").unwrap().list, []);
        let faults = read(
            "[[camera.faults]]\nkind = \"frozen\"\nfrom_s = 1.5\nuntil_s = 2\n\
             [[camera.faults]]\nkind = \"skewed\"\nfrom_s = 3.0\nuntil_s = 4.0\nstamped_millis = -6.5\n\
             [[camera.faults]]\nkind = \"black\"\nfrom_s = 3.0\nuntil_s = 4.0\ncameras = \"right\"",
        );
        let kinds: Vec<_> = faults.as_ref().unwrap().list.iter().map(|fault| fault.kind).collect();
        let expected = [
            CameraFaultKind::Frozen,
            CameraFaultKind::Skewed { stamped_nanos: -6_500_000 },
            CameraFaultKind::Black { cameras: AffectedCameras::Right },
        ];
        assert_eq!(kinds, expected);
        let first = faults.unwrap().list[0];
        assert_eq!((first.from, first.until), (Duration::from_millis(1500), Duration::from_secs(2)));
    }

    #[test]
    fn faults_that_can_not_be_are_refused_by_name() {
        for (faults, told) in [
            ("kind = \"dropped\"\nshare = 1.5", "camera fault dropped: share is 1.5"),
            ("kind = \"late\"\npairs = 0", "camera.faults[0].pairs = 0"),
            ("kind = \"torn\"", "share"),
            ("kind = \"frozen\"\nshare = 0.5", "share"),
            ("kind = \"upside-down\"", "upside-down"),
        ] {
            let refused = read(&format!("[[camera.faults]]\nfrom_s = 1.0\nuntil_s = 2.0\n{faults}")).unwrap_err();
            assert!(refused.contains(told), "{refused}");
        }
        let refused = read("[[camera.faults]]\nkind = \"frozen\"\nfrom_s = 2.0\nuntil_s = 1.0").unwrap_err();
        assert!(refused.contains("set a later end"), "{refused}");
    }
}
