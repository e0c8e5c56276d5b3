//! `pb3dp generate` (hidden): reference pages, manual pages and completion scripts, made from the source.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Args, Command, ValueEnum};
use clap_complete::Shell;
use pb3dp_setup::explain::{Explanation, explain_all};
use pb3dp_setup::layers::built_in;
use pb3dp_wiring::message_codes::tables;

/// Columns of help texts on a page.
const COLUMNS: usize = 100;

/// First paragraph of every page.
const MADE_BY: &str = "This page is made from the source by `cargo xtask reference`; change the source, not the page.";

/// Arguments of `pb3dp generate`.
#[derive(Debug, Args)]
pub struct GenerateArgs {
    /// Folder that gets `reference`, `man` and `completions`.
    #[arg(value_name = "DIR")]
    out: PathBuf,
}

/// Writes all files for `program`.
///
/// # Errors
/// If a file cannot be written.
pub fn run(args: &GenerateArgs, program: &Command) -> Result<ExitCode> {
    let folder = |name: &str| {
        let folder = args.out.join(name);
        fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be created", folder.display()))?;
        anyhow::Ok(folder)
    };
    let reference = folder("reference")?;
    for (name, text) in [("commands.md", commands(program)), ("keys.md", keys()), ("messages.md", messages())] {
        write(&reference.join(name), &text)?;
    }
    // The pages of `help` would repeat those of the commands.
    clap_mangen::generate_to(program.clone().disable_help_subcommand(true), folder("man")?)
        .context("the manual pages cannot be written")?;
    let completions = folder("completions")?;
    for shell in Shell::value_variants() {
        clap_complete::generate_to(*shell, &mut program.clone(), "pb3dp", &completions)
            .with_context(|| format!("the completion for {shell} cannot be written"))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn write(file: &Path, text: &str) -> Result<()> {
    fs::write(file, text).with_context(|| format!("{}: cannot be written", file.display()))
}

/// The help of every command.
fn commands(program: &Command) -> String {
    let mut page = format!("# Commands\n\n{MADE_BY}\n");
    let mut program = program.clone().disable_help_subcommand(true).term_width(COLUMNS);
    program.build();
    add_command(&mut page, &mut program, "pb3dp");
    page
}

fn add_command(page: &mut String, command: &mut Command, path: &str) {
    let help = command.render_long_help().to_string();
    let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
    let _ = write!(page, "\n## {path}\n\n```text\n{}\n```\n", lines.join("\n").trim_end());
    for inner in command.get_subcommands_mut().filter(|inner| !inner.is_hide_set()) {
        let path = format!("{path} {}", inner.get_name());
        add_command(page, inner, &path);
    }
}

/// Every key of the built-in setups.
fn keys() -> String {
    let mut page = format!(
        "# Keys of a setup\n\n{MADE_BY}\n`pb3dp config explain KEY` prints the same with the value of each built-in setup.\nThe keys of an arm are those of `arms.vs`, whatever the table of the arm is called.\n"
    );
    page.push_str("\n## Built-in setups\n\n| name | what it is |\n| --- | --- |\n");
    for setup in built_in::SETUPS {
        let _ = writeln!(page, "| `{}` | {} |", setup.name, cell(setup.about));
    }
    let mut tables: BTreeMap<String, Vec<Explanation>> = BTreeMap::new();
    for explanation in explain_all() {
        let table = explanation.key.rsplit_once('.').map_or("", |(table, _)| table).to_owned();
        tables.entry(table).or_default().push(explanation);
    }
    for (table, keys) in tables {
        let title = if table.is_empty() { "Outside of tables" } else { &table };
        let _ = write!(page, "\n## {title}\n\n| key | unit | allowed | meaning |\n| --- | --- | --- | --- |\n");
        for Explanation { key, about, unit, allowed, .. } in keys {
            let name = key.rsplit('.').next().unwrap_or(&key);
            let (unit, allowed) = (unit.unwrap_or_default(), allowed.unwrap_or_default());
            let _ = writeln!(page, "| `{name}` | {unit} | {} | {} |", cell(&allowed), cell(&about));
        }
    }
    page
}

/// Escapes text for a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

/// Every code with cause and remedy.
fn messages() -> String {
    let mut page = format!(
        "# Messages\n\n{MADE_BY}\n`pb3dp explain CODE` prints the same.\nA code stays the same in every release, and no other message ever gets it.\n"
    );
    for (title, codes) in tables() {
        let _ = write!(page, "\n## {title}\n\n| code | cause | remedy |\n| --- | --- | --- |\n");
        for code in codes {
            let _ = writeln!(page, "| `{}` | {} | {} |", code.code, cell(code.cause), cell(code.remedy));
        }
    }
    page
}
