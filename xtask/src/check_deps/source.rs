//! Access of a package's source text to the system: files, threads, clocks, the environment.

use crate::rust_text::{code_only, line_at, paths, without_test_items};
use crate::violation::Violation;

/// A part of the system, and the paths that access it.
type World = (&'static str, &'static [&'static str]);

const FILES: World =
    ("files", &["std::fs", "std::os", "image::open", "image::ImageReader::open", "image::save_buffer", "File::open"]);
const THREADS: World = ("threads", &["std::thread", "rayon"]);
const CLOCK: World = (
    "the wall clock",
    &["std::time::Instant", "std::time::SystemTime", "std::time::UNIX_EPOCH", "Instant::now", "SystemTime::now"],
);
const ENVIRONMENT: World = ("the environment", &["std::env"]);
const PROCESSES: World = ("other processes", &["std::process"]);
const NETWORK: World = ("the network", &["std::net"]);
const WORLDS: [World; 6] = [FILES, THREADS, CLOCK, ENVIRONMENT, PROCESSES, NETWORK];

/// The files and folders that may access the system, and which parts of it.
const ALLOWED: &[(&str, &[World])] = &[
    ("crates/bag/", &[FILES]),
    ("crates/bag/src/error.rs", &[NETWORK]),
    ("crates/bag/src/live/", &[THREADS, CLOCK, NETWORK]),
    ("crates/bag/src/queue.rs", &[THREADS]),
    ("crates/bag/src/recent.rs", &[THREADS]),
    ("crates/bag/src/writer.rs", &[THREADS, CLOCK]),
    ("crates/benchmarks/", &[FILES, THREADS, PROCESSES]),
    // The commands of calibration; all other code of the crate receives images.
    ("crates/calibration/src/command/", &[FILES, THREADS, PROCESSES]),
    ("crates/calibration/src/command/source.rs", &[CLOCK]),
    ("crates/calibration/src/main.rs", &[PROCESSES]),
    ("crates/cell/src/attended_motion.rs", &[THREADS]),
    ("crates/cell/src/compared.rs", &[CLOCK]),
    ("crates/cell/src/console.rs", &[THREADS]),
    ("crates/cell/src/console/reading.rs", &[THREADS]),
    ("crates/cell/src/flight.rs", &[FILES, CLOCK]),
    // Ends the program on a second signal.
    ("crates/cell/src/interruption.rs", &[FILES, THREADS, CLOCK, PROCESSES]),
    ("crates/cell/src/live.rs", &[THREADS]),
    ("crates/cell/src/lockstep.rs", &[THREADS]),
    ("crates/cell/src/vision.rs", &[CLOCK]),
    ("crates/cell/src/machine.rs", &[FILES, THREADS, ENVIRONMENT]),
    ("crates/cell/src/paced_clock.rs", &[THREADS, CLOCK]),
    ("crates/cell/src/report.rs", &[FILES]),
    ("crates/cell/src/stepped.rs", &[THREADS]),
    ("crates/cell/src/terminal.rs", &[THREADS]),
    ("crates/commissioning/", &[FILES, THREADS, CLOCK, ENVIRONMENT, PROCESSES]),
    ("crates/orchestrator/", &[FILES, THREADS, CLOCK, ENVIRONMENT, PROCESSES]),
    ("crates/panel/src/config.rs", &[NETWORK]),
    ("crates/panel/src/control_link.rs", &[CLOCK]),
    ("crates/panel/src/operator.rs", &[CLOCK]),
    ("crates/panel/src/panel.rs", &[THREADS, NETWORK]),
    ("crates/panel/src/preview.rs", &[CLOCK]),
    ("crates/panel/src/reporting.rs", &[THREADS, CLOCK]),
    ("crates/panel/src/server/", &[NETWORK]),
    ("crates/panel/src/server/checks.rs", &[CLOCK]),
    ("crates/panel/src/server/commands.rs", &[CLOCK]),
    ("crates/panel/src/server/mod.rs", &[THREADS]),
    ("crates/panel/src/server/rate.rs", &[CLOCK]),
    ("crates/panel/src/state_message.rs", &[CLOCK]),
    ("crates/record/", &[FILES]),
    ("crates/recording/", &[FILES]),
    ("crates/recording/src/pairs.rs", &[CLOCK]),
    ("crates/recording/src/replay/mod.rs", &[THREADS]),
    ("crates/setup/", &[FILES]),
    ("crates/setup/src/layers/variables.rs", &[FILES, ENVIRONMENT]),
    ("crates/wiring/src/parallel.rs", &[THREADS]),
    ("crates/wiring/src/calibration.rs", &[CLOCK]),
    ("crates/wiring/src/lib.rs", &[CLOCK]),
    // Tests move arms side by side.
    ("crates/wiring/src/sole_program.rs", &[ENVIRONMENT]),
    ("hal/arm-pa10-emulation/src/line/", &[FILES, THREADS, NETWORK]),
    ("hal/arm-pa10-gateway/src/bus/", &[FILES, CLOCK]),
    ("hal/arm-pa10-gateway/src/service/", &[FILES, THREADS, NETWORK]),
    // The folders of the arm's crates that do I/O; all other code receives bytes and time.
    ("hal/arm-pa10/src/arm/", &[FILES, THREADS, CLOCK]),
    ("hal/arm-pa10/src/serial/", &[FILES]),
    ("hal/camera-recordings/", &[FILES]),
    // The only folder of the cameras' crate with system calls.
    ("hal/camera-v4l2/src/linux/", &[FILES]),
    ("hal/clock/", &[THREADS, CLOCK]),
    ("hal/conformance/", &[THREADS, CLOCK]),
    // Byte streams, signals and real-time scheduling, for all backends.
    ("hal/platform/", &[FILES, THREADS, CLOCK, NETWORK]),
];

/// Crate names of the backends; only the modules in [`NAME_BACKENDS`] may name them.
const BACKENDS: [&str; 6] = [
    "pb3dp_camera_replay",
    "pb3dp_camera_sim",
    "pb3dp_camera_v4l2",
    "pb3dp_arm_pa10",
    "pb3dp_arm_pa10_gateway",
    "pb3dp_arm_pa10_emulation",
];

/// Modules that may name a backend: wiring, and the commands for one backend.
const NAME_BACKENDS: [&str; 4] = [
    "crates/wiring/",
    "crates/commissioning/",
    "crates/orchestrator/src/commands/cameras/",
    "crates/orchestrator/src/commands/doctor/",
];

/// Modules that may use a speed scale: the setup that states it, and the type that applies it. All others get effective limits.
const KNOW_SPEED_SCALE: [&str; 2] = ["crates/setup/", "crates/kinematics/src/effective_limits.rs"];

/// Folders whose texts may name options of the program: its commands, what only they use, and the readers of files, whose messages
/// `pb3dp-python` translates. All other code names an `Argument`.
const NAME_OPTIONS: [&str; 15] = [
    "crates/bag/",
    "crates/benchmarks/",
    "crates/calibration/",
    "crates/cell/",
    "crates/commissioning/",
    "crates/orchestrator/",
    "crates/panel/",
    "crates/python/src/wording.rs",
    "crates/record/",
    "crates/recording/",
    "crates/setup/",
    "crates/wiring/",
    "hal/camera-recordings/",
    "hal/camera-replay/",
    "hal/camera-v4l2/",
];

/// Checks one Rust file; tests, examples and the project's own commands are exempt.
pub fn check(path: &str, text: &str) -> Vec<Violation> {
    let is_product = (path.starts_with("crates/") || path.starts_with("hal/")) && path.contains("/src/");
    // A package that only tests depend on is a test.
    let is_test = path.contains("test-support/src/")
        || path.ends_with("/tests.rs")
        || path.ends_with("_tests.rs")
        || path.contains("/src/tests/");
    if !is_product || is_test || path.starts_with("hal/vendor/") {
        return Vec::new();
    }
    let code = without_test_items(&code_only(text));
    let mut violations = worlds(path, &code);
    violations.extend(backends(path, &code));
    violations.extend(speed_scales(path, &code));
    violations.extend(options(path, text));
    violations.sort();
    violations.dedup();
    violations
}

fn worlds(path: &str, code: &str) -> Vec<Violation> {
    let named = paths(code);
    let mut violations = Vec::new();
    for (what, forbidden) in WORLDS {
        let here = |(place, worlds): &(&str, &[World])| path.starts_with(place) && worlds.iter().any(|w| w.0 == what);
        if ALLOWED.iter().any(here) {
            continue;
        }
        for (line, name) in named.iter().filter(|(_, name)| forbidden.iter().any(|path| leads_to(name, path))) {
            let message = format!("`{name}`: only the places in xtask/src/check_deps/source.rs may use {what}");
            violations.push(Violation::at(path, *line, "outside-world", message));
        }
    }
    violations
}

/// Whether `name` is the forbidden path, a path below it, or a glob import of its parent.
fn leads_to(name: &str, forbidden: &str) -> bool {
    let name = name.trim_start_matches("::");
    let below = |prefix: &str| name == prefix || name.strip_prefix(prefix).is_some_and(|rest| rest.starts_with("::"));
    below(forbidden) || forbidden.rsplit_once("::").is_some_and(|(parent, _)| name == format!("{parent}::*"))
}

fn backends(path: &str, code: &str) -> Vec<Violation> {
    if !path.starts_with("crates/") || NAME_BACKENDS.iter().any(|place| path.starts_with(place)) {
        return Vec::new();
    }
    let violation = |backend: &str| {
        let line = line_at(code, code.find(backend).unwrap_or_default());
        Violation::at(
            path,
            line,
            "backend-named",
            format!("`{backend}`: only wiring and {NAME_BACKENDS:?} name backends"),
        )
    };
    BACKENDS.into_iter().filter(|backend| names_crate(code, backend)).map(violation).collect()
}

/// Whether the text names this crate, and not one whose name starts with the same letters.
fn names_crate(code: &str, name: &str) -> bool {
    let goes_on = |rest: &str| rest.starts_with(|c: char| c.is_alphanumeric() || c == '_');
    code.match_indices(name).any(|(at, _)| !goes_on(&code[at + name.len()..]))
}

fn speed_scales(path: &str, code: &str) -> Vec<Violation> {
    if KNOW_SPEED_SCALE.iter().any(|place| path.starts_with(place)) {
        return Vec::new();
    }
    let message = "`speed_scale`: use `EffectiveLimits`, which already contain it; do not multiply by it again";
    let found = code.match_indices("speed_scale");
    found.map(|(at, _)| Violation::at(path, line_at(code, at), "speed-scale", message)).collect()
}

/// Options of a command line in texts.
fn options(path: &str, text: &str) -> Vec<Violation> {
    // The remedies of message codes are the text of a command, `pb3dp explain`.
    if NAME_OPTIONS.iter().any(|place| path.starts_with(place)) || path.ends_with("/src/codes.rs") {
        return Vec::new();
    }
    let product = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    let lines = product.lines().enumerate().filter(|(_, line)| !line.trim_start().starts_with("//"));
    let names_option = |line: &str| {
        line.match_indices("--").any(|(at, dashes)| {
            let before = line[..at].ends_with([' ', '`', '"', '(']);
            before && line[at + dashes.len()..].starts_with(|c: char| c.is_ascii_lowercase())
        })
    };
    let message = "an option in a text: write an `Argument` of pb3dp-message-codes, which each program spells";
    let found = lines.filter(|(_, line)| names_option(line));
    found.map(|(index, _)| Violation::at(path, index + 1, "option-named", message)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(path: &str, text: &str) -> Vec<&'static str> {
        check(path, text).into_iter().map(|v| v.rule).collect()
    }

    #[test]
    fn the_outside_world_is_caught_in_pure_crates() {
        let path = "crates/estimation-published/src/search.rs";
        for text in [
            "use std::fs;",
            "use std::{fmt, time::Instant};",
            "use std::time::*;",
            "fn f() { ::std::thread::spawn(g); }",
            "fn f() { let t = std::time::SystemTime::now(); }",
            "fn f() { std::env::var(\"X\"); }",
            "use std::net::UdpSocket;",
            "use rayon::prelude::*;",
            "fn f() { image::open(p); }",
        ] {
            assert!(rules(path, text).contains(&"outside-world"), "{text}");
        }
    }

    #[test]
    fn values_tests_and_words_in_comments_pass() {
        let path = "crates/estimation-published/src/search.rs";
        for text in [
            "use std::time::Duration;",
            "// std::fs is not used here\nfn f() {}",
            "#[cfg(test)]\nmod tests {\n    use std::fs;\n}",
            "fn f() { my_std::fs_like(); }",
        ] {
            assert!(rules(path, text).is_empty(), "{text}");
        }
        assert!(rules("crates/record/src/files.rs", "use std::fs;").is_empty());
        assert!(rules("crates/estimation/examples/speed.rs", "use std::time::Instant;").is_empty());
        assert!(rules("hal/clock/src/lib.rs", "use std::time::{Duration, Instant};").is_empty());
    }

    #[test]
    fn the_clock_is_not_read_outside_its_rooms() {
        for path in ["crates/sim/src/scene.rs", "crates/servo/src/law.rs", "hal/camera-replay/src/lib.rs"] {
            assert_eq!(rules(path, "use std::time::Instant;"), ["outside-world"], "{path}");
        }
    }

    #[test]
    fn the_arm_does_io_in_few_folders() {
        for text in
            ["use std::thread;", "use std::os::fd::AsFd;", "use std::net::TcpStream;", "use std::time::Instant;"]
        {
            assert!(rules("hal/platform/src/tcp.rs", text).is_empty(), "{text}");
            for path in [
                "hal/arm-pa10/src/driver/machine.rs",
                "hal/arm-pa10/src/lib.rs",
                "hal/arm-pa10-gateway/src/gateway/machine.rs",
                "hal/arm-pa10-protocol/src/arcnet.rs",
            ] {
                assert_eq!(rules(path, text), ["outside-world"], "{path}: {text}");
            }
        }
    }

    #[test]
    fn a_speed_scale_is_applied_in_one_place() {
        let text = "fn f(limits: &L) -> f64 { limits.speed * self.speed_scale }";
        assert_eq!(rules("hal/middleware/src/guard.rs", text), ["speed-scale"]);
        assert!(rules("crates/kinematics/src/effective_limits.rs", text).is_empty());
        assert!(rules("crates/setup/src/setup/arms.rs", text).is_empty());
    }

    #[test]
    fn options_are_caught_in_libraries() {
        let path = "crates/estimation-direct/src/verdict.rs";
        let message = |option: &str| format!("fn f() -> &'static str {{ \"widen the range ({option})\" }}");
        assert_eq!(rules(path, &message("--z-range")), ["option-named"]);
        assert!(rules("crates/orchestrator/src/arguments.rs", &message("--z-range")).is_empty());
        for text in [
            message("SearchRange"),
            "// as for `--z-range`".to_owned(),
            "fn f(x: i32) -> i32 { -x--1 }".to_owned(),
            format!("#[cfg(test)]\nmod tests {{ {} }}", message("--z-range")),
        ] {
            assert!(rules(path, &text).is_empty(), "{text}");
        }
    }

    #[test]
    fn backends_are_caught() {
        assert_eq!(rules("crates/servo/src/a.rs", "use pb3dp_arm_pa10::Mock;"), ["backend-named"]);
        assert!(rules("crates/wiring/src/arm.rs", "use pb3dp_arm_pa10::Mock;").is_empty());
        assert_eq!(rules("crates/orchestrator/src/commands/run.rs", "use pb3dp_arm_pa10::Mock;"), ["backend-named"]);
        assert_eq!(rules("crates/cell/src/moving.rs", "use pb3dp_arm_pa10::Mock;"), ["backend-named"]);
        assert_eq!(rules("crates/setup/src/setup/link.rs", "use pb3dp_camera_v4l2::names::X;"), ["backend-named"]);
        assert!(rules("crates/setup/src/setup/link.rs", "use pb3dp_arm_pa10_protocol::places::BusTarget;").is_empty());
    }
}
