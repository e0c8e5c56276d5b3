//! The figure: time of the cold start by size of the region, with its stages.

use std::fmt::Write as _;

use super::cold::SizeRow;
use super::stages::Stage;

const LEFT: f64 = 120.0;
const WIDTH: f64 = 460.0;
const RIGHT: f64 = 90.0;
const TOP: f64 = 52.0;
const BAR: f64 = 13.0;
const STEP: f64 = 46.0;

const STYLE: &str = "text { font: 12px sans-serif; fill: #1c1f24; } .soft { fill: #5b6470; } .paper { fill: #ffffff; } \
    .whole { fill: #1c1f24; } .s0 { fill: #a3abb6; } .s1 { fill: #0b62c4; } .s2 { fill: #c4640b; } .s3 { fill: #2e8540; } \
    @media (prefers-color-scheme: dark) { text { fill: #e8eaed; } .soft { fill: #a3abb6; } .paper { fill: #15181d; } \
    .whole { fill: #e8eaed; } .s0 { fill: #68707c; } .s1 { fill: #6cb0ff; } .s2 { fill: #ffab66; } .s3 { fill: #7fd494; } }";

/// Stages that do not contain each other.
const DRAWN: [Stage; 4] = [Stage::Windows, Stage::Search, Stage::Patches, Stage::Refinement];

/// For each size the median of the whole, with a mark at the 99th percentile, and below it the stages in sequence.
pub fn svg(sizes: &[SizeRow]) -> String {
    let longest =
        sizes.iter().flat_map(|row| [row.whole.p99_ms, stages(row).map(|(_, ms)| ms).sum()]).fold(0.0, f64::max);
    let scale = WIDTH / if longest > 0.0 { longest } else { 1.0 };
    let mut body = legend();
    for (row, i) in sizes.iter().zip(0_u32..) {
        size(&mut body, row, TOP + STEP * f64::from(i), scale);
    }
    let (width, height) = (LEFT + WIDTH + RIGHT, TOP + STEP * sizes.len() as f64);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
         aria-label=\"Time of a cold start by size of the region\"><style>{STYLE}</style>\
         <rect class=\"paper\" width=\"{width}\" height=\"{height}\"/>{body}</svg>\n"
    )
}

fn stages(row: &SizeRow) -> impl Iterator<Item = (usize, f64)> + '_ {
    let ms = |stage: Stage| row.stages.iter().find(|(other, _)| *other == stage).map(|(_, times)| times.median_ms);
    DRAWN.into_iter().enumerate().filter_map(move |(i, stage)| Some((i, ms(stage)?)))
}

fn legend() -> String {
    let mut text = String::from("<text x=\"8\" y=\"18\">median of the whole, mark at the 99th percentile, ms</text>");
    let mut x = 8.0;
    for (i, stage) in DRAWN.iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "<rect class=\"s{i}\" x=\"{x}\" y=\"28\" width=\"11\" height=\"11\"/><text x=\"{}\" y=\"38\">{}</text>",
            x + 16.0,
            stage.name()
        );
        x += 40.0 + 6.5 * stage.name().len() as f64;
    }
    text
}

fn size(body: &mut String, row: &SizeRow, y: f64, scale: f64) {
    let (median, p99) = (row.whole.median_ms * scale, LEFT + row.whole.p99_ms * scale);
    // Writing to a string cannot fail.
    let _ = write!(
        body,
        "<text x=\"8\" y=\"{0}\">{1} x {1} px</text><rect class=\"whole\" x=\"{LEFT}\" y=\"{y}\" width=\"{median:.1}\" height=\"{BAR}\"/>\
         <rect class=\"whole\" x=\"{p99:.1}\" y=\"{y}\" width=\"2\" height=\"{BAR}\"/><text x=\"{2:.1}\" y=\"{0}\">{3:.2}</text>",
        y + 11.0,
        row.side_px,
        p99 + 8.0,
        row.whole.median_ms
    );
    let mut x = LEFT;
    for (i, ms) in stages(row) {
        let length = ms * scale;
        let _ = write!(
            body,
            "<rect class=\"s{i}\" x=\"{x:.1}\" y=\"{}\" width=\"{length:.1}\" height=\"{BAR}\"/>",
            y + BAR + 2.0
        );
        x += length;
    }
}

#[cfg(test)]
mod tests {
    use super::super::times::Times;
    use super::*;

    #[test]
    fn bars_are_as_long_as_the_times_say() {
        let times = |ms: f64| Times::of(&[ms]).expect("not empty");
        let stages = vec![(Stage::Windows, times(0.25)), (Stage::Costs, times(9.0)), (Stage::Search, times(0.5))];
        let text = svg(&[SizeRow { side_px: 60, status: "ok", whole: times(1.0), stages }]);
        // One millisecond is the whole width; the costs are part of the search and are not drawn.
        for (class, length) in [("whole", "460.0"), ("s0", "115.0"), ("s1", "230.0")] {
            assert!(text.contains(&format!("<rect class=\"{class}\" x=")), "{class}");
            assert!(text.contains(&format!("width=\"{length}\"")), "{length}: {text}");
        }
        assert!(text.contains("60 x 60 px") && !text.contains("4140"));
    }
}
