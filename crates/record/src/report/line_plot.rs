//! Line plots as inline SVG.
//!
//! Implemented here instead of with a plotting crate. The usual crate repeats font and colour in every element (files several
//! times larger), cannot follow the light or dark colours of the page, and draws every sample. Here colours are classes of the
//! page's style sheet, and long series are reduced to the resolution of the image.

use std::fmt::Write as _;

use serde::Serialize;

use super::axis::Scale;
use super::escape;
use super::kept_rows::kept_rows;

/// Height of the plot area and its margins, pixels on a wide screen.
const HEIGHT: f64 = 190.0;
const LEFT: f64 = 62.0;
const TOP: f64 = 24.0;
const RIGHT: f64 = 14.0;
const BOTTOM: f64 = 40.0;
/// Height of title and legend, if drawn.
const HEADING: f64 = 34.0;

/// Width of the plot area, chosen so that letters have about the size of the surrounding text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlotWidth(f64);

impl PlotWidth {
    /// The whole width of the page.
    pub(super) const PAGE: Self = Self(1050.0);
    /// Half the width of the page.
    pub(super) const PANEL: Self = Self(470.0);
}

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

impl AxisText {
    /// `time, s`; without a unit only the quantity.
    fn label(&self) -> String {
        if self.unit.is_empty() { self.quantity.clone() } else { format!("{}, {}", self.quantity, self.unit) }
    }
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

    /// The plot as an HTML figure with its title, legend and SVG, and with the element of its data.
    pub(super) fn to_html(&self, PlotWidth(area): PlotWidth, data: &str) -> String {
        let [x, y] = self.scales(area);
        let title = escape(&self.title);
        let (width, height) = (LEFT + area + RIGHT, TOP + HEIGHT + BOTTOM);
        format!(
            "<figure class=\"plot\"><figcaption><b>{title}</b>{}</figcaption>\
             <svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\">{}{}{}</svg>{data}</figure>\n",
            self.legend(),
            self.grid(&x, &y, area),
            self.lines(&x, &y, area),
            self.mark_labels(&x, area),
        )
    }

    /// Size of [`Self::to_group`], pixels.
    pub(super) fn group_size(PlotWidth(area): PlotWidth) -> [f64; 2] {
        [LEFT + area + RIGHT, HEADING + TOP + HEIGHT + BOTTOM]
    }

    /// The plot with its title and legend as a group of a larger SVG, which uses the same style sheet.
    pub(super) fn to_group(&self, PlotWidth(area): PlotWidth, [left, top]: [f64; 2]) -> String {
        let [x, y] = self.scales(area);
        let title = escape(&self.title);
        let mut heading = format!("<text x=\"{LEFT}\" y=\"14\" class=\"head\">{title}</text>");
        let mut at = LEFT;
        for series in &self.series {
            let dashed = if series.dashed { " dashed" } else { "" };
            let (class, name) = (series.color.class(), escape(&series.name));
            let (end, text) = (at + 18.0, at + 23.0);
            let _ = write!(heading, "<path class=\"line {class}{dashed}\" d=\"M{at:.0} 26H{end:.0}\"/>");
            let _ = write!(heading, "<text x=\"{text:.0}\" y=\"30\">{name}</text>");
            at = text + 6.2 * series.name.chars().count() as f64 + 14.0;
        }
        let (grid, lines, marks) = (self.grid(&x, &y, area), self.lines(&x, &y, area), self.mark_labels(&x, area));
        format!(
            "<g transform=\"translate({left} {top})\">{heading}<g transform=\"translate(0 {HEADING})\">{grid}{lines}{marks}</g></g>\n"
        )
    }

