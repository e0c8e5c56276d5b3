//! One or two V4L2 devices as one stereo camera.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_camera_settings::{CommonExposure, SkewCost, StereoConfig};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FollowedTarget, FramePair, StereoCamera, StereoCameraInfo};

use crate::controls::{self, Control, Focus};
use crate::error::{failed, unusable};
use crate::modes::Mode;
use crate::names::CaptureDevice;
use crate::opening::{OpenedDevices, open_devices};
use crate::pairing::{Drift, DriftEstimator, Verdict, judge};
use crate::shared_exposure::{ExposureEvent, ExposurePair, settling_time};
use crate::stream::{Drained, Side, Stream, StreamCounters, Streams};
use crate::timing::ClockMap;
use crate::video::VideoSystem;
use pb3dp_camera_pixels::PixelError;

/// A camera without any image for this number of periods counts as silent. A working camera is late by less than a period: on an
/// emulated computer with one busy processor the images of `vivid` were 43 to 61 ms apart instead of 33 (maximum of 300 images,
/// 1.8 periods). After a single lost image the next one arrives at exactly this time, so that the camera may be reported as
/// silent; the image is delivered by the next call.
const SILENT_PERIODS: f64 = 2.0;

/// The same for a camera whose images are invalid: one image may be damaged, and the next one late by half a period.
const DAMAGED_PERIODS: f64 = 2.5;

/// Counters of received and dropped images.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StereoCounters {
    /// Of the left camera.
    pub left: StreamCounters,
    /// Of the right camera; those of the left one if one device has both views.
    pub right: StreamCounters,
    /// Pairs that were delivered.
    pub pairs: u64,
    /// Pairs whose exposures were too far apart.
    pub skew_refused: u64,
    /// Largest skew of a delivered pair.
    pub skew_max_nanos: u64,
    /// Drift between the two cameras; `None` before it is known.
    pub drift: Option<Drift>,
}

/// Identity of a camera and its lens setting.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraIdentity {
    /// Serial number.
    pub serial: Option<String>,
    /// Port it is connected to.
    pub place: String,
    /// Focus setting.
    pub focus: Focus,
}

/// Two V4L2 devices that deliver pairs, or one whose images have both views; a pair of one device has one time, and the skew 0. If one is
/// lost both are closed, and the camera must be opened again.
pub struct V4l2StereoCamera {
    info: StereoCameraInfo,
    found: [CaptureDevice; 2],
    system: Arc<dyn VideoSystem>,
    clock: Arc<dyn Clock>,
    clock_map: ClockMap,
    period: Duration,
    skew_max: Duration,
    skew_cost: SkewCost,
    /// The exposure of both cameras, if the program controls it.
    exposure: Option<ExposurePair>,
    state: State,
    counters: StereoCounters,
    drift: DriftEstimator,
    last: Option<(u64, MonotonicTime)>,
    /// Last sign of life of each side; `None` before its first good image.
    last_images: [Option<LastImages>; 2],
}

/// Time of the last images of a camera, or of the last report that it has none.
#[derive(Clone, Copy, Debug)]
struct LastImages {
    /// Images of any quality.
    any: MonotonicTime,
    /// Good images.
    good: MonotonicTime,
}

impl LastImages {
    /// Updates the times after draining the driver.
    fn note(last_images: &mut Option<Self>, drained: Drained, now: MonotonicTime) {
        if drained.has_life {
            *last_images = Some(Self { any: now, good: now });
        } else if let (Some(last_images), 1..) = (last_images, drained.taken) {
            last_images.any = now;
        }
    }
}

enum State {
    Open(Streams),
    /// The message of every call.
    Lost(String),
}

impl V4l2StereoCamera {
    /// Opens the devices, sets the requested mode and controls, reads them back, and starts the streams.
    ///
    /// # Errors
    /// `Disconnected` if a device is missing; `Unusable` if it is in use, not permitted, or not as requested, or if the layout or a crop
    /// does not suit its images.
    pub fn open(
        system: Arc<dyn VideoSystem>,
        clock: Arc<dyn Clock>,
        config: &StereoConfig,
    ) -> Result<Self, CameraError> {
        let OpenedDevices { name, found, mut streams, period } = open_devices(system.as_ref(), config)?;
        if config.skew_max >= period {
            let what = format!(
                "the maximum skew is {:?}, it must be shorter than the frame period of {period:?}",
                config.skew_max
            );
            return Err(unusable(&name, what));
        }
        let shared = config.shared_exposure.as_ref();
        let exposure = shared.map(|shared| ExposurePair::open(&mut streams, shared, period)).transpose()?;
        for stream in streams.all_mut() {
            stream.start()?;
        }
        let clock_map = ClockMap::measure(system.as_ref(), clock.as_ref());
        Ok(Self {
            info: StereoCameraInfo { name, size: config.size(), period: Some(period) },
            found,
            system,
            clock,
            clock_map,
            period,
            skew_max: config.skew_max,
            skew_cost: config.skew_cost,
            exposure,
            state: State::Open(streams),
            counters: StereoCounters::default(),
            drift: DriftEstimator::new(period),
            last: None,
            last_images: [None; 2],
        })
    }

