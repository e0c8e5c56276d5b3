//! First poses of tracks on real cases, beside those of single pairs: whether the standard deviations that they state hold.

use std::path::Path;

use nalgebra::{Vector2, Vector3};
use pb3dp_benchmarks::table::{Column, markdown};
use pb3dp_estimation::estimator::{EstimatorConfig, Method, Tracker};
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_record::dataset::load_case;
use pb3dp_record::metrics::{self, compare_plane};
use serde_json::{Value, json};

use super::cases::{self, Prepared};
use super::score::{Answer, Entry, Maker};
use super::{Args, left_out, ours};

/// Error of a normal from which it is no longer a matter of words whether the standard deviation holds.
const LARGE_RAD: f64 = 1.0 / 57.295_779_513;

/// Prints the table of both.
///
/// # Errors
/// A folder or case that cannot be read.
pub fn run(args: &Args, folder: &Path) -> anyhow::Result<()> {
    let mut entries = [Vec::new(), Vec::new()];
    for case in &cases::find(folder, args.filter.as_deref())? {
        if args.cases.is_some() && left_out::is_held_back(&load_case(case)?) {
            continue;
        }
        let Some(prepared) = cases::load(case)?.filter(|case| case.facts.is_planar()) else { continue };
        entries[0].push(ours::run(&prepared, Method::Direct, 1));
        entries[1].push(first_pose(&prepared)?);
    }
    print!("{}", markdown(&COLUMNS, &entries.map(|entries| row(&entries))));
    Ok(())
}

const COLUMNS: [Column<'_>; 5] = [
    ("poses", "{poses}"),
    ("cases, ok", "{cases}, {ok}"),
    ("normal deg med / p95", "{normal_deg.0:2} / {normal_deg.1:2}"),
    ("in 2 sigmas %: depth, normal", "{in_2_sigmas_percent.0:0}, {in_2_sigmas_percent.1:0}"),
    ("normals beyond 3 sigmas and 1 degree", "{beyond}"),
];

/// The first pose of a track.
fn first_pose(case: &Prepared) -> anyhow::Result<Entry> {
    let mut tracker = Tracker::new(Method::Direct, &case.rig, &EstimatorConfig::default())?;
    let images = &case.images;
    let request = EstimateRequest::new_target(&images.left, &images.right, &case.region, &case.range);
    let found = tracker.estimate(request)?;
    let [u, v] = case.centroid_px;
    let ray = case.rig.left().unproject(&Vector2::new(u, v))?;
    let answer = found.cam_left_from_model.zip(found.first_pose_covariance).map(|(pose, covariance)| {
        let normal = pose.transform_vector(&Vector3::z());
        let z_m = normal.dot(&pose.translation_m()) / normal.dot(&ray);
        let error = compare_plane(&metrics::PlaneEstimate { z_m, normal_in_cam_left: -normal }, &case.truth);
        let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
        Answer {
            z_m: error.z_m,
            normal_rad: error.normal_rad,
            disparity_px: error.disparity_px,
            // The depth of a plane on a ray changes with its shift along the normal.
            z_sigma_m: Some(sigma(2) / normal.dot(&ray).abs()),
            normal_sigma_rad: Some(sigma(3).hypot(sigma(4))),
            map: None,
        }
    });
    let status = Some(found.status.as_str());
    Ok(Entry { status, answer, ..Entry::new(&case.facts, "first pose of a track", Maker::Ours) })
}

fn row(entries: &[Entry]) -> Value {
    let sure: Vec<&Entry> = entries.iter().filter(|entry| entry.is_ok()).collect();
    let mut normals_deg: Vec<f64> =
        sure.iter().filter_map(|entry| Some(entry.answer?.normal_rad.to_degrees())).collect();
    normals_deg.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let index = (share * normals_deg.len().saturating_sub(1) as f64).round() as usize;
        normals_deg.get(index).copied().unwrap_or(f64::NAN)
    };
    let scores: Vec<(f64, f64)> = sure.iter().filter_map(|entry| entry.squared_scores()).collect();
    let within = |score: fn(&(f64, f64)) -> f64| {
        let count = scores.iter().filter(|scores| score(scores) <= 4.0).count();
        100.0 * count as f64 / scores.len().max(1) as f64
    };
    let is_silent = |entry: &&&Entry| {
        let is_large = entry.answer.is_some_and(|answer| answer.normal_rad > LARGE_RAD);
        is_large && entry.squared_scores().is_some_and(|(_, normal)| normal > 9.0)
    };
    json!({
        "poses": entries.first().map(|entry| entry.method.as_str()),
        "cases": entries.len(),
        "ok": sure.len(),
        "normal_deg": [at(0.5), at(0.95)],
        "in_2_sigmas_percent": [within(|scores| scores.0), within(|scores| scores.1)],
        "beyond": sure.iter().filter(is_silent).count(),
    })
}

#[cfg(test)]
mod tests {
    use pb3dp_record::metrics::Group;

    use super::*;
    use crate::real::score::tests::{answer, case, entry};

    #[test]
    fn shares_are_those_of_sure_answers() {
        let case = case("a", Group::Textured, (0.0, 0.0));
        let with = |z_mm: f64, normal_deg: f64| {
            let sigmas = (Some(1e-3), Some(1_f64.to_radians()));
            let answer = Answer { z_sigma_m: sigmas.0, normal_sigma_rad: sigmas.1, ..answer(z_mm, normal_deg) };
            Entry { status: Some("ok"), ..entry(&case, "m", Some(answer)) }
        };
        let unsure = Entry { status: Some("weak-tilt"), ..with(50.0, 50.0) };
        let entries = [with(1.0, 0.5), with(3.0, 1.5), with(-1.5, 4.0), with(0.1, 0.2), unsure];
        let shown = pb3dp_benchmarks::table::row(&COLUMNS, &row(&entries));
        assert_eq!(shown, "| m | 5, 4 | 1.50 / 4.00 | 75, 75 | 1 |\n");
    }
}