    fn scales(&self, area: f64) -> [Scale; 2] {
        let finite = || self.series.iter().flat_map(|s| &s.points).filter(|p| is_finite(p));
        let range = |axis: usize| {
            let values = finite().map(|p| p[axis]);
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| [r[0].min(v), r[1].max(v)])
        };
        let [[x0, x1], [y0, y1]] = [range(0), range(1)];
        [Scale::new(x0, x1, (area / 75.0) as usize), Scale::with_margin(y0, y1, 5)]
    }

    fn legend(&self) -> String {
        let key = |s: &Series| {
            let dashed = if s.dashed { " dashed" } else { "" };
            format!("<span><i class=\"key {}{dashed}\"></i>{}</span>", s.color.class(), escape(&s.name))
        };
        self.series.iter().map(key).collect()
    }

    fn grid(&self, x: &Scale, y: &Scale, area: f64) -> String {
        let mut svg = String::new();
        let (bottom, right) = (TOP + HEIGHT, LEFT + area);
        // Writing to a String does not fail.
        for tick in &x.ticks {
            let at = LEFT + area * x.share(*tick);
            let (label, below) = (x.label(*tick), bottom + 15.0);
            let _ = write!(svg, "<path class=\"grid\" d=\"M{at:.1} {TOP}V{bottom}\"/>");
            let _ = write!(svg, "<text x=\"{at:.1}\" y=\"{below}\" class=\"mid\">{label}</text>");
        }
        for tick in &y.ticks {
            let at = bottom - HEIGHT * y.share(*tick);
            let (label, left, base) = (y.label(*tick), LEFT - 6.0, at + 4.0);
            let _ = write!(svg, "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{right}\"/>");
            let _ = write!(svg, "<text x=\"{left}\" y=\"{base:.1}\" class=\"end\">{label}</text>");
        }
        let (middle_x, middle_y) = (LEFT + 0.5 * area, TOP + 0.5 * HEIGHT);
        let (x_label, y_label) = (escape(&self.x.label()), escape(&self.y.label()));
        let _ = write!(svg, "<text x=\"{middle_x}\" y=\"{}\" class=\"mid axis\">{x_label}</text>", bottom + 33.0);
        let _ =
            write!(svg, "<text transform=\"translate(13 {middle_y}) rotate(-90)\" class=\"mid axis\">{y_label}</text>");
        let _ = write!(svg, "<path class=\"frame\" d=\"M{LEFT} {TOP}V{bottom}H{right}\"/>");
        svg
    }

    /// The lines, inside a nested SVG that clips them at the edges of the plot area.
    fn lines(&self, x: &Scale, y: &Scale, area: f64) -> String {
        let mut svg = format!("<svg x=\"{LEFT}\" y=\"{TOP}\" width=\"{area}\" height=\"{HEIGHT}\" class=\"area\">");
        for mark in self.marks.iter().filter(|mark| mark.at.is_finite()) {
            let _ = write!(svg, "<path class=\"mark\" d=\"M{:.1} 0V{}\"/>", area * x.share(mark.at), HEIGHT);
        }
        for series in &self.series {
            let dashed = if series.dashed { " dashed" } else { "" };
            let path = path(series, x, y, area);
            let _ = write!(svg, "<path class=\"line {}{dashed}\" d=\"{path}\"/>", series.color.class());
        }
        svg.push_str("</svg>");
        svg
    }

    /// Labels of the marks above the plot area. A label that would overlap its neighbour moves up, and is omitted if there is no
    /// room either.
    fn mark_labels(&self, x: &Scale, area: f64) -> String {
        let mut marks: Vec<_> =
            self.marks.iter().map(|m| (LEFT + area * x.share(m.at), m)).filter(|(at, _)| at.is_finite()).collect();
        marks.retain(|(at, _)| (LEFT - 1.0..=LEFT + area + 1.0).contains(at));
        marks.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut free_from = [f64::NEG_INFINITY; 2];
        let mut svg = String::new();
        for (at, mark) in marks {
            let half = 3.2 * mark.label.chars().count() as f64;
            let Some(row) = free_from.iter().position(|free| at - half >= *free) else { continue };
            free_from[row] = at + half + 2.0;
            let base = TOP - 4.0 - 9.0 * row as f64;
            let label = escape(&mark.label);
            let _ = write!(svg, "<text x=\"{at:.1}\" y=\"{base}\" class=\"mid small\">{label}</text>");
        }
        svg
    }
}

fn is_finite(point: &[f64; 2]) -> bool {
    point[0].is_finite() && point[1].is_finite()
}

