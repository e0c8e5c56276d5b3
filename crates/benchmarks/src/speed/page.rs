//! Goals, tables and figure of the page.

use pb3dp_benchmarks::figure::{Bar, BarGroup, bars};
use pb3dp_benchmarks::limit::{self, Check};
use pb3dp_benchmarks::page::Part;
use pb3dp_benchmarks::table::{Column, at, cell, markdown, number};
use serde_json::Value;

use super::stages::Stage;

/// Goals for the direct method: what, where it stands in the results, and the largest time, milliseconds.
const GOALS: [(&str, &str, f64); 7] = [
    ("cold start on real cases, median", "cold_start_on_cases.rows.0.whole.median_ms", 1.5),
    ("cold start on real cases, 90th percentile", "cold_start_on_cases.rows.0.whole.p90_ms", 4.0),
    ("vertical misalignment, once per rig, median", "cold_start_on_cases.row_measurement.median_ms", 20.0),
    ("tracking frame, median", "tracking.followed.median_ms", 0.9),
    ("tracking frame, 99th percentile", "tracking.followed.p99_ms", 1.5),
    ("frame of a lost target, median", "tracking.lost.median_ms", 5.0),
    ("first frame of a track", "tracking.start_ms", 80.0),
];

/// The goals for what was measured: without real cases there are none for them.
pub fn goals(kept: &Value) -> Vec<Check> {
    let measured = GOALS.iter().filter_map(|(what, path, most)| Some((what, number(kept, path)?, most)));
    let check = |(what, found, most): (&&str, f64, &f64)| Check {
        what: (*what).to_owned(),
        found: Some(found),
        most: *most,
        unit: "ms",
    };
    measured.map(check).collect()
}

const CASES: [Column<'_>; 5] = [
    ("group", "{group}"),
    ("cases", "{whole.count}"),
    ("median", "{whole.median_ms:2}"),
    ("p90", "{whole.p90_ms:2}"),
    ("max", "{whole.max_ms:2}"),
];
const SIZES: [Column<'_>; 5] = [
    ("region px", "{side_px} x {side_px}"),
    ("status", "{status}"),
    ("median", "{times.median_ms:3}"),
    ("p90", "{times.p90_ms:3}"),
    ("p99", "{times.p99_ms:3}"),
];
const RAW: [Column<'_>; 5] = [
    ("images", "{width} x {height}"),
    ("lenses", "{lenses}"),
    ("to rectified", "{ratio_to_rectified:2}"),
    ("to 640 x 480", "{ratio_to_small:2}"),
    ("creation", "{creation_ms:2}"),
];
const TRACKING: [Column<'_>; 6] = [
    ("frame", "{frame}"),
    ("frames", "{count}"),
    ("median", "{median_ms:3}"),
    ("p90", "{p90_ms:3}"),
    ("p99", "{p99_ms:3}"),
    ("max", "{max_ms:3}"),
];
const PUBLISHED: [Column<'_>; 4] = [
    ("kernels", "{kernels}"),
    ("ns per sample", "{ns_per_sample:3}"),
    ("ratio to naive", "{ratio_to_naive:1}"),
    ("frame ms", "{frame_ms:3}"),
];
const SCALING: [Column<'_>; 7] = [
    ("varied", "{varied}"),
    ("value", "{value}"),
    ("what", "{what}"),
    ("median", "{times.median_ms:3}"),
    ("p90", "{times.p90_ms:3}"),
    ("p99", "{times.p99_ms:3}"),
    ("ratio", "{ratio_to_first:2}"),
];

/// The parts of the page; without real cases or the published method, theirs stay as they are.
pub fn parts(kept: &Value, command: &str, origin: &str) -> Vec<Part<'static>> {
    let goals: Vec<Value> = goals(kept).iter().map(Check::to_json).collect();
    let mut parts = vec![
        ("run", format!("```text\n{command}\n```\n\n{origin}")),
        ("goals", markdown(&limit::COLUMNS, &goals)),
        ("sizes", with_stages(&SIZES, "stages.{}.median_ms", rows(kept, "cold_start_by_size"))),
        (
            "raw",
            with_stages(&[&SIZES[..], &RAW].concat(), "stages.{}.median_ms", rows(kept, "cold_start_on_raw_images")),
        ),
        ("tracking", tracking(&kept["tracking"])),
        ("kernels", kernels(rows(kept, "kernels"))),
        ("scaling", markdown(&SCALING, rows(kept, "scaling"))),
    ];
    if let Some(rows) = at(kept, "cold_start_on_cases.rows").and_then(Value::as_array) {
        let once = "median {median_ms:2} ms, p90 {p90_ms:2} ms, max {max_ms:2} ms.";
        let once = |key: &str| cell(once, &kept["cold_start_on_cases"][key]);
        let text = format!(
            "{}\nThe vertical misalignment of the rig is measured once before and is not part of these times: {}\n\
             The first call of an estimator also allocates its memory: {}",
            with_stages(&CASES, "median_of_stages_ms.{}", rows),
            once("row_measurement"),
            once("first_call")
        );
        parts.push(("cases", text));
    }
    if let Some(pairs) = at(kept, "published.pairs").and_then(Value::as_array) {
        let table =
            |pair: &Value| format!("Pair {}:\n\n{}", cell("{pair}", pair), markdown(&PUBLISHED, rows(pair, "kernels")));
        parts.push(("published", pairs.iter().map(table).collect::<Vec<_>>().join("\n")));
    }
    parts
}

