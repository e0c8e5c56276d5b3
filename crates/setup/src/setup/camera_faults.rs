//! The tables `[[camera.faults]]`: faults of the simulated cameras.

use std::time::Duration;

use serde::Deserialize;

use super::super::load::{Checker, whole};
use pb3dp_sim::camera_faults::{AffectedCameras, CameraFault, CameraFaultKind, CameraFaults, PAIRS_LATE};

/// One fault: each kind has its own keys, and all have a time span.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaultSection {
    kind: FaultName,
    from_s: Option<f64>,
    until_s: Option<f64>,
    share: Option<f64>,
    as_new: Option<bool>,
    pairs: Option<i64>,
    stamped_millis: Option<f64>,
    cameras: Option<AffectedCamerasName>,
    factor: Option<f64>,
    width_share: Option<f64>,
    crosses: Option<bool>,
    columns_px: Option<f64>,
    rows_px: Option<f64>,
    roll_deg: Option<f64>,
    scale: Option<f64>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum FaultName {
    Dropped,
    Repeated,
    Late,
    Torn,
    Skewed,
    Frozen,
    Black,
    Saturated,
    Brightness,
    Occluder,
    Miscalibrated,
}

impl FaultName {
    const ALL: [Self; 11] = [
        Self::Dropped,
        Self::Repeated,
        Self::Late,
        Self::Torn,
        Self::Skewed,
        Self::Frozen,
        Self::Black,
        Self::Saturated,
        Self::Brightness,
        Self::Occluder,
        Self::Miscalibrated,
    ];

