//! Summary of a method over the groups of cases.

use std::collections::BTreeMap;

use super::plane::{EvaluatedCase, Group};
use super::{median, percentile};

/// One row of the summary. Errors are over the answered cases, times over all cases.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupSummary {
    /// Name of the row: a group's, or `textured+boards`.
    pub name: &'static str,
    /// Number of cases.
    pub cases: usize,
    /// Cases with a pose that may be used.
    pub answered: usize,
    /// Number of the other cases by status.
    pub unanswered: BTreeMap<&'static str, usize>,
    /// Median of the absolute depth error, percent.
    pub z_median_percent: Option<f64>,
    /// 90th percentile of the same.
    pub z_p90_percent: Option<f64>,
    /// Median of the absolute depth error, millimetres.
    pub z_median_mm: Option<f64>,
    /// Median of the absolute disparity error, pixels.
    pub disparity_median_px: Option<f64>,
    /// Median angle between the normals, degrees; `None` for regions that are not planar.
    pub normal_median_deg: Option<f64>,
    /// 90th percentile of the same.
    pub normal_p90_deg: Option<f64>,
    /// Share of all cases with depth within 1 % and normal within 5 degrees, percent; `None` for regions that are not planar.
    pub good_percent: Option<f64>,
    /// Median CPU time, milliseconds.
    pub median_millis: Option<f64>,
    /// 90th percentile of the same.
    pub p90_millis: Option<f64>,
    /// Non-planar groups: median over the cases of the median absolute difference to the disparity map, pixels.
    pub map_median_px: Option<f64>,
    /// Non-planar groups: median over the cases of the share of pixels within 1 px of the disparity map, percent.
    pub map_within_1px_percent: Option<f64>,
}

/// One row per group that has cases, in the order of [`Group::ALL`], then `textured+boards`: all planar cases that are not
/// difficult, called textured in the tables of other methods.
pub fn summarize(cases: &[EvaluatedCase]) -> Vec<GroupSummary> {
    let of = |groups: &[Group]| cases.iter().filter(|c| groups.contains(&c.group)).collect::<Vec<_>>();
    let mut rows: Vec<_> = Group::ALL.iter().map(|group| row(group.name(), &of(&[*group]))).collect();
    let has = |group: Group| cases.iter().any(|case| case.group == group);
    if has(Group::Textured) && has(Group::Boards) {
        rows.push(row("textured+boards", &of(&[Group::Textured, Group::Boards])));
    }
    rows.retain(|row| row.cases > 0);
    rows
}

fn row(name: &'static str, cases: &[&EvaluatedCase]) -> GroupSummary {
    let errors: Vec<_> = cases.iter().filter_map(|case| case.error).collect();
    let z_percent: Vec<_> = errors.iter().map(|e| 100.0 * e.z_ratio.abs()).collect();
    let z_mm: Vec<_> = errors.iter().map(|e| 1e3 * e.z_m.abs()).collect();
    // A plane fitted to a non-planar region has no true normal.
    let planar = cases.iter().all(|case| case.group != Group::NonPlanar);
    let normal_deg: Vec<_> = errors.iter().filter(|_| planar).map(|e| e.normal_rad.to_degrees()).collect();
    let disparity_px: Vec<_> = errors.iter().filter_map(|e| e.disparity_px.map(f64::abs)).collect();
    let millis: Vec<_> = cases.iter().map(|case| case.cpu_millis).filter(|ms| ms.is_finite()).collect();
    let mut unanswered = BTreeMap::new();
    cases.iter().filter(|case| case.error.is_none()).for_each(|case| *unanswered.entry(case.status).or_default() += 1);
    let good = errors.iter().filter(|e| e.is_good()).count();
    let maps: Vec<_> = cases.iter().filter(|c| c.error.is_some()).filter_map(|c| c.disparity).collect();
    let map_px: Vec<_> = maps.iter().map(|m| m.median_abs_px).collect();
    let map_within: Vec<_> = maps.iter().map(|m| 100.0 * m.share_within_1px).collect();
    GroupSummary {
        name,
        cases: cases.len(),
        answered: errors.len(),
        unanswered,
        z_median_percent: median(&z_percent),
        z_p90_percent: percentile(&z_percent, 90.0),
        z_median_mm: median(&z_mm),
        disparity_median_px: median(&disparity_px),
        normal_median_deg: median(&normal_deg),
        normal_p90_deg: percentile(&normal_deg, 90.0),
        good_percent: (planar && !cases.is_empty()).then(|| 100.0 * good as f64 / cases.len() as f64),
        median_millis: median(&millis),
        p90_millis: percentile(&millis, 90.0),
        map_median_px: median(&map_px),
        map_within_1px_percent: median(&map_within),
    }
}

const HEADINGS: [&str; 12] = [
    "group",
    "cases",
    "answered",
    "med z %",
    "p90 z %",
    "med z mm",
    "med disp px",
    "med normal deg",
    "p90 normal deg",
    "z<1% & n<5deg",
    "ms median",
    "ms p90",
];

