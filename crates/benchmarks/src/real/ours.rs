//! Our own methods on a case.

use nalgebra::Vector2;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, VisiblePoint};
use pb3dp_record::images::DisparityMap;
use pb3dp_record::metrics::{self, DisparityAgreement, compare_plane};
use pb3dp_record::overlay::mask::polygon_pixels;

use super::cases::Prepared;
use super::score::{Answer, Entry, Maker, SurfaceScore};
use pb3dp_hal_platform::cpu_time::timed;

/// Runs a method with its default parameters: one estimator, called `repeat` times. The answer is that of the first call,
/// the time the median of all calls. Measurements once per rig or scene run before and are timed separately. A rejected
/// case has no answer; the reason goes to standard error.
pub fn run(case: &Prepared, method: Method, repeat: u32) -> Entry {
    let mut entry = Entry { status: Some("error"), ..Entry::new(&case.facts, method.name(), Maker::Ours) };
    if let Err(error) = fill(&mut entry, case, method, repeat) {
        eprintln!("{}: {method}: {error:#}", case.facts.name);
    }
    entry
}

fn fill(entry: &mut Entry, case: &Prepared, method: Method, repeat: u32) -> anyhow::Result<()> {
    let mut estimator = Estimator::new(method, &case.rig, &EstimatorConfig::default())?;
    let (prepared, rows_ms) = timed(|| estimator.look(&case.images.left, &case.images.right));
    prepared?;
    entry.rows_ms = (method == Method::Direct).then_some(rows_ms);
    let mut estimate_timed = || {
        timed(|| {
            estimator.estimate(EstimateRequest::new_target(
                &case.images.left,
                &case.images.right,
                &case.region,
                &case.range,
            ))
        })
    };
    let (first, first_ms) = estimate_timed();
    let first = first?;
    let mut times = vec![first_ms];
    for _ in 1..repeat {
        let (again, ms) = estimate_timed();
        again?;
        times.push(ms);
    }
    entry.status = Some(first.status.as_str());
    entry.answer = answer_of(case, &first);
    entry.ms = metrics::median(&times);
    entry.first_ms = Some(first_ms);
    if let Some(truth) = case.disparity.as_ref().filter(|_| !case.facts.is_planar()) {
        let request = EstimateRequest::new_target(&case.images.left, &case.images.right, &case.region, &case.range);
        let points = estimator.visible_surface(&request).ok();
        entry.surface = points.and_then(|points| surface_score(case, &points, truth));
    }
    Ok(())
}

/// Compares the points of a rectified pair with the true disparities; `None` without points.
fn surface_score(case: &Prepared, points: &[VisiblePoint], truth: &DisparityMap) -> Option<SurfaceScore> {
    let (left, right) = (case.rig.left().pinhole(), case.rig.right().pinhole());
    let (mut within, mut in_2_sigmas, mut compared) = (0_usize, 0_usize, 0_usize);
    for point in points {
        let VisiblePoint { pixel_px, position_in_cam_left_m: at_m, sigma_m, .. } = point;
        let Some(known_px) = truth.at(pixel_px.x.round() as u32, pixel_px.y.round() as u32) else { continue };
        let per_m = left.fx * case.rig.baseline_m() / at_m.z;
        let error_px = (per_m - (right.cx - left.cx) - known_px).abs();
        let sigma_px = per_m * sigma_m / at_m.coords.norm();
        compared += 1;
        within += usize::from(error_px < 1.0);
        in_2_sigmas += usize::from(error_px <= 2.0 * sigma_px);
    }
    let all = region_truths(case, truth).max(1) as f64;
    (compared > 0)
        .then(|| SurfaceScore { within_1px: within as f64 / all, in_2_sigmas: in_2_sigmas as f64 / compared as f64 })
}

/// Number of pixels of the region with a known disparity.
fn region_truths(case: &Prepared, truth: &DisparityMap) -> usize {
    let mut known = 0;
    polygon_pixels(&case.polygon_px, truth.size(), |u, v| known += usize::from(truth.at(u, v).is_some()));
    known
}

/// The estimated plane compared with the truth; `None` without a plane.
pub fn answer_of(case: &Prepared, estimate: &PlaneEstimate) -> Option<Answer> {
    let [u, v] = case.centroid_px;
    let plane = metrics::PlaneEstimate {
        z_m: estimate.depth_at_pixel(&Vector2::new(u, v))?,
        normal_in_cam_left: estimate.normal_in_cam_left()?,
    };
    let error = compare_plane(&plane, &case.truth);
    let agreement = case
        .disparity
        .as_ref()
        .and_then(|map| DisparityAgreement::of(&plane, case.centroid_px, &case.rig, &case.polygon_px, map));
    Some(Answer {
        z_m: error.z_m,
        normal_rad: error.normal_rad,
        disparity_px: error.disparity_px,
        z_sigma_m: estimate.z_sigma_m,
        normal_sigma_rad: estimate.normal_sigma_rad,
        map: agreement.map(|found| (found.median_abs_px, found.share_within_1px)),
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::real::cases::load;
    use crate::real::score::Grade;

    #[test]
    fn what_is_measured_once_per_rig_has_a_time_of_its_own() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases/bb209_c0");
        let case = load(&folder).expect("loads").expect("has a truth");
        let entry = run(&case, Method::Direct, 1);
        assert_eq!(entry.grade(), Some(Grade::Pass), "{entry:?}");
        assert!(entry.rows_ms.is_some_and(|ms| ms > 0.0) && entry.ms.is_some(), "{entry:?}");
        assert_eq!(run(&case, Method::Published, 1).rows_ms, None);
    }

    #[test]
    fn a_plane_is_compared_at_the_centroid_of_the_case() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases/bb201_c0");
        let case = load(&folder).expect("loads").expect("has a truth");
        let entry = run(&case, Method::Published, 1);
        assert!(entry.status != Some("error") && entry.ms == entry.first_ms && entry.ms > Some(0.0), "{entry:?}");
        // A colourless board is hard for the published method; where it answers, its error fields are consistent.
        if let Some(answer) = entry.answer {
            let grade = entry.grade().expect("there is an answer");
            assert_eq!(grade == Grade::Pass, answer.z_m.abs() <= 0.01 * case.truth.z_m && answer.normal_rad < 0.0873);
        }
    }
}
