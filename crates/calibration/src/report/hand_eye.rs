//! The report of a hand-eye calibration.

use pb3dp_geometry::so3;
use pb3dp_record::report::{Bars, Report, Table};

use super::{add_gates, parameters, with_limits};
use crate::adjust::POSE_NUMBERS;
use crate::gates::{Gate, Judged};
use crate::hand_eye::gates::{CORNERS, LEFT_OUT_ANGLE, LEFT_OUT_DISTANCE};
use crate::hand_eye::{HandEyeFit, Scale, StopCheck};

/// The report of a hand with working distance `distance_m`.
pub fn of_hand_eye(fit: &HandEyeFit, judged: &[Judged], distance_m: f64) -> Report {
    let bars = |title: &str, decimals: usize, gate: Gate, of: &dyn Fn(&StopCheck) -> f64| {
        with_limits(by_stop(fit, title, decimals, of), judged, gate)
    };
    let at = format!("predicted error of the hand at {:.0} mm", distance_m * 1e3);
    let figures = [
        (at.as_str(), format!("{:.2} mm", fit.hand_error_m(distance_m) * 1e3)),
        ("stops used", format!("{} of {}", fit.used().count(), fit.stops.len())),
        ("arm noise over the stated noise", format!("{:.2}", fit.robot_noise_ratio)),
        ("corner noise", format!("{:.3} px", fit.corner_sigma_px)),
    ];
    add_gates(Report::new("Hand-eye calibration"), judged)
        .figures(&figures)
        .heading("Stops")
        .paragraph("Board pose seen at each stop, compared with the calibration from all other stops. A stop that disagrees with all others is not used: the arm was still moving, or something was touched.")
        .bars(&[
            bars("distance by stop, mm", 3, LEFT_OUT_DISTANCE, &|stop| stop.left_out_mm),
            bars("angle by stop, degrees", 4, LEFT_OUT_ANGLE, &|stop| stop.left_out_deg),
            bars("reprojection error by stop, px rms", 3, CORNERS, &|stop| stop.corner_rms_px.unwrap_or(f64::NAN)),
        ])
        .heading("Numbers")
        .table(&of_poses(fit))
        .paragraph("Translation and rotation vector of each pose; the standard deviations are along and about the axes of its source frame.")
        .table(&scales(fit))
}

/// One bar per stop, in their order.
fn by_stop(fit: &HandEyeFit, title: &str, decimals: usize, of: &dyn Fn(&StopCheck) -> f64) -> Bars {
    fit.stops.iter().fold(Bars::new(title, decimals), |bars, stop| {
        let name = if stop.used { stop.name.clone() } else { format!("not used: {}", stop.name) };
        bars.bar(name, of(stop))
    })
}

fn of_poses(fit: &HandEyeFit) -> Table {
    let numbers = fit.poses().into_iter().flat_map(|(name, pose)| {
        let (shift, turn) = (pose.translation.vector, so3::log(&pose.rotation));
        let values = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
        POSE_NUMBERS.into_iter().zip(values).map(move |(key, value)| {
            let name = format!("{name}.{key}");
            let sigma = fit.sigma(&name);
            (name, value, sigma)
        })
    });
    parameters(numbers, 4)
}

/// True over stated lengths, with the robot as reference.
fn scales(fit: &HandEyeFit) -> Table {
    let table = Table::new(["true over stated length, with the robot as reference", "value", "standard deviation"]);
    let row = |table: Table, (name, scale): (&str, Scale)| {
        table.row([name.to_owned(), format!("{:.5}", scale.factor), format!("{:.5}", scale.sigma)])
    };
    [("squares", fit.scales.squares), ("baseline", fit.scales.baseline)].into_iter().fold(table, row)
}
