//! `cargo xtask vm`: tests the hardware interfaces with the real drivers of a real kernel in an emulated computer.

mod archive;
mod control;
mod kernel;
mod machine;
mod modules;
mod suites;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, bail};

use crate::files::{create_folder, remove_folder};
use crate::not_possible::NotPossible;
use crate::workspace::{Workspace, run_visibly};
use archive::Archive;
use kernel::Kernel;
use machine::Machine;
use suites::{SUITES, Suite};

/// Whether this system can build programs for the guest.
pub const CAN_BE_BUILT: bool = cfg!(all(target_arch = "x86_64", target_os = "linux"));

/// The guest has neither libraries nor a dynamic linker.
const TARGET: &str = "x86_64-unknown-linux-gnu";
const RUSTFLAGS: &str = "-C target-feature=+crt-static -C strip=debuginfo";

/// Build profile of the programs: an emulated computer is many times slower than this one, and code that is not inlined costs minutes.
const PROFILE: &str = "guest";

/// Attempts for a suite whose QEMU crashes: QEMU of Debian 12 sometimes crashes when a USB device is unplugged.
const TRIES: u32 = 3;

/// Tests the hardware interfaces on a real kernel with its own drivers, in an emulated computer (QEMU, without KVM).
///
/// serial  the serial ports of an arm: USB adapters (ftdi_sio) and a 16550; their detection, rates and permissions,
///         a cable that is unplugged while an arm moves, the system calls of a cycle of 2 ms
/// arcnet  the bus of an arm: the kernel's ARCNET driver (arc_rimi, arc_rawmode) on a card of plain memory;
///         two arms, each behind a gateway at an ARCNET interface of its own
/// cameras two cameras (vivid) as one: detection, modes and controls, 300 pairs at full rate,
///         skew, damaged and lost images, a camera that is unplugged, permissions
/// rig     `pb3dp run` itself with configs/rig.toml, two cameras (vivid) and two emulated
///         arms at the far ends of serial cables (ftdi_sio): it tracks, a camera is unplugged, it holds and stops; `pb3dp cameras`
/// rig-one-device
///         the same with one camera (vivid, HDMI) whose images have both views side by side
///
/// The time of the emulated computers is counted in instructions, so a busy machine takes longer but gets the same results. Suites run
/// in parallel. All suites take a minute or two on an idle machine, after the build; the program itself (rig) takes longest.
/// The kernel is that of the distribution (Debian, package linux-image-amd64, 6.1 or later), fetched by `apt-get download` and kept
/// in the user's cache folder; QEMU (qemu-system-x86) is installed by apt-get if permitted, otherwise the command asks for it.
/// The tests are root in the emulated computer; they do not change this one.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Suites to run; default: all.
    #[arg(value_parser = SUITES.map(|suite| suite.name))]
    suites: Vec<String>,
    /// Fetch the kernel again.
    #[arg(long)]
    renew: bool,
    /// Print the whole console of the guest.
    #[arg(long)]
    console: bool,
}

/// Names of the suites that test a package for which this is true.
pub fn suites_of(is_wanted: impl Fn(&str) -> bool) -> Vec<String> {
    SUITES.iter().filter(|suite| is_wanted(suite.package)).map(|suite| suite.name.to_owned()).collect()
}

/// Runs some suites.
///
/// # Errors
/// Those of [`run`].
pub fn run_suites(workspace: &Workspace, suites: Vec<String>) -> anyhow::Result<()> {
    run(workspace, &Args { suites, renew: false, console: false })
}