/// The rows as a plain-text table with aligned columns, for a terminal; `-` for missing figures. The statuses of unanswered cases follow.
pub fn text_table(rows: &[GroupSummary]) -> String {
    let mut lines = vec![HEADINGS.map(str::to_owned)];
    lines.extend(rows.iter().map(cells));
    let widths: Vec<usize> =
        (0..HEADINGS.len()).map(|i| lines.iter().map(|line| line[i].len()).max().unwrap_or(0)).collect();
    let mut text = String::new();
    for line in &lines {
        let padded = line.iter().zip(&widths).enumerate().map(|(i, (cell, width))| match i {
            0 => format!("{cell:<width$}"),
            _ => format!("{cell:>width$}"),
        });
        text.push_str(padded.collect::<Vec<_>>().join("  ").trim_end());
        text.push('\n');
    }
    for row in rows.iter().filter(|row| !row.unanswered.is_empty()) {
        let counts: Vec<String> = row.unanswered.iter().map(|(status, count)| format!("{count} {status}")).collect();
        text.push_str(&format!("{}: not answered: {}\n", row.name, counts.join(", ")));
    }
    for row in rows {
        if let (Some(px), Some(percent)) = (row.map_median_px, row.map_within_1px_percent) {
            text.push_str(&format!(
                "{}: plane against disparity map inside the region: median {px:.2} px, {percent:.0} % within 1 px\n",
                row.name
            ));
        }
    }
    text
}

fn cells(row: &GroupSummary) -> [String; 12] {
    let figure = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |x| format!("{x:.decimals$}"));
    [
        row.name.into(),
        row.cases.to_string(),
        row.answered.to_string(),
        figure(row.z_median_percent, 2),
        figure(row.z_p90_percent, 2),
        figure(row.z_median_mm, 1),
        figure(row.disparity_median_px, 2),
        figure(row.normal_median_deg, 2),
        figure(row.normal_p90_deg, 1),
        row.good_percent.map_or("-".into(), |percent| format!("{percent:.0}%")),
        figure(row.median_millis, 1),
        figure(row.p90_millis, 1),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::plane::PlaneError;
    use super::*;

    fn case(group: Group, z_percent: f64, normal_deg: f64, cpu_millis: f64) -> EvaluatedCase {
        let z_ratio = z_percent / 100.0;
        let normal_rad = normal_deg.to_radians();
        let error = PlaneError { z_m: 0.5 * z_ratio, z_ratio, normal_rad, disparity_px: Some(-10.0 * z_ratio) };
        EvaluatedCase { group, status: "ok", error: Some(error), disparity: None, cpu_millis }
    }

    fn lost(group: Group, cpu_millis: f64) -> EvaluatedCase {
        EvaluatedCase { group, status: "ambiguous", error: None, disparity: None, cpu_millis }
    }

    #[test]
    fn shares_count_all_cases_and_errors_only_answered_ones() {
        let cases = [
            case(Group::Textured, -0.5, 1.0, 2.0),
            case(Group::Textured, 0.7, 6.0, 4.0),
            case(Group::Textured, 1.5, 2.0, 6.0),
            lost(Group::Textured, 100.0),
            lost(Group::Small, 7.0),
        ];
        let rows = summarize(&cases);
        assert_eq!(rows.iter().map(|r| r.name).collect::<Vec<_>>(), ["textured", "small"]);
        let row = &rows[0];
        assert_eq!((row.cases, row.answered), (4, 3));
        assert_eq!(row.unanswered, BTreeMap::from([("ambiguous", 1)]));
        let close = |a: Option<f64>, b: f64| assert!((a.unwrap() - b).abs() < 1e-9, "{a:?} is not {b}");
        close(row.z_median_percent, 0.7);
        // numpy.percentile([0.5, 0.7, 1.5], 90) = 1.34
        close(row.z_p90_percent, 1.34);
        close(row.z_median_mm, 3.5);
        close(row.disparity_median_px, 0.07);
        close(row.normal_median_deg, 2.0);
        close(row.good_percent, 25.0);
        close(row.median_millis, 5.0);
        assert_eq!((rows[1].answered, rows[1].z_median_percent, rows[1].good_percent), (0, None, Some(0.0)));
    }

    #[test]
    fn regions_that_are_no_plane_are_judged_by_depth_alone() {
        let rows = summarize(&[case(Group::NonPlanar, 0.5, 40.0, 1.0)]);
        assert_eq!((rows[0].normal_median_deg, rows[0].normal_p90_deg, rows[0].good_percent), (None, None, None));
        assert!((rows[0].z_median_percent.unwrap() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn the_table_is_aligned_and_has_a_line_per_row() {
        let cases =
            [case(Group::Textured, 0.5, 1.0, 2.0), case(Group::Boards, 0.25, 1.0, 2.0), lost(Group::Small, 1.0)];
        let text = text_table(&summarize(&cases));
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines.len(), 6, "{text}");
        assert_eq!(lines[5], "small: not answered: 1 ambiguous");
        let end_of_cases = lines[0].find("cases").unwrap() + 5;
        assert!(lines[1..5].iter().all(|line| line.as_bytes()[end_of_cases - 1].is_ascii_digit()), "{text}");
        assert!(lines[2].starts_with("small") && lines[2].contains(" - "), "{text}");
        assert!(lines[4].starts_with("textured+boards      2         2     0.38"), "{text}");
    }
}