fn rows<'a>(kept: &'a Value, key: &str) -> &'a [Value] {
    kept[key].as_array().map_or(&[], Vec::as_slice)
}

/// A table with a column for each stage; `{}` in its path is the name of the stage.
fn with_stages(columns: &[Column<'_>], path: &str, rows: &[Value]) -> String {
    let stages: Vec<_> =
        Stage::PARTS.map(|stage| (stage.name(), format!("{{{}:3}}", path.replace("{}", stage.name())))).into();
    let stages = stages.iter().map(|(name, text)| (*name, text.as_str()));
    markdown(&columns.iter().copied().chain(stages).collect::<Vec<_>>(), rows)
}

fn tracking(found: &Value) -> String {
    let rows = ["followed", "lost"].map(|key| {
        let mut row = found[key].clone();
        row["frame"] = key.into();
        row
    });
    let first = cell("The first frame, with cold start and model, took {start_ms:2} ms.", found);
    format!("{}\n{first}", markdown(&TRACKING, &rows))
}

fn kernels(rows: &[Value]) -> String {
    let sets = rows.first().map_or(0, |row| row["sets"].as_array().map_or(0, Vec::len));
    let set = |set: usize| {
        let text = format!("{{sets.{set}.ns_per_sample:3}} ({{sets.{set}.ratio_to_scalar:1}})");
        (cell(&format!("{{sets.{set}.kernels}}"), &rows[0]), text)
    };
    let sets: Vec<(String, String)> = (0..sets).map(set).collect();
    let sets = sets.iter().map(|(name, text)| (name.as_str(), text.as_str()));
    markdown(&[("part", "{name}"), ("a sample is a", "{sample}")].into_iter().chain(sets).collect::<Vec<_>>(), rows)
}

/// Stages that do not contain each other.
const DRAWN: [Stage; 4] = [Stage::Windows, Stage::Search, Stage::Patches, Stage::Refinement];

/// For each size of the region the median of the whole, and below it the stages in sequence.
pub fn figure(kept: &Value) -> String {
    let group = |row: &Value| {
        let median_ms = |path: &str| number(row, path).unwrap_or(0.0);
        let whole = vec![(4, median_ms("times.median_ms"))];
        let part = |(index, stage): (usize, &Stage)| (index, median_ms(&format!("stages.{}.median_ms", stage.name())));
        let text = cell("{times.median_ms:2} ms, p99 {times.p99_ms:2} ms", row);
        BarGroup {
            heading: cell("{side_px} x {side_px} px", row),
            bars: vec![
                Bar { name: "whole, median".to_owned(), parts: whole, text },
                Bar {
                    name: "stages".to_owned(),
                    parts: DRAWN.iter().enumerate().map(part).collect(),
                    text: String::new(),
                },
            ],
        }
    };
    let groups: Vec<BarGroup> = rows(kept, "cold_start_by_size").iter().map(group).collect();
    bars(&DRAWN.map(Stage::name), &groups, None)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn tables_and_bars_are_those_of_the_rows() {
        let times = json!({"count": 9, "min_ms": 0.5, "median_ms": 1.0, "p90_ms": 1.5, "p99_ms": 2.0, "max_ms": 3.0});
        let stages: serde_json::Map<_, _> =
            Stage::PARTS.iter().map(|stage| (stage.name().to_owned(), times.clone())).collect();
        let row = json!({
            "side_px": 60, "status": "ok", "times": times, "stages": stages, "lenses": "rectified", "width": 640, "height": 480,
            "ratio_to_rectified": 1.0, "ratio_to_small": 1.0, "creation_ms": 4.0,
        });
        let kept = json!({
            "cold_start_by_size": [row], "cold_start_on_raw_images": [row],
            "tracking": {"followed": times, "lost": times, "start_ms": 90.0},
            "kernels": [{"name": "a part", "sample": "pixel", "sets": [{"kernels": "scalar", "ns_per_sample": 2.0, "ratio_to_scalar": 1.0}]}],
            "scaling": [{"varied": "points", "value": "250", "what": "frame", "times": times, "ratio_to_first": 1.0}],
        });
        let goals = goals(&kept);
        assert_eq!(goals.iter().filter(|goal| !goal.is_kept()).count(), 3, "0.9, 1.5 and 80 ms: {goals:?}");
        let parts = parts(&kept, "command", "origin");
        assert!(parts.iter().all(|(_, text)| !text.contains('?')), "{parts:?}");
        assert!(parts[2].1.contains("| 60 x 60 | ok | 1.000 | 1.500 | 2.000 | 1.000 |"), "{parts:?}");
        let folder = tempfile::tempdir().expect("a folder");
        pb3dp_benchmarks::page::update(&folder.path().join("speed.md"), &parts).expect("the page has all marks");
        // The four stages are the longest bar, and the whole is a quarter of it.
        let svg = figure(&kept);
        assert!(svg.contains("c4\" x=\"190.0\" y=\"52.0\" width=\"105.0\"") && svg.contains(">60 x 60 px<"), "{svg}");
    }
}
