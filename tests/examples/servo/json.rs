//! Everything that was measured, as JSON.

use serde_json::{Value, json};

use crate::Findings;
use crate::demands::Demand;
use crate::ideal::Ideal;
use crate::limits::Check;
use crate::runs::{Fig7, IdealPhases, Response, Step};

/// Findings and limits, with where they were found.
pub fn all(findings: &Findings, checks: &[Check], origin: &str) -> Value {
    json!({
        "bench": "servo",
        "where": origin,
        "fig7": findings.fig7.iter().map(fig7).collect::<Vec<_>>(),
        "responses": findings.responses.iter().map(response).collect::<Vec<_>>(),
        "steps": findings.steps.iter().map(step).collect::<Vec<_>>(),
        "geometric_times_real_time": findings.geometric_times_real_time,
        "limits": checks.iter().map(check).collect::<Vec<_>>(),
    })
}

fn fig7(run: &Fig7) -> Value {
    json!({
        "who": run.who,
        "target": run.target,
        "delay_millis": run.delay_millis,
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

fn check(check: &Check) -> Value {
    json!({ "what": check.what, "found": check.found, "most": check.most, "unit": check.unit, "kept": check.is_kept() })
}
