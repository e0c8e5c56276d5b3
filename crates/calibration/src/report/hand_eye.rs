//! The report of a hand-eye calibration.

use nalgebra::Isometry3;
use pb3dp_geometry::so3;
use pb3dp_record::calibration_files::BoardPlace;
use pb3dp_record::report::{Bars, Report, Table};

use super::{GateLine, add_gates};
use crate::gates::Limit;
use crate::hand_eye::HandEyeFit;
use crate::hand_eye::gates::{HandEyeGate, HandEyeVerdict};

impl From<&HandEyeVerdict> for GateLine {
    fn from(verdict: &HandEyeVerdict) -> Self {
        Self {
            name: verdict.gate.key().to_owned(),
            measured: verdict.measured,
            good: verdict.limit.good,
            refused: verdict.limit.refused,
            grade: verdict.grade(),
            advice: verdict.advice.to_owned(),
        }
    }
}

/// The report of a hand with working distance `distance_m`.
pub fn of_hand_eye(fit: &HandEyeFit, verdicts: &[HandEyeVerdict], distance_m: f64) -> Report {
    let gates: Vec<GateLine> = verdicts.iter().map(GateLine::from).collect();
    let limit = |gate: HandEyeGate| verdicts.iter().find(|verdict| verdict.gate == gate).map(|verdict| verdict.limit);
    let at = format!("predicted error of the hand at {:.0} mm", distance_m * 1e3);
    let figures = [
        (at.as_str(), format!("{:.2} mm", fit.hand_error_m(distance_m) * 1e3)),
        ("stops used", format!("{} of {}", fit.used().count(), fit.stops.len())),
        ("arm noise over the stated noise", format!("{:.2}", fit.robot_noise_ratio)),
        ("corner noise", format!("{:.3} px", fit.corner_sigma_px)),
    ];
    add_gates(Report::new("Hand-eye calibration"), &gates)
        .figures(&figures)
        .heading("Stops")
        .paragraph("Board pose seen at each stop, compared with the calibration from all other stops. A stop that disagrees with all others is not used: the arm was still moving, or something was touched.")
        .bars(&[
            by_stop(fit, "distance by stop, mm", 3, limit(HandEyeGate::LeftOutDistance), |stop| stop.left_out_mm),
            by_stop(fit, "angle by stop, degrees", 4, limit(HandEyeGate::LeftOutAngle), |stop| stop.left_out_deg),
            by_stop(fit, "reprojection error by stop, px rms", 3, limit(HandEyeGate::Corners), |stop| {
                stop.corner_rms_px.unwrap_or(f64::NAN)
            }),
        ])
        .heading("Numbers")
        .table(&poses(fit))
        .paragraph("Translation and rotation vector of each pose; the standard deviations are along and about the axes of its source frame.")
        .table(&scales(fit))
}

/// One bar per stop, in their order.
fn by_stop(
    fit: &HandEyeFit,
    title: &str,
    decimals: usize,
    limit: Option<Limit>,
    of: impl Fn(&crate::hand_eye::StopCheck) -> f64,
) -> Bars {
    let mut bars = Bars::new(title, decimals);
    for stop in &fit.stops {
        let name = if stop.used { stop.name.clone() } else { format!("not used: {}", stop.name) };
        bars = bars.bar(name, of(stop));
    }
    match limit {
        Some(limit) => bars.limit("good", limit.good).limit("refused", limit.refused),
        None => bars,
    }
}

/// All poses, in millimetres and degrees.
fn poses(fit: &HandEyeFit) -> Table {
    let mut all: Vec<(&str, Isometry3<f64>)> = vec![("flange_from_cam_left", *fit.flange_from_cam_left().isometry())];
    match fit.board() {
        BoardPlace::Room { base_from_board } => all.push(("base_from_board", *base_from_board.isometry())),
        BoardPlace::Carried { vs_base_from_tc_base, tc_flange_from_board } => all.extend([
            ("vs_base_from_tc_base", *vs_base_from_tc_base.isometry()),
            ("tc_flange_from_board", *tc_flange_from_board.isometry()),
        ]),
    }
    let mut table = Table::new(["parameter", "value", "standard deviation"]);
    for (name, pose) in all {
        let (shift, turn) = (pose.translation.vector * 1e3, so3::log(&pose.rotation).map(f64::to_degrees));
        let degrees = 1_f64.to_degrees();
        let rows = [
            ("x", "x_m", shift.x, 1e3, "mm"),
            ("y", "y_m", shift.y, 1e3, "mm"),
            ("z", "z_m", shift.z, 1e3, "mm"),
            ("rx", "rx_rad", turn.x, degrees, "degrees"),
            ("ry", "ry_rad", turn.y, degrees, "degrees"),
            ("rz", "rz_rad", turn.z, degrees, "degrees"),
        ];
        for (shown, key, value, factor, unit) in rows {
            let sigma = fit.sigma(&format!("{name}.{key}")).map_or("-".to_owned(), |s| format!("{:.4}", s * factor));
            table = table.row([format!("{name}.{shown}, {unit}"), format!("{value:.4}"), sigma]);
        }
    }
    table
}

/// True over stated lengths, with the robot as reference.
fn scales(fit: &HandEyeFit) -> Table {
    let table = Table::new(["true over stated length, with the robot as reference", "value", "standard deviation"]);
    let row = |table: Table, (name, scale): (&str, crate::hand_eye::Scale)| {
        table.row([name.to_owned(), format!("{:.5}", scale.factor), format!("{:.5}", scale.sigma)])
    };
    [("squares", fit.scales.squares), ("baseline", fit.scales.baseline)].into_iter().fold(table, row)
}
