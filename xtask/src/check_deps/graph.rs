//! Dependencies between our packages, and on serde, from `cargo metadata`.

use anyhow::Context;
use serde_json::Value;

use crate::violation::Violation;

/// One row per package: which of our packages it may depend on. Lowest layer first; a package may depend only on packages
/// above its own row. Names without the prefix `pb3dp-`.
const ALLOWED: [(&str, &[&str]); 43] = [
    ("allocation-count", &[]),
    ("test-support", &[]),
    ("computing", &[]),
    ("message-codes", &[]),
    ("third-party", &[]),
    ("geometry", &["third-party"]),
    ("kinematics", &["geometry"]),
    ("estimation-core", &["message-codes", "computing", "geometry"]),
    ("estimation-test-support", &["geometry", "estimation-core", "test-support"]),
    ("estimation-direct", &["geometry", "estimation-core"]),
    ("estimation-track", &["geometry", "estimation-core", "estimation-direct"]),
    ("estimation-published", &["geometry", "estimation-core"]),
    ("estimation", &["geometry", "estimation-core", "estimation-direct", "estimation-track", "estimation-published"]),
    ("camera-settings", &["geometry"]),
    ("record", &["message-codes", "geometry", "camera-settings"]),
    ("servo", &["message-codes", "geometry", "kinematics"]),
    ("sim", &["message-codes", "computing", "geometry", "kinematics"]),
    ("hal-api", &["message-codes", "geometry", "kinematics"]),
    ("hal-clock", &["geometry", "hal-api"]),
    ("hal-middleware", &["geometry", "kinematics", "hal-api"]),
    ("hal-conformance", &["geometry", "kinematics", "hal-api"]),
    ("camera-pixels", &["geometry", "camera-settings"]),
    ("bag", &["message-codes", "geometry", "record", "camera-pixels", "camera-settings"]),
    ("camera-recordings", &["geometry", "hal-api", "record", "bag", "camera-settings"]),
    ("camera-replay", &["geometry", "hal-api", "record", "camera-recordings"]),
    ("camera-sim", &["geometry", "kinematics", "hal-api", "sim"]),
    ("camera-v4l2", &["geometry", "hal-api", "camera-settings", "camera-pixels"]),
    ("hal-platform", &["geometry"]),
    ("arm-pa10-protocol", &["geometry", "kinematics"]),
    ("arm-pa10", &["message-codes", "geometry", "kinematics", "hal-api", "hal-platform", "arm-pa10-protocol"]),
    ("arm-pa10-gateway", &["message-codes", "geometry", "kinematics", "hal-platform", "arm-pa10-protocol", "arm-pa10"]),
    (
        "arm-pa10-emulation",
        &[
            "geometry",
            "kinematics",
            "hal-api",
            "hal-platform",
            "sim",
            "arm-pa10-protocol",
            "arm-pa10",
            "arm-pa10-gateway",
        ],
    ),
    (
        "arm-pa10-test-support",
        &[
            "geometry",
            "kinematics",
            "hal-api",
            "hal-clock",
            "hal-platform",
            "sim",
            "arm-pa10-protocol",
            "arm-pa10",
            "arm-pa10-gateway",
            "arm-pa10-emulation",
            "test-support",
        ],
    ),
    (
        "benchmarks",
        &[
            "geometry",
            "estimation-core",
            "estimation-direct",
            "estimation-track",
            "estimation-published",
            "estimation",
            "record",
            "sim",
            "hal-platform",
        ],
    ),
    (
        "setup",
        &[
            "message-codes",
            "geometry",
            "kinematics",
            "estimation-core",
            "estimation-direct",
            "estimation-track",
            "estimation-published",
            "estimation",
            "record",
            "servo",
            "sim",
            "hal-middleware",
            "hal-platform",
            // Settings of cameras and arms as text: no backend.
            "camera-settings",
            "arm-pa10-protocol",
        ],
    ),
    ("calibration", &["geometry", "record", "bag", "camera-recordings", "setup"]),
    (
        "cell",
        &[
            "message-codes",
            "geometry",
            "kinematics",
            "estimation-core",
            "estimation",
            "record",
            "bag",
            "servo",
            "sim",
            "hal-api",
            "hal-clock",
            "hal-middleware",
            "hal-platform",
            "setup",
        ],
    ),
    (
        "recording",
        &[
            "geometry",
            "kinematics",
            "estimation-core",
            "estimation",
            "record",
            "bag",
            "servo",
            "sim",
            "hal-api",
            "hal-clock",
            "hal-middleware",
            "setup",
            "cell",
        ],
    ),
    (
        "panel",
        &[
            "message-codes",
            "geometry",
            "kinematics",
            "estimation-core",
            "estimation",
            "servo",
            "hal-platform",
            "hal-api",
            "setup",
            "cell",
        ],
    ),
    (
        "wiring",
        &[
            "message-codes",
            "geometry",
            "kinematics",
            "estimation",
            "record",
            "sim",
            "hal-api",
            "hal-clock",
            "hal-middleware",
            "hal-platform",
            "camera-replay",
            "camera-sim",
            "camera-settings",
            "camera-v4l2",
            "arm-pa10-protocol",
            "arm-pa10",
            "arm-pa10-gateway",
            "arm-pa10-emulation",
            "setup",
            "cell",
            "panel",
        ],
    ),
    (
        "commissioning",
        &[
            "geometry",
            "kinematics",
            "record",
            "servo",
            "sim",
            "hal-api",
            "hal-clock",
            "hal-middleware",
            "hal-platform",
            "arm-pa10-protocol",
            "arm-pa10",
            "arm-pa10-gateway",
            "arm-pa10-emulation",
            "setup",
            "cell",
            "recording",
            "wiring",
        ],
    ),
    (
        "orchestrator",
        &[
            "message-codes",
            "setup",
            "cell",
            "recording",
            "panel",
            "wiring",
            "commissioning",
            "calibration",
            "geometry",
            "kinematics",
            "estimation-core",
            "estimation-direct",
            "estimation-track",
            "estimation-published",
            "estimation",
            "record",
            "bag",
            "servo",
            "sim",
            "hal-api",
            "hal-clock",
            "hal-middleware",
            "camera-replay",
            "camera-sim",
            "camera-settings",
            "camera-v4l2",
            "hal-platform",
            "arm-pa10-protocol",
            "arm-pa10",
            "arm-pa10-gateway",
            "arm-pa10-emulation",
        ],
    ),
    (
        "python",
        &[
            "geometry",
            "estimation-core",
            "estimation",
            "record",
            "recording",
            "hal-api",
            "hal-platform",
            "setup",
            "cell",
            "wiring",
        ],
    ),
];

