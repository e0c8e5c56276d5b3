//! The goals for the times.

use serde_json::{Value, json};

/// A measured time and its goal.
pub struct Goal {
    /// Name of the time.
    pub name: &'static str,
    /// Goal, milliseconds.
    pub limit_ms: f64,
    /// Measured time, milliseconds.
    pub found_ms: f64,
}

impl Goal {
    /// Whether the goal is reached.
    pub fn is_reached(&self) -> bool {
        self.found_ms <= self.limit_ms
    }

    /// As saved.
    pub fn to_json(&self) -> Value {
        json!({
            "name": self.name,
            "limit_ms": self.limit_ms,
            "found_ms": self.found_ms,
            "is_reached": self.is_reached(),
        })
    }
}

/// The goals for all measured times.
pub fn goals(findings: &super::Findings) -> Vec<Goal> {
    let mut goals = Vec::new();
    if let Some(all) = findings.real.as_ref().and_then(|real| real.rows.first()) {
        let times = &all.whole;
        goals.push(Goal { name: "cold start on real cases, median", limit_ms: 1.5, found_ms: times.median_ms });
        goals.push(Goal { name: "cold start on real cases, 90th percentile", limit_ms: 4.0, found_ms: times.p90_ms });
    }
    if let Some(real) = &findings.real {
        let found_ms = real.row_measurement.median_ms;
        goals.push(Goal { name: "vertical misalignment, once per rig, median", limit_ms: 20.0, found_ms });
    }
    let tracking = &findings.tracking;
    let (followed, lost) = (&tracking.followed, &tracking.lost);
    goals.push(Goal { name: "tracking frame, median", limit_ms: 0.9, found_ms: followed.median_ms });
    goals.push(Goal { name: "tracking frame, 99th percentile", limit_ms: 1.5, found_ms: followed.p99_ms });
    goals.push(Goal { name: "frame of a lost target, median", limit_ms: 5.0, found_ms: lost.median_ms });
    goals.push(Goal { name: "first frame of a track", limit_ms: 80.0, found_ms: tracking.start_ms });
    goals
}
