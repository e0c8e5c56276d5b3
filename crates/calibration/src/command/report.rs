//! Printed results of a calibration.

use std::fmt::Write;

use crate::fit::{Fit, View, sides};
use crate::gates::{Judged, verdict};
use crate::held_out::Chosen;
use crate::quality::Quality;
use crate::report::noise;
use anyhow::Result;
use pb3dp_geometry::StereoRig;

/// Number of worst views listed.
const WORST_VIEWS: usize = 3;

/// The cameras with the standard deviation of each number, and the lens model selection.
pub(super) fn fit<const N: usize>(chosen: &Chosen<N>) -> String {
    let covariance = chosen.fit.covariance();
    let mut lines = Vec::new();
    if chosen.tried.len() > 1 {
        lines.push("lens model: error on held-out views, px".to_owned());
        for held_out in &chosen.tried {
            let mark = if held_out.lens == chosen.fit.lens() { "  <- chosen" } else { "" };
            lines.push(match &held_out.rms_px {
                Ok(rms_px) => format!("  {:<10} {rms_px:.4}{mark}", held_out.lens.name()),
                Err(reason) => format!("  {:<10} -       {reason}", held_out.lens.name()),
            });
        }
    }
    for (side, camera) in sides::<N>().into_iter().zip(chosen.fit.cameras()) {
        let p = camera.pinhole();
        let pinhole = [("fx", p.fx), ("fy", p.fy), ("cx", p.cx), ("cy", p.cy)];
        let numbers = pinhole.into_iter().chain(camera.distortion().named_coefficients());
        let known =
            numbers.filter_map(|(name, value)| Some((name, value, covariance.sigma(&format!("{side}.{name}"))?)));
        let text = known.map(|(name, value, sigma)| format!("{name} {value:.4} +- {sigma:.4}")).collect::<Vec<_>>();
        lines.push(format!("{side}: {}", text.join(", ")));
    }
    if let Some(heights_m) = chosen.fit.board_shape_m() {
        let names = ["bow_of_rows_m", "bow_of_columns_m", "twist_m"];
        let sigma_mm = |name: &str| covariance.sigma(&format!("board.{name}")).unwrap_or(f64::NAN) * 1e3;
        let [rows, columns, twist] =
            std::array::from_fn(|n| format!("{:+.3} +- {:.3}", heights_m[n] * 1e3, sigma_mm(names[n])));
        lines
            .push(format!("board: bow along its rows {rows} mm, bow along its columns {columns} mm, twist {twist} mm"));
    }
    lines.push(format!("+- is one standard deviation, {}", noise(covariance)));
    lines.join("\n")
}

/// The pose between the two cameras.
pub(super) fn rig(fit: &Fit<2>, rig: &StereoRig, depth_m: f64) -> Result<String> {
    let pose = rig.cam_right_from_cam_left();
    let (t, turn) = (pose.translation_m() * 1e3, pose.rotation().scaled_axis());
    let sigma = |name: &str| fit.covariance().sigma(&format!("cam_right_from_cam_left.{name}")).unwrap_or(f64::NAN);
    let [x, y, z] = ["x_m", "y_m", "z_m"].map(|name| sigma(name) * 1e3);
    let [rx, ry, rz] = ["rx_rad", "ry_rad", "rz_rad"].map(|name| sigma(name).to_degrees());
    let degrees = [turn.x, turn.y, turn.z].map(f64::to_degrees);
    Ok(format!(
        "baseline {:.3} mm; cam_right_from_cam_left: x {:.3} +- {x:.3}, y {:.3} +- {y:.3}, z {:.3} +- {z:.3} mm, rotation vector {:.4} +- {rx:.4}, {:.4} +- {ry:.4}, {:.4} +- {rz:.4} degrees\ndepth error from this calibration at {:.0} mm straight ahead: +- {:.3} mm",
        rig.baseline_m() * 1e3,
        t.x,
        t.y,
        t.z,
        degrees[0],
        degrees[1],
        degrees[2],
        depth_m * 1e3,
        fit.depth_sigma_m(depth_m)? * 1e3
    ))
}

/// The gates, the worst views, and the verdict.
pub(super) fn of_cameras(quality: &Quality, judged: &[Judged]) -> String {
    let mut lines: Vec<String> = Vec::new();
    if let Some(rows) = quality.rows {
        lines.push(format!(
            "vertical misalignment of the rectified images, right minus left: mean {:+.3} px, 95 % within {:.3} px",
            rows.mean_px, rows.p95_px
        ));
    }
    lines.extend(defects(quality));
    let worst =
        quality.views_by_error().into_iter().take(WORST_VIEWS).map(|(_, name, rms_px)| format!("{name:?} {rms_px:.3}"));
    lines.push(format!("views with the largest errors, px rms: {}", worst.collect::<Vec<_>>().join(", ")));
    lines.push(gates(judged));
    if quality.scale_error_share.is_none() {
        lines.push(
            "not judged: the size of the squares, which images cannot reveal; measure the baseline with a ruler and give --baseline, or measure a known length with the calibrated cameras"
                .to_owned(),
        );
    }
    lines.join("\n")
}

/// Describes the detected defects.
fn defects(quality: &Quality) -> Vec<String> {
    let Some(defects) = &quality.defects else { return Vec::new() };
    let name = |view: usize| quality.reprojection_rms_by_view_px.get(view).map_or("", |(name, _)| name.as_str());
    let mut lines = Vec::new();
    let refocused = defects.refocused;
    if refocused.share > 0.0 {
        let side = if quality.rows.is_none() { "the" } else { sides::<2>()[refocused.camera.min(1)] };
        let from = name(refocused.from_view);
        lines.push(format!("{side} camera: focal length changes from view {from:?} on, in the order of the names"));
    }
    if let Some(moved) = defects.moved.filter(|moved| moved.rms_px > 0.0) {
        lines.push(format!(
            "largest disagreement of the two cameras about the board position: view {:?}",
            name(moved.worst_view)
        ));
    }
    lines
}

/// The gates of any calibration, and the verdict in words.
pub(super) fn gates(judged: &[Judged]) -> String {
    let mut lines: Vec<String> = judged.iter().map(Judged::to_string).collect();
    lines.push(format!("verdict: {}", verdict(judged).1));
    lines.join("\n")
}

/// All corners as CSV.
pub(super) fn corners<const N: usize>(views: &[View<N>]) -> String {
    let mut text = "view,camera,column,row,u,v\n".to_owned();
    for view in views {
        for (side, sighting) in sides::<N>().into_iter().zip(&view.sightings) {
            for corner in sighting.corners() {
                let (name, pixel) = (&view.name, corner.pixel);
                // Writing to a `String` does not fail.
                let _ = writeln!(text, "{name},{side},{},{},{:.4},{:.4}", corner.column, corner.row, pixel.x, pixel.y);
            }
        }
    }
    text
}
