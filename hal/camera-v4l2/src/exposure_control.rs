//! The next exposure for the measured brightness. Pure computation: it knows no device and no clock.
//!
//! The tracker follows steps of the exposure by 1.5 in both cameras or in one of them within a frame (`exposure/both-1.5x` and
//! `exposure/right-1.5x` of `cargo xtask bench accuracy`, every 0.2 s). While a target is followed, steps are at most 1.1 here, once per
//! second.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::FollowedTarget;

use crate::brightness::Brightness;

/// Largest factor of a step of the exposure time while a target is followed. Chosen: a fifth of the tested step of 1.5. At half, a change
/// of the light by two takes 15 s; at twice, a step is still within the prior of the tracker's gain of 30 %.
const FACTOR_FOLLOWED: f64 = 1.1;
/// The same while nothing is followed.
const FACTOR_FREE: f64 = 2.0;

/// Least time between two changes while a target is followed. Chosen: 25 pairs between two steps, of which the tracker needs one.
const BETWEEN_FOLLOWED: Duration = Duration::from_secs(1);

/// How long the exposure stays after the pose has become doubtful. The cause may be a hand in front of the cameras, which also changes the
/// brightness; after this time it may be the light. Chosen; at half, a hand that passes in a second can change the exposure.
const DOUBTFUL_FOR: Duration = Duration::from_secs(2);

/// How long nothing is tried after a change that a camera refused.
const AFTER_FAILURE: Duration = Duration::from_secs(10);

/// Periods after a change in which images may still have the exposure before it. Chosen: a UVC camera uses a new exposure one or two images
/// later, and images wait in buffers.
pub const SETTLING_PERIODS: u32 = 4;

/// Pairs whose brightness is averaged: under lamps at 50 Hz the brightness of 30 images per second repeats after three of them.
const PAIRS: u32 = 6;

/// Dead band: share by which the brightness may differ from the target. Chosen; at half, the smallest steps of short exposures are larger
/// than the band.
const DEAD_BAND_SHARE: f64 = 0.1;

/// Brightness of one image relative to that of the other above which one of them shows something else: a covered lens, a lamp.
const SIDES_FACTOR_MAX: f64 = 2.0;

/// Share of saturated pixels above which the exposure is not raised, and above which it is lowered.
const SATURATED_SHARES: [f64; 2] = [0.05, 0.10];
/// Saturated pixels lower the brightness to this share of the target, not further.
const SATURATED_GREY_SHARE: f64 = 0.6;

/// Steps of the gain: share of the driver's range while a target is followed, and while nothing is. The unit of a gain is not known; a
/// range of 50 dB has steps of 6 % then.
const GAIN_SHARES: [f64; 2] = [0.01, 0.06];

/// Exposure time and gain, in units of the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExposureUnits {
    /// Exposure time, 100 microseconds.
    pub time: i32,
    /// Gain; `None` if it is not changed.
    pub gain: Option<i32>,
}

/// The values of a control that may be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnitRange {
    /// Smallest value.
    pub min: i32,
    /// Largest value.
    pub max: i32,
    /// Values are `min` plus a multiple of it.
    pub step: i32,
    /// Largest minus smallest value of the driver.
    pub span: i32,
}

impl UnitRange {
    /// The largest permitted value that is at most `value`; the smallest one if there is none.
    pub fn at_most(&self, value: f64) -> i32 {
        let (min, max) = (i64::from(self.min), i64::from(self.max));
        // A float becomes the nearest integer, NaN zero.
        let steps = ((value.floor() as i64).clamp(min, max.max(min)) - min) / i64::from(self.step.max(1));
        i32::try_from(min + steps * i64::from(self.step.max(1))).unwrap_or(self.min)
    }
}

/// Limits of exposure time and gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExposureLimits {
    /// Exposure time.
    pub time: UnitRange,
    /// Gain; `None` if it is not changed.
    pub gain: Option<UnitRange>,
}

impl ExposureLimits {
    /// The exposure within the limits.
    pub fn clamp(&self, exposure: ExposureUnits) -> ExposureUnits {
        ExposureUnits {
            time: self.time.at_most(f64::from(exposure.time)),
            gain: self.gain.map(|gain| gain.at_most(exposure.gain.map_or(f64::from(gain.min), f64::from))),
        }
    }
}

