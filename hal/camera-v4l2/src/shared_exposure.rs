//! One exposure for both cameras: set in both or in none, adapted to the light, announced in each pair.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use pb3dp_camera_settings::{CommonExposure, SharedExposure};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind, FollowedTarget, FramePair, PairExposure};

use crate::brightness::brightness_of;
use crate::controls::{self, EXPOSURE_UNIT, id};
use crate::error::{failed, unusable};
use crate::exposure_control::{
    ExposureController, ExposureLimits, ExposureUnits, SETTLING_PERIODS, UnitRange, Verdict,
};
use crate::stream::{Stream, Streams};
use crate::video::ControlEntry;

/// Events that nobody has taken; older ones are dropped.
const EVENTS_MAX: usize = 8;

/// What became of the exposure of both cameras.
#[derive(Clone, Debug, PartialEq)]
pub enum ExposureEvent {
    /// Both cameras have a new exposure.
    Changed {
        /// The exposure before.
        from: CommonExposure,
        /// The new one.
        to: CommonExposure,
        /// Mean grey level of the images before.
        grey: f64,
        /// The grey level that they shall have.
        target_grey: f64,
    },
    /// A camera refused a change: both have the exposure before it.
    Failed(String),
    /// The brightness cannot be reached.
    AtLimit {
        /// Whether the images are too dark, else too bright.
        is_dark: bool,
        /// The exposure, which stays.
        exposure: CommonExposure,
    },
}

impl ExposureEvent {
    /// Whether a person should know of it, not only the log.
    pub fn is_warning(&self) -> bool {
        !matches!(self, Self::Changed { .. })
    }
}

impl fmt::Display for ExposureEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Changed { from, to, grey, target_grey } => write!(
                f,
                "exposure of both cameras: {} instead of {}; the images had a mean grey level of {grey:.0}, the target is {target_grey:.0}",
                text_of(to),
                text_of(from)
            ),
            Self::Failed(error) => {
                write!(f, "the exposure was not changed, both cameras have the one before: {error}")
            }
            Self::AtLimit { is_dark, exposure } => {
                let (state, remedy) = if *is_dark { ("dark", "add light") } else { ("bright", "close the aperture") };
                write!(
                    f,
                    "the images are too {state}, and the exposure of {} cannot be changed further: {remedy}, or extend the limits of \
                     camera.shared_exposure; while a target is followed only small steps are possible",
                    text_of(exposure)
                )
            }
        }
    }
}

fn text_of(exposure: &CommonExposure) -> String {
    let gain = exposure.gain.map(|gain| format!(", gain {gain}")).unwrap_or_default();
    format!("{:.1} ms{gain}", exposure.time.as_secs_f64() * 1e3)
}

/// Controls of one camera.
#[derive(Clone, Debug)]
struct SideControls {
    time: ControlEntry,
    gain: Option<ControlEntry>,
}

/// The exposure of both cameras, and its controller.
#[derive(Debug)]
pub(crate) struct ExposurePair {
    sides: Vec<SideControls>,
    controller: ExposureController,
    target_grey: f64,
    following: FollowedTarget,
    now: ExposureUnits,
    /// The next exposure and the brightness that it is for: set before the next pair, so that this one is not late.
    wanted: Option<(ExposureUnits, f64)>,
    /// Why the cameras may have different exposures.
    differs: Option<String>,
    changes: u64,
    factor: f64,
    was_at_limit: bool,
    events: VecDeque<ExposureEvent>,
}

