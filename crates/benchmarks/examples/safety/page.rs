//! The page docs/benchmarks/safety.md.

use std::fmt::Write as _;
use std::iter;
use std::path::Path;

use anyhow::Context;
use pb3dp_servo::supervisor::State;

use system_tests::safety::invariants::Violation;

use crate::effects::ENABLING;
use crate::figures::{Count, Figures};
use crate::proofs::Shown;
use crate::proofs::safeguards::Safeguard;
use crate::replay;

/// The whole page.
pub fn text(figures: &Figures, rendered: &Figures, seed: u64, origin: &str) -> String {
    let mut page = String::new();
    // Writing to a string cannot fail.
    write(&mut page, figures, rendered, (seed, origin)).ok();
    page
}

/// A part of the page.
const HEADING: &str = "# Safety";
/// The page lists this many reasons for which runs ended.
const ENDS_MAX: usize = 40;
/// Heading at which the part about safeguards begins; a separate build writes that part.
const SAFEGUARDS: &str = "## Safeguards, each disabled";

/// Writes one part of the page, or both; the other part stays as it is.
///
/// # Errors
/// If the page cannot be written.
pub fn write_part(folder: &Path, runs: Option<&str>, safeguards: Option<&str>) -> anyhow::Result<()> {
    let path = folder.join("safety.md");
    let before = std::fs::read_to_string(&path).unwrap_or_default();
    let (runs_before, safeguards_before) = before.split_at(before.find(SAFEGUARDS).unwrap_or(before.len()));
    let runs = Some(runs.unwrap_or(runs_before).trim_end()).filter(|runs| !runs.is_empty()).unwrap_or(HEADING);
    let text = format!("{runs}\n\n{}", safeguards.unwrap_or(safeguards_before).trim_end());
    std::fs::write(&path, format!("{}\n", text.trim())).with_context(|| format!("cannot write {}", path.display()))
}

/// The table of safeguards that were disabled one by one, and the limits of these runs.
pub fn safeguards(shown: &[Shown], elsewhere: &[(Safeguard, &str)], origin: &str) -> String {
    let mut page = String::new();
    // Writing to a string cannot fail.
    write_safeguards(&mut page, shown, elsewhere, origin).ok();
    page
}

fn write_safeguards(
    page: &mut String,
    shown: &[Shown],
    elsewhere: &[(Safeguard, &str)],
    origin: &str,
) -> std::fmt::Result {
    let runs: u64 = shown.iter().map(|shown| shown.runs).sum();
    writeln!(page, "{SAFEGUARDS}\n\n`cargo xtask bench safety --disabled`; {origin}\n")?;
    writeln!(
        page,
        "{runs} runs of 7 virtual seconds in a build with the switches of `tests/safeguards.toml`, which `pb3dp` does not have.\n\
         Each row compares pairs of runs of the same seed that differ in one safeguard: with it all invariants hold, without it at least one is violated, in two seeds.\n\
         Other safeguards against the same hazard are disabled in both runs: each safeguard is sufficient alone.\n"
    )?;
    writeln!(
        page,
        "| safeguard | function | disabled in both runs | violated without it | seeds | with it |\n|---|---|---|---|---|---|"
    )?;
    for shown in shown {
        let Shown { guard, others, without, with, digests, .. } = shown;
        let names: Vec<_> = others.iter().map(|other| other.name()).collect();
        let seeds: Vec<_> = without.iter().map(|(seed, _)| seed.to_string()).collect();
        let broken = match without.first() {
            Some((_, violations)) if shown.is_proof() => broken(violations),
            _ => format!("TOO LITTLE (digests {digests:x?})"),
        };
        let with = match with {
            Some((seed, violations)) => format!("VIOLATED: {} (seed {seed})", self::broken(violations)),
            None => "all hold".to_owned(),
        };
        let (names, seeds) = (names.join(", "), seeds.join(", "));
        writeln!(page, "| {} | {} | {names} | {broken} | {seeds} | {with} |", guard.name(), guard.what())?;
    }
    writeln!(
        page,
        "\nNot shown by these runs:\n\n| safeguard | function | reason, and the test that shows it |\n|---|---|---|"
    )?;
    for (guard, by) in elsewhere {
        writeln!(page, "| {} | {} | {by} |", guard.name(), guard.what())?;
    }
    Ok(())
}

/// The invariants that are violated.
fn broken(violations: &[Violation]) -> String {
    let mut names: Vec<_> = violations.iter().map(|violation| violation.invariant.name()).collect();
    names.dedup();
    names.join(", ")
}

/// The violations, with the command that repeats the first run.
fn write_violations(page: &mut String, figures: &Figures, rendered: bool) -> std::fmt::Result {
    if figures.violations.is_empty() {
        return writeln!(page, "None.\n");
    }
    writeln!(page, "| invariant | runs | command for the first run |\n|---|---|---|")?;
    for (invariant, seeds) in &figures.violations {
        let first = seeds.first().map_or_else(String::new, |(seed, draw)| replay((*seed, *draw), rendered));
        writeln!(page, "| {invariant} | {} | `{first}` |", seeds.len())?;
    }
    writeln!(page)
}

/// Runs in which images were rendered and processed.
fn write_rendered(page: &mut String, figures: &Figures) -> std::fmt::Result {
    let Figures { runs, virtual_s, .. } = figures;
    if *runs == 0 {
        return Ok(());
    }
    writeln!(page, "## With images\n")?;
    writeln!(
        page,
        "The first {runs} of these runs again, with rendered images and the estimation method ({virtual_s:.0} s in all), at {:.1} times real time per core; violations:\n",
        figures.times_real_time()
    )?;
    write_violations(page, figures, true)
}

