//! Dependencies between our packages, and on serde, from `cargo metadata`.

use crate::packages::Package;
use crate::violation::Violation;

/// One row per package: the packages directly below it. It may depend on them and on all that is below them. Lowest layer first;
/// a row names only packages above its own row. Names without the prefix `pb3dp-`.
const BELOW: &[(&str, &[&str])] = &[
    ("allocation-count", &[]),
    ("test-support", &[]),
    ("computing", &[]),
    ("message-codes", &[]),
    ("third-party", &[]),
    ("geometry", &["third-party"]),
    ("kinematics", &["geometry"]),
    ("estimation-core", &["message-codes", "computing", "geometry"]),
    ("estimation-test-support", &["estimation-core", "test-support"]),
    ("estimation-views", &["estimation-core"]),
    ("estimation-direct", &["estimation-views"]),
    ("estimation-track", &["estimation-direct"]),
    ("estimation-published", &["estimation-core"]),
    ("estimation", &["estimation-track", "estimation-published"]),
    ("camera-settings", &["geometry"]),
    ("record", &["message-codes", "camera-settings"]),
    ("servo", &["message-codes", "kinematics"]),
    ("sim", &["message-codes", "computing", "kinematics"]),
    ("hal-api", &["message-codes", "kinematics"]),
    ("hal-clock", &["hal-api"]),
    ("hal-middleware", &["hal-api"]),
    ("hal-conformance", &["hal-api"]),
    ("camera-pixels", &["camera-settings"]),
    ("bag", &["record", "camera-pixels"]),
    ("camera-recordings", &["hal-api", "bag"]),
    ("camera-replay", &["camera-recordings"]),
    ("camera-sim", &["hal-api", "sim"]),
    ("camera-v4l2", &["hal-api", "camera-pixels"]),
    ("hal-platform", &["geometry"]),
    ("arm-pa10-protocol", &["kinematics"]),
    ("arm-pa10", &["hal-api", "hal-platform", "arm-pa10-protocol"]),
    ("arm-pa10-gateway", &["arm-pa10"]),
    ("arm-pa10-emulation", &["sim", "arm-pa10-gateway"]),
    ("arm-pa10-test-support", &["hal-clock", "arm-pa10-emulation", "test-support"]),
    ("benchmarks", &["estimation", "record", "sim", "hal-platform"]),
    // Settings of cameras and arms as text: no backend.
    ("setup", &["estimation", "record", "servo", "sim", "hal-middleware", "hal-platform", "arm-pa10-protocol"]),
    ("calibration", &["camera-recordings", "setup"]),
    ("cell", &["bag", "hal-clock", "setup"]),
    ("recording", &["cell"]),
    ("panel", &["cell"]),
    ("wiring", &["camera-replay", "camera-sim", "camera-v4l2", "arm-pa10-emulation", "panel"]),
    ("commissioning", &["recording", "wiring"]),
    ("orchestrator", &["commissioning", "calibration"]),
    ("python", &["recording", "wiring"]),
];

/// Additional packages for tests of any package.
const BELOW_ALL_TESTS: [&str; 3] = ["allocation-count", "computing", "test-support"];

/// Additional packages for tests of a package in `hal/`: the conformance suite of all backends, and a clock to run it.
const BELOW_HAL_TESTS: [&str; 2] = ["hal-conformance", "hal-clock"];

/// Additional packages for tests of one package, with all that is below: a wrapper is tested around the arm without hardware.
const BELOW_TESTS_OF: &[(&str, &str)] = &[
    ("cell", "arm-pa10-emulation"),
    ("estimation-core", "estimation-test-support"),
    ("estimation-views", "estimation-test-support"),
    ("estimation-direct", "estimation-test-support"),
    ("estimation-track", "estimation-test-support"),
    ("estimation-published", "estimation-test-support"),
    ("estimation", "estimation-test-support"),
    ("hal-middleware", "arm-pa10-test-support"),
    ("arm-pa10", "arm-pa10-test-support"),
    ("arm-pa10-gateway", "arm-pa10-test-support"),
    ("arm-pa10-emulation", "arm-pa10-test-support"),
    ("orchestrator", "arm-pa10-test-support"),
];