impl ExposurePair {
    /// Sets the first exposure in all cameras. Their automatic modes are disabled already.
    ///
    /// # Errors
    /// A camera lacks a control, the gains of both are not the same, the limits are outside those of a camera, or an error of the driver.
    pub(crate) fn open(streams: &mut Streams, config: &SharedExposure, period: Duration) -> Result<Self, CameraError> {
        let mut sides = Vec::new();
        for stream in streams.all_mut() {
            sides.push(controls_of(stream, config.gain.is_some())?);
        }
        let devices: Vec<&str> = streams.all().iter().map(|stream| stream.config.device.as_str()).collect();
        let limits = limits(&sides, &devices, config)?;
        let time_max = from_units(limits.time.max);
        let present = match config.start {
            Some(start) => ExposureUnits { time: to_units(start.time), gain: start.gain },
            None => present(&mut streams.all_mut()[0], &sides[0])?,
        };
        let pair = Self {
            controller: ExposureController::new(config.target_grey, limits, period),
            sides,
            target_grey: config.target_grey,
            following: FollowedTarget::Nothing,
            now: limits.clamp(present),
            wanted: None,
            differs: None,
            changes: 0,
            factor: 1.0,
            was_at_limit: false,
            events: VecDeque::new(),
        };
        for (stream, side) in streams.all_mut().iter_mut().zip(&pair.sides) {
            set(stream, side, pair.now)?;
            // A longer exposure than the present one also makes images older when they arrive.
            stream.config.age_max += time_max;
        }
        pair.note_time(streams);
        Ok(pair)
    }

    /// The exposure of both cameras.
    pub(crate) fn now(&self) -> CommonExposure {
        common(self.now)
    }

    /// What follows the target.
    pub(crate) fn set_following(&mut self, following: FollowedTarget) {
        // A change that was decided for free images is too large for a target.
        if following != self.following {
            self.wanted = None;
        }
        self.following = following;
    }

    /// Whether the newest images needed no change.
    pub(crate) fn rests(&self) -> bool {
        self.wanted.is_none() && self.controller.rests()
    }

    /// The oldest event that was not taken yet.
    pub(crate) fn take_event(&mut self) -> Option<ExposureEvent> {
        self.events.pop_front()
    }

    /// Whether the controller sets this control.
    pub(crate) fn owns(&self, id: u32) -> bool {
        let is_gain = matches!(id, id::GAIN | id::AUTO_GAIN);
        matches!(id, id::EXPOSURE_AUTO | id::EXPOSURE_ABSOLUTE | id::EXPOSURE_AUTO_PRIORITY)
            || is_gain && self.now.gain.is_some()
    }

    /// Sets the wanted exposure in both cameras, or restores that before in both.
    ///
    /// # Errors
    /// `Disconnected` if a camera is lost; `BadPair` while the cameras may have different exposures.
    pub(crate) fn apply(&mut self, streams: &mut Streams, now: MonotonicTime) -> Result<(), CameraError> {
        if self.differs.is_some() {
            self.restore(streams, now)?;
        }
        let Some((wanted, grey)) = self.wanted.take() else { return Ok(()) };
        match self.set_all(streams, wanted) {
            Ok(()) => {
                self.factor = f64::from(wanted.time) / f64::from(self.now.time.max(1));
                let from = std::mem::replace(&mut self.now, wanted);
                self.changes += 1;
                self.note_time(streams);
                self.controller.changed(now);
                let target_grey = self.target_grey;
                self.tell(ExposureEvent::Changed { from: common(from), to: common(wanted), grey, target_grey });
                Ok(())
            }
            Err(error) if error.kind() == CameraErrorKind::Disconnected => Err(error),
            Err(error) => {
                let text = error.with_causes();
                self.differs = Some(text.clone());
                self.restore(streams, now)?;
                self.tell(ExposureEvent::Failed(text));
                Ok(())
            }
        }
    }

    /// Sets the exposure before a failed change in both cameras.
    fn restore(&mut self, streams: &mut Streams, now: MonotonicTime) -> Result<(), CameraError> {
        let Some(why) = self.differs.take() else { return Ok(()) };
        let Err(error) = self.set_all(streams, self.now) else {
            // One camera may have had the failed exposure for some images.
            self.controller.changed(now);
            self.controller.failed(now);
            return Ok(());
        };
        let kind = match error.kind() {
            CameraErrorKind::Disconnected => CameraErrorKind::Disconnected,
            _ => CameraErrorKind::BadPair,
        };
        let message = format!(
            "the cameras may have different exposures, and no pair is delivered until both have the same one: {why}; restoring the exposure \
             before it failed, too"
        );
        self.differs = Some(why);
        Err(CameraError::caused_by(kind, message, error))
    }

