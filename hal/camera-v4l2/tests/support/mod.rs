//! Two emulated cameras in virtual time.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]
#![allow(dead_code, reason = "each test uses a part of it")]

use std::sync::Arc;
use std::time::Duration;

use pb3dp_camera_settings::{
    CameraConfig, CameraName, ControlSettings, DeviceLayout, Interval, ModeRequest, PixelFormat, SKEW_MAX, Setting,
    SkewCost, StampModel, StereoConfig,
};
use pb3dp_camera_v4l2::V4l2StereoCamera;
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem, Faults};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{CameraError, Clock, FramePair, StereoCamera};
use pb3dp_hal_clock::VirtualClock;

pub const SECOND: Duration = Duration::from_secs(1);
pub const SMALL: ImageSize = ImageSize { width: 64, height: 48 };
pub const PERIOD_MILLIS: f64 = 1000.0 / 30.0;

pub fn millis(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

pub fn camera_config(serial: &str) -> CameraConfig {
    CameraConfig {
        name: format!("serial:{serial}").parse::<CameraName>().unwrap(),
        mode: ModeRequest {
            format: PixelFormat::Yuyv,
            size: SMALL,
            interval: Interval { numerator: 1, denominator: 30 },
            input: None,
            standard: None,
            takes_interlaced: false,
        },
        controls: ControlSettings { exposure: Setting::Manual(millis(4)), ..ControlSettings::default() },
        exposure: None,
        stamps: StampModel::default(),
        crop: None,
    }
}

pub fn config() -> StereoConfig {
    let (left, right) = (camera_config("SN0000"), camera_config("SN0001"));
    let layout = DeviceLayout::TwoDevices;
    StereoConfig {
        layout,
        range: None,
        left,
        right,
        skew_max: SKEW_MAX,
        skew_cost: SkewCost::OF_NO_SETUP,
        shared_exposure: None,
    }
}

/// One device with both views of 64x48 pixels.
pub fn config_of_one(layout: DeviceLayout, format: PixelFormat) -> StereoConfig {
    let mut config = config();
    config.layout = layout;
    config.left.mode.format = format;
    config
}

/// A rig in virtual time; the right camera runs 2 ms after the left one.
pub struct Rig {
    pub clock: Arc<VirtualClock>,
    pub system: EmulatedSystem,
}

impl Rig {
    pub fn new() -> Self {
        Self::with(|_, _| {})
    }

    pub fn with(change: impl Fn(usize, &mut EmulatedCamera)) -> Self {
        let clock = Arc::new(VirtualClock::default());
        clock.sleep_until(pb3dp_geometry::MonotonicTime::from_nanos(5_000_000_000));
        let cameras = (0..2).map(|number| {
            let mut camera = EmulatedCamera::usual(number as u32);
            camera.phase = millis(40 + 2 * number as u64);
            change(number, &mut camera);
            camera
        });
        let system = EmulatedSystem::new(clock.clone(), cameras.collect());
        Self { clock, system }
    }

    pub fn open(&self, config: &StereoConfig) -> Result<V4l2StereoCamera, CameraError> {
        V4l2StereoCamera::open(Arc::new(self.system.clone()), self.clock.clone(), config)
    }

    pub fn opened(&self) -> V4l2StereoCamera {
        self.open(&config()).unwrap()
    }

    pub fn faults(&self, number: usize, change: impl FnOnce(&mut Faults)) {
        self.system.with(number, |camera| change(&mut camera.faults)).unwrap();
    }

    /// The result of a call and its duration, in milliseconds.
    pub fn timed(&self, camera: &mut V4l2StereoCamera) -> (Result<FramePair, CameraError>, f64) {
        let begin = self.clock.now();
        let result = camera.next_pair(SECOND);
        (result, self.clock.now().seconds_since(begin) * 1e3)
    }
}
