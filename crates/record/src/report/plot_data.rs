//! The data of a line plot for the script of the page.

use serde::Serialize;

use super::kept_rows::kept_rows;
use super::line_plot::{AxisText, LinePlot, Mark, Series};

/// Rows of one table, beyond which rows are left out: 200 s of control steps at 100 Hz are complete, and the page of a longer run stays
/// below 5 MB.
const ROWS_MAX: usize = 20_000;
/// Steps that divide the range of a column at least: a thousand times finer than the pixels of a plot of the whole run.
const STEPS_MIN: f64 = 1e5;

#[derive(Serialize)]
struct PlotData<'a> {
    x: &'a AxisText,
    y: &'a AxisText,
    marks: Vec<&'a Mark>,
    tables: Vec<TableData>,
}

/// Lines with the same x.
#[derive(Serialize)]
struct TableData {
    x: Column,
    lines: Vec<LineData>,
}

#[derive(Serialize)]
struct LineData {
    is_held: bool,
    values: Column,
}

/// Values as steps from one to the next in units of the last decimal, half as long as the values themselves.
#[derive(Serialize)]
struct Column {
    decimals: i32,
    /// None: not finite.
    steps: Vec<Option<i64>>,
}

/// The data as a script element that is not run; none for a plot without a point.
pub(super) fn to_html(plot: &LinePlot) -> Option<String> {
    let same_x = |a: &Series, b: &Series| a.points.iter().map(|p| p[0]).eq(b.points.iter().map(|p| p[0]));
    let tables: Vec<_> = plot.series.chunk_by(same_x).map(TableData::new).collect();
    if tables.iter().flat_map(|table| &table.lines).all(|line| line.values.steps.iter().all(Option::is_none)) {
        return None;
    }
    let marks = plot.marks.iter().filter(|mark| mark.at.is_finite()).collect();
    let json = serde_json::json!(PlotData { x: &plot.x, y: &plot.y, marks, tables }).to_string();
    // Nothing in it can end the element.
    Some(format!("<script type=\"application/json\">{}</script>", json.replace('<', "\\u003c")))
}

impl TableData {
    fn new(lines: &[Series]) -> Self {
        let points: Vec<&[[f64; 2]]> = lines.iter().map(|line| &*line.points).collect();
        let mut rows = kept_rows(&points, ROWS_MAX);
        rows.retain(|row| points[0][*row][0].is_finite());
        let column = |points: &[[f64; 2]], axis: usize| Column::new(rows.iter().map(|row| points[*row][axis]));
        let line = |line: &Series| LineData { is_held: line.held, values: column(&line.points, 1) };
        Self { x: column(points[0], 0), lines: lines.iter().map(line).collect() }
    }
}

impl Column {
    fn new(values: impl Iterator<Item = f64> + Clone) -> Self {
        let finite = values.clone().filter(|value| value.is_finite());
        let [least, most] =
            finite.fold([f64::INFINITY, f64::NEG_INFINITY], |range, v| [range[0].min(v), range[1].max(v)]);
        let range = if most > least { most - least } else { most.abs() };
        let decimals = if range > 0.0 && range.is_finite() { (STEPS_MIN / range).log10().ceil() } else { 0.0 };
        let mut decimals = decimals.clamp(0.0, 9.0) as i32;
        let whole = |value: f64| value.is_finite().then(|| (value * 10_f64.powi(decimals)).round() as i64);
        let mut whole: Vec<Option<i64>> = values.map(whole).collect();
        while decimals > 0 && whole.iter().flatten().all(|value| value % 10 == 0) {
            decimals -= 1;
            whole.iter_mut().flatten().for_each(|value| *value /= 10);
        }
        let mut before = 0;
        let mut step = |now: i64| now.saturating_sub(std::mem::replace(&mut before, now));
        Self { decimals, steps: whole.into_iter().map(|value| value.map(&mut step)).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::super::SeriesColor;
    use super::*;

    /// The data, and the element that contains it.
    fn data(lines: Vec<Series>, mark: &str) -> (serde_json::Value, String) {
        let plot = LinePlot::new("t", ("time", "s"), (mark, "mm")).mark(1.0, mark).mark(f64::NAN, "never");
        let html = to_html(&lines.into_iter().fold(plot, LinePlot::series)).unwrap();
        let json = html.strip_prefix("<script type=\"application/json\">").unwrap().strip_suffix("</script>").unwrap();
        (serde_json::from_str(json).unwrap(), html)
    }

    fn line(points: &[[f64; 2]]) -> Series {
        Series::line("a", SeriesColor::Red, points.to_vec())
    }

    #[test]
    fn columns_are_steps_and_lines_with_the_same_x_share_it() {
        let a = line(&[[0.0, -1.5], [0.5, f64::NAN], [1.0, 8.5]]);
        let (data, _) = data(vec![a.clone(), a.held(), line(&[[0.25, 3.0], [f64::NAN, 4.0]])], "z");
        let values = serde_json::json!({"decimals": 1, "steps": [-15, null, 100]});
        assert_eq!(
            data["tables"],
            serde_json::json!([
                {"x": {"decimals": 1, "steps": [0, 5, 5]}, "lines": [
                    {"is_held": false, "values": values}, {"is_held": true, "values": values}]},
                {"x": {"decimals": 2, "steps": [25]}, "lines": [{"is_held": false, "values": {"decimals": 0, "steps": [3]}}]},
            ])
        );
        assert_eq!(data["marks"], serde_json::json!([{"at": 1.0, "label": "z"}]));
    }

    #[test]
    fn no_text_of_a_recording_ends_the_element() {
        let nasty = "</script><script>alert(1)</script><!-- <img src=x onerror=alert(1)> \u{2028} \" \\";
        let (data, html) = data(vec![line(&[[0.0, 0.0], [1.0, 1.0]])], nasty);
        assert_eq!(html.matches('<').count(), 2, "{html}");
        assert_eq!((&data["y"]["quantity"], &data["marks"][0]["label"]), (&nasty.into(), &nasty.into()));
    }

    #[test]
    fn a_plot_without_a_value_has_no_data() {
        let plot = LinePlot::new("t", ("time", "s"), ("ratio", "")).series(line(&[[0.0, f64::NAN]]));
        assert_eq!(to_html(&plot), None);
    }

    #[test]
    fn a_column_has_the_decimals_that_its_range_needs() {
        let (data, _) = data(vec![line(&[[0.0, 100.123_456_789], [1.0 / 3.0, 101.123_456_789]])], "z");
        let table = &data["tables"][0];
        assert_eq!(table["x"], serde_json::json!({"decimals": 6, "steps": [0, 333_333]}));
        assert_eq!(table["lines"][0]["values"], serde_json::json!({"decimals": 5, "steps": [10_012_346, 100_000]}));
    }

    #[test]
    fn values_out_of_all_proportion_are_still_data() {
        for [a, b] in [[1e300, -1e300], [0.0, 0.0], [5e-324, 0.0], [f64::NAN, 0.0], [1e12, 1e12 + 1e-6]] {
            data(vec![line(&[[0.0, a], [1.0, b]])], "z");
        }
    }
}
