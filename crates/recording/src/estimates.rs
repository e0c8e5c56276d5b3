//! Estimates of pairs as messages and back.

use anyhow::{Context, Result};
use nalgebra::Vector2;
use pb3dp_bag::cdr::Later;
use pb3dp_bag::run_messages::{Chosen, PairResult};
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::perception::View;
use pb3dp_cell::selection::Choice;
use pb3dp_estimation_core::estimate::{SurfaceEstimate, TrackEstimate};
use pb3dp_estimation_core::method::KnownModel;

use crate::exact::{covariance, of_covariance, of_pose_if_any, of_region, pose_if_any, same_bits};

/// An estimate with everything that it depended on.
pub fn pair_result(pair_estimate: &PairEstimate) -> PairResult {
    let PairEstimate { captured, estimate, .. } = pair_estimate;
    let chosen = pair_estimate.chosen.as_ref().map(|choice| match choice {
        Choice::OfSetup => Chosen { kind: "of setup".to_owned(), region: Default::default(), drawn_on: Vec::new() },
        Choice::Marked(selection) => Chosen {
            kind: "marked".to_owned(),
            region: of_region(&selection.region),
            drawn_on: selection.drawn_on.iter().map(|pair| pair.sequence).collect(),
        },
    });
    let surface = estimate.surface.as_ref();
    let model = match &pair_estimate.chosen {
        Some(Choice::Marked(selection)) => selection.model.as_deref(),
        Some(Choice::OfSetup) | None => None,
    };
    PairResult {
        sequence: captured.frame.sequence,
        exposed_at_nanos: captured.frame.at.as_nanos(),
        skew_s: captured.frame.skew_s,
        has_images: matches!(captured.view, View::Images(_)),
        steps: pair_estimate.steps,
        chosen: chosen.into_iter().collect(),
        cam_left_from_target: of_pose_if_any(captured.cam_left_from_target.as_ref()),
        cam_left_prev_from_cam_left_now: of_pose_if_any(pair_estimate.prior.cam_left_prev_from_cam_left_now.as_ref()),
        since_previous_s: pair_estimate.prior.dt_s.into_iter().collect(),
        target: pair_estimate.target,
        region: pair_estimate.region.iter().map(of_region).collect(),
        status: estimate.status.to_string(),
        reason: estimate.reason.clone(),
        cam_left_from_model: of_pose_if_any(estimate.cam_left_from_model.as_ref()),
        covariance: of_covariance(estimate.covariance.as_ref()),
        fitness: estimate.fitness.into_iter().collect(),
        observed: estimate.observed.iter().flatten().copied().collect(),
        rotation_about_normal_observed: estimate.rotation_about_normal_observed,
        outline_px: estimate.outline_px.iter().flat_map(|corner| [corner.x, corner.y]).collect(),
        latency_millis: pair_estimate.latency_millis,
        age_millis: pair_estimate.age_millis,
        first_pose_covariance: Later(of_covariance(estimate.first_pose_covariance.as_ref())),
        pose_covariance: Later(of_covariance(estimate.pose_covariance.as_ref())),
        surface_from_model: Later(of_pose_if_any(surface.map(|known| &known.surface_from_model))),
        surface_covariance: Later(of_covariance(surface.map(|known| &known.covariance))),
        surface_version: Later(surface.iter().map(|known| known.version).collect()),
        chosen_model: Later(of_pose_if_any(model.map(|known| &known.cam_left_from_model))),
        chosen_model_covariance: Later(of_covariance(model.map(|known| &known.first_pose_covariance))),
    }
}

