//! Figures of each channel of an experiment: errors in motion and at hold, lag, gain and phase, settling.
//!
//! An experiment of moves has one channel per pair of marks (out and back). In each channel the displacement of the hand along that channel
//! is compared with the desired displacement. "Moving" is from a mark to the end of its move. "Hold" begins one second after the end of the
//! move, when the hand should have settled, and ends with the next mark. A sinusoid has one channel, which moves all the time at full
//! amplitude; the time before and after is left out.

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, World};
use pb3dp_record::metrics::{lag_by_cross_correlation, overshoot, settled_from, sine_response};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, Trajectory};
use serde::Serialize;

use super::log::{ControlSample, RunLog};
use crate::figures::{RmsMax, TrackingError};

/// Settling time after each move before "hold" begins, seconds.
const SETTLE_S: f64 = 1.0;
/// Largest lag in the search, seconds.
const LAG_MAX_S: f64 = 1.5;
/// Below this correlation with the desired displacement the hand does not follow.
const CORRELATION_MIN: f64 = 0.7;
/// After a step move the hand has settled once it stays this near to the desired pose by the initial lock, mm and degrees.
pub const SETTLED_WITHIN: (f64, f64) = (1.0, 0.3);

/// Experiment parameters known in advance.
#[derive(Clone, Debug)]
pub struct Plan {
    /// How the target moves.
    pub motion: MotionConfig,
    /// Directions of the channel axes in `world`.
    pub world_from_axes: UnitQuaternion<f64>,
}

impl Plan {
    /// From the motion parameters and the place of the experiment.
    pub fn of(motion: &MotionConfig, experiment: &dyn Trajectory) -> Self {
        let world_from_axes = match motion.axes() {
            ExperimentAxes::World => UnitQuaternion::identity(),
            ExperimentAxes::TargetAtStart => experiment.pose_at(0.0).rotation(),
        };
        Self { motion: motion.clone(), world_from_axes }
    }

    /// The channels with their times; `marks_s` are the times of the marks, `end_s` is the end of the run.
    fn spans(&self, marks_s: &[f64], end_s: f64) -> Vec<Span> {
        match &self.motion {
            MotionConfig::Sine(sine) => {
                let steady_s = sine.steady_s();
                let (channel, period_s) = (sine.channel, Some(sine.period_s));
                vec![Span {
                    channel,
                    whole_s: steady_s,
                    back_s: None,
                    moving_s: [steady_s; 2],
                    hold_s: [NEVER; 2],
                    period_s,
                }]
            }
            MotionConfig::Steps(steps) => {
                let after = |index: usize| marks_s.get(index).copied().unwrap_or(end_s + 1e-9);
                let channels = steps.channels.iter().enumerate();
                let of_channel = |(index, channel): (usize, &Channel)| {
                    let out_s = *marks_s.get(2 * index)?;
                    let (back_s, next_s) = (after(2 * index + 1), after(2 * index + 2));
                    let rest_s = steps.move_s + SETTLE_S;
                    Some(Span {
                        channel: *channel,
                        whole_s: (out_s, next_s),
                        back_s: Some(back_s),
                        moving_s: [(out_s, out_s + steps.move_s), (back_s, back_s + steps.move_s)],
                        hold_s: [(out_s + rest_s, back_s), (back_s + rest_s, next_s)],
                        period_s: None,
                    })
                };
                channels.map_while(of_channel).collect()
            }
        }
    }
}

/// An empty time span.
const NEVER: (f64, f64) = (0.0, 0.0);

/// Time span of one channel.
#[derive(Clone, Copy, Debug)]
struct Span {
    channel: Channel,
    whole_s: (f64, f64),
    /// Begin of the move back; only for moves out and back.
    back_s: Option<f64>,
    moving_s: [(f64, f64); 2],
    hold_s: [(f64, f64); 2],
    /// Only for a sinusoid.
    period_s: Option<f64>,
}

fn within(spans_s: &[(f64, f64)], t_s: f64) -> bool {
    spans_s.iter().any(|(from, until)| t_s >= *from && t_s < *until)
}

/// Position and orientation errors of the hand against the desired pose by the initial lock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LockedErrors {
    /// Distance while the target moves, mm.
    pub moving_mm: Option<RmsMax>,
    /// Angle while the target moves, degrees.
    pub moving_deg: Option<RmsMax>,
    /// Distance while the target is stationary, mm.
    pub hold_mm: Option<RmsMax>,
    /// Angle while the target is stationary, degrees.
    pub hold_deg: Option<RmsMax>,
}

