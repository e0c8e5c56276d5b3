//! A comparison as text.

use std::fmt::Write as _;

use pb3dp_record::metrics::Statistics;

use super::Comparison;
use super::control::{ARMS, BEYOND_RAD_PER_S, StateChange};
use super::estimates::{Matched, OffsetStatistics};

/// Changes of state that are printed; the page has all.
const CHANGES_MAX: usize = 40;
/// Settings that are printed; the page has all.
const SETTINGS_MAX: usize = 60;

/// All differences.
pub fn text(comparison: &Comparison) -> String {
    let Comparison { runs: [a, b], .. } = comparison;
    let mut text = format!("A  {}\nB  {}\n", a.file.display(), b.file.display());
    text += &settings_text(comparison);
    text += &estimates_text(comparison);
    text += &truth_text(comparison);
    text += &filter_text(comparison);
    text += &commands_text(comparison);
    text += &decisions_text(comparison);
    text + &verdict(comparison)
}

/// The result in one line.
pub fn verdict(comparison: &Comparison) -> String {
    let has_same_settings = comparison.settings.is_empty();
    match (comparison.is_equal(), has_same_settings) {
        (true, true) => "equal to the bit".to_owned(),
        (true, false) => "equal to the bit, with other settings".to_owned(),
        (false, _) => "the runs differ".to_owned(),
    }
}

/// A value with four significant digits; very small and very large ones with two, as a power of ten.
pub fn figure(value: f64) -> String {
    let magnitude = value.abs();
    match magnitude {
        0.0 => "0".to_owned(),
        _ if !(1e-3..1e6).contains(&magnitude) => format!("{value:.1e}"),
        _ => {
            let digits = (3.0 - magnitude.log10().floor()).max(0.0) as usize;
            format!("{value:.digits$}")
        }
    }
}

