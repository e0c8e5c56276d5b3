//! Figures as standalone SVG files that adapt to light and dark pages: lines in panels, and bars.

use std::fmt::Write as _;

/// A named line.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name.
    pub name: String,
    /// Its points; points that are not finite, or not positive on a logarithmic axis, are omitted.
    pub points: Vec<[f64; 2]>,
    /// Whether the line is dashed and grey: a bound.
    pub is_bound: bool,
}

/// Scale of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisKind {
    /// Logarithmic.
    Logarithmic,
    /// Linear.
    Linear,
}

/// One panel.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Heading.
    pub title: String,
    /// Label of the x axis.
    pub x: String,
    /// Kinds of the x and the y axis.
    pub axes: [AxisKind; 2],
    /// Its lines.
    pub lines: Vec<Line>,
}

/// One bar, of parts one after the other.
pub struct Bar {
    /// Its name.
    pub name: String,
    /// Number of the colour, and length, of each part.
    pub parts: Vec<(usize, f64)>,
    /// The text behind it.
    pub text: String,
}

/// Bars below a heading.
pub struct BarGroup {
    /// The heading.
    pub heading: String,
    /// The bars.
    pub bars: Vec<Bar>,
}

const WIDTH: f64 = 300.0;
const HEIGHT: f64 = 210.0;
const LEFT: f64 = 52.0;
const TOP: f64 = 54.0;
const BOTTOM: f64 = 40.0;
const RIGHT: f64 = 16.0;
/// Height of a caption line.
const CAPTION: f64 = 16.0;
/// Lines with more points than this have no dots.
const DOTS_MAX: usize = 40;
/// Length of the longest bar, space for its name, and height of a bar.
const BAR_LENGTH: f64 = 420.0;
const BAR_NAME: f64 = 190.0;
const BAR_HEIGHT: f64 = 13.0;

const STYLE: &str = "text { font: 11px sans-serif; fill: #5b6470; } .head { font-weight: bold; fill: #1c1f24; } \
    .grid { stroke: #e3e6ea; } .line { fill: none; stroke: currentColor; stroke-width: 1.8; } .paper { fill: #ffffff; } \
    .dot { fill: currentColor; } .dashed { stroke-dasharray: 5 3; } .c0 { color: #d1242f; } .c1 { color: #0b62c4; } \
    .c2 { color: #1a7f37; } .c3 { color: #b35900; } .c4 { color: #a3abb6; } .cb { color: #6b7480; } \
    @media (prefers-color-scheme: dark) { text { fill: #a3abb6; } .head { fill: #e8eaed; } .grid { stroke: #2b313a; } \
    .paper { fill: #15181d; } .c0 { color: #ff6b6b; } .c1 { color: #6cb0ff; } .c2 { color: #58c97b; } .c3 { color: #ffa84d; } \
    .c4 { color: #68707c; } }";

/// Panels in rows of `columns`, with lines of text below.
pub fn panels(panels: &[Panel], columns: usize, caption: &[String]) -> String {
    let (cell_width, cell_height) = (LEFT + WIDTH + RIGHT, TOP + HEIGHT + BOTTOM);
    let below = cell_height * panels.len().div_ceil(columns) as f64;
    let height = below + if caption.is_empty() { 0.0 } else { CAPTION * (caption.len() as f64 + 0.5) };
    let mut body = String::new();
    for (index, panel) in panels.iter().enumerate() {
        let (x, y) = (cell_width * (index % columns) as f64, cell_height * (index / columns) as f64);
        // Writing to a string cannot fail.
        let _ = write!(body, "<g transform=\"translate({x} {y})\">{}</g>", draw(panel));
    }
    for (index, line) in caption.iter().enumerate() {
        body.push_str(&text_at(12.0, below + CAPTION * (index as f64 + 0.8), line, ""));
    }
    file([cell_width * columns as f64, height], &body)
}

