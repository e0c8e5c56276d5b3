//! Stalls: one part of the workcell stands still for a moment (docs/supervisor.md#stalls).

use pb3dp_sim::camera_faults::CameraFaultKind;

use crate::faults::{Fault, Kind};
use crate::scenario::Dice;

/// Lengths, seconds: about the age at which joints are stale, twice that, and the ages of images and estimates of two and four periods.
const LENGTHS_S: [f64; 4] = [0.02, 0.04, 0.08, 0.16];

/// Names in tables.
pub const NAMES: [&str; 4] = ["stall: control loop", "stall: estimator", "stall: cameras", "stall: line of an arm"];

/// Draws a stall that begins at this time. A line that transports nothing is two faults, one for each direction.
pub fn draw(dice: &mut Dice, from_s: f64) -> Vec<Fault> {
    let for_s = dice.pick(&LENGTHS_S);
    let part = dice.below(NAMES.len());
    let arm = dice.below(2);
    let kinds = match part {
        0 => vec![Kind::Overrun(for_s)],
        1 => vec![Kind::Stall],
        2 => vec![Kind::Camera(CameraFaultKind::Dropped { share: 1.0 })],
        _ => vec![
            Kind::of_arm(arm, "line: silent", "line silence on", Some("line silence off")),
            Kind::of_arm(arm, "line: gateway deaf", "line deaf on", Some("line deaf off")),
        ],
    };
    kinds.into_iter().map(|kind| Fault { kind, from_s, for_s, stall: Some(NAMES[part]) }).collect()
}
