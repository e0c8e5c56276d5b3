//! One exposure for both cameras, which the program adapts to the light.

use std::time::Duration;

use pb3dp_geometry::StereoRig;

/// Exposure time and gain of both cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommonExposure {
    /// Exposure time.
    pub time: Duration,
    /// Gain, in units of the driver; `None` if the program does not change it.
    pub gain: Option<i32>,
}

/// Settings of the exposure that the program controls: both cameras always get the same exposure time and gain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedExposure {
    /// Mean grey level that both images shall have.
    pub target_grey: f64,
    /// Shortest and longest exposure time.
    pub time: [Duration; 2],
    /// Smallest and largest gain, in units of the driver; `None`: the gain stays as it is.
    pub gain: Option<[i32; 2]>,
    /// Longest motion of the target in the images during an exposure, pixels.
    pub blur_max_px: f64,
    /// Nearest distance of the target, metres: there it moves fastest in the images.
    pub nearest_m: f64,
    /// The exposure to begin with; `None`: that of the left camera, within the limits.
    pub start: Option<CommonExposure>,
}

/// The shortest exposure time blurs more than is allowed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "at {:.0} mm/s and {:.0} mm the target moves by {:.1} px in {:.2} ms, and {time_min_millis:.2} ms is the shortest exposure; allow more \
     blur, a shorter exposure, or less speed",
    speed_m_per_s * 1e3, nearest_m * 1e3, blur_max_px, time_max_millis
)]
pub struct TooBlurred {
    /// Largest speed of the target.
    pub speed_m_per_s: f64,
    /// Its nearest distance.
    pub nearest_m: f64,
    /// The allowed blur.
    pub blur_max_px: f64,
    /// The time with this blur.
    pub time_max_millis: f64,
    /// The shortest exposure time.
    pub time_min_millis: f64,
}

impl SharedExposure {
    /// Shortens the longest exposure to the time in which a target with this speed moves by `blur_max_px` in the left image of a rig.
    ///
    /// Blur is f v t / z pixels (docs/rig.md, Motion).
    ///
    /// # Errors
    /// If this time is below the shortest exposure.
    pub fn limit_blur(&mut self, rig: &StereoRig, speed_m_per_s: f64) -> Result<(), TooBlurred> {
        let pinhole = rig.left().pinhole();
        let px_per_s = pinhole.fx.max(pinhole.fy) * speed_m_per_s / self.nearest_m;
        let time_max = Duration::try_from_secs_f64(self.blur_max_px / px_per_s).unwrap_or(Duration::MAX);
        let [time_min, longest] = &mut self.time;
        *longest = (*longest).min(time_max);
        if time_max >= *time_min {
            return Ok(());
        }
        let [time_max_millis, time_min_millis] = [time_max, *time_min].map(|time| time.as_secs_f64() * 1e3);
        let (nearest_m, blur_max_px) = (self.nearest_m, self.blur_max_px);
        Err(TooBlurred { speed_m_per_s, nearest_m, blur_max_px, time_max_millis, time_min_millis })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose};

    use super::*;

    #[test]
    fn the_exposure_is_no_longer_than_the_blur_allows() {
        let pinhole = Pinhole { fx: 740.0, fy: 735.0, cx: 320.0, cy: 240.0 };
        let camera = Camera::new(ImageSize { width: 640, height: 480 }, pinhole, Distortion::None).unwrap();
        let rig = StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap();
        let time = [Duration::from_millis(1), Duration::from_millis(20)];
        let mut shared =
            SharedExposure { target_grey: 110.0, time, gain: None, blur_max_px: 2.0, nearest_m: 0.3, start: None };
        shared.limit_blur(&rig, 0.1).unwrap();
        // 740 px * 0.1 m/s / 0.3 m = 247 px/s.
        assert!((shared.time[1].as_secs_f64() - 2.0 / (740.0 / 3.0)).abs() < 1e-6, "{shared:?}");
        shared.limit_blur(&rig, 0.0).unwrap();
        let text = shared.limit_blur(&rig, 10.0).unwrap_err().to_string();
        assert!(text.contains("moves by 2.0 px in 0.08 ms, and 1.00 ms is the shortest exposure"), "{text}");
    }
}
