//! A comparison as a page with plots over time.

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::Frame;
use pb3dp_record::report::{LinePlot, Report, Series, SeriesColor, Table, Tone};

use super::Comparison;
use super::control::{ARMS, StateChange, commanded};
use super::estimates::{EstimatePair, Offset};
use super::recorded::{Estimate, Recorded, Step};
use super::text::{
    StatisticsRow, arm_cells, cells, change_text, closer, estimate_rows, filter_rows, matched_text, one_only_text,
    truth_rows, verdict,
};

/// Colours and names of A and B.
const RUNS: [(&str, SeriesColor); 2] = [("A", SeriesColor::Blue), ("B", SeriesColor::Red)];

/// Points of a line: time since the begin, seconds, and the value.
type Points = Vec<[f64; 2]>;
/// Positions over time: seconds, and x, y, z in millimetres where there is a pose.
type Positions = Vec<(f64, Option<[f64; 3]>)>;

/// The page.
pub fn page(comparison: &Comparison) -> Report {
    let tone = if comparison.is_equal() { Tone::Good } else { Tone::Fair };
    let report = Report::new("Comparison of two recorded runs").verdict(tone, &verdict(comparison), &[]);
    let report = estimates(settings(report, comparison), comparison);
    let report = truth(report, comparison);
    decisions(commands(filter(report, comparison), comparison), comparison)
}

fn settings(report: Report, comparison: &Comparison) -> Report {
    let [a, b] = &comparison.runs;
    let runs = Table::new(["", "A", "B"])
        .row(["recording".to_owned(), a.file.display().to_string(), b.file.display().to_string()])
        .row(["version", &a.version, &b.version])
        .row(["pairs".to_owned(), a.estimates.len().to_string(), b.estimates.len().to_string()])
        .row(["control steps".to_owned(), a.steps.len().to_string(), b.steps.len().to_string()]);
    let report = report.table(&runs).heading("Settings that differ");
    if comparison.settings.is_empty() {
        return report.paragraph("All settings are the same.");
    }
    let rows = comparison.settings.iter().fold(Table::new(["key", "A", "B"]), |table, setting| {
        let [in_a, in_b] = setting.values.each_ref().map(|value| value.clone().unwrap_or("(not stated)".to_owned()));
        table.row([setting.key.clone(), in_a, in_b])
    });
    report.table(&rows)
}

fn estimates(report: Report, comparison: &Comparison) -> Report {
    let found = &comparison.estimates;
    let report = report
        .heading("Estimates: pose of the target in the left camera")
        .paragraph(&(matched_text(&found.matched, "pair") + &one_only_text(found.pose_in_one_only) + "."))
        .paragraph(&format!("{} of {} pairs have the same status.", found.same_status, found.pairs.len()))
        .table(&statistics(&estimate_rows(comparison)))
        .paragraph(
            "Each method places its model frame on the target. Offsets since the first estimate compare the motions of the target, which do \
             not depend on this frame.",
        );
    let pose = |estimate: &Estimate| (estimate.stamp.t_s(), estimate.cam_left_from_model.map(millimetres));
    let positions = [0, 1].map(|run| comparison.runs[run].estimates.iter().map(pose).collect::<Positions>());
    let latency = |run: &Recorded| -> Points {
        run.estimates.iter().map(|estimate| [estimate.stamp.t_s(), estimate.result.latency_millis]).collect()
    };
    let of_pairs = |pick: fn(&EstimatePair) -> Option<Offset>| -> Vec<(f64, Option<Offset>)> {
        let t_s = |pair: &EstimatePair| comparison.runs[0].estimates[pair.at[0]].stamp.t_s();
        found.pairs.iter().map(|pair| (t_s(pair), pick(pair))).collect()
    };
    let mut plots = position_plots(&positions);
    plots.extend(offset_plots(&[
        ("poses", of_pairs(|pair| pair.offset)),
        ("since the first", of_pairs(|pair| pair.moved)),
    ]));
    plots.push(both("latency", ("wall time", "ms"), comparison.runs.each_ref().map(latency)));
    report.panels(&plots)
}