/// Bars whose longest is `longest`, or as long as the longest of them, with the names of the colours on top.
pub fn bars(legend: &[&str], groups: &[BarGroup], longest: Option<f64>) -> String {
    let lengths =
        groups.iter().flat_map(|group| &group.bars).map(|bar| bar.parts.iter().map(|(_, length)| length).sum());
    let scale = BAR_LENGTH / longest.unwrap_or_else(|| lengths.fold(f64::MIN_POSITIVE, f64::max));
    let rect = |[x, y, width]: [f64; 3], colour: usize| {
        format!(
            "<rect class=\"dot c{colour}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{BAR_HEIGHT}\"/>"
        )
    };
    let (mut body, mut x) = (String::new(), 8.0);
    for (colour, name) in legend.iter().enumerate() {
        body += &(rect([x, 8.0, BAR_HEIGHT], colour) + &text_at(x + 18.0, 19.0, name, ""));
        x += 40.0 + 6.5 * name.len() as f64;
    }
    let mut y = 34.0;
    for group in groups {
        body.push_str(&text_at(8.0, y + 11.0, &group.heading, " class=\"head\""));
        y += 18.0;
        for bar in &group.bars {
            let mut end = BAR_NAME;
            body.push_str(&text_at(BAR_NAME - 6.0, y + 11.0, &bar.name, " text-anchor=\"end\""));
            for (colour, length) in &bar.parts {
                body.push_str(&rect([end, y, length * scale], *colour));
                end += length * scale;
            }
            body.push_str(&text_at(end + 4.0, y + 11.0, &bar.text, ""));
            y += BAR_HEIGHT + 3.0;
        }
        y += 12.0;
    }
    file([BAR_NAME + BAR_LENGTH + 110.0, y], &body)
}

fn file([width, height]: [f64; 2], body: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\"><style>{STYLE}</style>\
         <rect class=\"paper\" width=\"{width}\" height=\"{height}\"/>{body}</svg>\n"
    )
}

fn text_at(x: f64, y: f64, text: &str, attributes: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    format!("<text x=\"{x:.1}\" y=\"{y:.1}\"{attributes}>{text}</text>")
}

/// Range of an axis.
struct Axis {
    kind: AxisKind,
    low: f64,
    high: f64,
}

/// Approximate number of ticks of a linear axis.
const TICKS: f64 = 6.0;

impl Axis {
    fn of(kind: AxisKind, values: impl Iterator<Item = f64> + Clone) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min);
        let high = values.fold(f64::NEG_INFINITY, f64::max);
        match kind {
            _ if low > high => Self { kind, low: 0.1, high: 10.0 },
            AxisKind::Logarithmic => Self { kind, low: low / 1.15, high: high * 1.15 },
            AxisKind::Linear => {
                let margin = 0.03 * (high - low).max(1e-6 * high.abs()).max(1e-9);
                Self { kind, low: low - margin, high: high + margin }
            }
        }
    }

    fn share(&self, value: f64) -> f64 {
        match self.kind {
            AxisKind::Logarithmic => (value / self.low).ln() / (self.high / self.low).ln(),
            AxisKind::Linear => (value - self.low) / (self.high - self.low),
        }
    }

    /// Values with a grid line and a label: 1, 2 and 5 of each decade, fewer for many decades; on a linear axis multiples
    /// of one of these.
    fn ticks(&self) -> Vec<f64> {
        if self.kind == AxisKind::Linear {
            let least = (self.high - self.low) / TICKS;
            let power = 10f64.powf(least.log10().floor());
            let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= least).unwrap_or(least);
            let (first, last) = ((self.low / step).ceil() as i64, (self.high / step).floor() as i64);
            return (first..=last).map(|i| i as f64 * step).collect();
        }
        let many = self.high / self.low > 300.0;
        let steps: &[f64] = if many { &[1.0] } else { &[1.0, 2.0, 5.0] };
        (-6..6)
            .flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)))
            .filter(|tick| (self.low..=self.high).contains(tick))
            .collect()
    }
}

