//! Cameras that are reopened after one of them was lost.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_camera_settings::StereoConfig;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FollowedTarget, FramePair, StereoCamera, StereoCameraInfo};

use crate::camera::{CameraIdentity, StereoCounters, V4l2StereoCamera};
use crate::controls::Control;
use crate::error::unusable;
use crate::names::CaptureDevice;
use crate::shared_exposure::ExposureEvent;
use crate::stream::Side;
use crate::video::VideoSystem;

/// Time between two attempts to open lost cameras. An attempt queries every video device of the computer.
const AGAIN: Duration = Duration::from_millis(250);

/// A [`V4l2StereoCamera`] that survives the loss of its devices. While they are missing each call is a `Timeout` with the reason.
/// When they are available again, in the same mode and with the same controls, pairs continue with increasing numbers and times.
/// Only the same cameras are used again: see [`Self::are_distinguished`].
///
/// A call that opens cameras takes as long as the drivers need, which may be more than twice its `timeout`.
pub struct ReopeningCamera {
    system: Arc<dyn VideoSystem>,
    clock: Arc<dyn Clock>,
    config: StereoConfig,
    info: StereoCameraInfo,
    /// Left and right device at the start.
    first: [CaptureDevice; 2],
    reopen_for: Duration,
    state: State,
    /// Number and time of the newest delivered pair.
    last: Option<(u64, MonotonicTime)>,
    /// Offset from the numbers of the open camera to the delivered numbers; `None` until its first pair.
    offset: Option<u64>,
    reopened: u64,
    following: FollowedTarget,
}

enum State {
    Open(Box<V4l2StereoCamera>),
    Lost {
        since: MonotonicTime,
        next_try: MonotonicTime,
        why: String,
        counters: Box<StereoCounters>,
    },
    /// The message of every call.
    GivenUp(String),
}

impl ReopeningCamera {
    /// Opens the devices as [`V4l2StereoCamera::open`] does. After a loss they are searched for the time `reopen_for`; zero: not
    /// at all.
    ///
    /// # Errors
    /// As [`V4l2StereoCamera::open`]: a device that is missing at the start is not waited for.
    pub fn open(
        system: Arc<dyn VideoSystem>,
        clock: Arc<dyn Clock>,
        config: StereoConfig,
        reopen_for: Duration,
    ) -> Result<Self, CameraError> {
        let camera = V4l2StereoCamera::open(Arc::clone(&system), Arc::clone(&clock), &config)?;
        let (info, first) = (camera.info().clone(), camera.devices().clone());
        let state = State::Open(Box::new(camera));
        Ok(Self {
            system,
            clock,
            config,
            info,
            first,
            reopen_for,
            state,
            last: None,
            offset: None,
            reopened: 0,
            following: FollowedTarget::Nothing,
        })
    }

    /// Counters of received and dropped images since the cameras were opened last.
    pub fn counters(&self) -> StereoCounters {
        match &self.state {
            State::Open(camera) => camera.counters(),
            State::Lost { counters, .. } => **counters,
            State::GivenUp(_) => StereoCounters::default(),
        }
    }

    /// Identity and present lens setting of a camera.
    ///
    /// # Errors
    /// As [`V4l2StereoCamera::identity`]; `Disconnected` while the cameras are lost.
    pub fn identity(&mut self, side: Side) -> Result<CameraIdentity, CameraError> {
        self.open_camera()?.identity(side)
    }

    /// Controls of a camera with their values.
    ///
    /// # Errors
    /// As [`V4l2StereoCamera::controls`]; `Disconnected` while the cameras are lost.
    pub fn controls(&mut self, side: Side) -> Result<Vec<Control>, CameraError> {
        self.open_camera()?.controls(side)
    }

    /// Sets a control and reads it back. Reopened cameras have the controls of their configuration again.
    ///
    /// # Errors
    /// As [`V4l2StereoCamera::set_control`]; `Disconnected` while the cameras are lost.
    pub fn set_control(&mut self, side: Side, id: u32, value: i32) -> Result<(), CameraError> {
        self.open_camera()?.set_control(side, id, value)
    }

    /// As [`V4l2StereoCamera::set_following`].
    pub fn set_following(&mut self, following: FollowedTarget) {
        self.following = following;
        if let State::Open(camera) = &mut self.state {
            camera.set_following(following);
        }
    }

    /// As [`V4l2StereoCamera::take_exposure_event`].
    pub fn take_exposure_event(&mut self) -> Option<ExposureEvent> {
        match &mut self.state {
            State::Open(camera) => camera.take_exposure_event(),
            State::Lost { .. } | State::GivenUp(_) => None,
        }
    }

    /// As [`V4l2StereoCamera::settle_exposure`].
    ///
    /// # Errors
    /// As there.
    pub fn settle_exposure(&mut self) -> Result<(), CameraError> {
        self.open_camera()?.settle_exposure()
    }

    fn open_camera(&mut self) -> Result<&mut V4l2StereoCamera, CameraError> {
        match &mut self.state {
            State::Open(camera) => Ok(camera),
            State::Lost { why, .. } | State::GivenUp(why) => {
                Err(CameraError::new(CameraErrorKind::Disconnected, why.clone()))
            }
        }
    }

    /// Number of times the cameras were reopened.
    pub fn reopened(&self) -> u64 {
        self.reopened
    }

    /// Whether left and right cannot be exchanged unnoticed: different serial numbers tell them apart, or one device has both views.
    /// Otherwise a reopened camera is identified by its port, and exchanged cables only show in the images.
    pub fn are_distinguished(&self) -> bool {
        is_one_device(&self.first) || have_numbers(&self.first)
    }

