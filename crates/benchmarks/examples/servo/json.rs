//! All results as JSON: rows of the tables.

use pb3dp_benchmarks::limit::Check;
use pb3dp_cell::channels::ChannelSummary;
use serde_json::{Value, json};

use crate::Findings;
use crate::cases::LawFindings;
use crate::demands::Demand;
use crate::ideal::Ideal;
use crate::runs::{Fig7, IdealPhases, Response, Step};
use crate::setups::Who;
use crate::ways::Way;

/// Results and limits, with their origin.
pub fn all(findings: &Findings, checks: &[Check], origin: &str) -> Value {
    json!({
        "bench": "servo",
        "where": origin,
        "fig7": findings.fig7.iter().map(fig7).collect::<Vec<_>>(),
        "axes": findings.fig7.iter().flat_map(axes).collect::<Vec<_>>(),
        "responses": responses(&findings.responses),
        "steps": findings.steps.iter().map(step).collect::<Vec<_>>(),
        "approaches": findings.approaches.iter().map(|approach| way(&approach.way)).collect::<Vec<_>>(),
        "singular": findings.singular.iter().map(way).collect::<Vec<_>>(),
        "laws": findings.laws.iter().map(law).collect::<Vec<_>>(),
        "far": far(&findings.laws),
        "geometric_times_real_time": findings.geometric_times_real_time,
        "limits": checks.iter().map(Check::to_json).collect::<Vec<_>>(),
    })
}

fn fig7(run: &Fig7) -> Value {
    let length = |from: usize| run.noise.map(|noise| noise[from..from + 3].iter().map(|x| x * x).sum::<f64>().sqrt());
    json!({
        "who": run.who,
        "target": run.target,
        "delay_millis": run.delay_millis,
        "seed": run.seed,
        "summary": run.summary,
        "largest_lag_s": largest_lag_s(&run.summary.channels),
        "ideal": phases(&run.ideal),
        "channel_ideals": run.channel_ideals.iter().map(phases).collect::<Vec<_>>(),
        "noise_at_hand_mm_deg": run.noise,
        "noise_length_mm_deg": [length(0), length(3)],
        "estimates_at_hand_mm_deg": run.estimates,
    })
}

fn largest_lag_s(channels: &[ChannelSummary]) -> Option<f64> {
    channels.iter().filter_map(|channel| channel.lag_s).max_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// Each axis of a run separately.
fn axes(run: &Fig7) -> Vec<Value> {
    let row = |(channel, ideal): (&ChannelSummary, &IdealPhases)| json!({"who": run.who, "target": run.target, "delay_millis": run.delay_millis, "summary": channel, "ideal": phases(ideal)});
    run.summary.channels.iter().zip(&run.channel_ideals).map(row).collect()
}

fn phases(phases: &IdealPhases) -> Value {
    let ideal = |ideal: Option<Ideal>| ideal.map(|ideal| json!({ "mm": ideal.mm, "deg": ideal.deg }));
    json!({ "moving": ideal(phases.moving), "hold": ideal(phases.hold) })
}

/// The responses, ours with that of the published law and the largest demands.
fn responses(all: &[Response]) -> Vec<Value> {
    let row = |found: &Response| {
        let mut row = response(found);
        let same = |other: &&Response| other.channel == found.channel && other.period_s == found.period_s;
        let published = all.iter().filter(same).find(|other| other.who == Who::Published.name());
        row["published"] = published.map_or_else(|| json!({"gain_db": null, "phase_deg": null}), response);
        let most = |only_speeds: bool| -> Option<String> {
            let Some(demands) = &found.demands else { return found.refusal.clone() };
            let first = demands.iter().find(|demand| demand.is_speed || !only_speeds)?;
            Some(format!("{:.0} %: {}", 100.0 * first.share, first.what))
        };
        (row["most"], row["most_speed"]) = (most(false).into(), most(true).into());
        row
    };
    all.iter().map(row).collect()
}

fn response(response: &Response) -> Value {
    let demand = |demand: &Demand| json!({ "what": demand.what, "is_speed": demand.is_speed, "share": demand.share });
    json!({
        "who": response.who,
        "channel": response.channel,
        "period_s": response.period_s,
        "demands": response.demands.as_ref().map(|demands| demands.iter().map(demand).collect::<Vec<_>>()),
        "refusal": response.refusal,
        "gain_db": response.gain_db,
        "phase_deg": response.phase_deg,
    })
}

fn step(step: &Step) -> Value {
    let size = if step.summary.unit == "mm" { "50 mm" } else { "15 deg" };
    json!({ "who": step.who, "size": size, "summary": step.summary, "shortest_s": step.shortest_s, "set_by": step.set_by })
}

fn law(findings: &LawFindings) -> Value {
    json!({
        "law": findings.law.name(),
        "fig7": findings.fig7.summary,
        "largest_lag_s": largest_lag_s(&findings.fig7.summary.channels),
        "ways": findings.ways.iter().map(way).collect::<Vec<_>>(),
    })
}

/// The approaches from far away, each with all laws.
fn far(laws: &[LawFindings]) -> Vec<Value> {
    let count = laws.iter().map(|findings| findings.ways.len()).max().unwrap_or(0);
    let row = |findings: &LawFindings, index: usize| {
        let mut row = way(findings.ways.get(index)?);
        row["law"] = findings.law.name().into();
        Some(row)
    };
    (0..count).flat_map(|index| laws.iter().filter_map(move |findings| row(findings, index))).collect()
}

fn way(way: &Way) -> Value {
    let axis = |(value, axis): (f64, usize)| json!({ "value": value, "axis": axis });
    json!({
        "name": way.name,
        "off_mm_deg": way.off,
        "there_after_s": way.there_after_s,
        "mode": way.mode,
        "left_mm_deg": way.left,
        "most_mm_deg": way.most,
        "singular_value_min": way.singular_value_min,
        "held_share": way.held.0,
        "held_why": way.held.1,
        "speed_share": axis(way.used.speed),
        "acceleration_share": axis(way.used.acceleration),
        "room_deg": axis(way.used.room_deg),
        "turns": way.used.turns,
        "path_mm": way.path.length_mm,
        "straight_mm": way.path.straight_mm,
        "aside_mm": way.path.aside_mm,
        "farthest_mm": way.path.farthest_mm,
        "border_px": way.path.border_px,
    })
}