    fn set_all(&self, streams: &mut Streams, exposure: ExposureUnits) -> Result<(), CameraError> {
        let mut sides = streams.all_mut().iter_mut().zip(&self.sides);
        sides.try_for_each(|(stream, side)| set(stream, side, exposure))
    }

    /// The time stamps are the middle of the exposure.
    fn note_time(&self, streams: &mut Streams) {
        for stream in streams.all_mut() {
            stream.config.exposure = from_units(self.now.time);
        }
    }

    /// Marks a pair with its exposure, and decides about the next one from its brightness.
    pub(crate) fn observe(&mut self, pair: &mut FramePair) {
        let at = pair.exposed_at;
        let CommonExposure { time, gain } = self.now();
        let is_settling = self.controller.is_settling(at);
        pair.exposure = Some(PairExposure { time, gain, changes: self.changes, factor: self.factor, is_settling });
        if is_settling || self.wanted.is_some() {
            return;
        }
        let sides = [brightness_of(&pair.left), brightness_of(&pair.right)];
        self.wanted = self.controller.observe((at, self.following), sides, self.now);
        let at_limit = self.controller.at_limit();
        if let Some(verdict) = at_limit.filter(|_| !self.was_at_limit) {
            let is_dark = matches!(verdict, Verdict::TooDark(_));
            self.tell(ExposureEvent::AtLimit { is_dark, exposure: self.now() });
        }
        self.was_at_limit = at_limit.is_some();
    }

