//! Rows of the tables: one per group and method.

use std::fmt::Write as _;

use pb3dp_benchmarks::table::{Column, number};
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

/// The columns of a group's table.
pub const COLUMNS: [Column<'_>; 15] = [
    ("method", "{method}"),
    ("n", "{cases}"),
    ("answered %", "{answered_percent:0}"),
    ("pass %", "{pass_percent:1}"),
    ("of answered %", "{of_answered_percent:1}"),
    ("gross", "{gross}"),
    ("gross, ok", "{gross_ok}"),
    ("wrong ok", "{wrong_ok}"),
    ("z % med / p95", "{z_percent_median_p95.0:2} / {z_percent_median_p95.1:2}"),
    ("normal deg med / p95", "{normal_deg_median_p95.0:2} / {normal_deg_median_p95.1:2}"),
    ("ms med / p90", "{ms_median_p90.0:2} / {ms_median_p90.1:2}"),
    ("chi2 z / normal", "{squared_scores_z_normal.0:2} / {squared_scores_z_normal.1:2}"),
    ("in 2 sigmas % z / normal", "{in_2_sigmas_percent.0:0} / {in_2_sigmas_percent.1:0}"),
    ("within 1 px %", "{within_1px_percent:1}"),
    (
        "surface within 1 px / 2 sigmas %",
        "{surface_percent_within_1px_in_2_sigmas.0:1} / {surface_percent_within_1px_in_2_sigmas.1:1}",
    ),
];

/// The row of one method for one group. Errors are over the answered cases, times over all; a method without a status has no `ok`.
/// The normal is judged of planes, the disparities of other regions; there a case without an answer counts as missed.
fn row(group: &str, entries: &[&Entry]) -> Option<Value> {
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
    let passed = entries.iter().filter(|e| e.grade() == Some(Grade::Pass)).count();
    let covered_percent = |index: usize| {
        let known: Vec<bool> = entries.iter().filter_map(|e| e.covered()[index]).collect();
        (!known.is_empty()).then(|| share(known.iter().filter(|is_covered| **is_covered).count(), known.len()))
    };
    let surface = || [of_surfaces(|s| s.within_1px), of_surfaces(|s| s.in_2_sigmas)].map(per_case);
    Some(json!({
        "group": group, "method": first.method, "ours": first.maker == Maker::Ours, "cases": entries.len(),
        "answered": answers.len(), "passed": passed, "gross": gross.len(),
        "gross_ok": first.status.map(|_| gross.iter().filter(|e| e.is_ok()).count()),
        "ok": first.status.map(|_| entries.iter().filter(|e| e.is_ok()).count()),
        "wrong_ok": first.status.map(|_| entries.iter().filter(|e| e.is_wrong_ok()).count()),
        "in_2_sigmas_percent": [covered_percent(0), covered_percent(1)],
        "answered_percent": share(answers.len(), entries.len()), "pass_percent": share(passed, entries.len()),
        "of_answered_percent": (!answers.is_empty()).then(|| share(passed, answers.len())),
        "z_percent_median_p95": pair(&z, 95.0), "normal_deg_median_p95": pair(&normal, 95.0),
        "ms_median_p90": pair(&millis, 90.0), "squared_scores_z_normal": mean_of_pairs(&judged),
        "within_1px_percent": (!planar && has_map).then(|| per_case(within)),
        "surface_percent_within_1px_in_2_sigmas": (!surfaces.is_empty()).then(surface),
    }))
}

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

/// Every group that has cases, with one row per method; last all planar cases together.
pub fn groups(entries: &[Entry]) -> Vec<(&'static str, Vec<Value>)> {
    let rows = |group: &'static str, belongs: &dyn Fn(&Entry) -> bool| {
        let of_method = |method: &str| {
            let chosen: Vec<_> = entries.iter().filter(|e| e.method == method && belongs(e)).collect();
            row(group, &chosen)
        };
        (group, methods(entries).into_iter().filter_map(of_method).collect::<Vec<_>>())
    };
    let mut found: Vec<_> = GROUPS.iter().map(|(group, name)| rows(name, &|e| e.case.group == *group)).collect();
    found.push(rows("all planar", &|e| e.case.is_planar()));
    found.retain(|(_, rows)| !rows.is_empty());
    found
}

