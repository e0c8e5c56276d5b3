//! Named bars as inline SVG.

use std::fmt::Write as _;

use super::escape;

/// Sizes, pixels on a wide screen.
const WIDTH: f64 = 520.0;
const NAME: f64 = 130.0;
const VALUE: f64 = 56.0;
const ROW: f64 = 17.0;
/// Space above the bars, for the names of limits.
const TOP: f64 = 16.0;
/// Maximum length of a name; longer names are truncated.
const NAME_MAX: usize = 20;

/// A bar chart with names, one bar below the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Bars {
    title: String,
    decimals: usize,
    bars: Vec<(String, f64)>,
    limits: Vec<(String, f64)>,
}

impl Bars {
    /// An empty chart with this number of decimals. Units belong in the title.
    pub fn new(title: impl Into<String>, decimals: usize) -> Self {
        Self { title: title.into(), decimals, bars: Vec::new(), limits: Vec::new() }
    }

    /// Adds a bar; a value that is not finite has no bar.
    #[must_use]
    pub fn bar(mut self, name: impl Into<String>, value: f64) -> Self {
        self.bars.push((name.into(), value));
        self
    }

    /// Adds a line across all bars with a name above it.
    #[must_use]
    pub fn limit(mut self, name: impl Into<String>, value: f64) -> Self {
        self.limits.push((name.into(), value));
        self
    }

    /// The bars as an HTML figure.
    pub(super) fn to_html(&self) -> String {
        let values = self.bars.iter().chain(&self.limits).map(|(_, value)| *value);
        let most = values.filter(|value| value.is_finite()).fold(0.0, f64::max).max(f64::MIN_POSITIVE);
        let area = WIDTH - NAME - VALUE;
        let place = |value: f64| area * (value / most).clamp(0.0, 1.0);
        let mut svg = String::new();
        for (index, (name, value)) in self.bars.iter().enumerate() {
            let (top, base) = (TOP + ROW * index as f64, TOP + ROW * (index as f64 + 0.75));
            let length = if value.is_finite() { place(*value) } else { 0.0 };
            let text = if value.is_finite() { format!("{value:.*}", self.decimals) } else { "-".to_owned() };
            let short: String = if name.chars().count() > NAME_MAX {
                name.chars().take(NAME_MAX - 1).chain("\u{2026}".chars()).collect()
            } else {
                name.clone()
            };
            // Writing to a String does not fail.
            let _ = write!(
                svg,
                "<text class=\"end\" x=\"{}\" y=\"{base:.1}\"><title>{}</title>{}</text>\
                 <rect class=\"c-blue\" x=\"{NAME}\" y=\"{:.1}\" width=\"{length:.1}\" height=\"{:.1}\" fill=\"currentColor\"/>\
                 <text class=\"axis\" x=\"{:.1}\" y=\"{base:.1}\">{text}</text>",
                NAME - 6.0,
                escape(name),
                escape(&short),
                top + 3.0,
                ROW - 6.0,
                NAME + length + 5.0,
            );
        }
        let bottom = TOP + ROW * self.bars.len() as f64;
        for (name, value) in self.limits.iter().filter(|(_, value)| value.is_finite()) {
            let at = NAME + place(*value);
            let _ = write!(svg, "<path class=\"mark\" d=\"M{at:.1} {TOP}V{bottom:.1}\"/>");
            let _ = write!(svg, "<text class=\"mid small\" x=\"{at:.1}\" y=\"{}\">{}</text>", TOP - 4.0, escape(name));
        }
        let title = escape(&self.title);
        format!(
            "<figure class=\"plot over\"><figcaption><b>{title}</b></figcaption>\
             <svg viewBox=\"0 0 {WIDTH} {:.1}\" role=\"img\" aria-label=\"{title}\">{svg}</svg></figure>\n",
            bottom + 4.0
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_are_as_long_as_their_numbers() {
        let bars = Bars::new("error, px", 3).bar("a < b", 0.2).bar("x".repeat(30), 0.4).bar("none", f64::NAN);
        let html = bars.limit("good", 0.1).limit("never", f64::INFINITY).to_html();
        assert!(html.contains("a &lt; b") && html.contains(">0.200</text>"), "{html}");
        // Half of 334, and a quarter of it.
        assert!(
            html.contains("width=\"167.0\"") && html.contains("width=\"334.0\"") && html.contains("M213.5 16"),
            "{html}"
        );
        assert!(html.contains("x\u{2026}") && !html.contains("never") && !html.contains("NaN"), "{html}");
    }
}
