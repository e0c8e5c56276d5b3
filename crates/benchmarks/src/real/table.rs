//! Rows of the tables: one per group and method.

use std::fmt::Write as _;

use pb3dp_record::metrics::{Group, median, percentile};
use serde_json::{Value, json};

use super::score::{Entry, Grade, Maker, SurfaceScore};

/// Groups in the order of the report, with their names in it.
pub const GROUPS: [(Group, &str); 6] = [
    (Group::Textured, "textured"),
    (Group::Boards, "boards"),
    (Group::Small, "small"),
    (Group::Occluded, "straddling a depth edge"),
    (Group::LowTexture, "low texture"),
    (Group::NonPlanar, "non-planar"),
];

/// The row of one method for one group. Errors are over the answered cases, times over all.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The method.
    pub method: String,
    /// Origin of the method.
    pub maker: Maker,
    /// Number of cases.
    pub cases: usize,
    /// Number of cases with a plane.
    pub answered: usize,
    /// Number of cases that passed.
    pub passed: usize,
    /// Number of answers that are grossly wrong.
    pub gross: usize,
    /// Grossly wrong answers with status `ok`; `None` for a method without a status.
    pub gross_ok: Option<usize>,
    /// Median and 95th percentile of the absolute depth error, percent.
    pub z_percent: Option<[f64; 2]>,
    /// The same of the angle between the normals, degrees; `None` for non-planar regions.
    pub normal_deg: Option<[f64; 2]>,
    /// Median and 90th percentile of the CPU time, milliseconds.
    pub millis: Option<[f64; 2]>,
    /// Mean squared error over variance, of depth and of normal, of the answers that are not grossly wrong; 1 is consistent.
    pub squared_scores: Option<[f64; 2]>,
    /// Non-planar regions: share of the true disparities within 1 px of the plane, mean over all cases, percent.
    pub within_1px_percent: Option<f64>,
    /// Non-planar regions: share of the true disparities within 1 px of the visible surface, and share of its points within two of their
    /// standard deviations, means over all cases, percent.
    pub surface_percent: Option<[f64; 2]>,
}

impl Row {
    /// The row of a method's entries in one group.
    fn of(entries: &[&Entry]) -> Option<Self> {
        let first = entries.first()?;
        let planar = entries.iter().all(|entry| entry.case.is_planar());
        let answers: Vec<_> = entries.iter().filter_map(|e| Some((*e, e.answer?))).collect();
        let z: Vec<_> = answers.iter().map(|(e, a)| 100.0 * (a.z_m / e.case.z_m).abs()).collect();
        let normal: Vec<_> = answers.iter().filter(|_| planar).map(|(_, a)| a.normal_rad.to_degrees()).collect();
        let millis: Vec<_> = entries.iter().filter_map(|e| e.ms).collect();
        let is_gross = |entry: &&Entry| entry.grade() == Some(Grade::Gross);
        let gross: Vec<_> = entries.iter().copied().filter(is_gross).collect();
        let judged: Vec<_> = entries.iter().filter(|e| !is_gross(e)).filter_map(|e| e.squared_scores()).collect();
        let has_map = answers.iter().any(|(_, a)| a.map.is_some());
        let surfaces: Vec<_> = entries.iter().filter_map(|e| e.surface).collect();
        let of_surfaces = |value: fn(&SurfaceScore) -> f64| 100.0 * surfaces.iter().map(value).sum::<f64>();
        let per_case = |sum: f64| sum / entries.len() as f64;
        let within = answers.iter().filter_map(|(_, a)| a.map).map(|(_, share)| 100.0 * share).sum::<f64>();
        Some(Self {
            method: first.method.clone(),
            maker: first.maker,
            cases: entries.len(),
            answered: answers.len(),
            passed: entries.iter().filter(|e| e.grade() == Some(Grade::Pass)).count(),
            gross: gross.len(),
            gross_ok: first.status.map(|_| gross.iter().filter(|e| e.status == Some("ok")).count()),
            z_percent: pair(&z, 95.0),
            normal_deg: pair(&normal, 95.0),
            millis: pair(&millis, 90.0),
            squared_scores: mean_of_pairs(&judged),
            within_1px_percent: (!planar && has_map).then(|| per_case(within)),
            surface_percent: (!surfaces.is_empty())
                .then(|| [of_surfaces(|s| s.within_1px), of_surfaces(|s| s.in_2_sigmas)].map(per_case)),
        })
    }

    /// Share of all cases that passed, percent.
    pub fn pass_percent(&self) -> f64 {
        share(self.passed, self.cases)
    }

