//! The document with the results.

use std::fmt::Write as _;

use super::score::{Entry, Maker};
use super::table::{HEADINGS, Row, best_peer, groups, rows_notes, times_by_size};
use crate::common::circumstances::Circumstances;

/// Text before the figures.
const HEAD: &str = "\
# Real stereo cases

This page is written by the command below; change the program, not the page.

Each case is a calibrated pair with a region whose plane is known from ground truth that no method sees.
Every method gets the same images, region, calibration and depth range, no initial value, and one thread.

* **pass**: depth within 1 % and normal within 5 degrees, or within twice the standard deviation of the truth if that is larger; for non-planar regions only the depth counts.
* **answered**: share of cases with a plane; **of answered**: share of the answers that passed.
* **gross**: answers with a depth error above 1.5 % or a normal error above 20 degrees; **gross, ok**: those with status `ok` from the method.
* **z %**, **normal deg**: median and 95th percentile of the errors of the answers.
* **ms**: CPU time of one thread from images in memory to the plane, median of the calls; median and 90th percentile over the cases.
* **chi2**: mean squared error over variance (the method's own plus the truth's) of answers that are not grossly wrong: 1 is consistent, more is overconfident.
* **within 1 px**: share of the true disparities inside the region that lie within 1 px of the plane, mean over all cases; a case without a plane counts as 0.
* **surface within 1 px / 2 sigmas**: the same for the visible surface, pixel by pixel (`pb3dp estimate --surface`), and the share of its points that are off by at most two of their standard deviations.
* The scenes of `crates/benchmarks/held_back.txt` take no part.
* The constants of the method `direct` were set on cases like these; what to expect of other scenes is on the page of the [scenes left out](left_out.md).
";

/// The whole page.
pub fn markdown(entries: &[Entry], circumstances: &Circumstances, command: &str) -> String {
    let mut page = HEAD.to_owned();
    let changed = if circumstances.changed { ", with uncommitted changes" } else { "" };
    let Circumstances { commit, processor, compiler, .. } = circumstances;
    // Writing to a String does not fail.
    let _ = write!(page, "\n```text\n{command}\n```\n\nCommit {commit}{changed}; {processor}; {compiler}.\n");
    let found = groups(entries);
    page.push_str("\n![Share of passed cases by group and method](real.svg)\n");
    overview(&mut page, &found);
    for (name, rows) in &found {
        let _ = write!(page, "\n## {}\n\n", capitalised(name));
        table(&mut page, rows);
    }
    sizes(&mut page, entries);
    let notes = rows_notes(entries, |_| true);
    if !notes.is_empty() {
        page.push_str("\nApart from these times, over all cases:\n\n");
        notes.iter().for_each(|note| page.push_str(&format!("* {note}\n")));
    }
    page
}

/// Compares our methods with the best of the other tools, group by group.
fn overview(page: &mut String, found: &[(&'static str, Vec<Row>)]) {
    if !found.iter().any(|(_, rows)| best_peer(rows).is_some()) {
        return;
    }
    page.push_str("\n## Comparison with the best of the other tools\n\n");
    page.push_str("The best tool of each group passes most cases; for non-planar regions it has the most disparities within 1 px.\n\n");
    line(
        page,
        &["group", "method", "pass %", "gross", "ms med / p90", "within 1 px %", "surface within 1 px %"]
            .map(str::to_owned),
    );
    rule(page, 7, 2);
    for (name, rows) in found {
        let ours = rows.iter().filter(|row| row.maker == Maker::Ours);
        for row in ours.chain(best_peer(rows)) {
            let cells = row.cells();
            let method =
                if row.maker == Maker::Peer { format!("{} (best other)", row.method) } else { cells[0].clone() };
            let surface = row.surface_percent.map_or("-".to_owned(), |[within, _]| format!("{within:.1}"));
            let picked = [3, 5, 9, 11].map(|column: usize| cells[column].clone());
            let first = [(*name).to_owned(), method];
            line(page, &[&first[..], &picked[..], &[surface]].concat());
        }
    }
}

/// All columns with a value.
fn table(page: &mut String, rows: &[Row]) {
    let cells: Vec<_> = rows.iter().map(Row::cells).collect();
    let used: Vec<_> = (0..HEADINGS.len()).filter(|c| cells.iter().any(|row| row[*c] != "-")).collect();
    let pick = |row: &[String]| used.iter().map(|c| row[*c].clone()).collect::<Vec<_>>();
    line(page, &pick(&HEADINGS.map(str::to_owned)));
    rule(page, used.len(), 1);
    cells.iter().for_each(|row| line(page, &pick(row)));
}

fn sizes(page: &mut String, entries: &[Entry]) {
    page.push_str("\n## Time by size of the region\n\n");
    line(page, &["method", "region, px", "n", "ms med / p90"].map(str::to_owned));
    rule(page, 4, 2);
    for (method, class, cases, [median, p90]) in times_by_size(entries) {
        line(page, &[method, class, cases.to_string(), format!("{median:.2} / {p90:.2}")]);
    }
}

fn line(page: &mut String, cells: &[String]) {
    let _ = writeln!(page, "| {} |", cells.join(" | "));
}

/// The line under the headings: the first `left` columns left-aligned, the others right-aligned.
fn rule(page: &mut String, columns: usize, left: usize) {
    let marks: Vec<_> = (0..columns).map(|c| if c < left { "---" } else { "---:" }).collect();
    let _ = writeln!(page, "|{}|", marks.join("|"));
}

fn capitalised(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::score::tests::{answer, case, entry};
    use pb3dp_record::metrics::Group;

    #[test]
    fn the_page_says_how_it_was_made_and_who_is_best() {
        let one = case("a", Group::LowTexture, (1.0, 0.1));
        let entries = [
            entry(&one, "direct", Some(answer(30.5, 1.0))),
            Entry { maker: Maker::Peer, status: None, ..entry(&one, "bm", Some(answer(0.0, 0.0))) },
        ];
        let circumstances = Circumstances {
            commit: "0123456789ab".into(),
            changed: true,
            processor: "Some CPU".into(),
            compiler: "rustc 1".into(),
        };
        let page = markdown(&entries, &circumstances, "cargo xtask bench real --cases DIR");
        let expect = |part: &str| assert!(page.contains(part), "{part:?} is missing in:\n{page}");
        expect("```text\ncargo xtask bench real --cases DIR\n```");
        expect("Commit 0123456789ab, with uncommitted changes; Some CPU; rustc 1.");
        expect("## Low texture\n\n| method | n | answered % |");
        expect("| low texture | bm (best other) | 100.0 | 0 |");
        expect("| direct | 1 | 100 | 0.0 | 0.0 | 1 | 1 | 1.52 / 1.52 | 1.00 / 1.00 | 2.00 / 2.00 |");
        expect("| direct | 0 to 1999 | 1 | 2.00 / 2.00 |");
        let widths: Vec<_> = page.lines().filter(|l| l.starts_with("| ")).map(|l| l.matches('|').count()).collect();
        assert!(!widths.is_empty() && !page.contains("chi2 z / normal"), "a column without figures is left out");
    }

    #[test]
    fn without_other_tools_there_is_no_comparison() {
        let one = case("a", Group::Boards, (1.0, 0.1));
        let entries = [entry(&one, "direct", None)];
        let page = markdown(&entries, &Circumstances::of(std::path::Path::new(".")), "x");
        assert!(!page.contains("best of the other") && page.contains("## Boards"));
    }
}