/// How far a step may go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepSize {
    /// A target is followed.
    Followed,
    /// Nothing is followed.
    Free,
}

/// The measured brightness relative to the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// Within the dead band, or not to be judged: the exposure stays.
    Good,
    /// Too dark: the factor that would reach the target with a linear camera. With the gamma curve of a webcam it is smaller than needed, so
    /// that several steps approach the target without overshooting.
    TooDark(f64),
    /// Too bright, likewise.
    TooBright(f64),
}

/// Judges both images.
pub fn judge(target_grey: f64, sides: [Brightness; 2]) -> Verdict {
    let [left, right] = sides.map(|side| side.grey);
    let grey = (left + right) / 2.0;
    let saturated = sides[0].saturated_share.max(sides[1].saturated_share);
    if ![left, right, saturated, target_grey].iter().all(|value| value.is_finite()) || target_grey <= 0.0 {
        return Verdict::Good;
    }
    // One grey level in black images.
    let are_alike = left.max(right) <= SIDES_FACTOR_MAX * left.min(right).max(1.0);
    let factor = target_grey / grey.max(1.0);
    if !are_alike {
        Verdict::Good
    } else if factor < 1.0 / (1.0 + DEAD_BAND_SHARE) {
        Verdict::TooBright(factor)
    } else if saturated > SATURATED_SHARES[1] && grey > SATURATED_GREY_SHARE * target_grey {
        Verdict::TooBright(1.0 / FACTOR_FOLLOWED)
    } else if factor > 1.0 + DEAD_BAND_SHARE && saturated <= SATURATED_SHARES[0] {
        Verdict::TooDark(factor)
    } else {
        Verdict::Good
    }
}

/// The next exposure: a longer time before more gain, less gain before a shorter time. `None`: it stays, also at its limits, and where the
/// driver has no step that is small enough.
pub fn next(verdict: Verdict, now: ExposureUnits, limits: &ExposureLimits, size: StepSize) -> Option<ExposureUnits> {
    let now = limits.clamp(now);
    let time = |factor| next_time(now.time, factor, &limits.time, size).map(|time| ExposureUnits { time, ..now });
    let gain = |sign| {
        let (range, gain) = limits.gain.zip(now.gain)?;
        next_gain(gain, sign, &range, size).map(|gain| ExposureUnits { gain: Some(gain), ..now })
    };
    match verdict {
        Verdict::TooDark(factor) | Verdict::TooBright(factor) if !factor.is_finite() => None,
        Verdict::Good => None,
        Verdict::TooDark(factor) => time(factor).or_else(|| gain(1)),
        Verdict::TooBright(factor) => gain(-1).or_else(|| time(factor)),
    }
}

fn next_time(now: i32, factor: f64, range: &UnitRange, size: StepSize) -> Option<i32> {
    let factor_max = if size == StepSize::Followed { FACTOR_FOLLOWED } else { FACTOR_FREE };
    let wanted = f64::from(now) * factor.clamp(1.0 / factor_max, factor_max);
    let step = f64::from(range.step.max(1));
    let next = match (size, factor > 1.0) {
        (StepSize::Followed, true) => range.at_most(wanted),
        // Never less than the factor allows: the first value from `wanted` on.
        (StepSize::Followed, false) => range.at_most((wanted + step - 1e-6).min(f64::from(now))),
        // The nearest value, but at least one step.
        (StepSize::Free, true) => range.at_most((wanted + step / 2.0).max(f64::from(now) + step)),
        (StepSize::Free, false) => range.at_most((wanted + step / 2.0).min(f64::from(now) - step)),
    };
    Some(next).filter(|next| *next != now)
}

fn next_gain(now: i32, sign: i32, range: &UnitRange, size: StepSize) -> Option<i32> {
    let step = f64::from(range.step.max(1));
    let share = GAIN_SHARES[usize::from(size == StepSize::Free)];
    let by = (share * f64::from(range.span) / step).floor() * step;
    // A driver with few steps: each of them is too large while a target is followed.
    let by = if size == StepSize::Free { by.max(step) } else { by };
    let next = range.at_most(f64::from(now) + f64::from(sign) * by);
    Some(next).filter(|next| *next != now)
}