    fn tell(&mut self, event: ExposureEvent) {
        if self.events.len() == EVENTS_MAX {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }
}

/// Longest time that a first exposure needs to settle: eight changes by two, each with its pairs, and as much again.
pub(crate) fn settling_time(period: Duration) -> Duration {
    period * (SETTLING_PERIODS + 6) * 16
}

fn common(exposure: ExposureUnits) -> CommonExposure {
    CommonExposure { time: from_units(exposure.time), gain: exposure.gain }
}

fn from_units(units: i32) -> Duration {
    EXPOSURE_UNIT * u32::try_from(units).unwrap_or(0)
}

/// The largest number of units within a time.
fn to_units(time: Duration) -> i32 {
    i32::try_from(time.as_nanos() / EXPOSURE_UNIT.as_nanos()).unwrap_or(i32::MAX)
}

/// Exposure time and gain that a camera has now.
fn present(stream: &mut Stream, side: &SideControls) -> Result<ExposureUnits, CameraError> {
    let device = stream.config.device.clone();
    let read = |entry: &ControlEntry, stream: &mut Stream| {
        let value = stream.node().control(entry.id);
        value.map_err(|error| failed(&device, &format!("reading `{}`", entry.name), error))
    };
    let time = read(&side.time, stream)?;
    let gain = side.gain.as_ref().map(|gain| read(gain, stream)).transpose()?;
    Ok(ExposureUnits { time, gain })
}

/// Finds the controls of a camera.
fn controls_of(stream: &mut Stream, needs_gain: bool) -> Result<SideControls, CameraError> {
    let device = stream.config.device.clone();
    let found = controls::controls(stream.node()).map_err(|error| failed(&device, "reading its controls", error))?;
    let control = |id: u32, name: &str, key: &str| {
        let entry = found.iter().map(|control| &control.entry).find(|entry| entry.id == id);
        let why = match entry {
            Some(entry) if !entry.is_locked => return Ok(entry.clone()),
            Some(entry) => format!("its control `{}` is locked", entry.name),
            None => format!("it has no control for the {name} ({id:#010x})"),
        };
        let what = format!(
            "{why}, which {key} = \"shared\" needs in both cameras; set {key} of both cameras to a number or to \"keep\", or use two cameras \
             with this control"
        );
        Err(unusable(&device, what))
    };
    let time = control(id::EXPOSURE_ABSOLUTE, "exposure time", "exposure_millis")?;
    let gain = needs_gain.then(|| control(id::GAIN, "gain", "gain")).transpose()?;
    Ok(SideControls { time, gain })
}

/// The limits that the setup and all cameras permit.
fn limits(sides: &[SideControls], devices: &[&str], config: &SharedExposure) -> Result<ExposureLimits, CameraError> {
    let of = |asked: [i32; 2], entries: Vec<&ControlEntry>, (name, key): (&str, &str)| {
        let first = entries[0];
        if let Some(k) = entries.iter().position(|entry| (entry.min, entry.step) != (first.min, first.step)) {
            let what = format!(
                "its control `{}` has values from {} in steps of {}, that of {} from {} in steps of {}: equal values are not possible; set \
                 {key} of each camera to a number, or use two cameras of one model",
                entries[k].name, entries[k].min, entries[k].step, devices[0], first.min, first.step
            );
            return Err(unusable(devices[k], what));
        }
        let max = entries.iter().map(|entry| entry.max).min().unwrap_or(first.max);
        let step = first.step.max(1);
        let span = max.saturating_sub(first.min);
        // The first value of the driver from the smallest one on that the setup permits.
        let above = i64::from(asked[0].max(first.min)) - i64::from(first.min);
        let min = i64::from(first.min) + (above + i64::from(step) - 1) / i64::from(step) * i64::from(step);
        let range = UnitRange { min: i32::try_from(min).unwrap_or(i32::MAX), max: max.min(asked[1]), step, span };
        if range.min > range.max {
            let what = format!(
                "no {name} between {} and {} is possible; its control `{}` has {} to {max} in steps of {step}: change the limits in \
                 camera.shared_exposure",
                asked[0], asked[1], first.name, first.min
            );
            return Err(unusable(devices[0], what));
        }
        Ok(range)
    };
    let [time_min, time_max] = config.time;
    // Rounded inwards: the longest exposure is a limit of the motion blur.
    let units = [to_units(time_min + EXPOSURE_UNIT.saturating_sub(Duration::from_nanos(1))), to_units(time_max)];
    let times = sides.iter().map(|side| &side.time).collect();
    let time = of(units, times, ("exposure time (in 0.1 ms)", "exposure_millis"))?;
    let gain = match config.gain {
        None => None,
        Some(asked) => {
            let gains: Vec<&ControlEntry> = sides.iter().filter_map(|side| side.gain.as_ref()).collect();
            check_equal_gains(&gains, devices)?;
            Some(of(asked, gains, ("gain", "gain"))?)
        }
    };
    Ok(ExposureLimits { time, gain })
}

/// Gains have no unit: equal numbers are equal gains only if both drivers have the same range.
fn check_equal_gains(gains: &[&ControlEntry], devices: &[&str]) -> Result<(), CameraError> {
    let differs = gains.iter().position(|gain| (gain.min, gain.max) != (gains[0].min, gains[0].max));
    let Some(k) = differs else { return Ok(()) };
    let what = format!(
        "its control `{}` has the range {} to {}, that of {} has {} to {}: equal numbers are not equal gains; set gain of each camera to a \
         number, and let the program change the exposure time only",
        gains[k].name, gains[k].min, gains[k].max, devices[0], gains[0].min, gains[0].max
    );
    Err(unusable(devices[k], what))
}

/// Sets the exposure of one camera and reads it back.
fn set(stream: &mut Stream, side: &SideControls, exposure: ExposureUnits) -> Result<(), CameraError> {
    let device = stream.config.device.clone();
    let gain = side.gain.as_ref().zip(exposure.gain);
    for (entry, value) in std::iter::once((&side.time, exposure.time)).chain(gain) {
        controls::write(stream.node(), &device, entry, value)?;
    }
    for (entry, value) in std::iter::once((&side.time, exposure.time)).chain(gain) {
        controls::verify(stream.node(), &device, entry, value)?;
    }
    Ok(())
}
