//! Plots as a standalone SVG file, for pages that are not reports.

use super::escape;
use super::line_plot::{LinePlot, PlotWidth};

/// Height of a caption line, pixels.
const CAPTION: f64 = 16.0;
/// Space between and around the panels.
const GAP: f64 = 10.0;

const STYLE: &str = "svg { --ink: #1c1f24; --soft: #5b6470; --rule: #d9dde3; --grid: #e9ecf0; --paper: #ffffff; --red: #d1242f; \
    --blue: #0b62c4; --green: #1a7f37; --orange: #b35900; --purple: #7a3fc4; --grey: #8a929d; } \
    @media (prefers-color-scheme: dark) { svg { --ink: #e8eaed; --soft: #a3abb6; --rule: #39404a; --grid: #272c34; \
    --paper: #15181d; --red: #ff6b6b; --blue: #6cb0ff; --green: #58c97b; --orange: #ffa84d; --purple: #c198ff; --grey: #78818d; } } \
    text { font: 11px sans-serif; fill: var(--soft); } .head { font-weight: bold; fill: var(--ink); font-size: 12px; } \
    .mid { text-anchor: middle; } .end { text-anchor: end; } .axis { fill: var(--ink); } .small { font-size: 10px; } \
    .grid { stroke: var(--grid); fill: none; } .frame { stroke: var(--rule); fill: none; } .paper { fill: var(--paper); } \
    .mark { stroke: var(--grey); stroke-dasharray: 2 3; opacity: .7; fill: none; } \
    .line { fill: none; stroke: currentColor; stroke-width: 1.5; stroke-linejoin: round; stroke-linecap: round; } \
    .line.dashed { stroke-dasharray: 6 4; stroke-linecap: butt; } .c-ink { color: var(--ink); } .c-red { color: var(--red); } \
    .c-blue { color: var(--blue); } .c-green { color: var(--green); } .c-orange { color: var(--orange); } \
    .c-purple { color: var(--purple); } .c-grey { color: var(--grey); }";

/// Plots in rows of `columns`, with lines of text below: an SVG document that follows the light or dark mode of the page.
pub fn svg_file(plots: &[LinePlot], columns: usize, caption: &[String]) -> String {
    let columns = columns.max(1);
    let [panel_width, panel_height] = LinePlot::group_size(PlotWidth::PANEL);
    let rows = plots.len().div_ceil(columns);
    let width = columns as f64 * (panel_width + GAP) + GAP;
    let below = rows as f64 * (panel_height + GAP) + GAP;
    let height = below + CAPTION * caption.len() as f64 + GAP;
    let place = |index: usize| {
        let (column, row) = ((index % columns) as f64, (index / columns) as f64);
        [GAP + column * (panel_width + GAP), GAP + row * (panel_height + GAP)]
    };
    let panels: String =
        plots.iter().enumerate().map(|(index, plot)| plot.to_group(PlotWidth::PANEL, place(index))).collect();
    let line = |(index, text): (usize, &String)| {
        format!("<text x=\"{GAP}\" y=\"{}\">{}</text>\n", below + CAPTION * (index as f64 + 0.8), escape(text))
    };
    let caption: String = caption.iter().enumerate().map(line).collect();
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\">\n\
         <style>{STYLE}</style>\n<rect class=\"paper\" width=\"{width}\" height=\"{height}\"/>\n{panels}{caption}</svg>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::super::{Series, SeriesColor};
    use super::*;

    #[test]
    fn panels_stand_in_rows_and_the_caption_below() {
        let plot = |name: &str| {
            let series = Series::line("a < b", SeriesColor::Red, vec![[0.0, 1.0], [2.0, 3.0]]);
            LinePlot::new(name, ("time", "s"), ("way", "mm")).series(series.clone()).series(series.dashed())
        };
        let svg = svg_file(&[plot("one"), plot("two & a half"), plot("three")], 2, &["what it is".to_owned()]);
        assert!(svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\"") && svg.trim_end().ends_with("</svg>"));
        assert_eq!(svg.matches("class=\"head\"").count(), 3);
        // Plot area 470 with margins of 62 and 14, gap 10; title 34, margins 24 and 40 around 190.
        assert!(
            svg.contains("translate(10 10)") && svg.contains("translate(566 10)") && svg.contains("translate(10 308)"),
            "{svg}"
        );
        assert!(svg.contains("two &amp; a half") && svg.contains("a &lt; b") && svg.contains("what it is"));
        assert_eq!(svg.matches("<g ").count(), svg.matches("</g>").count());
        assert_eq!(svg.matches("<svg ").count(), 1 + 3, "one for each plot area");
    }
}