/// Additional packages for tests of any package.
const ALLOWED_IN_ALL_TESTS: [&str; 3] = ["allocation-count", "computing", "test-support"];

/// Additional packages for tests of a package in `hal/`: the conformance suite of all backends, and a clock to run it.
const ALLOWED_IN_HAL_TESTS: [&str; 2] = ["hal-conformance", "hal-clock"];

/// Additional packages for tests of one package: a wrapper is tested around the arm without hardware, and a calibration on
/// simulated rigs, whose arms have joints.
const ALLOWED_IN_TESTS_OF: [(&str, &[&str]); 13] = [
    ("cell", &["arm-pa10-emulation"]),
    ("estimation-core", &["estimation-test-support"]),
    ("estimation-direct", &["estimation-test-support"]),
    ("estimation-track", &["estimation-test-support"]),
    ("estimation-published", &["estimation-test-support"]),
    ("estimation", &["estimation-test-support"]),
    (
        "hal-middleware",
        &[
            "arm-pa10",
            "arm-pa10-protocol",
            "arm-pa10-gateway",
            "arm-pa10-emulation",
            "arm-pa10-test-support",
            "hal-platform",
            "sim",
        ],
    ),
    ("arm-pa10", &["arm-pa10-gateway", "arm-pa10-emulation", "arm-pa10-test-support", "sim"]),
    ("arm-pa10-gateway", &["arm-pa10-test-support"]),
    ("arm-pa10-emulation", &["arm-pa10-test-support"]),
    ("orchestrator", &["arm-pa10-test-support", "arm-pa10-protocol", "arm-pa10-gateway", "arm-pa10-emulation", "sim"]),
    ("calibration", &["kinematics", "sim"]),
    ("panel", &["hal-clock"]),
];

