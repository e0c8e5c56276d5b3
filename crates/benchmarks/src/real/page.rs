//! Tables and figure of the page.

use pb3dp_benchmarks::figure::{Bar, BarGroup, bars};
use pb3dp_benchmarks::page::Part;
use pb3dp_benchmarks::table::{Column, cell, markdown, number};
use serde_json::Value;

use super::score::Entry;
use super::table::{COLUMNS, best_peer, groups, rows_notes, times_by_size};

const COMPARED: [Column<'_>; 7] = [
    ("group", "{group}"),
    ("method", "{method}{rank}"),
    ("pass %", "{pass_percent:1}"),
    ("gross", "{gross}"),
    ("ms med / p90", "{ms_median_p90.0:2} / {ms_median_p90.1:2}"),
    ("within 1 px %", "{within_1px_percent:1}"),
    ("surface within 1 px %", "{surface_percent_within_1px_in_2_sigmas.0:1}"),
];

const SIZES: [Column<'_>; 4] = [
    ("method", "{method}"),
    ("region, px", "{region_px}"),
    ("n", "{cases}"),
    ("ms med / p90", "{ms_median_p90.0:2} / {ms_median_p90.1:2}"),
];

/// The parts of the page; without other tools their comparison stays as it is.
pub fn parts(entries: &[Entry], command: &str, origin: &str) -> Vec<Part<'static>> {
    let found = groups(entries);
    let tables = found.iter().map(|(name, rows)| format!("### {}\n\n{}", capitalised(name), markdown(&COLUMNS, rows)));
    let sizes = markdown(&SIZES, &times_by_size(entries));
    let mut parts = vec![
        ("run", format!("```text\n{command}\n```\n\n{origin}")),
        ("groups", tables.collect::<Vec<_>>().join("\n")),
        ("sizes", format!("{sizes}\nApart from these times, over all cases:\n\n{}", rows_notes(entries).join("\n"))),
    ];
    // Our methods, and the best of the other tools.
    let compared =
        found.iter().flat_map(|(_, rows)| rows.iter().filter(|row| row["ours"] == true).chain(best_peer(rows)));
    let compared: Vec<Value> = compared
        .map(|row| {
            let mut row = row.clone();
            row["rank"] = if row["ours"] == true { "" } else { " (best other)" }.into();
            row
        })
        .collect();
    if compared.iter().any(|row| row["ours"] == false) {
        parts.push(("comparison", markdown(&COMPARED, &compared)));
    }
    parts
}

/// Number of other tools in the figure: the best over all planar cases.
const PEERS_DRAWN: usize = 4;
/// Numbers of the colours.
const OURS: usize = 1;
const PEER: usize = 4;

/// Bars of the share of passed cases, ours above the best of the other tools, for each group of planar cases.
pub fn figure(entries: &[Entry]) -> String {
    let groups: Vec<_> = groups(entries).into_iter().filter(|(name, _)| *name != "non-planar").collect();
    let percent = |row: &Value| number(row, "pass_percent").unwrap_or(0.0);
    let mut peers: Vec<&Value> =
        groups.last().map_or(&[][..], |(_, rows)| rows).iter().filter(|row| row["ours"] == false).collect();
    peers.sort_by(|a, b| percent(b).total_cmp(&percent(a)));
    peers.truncate(PEERS_DRAWN);
    let is_drawn = |row: &&Value| row["ours"] == true || peers.iter().any(|peer| peer["method"] == row["method"]);
    let bar = |row: &Value| Bar {
        name: cell("{method}", row),
        parts: vec![(if row["ours"] == true { OURS } else { PEER }, percent(row))],
        text: cell("{pass_percent:0} %", row),
    };
    let group = |(name, rows): &(&str, Vec<Value>)| {
        let cases = rows.iter().filter_map(|row| row["cases"].as_u64()).max().unwrap_or(0);
        BarGroup { heading: format!("{name}, {cases}"), bars: rows.iter().filter(is_drawn).map(bar).collect() }
    };
    bars(&[], &groups.iter().map(group).collect::<Vec<_>>(), Some(100.0))
}

fn capitalised(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::score::Maker;
    use crate::real::score::tests::{answer, case, entry};
    use pb3dp_record::metrics::Group;

    /// The best tools are drawn and compared; every column has a figure of its row.
    #[test]
    fn weak_tools_are_not_drawn_and_the_best_is_compared() {
        let cases = ["a", "b"].map(|name| case(name, Group::Small, (1.0, 0.1)));
        let mut entries = vec![entry(&cases[0], "direct", Some(answer(0.0, 0.0))), entry(&cases[1], "direct", None)];
        let alone = parts(&entries, "command", "origin");
        assert!(alone.iter().all(|(name, text)| *name != "comparison" && !text.contains('?')), "{alone:?}");
        for (index, tool) in ["t0", "t1", "t2", "t3", "weak"].iter().enumerate() {
            let good = (index < 4).then(|| answer(0.0, 0.0));
            entries.push(Entry { maker: Maker::Peer, status: None, ..entry(&cases[0], tool, good) });
        }
        let svg = figure(&entries);
        assert!(svg.contains(">t3<") && !svg.contains("weak") && svg.contains(">50 %<"), "{svg}");
        let parts = parts(&entries, "command", "origin");
        let compared = &parts.iter().find(|(name, _)| *name == "comparison").expect("compared").1;
        assert!(compared.contains("| small | t3 (best other) | 100.0 | 0 | 2.00 / 2.00 |"), "{compared}");
        assert!(parts.iter().all(|(_, text)| !text.contains('?')), "{parts:?}");
        let folder = tempfile::tempdir().expect("a folder");
        pb3dp_benchmarks::page::update(&folder.path().join("real.md"), &parts).expect("the page has all marks");
    }
}