/// Decides when the exposure changes.
#[derive(Clone, Debug)]
pub struct ExposureController {
    target_grey: f64,
    limits: ExposureLimits,
    period: Duration,
    sums: [Brightness; 2],
    pairs: u32,
    changed_at: Option<MonotonicTime>,
    failed_at: Option<MonotonicTime>,
    doubtful_since: Option<MonotonicTime>,
    rests: bool,
    at_limit: Option<Verdict>,
}

const NO_BRIGHTNESS: Brightness = Brightness { grey: 0.0, saturated_share: 0.0 };

impl ExposureController {
    /// A controller for images with this period.
    pub fn new(target_grey: f64, limits: ExposureLimits, period: Duration) -> Self {
        Self {
            target_grey,
            limits,
            period,
            sums: [NO_BRIGHTNESS; 2],
            pairs: 0,
            changed_at: None,
            failed_at: None,
            doubtful_since: None,
            rests: false,
            at_limit: None,
        }
    }

    /// Whether images at this time may still have the exposure before the newest change.
    pub fn is_settling(&self, at: MonotonicTime) -> bool {
        self.changed_at.is_some_and(|changed_at| at < changed_at + self.period * SETTLING_PERIODS)
    }

    /// Whether the newest images needed no change, or none was possible.
    pub fn rests(&self) -> bool {
        self.rests
    }

    /// The verdict if the exposure can go no further towards the target.
    pub fn at_limit(&self) -> Option<Verdict> {
        self.at_limit
    }

    /// The exposure was changed in both cameras.
    pub fn changed(&mut self, now: MonotonicTime) {
        (self.changed_at, self.failed_at, self.pairs, self.rests) = (Some(now), None, 0, false);
    }

    /// A change has failed; both cameras have the exposure before it.
    pub fn failed(&mut self, now: MonotonicTime) {
        (self.failed_at, self.pairs, self.rests) = (Some(now), 0, true);
    }

    /// Takes the brightness of a pair that was exposed at `at`. The next exposure, if it shall change now, and the mean grey level that it
    /// is for.
    pub fn observe(
        &mut self,
        (at, following): (MonotonicTime, FollowedTarget),
        sides: [Brightness; 2],
        exposure: ExposureUnits,
    ) -> Option<(ExposureUnits, f64)> {
        self.doubtful_since = match (following, self.doubtful_since) {
            (FollowedTarget::Doubtful, since) => Some(since.unwrap_or(at)),
            (FollowedTarget::Nothing | FollowedTarget::Confident, _) => None,
        };
        if self.is_settling(at) {
            return None;
        }
        let means = self.average(sides)?;
        let verdict = judge(self.target_grey, means);
        let size = if following == FollowedTarget::Nothing { StepSize::Free } else { StepSize::Followed };
        let next = next(verdict, exposure, &self.limits, size);
        self.rests = next.is_none();
        self.at_limit = Some(verdict).filter(|verdict| next.is_none() && *verdict != Verdict::Good);
        let grey = (means[0].grey + means[1].grey) / 2.0;
        next.filter(|_| self.may_change(at, following)).map(|next| (next, grey))
    }

    fn may_change(&self, at: MonotonicTime, following: FollowedTarget) -> bool {
        let is_over = |since: Option<MonotonicTime>, time| since.is_none_or(|since| at.saturating_since(since) >= time);
        let is_slow_enough = following == FollowedTarget::Nothing || is_over(self.changed_at, BETWEEN_FOLLOWED);
        is_slow_enough && is_over(self.doubtful_since, DOUBTFUL_FOR) && is_over(self.failed_at, AFTER_FAILURE)
    }

    /// The mean of [`PAIRS`] pairs, after each of them.
    fn average(&mut self, sides: [Brightness; 2]) -> Option<[Brightness; 2]> {
        if self.pairs == 0 {
            self.sums = [NO_BRIGHTNESS; 2];
        }
        for (sum, side) in self.sums.iter_mut().zip(sides) {
            sum.grey += side.grey;
            sum.saturated_share += side.saturated_share;
        }
        self.pairs += 1;
        if self.pairs < PAIRS {
            return None;
        }
        self.pairs = 0;
        let share = 1.0 / f64::from(PAIRS);
        Some(self.sums.map(|sum| Brightness { grey: sum.grey * share, saturated_share: sum.saturated_share * share }))
    }
}

#[cfg(test)]
mod tests;