    /// Counters of received and dropped images since opening.
    pub fn counters(&self) -> StereoCounters {
        let mut counters = self.counters;
        if let State::Open(streams) = &self.state {
            (counters.left, counters.right) = (streams.of(Side::Left).counters, streams.of(Side::Right).counters);
        }
        counters.drift = self.drift.drift();
        counters
    }

    /// The negotiated mode of a camera.
    ///
    /// # Errors
    /// `Disconnected` after the loss of a camera.
    pub fn mode(&mut self, side: Side) -> Result<Mode, CameraError> {
        Ok(self.stream(side)?.config.mode)
    }

    /// Identity and present lens setting of a camera.
    ///
    /// # Errors
    /// Errors of the driver; `Disconnected` after the loss of a camera.
    pub fn identity(&mut self, side: Side) -> Result<CameraIdentity, CameraError> {
        let stream = self.stream(side)?;
        let device = stream.config.device.clone();
        let focus = controls::focus_now(stream.node(), &device)?;
        let CaptureDevice { entry, capability } = &self.found[side as usize];
        Ok(CameraIdentity { serial: entry.serial.clone(), place: capability.bus.clone(), focus })
    }

    /// Left and right device, as they were found.
    pub(crate) fn devices(&self) -> &[CaptureDevice; 2] {
        &self.found
    }

    /// Controls of a camera with their values.
    ///
    /// # Errors
    /// Errors of the driver; `Disconnected` after the loss of a camera.
    pub fn controls(&mut self, side: Side) -> Result<Vec<Control>, CameraError> {
        let stream = self.stream(side)?;
        let device = stream.config.device.clone();
        controls::controls(stream.node()).map_err(|error| failed(&device, "reading its controls", error))
    }

    /// Sets a control while the camera runs, and reads it back. The exposure time used for the timestamps is updated.
    ///
    /// # Errors
    /// The value is not possible or not kept, or the program controls the exposure of both cameras; `Disconnected` after the loss of a
    /// camera.
    pub fn set_control(&mut self, side: Side, id: u32, value: i32) -> Result<(), CameraError> {
        let is_shared = self.exposure.as_ref().is_some_and(|exposure| exposure.owns(id));
        let stream = self.stream(side)?;
        let device = stream.config.device.clone();
        if is_shared {
            let what = "the program sets this control in both cameras together (exposure_millis = \"shared\"); change camera.shared_exposure, or \
                        set exposure_millis of both cameras to a number";
            return Err(unusable(&device, what));
        }
        controls::set(stream.node(), &device, id, value)?;
        if let Some(exposure) = controls::exposure_now(stream.node(), &device)? {
            stream.config.exposure = exposure;
        }
        Ok(())
    }

    /// The exposure of both cameras, if the program controls it.
    pub fn shared_exposure(&self) -> Option<CommonExposure> {
        self.exposure.as_ref().map(ExposurePair::now)
    }

    /// States what follows the target: the exposure then changes slowly, or not at all.
    pub fn set_following(&mut self, following: FollowedTarget) {
        if let Some(exposure) = &mut self.exposure {
            exposure.set_following(following);
        }
    }

    /// What became of the exposure, oldest first; to be taken after each pair.
    pub fn take_exposure_event(&mut self) -> Option<ExposureEvent> {
        self.exposure.as_mut()?.take_event()
    }

    /// Drops pairs until the exposure rests, for a few seconds at most. Does nothing if the program does not control the exposure.
    ///
    /// # Errors
    /// `Disconnected` after the loss of a camera; `Unusable` for cameras that cannot be used. Other errors only take time.
    pub fn settle_exposure(&mut self) -> Result<(), CameraError> {
        let deadline = self.clock.now() + settling_time(self.period);
        let mut pair = FramePair::black(self.info.size);
        while self.exposure.as_ref().is_some_and(|exposure| !exposure.rests()) && self.clock.now() < deadline {
            match self.next_pair_into(&mut pair, self.period * 4) {
                Err(error) if matches!(error.kind(), CameraErrorKind::Disconnected | CameraErrorKind::Unusable) => {
                    return Err(error);
                }
                Ok(()) | Err(_) => {}
            }
        }
        Ok(())
    }

    fn stream(&mut self, side: Side) -> Result<&mut Stream, CameraError> {
        match &mut self.state {
            State::Open(streams) => Ok(streams.of_mut(side)),
            State::Lost(message) => Err(CameraError::new(CameraErrorKind::Disconnected, message.clone())),
        }
    }