/// Faults by the state in which they began, and what the runs have not covered.
fn write_states(page: &mut String, figures: &Figures) -> std::fmt::Result {
    let names: Vec<_> = iter::once(ENABLING).chain(State::ALL.map(State::name)).collect();
    writeln!(
        page,
        "\n## Faults by state\n\n\
         Number of faults with an effect by the state of the supervisor in which they began, and the share of these that was noticed.\n\
         \"{ENABLING}\" is the time before, in which both arms are being enabled; in a tenth of the runs a fault of an arm, a line or a gateway begins then; it counts as noticed if enabling is refused, or a counter rises.\n"
    )?;
    writeln!(page, "| fault | {} |\n|---|{}", names.join(" | "), "---|".repeat(names.len()))?;
    let mut missing = Vec::new();
    for name in figures.faults.keys() {
        let counts = names.iter().map(|state| figures.states.get(name).and_then(|states| states.get(state)).copied());
        let counts: Vec<_> = counts.collect();
        let cell = |count: &Option<[u64; 2]>| {
            count.map_or_else(String::new, |[seen, noticed]| {
                format!("{seen}, {:.0} %", 100.0 * noticed as f64 / seen as f64)
            })
        };
        writeln!(page, "| {name} | {} |", counts.iter().map(cell).collect::<Vec<_>>().join(" | "))?;
        let without = counts.iter().zip(&names).filter(|(count, _)| count.is_none()).map(|(_, state)| *state);
        let without: Vec<_> = without.collect();
        if !without.is_empty() {
            missing.push(format!("* {name}: {}", without.join(", ")));
        }
    }
    if !missing.is_empty() {
        writeln!(page, "\nNot covered: no run has a fault with an effect in these states.\n\n{}", missing.join("\n"))?;
    }
    Ok(())
}

fn write(page: &mut String, figures: &Figures, rendered: &Figures, (seed, origin): (u64, &str)) -> std::fmt::Result {
    let Figures { runs, virtual_s, searches: (searches, searched_s), .. } = figures;
    writeln!(page, "{HEADING}\n")?;
    writeln!(page, "`cargo xtask bench safety --seed {seed} --runs {runs} --rendered {}`; {origin}\n", rendered.runs)?;
    writeln!(
        page,
        "{runs} runs of up to 20 virtual seconds ({virtual_s:.0} s in all) with 1 to 6 faults each and up to 3 stalls in half of them, at {:.0} times real time per core.",
        figures.times_real_time()
    )?;
    writeln!(
        page,
        "The runs use the whole loop of `pb3dp run` without images; both arms are emulated byte by byte behind gateways ([hil.md](../hil.md))."
    )?;
    writeln!(page, "A run ends early if the supervisor or an arm stops it; both arms are observed for 1.5 s more.")?;
    writeln!(
        page,
        "`tests/src/safety` checks the invariants on the simulator's joints and shares no code with the checked system."
    )?;
    writeln!(page, "In {searches} runs the hand may search for a lost target; it did so for {searched_s:.0} s.\n")?;
    writeln!(page, "## Violations\n")?;
    write_violations(page, figures, false)?;
    write_rendered(page, rendered)?;
    writeln!(page, "## Faults\n")?;
    writeln!(
        page,
        "Without effect: no frame pair arrived during the fault, the drives were disabled, or no operator was present.\n\
         Noticed, as a share of the others: a log line or a counter of a link or gateway, during the fault or within 0.5 s after it.\n\
         A tolerated fault, such as one late reply, leaves no trace.\n"
    )?;
    writeln!(page, "| fault | drawn | during the control loop | without effect | noticed |\n|---|---|---|---|---|")?;
    for (name, count) in &figures.faults {
        let Count { drawn, begun, without_effect, noticed } = *count;
        let share = 100.0 * noticed as f64 / (begun - without_effect).max(1) as f64;
        writeln!(page, "| {name} | {drawn} | {begun} | {without_effect} | {share:.0} % |")?;
    }
    write_states(page, figures)?;
    writeln!(page, "\n## Workcells\n\n| property | runs |\n|---|---|")?;
    for (property, count) in &figures.cells {
        writeln!(page, "| {property} | {count} |")?;
    }
    writeln!(page, "\n## Targets\n\n| motion | runs |\n|---|---|")?;
    for (name, count) in &figures.motions {
        writeln!(page, "| {name} | {count} |")?;
    }
    writeln!(page, "\n## How runs ended\n\n| reason, without its numbers | runs |\n|---|---|")?;
    let mut ends: Vec<_> = figures.ends.iter().collect();
    ends.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
    let rest = ends.split_off(ends.len().min(ENDS_MAX));
    for (why, count) in ends {
        writeln!(page, "| {} | {count} |", why.replace('|', "/"))?;
    }
    if !rest.is_empty() {
        let runs: u64 = rest.iter().map(|(_, count)| *count).sum();
        writeln!(page, "| {} others | {runs} |", rest.len())?;
    }
    writeln!(page, "\n## Margins\n")?;
    writeln!(
        page,
        "The largest share of a limit that an obeying joint used; accelerations of stops by the arm itself and behind late commands are excluded.\n\
         An acceleration is the change of speed within 20 ms; 1.3 times the limit is allowed, more while commands are lost or late ([safety.md](../safety.md)).\n"
    )?;
    writeln!(page, "| limit | share | seed |\n|---|---|---|")?;
    for (name, margin) in &figures.margins {
        writeln!(page, "| {name} | {:.3} | {} |", margin.share, margin.seed)?;
    }
    Ok(())
}