/// Tracking figures of one channel, in the channel's unit: mm for x, y, z, degrees for rx, ry, rz.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelSummary {
    /// `x` to `rz`.
    pub channel: String,
    /// `mm` or `deg`.
    pub unit: &'static str,
    /// Error while the target moves.
    pub moving: Option<RmsMax>,
    /// Error while the target is stationary.
    pub hold: Option<RmsMax>,
    /// Distance and angle against the desired pose by the initial lock, not along the channel only.
    pub locked: LockedErrors,
    /// Lag of the hand behind its desired displacement by cross-correlation, seconds.
    pub lag_s: Option<f64>,
    /// Rise time (10 to 90 %) of the hand minus that of the desired displacement, on the move out, seconds; not for step moves.
    pub rise_delay_s: Option<f64>,
    /// Gain of the hand relative to the desired displacement, dB; for sinusoids.
    pub gain_db: Option<f64>,
    /// Phase of the hand relative to the desired displacement, degrees, negative for a lag; for sinusoids.
    pub phase_deg: Option<f64>,
    /// For step moves: time until the hand stays within [`SETTLED_WITHIN`], seconds, the longer of out and back; none if it does not.
    pub settled_after_s: Option<f64>,
    /// For step moves: overshoot, percent of the move, the larger of out and back.
    pub overshoot_percent: Option<f64>,
}

/// Displacement of the hand along a channel since the start of the run: mm or degrees.
pub fn way_along(plan: &Plan, channel: Channel, start: &Pose<World, Hand>, now: &Pose<World, Hand>) -> f64 {
    let axes_from_world = plan.world_from_axes.inverse();
    if channel.is_rotation() {
        let turned = (now.rotation() * start.rotation().inverse()).scaled_axis();
        component(channel, &(axes_from_world * turned)).to_degrees()
    } else {
        component(channel, &(axes_from_world * (now.translation_m() - start.translation_m()))) * 1e3
    }
}

fn component(channel: Channel, v: &Vector3<f64>) -> f64 {
    match channel {
        Channel::X | Channel::Rx => v.x,
        Channel::Y | Channel::Ry => v.y,
        Channel::Z | Channel::Rz => v.z,
    }
}

/// The figures of each channel that the run reached, and the errors against the initial lock over all channels.
pub fn summaries(log: &RunLog, plan: &Plan) -> (Vec<ChannelSummary>, LockedErrors) {
    let (Some(first), Some(last)) = (log.judged().first(), log.judged().last()) else {
        return (Vec::new(), LockedErrors::default());
    };
    let marks_s: Vec<f64> = log.marks.iter().map(|mark| mark.at_s).collect();
    let spans = plan.spans(&marks_s, last.t_s);
    let summary = |span: &Span| {
        let samples: Vec<&ControlSample> = log.control.iter().filter(|s| within(&[span.whole_s], s.t_s)).collect();
        let way = |pick: fn(&ControlSample) -> &Pose<World, Hand>| -> Vec<f64> {
            samples.iter().map(|s| way_along(plan, span.channel, &first.world_from_hand_wanted, pick(s))).collect()
        };
        let (wanted, is) = (way(|s| &s.world_from_hand_wanted), way(|s| &s.world_from_hand));
        let locked = way(|s| &s.world_from_hand_locked);
        (samples.len() > 2).then(|| Ways { span, samples: &samples, wanted, locked, is }.summary())
    };
    let channels = spans.iter().map_while(summary).collect();
    let all = |pick: fn(&Span) -> [(f64, f64); 2]| spans.iter().flat_map(pick).collect::<Vec<_>>();
    let samples: Vec<&ControlSample> = log.control.iter().collect();
    (channels, LockedErrors::of(&samples, &all(|span| span.moving_s), &all(|span| span.hold_s)))
}

impl LockedErrors {
    fn of(samples: &[&ControlSample], moving_s: &[(f64, f64)], hold_s: &[(f64, f64)]) -> Self {
        type Pick = fn(&TrackingError) -> f64;
        let errors = |spans_s: &[(f64, f64)], pick: Pick| -> Option<RmsMax> {
            let inside = samples.iter().filter(|s| within(spans_s, s.t_s));
            RmsMax::of(&inside.map(|s| pick(&TrackingError::of_locked(s))).collect::<Vec<_>>())
        };
        let (mm, deg): (Pick, Pick) = (|e| e.position_m * 1e3, |e| e.orientation_rad.to_degrees());
        Self {
            moving_mm: errors(moving_s, mm),
            moving_deg: errors(moving_s, deg),
            hold_mm: errors(hold_s, mm),
            hold_deg: errors(hold_s, deg),
        }
    }
}