    /// Closes both devices if the error is a disconnection, so that they can be reopened.
    fn remember(&mut self, error: CameraError) -> CameraError {
        if error.kind() == CameraErrorKind::Disconnected {
            self.counters = self.counters();
            self.state = State::Lost(error.to_string());
        }
        error
    }

    fn try_next(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        let deadline = self.clock.now() + timeout;
        if let (State::Open(streams), Some(exposure)) = (&mut self.state, &mut self.exposure) {
            exposure.apply(streams, self.clock.now())?;
        }
        loop {
            self.drain()?;
            if self.deliver(pair)? {
                pair.exposure = None;
                if let Some(exposure) = &mut self.exposure {
                    exposure.observe(pair);
                }
                return Ok(());
            }
            let now = self.clock.now();
            let silent_at = self.complain_of_silence(now, deadline)?;
            if now >= deadline {
                let message = format!("{}: no pair within {timeout:?}{}", self.info.name, self.complaints());
                return Err(CameraError::new(CameraErrorKind::Timeout, message));
            }
            self.wait(silent_at.saturating_since(now))?;
        }
    }

    /// Takes all available images from both drivers.
    fn drain(&mut self) -> Result<(), CameraError> {
        let (now_nanos, now) = (self.system.monotonic_nanos(), self.clock.now());
        let State::Open(streams) = &mut self.state else { return Ok(()) };
        for (stream, last_images) in streams.all_mut().iter_mut().zip(&mut self.last_images) {
            LastImages::note(last_images, stream.drain(now_nanos)?, now);
        }
        Ok(())
    }

    /// Delivers a pair if there is one; drops images whose partners are lost.
    fn deliver(&mut self, pair: &mut FramePair) -> Result<bool, CameraError> {
        let (left, right) = match &mut self.state {
            State::Open(Streams::Two(streams)) => {
                let [left, right] = &mut **streams;
                (left, right)
            }
            State::Open(Streams::One(stream)) => {
                let Some(held) = stream.held() else { return Ok(false) };
                convert_both(stream, pair)?;
                return self.stamp(pair, held.mid_nanos, 0).map(|()| true);
            }
            State::Lost(_) => return Ok(false),
        };
        let (Some(left_held), Some(right_held)) = (left.held(), right.held()) else { return Ok(false) };
        let skew_nanos = right_held.mid_nanos.saturating_sub(left_held.mid_nanos);
        match judge(left_held.mid_nanos, right_held.mid_nanos, self.period, self.skew_max) {
            Verdict::LeftIsOld => left.drop_unpaired()?,
            Verdict::RightIsOld => right.drop_unpaired()?,
            Verdict::TooFar => {
                self.drift.add(left_held.mid_nanos, skew_nanos);
                left.give_back()?;
                right.give_back()?;
                self.counters.skew_refused += 1;
                return Err(self.too_far(skew_nanos));
            }
            Verdict::Pair => {
                self.drift.add(left_held.mid_nanos, skew_nanos);
                convert_each([left, right], pair)?;
                return self.stamp(pair, left_held.mid_nanos, skew_nanos).map(|()| true);
            }
        }
        Ok(false)
    }

    /// Sets time and number of a pair.
    fn stamp(&mut self, pair: &mut FramePair, left_nanos: i64, skew_nanos: i64) -> Result<(), CameraError> {
        let bad = |what: &str| CameraError::new(CameraErrorKind::BadPair, format!("{}: {what}", self.info.name));
        let exposed_at = self
            .clock_map
            .program_time(left_nanos)
            .ok_or_else(|| bad("a pair was exposed before the program start"))?;
        pair.sequence = match self.last {
            None => 0,
            Some((_, last)) if exposed_at <= last => return Err(bad("a pair is not newer than the previous one")),
            // Sequence numbers of drivers may repeat or restart; time does not.
            Some((sequence, last)) => {
                let periods = exposed_at.saturating_since(last).as_secs_f64() / self.period.as_secs_f64();
                sequence + (periods.round() as u64).max(1)
            }
        };
        pair.exposed_at = exposed_at;
        pair.skew_nanos = skew_nanos;
        self.last = Some((pair.sequence, exposed_at));
        self.counters.pairs += 1;
        self.counters.skew_max_nanos = self.counters.skew_max_nanos.max(skew_nanos.unsigned_abs());
        Ok(())
    }

    fn too_far(&self, skew_nanos: i64) -> CameraError {
        let skew = Duration::from_nanos(skew_nanos.unsigned_abs());
        let message = format!(
            "{}: right was exposed {:.1} ms after left, at most {:.1} ms is allowed; {}; use a hardware trigger for both cameras, restart them \
             until their exposures match, or accept more (camera.skew_max_millis, --skew-max) and move slowly",
            self.info.name,
            skew_nanos as f64 * 1e-6,
            self.skew_max.as_secs_f64() * 1e3,
            self.skew_cost.text(skew),
        );
        CameraError::new(CameraErrorKind::BadPair, message)
    }

