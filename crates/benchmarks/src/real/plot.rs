//! The figure: pass rate per group and method.

use std::fmt::Write as _;

use super::score::{Entry, Maker};
use super::table::{Row, groups};

/// Number of other tools in the figure: the best over all planar cases.
const PEERS_DRAWN: usize = 4;
const BAR: f64 = 13.0;
const GAP: f64 = 16.0;
const LEFT: f64 = 190.0;
const WIDTH: f64 = 420.0;
const TOP: f64 = 30.0;
const RIGHT: f64 = 60.0;

const STYLE: &str = "text { font: 12px sans-serif; fill: #1c1f24; } .head { font-weight: bold; } .soft { fill: #5b6470; } .grid { stroke: #d9dde3; } \
    .ours { fill: #0b62c4; } .peer { fill: #a3abb6; } .paper { fill: #ffffff; } \
    @media (prefers-color-scheme: dark) { text { fill: #e8eaed; } .soft { fill: #a3abb6; } .grid { stroke: #39404a; } \
    .ours { fill: #6cb0ff; } .peer { fill: #68707c; } .paper { fill: #15181d; } }";

/// Bars of the share of passed cases, ours above the best of the other tools, for each group of planar cases.
pub fn svg(entries: &[Entry]) -> String {
    let groups: Vec<_> = groups(entries).into_iter().filter(|(name, _)| *name != "non-planar").collect();
    let drawn = drawn_methods(groups.iter().find(|(name, _)| *name == "all planar").map_or(&[], |(_, rows)| rows));
    let mut body = String::new();
    let mut y = TOP;
    for (name, rows) in &groups {
        let cases = rows.iter().map(|row| row.cases).max().unwrap_or(0);
        // Writing to a String does not fail.
        let _ = write!(body, "<text x=\"8\" y=\"{:.0}\" class=\"head\">{name}, {cases}</text>", y + 11.0);
        y += 18.0;
        for row in rows.iter().filter(|row| drawn.contains(&row.method)) {
            bar(&mut body, row, y);
            y += BAR + 3.0;
        }
        y += GAP;
    }
    let (width, height) = (LEFT + WIDTH + RIGHT, y + 6.0);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
         aria-label=\"Share of passed cases by group and method\"><style>{STYLE}</style>\
         <rect class=\"paper\" width=\"{width}\" height=\"{height}\"/>{}{body}</svg>\n",
        grid(height)
    )
}

/// Our methods and the best of the others by their share of passed planar cases.
fn drawn_methods(rows: &[Row]) -> Vec<String> {
    let mut peers: Vec<_> = rows.iter().filter(|row| row.maker == Maker::Peer).collect();
    peers.sort_by(|a, b| b.pass_percent().total_cmp(&a.pass_percent()));
    let ours = rows.iter().filter(|row| row.maker == Maker::Ours);
    ours.chain(peers.into_iter().take(PEERS_DRAWN)).map(|row| row.method.clone()).collect()
}

fn grid(height: f64) -> String {
    let line = |percent: u32| {
        let x = LEFT + WIDTH * f64::from(percent) / 100.0;
        format!(
            "<path class=\"grid\" d=\"M{x} {TOP}V{}\"/><text class=\"soft\" x=\"{x}\" y=\"18\" text-anchor=\"middle\">{percent} %</text>",
            height - 6.0
        )
    };
    [0, 25, 50, 75, 100].map(line).concat()
}

fn bar(body: &mut String, row: &Row, y: f64) {
    let class = if row.maker == Maker::Ours { "ours" } else { "peer" };
    let (length, base) = (WIDTH * row.pass_percent() / 100.0, y + BAR - 2.0);
    let name = row.method.replace('&', "&amp;").replace('<', "&lt;");
    let _ = write!(body, "<text class=\"soft\" x=\"{}\" y=\"{base}\" text-anchor=\"end\">{name}</text>", LEFT - 6.0);
    let _ = write!(body, "<rect class=\"{class}\" x=\"{LEFT}\" y=\"{y}\" width=\"{length:.1}\" height=\"{BAR}\"/>");
    let _ = write!(body, "<text x=\"{:.1}\" y=\"{base}\">{:.0}</text>", LEFT + length + 4.0, row.pass_percent());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::score::tests::{answer, case, entry};
    use pb3dp_record::metrics::Group;

    #[test]
    fn bars_are_as_long_as_the_share_and_weak_tools_are_left_out() {
        let cases = ["a", "b"].map(|name| case(name, Group::Small, (1.0, 0.1)));
        let mut entries = vec![entry(&cases[0], "direct", Some(answer(0.0, 0.0))), entry(&cases[1], "direct", None)];
        for (index, tool) in ["t<0>", "t1", "t2", "t3", "weak"].iter().enumerate() {
            let good = (index < 4).then(|| answer(0.0, 0.0));
            entries.push(Entry { maker: Maker::Peer, status: None, ..entry(&cases[0], tool, good) });
        }
        let svg = svg(&entries);
        // Half of 420.
        assert!(svg.contains("class=\"ours\" x=\"190\" y=\"48\" width=\"210.0\""), "{svg}");
        assert!(svg.contains(">t&lt;0><") && svg.contains(">t3<") && !svg.contains("weak"), "{svg}");
        assert_eq!(svg.matches("class=\"peer\"").count(), 8, "four tools in two groups");
    }
}
