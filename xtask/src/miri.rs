//! `cargo xtask miri`: checks the unsafe kernels for undefined behaviour.

use crate::toolchains::nightly;
use crate::workspace::{Workspace, run_visibly};

/// Checks the scalar forms of the unsafe kernels for undefined behaviour: runs some of their unit tests in the interpreter Miri.
///
/// Miri checks each memory access and each unchecked conversion. It reports no processor features, so each kernel runs in its
/// scalar form. An interpreter is some thousand times slower than the processor, so only small tests run.
/// Needs the nightly toolchain with the components miri and rust-src: `rustup toolchain install nightly --profile minimal`,
/// `rustup component add --toolchain nightly miri rust-src`. Without them the check is skipped.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {}

/// The unit tests of one package that run in Miri.
struct Interpreted {
    package: &'static str,
    /// Names of the tests.
    tests: &'static [&'static str],
}

/// All kernels with unsafe code. Tests on large images, and those of proptest, take minutes in an interpreter and are omitted.
const INTERPRETED: [Interpreted; 3] = [
    Interpreted { package: "pb3dp-estimation-core", tests: &["wide::tests::every_width_gives_the_same_bits"] },
    Interpreted {
        package: "pb3dp-estimation-direct",
        tests: &["photometric::kernel::tests::places_outside_the_right_planes_are_not_read"],
    },
    Interpreted {
        package: "pb3dp-camera-pixels",
        tests: &[
            "yuyv::tests::black_white_and_primaries_are_exact",
            "yuyv::tests::the_two_pixels_of_a_pair_keep_their_order",
        ],
    },
];

/// # Errors
/// [`NotPossible`](crate::not_possible::NotPossible) without the nightly toolchain or Miri; otherwise if Miri finds undefined
/// behaviour, or a test fails.
pub fn run(workspace: &Workspace) -> anyhow::Result<()> {
    let target = workspace.target_folder()?.join("miri");
    for Interpreted { package, tests } in &INTERPRETED {
        let mut command = nightly(workspace, Some("miri"))?;
        command.args(["miri", "test", "--locked", "--lib", "--package", package, "--", "--exact"]).args(*tests);
        // proptest and `sweep` read environment variables.
        command.env("CARGO_TARGET_DIR", &target).env("MIRIFLAGS", "-Zmiri-disable-isolation");
        run_visibly(&mut command)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A name without a test would run nothing, and the check would pass.
    #[test]
    fn every_interpreted_test_exists() {
        let workspace = Workspace::find().unwrap();
        let sources = workspace.texts(&[".rs"]).unwrap();
        for Interpreted { package, tests } in &INTERPRETED {
            let name = package.trim_start_matches("pb3dp-");
            let parent = if name.starts_with("camera") { "hal" } else { "crates" };
            let folder = format!("{parent}/{name}/src/");
            for test in *tests {
                let (module, name) = test.rsplit_once("::").unwrap();
                let module = module.trim_end_matches("::tests").replace("::", "/");
                let declared = format!("#[test]\nfn {name}()");
                let indented = format!("#[test]\n    fn {name}()");
                let found = sources.iter().any(|source| {
                    source.path.starts_with(&format!("{folder}{module}"))
                        && (source.text.contains(&declared) || source.text.contains(&indented))
                });
                assert!(found, "{package} has no test {test}");
            }
        }
    }
}
