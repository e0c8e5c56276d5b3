//! All results as JSON.

use serde_json::{Value, json};

use crate::Findings;
use crate::cases::LawFindings;
use crate::demands::Demand;
use crate::ideal::Ideal;
use crate::limits::Check;
use crate::runs::{Fig7, IdealPhases, Response, Step};
use crate::ways::Way;

/// Results and limits, with their origin.
pub fn all(findings: &Findings, checks: &[Check], origin: &str) -> Value {
    json!({
        "bench": "servo",
        "where": origin,
        "fig7": findings.fig7.iter().map(fig7).collect::<Vec<_>>(),
        "responses": findings.responses.iter().map(response).collect::<Vec<_>>(),
        "steps": findings.steps.iter().map(step).collect::<Vec<_>>(),
        "approaches": findings.approaches.iter().map(|approach| way(&approach.way)).collect::<Vec<_>>(),
        "singular": findings.singular.iter().map(way).collect::<Vec<_>>(),
        "laws": findings.laws.iter().map(law).collect::<Vec<_>>(),
        "geometric_times_real_time": findings.geometric_times_real_time,
        "limits": checks.iter().map(check).collect::<Vec<_>>(),
    })
}

fn fig7(run: &Fig7) -> Value {
    json!({
        "who": run.who,
        "target": run.target,
        "delay_millis": run.delay_millis,
        "seed": run.seed,
        "summary": run.summary,
        "ideal": phases(&run.ideal),
        "channel_ideals": run.channel_ideals.iter().map(phases).collect::<Vec<_>>(),
        "noise_at_hand_mm_deg": run.noise,
        "estimates_at_hand_mm_deg": run.estimates,
    })
}

fn phases(phases: &IdealPhases) -> Value {
    let ideal = |ideal: Option<Ideal>| ideal.map(|ideal| json!({ "mm": ideal.mm, "deg": ideal.deg }));
    json!({ "moving": ideal(phases.moving), "hold": ideal(phases.hold) })
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
    json!({ "who": step.who, "summary": step.summary, "shortest_s": step.shortest_s, "set_by": step.set_by })
}

fn law(findings: &LawFindings) -> Value {
    json!({
        "law": findings.law.name(),
        "fig7": findings.fig7.summary,
        "ways": findings.ways.iter().map(way).collect::<Vec<_>>(),
    })
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

fn check(check: &Check) -> Value {
    json!({ "what": check.what, "found": check.found, "most": check.most, "unit": check.unit, "kept": check.is_kept() })
}