    /// The table cells of the row in the order of [`HEADINGS`].
    pub fn cells(&self) -> Vec<String> {
        let number = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |x| format!("{x:.decimals$}"));
        let two = |values: Option<[f64; 2]>, decimals: usize| {
            values.map_or("-".into(), |[a, b]| format!("{a:.decimals$} / {b:.decimals$}"))
        };
        let of_answered = (self.answered > 0).then(|| share(self.passed, self.answered));
        let gross_ok = self.gross_ok.map_or("-".into(), |count| count.to_string());
        vec![
            self.method.clone(),
            self.cases.to_string(),
            number(Some(share(self.answered, self.cases)), 0),
            number(Some(self.pass_percent()), 1),
            number(of_answered, 1),
            self.gross.to_string(),
            gross_ok,
            two(self.z_percent, 2),
            two(self.normal_deg, 2),
            two(self.millis, 2),
            two(self.squared_scores, 2),
            number(self.within_1px_percent, 1),
            two(self.surface_percent, 1),
        ]
    }

    fn to_json(&self, group: &str) -> Value {
        json!({
            "group": group, "method": self.method, "ours": self.maker == Maker::Ours, "cases": self.cases,
            "answered": self.answered, "passed": self.passed, "gross": self.gross, "gross_ok": self.gross_ok,
            "z_percent_median_p95": self.z_percent, "normal_deg_median_p95": self.normal_deg,
            "ms_median_p90": self.millis, "squared_scores_z_normal": self.squared_scores,
            "within_1px_percent": self.within_1px_percent,
            "surface_percent_within_1px_in_2_sigmas": self.surface_percent,
        })
    }
}

/// Headings of [`Row::cells`].
pub const HEADINGS: [&str; 13] = [
    "method",
    "n",
    "answered %",
    "pass %",
    "of answered %",
    "gross",
    "gross, ok",
    "z % med / p95",
    "normal deg med / p95",
    "ms med / p90",
    "chi2 z / normal",
    "within 1 px %",
    "surface within 1 px / 2 sigmas %",
];

fn share(part: usize, of: usize) -> f64 {
    100.0 * part as f64 / of.max(1) as f64
}

fn pair(samples: &[f64], percent: f64) -> Option<[f64; 2]> {
    Some([median(samples)?, percentile(samples, percent)?])
}

fn mean_of_pairs(pairs: &[(f64, f64)]) -> Option<[f64; 2]> {
    let count = pairs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / count;
    (!pairs.is_empty()).then(|| [mean(|p| p.0), mean(|p| p.1)])
}

/// The methods that occur, ours first, in the order of their first occurrence.
pub fn methods(entries: &[Entry]) -> Vec<&str> {
    let mut found: Vec<&str> = Vec::new();
    for maker in [Maker::Ours, Maker::Peer] {
        for entry in entries.iter().filter(|entry| entry.maker == maker) {
            if !found.contains(&entry.method.as_str()) {
                found.push(&entry.method);
            }
        }
    }
    found
}

/// One row per method for the entries that `belongs` accepts.
fn rows_where(entries: &[Entry], belongs: impl Fn(&Entry) -> bool) -> Vec<Row> {
    let of_method = |method: &str| {
        let chosen: Vec<_> = entries.iter().filter(|e| e.method == method && belongs(e)).collect();
        Row::of(&chosen)
    };
    methods(entries).into_iter().filter_map(of_method).collect()
}

/// Every group that has cases, with one row per method; last all planar cases together.
pub fn groups(entries: &[Entry]) -> Vec<(&'static str, Vec<Row>)> {
    let mut found: Vec<_> =
        GROUPS.iter().map(|(group, name)| (*name, rows_where(entries, |e| e.case.group == *group))).collect();
    found.push(("all planar", rows_where(entries, |e| e.case.is_planar())));
    found.retain(|(_, rows)| !rows.is_empty());
    found
}

/// The best of the other tools: most passed, then fewest grossly wrong, then the smallest depth error. For non-planar
/// regions: most disparities within 1 px.
pub fn best_peer(rows: &[Row]) -> Option<&Row> {
    let key = |row: &Row| {
        let z = row.z_percent.map_or(f64::INFINITY, |[median, _]| median);
        [row.within_1px_percent.unwrap_or(0.0), row.pass_percent(), -(row.gross as f64), -z]
    };
    let better = |a: &&Row, b: &&Row| {
        let (a, b) = (key(a), key(b));
        a.iter().zip(&b).map(|(x, y)| x.total_cmp(y)).find(|order| order.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
    };
    rows.iter().filter(|row| row.maker == Maker::Peer).max_by(better)
}

/// All rows for a terminal.
pub fn text(entries: &[Entry]) -> String {
    let mut text = String::new();
    for (name, rows) in groups(entries) {
        let _ = writeln!(text, "{name}");
        let mut lines = vec![HEADINGS.map(str::to_owned).to_vec()];
        lines.extend(rows.iter().map(Row::cells));
        text.push_str(&aligned(&lines));
        if let Some(best) = best_peer(&rows) {
            let _ = writeln!(text, "best of the others: {}", best.method);
        }
        for line in rows_notes(entries, |e| name == "all planar" && e.case.is_planar() || name == group_name(e)) {
            let _ = writeln!(text, "{line}");
        }
        text.push('\n');
    }
    text
}

/// Name of an entry's group.
fn group_name(entry: &Entry) -> &'static str {
    GROUPS.iter().find(|(group, _)| *group == entry.case.group).map_or("", |(_, name)| *name)
}