/// Packages outside the table: the whole-system tests may depend on all, the project commands on none.
const SEES_ALL: &str = "system-tests";
const SEES_NOTHING: &str = "xtask";

/// Without code: it has third-party crates for their features only.
const NO_CODE: &str = "third-party";

/// Its examples measure whole runs.
const MEASURES_ALL: &str = "benchmarks";

/// Packages that may read and write files, and those of them that may derive the traits of serde: elsewhere the structure of a file
/// must not depend on that of a type.
const FORMAT_USERS: [&str; 10] =
    ["setup", "cell", "panel", "commissioning", "orchestrator", "python", "record", "bag", "benchmarks", "calibration"];
const FORMATS: [&str; 4] = ["serde_json", "serde-saphyr", "toml", "figment"];
const SERDE_USERS: [&str; 6] = ["setup", "cell", "panel", "commissioning", "orchestrator", "record"];
const SERDE: [&str; 2] = ["serde", "serde_derive"];

/// The name in the tables.
fn short(name: &str) -> &str {
    name.strip_prefix("pb3dp-").unwrap_or(name)
}

/// Checks every package against the tables; packages of others in the tree have no rules.
pub fn check(packages: &[Package]) -> Vec<Violation> {
    let ours = packages.iter().filter(|package| !package.folder.starts_with("hal/vendor/"));
    let names: Vec<&str> = ours.clone().map(|package| short(&package.name)).collect();
    ours.flat_map(|package| check_package(package, &names)).collect()
}

/// Whether a package is this one or below it.
fn is_below(package: &str, name: &str) -> bool {
    let row = BELOW.iter().find(|(of, _)| *of == name);
    package == name || row.is_some_and(|(_, below)| below.iter().any(|next| is_below(package, next)))
}

fn check_package(package: &Package, ours: &[&str]) -> Vec<Violation> {
    let (own, place) = (short(&package.name), format!("package {}", short(&package.name)));
    let [dependencies, test_dependencies] =
        [&package.dependencies, &package.test_dependencies].map(|list| list.iter().map(|name| short(name)));
    if own == SEES_ALL {
        return Vec::new();
    }
    if own != SEES_NOTHING && !BELOW.iter().any(|(name, _)| *name == own) {
        let message = "is not in the table of xtask/src/check_deps/graph.rs: add a row, in its layer";
        return vec![Violation::of(&place, "unknown-package", message)];
    }
    let mut violations = Vec::new();
    let is_wrong = |name: &&str| ours.contains(name) && !is_below(name, own);
    for name in dependencies.clone().filter(is_wrong) {
        let message = format!("must not depend on {name}: see the layers in ARCHITECTURE.md");
        violations.push(Violation::of(&place, "direction", message));
    }
    for name in test_dependencies.filter(is_wrong).filter(|name| !is_below_tests(package, name)) {
        let message = format!("its tests must not depend on {name}: move them to the folder tests/");
        violations.push(Violation::of(&place, "direction", message));
    }
    if [SEES_NOTHING, NO_CODE].contains(&own) {
        return violations;
    }
    for (crates, users) in [(&FORMATS[..], &FORMAT_USERS[..]), (&SERDE, &SERDE_USERS)] {
        let found = dependencies.clone().filter(|name| crates.contains(name) && !users.contains(&own));
        violations.extend(found.map(|name| {
            let message = format!("must not depend on {name}: only {users:?} do; define the file format there");
            Violation::of(&place, "serde", message)
        }));
    }
    violations
}