/// Displacements in one channel: desired, desired by the initial lock, and actual, in the channel's unit.
struct Ways<'a> {
    span: &'a Span,
    samples: &'a [&'a ControlSample],
    wanted: Vec<f64>,
    locked: Vec<f64>,
    is: Vec<f64>,
}

impl Ways<'_> {
    fn summary(&self) -> ChannelSummary {
        let Self { span, samples, wanted, is, .. } = self;
        let error_within = |spans_s: &[(f64, f64)]| -> Option<RmsMax> {
            let both = is.iter().zip(wanted);
            let inside = samples.iter().zip(both).filter(|(s, _)| within(spans_s, s.t_s));
            RmsMax::of(&inside.map(|(_, (a, b))| a - b).collect::<Vec<f64>>())
        };
        let period_s = samples[1].t_s - samples[0].t_s;
        let response = span.period_s.and_then(|turn_s| sine_response(wanted, is, period_s, turn_s));
        let is_sudden = span.back_s.is_some() && span.moving_s[0].0 == span.moving_s[0].1;
        let way_out = span.back_s.map(|back_s| samples.iter().take_while(|s| s.t_s < back_s).count());
        let (settled_after_s, overshoot_percent) = match way_out.filter(|_| is_sudden) {
            Some(way_out) => (self.settled_after_s(way_out, period_s), self.overshoot_percent(way_out)),
            None => (None, None),
        };
        ChannelSummary {
            channel: span.channel.name().to_owned(),
            unit: if span.channel.is_rotation() { "deg" } else { "mm" },
            moving: error_within(&span.moving_s),
            hold: error_within(&span.hold_s),
            locked: LockedErrors::of(samples, &span.moving_s, &span.hold_s),
            lag_s: if is_sudden { None } else { lag_s(wanted, is, period_s) },
            rise_delay_s: way_out
                .filter(|_| !is_sudden)
                .and_then(|way_out| rise_delay_s(&wanted[..way_out], &is[..way_out], period_s)),
            gain_db: response.map(|response| response.gain_db()),
            phase_deg: response.map(|response| response.phase_rad.to_degrees()),
            settled_after_s,
            overshoot_percent,
        }
    }

    /// The longer of both settling times; none unless both moves settle.
    fn settled_after_s(&self, way_out: usize, period_s: f64) -> Option<f64> {
        let settled = |samples: &[&ControlSample]| -> Option<f64> {
            let errors: Vec<TrackingError> = samples.iter().map(|s| TrackingError::of_locked(s)).collect();
            let mm: Vec<f64> = errors.iter().map(|e| e.position_m * 1e3).collect();
            let deg: Vec<f64> = errors.iter().map(|e| e.orientation_rad.to_degrees()).collect();
            settled_from(&[(&mm, SETTLED_WITHIN.0), (&deg, SETTLED_WITHIN.1)]).map(|index| index as f64 * period_s)
        };
        let (out, back) = self.samples.split_at(way_out);
        Some(settled(out)?.max(settled(back)?))
    }

    fn overshoot_percent(&self, way_out: usize) -> Option<f64> {
        let ((out, back), (to, home)) = (self.is.split_at(way_out), self.locked.split_at(way_out));
        let (there, here) = (*to.last()?, *home.last()?);
        ((there - here).abs() > 1e-9).then(|| 100.0 * overshoot(out, here, there).max(overshoot(back, there, here)))
    }
}

/// The lag, if the response follows the reference; a channel that is not observed has none.
fn lag_s(reference: &[f64], response: &[f64], period_s: f64) -> Option<f64> {
    lag_by_cross_correlation(reference, response, period_s, LAG_MAX_S)
        .filter(|lag| lag.correlation > CORRELATION_MIN)
        .map(|lag| lag.lag_s)
}

/// 10-90 % rise time of the response minus that of the reference; both relative to the reference's displacement.
fn rise_delay_s(reference: &[f64], response: &[f64], period_s: f64) -> Option<f64> {
    let (from, to) = (*reference.first()?, *reference.last()?);
    let rise = |series: &[f64]| -> Option<f64> {
        let share = |value: f64| (value - from) / (to - from);
        let low = series.iter().position(|&v| share(v) >= 0.1)?;
        let high = series.iter().position(|&v| share(v) >= 0.9)?;
        Some((high as f64 - low as f64) * period_s)
    };
    ((to - from).abs() > 1e-9).then(|| Some(rise(response)? - rise(reference)?))?
}