/// The best of the other tools: most passed, then fewest grossly wrong, then the smallest depth error. For non-planar
/// regions: most disparities within 1 px.
pub fn best_peer(rows: &[Value]) -> Option<&Value> {
    let key = |row: &Value| {
        let value = |path: &str, default: f64| number(row, path).unwrap_or(default);
        [
            value("within_1px_percent", 0.0),
            value("pass_percent", 0.0),
            -value("gross", 0.0),
            -value("z_percent_median_p95.0", f64::INFINITY),
        ]
    };
    let better = |a: &&Value, b: &&Value| {
        let (a, b) = (key(a), key(b));
        a.iter().zip(&b).map(|(x, y)| x.total_cmp(y)).find(|order| order.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
    };
    rows.iter().filter(|row| row["ours"] == false).max_by(better)
}

/// Times of methods that measure once per rig or scene, one line each; these times are in no other column.
pub fn rows_notes(entries: &[Entry]) -> Vec<String> {
    let note = |method: &str| {
        let times: Vec<f64> = entries.iter().filter(|e| e.method == method).filter_map(|e| e.rows_ms).collect();
        let [median, p90] = pair(&times, 90.0)?;
        Some(format!(
            "* {method}: rows_ms {median:.1} / {p90:.1} (vertical misalignment per rig or scene, median / p90)"
        ))
    };
    methods(entries).into_iter().filter_map(note).collect()
}

/// Every case that one of our methods did not pass, or where it is wrong and `ok`, with its errors and what it states.
pub fn failures<'a>(entries: impl Iterator<Item = &'a Entry>) -> String {
    let mut text = String::new();
    let is_failure = |e: &&Entry| e.maker == Maker::Ours && (e.grade() != Some(Grade::Pass) || e.is_wrong_ok());
    for entry in entries.filter(is_failure) {
        let (name, method, status) = (&entry.case.name, &entry.method, entry.status.unwrap_or("-"));
        let errors = entry.answer.map_or("no answer".to_owned(), |a| {
            let percent = 100.0 / entry.case.z_m;
            let stated = a.z_sigma_m.zip(a.normal_sigma_rad);
            let stated =
                stated.map(|(z, normal)| format!(", stated {:.2} %, {:.1} deg", percent * z, normal.to_degrees()));
            let errors = format!("z {:+.2} %, normal {:.1} deg", percent * a.z_m, a.normal_rad.to_degrees());
            errors + &stated.unwrap_or_default()
        });
        let gross = if entry.grade() == Some(Grade::Gross) { ", grossly wrong" } else { "" };
        let wrong = if entry.is_wrong_ok() { ", wrong and ok" } else { "" };
        let _ = writeln!(text, "{method:<16} {name:<24} {status:<15} {errors}{gross}{wrong}");
    }
    text
}

/// Bounds of the size classes for times, pixels of the region.
const SIZE_LIMITS_PX: [usize; 4] = [2_000, 10_000, 60_000, usize::MAX];