/// Times of methods that measure once per rig or scene, one line each; these times are in no other column.
pub fn rows_notes(entries: &[Entry], belongs: impl Fn(&Entry) -> bool) -> Vec<String> {
    let note = |method: &str| {
        let chosen = entries.iter().filter(|e| e.method == method && belongs(e));
        let times: Vec<f64> = chosen.filter_map(|e| e.rows_ms).collect();
        let [median, p90] = pair(&times, 90.0)?;
        Some(format!("{method}: rows_ms {median:.1} / {p90:.1} (vertical misalignment per rig or scene, median / p90)"))
    };
    methods(entries).into_iter().filter_map(note).collect()
}

/// Aligned columns of text; columns without any value are omitted.
fn aligned(lines: &[Vec<String>]) -> String {
    let columns = lines.first().map_or(0, Vec::len);
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    let used: Vec<_> = (0..columns)
        .filter(|c| *c == 0 || lines[1..].iter().any(|line| line[*c] != "-"))
        .map(|c| (c, width(c)))
        .collect();
    let mut text = String::new();
    for line in lines {
        let cell = |&(column, width): &(usize, usize)| match column {
            0 => format!("{:<width$}", line[column]),
            _ => format!("{:>width$}", line[column]),
        };
        text.push_str(used.iter().map(cell).collect::<Vec<_>>().join("  ").trim_end());
        text.push('\n');
    }
    text
}

/// Every case that one of our methods did not pass, with its errors.
pub fn failures(entries: &[Entry]) -> String {
    let mut text = String::new();
    for entry in entries.iter().filter(|e| e.maker == Maker::Ours && e.grade() != Some(Grade::Pass)) {
        let (name, method, status) = (&entry.case.name, &entry.method, entry.status.unwrap_or("-"));
        let errors = entry.answer.map_or("no answer".to_owned(), |a| {
            format!("z {:+.2} %, normal {:.1} deg", 100.0 * a.z_m / entry.case.z_m, a.normal_rad.to_degrees())
        });
        let gross = if entry.grade() == Some(Grade::Gross) { ", grossly wrong" } else { "" };
        let _ = writeln!(text, "{method:<16} {name:<24} {status:<15} {errors}{gross}");
    }
    text
}

