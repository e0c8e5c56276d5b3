//! The target in the state that clients see.

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{CamLeft, Hand, Model, Surface, World};
use pb3dp_geometry::{MonotonicTime, Pose};

use crate::drawing::{axes, outline_right};
use crate::facts::About;
use crate::messages::state::{JogState, TargetState};
use crate::messages::{degrees, millimetres, pixels, sigmas, transform_of};
use crate::spectator::NewestEstimate;

/// Where the cameras are, and what the desired pose of the hand depends on.
pub struct HandPlace {
    /// Pose of the left camera, by the present joints.
    pub world_from_cam_left: Option<Pose<World, CamLeft>>,
    /// The surface for which the desired pose is meant.
    pub model_from_surface: Pose<Model, Surface>,
    /// The offset of the desired pose.
    pub jog: JogState,
}

/// The target, and the distance and angle of the hand from its desired pose, in millimetres and degrees.
pub fn target_state(
    about: &About,
    newest: Option<&NewestEstimate>,
    &HandPlace { world_from_cam_left, model_from_surface, jog }: &HandPlace,
    now: MonotonicTime,
) -> (TargetState, Option<(f64, f64)>) {
    let Some(newest) = newest else {
        let reason = "no frame pair yet".to_owned();
        return (TargetState { status: "none", reason, ..TargetState::default() }, None);
    };
    let estimate = &newest.estimate;
    let mut target = TargetState {
        id: newest.target,
        sequence: Some(newest.sequence),
        status: if newest.target.is_some() { estimate.status.as_str() } else { "none" },
        reason: estimate.reason.clone(),
        age_ms: Some(now.saturating_since(newest.at).as_secs_f64() * 1e3),
        latency_ms: Some(newest.latency_millis),
        fitness: estimate.fitness.filter(|fitness| fitness.is_finite()),
        outline_px: pixels(&estimate.outline_px),
        ..TargetState::default()
    };
    let Some(cam_left_from_model) = &estimate.cam_left_from_model else { return (target, None) };
    target.outline_right_px = outline_right(&estimate.outline_px, &about.stereo, cam_left_from_model);
    [target.axes_px, target.axes_right_px] = axes(&about.stereo, cam_left_from_model);
    target.point_mm = Some(millimetres(cam_left_from_model.translation_m()));
    target.cam_left_from_model = Some(transform_of(cam_left_from_model));
    target.world_from_model =
        world_from_cam_left.map(|world_from_cam_left| transform_of(&(world_from_cam_left * *cam_left_from_model)));
    (target.sigma_mm, target.sigma_deg) = sigmas(estimate.pose_covariance.as_ref()).unzip();
    (target.motion_sigma_mm, target.motion_sigma_deg) = sigmas(estimate.covariance.as_ref()).unzip();
    if let Some(cam_left_from_model_true) = &newest.cam_left_from_model_true {
        let error = cam_left_from_model_true.inverse() * *cam_left_from_model;
        target.error_mm = Some(millimetres(error.translation_m()));
        target.error_deg = Some(degrees(error.rotation().scaled_axis()));
    }
    let error = about.hand.as_ref().map(|hand| {
        let desired = |model_from_surface: &Pose<Model, Surface>| {
            *model_from_surface * hand.model_from_hand_desired.relabel() * hand_shift(&jog)
        };
        let model_from_hand_desired = desired(&model_from_surface);
        if let Some(surface) = &estimate.surface {
            let way = model_from_hand_desired.inverse() * desired(&surface.surface_from_model.inverse());
            target.surface_version = Some(surface.version);
            target.realign_mm = Some(way.translation_m().norm() * 1e3);
            target.realign_deg = Some(way.rotation_angle_rad().to_degrees());
        }
        let model_from_hand = (hand.hand_from_cam_left * *cam_left_from_model).inverse();
        let error = model_from_hand_desired.inverse() * model_from_hand;
        (error.translation_m().norm() * 1e3, error.rotation_angle_rad().to_degrees())
    });
    (target, error)
}

/// The jog as an offset of the desired pose of the hand.
pub fn hand_shift(jog: &JogState) -> Pose<Hand, Hand> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(jog.offset_deg).map(f64::to_radians));
    Pose::from_parts(Vector3::from(jog.offset_mm) * 1e-3, rotation)
}
