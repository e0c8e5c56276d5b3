//! The touch test: board corners touched with the arm, from a TOML file.

use std::path::Path;

use crate::verify::against::Known;
use crate::verify::touch::{Touch, TouchResult, touched};
use anyhow::{Context, Result, bail};
use nalgebra::{Isometry3, Point3};
use pb3dp_record::calibration_files::load_hand_eye;
use pb3dp_record::text_file::read_text;

use super::DetectedBoards;
use super::numbers::list_of_toml;

/// Fewer points cannot distinguish a rotated hand from a shifted one.
const PLACES_MIN: usize = 3;

/// Positions of the touched corners computed from the cameras, the hand-eye calibration and the stops of a recording.
pub(super) fn run(
    known: &Known,
    detected: &DetectedBoards<2>,
    hand_eye: &Path,
    file: &Path,
) -> Result<Vec<TouchResult>> {
    let text = read_text(file).with_context(|| format!("{}: cannot read file", file.display()))?;
    let touches = parse(&text).with_context(|| format!("{}: invalid touch test", file.display()))?;
    let flange_from_cam_left = load_hand_eye(hand_eye)?.flange_from_cam_left;
    let recorded = detected.stops.as_ref().context("the touch test needs a recording of stops")?;
    let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(detected.views.len());
    for [left, _] in &detected.files {
        let stop = recorded.stops.stops.iter().find(|stop| recorded.folder.join(&stop.left) == *left);
        let stop = stop.with_context(|| format!("{}: no stop has this image", left.display()))?;
        poses.push(*(stop.vs.base_from_flange * flange_from_cam_left).isometry());
    }
    Ok(touched(&known.rig, &detected.views, &poses, &touches)?)
}

/// `[[touch]]` with `board_corner = [column, row]` and `base_position_mm = [x, y, z]`.
fn parse(text: &str) -> Result<Vec<Touch>> {
    let root: toml::Table = text.parse()?;
    if let Some(key) = root.keys().find(|key| *key != "touch") {
        bail!("unknown key {key}: each point is a [[touch]]");
    }
    let places = root.get("touch").and_then(toml::Value::as_array).context("missing [[touch]]")?;
    if places.len() < PLACES_MIN {
        bail!("touch: {} points given, at least {PLACES_MIN} needed, far from each other", places.len());
    }
    places.iter().enumerate().map(|(number, place)| touch(number, place)).collect()
}

fn touch(number: usize, place: &toml::Value) -> Result<Touch> {
    let known = ["board_corner", "base_position_mm"];
    let table = place.as_table().with_context(|| format!("touch[{number}]: must be a [[touch]]"))?;
    if let Some(key) = table.keys().find(|key| !known.contains(&key.as_str())) {
        bail!("unknown key touch[{number}].{key}; use {}", known.join(", "));
    }
    let wrong = |key: &str, count: usize| format!("touch[{number}].{key}: must be {count} numbers");
    let [column, row] = list_of_toml(table.get("board_corner")).with_context(|| wrong("board_corner", 2))?;
    let [x, y, z] = list_of_toml(table.get("base_position_mm")).with_context(|| wrong("base_position_mm", 3))?;
    let is_place = |value: f64| value.fract() == 0.0 && (0.0..100.0).contains(&value);
    if !is_place(column) || !is_place(row) {
        bail!("touch[{number}].board_corner is [{column}, {row}]; must be column and row of a corner, counted from 0");
    }
    Ok(Touch { board_corner: [column as u32, row as u32], in_base_m: Point3::new(x, y, z) * 1e-3 })
}

/// The result of each point.
pub(super) fn notes(results: &[TouchResult]) -> String {
    let line = |result: &TouchResult| {
        let [column, row] = result.touch.board_corner;
        let [touched, detected] = [result.touch.in_base_m, result.measured_in_base_m].map(|point| point * 1e3);
        let apart = detected - touched;
        format!(
            "corner {column},{row}: touched at {:.2}, {:.2}, {:.2} mm in base, position error {:.2} mm ({:+.2}, {:+.2}, {:+.2}; {} stops, scatter {:.2} mm)",
            touched.x,
            touched.y,
            touched.z,
            apart.norm(),
            apart.x,
            apart.y,
            apart.z,
            result.stops,
            result.scatter_m * 1e3
        )
    };
    results.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "[[touch]]\nboard_corner = [0, 0]\nbase_position_mm = [412.5, -80, 31.2]\n
[[touch]]\nboard_corner = [8, 0]\nbase_position_mm = [612.5, -80, 31.2]\n
[[touch]]\nboard_corner = [0, 5]\nbase_position_mm = [412.5, 45, 30]\n";

    #[test]
    fn places_are_read_in_metres() {
        let touches = parse(FILE).expect("places");
        assert_eq!(touches.len(), 3);
        assert_eq!(touches[1].board_corner, [8, 0]);
        assert!((touches[1].in_base_m - Point3::new(0.6125, -0.08, 0.0312)).norm() < 1e-12);
    }

    #[test]
    fn mistakes_are_named() {
        for (from, to, named) in [
            ("board_corner = [8, 0]", "board_corner = [8.5, 0]", "touch[1].board_corner"),
            ("board_corner = [8, 0]", "board_corner = [8]", "touch[1].board_corner: must be 2 numbers"),
            ("[412.5, 45, 30]", "[412.5, 45]", "touch[2].base_position_mm: must be 3 numbers"),
            ("[412.5, 45, 30]", "[412.5, 45, nan]", "touch[2].base_position_mm"),
            ("board_corner = [8, 0]", "corner = [8, 0]", "touch[1].corner"),
            ("\n[[touch]]\nboard_corner = [8, 0]\nbase_position_mm = [612.5, -80, 31.2]\n", "", "2 points"),
        ] {
            let error = format!("{:#}", parse(&FILE.replacen(from, to, 1)).expect_err(to));
            assert!(error.contains(named), "{error}");
        }
    }
}
