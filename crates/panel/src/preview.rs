//! Previews: what a region would give as a target, before it is selected. One at a time; the newest request wins.

use std::time::Duration;

use nalgebra::{Matrix6, Vector2};
use pb3dp_estimation::estimator::{EstimateRequest, Method, SurfacePoint, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_estimation_core::status::Status;
use pb3dp_hal_api::FramePair;
use pb3dp_hal_platform::cpu_time::{timed, within};

use crate::drawing::{axes, outline_right};
use crate::facts::About;
use crate::hub::Hub;
use crate::messages::{pixels, sigmas};
use crate::preview_job::{Preview, PreviewJob};
use crate::refusal::Refusal;

/// Time between two checks whether the panel ends.
const LOOK: Duration = Duration::from_millis(50);
/// Processor time of one preview, milliseconds: on a busy computer a preview comes later, and is as good.
const TIME_MAX_MILLIS: f64 = 400.0;

/// Standard deviations up to which a first pose needs no advice: of a tilt, and of the depth relative to it.
const TILT_SIGMA_CERTAIN_RAD: f64 = 0.004;
const DEPTH_SIGMA_CERTAIN: f64 = 0.002;
/// Root mean square of the relief that counts as flat, pixels of disparity, as for the tracker.
const FLAT_PX: f64 = 0.2;

/// Answers previews until the panel ends.
pub fn run(hub: &Hub) {
    let mut tracker = None;
    while !hub.is_over() {
        let Some(PreviewJob { region, pair, answer }) = hub.previews.wait(LOOK) else { continue };
        if answer.is_closed() {
            continue;
        }
        let (result, ms) = timed(|| preview(&hub.about, &mut tracker, &region, &pair));
        // Who asked may be gone.
        let _ = answer.send(result.map(|preview| Preview { ms, ..preview }));
    }
}

fn preview(
    about: &About,
    tracker: &mut Option<Tracker>,
    region: &Region,
    pair: &FramePair,
) -> Result<Preview, Refusal> {
    let unusable = |error: &dyn std::error::Error| Refusal::Region { why: error_text(error) };
    let mut result = Preview {
        will_work: false,
        why: String::new(),
        status: Status::Error.as_str(),
        outline_px: Vec::new(),
        outline_right_px: Vec::new(),
        axes_px: None,
        depth_mm: None,
        sigma_mm: None,
        sigma_deg: None,
        ms: 0.0,
        sequence: pair.sequence,
    };
    let outline_px = match region.rasterize(&pair.left, &RegionConfig::default()) {
        Ok(mask) => region.outline_px(&mask),
        Err(error) => {
            result.why = error_text(&error);
            return Ok(result);
        }
    };
    result.outline_px = pixels(&outline_px);
    // The method of a run: it also accepts surfaces that are not flat.
    let tracker = match tracker {
        Some(tracker) => tracker,
        None => {
            let new =
                Tracker::new(Method::Direct, &about.stereo, &about.estimator).map_err(|error| unusable(&error))?;
            tracker.insert(new.with_calibration(about.calibration_term.clone()))
        }
    };
    let mut may_continue = within(Some(TIME_MAX_MILLIS));
    let request = EstimateRequest::new_target(&pair.left, &pair.right, region, &about.range).until(&mut may_continue);
    match tracker.estimate(request) {
        Ok(estimate) => {
            fill(&mut result, about, &estimate, &outline_px);
            let advice = advice(about, &estimate, &tracker.surface());
            result.why = [std::mem::take(&mut result.why), advice]
                .into_iter()
                .filter(|part| !part.is_empty())
                .collect::<Vec<_>>()
                .join("; ");
        }
        Err(error) => result.why = error_text(&error),
    }
    Ok(result)
}

fn fill(result: &mut Preview, about: &About, estimate: &TrackEstimate, outline_px: &[Vector2<f64>]) {
    result.status = estimate.status.as_str();
    result.will_work = estimate.status.depth_is_sure();
    result.why = why(estimate);
    let Some(cam_left_from_model) = &estimate.cam_left_from_model else { return };
    result.depth_mm = Some(cam_left_from_model.translation_m().z * 1e3);
    result.outline_right_px = outline_right(outline_px, &about.stereo, cam_left_from_model);
    [result.axes_px, _] = axes(&about.stereo, cam_left_from_model);
    (result.sigma_mm, result.sigma_deg) = sigmas(estimate.pose_covariance.as_ref()).unzip();
}

/// What would make the first pose more certain, if it is not as certain as it can be; empty otherwise.
fn advice(about: &About, estimate: &TrackEstimate, surface: &[SurfacePoint]) -> String {
    let Some((covariance, pose)) = estimate.pose_covariance.zip(estimate.cam_left_from_model) else {
        return String::new();
    };
    let depth_m = pose.translation_m().z;
    let shares = |of: &Matrix6<f64>| {
        let tilt = of[(3, 3)].max(of[(4, 4)]) / TILT_SIGMA_CERTAIN_RAD.powi(2);
        tilt.max(of[(2, 2)] / (DEPTH_SIGMA_CERTAIN * depth_m).powi(2))
    };
    if shares(&covariance) <= 1.0 {
        return String::new();
    }
    let of_calibration = estimate.calibration.map_or(0.0, |share| shares(&share.pose));
    let relief_m = {
        let squares: f64 = surface.iter().map(|point| point.position_in_model_m.z.powi(2)).sum();
        (squares / surface.len().max(1) as f64).sqrt()
    };
    let depth_per_px = depth_m.powi(2) / (about.stereo.left().pinhole().fx * about.stereo.baseline_m());
    if of_calibration > 0.5 * shares(&covariance) {
        "the calibration is the least certain part of this: calibrate again".to_owned()
    } else if relief_m > FLAT_PX * depth_per_px {
        "curved: mark more of it, or a flat part, and the first pose is more certain".to_owned()
    } else {
        "mark a larger part with more texture, and the first pose is more certain".to_owned()
    }
}

/// One plain line: what is wrong, the measured reason, the remedy.
fn why(estimate: &TrackEstimate) -> String {
    let reason = &estimate.reason;
    let line = match estimate.status {
        Status::Ok => String::new(),
        Status::WeakTilt => format!("{reason}; choose a larger part with more texture, and the tilt is determined"),
        Status::PartlyObserved => {
            format!("{reason}; choose a part with texture in all directions if the hand is to follow these, too")
        }
        Status::WeakDepth => format!("the depth is not determined: {reason}; choose a larger part with more texture"),
        Status::Ambiguous => format!(
            "two or more poses explain the images equally well: {reason}; choose a larger part, or one without a repeated pattern"
        ),
        Status::NotObservable => {
            format!("the pose cannot be determined: {reason}; choose a part with more texture that both cameras see")
        }
        Status::Miscalibrated | Status::Lost | Status::Error => reason.clone(),
    };
    let warnings = estimate.warnings.iter().map(ToString::to_string);
    let lines = std::iter::once(line).filter(|line| !line.is_empty()).chain(warnings);
    lines.collect::<Vec<_>>().join("; ")
}

/// An error with its causes.
fn error_text(error: &dyn std::error::Error) -> String {
    let mut full_text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let text = cause.to_string();
        if !full_text.ends_with(&text) {
            full_text = format!("{full_text}: {text}");
        }
        source = cause.source();
    }
    full_text
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3, Vector6};
    use pb3dp_estimation_core::estimate::CalibrationShare;
    use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

    use super::*;

    fn about() -> About {
        let pinhole = Pinhole { fx: 740.0, fy: 738.0, cx: 321.0, cy: 238.0 };
        let camera = Camera::new(ImageSize { width: 640, height: 480 }, pinhole, Distortion::None).unwrap();
        let rig = StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.002, -0.001))).unwrap();
        let range =
            pb3dp_estimation_core::plane_hypothesis::SearchRange { z_min_m: 0.3, z_max_m: 1.0, tilt_max_rad: 1.0 };
        About::of_cameras(rig, "two", "0", range)
    }

    #[test]
    fn the_advice_names_what_the_first_pose_lacks() {
        let about = about();
        let with = |sigmas: [f64; 6]| {
            let turn = UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3);
            let covariance = Matrix6::from_diagonal(&Vector6::from(sigmas).map(|sigma| sigma * sigma));
            TrackEstimate {
                cam_left_from_model: Some(Pose::from_parts(Vector3::new(0.02, -0.01, 0.5), turn)),
                pose_covariance: Some(covariance),
                ..TrackEstimate::without_pose(Status::Ok, String::new())
            }
        };
        let surface = |relief_m: f64| -> Vec<SurfacePoint> {
            let point = |k: u32| SurfacePoint {
                position_in_model_m: nalgebra::Point3::new(
                    0.01,
                    0.0,
                    if k.is_multiple_of(2) { relief_m } else { -relief_m },
                ),
                normal_in_model: Vector3::new(0.0, 0.0, -1.0),
                sigma_m: 1e-4,
                rgb: [0; 3],
            };
            (0..40).map(point).collect()
        };
        let sure = with([1e-4, 1e-4, 3e-4, 1e-3, 1e-3, 1e-3]);
        assert_eq!(advice(&about, &sure, &surface(5e-3)), "");
        let unsure = with([1e-4, 1e-4, 3e-4, 1e-2, 1e-3, 1e-3]);
        assert!(advice(&about, &unsure, &surface(5e-3)).contains("curved: mark more of it"));
        assert!(advice(&about, &unsure, &surface(1e-4)).contains("mark a larger part"));
        let covariance = unsure.pose_covariance.unwrap() * 0.9;
        let calibration = Some(CalibrationShare { pose: covariance, motion: covariance });
        assert!(advice(&about, &TrackEstimate { calibration, ..unsure }, &surface(5e-3)).contains("calibrate again"));
        assert_eq!(advice(&about, &TrackEstimate::without_pose(Status::Lost, String::new()), &[]), "");
    }
}
