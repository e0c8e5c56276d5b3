//! A camera without rendering, combined with a simulated tracker.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock};
use pb3dp_sim::camera_faults::{CameraFault, CameraFaultKind, CameraFaults};
use pb3dp_sim::geometric::{GeometricConfig, GeometricFrame, GeometricTracker, Hindrance};
use pb3dp_sim::scene::PoseSource;

use crate::SimCameraConfig;
use crate::faults::{Delivered, Delivery, Plan, bar};
use crate::schedule::ExposureSchedule;

/// Name for messages.
const NAME: &str = "camera without images";

/// Range of brightness factors in which a tracker still works.
const BRIGHTNESS_VISIBLE: std::ops::RangeInclusive<f64> = 0.2..=4.0;
/// Number of frames with low confidence after a step of brightness.
const FRAMES_AFTER_STEP: u32 = 3;
/// Maximum vertical misalignment of the right image for stereo matching, pixels.
const ROWS_OFF_MAX_PX: f64 = 2.0;

/// Exposes at the times of a [`SimStereoCamera`](crate::SimStereoCamera) and returns the result of a tracker: the true pose at
/// mid-exposure, with noise. Number and times of frames are those of the camera with images.
pub struct GeometricCamera {
    tracker: GeometricTracker,
    poses: Box<dyn PoseSource>,
    schedule: ExposureSchedule,
    exposure: Duration,
    plan: Plan,
    delivery: Delivery<GeometricFrame>,
    /// The true pose in the previous frame.
    before: Option<Pose<CamLeft, Target>>,
    /// Brightness factors of both cameras in the previous frame, and the number of frames since they changed.
    brightness: ([f64; 2], u32),
}

impl Delivered for GeometricFrame {
    fn with_content_of(&self, other: &Self) -> Self {
        let Self { sequence, exposed_at, .. } = *self;
        Self { sequence, exposed_at, is_new: false, ..*other }
    }
}

impl GeometricCamera {
    /// A camera whose first exposure begins now.
    ///
    /// # Errors
    /// `Unusable` for a configuration out of its range, with the value.
    pub fn new(
        tracker: GeometricTracker,
        poses: Box<dyn PoseSource>,
        clock: Arc<dyn Clock>,
        config: &SimCameraConfig,
    ) -> Result<Self, CameraError> {
        config.validate()?;
        let plan = Plan::new(CameraFaults::default(), clock.now())?;
        Ok(Self {
            tracker,
            poses,
            schedule: ExposureSchedule::from_now(clock, config),
            exposure: config.exposure,
            plan,
            delivery: Delivery::new(),
            before: None,
            brightness: ([1.0; 2], u32::MAX),
        })
    }

    /// The same camera with these faults and their effect on an image tracker; fault times count from `began`.
    ///
    /// # Errors
    /// `Unusable` for an invalid fault.
    pub fn with_faults(self, faults: CameraFaults, began: MonotonicTime) -> Result<Self, CameraError> {
        Ok(Self { plan: Plan::new(faults, began)?, ..self })
    }

    /// The tracker configuration.
    pub fn config(&self) -> &GeometricConfig {
        self.tracker.config()
    }

    /// Waits for the end of the next exposure.
    ///
    /// # Errors
    /// `Timeout` if there is none in this time, or a fault drops it, `BadPair` if the poses are not finite.
    pub fn next_frame(&mut self, timeout: Duration) -> Result<GeometricFrame, CameraError> {
        let (sequence, start) = self.schedule.wait_for_next(NAME, timeout)?;
        let exposed_at = start + self.exposure / 2;
        let poses = self.poses.poses_at(exposed_at);
        let cam_left_from_target = poses.world_from_cam_left.inverse() * poses.world_from_target;
        if !cam_left_from_target.is_finite() {
            let message = format!("{NAME}: the poses at {} s are not finite: {poses:?}", exposed_at.as_secs_f64());
            return Err(CameraError::new(CameraErrorKind::BadPair, message));
        }
        let sighting = self.tracker.look(&cam_left_from_target, sequence);
        let mut frame = GeometricFrame {
            sequence,
            exposed_at,
            skew_nanos: 0,
            is_new: true,
            sighting,
            hindrance: None,
            cam_left_from_target,
        };
        let faults = self.plan.at(sequence, exposed_at);
        self.hindrances(&mut frame, &faults);
        self.before = Some(cam_left_from_target);
        self.delivery.deliver(frame, &faults)
    }