    /// Its name in setups, and its own keys.
    fn keys(self) -> (&'static str, &'static [&'static str]) {
        match self {
            Self::Dropped => ("dropped", &["share"]),
            Self::Repeated => ("repeated", &["share", "as_new"]),
            Self::Late => ("late", &["pairs"]),
            Self::Torn => ("torn", &["share"]),
            Self::Skewed => ("skewed", &["stamped_millis"]),
            Self::Frozen => ("frozen", &[]),
            Self::Black => ("black", &["cameras"]),
            Self::Saturated => ("saturated", &["cameras"]),
            Self::Brightness => ("brightness", &["cameras", "factor"]),
            Self::Occluder => ("occluder", &["width_share", "crosses"]),
            Self::Miscalibrated => ("miscalibrated", &["columns_px", "rows_px", "roll_deg", "scale"]),
        }
    }
}

/// Keys of every fault.
const SPAN: [&str; 2] = ["from_s", "until_s"];

/// All kinds of faults with their keys, for `pb3dp config explain`.
pub fn help() -> String {
    let kinds = FaultName::ALL.map(|kind| match kind.keys() {
        (name, []) => name.to_owned(),
        (name, keys) => format!("{name} ({})", keys.join(", ")),
    });
    format!(
        "faults of the simulated cameras: a list of tables, each with {}, `kind` and the keys of its kind: {} \
         (docs/supervisor.md has an example)",
        SPAN.join(", "),
        kinds.join(", ")
    )
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum AffectedCamerasName {
    Left,
    Right,
    #[default]
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
    check.together("camera.faults", faults.validate());
    faults
}

impl FaultSection {
    fn build(&self, index: usize, check: &mut Checker) -> CameraFault {
        use CameraFaultKind as Kind;
        let key = |name: &str| format!("camera.faults[{index}].{name}");
        self.check_keys(index, check);
        let number = |value: Option<f64>| value.unwrap_or_default();
        let (share, cameras) = (number(self.share), AffectedCameras::from(self.cameras.unwrap_or_default()));
        let kind = match self.kind {
            FaultName::Dropped => Kind::Dropped { share },
            FaultName::Repeated => Kind::Repeated { share, as_new: self.as_new.unwrap_or_default() },
            FaultName::Late => {
                let pairs = self.pairs.unwrap_or(1);
                check.count(&key("pairs"), pairs, PAIRS_LATE);
                Kind::Late { pairs: whole(pairs) }
            }
            FaultName::Torn => Kind::Torn { share },
            FaultName::Skewed => {
                let stamped_millis = number(self.stamped_millis);
                check.number(&key("stamped_millis"), stamped_millis, -1000.0..=1000.0);
                Kind::Skewed { stamped_nanos: (stamped_millis * 1e6) as i64 }
            }
            FaultName::Frozen => Kind::Frozen,
            FaultName::Black => Kind::Black { cameras },
            FaultName::Saturated => Kind::Saturated { cameras },
            FaultName::Brightness => Kind::Brightness { cameras, factor: number(self.factor) },
            FaultName::Occluder => {
                Kind::Occluder { width_share: number(self.width_share), crosses: self.crosses.unwrap_or_default() }
            }
            FaultName::Miscalibrated => Kind::Miscalibrated {
                columns_px: number(self.columns_px),
                rows_px: number(self.rows_px),
                roll_rad: number(self.roll_deg).to_radians(),
                scale: number(self.scale),
            },
        };
        for (key, value) in SPAN.into_iter().zip([self.from_s, self.until_s]) {
            check.number(&format!("camera.faults[{index}].{key}"), number(value), 0.0..=86_400.0);
        }
        let time = |seconds: Option<f64>| Duration::try_from_secs_f64(number(seconds)).unwrap_or_default();
        CameraFault { kind, from: time(self.from_s), until: time(self.until_s) }
    }

    /// Refuses missing keys and those of other kinds, all at once.
    fn check_keys(&self, index: usize, check: &mut Checker) {
        let (name, own) = self.kind.keys();
        let of_kind = |key: &str| SPAN.contains(&key) || own.contains(&key);
        let stated = [
            ("from_s", self.from_s.is_some()),
            ("until_s", self.until_s.is_some()),
            ("share", self.share.is_some()),
            ("as_new", self.as_new.is_some()),
            ("pairs", self.pairs.is_some()),
            ("stamped_millis", self.stamped_millis.is_some()),
            ("cameras", self.cameras.is_some()),
            ("factor", self.factor.is_some()),
            ("width_share", self.width_share.is_some()),
            ("crosses", self.crosses.is_some()),
            ("columns_px", self.columns_px.is_some()),
            ("rows_px", self.rows_px.is_some()),
            ("roll_deg", self.roll_deg.is_some()),
            ("scale", self.scale.is_some()),
        ];
        let those = |is_wrong: &dyn Fn(&str, bool) -> bool| {
            stated.iter().filter(|(key, is_stated)| is_wrong(key, *is_stated)).map(|(key, _)| *key).collect::<Vec<_>>()
        };
        let missing = those(&|key, is_stated| of_kind(key) && !is_stated);
        if !missing.is_empty() {
            check.refuse(format!("camera.faults[{index}]: a fault of kind {name} also needs {}", missing.join(", ")));
        }
        let foreign = those(&|key, is_stated| !of_kind(key) && is_stated);
        if !foreign.is_empty() {
            check.refuse(format!("camera.faults[{index}]: a fault of kind {name} has no {}", foreign.join(", ")));
        }
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
    fn every_kind_is_read_with_the_keys_that_its_help_names() {
        for kind in FaultName::ALL {
            let (name, keys) = kind.keys();
            let value = |key: &str| match key {
                "cameras" => "\"left\"",
                "as_new" | "crosses" => "true",
                _ => "1",
            };
            let keys: String = keys.iter().map(|key| format!("{key} = {}\n", value(key))).collect();
            let text = format!("[[camera.faults]]\nkind = \"{name}\"\nfrom_s = 1\nuntil_s = 2\n{keys}");
            assert_eq!(read(&text).unwrap().list[0].kind.name(), name);
            assert!(help().contains(name));
        }
    }

    #[test]
    fn faults_that_can_not_be_are_refused_by_name() {
        for (faults, expected_text) in [
            ("kind = \"dropped\"\nshare = 1.5", "camera fault dropped: share is 1.5"),
            ("kind = \"late\"\npairs = 0", "camera.faults[0].pairs = 0"),
            ("kind = \"torn\"", "camera.faults[0]: a fault of kind torn also needs share"),
            ("kind = \"frozen\"\nshare = 0.5", "camera.faults[0]: a fault of kind frozen has no share"),
            ("kind = \"occluder\"\nscale = 1", "also needs width_share, crosses"),
            ("kind = \"black\"\ncameras = 3", "camera.faults.0.cameras"),
            ("kind = \"upside-down\"", "upside-down"),
        ] {
            let refused = read(&format!("[[camera.faults]]\nfrom_s = 1.0\nuntil_s = 2.0\n{faults}")).unwrap_err();
            assert!(refused.contains(expected_text), "{refused}");
        }
        let refused = read("[[camera.faults]]\nkind = \"miscalibrated\"").unwrap_err();
        assert!(refused.contains("also needs from_s, until_s, columns_px, rows_px, roll_deg, scale"), "{refused}");
        let refused = read("[[camera.faults]]\nkind = \"frozen\"\nfrom_s = 2.0\nuntil_s = 1.0").unwrap_err();
        assert!(refused.contains("set a later end"), "{refused}");
    }
}