    /// When the next camera becomes silent or the call ends; an error if one is silent now. A camera that has never sent an image
    /// has the whole call to begin.
    fn complain_of_silence(
        &mut self,
        now: MonotonicTime,
        deadline: MonotonicTime,
    ) -> Result<MonotonicTime, CameraError> {
        let State::Open(streams) = &self.state else { return Ok(deadline) };
        let mut earliest = deadline;
        for (stream, last_images) in streams.all().iter().zip(&mut self.last_images) {
            let Some(LastImages { any, good }) = *last_images else { continue };
            let [of_any, of_good] =
                [(any, SILENT_PERIODS), (good, DAMAGED_PERIODS)].map(|(at, n)| (at + self.period.mul_f64(n), n));
            let (silent_at, periods) = if of_any.0 <= of_good.0 { of_any } else { of_good };
            if now >= silent_at {
                // The next call waits equally long again.
                *last_images = Some(LastImages { any: now, good: now });
                let why = stream.complaint().unwrap_or("no data arrives; check its plug and cable");
                let device = &stream.config.device;
                let millis = now.saturating_since(good).as_secs_f64() * 1e3;
                let message = format!("{device}: no good image for {millis:.0} ms, {periods} periods: {why}");
                return Err(CameraError::new(CameraErrorKind::Timeout, message));
            }
            earliest = earliest.min(silent_at);
        }
        Ok(earliest)
    }

    fn complaints(&self) -> String {
        let State::Open(streams) = &self.state else { return String::new() };
        let lines = streams.all().iter().map(|stream| {
            let nothing = if stream.counters.good == 0 { "no image yet" } else { "no problem found" };
            format!("; {}: {}", stream.config.device, stream.complaint().unwrap_or(nothing))
        });
        lines.collect()
    }

    /// Waits for any device.
    fn wait(&mut self, timeout: Duration) -> Result<(), CameraError> {
        let State::Open(streams) = &mut self.state else { return Ok(()) };
        let handles = [Side::Left, Side::Right].map(|side| streams.of(side).handle());
        let ready = self
            .system
            .wait(handles, timeout)
            .map_err(|error| failed(&self.info.name, "waiting for an image", error))?;
        let now_nanos = self.system.monotonic_nanos();
        for ((stream, ready), last_images) in streams.all_mut().iter_mut().zip(ready).zip(&mut self.last_images) {
            if ready.has_failed {
                // The driver's own error is more specific, if there is one.
                let drained = stream.drain(now_nanos)?;
                LastImages::note(last_images, drained, self.clock.now());
                if drained.taken == 0 {
                    let message =
                        format!("{}: the driver has stopped the stream; open the camera again", stream.config.device);
                    return Err(CameraError::new(CameraErrorKind::Disconnected, message));
                }
            }
        }
        Ok(())
    }
}

/// Converts the images of two devices, and returns them to their drivers.
fn convert_each([left, right]: [&mut Stream; 2], pair: &mut FramePair) -> Result<(), CameraError> {
    let [left_delivered, right_delivered] = &mut pair.delivered;
    let converted = left
        .convert(&mut [&mut pair.left], &mut [left_delivered])
        .map_err(|error| damaged(&left.config.device, error))
        .and_then(|()| {
            right
                .convert(&mut [&mut pair.right], &mut [right_delivered])
                .map_err(|error| damaged(&right.config.device, error))
        });
    left.give_back()?;
    right.give_back()?;
    converted
}

/// Converts both views of a device, and returns its image to the driver.
fn convert_both(stream: &mut Stream, pair: &mut FramePair) -> Result<(), CameraError> {
    let converted = stream.convert(&mut [&mut pair.left, &mut pair.right], &mut pair.delivered.each_mut());
    stream.give_back()?;
    converted.map_err(|error| damaged(&stream.config.device, error))
}

fn damaged(device: &str, error: PixelError) -> CameraError {
    let message = format!("{device}: an image is damaged; if this happens often, check cable and hub");
    CameraError::caused_by(CameraErrorKind::BadPair, message, error)
}

impl StereoCamera for V4l2StereoCamera {
    fn info(&self) -> &StereoCameraInfo {
        &self.info
    }

    /// As defined by the trait. A silent camera is reported two periods after its last image (`Timeout`), whatever `timeout` is.
    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        if let State::Lost(message) = &self.state {
            return Err(CameraError::new(CameraErrorKind::Disconnected, message.clone()));
        }
        self.try_next(pair, timeout).map_err(|error| self.remember(error))
    }
}