fn truth(report: Report, comparison: &Comparison) -> Report {
    let rows = truth_rows(comparison);
    if rows.is_empty() {
        return report;
    }
    let report = report
        .heading("Errors against the truth")
        .paragraph("Motion of the target since the first common estimate, against its true motion.")
        .table(&statistics(&rows));
    let report = closer(comparison).into_iter().fold(report, |report, closer| report.paragraph(&(closer + ".")));
    let points = |pick: fn(&Offset) -> f64| {
        [0, 1].map(|run| -> Points {
            let estimates = &comparison.runs[run].estimates;
            let point = |pair: &EstimatePair| {
                [estimates[pair.at[run]].stamp.t_s(), pair.errors[run].as_ref().map_or(f64::NAN, pick)]
            };
            comparison.estimates.pairs.iter().map(point).collect()
        })
    };
    report.panels(&[
        both("position error", ("error", "mm"), points(|offset| offset.distance_mm)),
        both("orientation error", ("error", "deg"), points(|offset| offset.angle_deg)),
    ])
}

fn filter(report: Report, comparison: &Comparison) -> Report {
    let found = &comparison.filter;
    let report = report
        .heading("Filter: pose of the target in the base")
        .paragraph(&(matched_text(&found.matched, "step") + &one_only_text(found.pose_in_one_only) + "."))
        .table(&statistics(&filter_rows(comparison)));
    let pose = |step: &Step| (step.stamp.t_s(), step.base_from_model.map(millimetres));
    let positions = [0, 1].map(|run| comparison.runs[run].steps.iter().map(pose).collect::<Positions>());
    let t_s = |in_a: usize| comparison.runs[0].steps[in_a].stamp.t_s();
    let offsets = found.offsets.iter().map(|([in_a, _], offset)| (t_s(*in_a), *offset)).collect();
    let mut plots = position_plots(&positions);
    plots.extend(offset_plots(&[("poses", offsets)]));
    report.panels(&plots)
}

fn commands(report: Report, comparison: &Comparison) -> Report {
    let headings = ["arm", "rms of the difference, rad/s", "maximum, rad/s", "first difference, s"];
    let rows = (0..2).fold(Table::new(headings), |table, arm| {
        let [rms, max, first] = arm_cells(comparison, arm);
        table.row([ARMS[arm].to_owned(), rms, max, first])
    });
    let report = report
        .heading("Commanded joint velocities")
        .paragraph(&(matched_text(&comparison.commands.matched, "step") + "."))
        .table(&rows);
    let plots = [0_u8, 1].map(|arm| {
        let norm = |step: &Step| norm_of(commanded(step, arm));
        let points = comparison
            .runs
            .each_ref()
            .map(|run| run.steps.iter().map(|s| [s.stamp.t_s(), norm(s)]).collect::<Points>());
        let steps = comparison.runs.each_ref().map(|run| &run.steps);
        let difference = |&[in_a, in_b]: &[usize; 2]| {
            let [a, b] = [commanded(&steps[0][in_a], arm), commanded(&steps[1][in_b], arm)];
            let joints = a.zip(b).map(|(a, b)| std::array::from_fn(|joint| b[joint] - a[joint]));
            [steps[0][in_a].stamp.t_s(), norm_of(joints)]
        };
        let differences: Points = comparison.commands.matched.matching.partners.iter().map(difference).collect();
        let y = ("norm of the velocities", "rad/s");
        // Below the others.
        let plot = LinePlot::new(ARMS[usize::from(arm)], ("time", "s"), y);
        lines(points).fold(plot.series(Series::line("difference", SeriesColor::Grey, differences)), LinePlot::series)
    });
    report.panels(&plots)
}