/// # Errors
/// [`NotPossible`] without kernel or QEMU; otherwise if a test fails or does not build.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    if !CAN_BE_BUILT {
        return Err(NotPossible::because("the guest is Linux on x86-64 and must be built on the same system"));
    }
    let qemu = machine::find_qemu()?;
    let kernel = Kernel::get(&cache_folder(workspace)?, args.renew)?;
    println!("kernel {}", kernel.release);
    let wanted = |suite: &&Suite| args.suites.is_empty() || args.suites.iter().any(|name| name == suite.name);
    let wanted: Vec<&Suite> = SUITES.iter().filter(wanted).collect();
    let ready = build(workspace, &wanted)?;
    // An emulated computer has one processor: the suites do not disturb each other, because their time is counted.
    let outcomes: Vec<anyhow::Result<()>> = std::thread::scope(|scope| {
        let started: Vec<_> = ready
            .iter()
            .map(|(suite, built)| {
                let packed = || pack(suite, &kernel, built, workspace);
                let (kernel, qemu) = (&kernel, &qemu);
                scope.spawn(move || run_suite(suite, packed()?, kernel, qemu, args.console))
            })
            .collect();
        started.into_iter().map(|thread| thread.join().unwrap_or_else(|_| bail!("panicked"))).collect()
    });
    let mut failed = Vec::new();
    for ((suite, ..), outcome) in ready.iter().zip(outcomes) {
        if let Err(error) = outcome {
            println!("{}: {error:#}", suite.name);
            failed.push(suite.name);
        }
    }
    if failed.is_empty() {
        return Ok(());
    }
    bail!(
        "failed: {}; repeat it with the guest's console by: cargo xtask vm --console {}",
        failed.join(", "),
        failed[0]
    )
}

fn run_suite(suite: &Suite, packed: Archive, kernel: &Kernel, qemu: &Path, shows_console: bool) -> anyhow::Result<()> {
    let begin = Instant::now();
    // Its path is short: sockets have at most 107 characters.
    let folder = std::env::temp_dir().join(format!("pb3dp-vm-{}-{}", std::process::id(), suite.name));
    create_folder(&folder)?;
    let disk = folder.join("initrd");
    let start = || Machine::start(qemu, &kernel.image, &disk, suite, &folder);
    let outcome = packed.write(&disk).and_then(|()| try_suite(suite, shows_console, start));
    remove_folder(&folder)?;
    println!("{}: {:.1} s", suite.name, begin.elapsed().as_secs_f64());
    outcome
}

/// Repeats a suite while QEMU itself crashes. A failed check stays failed, even if QEMU crashes afterwards.
fn try_suite(
    suite: &Suite,
    shows_console: bool,
    mut start: impl FnMut() -> anyhow::Result<Machine>,
) -> anyhow::Result<()> {
    let mut tries = 1;
    loop {
        let mut machine = start()?;
        let mut tally = Tally::default();
        let watched = watch(&mut machine, suite, shows_console, &mut tally);
        if tally.failed > 0 {
            let counts = format!("{} checks failed, {} passed", tally.failed, tally.passed);
            watched.context(counts.clone())?;
            bail!(counts);
        }
        let Err(error) = watched else { return Ok(()) };
        if tries == TRIES || !machine.has_crashed() {
            return Err(error);
        }
        println!("{}: QEMU itself has crashed: {error:#}", suite.name);
        tries += 1;
    }
}

/// Results of the checks so far.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    passed: u32,
    failed: u32,
}

/// The static test program, and the product.
struct Built {
    program: Vec<u8>,
    product: Option<Vec<u8>>,
}

/// The build of the programs of some suites, with a command prefix.
pub fn build_of_suites(workspace: &Workspace, before: &[&str], names: &[String]) -> Command {
    let suites: Vec<&Suite> = SUITES.iter().filter(|suite| names.iter().any(|name| name == suite.name)).collect();
    build_command(workspace.cargo_after(before), &suites)
}

fn build_command(mut cargo: Command, suites: &[&Suite]) -> Command {
    cargo.args(["build", "--quiet", "--locked", "--profile", PROFILE, "--target", TARGET]);
    cargo.env("RUSTFLAGS", RUSTFLAGS).env_remove("CARGO_ENCODED_RUSTFLAGS");
    cargo.args(programs_of(suites));
    cargo
}