    /// Closes both devices; each call reports this until they are open again.
    fn lose(&mut self, error: CameraError) -> CameraError {
        if self.reopen_for.is_zero() {
            self.state = State::GivenUp(error.to_string());
            return error;
        }
        // Reopened cameras go on with the exposure of this light.
        if let (State::Open(camera), Some(shared)) = (&self.state, &mut self.config.shared_exposure) {
            shared.start = camera.shared_exposure().or(shared.start);
        }
        let since = self.clock.now();
        let counters = Box::new(self.counters());
        let why = error.to_string();
        self.state = State::Lost { since, next_try: since, why: why.clone(), counters };
        self.offset = None;
        CameraError::new(CameraErrorKind::Timeout, format!("{why}: trying to reopen for {:?}", self.reopen_for))
    }

    /// Tries to open both devices until `deadline`.
    fn reopen(&mut self, deadline: MonotonicTime) -> Result<(), CameraError> {
        while let State::Lost { since, next_try, why, .. } = &mut self.state {
            let now = self.clock.now();
            if now.saturating_since(*since) >= self.reopen_for {
                let message = format!("{why}: not available again within {:?}", self.reopen_for);
                self.state = State::GivenUp(message);
                break;
            }
            if now < *next_try {
                if now >= deadline {
                    let message = format!("{why}: no pairs until the cameras are available again");
                    return Err(CameraError::new(CameraErrorKind::Timeout, message));
                }
                self.clock.sleep_until((*next_try).min(deadline));
                continue;
            }
            let opened = V4l2StereoCamera::open(Arc::clone(&self.system), Arc::clone(&self.clock), &self.config);
            match opened.and_then(|camera| same_as(&self.first, camera)) {
                Ok(mut camera) => {
                    camera.set_following(self.following);
                    self.state = State::Open(Box::new(camera));
                    self.reopened += 1;
                    return Ok(());
                }
                // All errors are retried: after reconnection a device is first missing, then not permitted, and then busy for a
                // while, and exchanged cables can be exchanged again.
                Err(error) => {
                    *why = error.to_string();
                    *next_try = self.clock.now() + AGAIN;
                }
            }
        }
        match &self.state {
            State::GivenUp(message) => Err(CameraError::new(CameraErrorKind::Disconnected, message.clone())),
            State::Open(_) | State::Lost { .. } => Ok(()),
        }
    }

    /// Gives a pair a number after all previous ones.
    fn renumber(&mut self, pair: &mut FramePair) -> Result<(), CameraError> {
        let offset = match (self.offset, self.last) {
            (Some(offset), _) => offset,
            (None, None) => 0,
            (None, Some((_, last))) if pair.exposed_at <= last => {
                let message =
                    format!("{}: a pair is not newer than the pairs before the cameras were lost", self.info.name);
                return Err(CameraError::new(CameraErrorKind::BadPair, message));
            }
            (None, Some((sequence, last))) => {
                let period = self.info.period.unwrap_or(AGAIN).as_secs_f64();
                let periods = (pair.exposed_at.saturating_since(last).as_secs_f64() / period).round() as u64;
                (sequence + periods.max(1)).saturating_sub(pair.sequence)
            }
        };
        self.offset = Some(offset);
        pair.sequence += offset;
        self.last = Some((pair.sequence, pair.exposed_at));
        Ok(())
    }
}

/// Refuses other cameras than those of the start, and exchanged ones: the calibration belongs to those of the start.
fn same_as(first: &[CaptureDevice; 2], camera: V4l2StereoCamera) -> Result<V4l2StereoCamera, CameraError> {
    let by_port = !have_numbers(first);
    let names = if is_one_device(first) { ["the device"; 2] } else { ["left", "right"] };
    let mut sides = names.into_iter().zip(first.iter().zip(camera.devices()));
    let other = sides.find_map(|(side, (was, is))| {
        let differs =
            |what: &str, was: &str, is: &str| (was != is).then(|| format!("{side} has {what} {is}, not {was}"));
        let number = |device: &CaptureDevice| device.entry.serial.clone().unwrap_or_else(|| "(none)".to_owned());
        let port = || differs("port", &was.capability.bus, &is.capability.bus).filter(|_| by_port);
        differs("serial number", &number(was), &number(is)).or_else(port)
    });
    let Some(other) = other else { return Ok(camera) };
    let what = format!(
        "other cameras than at the start: {other}; connect each camera to its previous port, or end the run and use the calibration of \
         these cameras"
    );
    Err(unusable(&camera.info().name, what))
}

/// Whether one device has both views.
fn is_one_device([left, right]: &[CaptureDevice; 2]) -> bool {
    left.entry.path == right.entry.path
}

/// Whether serial numbers identify the devices.
fn have_numbers(devices: &[CaptureDevice; 2]) -> bool {
    let [left, right] = devices.each_ref().map(|device| device.entry.serial.as_ref());
    left.is_some() && right.is_some() && (left != right || is_one_device(devices))
}

impl StereoCamera for ReopeningCamera {
    fn info(&self) -> &StereoCameraInfo {
        &self.info
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        self.reopen(self.clock.now() + timeout)?;
        let State::Open(camera) = &mut self.state else {
            return Err(CameraError::new(CameraErrorKind::Timeout, format!("{}: no camera is open", self.info.name)));
        };
        match camera.next_pair_into(pair, timeout) {
            Ok(()) => self.renumber(pair),
            Err(error) if error.kind() == CameraErrorKind::Disconnected => Err(self.lose(error)),
            Err(error) => Err(error),
        }
    }
}
