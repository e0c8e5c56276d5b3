//! Conditions that disturb the cameras of a sequence: exposure steps, motion blur, skew, rolling shutter.

use image::RgbImage;
use pb3dp_sim::raster::{Exposure, Shutter, StereoRenderer};
use pb3dp_sim::scene::ScenePoses;
use pb3dp_sim::sensor::CameraResponse;

use super::cell::Condition;
use super::scenes::sensor;
use super::sequences::SequenceSpec;

/// Frames between two steps of the exposure: a fifth of a second at 30 frames per second, so that the tracker has settled
/// before the next step.
const STEP_FRAMES: usize = 6;

/// Moments of an exposure, or of the rows of the target. At 80 mm/s and 500 mm the target moves by 0.13 px between two
/// moments of 10 ms of blur, and by less between those of a rolling shutter.
const MOMENTS: usize = 9;

/// Rows around the target's outline that a rolling shutter renders with their own times.
const MARGIN_ROWS: f64 = 12.0;

/// Responses of the cameras in a frame.
fn responses(condition: Condition, spec: &SequenceSpec, frame: usize) -> [CameraResponse; 2] {
    let nominal = sensor(&spec.setup);
    let Condition::ExposureSteps { factor, only_right } = condition else { return [nominal.left, nominal.right] };
    let now = match frame / STEP_FRAMES % 4 {
        1 => factor,
        3 => 1.0 / factor,
        _ => 1.0,
    };
    let exposed = |response: CameraResponse| CameraResponse { exposure: response.exposure * now, ..response };
    [if only_right { nominal.left } else { exposed(nominal.left) }, exposed(nominal.right)]
}

/// Renders a frame of a sequence.
///
/// # Errors
/// If the simulator rejects the exposure.
pub fn render(
    spec: &SequenceSpec,
    frame: usize,
    renderer: &mut StereoRenderer,
    left: &mut RgbImage,
    right: &mut RgbImage,
) -> anyhow::Result<()> {
    let condition = spec.condition;
    if let Condition::ExposureSteps { .. } = condition {
        renderer.set_responses(responses(condition, spec, frame))?;
    }
    let time_s = spec.time_s(frame);
    let ([left_moments, right_moments], shutter) = moments(condition, spec, time_s, renderer);
    let exposures = [&left_moments, &right_moments].map(|moments| Exposure { moments, shutter });
    Ok(renderer.render_exposures(exposures, frame as u64, left, right)?)
}

fn moments(
    condition: Condition,
    spec: &SequenceSpec,
    time_s: f64,
    renderer: &StereoRenderer,
) -> ([Vec<ScenePoses>; 2], Shutter) {
    let spread = |first_s: f64, last_s: f64| -> Vec<ScenePoses> {
        let share = |k: usize| k as f64 / (MOMENTS - 1) as f64;
        (0..MOMENTS).map(|k| spec.poses_at(time_s + first_s + share(k) * (last_s - first_s))).collect()
    };
    match condition {
        Condition::Undisturbed | Condition::ExposureSteps { .. } => {
            ([vec![spec.poses_at(time_s)], vec![spec.poses_at(time_s)]], Shutter::Global)
        }
        Condition::Skew { delay_s, .. } => {
            ([vec![spec.poses_at(time_s)], vec![spec.poses_at(time_s + delay_s)]], Shutter::Global)
        }
        Condition::Blur { exposure_s } => {
            // The middles of equal parts of the exposure.
            let half = 0.5 * exposure_s * (1.0 - 1.0 / MOMENTS as f64);
            let moments = spread(-half, half);
            ([moments.clone(), moments], Shutter::Global)
        }
        Condition::RollingShutter { readout_s } => {
            let poses = spec.poses_at(time_s);
            let Some([first, origin, last]) = rows_of_target(&poses, renderer) else {
                return ([vec![poses], vec![poses]], Shutter::Global);
            };
            let per_row_s = readout_s / f64::from(renderer.size().height);
            let moments = spread((first - origin) * per_row_s, (last - origin) * per_row_s);
            ([moments.clone(), moments], Shutter::Rolling { first: first as i32, last: last as i32 })
        }
    }
}