/// The folder of the programs in the target folder.
pub fn folder_of_programs(target: &Path) -> PathBuf {
    target.join(TARGET).join(PROFILE)
}

/// The arguments of cargo that name the programs of some suites.
fn programs_of(suites: &[&Suite]) -> Vec<&'static str> {
    let mut asked: Vec<[&str; 2]> = Vec::new();
    for suite in suites {
        asked.extend([["--package", suite.package], ["--example", suite.example]]);
        if suite.has_product {
            asked.extend([["--package", "pb3dp-orchestrator"], ["--bin", "pb3dp"]]);
        }
    }
    asked.sort_unstable();
    asked.dedup();
    asked.concat()
}

/// All programs in one call of cargo, because otherwise their common code would be built once for each.
fn build<'a>(workspace: &Workspace, suites: &[&'a Suite]) -> anyhow::Result<Vec<(&'a Suite, Built)>> {
    suites.iter().for_each(|suite| println!("-- {}: {}", suite.name, suite.what));
    run_visibly(&mut build_command(workspace.cargo(), suites))?;
    let folder = folder_of_programs(&workspace.target_folder()?);
    let read = |name: &str| {
        let file = folder.join(name);
        std::fs::read(&file).with_context(|| format!("{} was not built", file.display()))
    };
    let built = |suite: &&'a Suite| {
        let program = read(&format!("examples/{}", suite.example))?;
        Ok((*suite, Built { program, product: suite.has_product.then(|| read("pb3dp")).transpose()? }))
    };
    suites.iter().map(built).collect()
}

/// Folder of the unpacked kernels, outside any build: the user's cache folder, or the target folder if there is none.
fn cache_folder(workspace: &Workspace) -> anyhow::Result<PathBuf> {
    let named = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let cache = named("XDG_CACHE_HOME").or_else(|| Some(named("HOME")?.join(".cache")));
    let ours = cache.map(|cache| cache.join("pb3dp").join("kernels"));
    match ours.filter(|folder| std::fs::create_dir_all(folder).is_ok()) {
        Some(folder) => Ok(folder),
        None => Ok(workspace.target_folder()?.join("vm")),
    }
}

/// The guest's initial file system: the program, modules in their order of loading, and the product with its configurations.
fn pack(suite: &Suite, kernel: &Kernel, built: &Built, workspace: &Workspace) -> anyhow::Result<Archive> {
    let mut archive = Archive::default();
    for folder in ["dev", "proc", "sys", "tmp", "modules"] {
        archive.folder(folder);
    }
    archive.console();
    archive.file("init", &built.program, true);
    if let Some(product) = &built.product {
        for folder in ["bin", "configs", "configs/robots", "configs/calibration"] {
            archive.folder(folder);
        }
        archive.file("bin/pb3dp", product, true);
        for file in ["configs/rig.toml", "configs/calibration/nominal.json", "configs/robots/pa10_gen2.urdf"] {
            let content = std::fs::read(workspace.root().join(file)).with_context(|| format!("cannot read {file}"))?;
            archive.file(file, &content, false);
        }
    }
    let (at_start, later) = modules::closure(&kernel.modules, suite.modules, suite.modules_by_hand)?;
    let list = |names: &[String]| names.iter().map(|name| format!("{name}\n")).collect::<String>();
    let names: Vec<String> = at_start.iter().map(|module| module.name.clone()).collect();
    archive.file("modules/order", list(&names).as_bytes(), false);
    for module in at_start.iter().chain(&later) {
        archive.file(&format!("modules/{}.ko", module.name), &module.content, false);
    }
    Ok(archive)
}

