//! Plots over the area of an image as inline SVG: vectors at pixels, and numbers in cells.

use std::fmt::Write as _;

use super::SeriesColor;
use super::escape;

/// Width of the image in the plot, chosen so that letters have about the size of the surrounding text.
const WIDTH: f64 = 520.0;
/// Space below the image, for the scale.
const BELOW: f64 = 22.0;
/// Maximum length of the scale bar, as a share of the image width.
const BAR_SHARE: f64 = 0.15;

/// A vector at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VectorAt {
    /// Start point, `[u, v]`, px.
    pub at_px: [f64; 2],
    /// Its components, px.
    pub vector_px: [f64; 2],
}

/// A plot over the area of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagePlot {
    title: String,
    size_px: [f64; 2],
    vectors: Vec<VectorAt>,
    color: SeriesColor,
    magnified: f64,
    cells: Option<Cells>,
}

#[derive(Clone, Debug, PartialEq)]
struct Cells {
    across: usize,
    numbers: Vec<f64>,
    decimals: usize,
}

impl ImagePlot {
    /// An empty plot over an image of `[width, height]` pixels.
    pub fn new(title: impl Into<String>, size_px: [u32; 2]) -> Self {
        let size_px = size_px.map(|length| f64::from(length.max(1)));
        Self { title: title.into(), size_px, vectors: Vec::new(), color: SeriesColor::Red, magnified: 1.0, cells: None }
    }

    /// Draws magnified vectors, with a scale bar.
    #[must_use]
    pub fn vectors(mut self, vectors: Vec<VectorAt>, color: SeriesColor, magnified: f64) -> Self {
        (self.vectors, self.color, self.magnified) = (vectors, color, magnified);
        self
    }

    /// Divides the image into cells, `across` in each row, and writes a number with this many decimals into each, row by row.
    /// Larger numbers have a stronger colour; a cell of zero is marked.
    #[must_use]
    pub fn cells(mut self, across: usize, numbers: Vec<f64>, decimals: usize) -> Self {
        self.cells = (across > 0).then_some(Cells { across, numbers, decimals });
        self
    }

    /// A round magnification for which 95 % of the vectors are no longer than a sixteenth of the image width.
    pub fn magnification(vectors: &[VectorAt], width_px: u32) -> f64 {
        let mut lengths: Vec<f64> = vectors.iter().map(|v| v.vector_px[0].hypot(v.vector_px[1])).collect();
        lengths.sort_by(f64::total_cmp);
        let long = lengths.get(lengths.len() * 95 / 100).copied().unwrap_or(1.0);
        round_down(f64::from(width_px) / 16.0 / long.max(1e-6)).max(1.0)
    }

    /// The plot as an HTML figure.
    pub(super) fn to_html(&self) -> String {
        let scale = WIDTH / self.size_px[0];
        let height = self.size_px[1] * scale;
        let title = escape(&self.title);
        let below = if self.vectors.is_empty() { 0.0 } else { BELOW };
        let mut svg = self.cells.as_ref().map_or_else(String::new, |cells| cells.to_svg(height));
        svg.push_str(&self.vectors_svg(scale, height));
        // Writing to a String does not fail.
        let _ = write!(svg, "<path class=\"frame\" d=\"M.5 .5H{:.1}V{:.1}H.5Z\"/>", WIDTH - 0.5, height - 0.5);
        format!(
            "<figure class=\"plot over\"><figcaption><b>{title}</b></figcaption>\
             <svg viewBox=\"0 0 {WIDTH} {:.1}\" role=\"img\" aria-label=\"{title}\">{svg}</svg></figure>\n",
            height + below
        )
    }

    fn vectors_svg(&self, scale: f64, height: f64) -> String {
        let (mut lines, mut dots) = (String::new(), String::new());
        let finite = |vector: &&VectorAt| vector.at_px.iter().chain(&vector.vector_px).all(|value| value.is_finite());
        for VectorAt { at_px, vector_px } in self.vectors.iter().filter(finite) {
            let [u, v] = at_px.map(|at| (at + 0.5) * scale);
            let [du, dv] = vector_px.map(|way| (way * self.magnified * scale).clamp(-2.0 * WIDTH, 2.0 * WIDTH));
            let _ = write!(lines, "M{u:.1} {v:.1}l{du:.1} {dv:.1}");
            let _ = write!(dots, "M{u:.1} {v:.1}h0");
        }
        if self.vectors.is_empty() {
            return String::new();
        }
        let class = self.color.class();
        let bar_px = round_down(BAR_SHARE * self.size_px[0] / self.magnified);
        let (bar, base) = (bar_px * self.magnified * scale, height + 13.0);
        let label = format!("{bar_px} px, drawn {} times longer", self.magnified);
        format!(
            "<svg width=\"{WIDTH}\" height=\"{height:.1}\" class=\"area\"><path class=\"dots {class}\" d=\"{dots}\"/>\
             <path class=\"line thin {class}\" d=\"{lines}\"/></svg>\
             <path class=\"line {class}\" d=\"M2 {base}h{bar:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\">{label}</text>",
            bar + 10.0,
            base + 4.0
        )
    }
}