    /// Effect of faults on a tracker of the images.
    fn hindrances(&mut self, frame: &mut GeometricFrame, faults: &[CameraFault]) {
        let mut brightness = [1.0; 2];
        for fault in faults {
            let hindrance = match fault.kind {
                CameraFaultKind::Black { .. } => Some(Hindrance::Blind("an image is black")),
                CameraFaultKind::Saturated { .. } => Some(Hindrance::Blind("an image is saturated")),
                CameraFaultKind::Torn { .. } => Some(Hindrance::Blind("the images are of two exposures")),
                CameraFaultKind::Brightness { cameras, factor } => {
                    for (side, _) in brightness.iter_mut().zip(cameras.are()).filter(|(_, is)| *is) {
                        *side *= factor;
                    }
                    (!BRIGHTNESS_VISIBLE.contains(&factor))
                        .then_some(Hindrance::Blind("the images are too dark or too bright"))
                }
                CameraFaultKind::Occluder { width_share, crosses } => {
                    let sides = bar(width_share, crosses, self.plan.progress(fault, frame.exposed_at));
                    self.is_hidden(&frame.cam_left_from_target, sides[0])
                        .then_some(Hindrance::Blind("the target is occluded"))
                }
                CameraFaultKind::Skewed { stamped_nanos } => {
                    frame.skew_nanos = stamped_nanos;
                    let moved_m = self
                        .before
                        .map_or(0.0, |before| before.translation_m().x - frame.cam_left_from_target.translation_m().x);
                    let columns_px =
                        self.tracker.rig().left().pinhole().fx * moved_m / frame.cam_left_from_target.translation_m().z;
                    self.misjudge(frame, [columns_px, 0.0], 0.0, 1.0)
                }
                CameraFaultKind::Miscalibrated { columns_px, rows_px, roll_rad, scale } => {
                    self.misjudge(frame, [columns_px, rows_px], roll_rad, scale)
                }
                CameraFaultKind::Dropped { .. }
                | CameraFaultKind::Repeated { .. }
                | CameraFaultKind::Late { .. }
                | CameraFaultKind::Frozen => None,
            };
            frame.hindrance = hindrance.or(frame.hindrance);
        }
        let (before, since) = self.brightness;
        let since = if before == brightness { since.saturating_add(1) } else { 0 };
        self.brightness = (brightness, since);
        if since < FRAMES_AFTER_STEP && frame.hindrance.is_none() {
            frame.hindrance = Some(Hindrance::Doubtful("brightness has just changed"));
        }
    }
    /// Effect of a right image that is displaced relative to the calibration.
    fn misjudge(
        &self,
        frame: &mut GeometricFrame,
        [columns_px, rows_px]: [f64; 2],
        roll_rad: f64,
        scale: f64,
    ) -> Option<Hindrance> {
        if rows_px.abs() > ROWS_OFF_MAX_PX {
            return Some(Hindrance::Blind("the vertical misalignment of the images is too large"));
        }
        let found = frame.sighting.cam_left_from_model.ok()?;
        match self.tracker.misjudged(&found, columns_px, roll_rad, scale) {
            Some(wrong) => {
                frame.sighting.cam_left_from_model = Ok(wrong);
                None
            }
            None => Some(Hindrance::Blind("the images do not fit the calibration")),
        }
    }

