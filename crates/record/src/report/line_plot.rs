//! Line plots of a page: title, legend and data, which uPlot draws.

use serde::Serialize;

use super::escape;

/// Colour of a series; each has a light and a dark shade.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeriesColor {
    /// The page's text colour: black on white, white on black.
    Ink,
    /// Red.
    Red,
    /// Blue.
    Blue,
    /// Green.
    Green,
    /// Orange.
    Orange,
    /// Purple.
    Purple,
    /// Grey, for background data.
    Grey,
}

impl SeriesColor {
    pub(super) fn class(self) -> &'static str {
        match self {
            Self::Ink => "c-ink",
            Self::Red => "c-red",
            Self::Blue => "c-blue",
            Self::Green => "c-green",
            Self::Orange => "c-orange",
            Self::Purple => "c-purple",
            Self::Grey => "c-grey",
        }
    }
}

/// A named line through points.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    name: String,
    color: SeriesColor,
    dashed: bool,
    pub(super) held: bool,
    pub(super) points: Vec<[f64; 2]>,
}

impl Series {
    /// A line through points `[x, y]`, x increasing. A point with a value that is not finite interrupts the line.
    pub fn line(name: impl Into<String>, color: SeriesColor, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), color, dashed: false, held: false, points }
    }

    /// Makes the line dashed: for references and limits.
    #[must_use]
    pub fn dashed(mut self) -> Self {
        self.dashed = true;
        self
    }

    /// Makes a staircase of the line: each value holds until the next point.
    #[must_use]
    pub fn held(mut self) -> Self {
        self.held = true;
        self
    }
}

/// A vertical line with a label.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mark {
    /// Position on the x axis.
    pub at: f64,
    /// Label, short: `(1)`.
    pub label: String,
}

/// A plot of lines over a common x axis.
#[derive(Clone, Debug, PartialEq)]
pub struct LinePlot {
    title: String,
    pub(super) x: AxisText,
    pub(super) y: AxisText,
    pub(super) series: Vec<Series>,
    pub(super) marks: Vec<Mark>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct AxisText {
    quantity: String,
    unit: String,
}

impl LinePlot {
    /// A plot without lines; axes are given as quantity and unit (empty for a number without a unit).
    pub fn new(title: impl Into<String>, x: (&str, &str), y: (&str, &str)) -> Self {
        let axis = |(quantity, unit): (&str, &str)| AxisText { quantity: quantity.into(), unit: unit.into() };
        Self { title: title.into(), x: axis(x), y: axis(y), series: Vec::new(), marks: Vec::new() }
    }

    /// Adds a line; later lines are drawn above earlier ones.
    #[must_use]
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Adds a vertical line with a label.
    #[must_use]
    pub fn mark(mut self, at: f64, label: impl Into<String>) -> Self {
        self.marks.push(Mark { at, label: label.into() });
        self
    }

    /// The plot as an HTML figure with its title, its legend and the element of its data.
    pub(super) fn to_html(&self, data: Option<String>) -> String {
        let key = |s: &Series| {
            let dashed = if s.dashed { " dashed" } else { "" };
            format!("<span><i class=\"key {}{dashed}\"></i>{}</span>", s.color.class(), escape(&s.name))
        };
        let legend: String = self.series.iter().map(key).collect();
        let data = data.unwrap_or_else(|| "<p>no value</p>".to_owned());
        format!(
            "<figure class=\"plot\"><figcaption><b>{}</b>{legend}</figcaption>{data}</figure>\n",
            escape(&self.title)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_without_any_point_is_still_a_figure() {
        let nothing = Series::line("nothing", SeriesColor::Red, vec![[0.0, f64::NAN]]).dashed();
        let html = LinePlot::new("a < b", ("time", "s"), ("ratio", "")).series(nothing).to_html(None);
        assert!(html.contains("a &lt; b") && html.contains("key c-red dashed") && html.contains("no value"), "{html}");
    }
}
