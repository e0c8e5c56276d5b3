//! Tables and figures of the page.

use pb3dp_benchmarks::figure::{AxisKind, Line, Panel, panels};
use pb3dp_benchmarks::page::Part;
use pb3dp_benchmarks::table::{markdown, number};
use pb3dp_record::metrics::MotionErrors;
use serde_json::Value;

use super::cell::Cell;
use super::sequence_summary::SequenceRow;
use super::{first_pose, limits, sequence_summary, summary};

/// The parts of the page, from what is saved.
pub fn parts(kept: &Value, origin: &str) -> [Part<'static>; 6] {
    let rows = |key: &str| kept[key].as_array().map_or(&[][..], Vec::as_slice);
    [
        ("run", format!("Seed {}. {origin}", kept["seed"])),
        ("pairs", markdown(&summary::COLUMNS, rows("pairs"))),
        ("sequences", markdown(&sequence_summary::COLUMNS, rows("sequences"))),
        ("ensembles", markdown(&sequence_summary::ENSEMBLE_COLUMNS, rows("ensembles"))),
        ("first poses", markdown(&first_pose::COLUMNS, rows("first_poses"))),
        ("limits", markdown(&limits::COLUMNS, rows("limits"))),
    ]
}

/// Factors with a figure: name and axis label.
const FIGURES: [(&str, &str); 3] =
    [("noise", "noise, grey levels"), ("distance", "distance, mm"), ("baseline", "baseline, mm")];

/// Rms error of depth and angle over noise, distance and baseline, for each method, with the bound.
pub fn accuracy_figure(cells: &[Cell], rows: &[Value]) -> String {
    let panel = |quantity: &str| {
        FIGURES.map(|(factor, label)| {
            let cells: Vec<&Cell> = cells.iter().filter(|cell| cell.factor() == factor).collect();
            cell_panel(&cells, rows, quantity, label)
        })
    };
    panels(&["z_mm", "angle_deg"].map(panel).concat(), FIGURES.len(), &[])
}

/// Rms error (`z_mm` or `angle_deg`) over the values of one factor, with the bound.
pub fn cell_panel(cells: &[&Cell], rows: &[Value], quantity: &str, label: &str) -> Panel {
    let mut methods: Vec<&str> = rows.iter().filter_map(|row| row["method"].as_str()).collect();
    methods.sort_unstable();
    methods.dedup();
    let line = |name: &str, method: &str, path: &str| {
        let row = |cell: &Cell| rows.iter().find(|row| row["cell"] == cell.name.as_str() && row["method"] == method);
        let point = |cell: &&Cell| Some([cell.value, number(row(cell)?, path)?]);
        let points = cells.iter().filter_map(point).collect();
        Line { name: name.to_owned(), points, is_bound: name == "bound" }
    };
    let of_methods = methods.iter().map(|method| line(method, method, &format!("{quantity}.rms")));
    let bound = methods.first().map(|method| line("bound", method, &format!("bound.{quantity}")));
    let title = if quantity == "z_mm" { "depth, rms, mm" } else { "normal, rms, degrees" };
    Panel {
        title: title.to_owned(),
        x: label.to_owned(),
        axes: [AxisKind::Logarithmic; 2],
        lines: of_methods.chain(bound).collect(),
    }
}

/// Depth and rotation error of each frame of one sequence; the first frame has no motion.
pub fn sequence_panels<'a>(rows: impl Iterator<Item = &'a SequenceRow> + Clone, x: &str) -> [Panel; 2] {
    let panel = |title: &str, of: fn(&MotionErrors) -> f64| {
        let line = |found: &SequenceRow| {
            let errors = found.errors.iter().enumerate().skip(1);
            let points = errors.filter_map(|(frame, errors)| Some([frame as f64, of(errors.as_ref()?)]));
            Line {
                name: found.row["method"].as_str().unwrap_or_default().to_owned(),
                points: points.collect(),
                is_bound: false,
            }
        };
        Panel {
            title: title.to_owned(),
            x: x.to_owned(),
            axes: [AxisKind::Linear, AxisKind::Logarithmic],
            lines: rows.clone().map(line).collect(),
        }
    };
    [
        panel("depth error, mm", |errors| 1e3 * errors.translation_m.z.abs()),
        panel("rotation error, degrees", |errors| errors.rotation_rad.norm().to_degrees()),
    ]
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn figures_show_methods_and_bound() {
        let cells = super::super::cells::all();
        let row = |cell: &Cell| {
            let figures = json!({"rms": cell.value});
            json!({"cell": cell.name, "method": "direct", "z_mm": figures, "angle_deg": figures, "bound": {"z_mm": 0.5, "angle_deg": 0.1}})
        };
        let rows: Vec<Value> = cells.iter().filter(|cell| cell.factor() == "noise").map(row).collect();
        let svg = accuracy_figure(&cells, &rows);
        // Depth and angle against noise; six points each. The other panels are empty.
        assert_eq!(svg.matches("<circle").count(), 12);
        assert!(svg.contains(">bound<") && svg.contains(">direct<"));
        let kept = json!({"seed": 1, "pairs": rows, "sequences": [], "ensembles": [], "first_poses": [], "limits": []});
        let folder = tempfile::tempdir().unwrap();
        pb3dp_benchmarks::page::update(&folder.path().join("accuracy.md"), &parts(&kept, "origin")).unwrap();
    }
}