fn is_below_tests(package: &Package, name: &str) -> bool {
    let own = short(&package.name);
    own == MEASURES_ALL
        || BELOW_ALL_TESTS.contains(&name)
        || (package.folder.starts_with("hal/") && BELOW_HAL_TESTS.contains(&name))
        || BELOW_TESTS_OF.iter().any(|(of, below)| *of == own && is_below(name, below))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: &str, in_hal: bool, dependencies: &[&str], test_dependencies: &[&str]) -> Package {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let (dependencies, test_dependencies) = (owned(dependencies), owned(test_dependencies));
        let folder = format!("{}/{name}/", if in_hal { "hal" } else { "crates" });
        Package { name: name.to_owned(), folder, dependencies, test_dependencies }
    }

    fn rules(package: Package) -> Vec<&'static str> {
        let names: Vec<&str> = BELOW.iter().map(|(name, _)| *name).chain([SEES_ALL, SEES_NOTHING]).collect();
        check_package(&package, &names).into_iter().map(|v| v.rule).collect()
    }

    #[test]
    fn the_table_has_no_arrow_that_runs_upwards() {
        for (index, (name, below)) in BELOW.iter().enumerate() {
            for dependency in *below {
                let above = BELOW[..index].iter().any(|(earlier, _)| earlier == dependency);
                assert!(above, "{name} -> {dependency}: {dependency} must have its line before {name}");
            }
        }
    }

    #[test]
    fn backends_stay_strangers_to_each_other() {
        let backends = ["camera-replay", "camera-sim", "camera-v4l2", "arm-pa10"];
        let may_name = ["orchestrator", "wiring", "commissioning", "python"];
        for (name, _) in BELOW.iter().filter(|(name, _)| !may_name.contains(name)) {
            // The parts of one backend may depend on each other.
            let named = backends.into_iter().find(|backend| !name.starts_with(backend) && is_below(backend, name));
            assert_eq!(named, None, "named by {name}");
        }
    }

    #[test]
    fn an_upward_arrow_is_caught() {
        assert_eq!(rules(with("estimation", false, &["geometry", "nalgebra"], &[])), [""; 0]);
        assert_eq!(rules(with("estimation", false, &["kinematics"], &[])), ["direction"]);
        assert_eq!(rules(with("servo", false, &["arm-pa10"], &[])), ["direction"]);
        assert_eq!(rules(with("servo", false, &["geometry"], &["sim"])), ["direction"]);
        assert_eq!(rules(with("xtask", false, &["geometry"], &[])), ["direction"]);
        assert_eq!(rules(with("system-tests", false, &["orchestrator", "camera-sim"], &[])), [""; 0]);
    }

    #[test]
    fn the_conformance_suite_is_for_tests_in_hal_alone() {
        assert_eq!(rules(with("camera-sim", true, &["sim"], &["hal-conformance"])), [""; 0]);
        assert_eq!(rules(with("camera-sim", true, &["hal-conformance"], &[])), ["direction"]);
        assert_eq!(rules(with("sim", false, &[], &["hal-conformance"])), ["direction"]);
        assert_eq!(rules(with("hal-middleware", true, &[], &["arm-pa10"])), [""; 0]);
        assert_eq!(rules(with("hal-middleware", true, &["arm-pa10"], &[])), ["direction"]);
        assert_eq!(rules(with("sim", false, &[], &["allocation-count"])), [""; 0]);
        assert_eq!(rules(with("sim", false, &["allocation-count"], &[])), ["direction"]);
        assert_eq!(rules(with("sim", false, &[], &["test-support"])), [""; 0]);
        assert_eq!(rules(with("arm-pa10", true, &["arm-pa10-test-support"], &[])), ["direction"]);
        assert_eq!(rules(with("camera-sim", true, &[], &["arm-pa10"])), ["direction"]);
    }

    #[test]
    fn serde_and_unknown_packages_are_caught() {
        assert_eq!(rules(with("geometry", false, &["serde"], &[])), ["serde"]);
        assert_eq!(rules(with("bag", false, &["serde_json"], &[])), [""; 0]);
        assert_eq!(rules(with("bag", false, &["serde"], &[])), ["serde"]);
        assert_eq!(rules(with("record", false, &["serde", "serde-saphyr"], &[])), [""; 0]);
        assert_eq!(rules(with("vision", false, &[], &[])), ["unknown-package"]);
    }
}