/// A number without trailing zeros.
fn label(value: f64) -> String {
    let text = format!("{value:.4}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

fn draw(panel: &Panel) -> String {
    let fits = |value: f64, kind| value.is_finite() && (kind == AxisKind::Linear || value > 0.0);
    let shown = |point: &&[f64; 2]| point.iter().zip(panel.axes).all(|(value, kind)| fits(*value, kind));
    let points: Vec<&[f64; 2]> = panel.lines.iter().flat_map(|line| line.points.iter().filter(shown)).collect();
    let [x, y] = [0, 1].map(|i| Axis::of(panel.axes[i], points.iter().map(|p| p[i])));
    let place = |point: &[f64; 2]| (LEFT + WIDTH * x.share(point[0]), TOP + HEIGHT * (1.0 - y.share(point[1])));
    let mut svg = text_at(LEFT, 16.0, &panel.title, " class=\"head\"");
    for tick in x.ticks() {
        let (at, _) = place(&[tick, y.low]);
        let (bottom, below) = (TOP + HEIGHT, TOP + HEIGHT + 14.0);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{at:.1} {TOP}V{bottom}\"/>");
        let _ = write!(svg, "<text x=\"{at:.1}\" y=\"{below}\" text-anchor=\"middle\">{}</text>", label(tick));
    }
    for tick in y.ticks() {
        let (_, at) = place(&[x.low, tick]);
        let (right, base) = (LEFT + WIDTH, at + 4.0);
        let _ = write!(svg, "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{right}\"/>");
        let _ = write!(svg, "<text x=\"{}\" y=\"{base:.1}\" text-anchor=\"end\">{}</text>", LEFT - 6.0, label(tick));
    }
    let (middle, base) = (LEFT + WIDTH / 2.0, TOP + HEIGHT + 32.0);
    svg.push_str(&text_at(middle, base, &panel.x, " text-anchor=\"middle\""));
    for (index, line) in panel.lines.iter().enumerate() {
        let class = if line.is_bound { "cb".to_owned() } else { format!("c{}", index % 4) };
        let dashed = if line.is_bound { " dashed" } else { "" };
        let places: Vec<_> = line.points.iter().filter(shown).map(place).collect();
        let path: Vec<String> = places.iter().map(|(u, v)| format!("{u:.1} {v:.1}")).collect();
        let key = LEFT + 100.0 * index as f64;
        let _ = write!(svg, "<g class=\"{class}\"><path class=\"line{dashed}\" d=\"M{key} 34h18\"/>");
        if !path.is_empty() {
            let _ = write!(svg, "<path class=\"line{dashed}\" d=\"M{}\"/>", path.join("L"));
        }
        for (u, v) in places.iter().filter(|_| !line.is_bound && line.points.len() <= DOTS_MAX) {
            let _ = write!(svg, "<circle class=\"dot\" cx=\"{u:.1}\" cy=\"{v:.1}\" r=\"2.6\"/>");
        }
        let _ = write!(svg, "</g>{}", text_at(key + 22.0, 38.0, &line.name, ""));
    }
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(axes: [AxisKind; 2], points: Vec<[f64; 2]>) -> Panel {
        let line = Line { name: "a < b".into(), points, is_bound: false };
        Panel { title: "t".into(), x: "px".into(), axes, lines: vec![line] }
    }

    #[test]
    fn points_are_placed_by_their_axes_and_gaps_are_left_out() {
        let middle = format!("<circle class=\"dot\" cx=\"{:.1}\" cy=\"{:.1}\"", LEFT + WIDTH / 2.0, TOP + HEIGHT / 2.0);
        let points = vec![[1.0, 1.0], [3.0, f64::NAN], [10.0, 10.0], [100.0, 100.0], [-1.0, 1.0]];
        let svg = panels(&[panel([AxisKind::Logarithmic; 2], points)], 1, &[]);
        assert!(svg.contains(&middle) && svg.matches("<circle").count() == 3, "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let points = vec![[-1.0, -0.5], [0.0, 0.0], [1.0, 0.5]];
        let svg = panels(&[panel([AxisKind::Linear; 2], points)], 1, &["c < d".to_owned()]);
        assert!(
            svg.contains(&middle) && svg.contains(">-0.5<") && svg.contains(">0<") && !svg.contains(">-0<"),
            "{svg}"
        );
        assert!(svg.contains("a &lt; b") && svg.contains("c &lt; d"), "{svg}");
        let empty = panels(&[panel([AxisKind::Logarithmic; 2], vec![[0.0, -1.0]])], 2, &[]);
        assert!(empty.contains("a &lt; b") && !empty.contains("NaN"), "{empty}");
    }

    #[test]
    fn bars_are_as_long_as_their_parts() {
        let bar = Bar { name: "direct".into(), parts: vec![(0, 25.0), (4, 50.0)], text: "75 %".into() };
        let groups = [BarGroup { heading: "boards".into(), bars: vec![bar] }];
        let svg = bars(&["ours"], &groups, Some(100.0));
        assert!(svg.contains("c0\" x=\"190.0\" y=\"52.0\" width=\"105.0\""), "{svg}");
        assert!(svg.contains("c4\" x=\"295.0\" y=\"52.0\" width=\"210.0\"") && svg.contains(">75 %<"), "{svg}");
        assert!(bars(&[], &groups, None).contains("width=\"280.0\""));
    }
}
