//! A line for each two estimates that belong together.

use std::fmt::Write as _;

use super::Comparison;
use super::estimates::{EstimatePair, Offset};

/// Columns: times since the begin, poses of the target in the left camera, the offset between both, the offset of the motions since the
/// first common estimate, errors of the motions against the truth. Empty cells are unknown.
const HEADING: &str = "t_a_s,t_b_s,pair_a,pair_b,target_a,target_b,status_a,status_b,x_a_mm,y_a_mm,z_a_mm,x_b_mm,y_b_mm,z_b_mm,\
    distance_mm,angle_deg,moved_distance_mm,moved_angle_deg,latency_a_ms,latency_b_ms,error_a_mm,error_a_deg,error_b_mm,error_b_deg,equal\n";

/// The table as CSV.
pub fn csv(comparison: &Comparison) -> String {
    let lines = comparison.estimates.pairs.iter().map(|pair| line(comparison, pair));
    lines.fold(HEADING.to_owned(), |text, line| text + &line)
}

fn line(comparison: &Comparison, pair: &EstimatePair) -> String {
    let [a, b] = [0, 1].map(|run| &comparison.runs[run].estimates[pair.at[run]]);
    let mut text = format!(
        "{:.6},{:.6},{},{},{},{},{},{}",
        a.stamp.t_s(),
        b.stamp.t_s(),
        a.stamp.number,
        b.stamp.number,
        a.result.target,
        b.result.target,
        a.result.status,
        b.result.status
    );
    for estimate in [a, b] {
        match &estimate.cam_left_from_model {
            Some(pose) => pose.translation_m().iter().for_each(|m| {
                let _ = write!(text, ",{:.6}", m * 1e3);
            }),
            None => text += ",,,",
        }
    }
    text += &cells(pair.offset);
    text += &cells(pair.moved);
    let _ = write!(text, ",{:.3},{:.3}", a.result.latency_millis, b.result.latency_millis);
    pair.errors.iter().for_each(|error| text += &cells(*error));
    let _ = writeln!(text, ",{}", u8::from(pair.is_equal));
    text
}

fn cells(offset: Option<Offset>) -> String {
    offset.map_or_else(|| ",,".to_owned(), |offset| format!(",{:.6},{:.6}", offset.distance_mm, offset.angle_deg))
}