/// Name of a quantity with its unit, and its median, 95th percentile and maximum.
pub type StatisticsRow = (&'static str, Option<Statistics>);

/// The rows of the estimates.
pub fn estimate_rows(comparison: &Comparison) -> Vec<StatisticsRow> {
    let estimates = &comparison.estimates;
    vec![
        ("distance, mm", estimates.offset.distance_mm),
        ("angle, deg", estimates.offset.angle_deg),
        ("distance since the first estimate, mm", estimates.moved.distance_mm),
        ("angle since the first estimate, deg", estimates.moved.angle_deg),
        ("latency of A, ms", estimates.latency_ms[0]),
        ("latency of B, ms", estimates.latency_ms[1]),
        ("latency, difference, ms", estimates.latency_ms[2]),
    ]
}

/// The rows of the errors against the truth; none without truth.
pub fn truth_rows(comparison: &Comparison) -> Vec<StatisticsRow> {
    let [a, b] = &comparison.estimates.errors;
    let rows = vec![
        ("position error of A, mm", a.distance_mm),
        ("position error of B, mm", b.distance_mm),
        ("orientation error of A, deg", a.angle_deg),
        ("orientation error of B, deg", b.angle_deg),
    ];
    if rows.iter().all(|(_, statistics)| statistics.is_none()) { Vec::new() } else { rows }
}

/// The rows of the filter.
pub fn filter_rows(comparison: &Comparison) -> Vec<StatisticsRow> {
    let OffsetStatistics { distance_mm, angle_deg } = comparison.filter.offset;
    vec![("distance, mm", distance_mm), ("angle, deg", angle_deg)]
}

/// Cells of median, 95th percentile and maximum.
pub fn cells(statistics: Option<Statistics>) -> [String; 3] {
    let cell = |value: fn(&Statistics) -> f64| statistics.as_ref().map_or("-".to_owned(), |all| figure(value(all)));
    [cell(|all| all.median), cell(|all| all.p95), cell(|all| all.max)]
}

/// Which estimate is closer to the truth, by the medians; none if they are the same or unknown.
pub fn closer(comparison: &Comparison) -> Option<String> {
    let [a, b] = &comparison.estimates.errors;
    let by = |one: Option<Statistics>, other: Option<Statistics>| {
        let (one, other) = (one?.median, other?.median);
        Some(if one == other {
            "both alike"
        } else if one < other {
            "A"
        } else {
            "B"
        })
    };
    let position = by(a.distance_mm, b.distance_mm)?;
    let orientation = by(a.angle_deg, b.angle_deg)?;
    Some(format!("smaller median error: position {position}, orientation {orientation}"))
}

/// How entries match, and which differ first.
pub fn matched_text(matched: &Matched, entry: &str) -> String {
    let partners = matched.matching.partners.len();
    let [a, b] = matched.matching.alone;
    let by = if matched.matching.by_number { "number" } else { "time" };
    let mut text = format!("{partners} {entry}s matched by {by}, {} differ", matched.differing);
    if a + b > 0 {
        let _ = write!(text, "; without a partner: {a} of A, {b} of B");
    }
    if let Some(([in_a, in_b], t_s)) = matched.first {
        let number = if in_a == in_b { format!("{entry} {in_a}") } else { format!("{entry} {in_a} of A, {in_b} of B") };
        let _ = write!(text, "; the first at {t_s:.3} s ({number})");
    }
    text
}

/// Poses that only one run has.
pub fn one_only_text([a, b]: [usize; 2]) -> String {
    if a + b == 0 { String::new() } else { format!("; with a pose in A only: {a}, in B only: {b}") }
}

/// A change of state with its time.
pub fn change_text(change: Option<&StateChange>) -> String {
    let Some(StateChange { t_s, from, to, .. }) = change else { return "-".to_owned() };
    if from.is_empty() { format!("{t_s:.3} s begins {to}") } else { format!("{t_s:.3} s {from} -> {to}") }
}

fn section(name: &str, line: &str) -> String {
    format!("{name:<11}{line}\n")
}

fn rows_text(rows: &[StatisticsRow]) -> String {
    let line = |name: &str, [median, p95, max]: [&str; 3]| format!("    {name:<40}{median:>10}{p95:>10}{max:>10}\n");
    let mut text = line("", ["median", "p95", "max"]);
    for (name, statistics) in rows {
        let cells = cells(*statistics);
        text += &line(name, cells.each_ref().map(String::as_str));
    }
    text
}

fn settings_text(comparison: &Comparison) -> String {
    let Comparison { runs: [a, b], settings, .. } = comparison;
    let mut text = match a.version == b.version {
        true => section("version", &a.version),
        false => section("version", &format!("differs\n    A  {}\n    B  {}", a.version, b.version)),
    };
    let all = a.settings.count().max(b.settings.count());
    text += &section("settings", &format!("{} of {all} differ", settings.len()));
    for setting in settings.iter().take(SETTINGS_MAX) {
        let [in_a, in_b] = setting.values.each_ref().map(|value| value.as_deref().unwrap_or("(not stated)"));
        let _ = write!(text, "    {}\n        A  {in_a}\n        B  {in_b}\n", setting.key);
    }
    if settings.len() > SETTINGS_MAX {
        let _ = writeln!(text, "    and {} more; --out writes all", settings.len() - SETTINGS_MAX);
    }
    text
}

fn estimates_text(comparison: &Comparison) -> String {
    let estimates = &comparison.estimates;
    let only = one_only_text(estimates.pose_in_one_only);
    let mut text = section("estimates", &(matched_text(&estimates.matched, "pair") + &only));
    let partners = estimates.pairs.len();
    if partners > 0 {
        let percent = 100.0 * estimates.same_status as f64 / partners as f64;
        let _ = writeln!(text, "    same status: {} of {partners} pairs, {percent:.1} %", estimates.same_status);
        text += &rows_text(&estimate_rows(comparison));
    }
    text
}

fn truth_text(comparison: &Comparison) -> String {
    let rows = truth_rows(comparison);
    if rows.is_empty() {
        return section("truth", "not recorded");
    }
    let mut text = section("truth", "motion since the first common estimate against the true motion");
    text += &rows_text(&rows);
    closer(comparison).iter().for_each(|closer| {
        let _ = writeln!(text, "    {closer}");
    });
    text
}

fn filter_text(comparison: &Comparison) -> String {
    let filter = &comparison.filter;
    let only = one_only_text(filter.pose_in_one_only);
    section("filter", &(matched_text(&filter.matched, "step") + &only)) + &rows_text(&filter_rows(comparison))
}

/// Cells of an arm: rms and maximum of the difference, rad/s; time of the first difference, s.
pub fn arm_cells(comparison: &Comparison, arm: usize) -> [String; 3] {
    let found = &comparison.commands.arms[arm];
    let or_none = |value: Option<f64>| value.map_or("-".to_owned(), figure);
    let first = found.first_beyond_s.map_or("never".to_owned(), |t_s| format!("{t_s:.3}"));
    [or_none(found.rms_rad_per_s), or_none(found.max_rad_per_s), first]
}

fn commands_text(comparison: &Comparison) -> String {
    let mut text = section("commands", &matched_text(&comparison.commands.matched, "step"));
    let _ = writeln!(text, "    {:<40}{:>10}{:>10}", "velocity difference, rad/s", "rms", "max");
    for (arm, name) in ARMS.iter().enumerate() {
        let [rms, max, first] = arm_cells(comparison, arm);
        let first = if first == "never" { first } else { format!("from {first} s on") };
        let _ = writeln!(text, "    {name:<40}{rms:>10}{max:>10}   beyond {BEYOND_RAD_PER_S:.0e}: {first}");
    }
    text
}

fn decisions_text(comparison: &Comparison) -> String {
    let decisions = &comparison.decisions;
    let mut text = section("decisions", &matched_text(&decisions.matched, "step"));
    let _ = writeln!(text, "    {:<40}B", "A");
    for [a, b] in decisions.changes.iter().take(CHANGES_MAX) {
        let _ = writeln!(text, "    {:<40}{}", change_text(a.as_ref()), change_text(b.as_ref()));
    }
    if decisions.changes.len() > CHANGES_MAX {
        let _ = writeln!(text, "    and {} more; --out writes all", decisions.changes.len() - CHANGES_MAX);
    }
    let _ = writeln!(text, "    {:<40}{:>10}{:>10}", "time in each state, s", "A", "B");
    for (state, [a, b]) in &decisions.seconds {
        let _ = writeln!(text, "    {state:<40}{a:>10.3}{b:>10.3}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_four_significant_digits() {
        let check = |value: f64, expected: &str| assert_eq!(figure(value), expected);
        check(0.0, "0");
        check(0.005_912_34, "0.005912");
        check(-1.5, "-1.500");
        check(123_456.7, "123457");
        check(2.34e-9, "2.3e-9");
        check(1.5e7, "1.5e7");
    }
}