/// Times of our methods by the size of the region.
pub fn times_by_size(entries: &[Entry]) -> Vec<Value> {
    let mut found = Vec::new();
    for method in methods(entries) {
        let mut from = 0;
        for to in SIZE_LIMITS_PX {
            let belongs =
                |e: &&Entry| e.method == method && e.maker == Maker::Ours && (from..to).contains(&e.case.region_px);
            let millis: Vec<_> = entries.iter().filter(belongs).filter_map(|e| e.ms).collect();
            let class = if to == usize::MAX { format!("from {from}") } else { format!("{from} to {}", to - 1) };
            let row = |times: [f64; 2]| json!({"method": method, "region_px": class, "cases": millis.len(), "ms_median_p90": times});
            found.extend(pair(&millis, 90.0).map(row));
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
    fn values_measured_once_stand_below_the_table() {
        let known = [case("a", Group::Small, (0.0, 0.0)), case("b", Group::Textured, (0.0, 0.0))];
        let timed = |index: usize, ms: f64| Entry { rows_ms: Some(ms), ..entry(&known[index], "m", None) };
        let entries = [timed(0, 50.0), timed(1, 70.0), entry(&known[0], "n", None)];
        let notes = rows_notes(&entries);
        assert!(notes.len() == 1 && notes[0].starts_with("* m: rows_ms 60.0 / 68.0"), "{notes:?}");
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
        let counts =
            ["cases", "answered", "passed", "gross", "gross_ok"].map(|key| row[key].as_u64().expect("counted"));
        assert_eq!(counts, [4, 3, 1, 1, 1]);
        // numpy.percentile([0.1, 1.2, 5.0], [50, 95]) = [1.2, 4.62], ([1, 2, 30], 95) = 27.2, ([2, 2, 2, 8], 90) = 6.2
        for (key, expected) in [
            ("z_percent_median_p95", [1.2, 4.62]),
            ("normal_deg_median_p95", [2.0, 27.2]),
            ("ms_median_p90", [2.0, 6.2]),
        ] {
            let is_close = |index: usize| (row[key][index].as_f64().expect("there") - expected[index]).abs() < 1e-9;
            assert!(is_close(0) && is_close(1), "{row}");
        }
        // Variances: depth 1^2 + 2^2 mm^2, errors 2 and 24 mm: (4 + 576) / 5 / 2 = 58; the third is grossly wrong.
        let z = number(row, "squared_scores_z_normal.0").expect("two answers with sigmas");
        assert!((z - 58.0).abs() < 1e-6, "{z}");
        let shown = pb3dp_benchmarks::table::row(&COLUMNS, row);
        assert!(
            shown.starts_with("| m | 4 | 75 | 25.0 | 33.3 | 1 | 1 | 2 | 1.20 / 4.62 |") && !shown.contains('?'),
            "{shown}"
        );
        assert!(row["within_1px_percent"].is_null(), "planar regions are judged by their plane");
    }

    #[test]
    fn disparities_of_regions_that_are_no_plane_count_unanswered_ones_as_missed() {
        let cases = ["a", "b"].map(|name| case(name, Group::NonPlanar, (1.0, 0.1)));
        let entries = [entry(&cases[0], "m", Some(answer(1.0, 70.0))), entry(&cases[1], "m", None)];
        let all = groups(&entries);
        let (name, rows) = &all[0];
        assert_eq!((*name, &rows[0]["within_1px_percent"]), ("non-planar", &25.0.into()));
        assert!(rows[0]["normal_deg_median_p95"].is_null());
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
        assert_eq!(best_peer(&all[0].1).map(|row| &row["method"]), Some(&"better".into()));
        assert_eq!(methods(&entries), ["direct", "worse", "fails", "better"]);
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
        let listed = failures(entries.iter());
        assert_eq!(listed.lines().count(), 2, "{listed}");
        assert!(listed.contains("z -5.00 %, normal 3.0 deg, grossly wrong") && listed.contains("not-observable"));
    }

    #[test]
    fn times_are_listed_by_size() {
        let one = case("a", Group::Small, (1.0, 0.1));
        let entries = [entry(&one, "direct", None), peer(entry(&one, "bm", None))];
        let expected = json!({"method": "direct", "region_px": "0 to 1999", "cases": 1, "ms_median_p90": [2.0, 2.0]});
        assert_eq!(times_by_size(&entries), [expected]);
    }
}