/// Executes the guest's requests, and counts its results.
fn watch(machine: &mut Machine, suite: &Suite, shows_console: bool, tally: &mut Tally) -> anyhow::Result<()> {
    let Tally { passed, failed } = tally;
    let mut last = Vec::new();
    while let Some(line) = machine.next_line().with_context(|| last_lines(&last))? {
        if shows_console {
            println!("{:8} | {line}", suite.name);
        }
        // Output of the kernel may stand before it. The guest's `report.rs` has the same words.
        let (word, text) =
            line.split_once("vm: ").and_then(|(_, output_text)| output_text.split_once(' ')).unwrap_or_default();
        match word {
            "passed" => {
                *passed += 1;
                println!("{:8} ok      {text}", suite.name);
            }
            "failed" => {
                *failed += 1;
                println!("{:8} FAILED  {text}", suite.name);
            }
            "note" => println!("{:8}         {text}", suite.name),
            "unplug" => machine.unplug(text)?,
            "plug" => machine.plug(suite, text)?,
            "end" if text == (*passed + *failed).to_string() && text != "0" => return Ok(()),
            "end" => bail!("{passed} checks passed, the guest reports {text}"),
            _ => last.push(line),
        }
    }
    bail!("the guest ended before its tests did, after {passed} checks; {}", last_lines(&last))
}

fn last_lines(lines: &[String]) -> String {
    let shown: Vec<&str> = lines.iter().rev().take(12).rev().map(String::as_str).collect();
    format!("its console said:\n{}", shown.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The result of a suite with a program in place of QEMU, and the number of its starts.
    fn outcome(name: &str, script: &str) -> (anyhow::Result<()>, usize) {
        let folder = std::env::temp_dir().join(format!("pb3dp-vm-test-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (text, qemu, log) = (folder.join("text"), folder.join("qemu"), folder.join("log"));
        std::fs::write(&text, format!("#!/bin/sh\necho started >> {}\n{script}\n", log.display())).unwrap();
        // Another process writes the program. If this one did, a process that another test starts meanwhile
        // could hold it open for writing, and Linux does not execute such a file (ETXTBSY).
        crate::workspace::output_of(Command::new("install").args(["-m", "755"]).args([&text, &qemu])).unwrap();
        let suite = &SUITES[1];
        let outcome = try_suite(suite, false, || Machine::start(&qemu, &folder, &folder, suite, &folder));
        let starts = std::fs::read_to_string(&log).unwrap().lines().count();
        std::fs::remove_dir_all(&folder).unwrap();
        (outcome, starts)
    }

    #[test]
    fn a_suite_is_begun_again_only_if_qemu_alone_has_failed() {
        let crash = "kill -SEGV $$";
        for (name, script, starts, expected) in [
            ("good", "echo '[0.1] vm: passed one'; echo vm: passe; echo vm: end 1".to_owned(), 1, None),
            (
                "crash",
                format!("echo vm: passed one; {crash}"),
                TRIES as usize,
                Some("the guest ended before its tests did"),
            ),
            (
                "failed",
                "echo vm: failed one; echo vm: passed two; echo vm: end 2".to_owned(),
                1,
                Some("1 checks failed, 1 passed"),
            ),
            (
                "both",
                format!("echo vm: passed one; echo vm: failed two; {crash}"),
                1,
                Some("1 checks failed, 1 passed"),
            ),
            ("after", format!("echo vm: failed one; echo vm: end 1; {crash}"), 1, Some("1 checks failed, 0 passed")),
            (
                "ended",
                "echo vm: passed one".to_owned(),
                1,
                Some("the guest ended before its tests did, after 1 checks"),
            ),
            (
                "count",
                "echo vm: passed one; echo vm: end 2".to_owned(),
                1,
                Some("1 checks passed, the guest reports 2"),
            ),
        ] {
            let (outcome, started) = outcome(name, &script);
            let error = outcome.err().map(|error| format!("{error:#}")).unwrap_or_default();
            assert!(
                error.starts_with(expected.unwrap_or_default()) && error.is_empty() == expected.is_none(),
                "{name}: {error}"
            );
            assert_eq!(started, starts, "{name}: {error}");
        }
    }
}
