//! Files inside the program: setups and the files that they refer to, so that an installed program works anywhere.

use std::sync::OnceLock;

use figment::value::{Dict, Value};

use super::value_at;

/// A setup inside the program.
#[derive(Clone, Copy, Debug)]
pub struct BuiltIn {
    /// Name for `--config` and `base`.
    pub name: &'static str,
    /// Description for help texts.
    pub about: &'static str,
    /// Its TOML text.
    pub text: &'static str,
}

/// The setups.
pub const SETUPS: [BuiltIn; 6] = [
    BuiltIn {
        name: "sim",
        about: "the experiment of the paper in simulation",
        text: include_str!("../../configs/sim.toml"),
    },
    BuiltIn {
        name: "playground",
        about: "sim, paced by the clock, with a target that you push about: for the panel",
        text: include_str!("../../configs/playground.toml"),
    },
    BuiltIn {
        name: "hil",
        about: "sim with both arms emulated byte by byte, in the machine's time",
        text: include_str!("../../configs/hil.toml"),
    },
    BuiltIn {
        name: "rig",
        about: "real cameras and arms: a base, to which a file adds devices, calibration, mounts and arms",
        text: include_str!("rig.toml"),
    },
    BuiltIn {
        name: "bare",
        about: "a simulated rig that nobody has calibrated yet",
        text: include_str!("../../configs/bare.toml"),
    },
    BuiltIn {
        name: "published",
        about: "sim, led by the published method and law",
        text: include_str!("../../configs/published.toml"),
    },
];

/// A complete example of a rig.
pub const RIG_EXAMPLE: &str = include_str!("../../configs/rig.toml");

/// A complete estimator file and a complete gateway file.
const ESTIMATOR: &str = include_str!("../../configs/estimator.toml");
const GATEWAY: &str = include_str!("../../configs/gateway.toml");

/// Prefix of a built-in file where a path is expected.
const PREFIX: &str = "built-in:";

const FILES: [(&str, &str); 6] = [
    ("pa10_gen1.urdf", include_str!("../../configs/robots/pa10_gen1.urdf")),
    ("pa10_gen2.urdf", include_str!("../../configs/robots/pa10_gen2.urdf")),
    ("ur5e_like.urdf", include_str!("../../configs/robots/ur5e_like.urdf")),
    ("nominal.json", include_str!("../../configs/calibration/nominal.json")),
    ("bare_truth.json", include_str!("../../configs/calibration/bare_truth.json")),
    ("ur5e.toml", include_str!("../../configs/arms/ur5e.toml")),
];

/// The built-in setup with this name.
pub fn setup(name: &str) -> Option<&'static BuiltIn> {
    SETUPS.iter().find(|setup| setup.name == name)
}

/// Path of a built-in file; extension and folder may be omitted.
pub(crate) fn path_of(written: &str) -> Option<String> {
    let name = written.strip_prefix(PREFIX).unwrap_or(written).rsplit('/').next()?;
    let is_it = |file: &&(&str, &str)| file.0 == name || file.0.strip_suffix(".urdf") == Some(name);
    FILES.iter().find(is_it).map(|(name, _)| format!("{PREFIX}{name}"))
}

/// A valid value of a key, from a built-in setup; for the table of an arm from any arm.
pub(crate) fn sample(path: &[String]) -> Option<Value> {
    let of_any_arm: Vec<String> = match path {
        [arms, _, rest @ ..] if arms == "arms" && !rest.is_empty() => {
            [&["arms".to_owned(), "vs".to_owned()], rest].concat()
        }
        path => path.to_vec(),
    };
    static TABLES: OnceLock<[Dict; 6]> = OnceLock::new();
    let tables = TABLES.get_or_init(|| {
        let texts = ["sim", "rig", "hil"].map(|name| setup(name).map_or("", |setup| setup.text));
        let [sim, rig, hil] = texts;
        [sim, RIG_EXAMPLE, rig, hil, ESTIMATOR, GATEWAY].map(|text| toml::from_str(text).unwrap_or_default())
    });
    [path, &of_any_arm].iter().find_map(|path| tables.iter().find_map(|table| value_at(table, path).cloned()))
}

/// The text of a built-in file with this path.
pub(crate) fn text_at(path: &str) -> Option<&'static str> {
    let name = path.strip_prefix(PREFIX)?;
    FILES.iter().find(|file| file.0 == name).map(|(_, text)| *text)
}