/// Packages outside the table: the whole-system tests may depend on all, the project commands on none.
const SEES_ALL: &str = "system-tests";
const SEES_NOTHING: &str = "xtask";

/// Without code: it has third-party crates for their features only.
const NO_CODE: &str = "third-party";

/// Its examples measure whole runs.
const MEASURES_ALL: &str = "benchmarks";

/// Packages that may serialise and deserialise structures.
const SERDE_USERS: [&str; 10] =
    ["setup", "cell", "panel", "commissioning", "orchestrator", "python", "record", "bag", "benchmarks", "calibration"];
const SERDE_CRATES: [&str; 6] = ["serde", "serde_json", "serde-saphyr", "toml", "figment", "serde_derive"];

/// One of our packages and its dependencies.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Package {
    /// Name without the prefix `pb3dp-`.
    pub name: String,
    /// Whether it is in `hal/`.
    pub in_hal: bool,
    /// Normal and build dependencies, ours without the prefix.
    pub dependencies: Vec<String>,
    /// Dependencies of its tests, ours without the prefix.
    pub test_dependencies: Vec<String>,
}

fn short(name: &str) -> String {
    name.strip_prefix("pb3dp-").unwrap_or(name).to_owned()
}

/// Third-party packages in the tree, which the rules do not cover.
const VENDORED: &str = "/hal/vendor/";

/// Members of the workspace from the output of `cargo metadata`.
///
/// # Errors
/// If the output lacks a required key.
pub fn packages(metadata: &Value) -> anyhow::Result<Vec<Package>> {
    let all = metadata["packages"].as_array().context("`packages` is missing from cargo metadata")?;
    let is_vendored = |package: &Value| package["manifest_path"].as_str().is_some_and(|path| path.contains(VENDORED));
    all.iter().filter(|package| package["source"].is_null() && !is_vendored(package)).map(package).collect()
}

fn package(package: &Value) -> anyhow::Result<Package> {
    let name = package["name"].as_str().context("a package has no name")?;
    let manifest = package["manifest_path"].as_str().context("a package has no manifest")?.replace('\\', "/");
    let mut found = Package { name: short(name), in_hal: manifest.contains("/hal/"), ..Package::default() };
    for dependency in package["dependencies"].as_array().context("a package has no dependencies")? {
        let name = short(dependency["name"].as_str().context("a dependency has no name")?);
        let for_tests = dependency["kind"].as_str() == Some("dev");
        if for_tests { found.test_dependencies.push(name) } else { found.dependencies.push(name) }
    }
    Ok(found)
}

/// Checks every package against the tables.
pub fn check(packages: &[Package]) -> Vec<Violation> {
    let ours: Vec<&str> = packages.iter().map(|package| package.name.as_str()).collect();
    packages.iter().flat_map(|package| check_package(package, &ours)).collect()
}