/// First row of the target, row of its origin, and last row, whole rows except for the origin.
fn rows_of_target(poses: &ScenePoses, renderer: &StereoRenderer) -> Option<[f64; 3]> {
    let outline_px = renderer.target_outline_px(poses)?;
    let low = outline_px.iter().map(|px| px.y).fold(f64::INFINITY, f64::min);
    let high = outline_px.iter().map(|px| px.y).fold(f64::NEG_INFINITY, f64::max);
    let cam_left_from_target = poses.world_from_cam_left.inverse() * poses.world_from_target;
    let origin = renderer.rig().left().project(&cam_left_from_target.translation_m().into())?;
    Some([(low - MARGIN_ROWS).floor(), origin.y, (high + MARGIN_ROWS).ceil()])
}

#[cfg(test)]
mod tests {
    use super::super::scenes::{SceneStore, rigs};
    use super::*;

    fn exposed(condition: Condition) -> ([Vec<ScenePoses>; 2], Shutter, SequenceSpec) {
        let spec = SequenceSpec { condition, ..super::super::sequences::all().remove(0) };
        let scene = SceneStore::default().scene(&spec.setup).unwrap();
        let rig = rigs(&spec.setup).unwrap().real;
        let renderer = StereoRenderer::new(scene, rig, &sensor(&spec.setup), 1).unwrap();
        let (moments, shutter) = moments(condition, &spec, 0.5, &renderer);
        (moments, shutter, spec)
    }

    #[test]
    fn the_row_of_the_origin_shows_the_time_of_the_frame() {
        let (moments, shutter, spec) = exposed(Condition::RollingShutter { readout_s: 0.02 });
        let Shutter::Rolling { first, last } = shutter else { panic!("{shutter:?}") };
        // 0.02 s for 480 rows; the target has about 150 of them.
        assert!((100..260).contains(&(last - first)), "{first} {last}");
        let at = |time_s: f64| spec.poses_at(time_s).world_from_target.translation_m();
        let whole_s = f64::from(last - first) * 0.02 / 480.0;
        let shown =
            moments[0][MOMENTS - 1].world_from_target.translation_m() - moments[0][0].world_from_target.translation_m();
        let true_shift = at(0.5 + 0.5 * whole_s) - at(0.5 - 0.5 * whole_s);
        assert!((shown - true_shift).norm() < 0.05 * true_shift.norm(), "{shown} {true_shift}");
        assert_eq!(moments[0].len(), moments[1].len());
    }

    #[test]
    fn blur_is_centred_and_skew_is_that_of_the_right_camera() {
        let (moments, shutter, spec) = exposed(Condition::Blur { exposure_s: 0.01 });
        assert_eq!((shutter, moments[0].len()), (Shutter::Global, MOMENTS));
        assert_eq!(moments[0][MOMENTS / 2], spec.poses_at(0.5));
        let (moments, _, spec) = exposed(Condition::Skew { delay_s: 0.005, is_known: true });
        assert_eq!((moments[0][0], moments[1][0]), (spec.poses_at(0.5), spec.poses_at(0.505)));
    }

    #[test]
    fn exposures_step_up_and_down_in_one_camera_or_both() {
        let spec = super::super::sequences::all().remove(0);
        let at = |only_right: bool, frame: usize| {
            let responses = responses(Condition::ExposureSteps { factor: 1.5, only_right }, &spec, frame);
            responses.map(|response| response.exposure)
        };
        assert_eq!([at(false, 0), at(false, 5), at(false, 6), at(false, 12)], [[1.0; 2], [1.0; 2], [1.5; 2], [1.0; 2]]);
        assert_eq!(at(true, 6), [1.0, 1.5]);
        assert_eq!(at(true, 18), [1.0, 1.0 / 1.5]);
    }
}