/// SVG path of a series; interrupted at points that are not finite, and reduced to the resolution of the image.
fn path(series: &Series, x: &Scale, y: &Scale, area: f64) -> String {
    let rows = kept_rows(&[&series.points], (4.0 * area) as usize);
    let points: Vec<_> = rows.into_iter().map(|row| series.points[row]).collect();
    let mut path = String::new();
    for run in points.split(|point| !is_finite(point)).filter(|run| !run.is_empty()) {
        let mut command = 'M';
        for point in run {
            // Values far outside are clipped, so that the numbers stay short.
            let v = (HEIGHT * (1.0 - y.share(point[1]))).clamp(-1e4, 1e4);
            let u = (area * x.share(point[0])).clamp(-1e4, 1e4);
            if series.held && command == 'L' {
                let _ = write!(path, "H{u:.1}");
            }
            let _ = write!(path, "{command}{u:.1} {v:.1}");
            command = 'L';
            if run.len() == 1 {
                // A single point between gaps is drawn as a dot: a line of zero length with round ends.
                let _ = write!(path, "L{u:.1} {v:.1}");
            }
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_stands_where_the_axes_say() {
        // The margin is a twentieth of the range of 20.
        let points = vec![[0.0, -10.0], [5.0, 0.5], [10.0, 10.0]];
        let plot = LinePlot::new("t", ("time", "s"), ("z", "mm")).series(Series::line("a", SeriesColor::Blue, points));
        let html = plot.to_html(PlotWidth(640.0), "");
        // Half way along 640; 21/22, 10.5/22 and 1/22 of 190 from the top.
        assert!(html.contains("d=\"M0.0 181.4L320.0 90.7L640.0 8.6\""), "{html}");
        assert!(html.contains(">time, s<") && html.contains(">z, mm<"));
    }

    #[test]
    fn gaps_interrupt_the_line_and_lone_points_stay_visible() {
        let points = vec![[0.0, 0.0], [1.0, 1.0], [2.0, f64::NAN], [3.0, 0.0], [4.0, f64::INFINITY]];
        let (x, y) = (Scale::new(0.0, 4.0, 4), Scale::new(0.0, 1.0, 5));
        let line = Series::line("a", SeriesColor::Red, points);
        assert_eq!(path(&line, &x, &y, 640.0), "M0.0 190.0L160.0 0.0M480.0 190.0L480.0 190.0");
        assert_eq!(path(&line.held(), &x, &y, 640.0), "M0.0 190.0H160.0L160.0 0.0M480.0 190.0L480.0 190.0");
    }

    #[test]
    fn long_series_keep_their_peaks() {
        let mut points: Vec<_> = (0..200_000).map(|i| [f64::from(i), (f64::from(i) * 0.01).sin()]).collect();
        points[123_456][1] = 40.0;
        points[123_460][1] = -30.0;
        let (x, y) = (Scale::new(0.0, 199_999.0, 10), Scale::new(-30.0, 40.0, 5));
        let path = path(&Series::line("a", SeriesColor::Red, points), &x, &y, 640.0);
        assert!(path.len() < 640 * 5 * 14, "{} characters", path.len());
        assert!(path.contains(" 0.0") && path.contains(" 190.0"), "both peaks are kept");
    }

    #[test]
    fn labels_of_close_marks_do_not_touch() {
        let whole = Series::line("a", SeriesColor::Red, vec![[0.0, 0.0], [100.0, 1.0]]);
        let mut plot = LinePlot::new("t", ("time", "s"), ("z", "mm")).series(whole);
        for i in 0..4 {
            plot = plot.mark(50.0 + 2.0 * f64::from(i), format!("({i})"));
        }
        plot = plot.mark(53.0, "no room").mark(f64::NAN, "never").mark(300.0, "outside");
        let [x, _] = plot.scales(640.0);
        let html = plot.mark_labels(&x, 640.0);
        assert_eq!(html.matches("class=\"mid small\"").count(), 4);
        assert_eq!(html.matches("y=\"20\" class=\"mid small\"").count(), 2);
        assert!(!html.contains("never") && !html.contains("no room") && !html.contains("outside"));
    }

    #[test]
    fn a_plot_without_any_point_is_still_a_plot() {
        let html = LinePlot::new("t", ("time", "s"), ("ratio", ""))
            .series(Series::line("nothing", SeriesColor::Red, vec![[0.0, f64::NAN]]).dashed())
            .to_html(PlotWidth::PANEL, "");
        assert!(html.contains(">ratio<") && !html.contains("NaN") && !html.contains("inf"), "{html}");
    }
}