fn decisions(report: Report, comparison: &Comparison) -> Report {
    let found = &comparison.decisions;
    let seconds =
        found.seconds.iter().fold(Table::new(["time in each state, s", "A", "B"]), |table, (state, [a, b])| {
            table.row([state.to_string(), format!("{a:.3}"), format!("{b:.3}")])
        });
    let changes = found
        .changes
        .iter()
        .fold(Table::new(["A", "B"]), |table, [a, b]| table.row([change_text(a.as_ref()), change_text(b.as_ref())]));
    let reasons = found.changes.iter().fold(Table::new(["change", "reason in A", "reason in B"]), |table, [a, b]| {
        let why = |change: &Option<StateChange>| change.as_ref().map_or(String::new(), |change| change.why.to_string());
        table.row([change_text(a.as_ref().or(b.as_ref())), why(a), why(b)])
    });
    let states: Vec<&str> = found.seconds.keys().map(AsRef::as_ref).collect();
    let number = |step: &Step| states.iter().position(|state| *state == &*step.state).map_or(f64::NAN, |k| k as f64);
    let strip = comparison.runs.each_ref().map(|run| run.steps.iter().map(|s| [s.stamp.t_s(), number(s)]).collect());
    let names: Vec<String> = states.iter().enumerate().map(|(number, state)| format!("{number} {state}")).collect();
    let title = format!("state of the supervisor: {}", names.join(", "));
    let plot = LinePlot::new(title, ("time", "s"), ("state", ""));
    report
        .heading("Decisions of the supervisor")
        .paragraph(&(matched_text(&found.matched, "step") + "."))
        .table(&seconds)
        .plot(&lines(strip).map(Series::held).fold(plot, LinePlot::series))
        .table(&changes)
        .folded("Reasons of these changes", &reasons)
}

fn statistics(rows: &[StatisticsRow]) -> Table {
    rows.iter().fold(Table::new(["", "median", "95th percentile", "maximum"]), |table, (name, statistics)| {
        let [median, p95, max] = cells(*statistics);
        table.row([(*name).to_owned(), median, p95, max])
    })
}

/// A plot with a line of each run.
fn both(title: &str, y: (&str, &str), points: [Points; 2]) -> LinePlot {
    lines(points).fold(LinePlot::new(title, ("time", "s"), y), LinePlot::series)
}

fn lines(points: [Points; 2]) -> impl Iterator<Item = Series> {
    RUNS.into_iter().zip(points).enumerate().map(|(run, ((name, color), points))| {
        let line = Series::line(name, color, points);
        // Dashed, so that A is visible below B where both are the same.
        if run == 1 { line.dashed() } else { line }
    })
}

fn position_plots(positions: &[Positions; 2]) -> Vec<LinePlot> {
    let plot = |(axis, name): (usize, &str)| {
        let of_run = |run: &Positions| -> Points {
            run.iter().map(|(t_s, xyz)| [*t_s, xyz.map_or(f64::NAN, |xyz| xyz[axis])]).collect()
        };
        both(name, ("position", "mm"), positions.each_ref().map(of_run))
    };
    ["x", "y", "z"].into_iter().enumerate().map(plot).collect()
}

/// Named offsets over time.
type NamedOffsets = (&'static str, Vec<(f64, Option<Offset>)>);

fn offset_plots(lines: &[NamedOffsets]) -> [LinePlot; 2] {
    let plot = |title: &str, y: (&str, &str), pick: fn(&Offset) -> f64| {
        let colors = [SeriesColor::Purple, SeriesColor::Green].into_iter();
        lines.iter().zip(colors).fold(LinePlot::new(title, ("time", "s"), y), |plot, ((name, offsets), color)| {
            let point = |(t_s, offset): &(f64, Option<Offset>)| [*t_s, offset.as_ref().map_or(f64::NAN, pick)];
            plot.series(Series::line(*name, color, offsets.iter().map(point).collect()))
        })
    };
    [
        plot("distance between A and B", ("distance", "mm"), |offset| offset.distance_mm),
        plot("angle between A and B", ("angle", "deg"), |offset| offset.angle_deg),
    ]
}

fn millimetres<A: Frame, B: Frame>(pose: Pose<A, B>) -> [f64; 3] {
    (pose.translation_m() * 1e3).into()
}

fn norm_of(joints: Option<[f64; 7]>) -> f64 {
    joints.map_or(f64::NAN, |joints| joints.iter().map(|joint| joint * joint).sum::<f64>().sqrt())
}
