//! The page docs/benchmarks/safety.md.

use std::fmt::Write as _;

use crate::figures::Figures;
use crate::replay;

/// The whole page.
pub fn text(figures: &Figures, seed: u64, origin: &str) -> String {
    let mut page = String::new();
    // Nothing is written to that could fail.
    write(&mut page, figures, (seed, origin)).ok();
    page
}

fn write(page: &mut String, figures: &Figures, (seed, origin): (u64, &str)) -> std::fmt::Result {
    let Figures { runs, virtual_s, .. } = figures;
    writeln!(page, "# Safety\n")?;
    writeln!(page, "`cargo xtask bench safety --seed {seed} --runs {runs}`; {origin}\n")?;
    writeln!(
        page,
        "{runs} runs of up to 20 virtual seconds ({virtual_s:.0} s in all) with 1 to 5 faults each, at {:.0} times real time per core.",
        figures.times_real_time()
    )?;
    writeln!(
        page,
        "The whole loop of `pb3dp run` without pictures, both arms emulated byte by byte behind gateways ([hil.md](../hil.md))."
    )?;
    writeln!(
        page,
        "A run ends early where the supervisor or an arm stops it; both arms are looked at for 1.5 s more."
    )?;
    writeln!(
        page,
        "What must hold is checked on the simulator's joints by `tests/src/safety`, which shares no code with what it checks.\n"
    )?;
    writeln!(page, "## Violations\n")?;
    if figures.violations.is_empty() {
        writeln!(page, "None.\n")?;
    } else {
        writeln!(page, "| invariant | runs | the first one again |\n|---|---|---|")?;
        for (invariant, seeds) in &figures.violations {
            let first = seeds.first().map_or_else(String::new, |seed| replay(*seed));
            writeln!(page, "| {invariant} | {} | `{first}` |", seeds.len())?;
        }
        writeln!(page)?;
    }
    writeln!(page, "## Faults\n")?;
    writeln!(
        page,
        "Noticed: a line in the log, or a counter of a link or gateway, while it lasted or within 0.5 s.\nA fault that is borne leaves no trace, such as one late reply.\n"
    )?;
    writeln!(page, "| fault | drawn | while the loop ran | noticed |\n|---|---|---|---|")?;
    for (name, count) in &figures.faults {
        let share = 100.0 * count.noticed as f64 / count.begun.max(1) as f64;
        writeln!(page, "| {name} | {} | {} | {share:.0} % |", count.drawn, count.begun)?;
    }
    writeln!(page, "\n## Targets\n\n| motion | runs |\n|---|---|")?;
    for (name, count) in &figures.motions {
        writeln!(page, "| {name} | {count} |")?;
    }
    writeln!(page, "\n## How runs ended\n\n| why, numbers left out | runs |\n|---|---|")?;
    let mut ends: Vec<_> = figures.ends.iter().collect();
    ends.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
    for (why, count) in ends {
        writeln!(page, "| {} | {count} |", why.replace('|', "/"))?;
    }
    writeln!(page, "\n## Margins\n")?;
    writeln!(
        page,
        "The largest share of a limit that a joint used that obeyed; accelerations without what a stop of the arm itself does.\n"
    )?;
    writeln!(page, "| limit | share | seed |\n|---|---|---|")?;
    for (name, margin) in &figures.margins {
        writeln!(page, "| {name} | {:.3} | {} |", margin.share, margin.seed)?;
    }
    Ok(())
}