    /// Whether more than half of the target outline is behind a bar between these sides, as shares of the left image width.
    fn is_hidden(&self, cam_left_from_target: &Pose<CamLeft, Target>, sides: [f64; 2]) -> bool {
        let outline_px = self.tracker.outline_px(cam_left_from_target);
        let width = f64::from(self.tracker.rig().left().size().width);
        let hidden = outline_px.iter().filter(|pixel| (sides[0]..sides[1]).contains(&(pixel.x / width)));
        2 * hidden.count() > outline_px.len()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion, Vector3};
    use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, StereoRig};
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_sim::geometric::PoseSigma;
    use pb3dp_sim::scene::ScenePoses;

    use pb3dp_sim::camera_faults::AffectedCameras;

    use super::*;

    struct Passing;

    impl PoseSource for Passing {
        fn poses_at(&mut self, at: MonotonicTime) -> ScenePoses {
            let facing = UnitQuaternion::from_scaled_axis(Vector3::new(0.15, 0.1, 0.0));
            ScenePoses {
                world_from_cam_left: Pose::from_translation(Vector3::zeros()),
                world_from_target: Pose::from_parts(Vector3::new(0.05 + 0.06 * at.as_secs_f64(), 0.01, 0.5), facing),
            }
        }
    }

    /// A target 500 mm away that moves to the right at 60 mm/s.
    fn passing(kind: CameraFaultKind) -> Vec<Option<GeometricFrame>> {
        let camera = Camera::new(
            ImageSize { width: 640, height: 480 },
            Pinhole { fx: 740.0, fy: 740.0, cx: 319.5, cy: 239.5 },
            Distortion::None,
        )
        .unwrap();
        let rig = StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap();
        let config = GeometricConfig {
            noise: PoseSigma::default(),
            lock: PoseSigma::default(),
            in_view_share_min: 0.5,
            turned_max_rad: 1.2,
            z_min_m: 0.3,
            z_max_m: 0.7,
            seed: 5,
        };
        let corner = |x: f64, y: f64| Point3::new(0.03 * x, 0.02 * y, 0.0);
        let outline_m = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        let tracker = GeometricTracker::new(config, rig, outline_m).unwrap();
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let config = SimCameraConfig { period: Duration::from_millis(50), ..SimCameraConfig::default() };
        let fault = CameraFault { kind, from: Duration::from_millis(95), until: Duration::from_millis(245) };
        let faults = CameraFaults { list: vec![fault], seed: 1 };
        let mut camera = GeometricCamera::new(tracker, Box::new(Passing), clock.clone(), &config)
            .unwrap()
            .with_faults(faults, clock.now())
            .unwrap();
        (0..8).map(|_| camera.next_frame(Duration::from_secs(1)).ok()).collect()
    }

    fn x_mm(frame: &Option<GeometricFrame>) -> Option<f64> {
        let found = frame.as_ref()?.sighting.cam_left_from_model.ok()?;
        Some((found.translation_m().x * 1e5).round() / 100.0)
    }

    /// Frames 2, 3 and 4 are affected.
    #[test]
    fn what_reaches_a_tracker() {
        let x = |kind| passing(kind).iter().map(x_mm).collect::<Vec<_>>();
        let all: Vec<_> = (0..8).map(|k| Some(50.12 + 3.0 * f64::from(k))).collect();
        let with = |changed: [Option<f64>; 3]| {
            let mut all = all.clone();
            all[2..5].copy_from_slice(&changed);
            all
        };
        assert_eq!(x(CameraFaultKind::Dropped { share: 1.0 }), with([None; 3]));
        assert_eq!(x(CameraFaultKind::Frozen), with([Some(53.12); 3]));
        assert_eq!(x(CameraFaultKind::Late { pairs: 1 }), with([None, Some(56.12), Some(59.12)]));
        let frozen = passing(CameraFaultKind::Frozen);
        let delivered = |frame: &Option<GeometricFrame>| frame.map(|frame| (frame.sequence, frame.is_new));
        assert_eq!(
            frozen[2..6].iter().map(delivered).collect::<Vec<_>>(),
            [(2, false), (3, false), (4, false), (5, true)].map(Some)
        );
        let again = passing(CameraFaultKind::Repeated { share: 1.0, as_new: false });
        assert_eq!(
            again[2..6].iter().map(delivered).collect::<Vec<_>>(),
            [(1, false), (1, false), (1, false), (5, true)].map(Some)
        );
    }

    #[test]
    fn what_hinders_a_tracker() {
        let hindered = |kind| passing(kind).iter().map(|frame| frame.unwrap().hindrance).collect::<Vec<_>>();
        let blind_in_three = |kind| {
            let hindered = hindered(kind);
            for (index, hindrance) in hindered.iter().enumerate() {
                let is_blind = matches!(hindrance, Some(Hindrance::Blind(_)));
                assert_eq!(is_blind, (2..5).contains(&index), "{kind:?}, frame {index}: {hindrance:?}");
            }
        };
        blind_in_three(CameraFaultKind::Black { cameras: AffectedCameras::Left });
        blind_in_three(CameraFaultKind::Saturated { cameras: AffectedCameras::Both });
        blind_in_three(CameraFaultKind::Torn { share: 1.0 });
        blind_in_three(CameraFaultKind::Brightness { cameras: AffectedCameras::Right, factor: 0.1 });
        blind_in_three(CameraFaultKind::Occluder { width_share: 0.6, crosses: false });
        blind_in_three(CameraFaultKind::Miscalibrated { columns_px: 0.0, rows_px: 3.0, roll_rad: 0.0, scale: 1.0 });
        let step = hindered(CameraFaultKind::Brightness { cameras: AffectedCameras::Both, factor: 1.5 });
        assert!(step[2..].iter().all(|hindrance| matches!(hindrance, Some(Hindrance::Doubtful(_)))), "{step:?}");
        assert!(step[..2].iter().all(Option::is_none), "{step:?}");
    }

    #[test]
    fn what_a_tracker_gets_wrong() {
        let z_mm = |kind| passing(kind)[3].unwrap().sighting.cam_left_from_model.unwrap().translation_m().z * 1e3;
        // A disparity of 148 pixels at 500 mm.
        let near = |found: f64, expected: f64| assert!((found - expected).abs() < 0.01, "{found} {expected}");
        near(z_mm(CameraFaultKind::Miscalibrated { columns_px: 3.0, rows_px: 1.0, roll_rad: 0.0, scale: 1.0 }), 510.34);
        // The right camera shows the target 3 mm farther left: 4.44 pixels.
        near(z_mm(CameraFaultKind::Skewed { stamped_nanos: 5 }), 500.0 * 148.0 / 152.44);
        assert_eq!(passing(CameraFaultKind::Skewed { stamped_nanos: 5 })[3].unwrap().skew_nanos, 5);
    }
}
