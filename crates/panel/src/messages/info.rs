//! The facts that do not change: `GET /api/info`.

use pb3dp_cell::calibration_facts::CalibrationFacts;
use pb3dp_estimation_core::status::SCHEMA_VERSION;
use pb3dp_geometry::Camera;
use pb3dp_kinematics::JointLimits;
use serde::Serialize;

use super::socket::PROTOCOL;
use super::{Transform, Triple, transform, transform_of};
use crate::facts::{About, AboutArm};

/// Answer of `GET /api/info`.
#[derive(Clone, Debug, Serialize)]
pub struct Info {
    protocol: u32,
    schema_version: u32,
    version: String,
    setup: String,
    emulated: bool,
    simulated: bool,
    playground: bool,
    hold_to_run: bool,
    silent_after_ms: u64,
    has_images: bool,
    cameras: Cameras,
    arms: Vec<Arm>,
    hand_from_cam_left: Option<Transform>,
}

/// Facts of the panel, not of the setup.
#[derive(Clone, Copy, Debug)]
pub struct PanelFacts {
    /// Whether the simulated target can be pushed.
    pub playground: bool,
    /// Whether motion needs a pressed button.
    pub hold_to_run: bool,
    /// Longest silence.
    pub silent_after_ms: u64,
}

#[derive(Clone, Debug, Serialize)]
struct Cameras {
    size_px: [u32; 2],
    left: Lens,
    right: Lens,
    cam_right_from_cam_left: Transform,
    calibrated: bool,
    calibration: String,
    calibrations: Vec<CalibrationFacts>,
}

#[derive(Clone, Debug, Serialize)]
struct Lens {
    focal_px: [f64; 2],
    center_px: [f64; 2],
    distortion: Vec<f64>,
}

#[derive(Clone, Debug, Serialize)]
struct Arm {
    name: String,
    joints: usize,
    limits: Vec<Limit>,
    world_from_base: Transform,
    chain: Vec<Transform>,
    axis: Vec<Triple>,
    flange_from_tool: Transform,
}

#[derive(Clone, Debug, Serialize)]
struct Limit {
    mechanical_deg: [f64; 2],
    servo_deg: [f64; 2],
    operating_deg: [f64; 2],
    gateway_deg: Option<[f64; 2]>,
    drive_speed_deg_per_s: f64,
    speed_deg_per_s: f64,
    gateway_speed_deg_per_s: Option<f64>,
}

impl Info {
    /// The answer.
    pub fn new(about: &About, facts: PanelFacts) -> Self {
        let size = about.stereo.left().size();
        Self {
            protocol: PROTOCOL,
            schema_version: SCHEMA_VERSION,
            version: about.version.clone(),
            setup: about.setup.clone(),
            emulated: about.is_emulated,
            simulated: about.is_simulated,
            playground: facts.playground,
            hold_to_run: facts.hold_to_run,
            silent_after_ms: facts.silent_after_ms,
            has_images: about.has_images,
            cameras: Cameras {
                size_px: [size.width, size.height],
                left: lens(about.stereo.left()),
                right: lens(about.stereo.right()),
                cam_right_from_cam_left: transform_of(about.stereo.cam_right_from_cam_left()),
                calibrated: about.is_calibrated,
                calibration: about.calibration.clone(),
                calibrations: about.calibrations.clone(),
            },
            arms: about.arms.iter().map(arm).collect(),
            hand_from_cam_left: about.hand.as_ref().map(|hand| transform_of(&hand.hand_from_cam_left)),
        }
    }
}

fn lens(camera: &Camera) -> Lens {
    let pinhole = camera.pinhole();
    Lens {
        focal_px: [pinhole.fx, pinhole.fy],
        center_px: [pinhole.cx, pinhole.cy],
        distortion: camera.distortion().coefficients().to_vec(),
    }
}

fn arm(arm: &AboutArm) -> Arm {
    let joints = arm.chain.joints();
    let (servo, operating) = (arm.limits.servo(), arm.limits.operating());
    let range = |limits: &JointLimits, joint: usize| {
        [limits.position_min_rad(), limits.position_max_rad()].map(|end_rad| end_rad[joint].to_degrees())
    };
    let limit = |joint: usize| Limit {
        mechanical_deg: arm.mechanical_rad.map(|end_rad| end_rad[joint].to_degrees()),
        servo_deg: range(servo, joint),
        operating_deg: range(operating, joint),
        gateway_deg: arm.gateway.map(|gateway| gateway.range_rad.map(|end_rad| end_rad[joint].to_degrees())),
        drive_speed_deg_per_s: servo.velocity_max_rad_per_s()[joint].to_degrees(),
        speed_deg_per_s: arm.limits.velocity_max_rad_per_s()[joint].to_degrees(),
        gateway_speed_deg_per_s: arm.gateway.map(|gateway| gateway.speed_max_rad_per_s[joint].to_degrees()),
    };
    let (links, axes) = arm.links();
    Arm {
        name: arm.name.clone(),
        joints,
        limits: (0..joints).map(limit).collect(),
        world_from_base: transform_of(&arm.world_from_base),
        chain: links.iter().map(transform).collect(),
        axis: axes.into_iter().map(Into::into).collect(),
        flange_from_tool: transform(&arm.flange_from_tool),
    }
}
