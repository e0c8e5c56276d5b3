//! Rows for the terminal and for the document.

use super::summary::Summary;

/// Headings of a table of summaries.
pub const HEADINGS: [&str; 13] = [
    "configuration",
    "method",
    "n",
    "conf %",
    "right %",
    "wrong ok",
    "z mm med / p95",
    "angle deg med / p95",
    "bound mm, deg",
    "rms / bound z",
    "angle",
    "NEES",
    "ms",
];

/// The cells of a row, including the name of the configuration.
pub fn row(summary: &Summary) -> [String; 13] {
    let number = |value: Option<f64>, digits: usize| match value {
        Some(value) if value.is_finite() => format!("{value:.digits$}"),
        _ => "-".to_owned(),
    };
    let pair = |values: &[f64; 3], scale: f64, digits: usize| {
        format!("{} / {}", number(Some(values[0] * scale), digits), number(Some(values[1] * scale), digits))
    };
    let degrees = 1f64.to_degrees();
    [
        summary.cell.clone(),
        summary.method.to_owned(),
        summary.count.to_string(),
        number(Some(100.0 * summary.sure_share()), 1),
        number(Some(100.0 * summary.right_share()), 1),
        summary.wrong_ok.to_string(),
        pair(&summary.z_m, 1e3, 3),
        pair(&summary.angle_rad, degrees, 3),
        summary.bound.map_or("-".to_owned(), |[z, angle]| format!("{:.3}, {:.3}", z * 1e3, angle.to_degrees())),
        number(summary.ratio.map(|ratio| ratio[0]), 2),
        number(summary.ratio.map(|ratio| ratio[1]), 2),
        with_interval(summary.nees, summary.nees_interval),
        number(Some(summary.cpu_millis), 2),
    ]
}

/// A NEES and its interval.
pub fn with_interval(nees: Option<f64>, interval: Option<[f64; 2]>) -> String {
    match (nees, interval) {
        (Some(nees), Some([low, high])) => format!("{nees:.2} ({low:.2} to {high:.2})"),
        (Some(nees), None) => format!("{nees:.2}"),
        (None, _) => "-".to_owned(),
    }
}

/// Column widths on the terminal.
const WIDTHS: [usize; 13] = [34, 16, 5, 7, 8, 9, 17, 20, 15, 14, 8, 22, 8];

/// A row for the terminal.
pub fn line(cells: &[String; 13]) -> String {
    let mut line = String::new();
    for (index, (cell, width)) in cells.iter().zip(WIDTHS).enumerate() {
        line += &if index < 2 { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
    }
    line
}

/// A table in Markdown.
pub fn markdown<const N: usize>(headings: &[&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let mut text = format!("| {} |\n|{}\n", headings.join(" | "), "---|".repeat(N));
    for row in rows {
        text += &format!("| {} |\n", row.join(" | "));
    }
    text
}
