//! Tables and figures of the page, from the results as JSON.

use nalgebra::UnitQuaternion;
use pb3dp_benchmarks::figure::{AxisKind, Line, Panel, panels};
use pb3dp_benchmarks::limit;
use pb3dp_benchmarks::page::Part;
use pb3dp_benchmarks::table::{Column, cell, markdown};
use pb3dp_cell::log::{ControlSample, RunLog};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, World};
use serde_json::Value;

use crate::runs::{Fig7, Response};
use crate::setups::Who;

/// Time between two points of a line, seconds.
const LINE_STEP_S: f64 = 0.12;

/// Errors with the largest and that of the ideal filter: of a run or a channel.
const ERRORS: [Column<'_>; 4] = [
    ("moving, mm", "{summary.locked.moving_mm.rms:2} ({summary.locked.moving_mm.max:2}; {ideal.moving.mm:2})"),
    ("moving, deg", "{summary.locked.moving_deg.rms:3} ({summary.locked.moving_deg.max:3}; {ideal.moving.deg:3})"),
    ("hold, mm", "{summary.locked.hold_mm.rms:2} ({summary.locked.hold_mm.max:2}; {ideal.hold.mm:2})"),
    ("hold, deg", "{summary.locked.hold_deg.rms:3} ({summary.locked.hold_deg.max:3}; {ideal.hold.deg:3})"),
];
const RUN: [Column<'_>; 3] = [("target", "{target}"), ("led by", "{who}"), ("delay, ms", "{delay_millis:0}")];
const FIG7: [Column<'_>; 7] = [
    ("lag, ms", "{largest_lag_s*1e3:1}"),
    ("initial lock, mm (500 mm x sigma)", "{summary.lock.hand_mm:2} ({summary.lock.hand_by_tilt_sigma_mm:2})"),
    ("noise at the hand, mm", "{noise_length_mm_deg.0:2}"),
    ("deg", "{noise_length_mm_deg.1:3}"),
    ("estimates, mm", "{estimates_at_hand_mm_deg.0:2}"),
    ("deg", "{estimates_at_hand_mm_deg.1:3}"),
    ("no pose", "{summary.frames_without_pose} of {summary.frames}"),
];
const RESPONSES: [Column<'_>; 8] = [
    ("axis", "{channel}"),
    ("period, s", "{period_s}"),
    ("gain, dB", "{gain_db:2}"),
    ("phase, deg", "{phase_deg:1}"),
    ("published law: gain, dB", "{published.gain_db:2}"),
    ("phase, deg", "{published.phase_deg:1}"),
    ("largest share of all limits", "{most}"),
    ("of the speed limits", "{most_speed}"),
];
const STEPS: [Column<'_>; 6] = [
    ("step", "{summary.channel} {size}"),
    ("law", "{who}"),
    ("settling time, s", "{summary.settled_after_s:2}"),
    ("overshoot, %", "{summary.overshoot_percent:1}"),
    ("lower bound, s", "{shortest_s:2}"),
    ("set by", "{set_by}"),
];
const USED: [Column<'_>; 3] = [
    ("joint speed, of the limit", "{speed_share.value*100:0} %: axis {speed_share.axis}"),
    ("acceleration, of the limit", "{acceleration_share.value*100:0} %: axis {acceleration_share.axis}"),
    ("smallest margin to an end of a range, deg", "{room_deg.value:1}: axis {room_deg.axis}"),
];
const LEFT: [Column<'_>; 2] = [("final error, mm", "{left_mm_deg.0:2}"), ("deg", "{left_mm_deg.1:2}")];
const APPROACHES: [Column<'_>; 5] = [
    ("start", "{name}"),
    ("initial error, mm", "{off_mm_deg.0:0}"),
    ("deg", "{off_mm_deg.1:0}"),
    ("settling time, s", "{there_after_s:1}"),
    ("end state", "{mode}"),
];
const SINGULAR: [Column<'_>; 7] = [
    ("path", "{name}"),
    ("smallest singular value", "{singular_value_min:4}"),
    ("largest error, mm", "{most_mm_deg.0:1}"),
    ("deg", "{most_mm_deg.1:2}"),
    ("on hold, % of the time", "{held_share*100:0}"),
    ("reason", "{held_why}"),
    ("joint reversals", "{turns}"),
];
const LAWS: [Column<'_>; 6] = [
    ("law", "{law}"),
    ("moving, mm", "{fig7.locked.moving_mm.rms:2}"),
    ("moving, deg", "{fig7.locked.moving_deg.rms:3}"),
    ("hold, mm", "{fig7.locked.hold_mm.rms:2}"),
    ("hold, deg", "{fig7.locked.hold_deg.rms:3}"),
    ("largest lag, ms", "{largest_lag_s*1e3:0}"),
];
const FAR: [Column<'_>; 9] = [
    ("start", "{name}"),
    ("law", "{law}"),
    ("settling time, s", "{there_after_s:1}"),
    ("end state", "{mode}"),
    ("path, mm", "{path_mm:0}"),
    ("straight, mm", "{straight_mm:0}"),
    ("aside, mm", "{aside_mm:0}"),
    ("largest distance to the target, mm", "{farthest_mm:0}"),
    ("to border, px", "{border_px:0}"),
];

/// The parts of the page.
pub fn parts(found: &Value, origin: &str) -> Vec<Part<'static>> {
    let rows = |key: &str| found[key].as_array().cloned().unwrap_or_default();
    let table = |key: &str, columns: &[&[Column<'_>]]| markdown(&columns.concat(), &rows(key));
    let ours = rows("responses").into_iter().filter(|row| row["who"] == Who::Ours.name()).collect::<Vec<_>>();
    let limits = rows("limits");
    let missed = limits.iter().filter(|limit| limit["kept"] == false).count();
    let speed = cell(
        "A run of Fig. 7 without images takes 1/{geometric_times_real_time:0} of its simulated time on one core.",
        found,
    );
    vec![
        ("run", format!("{origin}\n\n{missed} of {} limits are missed: [limits](#limits).\n{speed}", limits.len())),
        ("fig7", table("fig7", &[&RUN, &ERRORS, &FIG7])),
        (
            "axes",
            table("axes", &[&RUN, &[("axis", "{summary.channel}")], &ERRORS, &[("lag, ms", "{summary.lag_s*1e3:1}")]]),
        ),
        ("responses", markdown(&RESPONSES, &ours)),
        ("steps", table("steps", &[&STEPS])),
        ("approaches", table("approaches", &[&APPROACHES, &LEFT, &USED, &[SINGULAR[1]]])),
        ("singular", table("singular", &[&SINGULAR[..4], &LEFT, &SINGULAR[4..], &USED])),
        ("laws", table("laws", &[&LAWS])),
        ("far", table("far", &[&FAR[..4], &LEFT, &FAR[4..]])),
        ("limits", markdown(&limit::COLUMNS, &limits)),
    ]
}

/// The six panels: the desired and the actual motion of the hand with both setups.
pub fn motion_figure(runs: &[Fig7]) -> Option<String> {
    let ours = runs.iter().find(|run| run.who == Who::Ours.name())?;
    let published = runs.iter().find(|run| run.who == Who::Published.name() && run.delay_millis == ours.delay_millis);
    let (wanted, hand): (Pick, Pick) = (|s| &s.world_from_hand_locked, |s| &s.world_from_hand);
    let mut lines = vec![("direct", &ours.log, hand)];
    lines.extend(published.map(|published| ("published", &published.log, hand)));
    lines.push((WANTED, &ours.log, wanted));
    let axes = ours.log.control.first()?.world_from_target.rotation();
    let drawn: Vec<Panel> = (0..6).map(|row| motion_panel(row, &lines, &axes)).collect();
    let caption = format!(
        "Translation and rotation of the hand since the start, in the target's axes at the start; direct method: {}{}; total delay {:.0} ms.",
        ours.target,
        published.map_or(String::new(), |run| format!("; published method: {}", run.target)),
        ours.delay_millis
    );
    Some(panels(&drawn, 2, &[caption]))
}

type Pick = fn(&ControlSample) -> &Pose<World, Hand>;

/// Name of the desired motion.
const WANTED: &str = "wanted";

fn motion_panel(row: usize, lines: &[(&str, &RunLog, Pick)], axes: &UnitQuaternion<f64>) -> Panel {
    let (letter, axis) = (["a", "b", "c", "d", "e", "f"][row], ["x", "y", "z"][row % 3]);
    let what = if row < 3 { format!("position {axis}, mm") } else { format!("orientation {axis}, deg") };
    let value = |start: &Pose<World, Hand>, now: &Pose<World, Hand>| -> f64 {
        let turned = (now.rotation() * start.rotation().inverse()).scaled_axis();
        match row < 3 {
            true => (axes.inverse() * (now.translation_m() - start.translation_m()))[row] * 1e3,
            false => (axes.inverse() * turned)[row - 3].to_degrees(),
        }
    };
    let line = |(name, log, pick): &(&str, &RunLog, Pick)| {
        let start = log.control.first()?.world_from_hand_locked;
        let mut next_s = 0.0;
        let mut points = Vec::new();
        for sample in log.control.iter() {
            if sample.t_s >= next_s {
                next_s += LINE_STEP_S;
                points.push([sample.t_s, value(&start, pick(sample))]);
            }
        }
        Some(Line { name: (*name).to_owned(), points, is_bound: *name == WANTED })
    };
    Panel {
        title: format!("({letter}) {what}"),
        x: "time, s".to_owned(),
        axes: [AxisKind::Linear; 2],
        lines: lines.iter().filter_map(line).collect(),
    }
}

/// Gain and phase over the period, for a translation and a rotation, with both laws.
pub fn response_figure(responses: &[Response]) -> String {
    type Figure = fn(&Response) -> Option<f64>;
    let figures: [(&str, Figure); 2] = [("gain, dB", |r| r.gain_db), ("phase, deg", |r| r.phase_deg)];
    let lines = [(Who::Ours, "x"), (Who::Ours, "ry"), (Who::Published, "x"), (Who::Published, "ry")];
    let panel = |(title, pick): (&str, Figure)| {
        let line = |(who, channel): (Who, &str)| {
            let mine = responses.iter().filter(|r| r.who == who.name() && r.channel == channel);
            let mut points: Vec<[f64; 2]> = mine.filter_map(|r| Some([r.period_s, pick(r)?])).collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            Line { name: format!("{channel}, {}", who.name()), points, is_bound: false }
        };
        Panel {
            title: title.to_owned(),
            x: "period, s".to_owned(),
            axes: [AxisKind::Linear; 2],
            lines: lines.map(line).into(),
        }
    };
    let caption = "Sinusoids of 100 mm (x) and 20 degrees (ry), without images.".to_owned();
    panels(&figures.map(panel), 2, &[caption])
}