fn check_package(package: &Package, ours: &[&str]) -> Vec<Violation> {
    let place = format!("package {}", package.name);
    if package.name == SEES_ALL {
        return Vec::new();
    }
    let listed = ALLOWED.iter().find(|(name, _)| *name == package.name).map(|(_, allowed)| *allowed);
    let allowed: &[&str] = match listed {
        Some(allowed) => allowed,
        None if package.name == SEES_NOTHING => &[],
        None => {
            let message = "is not in the table of xtask/src/check_deps/graph.rs: add a row, in its layer";
            return vec![Violation::of(&place, "unknown-package", message)];
        }
    };
    let mut violations = Vec::new();
    let is_ours = |name: &&String| ours.contains(&name.as_str());
    for name in package.dependencies.iter().filter(is_ours).filter(|name| !allowed.contains(&name.as_str())) {
        let message = format!("must not depend on {name}: see the layers in ARCHITECTURE.md");
        violations.push(Violation::of(&place, "direction", message));
    }
    for name in package.test_dependencies.iter().filter(is_ours) {
        if !allowed.contains(&name.as_str()) && !is_allowed_in_tests(package, name) {
            let message = format!("its tests must not depend on {name}: move them to the folder tests/");
            violations.push(Violation::of(&place, "direction", message));
        }
    }
    if ![SEES_NOTHING, NO_CODE].contains(&package.name.as_str()) && !SERDE_USERS.contains(&package.name.as_str()) {
        for name in package.dependencies.iter().filter(|name| SERDE_CRATES.contains(&name.as_str())) {
            let message = format!("must not depend on {name}: only {SERDE_USERS:?} read and write files");
            violations.push(Violation::of(&place, "serde", message));
        }
    }
    violations
}

fn is_allowed_in_tests(package: &Package, name: &str) -> bool {
    let by_name = ALLOWED_IN_TESTS_OF.iter().any(|(of, allowed)| *of == package.name && allowed.contains(&name));
    let sees_all = package.name == MEASURES_ALL;
    sees_all
        || ALLOWED_IN_ALL_TESTS.contains(&name)
        || by_name
        || (package.in_hal && ALLOWED_IN_HAL_TESTS.contains(&name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(name: &str, in_hal: bool, dependencies: &[&str], test_dependencies: &[&str]) -> Package {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let (dependencies, test_dependencies) = (owned(dependencies), owned(test_dependencies));
        Package { name: name.to_owned(), in_hal, dependencies, test_dependencies }
    }

    fn rules(package: Package) -> Vec<&'static str> {
        let names: Vec<&str> = ALLOWED.iter().map(|(name, _)| *name).chain([SEES_ALL, SEES_NOTHING]).collect();
        check_package(&package, &names).into_iter().map(|v| v.rule).collect()
    }

    #[test]
    fn the_table_has_no_arrow_that_runs_upwards() {
        for (index, (name, allowed)) in ALLOWED.iter().enumerate() {
            for dependency in *allowed {
                let above = ALLOWED[..index].iter().any(|(earlier, _)| earlier == dependency);
                assert!(above, "{name} -> {dependency}: {dependency} must have its line before {name}");
            }
        }
    }

    #[test]
    fn backends_stay_strangers_to_each_other() {
        let backends = ["camera-replay", "camera-sim", "camera-v4l2", "arm-pa10"];
        // The last two by what the rows above them name.
        let may_name = ["orchestrator", "wiring", "commissioning", "setup", "cell"];
        for (name, allowed) in ALLOWED.iter().filter(|(name, _)| !may_name.contains(name)) {
            // The parts of one backend may depend on each other.
            let is_own = |backend: &str| name.starts_with(backend);
            let named = backends
                .iter()
                .find(|backend| !is_own(backend) && allowed.iter().any(|dependency| dependency.starts_with(*backend)));
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
        assert_eq!(rules(with("record", false, &["serde", "serde-saphyr"], &[])), [""; 0]);
        assert_eq!(rules(with("vision", false, &[], &[])), ["unknown-package"]);
    }

    #[test]
    fn metadata_is_understood() {
        let metadata = serde_json::json!({"packages": [
            {"name": "serde", "source": "registry+x", "manifest_path": "/r/Cargo.toml", "dependencies": []},
            {"name": "v4l2-sys-mit", "source": null, "manifest_path": "/x/hal/vendor/v4l2-sys-mit/Cargo.toml", "dependencies": []},
            {"name": "pb3dp-camera-sim", "source": null, "manifest_path": "/x/hal/camera-sim/Cargo.toml", "dependencies": [
                {"name": "pb3dp-sim", "kind": null}, {"name": "pb3dp-hal-conformance", "kind": "dev"}]},
        ]});
        let expected = with("camera-sim", true, &["sim"], &["hal-conformance"]);
        assert_eq!(packages(&metadata).expect("complete"), [expected]);
    }
}