/// The recorded estimate; without the hypothesis of a search, which nothing after the estimation uses.
///
/// # Errors
/// Names the damaged field.
pub fn recorded_estimate(result: &PairResult) -> Result<TrackEstimate> {
    let observed = match &result.observed[..] {
        [] => None,
        six => Some(six.try_into().context("observed: a pose has six directions")?),
    };
    let corner = |pair: &[f64]| Vector2::new(pair[0], pair[1]);
    Ok(TrackEstimate {
        cam_left_from_model: pose_if_any("cam_left_from_model", &result.cam_left_from_model)?,
        covariance: covariance("covariance", &result.covariance)?,
        first_pose_covariance: covariance("first_pose_covariance", &result.first_pose_covariance.0)?,
        pose_covariance: covariance("pose_covariance", &result.pose_covariance.0)?,
        surface: recorded_surface(result)?,
        fitness: result.fitness.first().copied(),
        outline_px: result.outline_px.chunks_exact(2).map(corner).collect(),
        observed,
        rotation_about_normal_observed: result.rotation_about_normal_observed,
        ..TrackEstimate::without_pose(result.status.parse().context("status")?, result.reason.clone())
    })
}

/// The frame `model` that a chosen target had before.
///
/// # Errors
/// Names the damaged field.
pub fn recorded_model(result: &PairResult) -> Result<Option<KnownModel>> {
    let cam_left_from_model = pose_if_any("chosen_model", &result.chosen_model.0)?;
    let covariance = covariance("chosen_model_covariance", &result.chosen_model_covariance.0)?;
    let known = cam_left_from_model.zip(covariance);
    Ok(known
        .map(|(cam_left_from_model, first_pose_covariance)| KnownModel { cam_left_from_model, first_pose_covariance }))
}

fn recorded_surface(result: &PairResult) -> Result<Option<SurfaceEstimate>> {
    let surface_from_model = pose_if_any("surface_from_model", &result.surface_from_model.0)?;
    let covariance = covariance("surface_covariance", &result.surface_covariance.0)?;
    let version = result.surface_version.0.first().copied();
    let all = surface_from_model.zip(covariance).zip(version);
    Ok(all.map(|((surface_from_model, covariance), version)| SurfaceEstimate {
        surface_from_model,
        covariance,
        version,
    }))
}

/// Whether two estimates are equal to the bit. Times of the computation do not count, nor does a surface that a version before did not record.
pub fn is_same_estimate(one: &PairResult, other: &PairResult) -> bool {
    let surfaces = [one, other].map(|result| &result.surface_from_model.0);
    one.status == other.status
        && one.target == other.target
        && one.observed == other.observed
        && same_bits(&one.cam_left_from_model, &other.cam_left_from_model)
        && same_bits(&one.covariance, &other.covariance)
        && (surfaces.iter().any(|surface| surface.is_empty()) || same_bits(surfaces[0], surfaces[1]))
        && same_bits(&one.fitness, &other.fitness)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix6, UnitQuaternion, Vector3};
    use pb3dp_geometry::Pose;
    use pb3dp_geometry::frames::{CamLeft, Model};

    use super::*;

    #[test]
    fn the_surface_and_the_model_of_a_chosen_target_return_to_the_bit() {
        let turn = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3);
        let covariance = Matrix6::from_fn(|i, j| 1e-7 / (1.0 + i as f64 + 3.0 * j as f64));
        let (near, far) = (Vector3::new(0.001, -0.002, 0.0), Vector3::new(0.02, -0.01, 0.5));
        let result = PairResult {
            surface_from_model: Later(of_pose_if_any(Some(&Pose::<CamLeft, Model>::from_parts(near, turn)))),
            surface_covariance: Later(of_covariance(Some(&covariance))),
            surface_version: Later(vec![3]),
            chosen_model: Later(of_pose_if_any(Some(&Pose::<CamLeft, Model>::from_parts(far, turn)))),
            chosen_model_covariance: Later(of_covariance(Some(&covariance.transpose()))),
            ..PairResult::default()
        };
        let surface = recorded_surface(&result).unwrap().unwrap();
        assert_eq!(surface.surface_from_model, Pose::from_parts(near, turn));
        assert_eq!((surface.covariance, surface.version), (covariance, 3));
        let known = recorded_model(&result).unwrap().unwrap();
        assert_eq!(known.cam_left_from_model, Pose::from_parts(far, turn));
        assert_eq!(known.first_pose_covariance, covariance.transpose());
        let before = PairResult::default();
        assert!(recorded_surface(&before).unwrap().is_none() && recorded_model(&before).unwrap().is_none());
    }
}
