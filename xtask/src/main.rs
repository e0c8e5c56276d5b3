//! Project commands: `cargo xtask <command>`.
//!
//! One file per command. This package contains no code of the product, and the product does not depend on it. The commands
//! need rustc, cargo and cc; they use `git` if it is installed.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program for the terminal")]

mod apt;
mod bench;
mod check_deps;
mod ci;
mod commissioning;
mod demo;
mod files;
mod fuzz_build;
mod hil;
mod licences;
mod miri;
mod not_possible;
mod package;
mod packages;
mod panel;
mod pytest;
mod python_package;
mod recordings;
mod reference;
mod required;
mod rust_text;
mod safeguard_switches;
mod same_answers;
mod scratch;
mod seeded_bugs;
mod soak;
mod test;
mod tidy;
mod toolchains;
mod violation;
mod vm;
mod workspace;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::workspace::Workspace;

/// Commands of the pb3dp project.
#[derive(Parser)]
#[command(name = "cargo xtask", version, about, long_about = None)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::Args),
    Test(test::Args),
    Ci(ci::Args),
    Tidy(tidy::Args),
    CheckDeps(check_deps::Args),
    Bench(bench::Args),
    Hil(hil::Args),
    Soak(soak::Args),
    Commissioning(commissioning::Args),
    #[command(visible_alias = "vm-test")]
    Vm(vm::Args),
    FuzzBuild(fuzz_build::Args),
    Miri(miri::Args),
    Panel(panel::Args),
    Recordings(recordings::Args),
    Python(python_package::Args),
    SeededBugs(seeded_bugs::Args),
    SameAnswers(same_answers::Args),
    Package(package::Args),
    Reference(reference::Args),
}

fn run(cli: &Cli) -> anyhow::Result<()> {
    let workspace = Workspace::find()?;
    match &cli.command {
        Command::Demo(args) => demo::run(&workspace, args),
        Command::Test(args) => test::run(&workspace, args),
        Command::Ci(args) => ci::run(&workspace, args),
        Command::Tidy(args) => tidy::run(&workspace, args),
        Command::CheckDeps(args) => check_deps::run(&workspace, args),
        Command::Bench(args) => bench::run(&workspace, args),
        Command::Hil(args) => hil::run(&workspace, args),
        Command::Soak(args) => soak::run(&workspace, args),
        Command::Commissioning(args) => commissioning::run(&workspace, args, None),
        Command::Vm(args) => vm::run(&workspace, args),
        Command::FuzzBuild(_) => fuzz_build::run(&workspace),
        Command::Miri(_) => miri::run(&workspace),
        Command::Panel(args) => panel::run(&workspace, args),
        Command::Recordings(args) => recordings::run(&workspace, args),
        Command::Python(args) => python_package::run(&workspace, args, None),
        Command::SeededBugs(args) => seeded_bugs::run(&workspace, args),
        Command::SameAnswers(args) => same_answers::run(&workspace, args),
        Command::Package(args) => package::run(&workspace, args),
        Command::Reference(args) => reference::run(&workspace, args),
    }
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn every_command_explains_itself() {
        Cli::command().debug_assert();
        for command in Cli::command().get_subcommands() {
            let long = command.get_long_about().map(ToString::to_string).unwrap_or_default();
            assert!(long.len() > 120, "`cargo xtask {} --help` is too short: {long:?}", command.get_name());
        }
    }
}