/// All rows as JSON.
pub fn summary_json(entries: &[Entry]) -> Value {
    let of_group =
        |(name, rows): (&'static str, Vec<Row>)| rows.iter().map(|row| row.to_json(name)).collect::<Vec<_>>();
    groups(entries).into_iter().flat_map(of_group).collect()
}

/// Bounds of the size classes for times, pixels of the region.
const SIZE_LIMITS_PX: [usize; 4] = [2_000, 10_000, 60_000, usize::MAX];

/// Times of our methods by the size of the region: method, size class, number of cases, median and 90th percentile.
pub fn times_by_size(entries: &[Entry]) -> Vec<(String, String, usize, [f64; 2])> {
    let mut found = Vec::new();
    for method in methods(entries) {
        let mut from = 0;
        for to in SIZE_LIMITS_PX {
            let belongs =
                |e: &&Entry| e.method == method && e.maker == Maker::Ours && (from..to).contains(&e.case.region_px);
            let millis: Vec<_> = entries.iter().filter(belongs).filter_map(|e| e.ms).collect();
            let class = if to == usize::MAX { format!("from {from}") } else { format!("{from} to {}", to - 1) };
            found.extend(pair(&millis, 90.0).map(|times| (method.to_owned(), class, millis.len(), times)));
            from = to;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::score::Answer;
    use crate::real::score::tests::{answer, case, entry};

    fn peer(entry: Entry) -> Entry {
        Entry { maker: Maker::Peer, status: None, ..entry }
    }

    #[test]
    fn what_is_measured_once_is_told_below_the_table() {
        let known = [case("a", Group::Small, (0.0, 0.0)), case("b", Group::Textured, (0.0, 0.0))];
        let timed = |index: usize, ms: f64| Entry { rows_ms: Some(ms), ..entry(&known[index], "m", None) };
        let entries = [timed(0, 50.0), timed(1, 70.0), entry(&known[0], "n", None)];
        assert_eq!(rows_notes(&entries, |_| true).len(), 1);
        let text = text(&entries);
        for part in ["m: rows_ms 50.0 / 50.0", "m: rows_ms 70.0 / 70.0", "m: rows_ms 60.0 / 68.0"] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
    }

    #[test]
    fn a_row_counts_what_was_answered_passed_and_grossly_wrong() {
        let cases: Vec<_> = ["a", "b", "c", "d"].map(|name| case(name, Group::Small, (1.0, 0.1))).into();
        let honest = |a: Answer| Answer { z_sigma_m: Some(2e-3), normal_sigma_rad: Some(0.01), ..a };
        let entries = [
            entry(&cases[0], "m", Some(honest(answer(-2.0, 1.0)))),
            entry(&cases[1], "m", Some(honest(answer(24.0, 2.0)))),
            entry(&cases[2], "m", Some(honest(answer(100.0, 30.0)))),
            Entry { ms: Some(8.0), ..entry(&cases[3], "m", None) },
        ];
        let all = groups(&entries);
        assert_eq!(all.iter().map(|(name, _)| *name).collect::<Vec<_>>(), ["small", "all planar"]);
        let row = &all[0].1[0];
        assert_eq!((row.cases, row.answered, row.passed, row.gross, row.gross_ok), (4, 3, 1, 1, Some(1)));
        // numpy.percentile([0.1, 1.2, 5.0], [50, 95]) = [1.2, 4.62], ([1, 2, 30], 95) = 27.2, ([2, 2, 2, 8], 90) = 6.2
        let close = |found: Option<[f64; 2]>, expected: [f64; 2]| {
            let found = found.expect("there");
            assert!(found.iter().zip(&expected).all(|(f, e)| (f - e).abs() < 1e-9), "{found:?} {expected:?}");
        };
        close(row.z_percent, [1.2, 4.62]);
        close(row.normal_deg, [2.0, 27.2]);
        close(row.millis, [2.0, 6.2]);
        // Variances: depth 1^2 + 2^2 mm^2, errors 2 and 24 mm: (4 + 576) / 5 / 2 = 58; the third is grossly wrong.
        let [z, _] = row.squared_scores.expect("two answers with sigmas");
        assert!((z - 58.0).abs() < 1e-6, "{z}");
        assert_eq!(row.cells()[..7], ["m", "4", "75", "25.0", "33.3", "1", "1"]);
        assert_eq!(row.within_1px_percent, None, "planar regions are judged by their plane");
    }

    #[test]
    fn disparities_of_regions_that_are_no_plane_count_unanswered_ones_as_missed() {
        let cases = ["a", "b"].map(|name| case(name, Group::NonPlanar, (1.0, 0.1)));
        let entries = [entry(&cases[0], "m", Some(answer(1.0, 70.0))), entry(&cases[1], "m", None)];
        let all = groups(&entries);
        let (name, rows) = &all[0];
        assert_eq!((*name, rows[0].within_1px_percent, rows[0].normal_deg), ("non-planar", Some(25.0), None));
        assert_eq!(all.len(), 1, "there is no planar case");
    }

    #[test]
    fn the_best_of_the_others_passes_most_and_ours_is_not_among_them() {
        let one = case("a", Group::Boards, (1.0, 0.1));
        let entries = [
            peer(entry(&one, "worse", Some(answer(9.0, 1.0)))),
            peer(entry(&one, "fails", Some(answer(900.0, 1.0)))),
            peer(entry(&one, "better", Some(answer(3.0, 1.0)))),
            entry(&one, "direct", Some(answer(0.0, 0.0))),
        ];
        let all = groups(&entries);
        assert_eq!(best_peer(&all[0].1).map(|row| row.method.as_str()), Some("better"));
        assert_eq!(methods(&entries), ["direct", "worse", "fails", "better"]);
        assert!(text(&entries).contains("best of the others: better"));
        assert!(best_peer(&all[0].1[..1]).is_none());
    }

    #[test]
    fn failures_are_ours_only_and_name_the_case() {
        let one = case("a_small", Group::Small, (1.0, 0.1));
        let entries = [
            entry(&one, "direct", None),
            entry(&one, "published", Some(answer(-100.0, 3.0))),
            entry(&one, "other", Some(answer(0.0, 0.0))),
            peer(entry(&one, "bm", None)),
        ];
        let listed = failures(&entries);
        assert_eq!(listed.lines().count(), 2, "{listed}");
        assert!(listed.contains("z -5.00 %, normal 3.0 deg, grossly wrong") && listed.contains("not-observable"));
    }

    #[test]
    fn times_are_listed_by_size() {
        let one = case("a", Group::Small, (1.0, 0.1));
        let entries = [entry(&one, "direct", None), peer(entry(&one, "bm", None))];
        assert_eq!(times_by_size(&entries), [("direct".to_owned(), "0 to 1999".to_owned(), 1, [2.0, 2.0])]);
    }
}
