//! The figures of the page docs/benchmarks/safety.md.

use std::iter;

use pb3dp_benchmarks::page::Part;
use pb3dp_benchmarks::table::{Column, markdown};
use pb3dp_servo::supervisor::State;
use serde_json::{Value, json};

use system_tests::safety::invariants::Violation;

use crate::effects::ENABLING;
use crate::figures::{Count, Figures};
use crate::proofs::Shown;
use crate::proofs::safeguards::Safeguard;
use crate::replay;

/// The page lists this many reasons for which runs ended.
const ENDS_MAX: usize = 40;

/// The parts of the page; without runs with images theirs stays as it is.
pub fn parts(figures: &Figures, rendered: &Figures, seed: u64, origin: &str) -> Vec<Part<'static>> {
    let Figures { runs, virtual_s, searches: (searches, searched_s), .. } = figures;
    let run = format!(
        "`cargo xtask bench safety --seed {seed} --runs {runs} --rendered {}`; {origin}\n\n\
         {runs} runs ({virtual_s:.0} virtual seconds in all), at {:.0} times real time per core.\n\
         In {searches} runs the hand may search for a lost target; it did so for {searched_s:.0} s.",
        rendered.runs,
        figures.times_real_time()
    );
    let mut parts = vec![
        ("run", run),
        ("violations", violations(figures, false)),
        ("faults", faults(figures)),
        ("states", states(figures)),
        ("workcells", counts("property", figures.cells.iter().map(|(name, count)| (*name, *count)))),
        ("targets", counts("motion", figures.motions.iter().map(|(name, count)| (*name, *count)))),
        ("ends", ends(figures)),
        ("margins", margins(figures)),
    ];
    if rendered.runs > 0 {
        let Figures { runs, virtual_s, .. } = rendered;
        let run = format!(
            "The first {runs} of these runs again, with rendered images and the estimation method ({virtual_s:.0} s in all), \
             at {:.1} times real time per core; violations:",
            rendered.times_real_time()
        );
        parts.insert(2, ("with images", format!("{run}\n\n{}", violations(rendered, true))));
    }
    parts
}

/// The violations, with the command that repeats the first run.
fn violations(figures: &Figures, rendered: bool) -> String {
    const COLUMNS: [Column<'_>; 3] =
        [("invariant", "{invariant}"), ("runs", "{runs}"), ("command for the first run", "`{command}`")];
    let row = |(invariant, seeds): (&String, &Vec<_>)| {
        let command = seeds.first().map(|first| replay(*first, rendered));
        json!({"invariant": invariant, "runs": seeds.len(), "command": command})
    };
    let rows: Vec<Value> = figures.violations.iter().map(row).collect();
    if rows.is_empty() { "None.".to_owned() } else { markdown(&COLUMNS, &rows) }
}

fn faults(figures: &Figures) -> String {
    const COLUMNS: [Column<'_>; 5] = [
        ("fault", "{fault}"),
        ("drawn", "{drawn}"),
        ("during the control loop", "{begun}"),
        ("without effect", "{without_effect}"),
        ("noticed", "{noticed_percent:0} %"),
    ];
    let row = |(fault, count): (&&str, &Count)| {
        let Count { drawn, begun, without_effect, noticed } = *count;
        let percent = 100.0 * noticed as f64 / (begun - without_effect).max(1) as f64;
        json!({"fault": fault, "drawn": drawn, "begun": begun, "without_effect": without_effect, "noticed_percent": percent})
    };
    markdown(&COLUMNS, &figures.faults.iter().map(row).collect::<Vec<_>>())
}

/// Faults by the state in which they began, and what the runs have not covered.
fn states(figures: &Figures) -> String {
    let names: Vec<&str> = iter::once(ENABLING).chain(State::ALL.map(State::name)).collect();
    let (mut rows, mut missing) = (Vec::new(), Vec::new());
    for fault in figures.faults.keys() {
        let count = |state: &str| figures.states.get(fault).and_then(|states| states.get(state));
        let mut row = json!({"fault": fault});
        for state in &names {
            row[state] = count(state)
                .map_or_else(String::new, |[entered, noticed]| {
                    format!("{entered}, {:.0} %", 100.0 * *noticed as f64 / *entered as f64)
                })
                .into();
        }
        rows.push(row);
        let without: Vec<&str> = names.iter().copied().filter(|state| count(state).is_none()).collect();
        if !without.is_empty() {
            missing.push(format!("* {fault}: {}", without.join(", ")));
        }
    }
    let places: Vec<String> = names.iter().map(|state| format!("{{{state}}}")).collect();
    let columns = iter::once(("fault", "{fault}")).chain(names.iter().copied().zip(places.iter().map(String::as_str)));
    let table = markdown(&columns.collect::<Vec<_>>(), &rows);
    if missing.is_empty() {
        return table;
    }
    format!("{table}\nNot covered: no run has a fault with an effect in these states.\n\n{}", missing.join("\n"))
}

fn counts<'a>(heading: &str, rows: impl Iterator<Item = (&'a str, u64)>) -> String {
    let rows: Vec<Value> = rows.map(|(name, count)| json!({"name": name, "runs": count})).collect();
    markdown(&[(heading, "{name}"), ("runs", "{runs}")], &rows)
}

fn ends(figures: &Figures) -> String {
    let mut ends: Vec<(&str, u64)> = figures.ends.iter().map(|(why, count)| (why.as_str(), *count)).collect();
    ends.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let rest = ends.split_off(ends.len().min(ENDS_MAX));
    let others = format!("{} others", rest.len());
    ends.extend((!rest.is_empty()).then(|| (others.as_str(), rest.iter().map(|(_, count)| count).sum())));
    counts("reason, without its numbers", ends.into_iter())
}

fn margins(figures: &Figures) -> String {
    let rows =
        figures.margins.iter().map(|(name, margin)| json!({"limit": name, "share": margin.share, "seed": margin.seed}));
    markdown(&[("limit", "{limit}"), ("share", "{share:3}"), ("seed", "{seed}")], &rows.collect::<Vec<_>>())
}

/// The part about safeguards that were disabled one by one.
pub fn safeguards(shown: &[Shown], elsewhere: &[(Safeguard, &str)], origin: &str) -> [Part<'static>; 3] {
    const COLUMNS: [Column<'_>; 6] = [
        ("safeguard", "{name}"),
        ("function", "{what}"),
        ("disabled in both runs", "{others}"),
        ("violated without it", "{without}"),
        ("seeds", "{seeds}"),
        ("with it", "{with}"),
    ];
    let row = |shown: &Shown| {
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
        json!({
            "name": guard.name(), "what": guard.what(), "others": names.join(", "), "without": broken,
            "seeds": seeds.join(", "), "with": with,
        })
    };
    let other = |(guard, by): &(Safeguard, &str)| json!({"name": guard.name(), "what": guard.what(), "by": by});
    let by = [COLUMNS[0], COLUMNS[1], ("reason, and the test that shows it", "{by}")];
    let runs: u64 = shown.iter().map(|shown| shown.runs).sum();
    [
        ("safeguards run", format!("`cargo xtask bench safety --disabled`; {origin}\n\n{runs} runs.")),
        ("safeguards", markdown(&COLUMNS, &shown.iter().map(row).collect::<Vec<_>>())),
        ("shown elsewhere", markdown(&by, &elsewhere.iter().map(other).collect::<Vec<_>>())),
    ]
}

/// The invariants that are violated.
fn broken(violations: &[Violation]) -> String {
    let mut names: Vec<_> = violations.iter().map(|violation| violation.invariant.name()).collect();
    names.dedup();
    names.join(", ")
}