impl Cells {
    fn to_svg(&self, height: f64) -> String {
        let down = self.numbers.len().div_ceil(self.across).max(1);
        let (w, h) = (WIDTH / self.across as f64, height / down as f64);
        let most = self.numbers.iter().copied().filter(|number| number.is_finite()).fold(0.0, f64::max);
        let mut svg = String::new();
        for (index, number) in self.numbers.iter().enumerate() {
            let (x, y) = ((index % self.across) as f64 * w, (index / self.across) as f64 * h);
            let (class, opacity) = match number {
                number if !number.is_finite() => ("c-grey", 0.3),
                number if *number > 0.0 => ("c-blue", 0.08 + 0.6 * number / most),
                _ => ("c-orange", 0.3),
            };
            let (middle, base) = (x + 0.5 * w, y + 0.5 * h + 4.0);
            let text = if number.is_finite() { format!("{number:.*}", self.decimals) } else { "-".to_owned() };
            let _ = write!(
                svg,
                "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"currentColor\" \
                 fill-opacity=\"{opacity:.2}\"/><text class=\"mid axis\" x=\"{middle:.1}\" y=\"{base:.1}\">{text}</text>"
            );
        }
        svg
    }
}

/// The largest 1, 2 or 5 times a power of ten that is not larger than the value.
fn round_down(value: f64) -> f64 {
    if !(value.is_finite() && value > 0.0) {
        return 1.0;
    }
    let exponent = value.log10().floor() as i32;
    let steps = [1, 2, 5].map(|step| {
        if exponent < 0 { f64::from(step) / 10_f64.powi(-exponent) } else { f64::from(step) * 10_f64.powi(exponent) }
    });
    steps.into_iter().rev().find(|step| *step <= value * (1.0 + 1e-12)).unwrap_or(steps[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_stand_at_their_pixels_and_the_scale_is_stated() {
        let vectors = vec![
            VectorAt { at_px: [319.5, 239.5], vector_px: [0.2, -0.1] },
            VectorAt { at_px: [f64::NAN, 0.0], vector_px: [0.0, 0.0] },
        ];
        let magnified = ImagePlot::magnification(&vectors[..1], 640);
        assert_eq!(magnified, 100.0);
        let html = ImagePlot::new("left & right", [640, 480]).vectors(vectors, SeriesColor::Red, magnified).to_html();
        // Half of 520 x 390, and 20 px of 640 to the right.
        assert!(html.contains("d=\"M260.0 195.0l16.2 -8.1\""), "{html}");
        assert!(html.contains("0.5 px, drawn 100 times longer") && html.contains("M2 403h40.6"), "{html}");
        assert!(html.contains("left &amp; right") && !html.contains("NaN"), "{html}");
    }

    #[test]
    fn cells_hold_their_numbers() {
        let html = ImagePlot::new("seen", [400, 300]).cells(3, vec![0.0, 4.0, 2.0, 1.0, 0.0, f64::NAN], 0).to_html();
        assert_eq!(html.matches("<rect").count(), 6);
        assert_eq!(html.matches("c-orange").count(), 2);
        assert!(
            html.contains(">4</text>") && html.contains("fill-opacity=\"0.68\"") && !html.contains("NaN"),
            "{html}"
        );
        assert!(!html.contains("drawn"), "{html}");
    }

    #[test]
    fn round_numbers_are_one_two_or_five() {
        for (value, expected) in [(0.37, 0.2), (1.0, 1.0), (5.1, 5.0), (4.99, 2.0), (1234.0, 1000.0), (0.001, 0.001)] {
            assert_eq!(round_down(value), expected);
        }
        assert_eq!(round_down(f64::NAN), 1.0);
    }
}
