//! The figures of a run: how well the hand followed, how good the estimates were, how long they took.
//!
//! The experiment has one channel per pair of marks (out and back). In each channel the hand's way along that channel is
//! compared with the way it should have gone. "Moving" is from a mark to the end of its move; "hold" begins one second
//! after the move's end, when the hand should have settled, and ends with the next mark.

use std::collections::BTreeMap;

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, World};
use pb3dp_record::metrics::{Statistics, lag_by_cross_correlation, max_abs, percentile, rms};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, StepExperiment, StepExperimentConfig, Trajectory};
use serde::Serialize;

use super::commands::CommandSummary;
use super::cycles::CycleSummary;
use super::log::{ControlSample, RunLog};
use super::methods::{self, MethodSummary};

/// The hand settles for this long after each move before "hold" is judged, seconds.
const SETTLE_S: f64 = 1.0;
/// Lags up to this are looked for, seconds.
const LAG_MAX_S: f64 = 1.5;
/// A hand that moves less like its wanted way than this does not follow it.
const CORRELATION_MIN: f64 = 0.7;

/// Root mean square and largest value of an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RmsMax {
    /// Root mean square.
    pub rms: f64,
    /// Largest absolute value.
    pub max: f64,
}

impl RmsMax {
    fn of(samples: &[f64]) -> Option<Self> {
        Some(Self { rms: rms(samples)?, max: max_abs(samples)? })
    }
}

/// Median and 95th percentile of an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MedianP95 {
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
}

impl MedianP95 {
    /// Of absolute errors; `None` without any.
    pub fn of(samples: &[f64]) -> Option<Self> {
        Statistics::of(samples).map(|s| Self { median: s.median, p95: s.p95 })
    }
}

/// How the hand followed one channel, in the channel's unit: mm for x, y, z, degrees for rx, ry, rz.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelSummary {
    /// `x` to `rz`.
    pub channel: String,
    /// `mm` or `deg`.
    pub unit: &'static str,
    /// Error while the target moves.
    pub moving: Option<RmsMax>,
    /// Error while the target rests.
    pub hold: Option<RmsMax>,
    /// Lag of the hand behind its wanted way by cross-correlation, seconds.
    pub lag_s: Option<f64>,
    /// Rise time (10 to 90 %) of the hand less that of its wanted way, on the way out, seconds.
    pub rise_delay_s: Option<f64>,
}

/// The figures of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSummary {
    /// Duration of the experiment, seconds.
    pub duration_s: f64,
    /// Distance of the hand from where it should be, mm.
    pub tracking_position_mm: Option<RmsMax>,
    /// Angle of the hand to where it should be, degrees.
    pub tracking_orientation_deg: Option<RmsMax>,
    /// The same angle without the rotation about the model's normal, degrees.
    pub tracking_tilt_deg: Option<RmsMax>,
    /// Median lag over the channels that the hand follows, seconds.
    pub lag_s: Option<f64>,
    /// Each channel by itself.
    pub channels: Vec<ChannelSummary>,
    /// Absolute depth error of the estimates, mm.
    pub estimation_depth_mm: Option<MedianP95>,
    /// Normal error of the estimates, degrees.
    pub estimation_normal_deg: Option<MedianP95>,
    /// The leading method and those that looked on, side by side.
    pub methods: Vec<MethodSummary>,
    /// Frames seen.
    pub frames: usize,
    /// Frames without a pose.
    pub frames_without_pose: usize,
    /// Number of frames with each status.
    pub frames_by_status: BTreeMap<String, usize>,
    /// Whether the method measured the rotation about the model's normal.
    pub rotation_about_normal_observed: bool,
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// Wall time from the pair in memory to the estimate, milliseconds: median.
    pub latency_p50_millis: Option<f64>,
    /// The same, 99th percentile.
    pub latency_p99_millis: Option<f64>,
    /// Share of the control steps in each mode of the controller, 0 to 1.
    pub share_by_mode: BTreeMap<String, f64>,
    /// Smallest singular value of the Jacobian during the run.
    pub smallest_singular_value: Option<f64>,
    /// What became of the velocities of each arm.
    pub commands: Vec<CommandSummary>,
    /// How punctual the cycles were; of a run in the machine's time only.
    pub cycles: Vec<CycleSummary>,
}

/// What is known of the experiment beforehand.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Channels in the order of the marks, two marks each.
    pub channels: Vec<Channel>,
    /// Duration of each move, seconds.
    pub move_s: f64,
    /// Directions of the channels' axes in `world`.
    pub world_from_axes: UnitQuaternion<f64>,
}

impl Plan {
    /// What these numbers mean where the experiment takes place.
    pub fn of(config: &StepExperimentConfig, experiment: &StepExperiment) -> Self {
        let world_from_axes = match config.axes {
            ExperimentAxes::World => UnitQuaternion::identity(),
            ExperimentAxes::TargetAtStart => experiment.pose_at(0.0).rotation(),
        };
        Self { channels: config.channels.clone(), move_s: config.move_s, world_from_axes }
    }
}

/// The way of the hand along a channel since the start of the run: mm or degrees.
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

/// The figures of `log`.
pub fn summarize(log: &RunLog, plan: &Plan) -> RunSummary {
    let errors: Vec<TrackingError> = log.control.iter().map(TrackingError::of).collect();
    let column = |pick: fn(&TrackingError) -> f64| errors.iter().map(pick).collect::<Vec<f64>>();
    let channels = channel_summaries(log, plan);
    let lags: Vec<f64> = channels.iter().filter_map(|c| c.lag_s).collect();
    let latencies: Vec<f64> = log.leading.frames.iter().map(|f| f.latency_millis).collect();
    let depth: Vec<f64> = log.leading.frames.iter().filter_map(|f| f.depth_error_m).map(|e| e.abs() * 1e3).collect();
    let normal: Vec<f64> = log.leading.frames.iter().filter_map(|f| f.normal_error_rad).map(f64::to_degrees).collect();
    RunSummary {
        duration_s: log.control.last().map_or(0.0, |sample| sample.t_s),
        tracking_position_mm: RmsMax::of(&column(|e| e.position_m * 1e3)),
        tracking_orientation_deg: RmsMax::of(&column(|e| e.orientation_rad.to_degrees())),
        tracking_tilt_deg: RmsMax::of(&column(|e| e.tilt_rad.to_degrees())),
        lag_s: percentile(&lags, 50.0),
        channels,
        estimation_depth_mm: MedianP95::of(&depth),
        estimation_normal_deg: MedianP95::of(&normal),
        methods: methods::summaries(log),
        frames: log.leading.frames.len(),
        frames_without_pose: log.leading.frames.iter().filter(|f| f.depth_error_m.is_none()).count(),
        frames_by_status: log.leading.frames.iter().fold(BTreeMap::new(), |mut counts, frame| {
            *counts.entry(frame.status.clone()).or_default() += 1;
            counts
        }),
        rotation_about_normal_observed: log.leading.rotation_about_normal_observed,
        pairs_lost: log.pairs_lost,
        latency_p50_millis: percentile(&latencies, 50.0),
        latency_p99_millis: percentile(&latencies, 99.0),
        share_by_mode: shares(log.control.iter().map(ControlSample::mode_word)),
        smallest_singular_value: log.control.iter().map(|s| s.smallest_singular_value).reduce(f64::min),
        commands: log.commands.clone(),
        cycles: log.cycles.clone(),
    }
}

/// How often each word occurs, as a share of all.
fn shares<'a>(words: impl Iterator<Item = &'a str>) -> BTreeMap<String, f64> {
    let mut counts = BTreeMap::<String, f64>::new();
    words.for_each(|word| *counts.entry(word.to_owned()).or_default() += 1.0);
    let total: f64 = counts.values().sum();
    counts.values_mut().for_each(|count| *count /= total);
    counts
}

impl RunSummary {
    /// Share of the time in which the hand followed or approached, 0 to 1.
    pub fn share_following(&self) -> f64 {
        // A sum of nothing would be -0.
        ["tracking", "approaching"].iter().filter_map(|mode| self.share_by_mode.get(*mode)).fold(0.0, |sum, x| sum + x)
    }
}

/// Distance between the hand and its wanted pose.
#[derive(Clone, Copy, Debug)]
pub struct TrackingError {
    /// Metres.
    pub position_m: f64,
    /// Radians.
    pub orientation_rad: f64,
    /// Angle between the viewing axes, radians: without the rotation about them.
    pub tilt_rad: f64,
}

impl TrackingError {
    /// The error of one control step.
    pub fn of(sample: &ControlSample) -> Self {
        let (wanted, is) = (&sample.world_from_hand_wanted, &sample.world_from_hand);
        let axis = |pose: &Pose<World, Hand>| pose.transform_vector(&Vector3::z());
        Self {
            position_m: (is.translation_m() - wanted.translation_m()).norm(),
            orientation_rad: wanted.rotation().angle_to(&is.rotation()),
            tilt_rad: axis(wanted).angle(&axis(is)),
        }
    }
}

fn channel_summaries(log: &RunLog, plan: &Plan) -> Vec<ChannelSummary> {
    let Some(first) = log.control.first() else { return Vec::new() };
    let marks_s: Vec<f64> = log.marks.iter().map(|mark| mark.at_s).collect();
    let end_s = log.control.last().map_or(0.0, |sample| sample.t_s);
    let mut summaries = Vec::new();
    for (index, &channel) in plan.channels.iter().enumerate() {
        let Some(&out_s) = marks_s.get(2 * index) else { break };
        let back_s = marks_s.get(2 * index + 1).copied().unwrap_or(end_s);
        let after_s = marks_s.get(2 * index + 2).copied().unwrap_or(end_s + 1e-9);
        let span: Vec<&ControlSample> = log.control.iter().filter(|s| s.t_s >= out_s && s.t_s < after_s).collect();
        if span.len() < 3 {
            break;
        }
        let way = |pick: fn(&ControlSample) -> &Pose<World, Hand>| -> Vec<f64> {
            span.iter().map(|s| way_along(plan, channel, &first.world_from_hand_wanted, pick(s))).collect()
        };
        let wanted = way(|s| &s.world_from_hand_wanted);
        let is = way(|s| &s.world_from_hand);
        let error_where = |inside: &dyn Fn(f64) -> bool| -> Vec<f64> {
            span.iter().zip(is.iter().zip(&wanted)).filter(|(s, _)| inside(s.t_s)).map(|(_, (a, b))| a - b).collect()
        };
        let moving = |t: f64| (t < out_s + plan.move_s) || (t >= back_s && t < back_s + plan.move_s);
        let rest_from = plan.move_s + SETTLE_S;
        let hold = |t: f64| (t >= out_s + rest_from && t < back_s) || t >= back_s + rest_from;
        let period_s = span[1].t_s - span[0].t_s;
        let way_out = span.iter().take_while(|s| s.t_s < back_s).count();
        summaries.push(ChannelSummary {
            channel: channel.name().to_owned(),
            unit: if channel.is_rotation() { "deg" } else { "mm" },
            moving: RmsMax::of(&error_where(&moving)),
            hold: RmsMax::of(&error_where(&hold)),
            lag_s: lag_s(&wanted, &is, period_s),
            rise_delay_s: rise_delay_s(&wanted[..way_out], &is[..way_out], period_s),
        });
    }
    summaries
}

/// The lag, if the response follows the reference at all; a channel that is not observed has none.
fn lag_s(reference: &[f64], response: &[f64], period_s: f64) -> Option<f64> {
    lag_by_cross_correlation(reference, response, period_s, LAG_MAX_S)
        .filter(|lag| lag.correlation > CORRELATION_MIN)
        .map(|lag| lag.lag_s)
}

/// 10-90 % rise time of the response less that of the reference; both measured against the reference's own way.
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

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_geometry::frames::{Target, World};
    use pb3dp_sim::trajectory::{StepExperiment, StepExperimentConfig, Trajectory};

    /// A hand that follows 300 ms late and 2 mm beside its place, with the target's axes turned against the world's.
    fn late_hand() -> (RunLog, Plan) {
        let start = Pose::<World, Target>::from_parts(
            Vector3::new(0.9, -0.2, 1.1),
            UnitQuaternion::from_euler_angles(0.4, -0.7, 1.2),
        );
        let config = StepExperimentConfig { channels: vec![Channel::X, Channel::Ry], ..Default::default() };
        let plan = Plan { channels: config.channels.clone(), move_s: config.move_s, world_from_axes: start.rotation() };
        let experiment = StepExperiment::new(config, start).unwrap();
        let wanted = |t: f64| -> Pose<World, Hand> {
            experiment.pose_at(t) * Pose::from_translation(Vector3::new(0.01, 0.02, -0.5))
        };
        let beside = start.transform_vector(&Vector3::new(0.002, 0.0, 0.0));
        let control = (0..)
            .map(|i| f64::from(i) * 0.01)
            .take_while(|&t| t <= experiment.duration_s())
            .map(|t| {
                let late = wanted((t - 0.3).max(0.0));
                ControlSample {
                    t_s: t,
                    world_from_target: experiment.pose_at(t),
                    world_from_hand: Pose::from_parts(late.translation_m() + beside, late.rotation()),
                    world_from_hand_wanted: wanted(t),
                    mode: "tracking".into(),
                    smallest_singular_value: 0.2,
                }
            })
            .collect();
        (RunLog { control, marks: experiment.marks().to_vec(), ..Default::default() }, plan)
    }

    #[test]
    fn lag_and_errors_are_those_that_were_put_in() {
        let (log, plan) = late_hand();
        let summary = summarize(&log, &plan);
        let x = &summary.channels[0];
        let ry = &summary.channels[1];
        assert_eq!((x.channel.as_str(), x.unit, ry.channel.as_str(), ry.unit), ("x", "mm", "ry", "deg"));
        for channel in &summary.channels {
            assert!((channel.lag_s.unwrap() - 0.3).abs() < 0.02, "{channel:?}");
            assert!(channel.rise_delay_s.unwrap().abs() < 0.02, "{channel:?}");
        }
        // Beside by 2 mm along x at rest; 300 ms late at up to 1.875 x 50 mm/s while moving.
        assert!((x.hold.unwrap().rms - 2.0).abs() < 0.05, "{x:?}");
        assert!(x.moving.unwrap().max > 25.0 && x.moving.unwrap().max < 32.0, "{x:?}");
        assert!(ry.hold.unwrap().max < 0.05 && ry.moving.unwrap().max > 4.5, "{ry:?}");
        assert!(summary.tracking_tilt_deg.unwrap().max <= summary.tracking_orientation_deg.unwrap().max + 1e-9);
    }

    #[test]
    fn a_turn_about_the_viewing_axis_is_no_tilt() {
        let (mut log, plan) = late_hand();
        for sample in &mut log.control {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.35));
            let wanted = sample.world_from_hand_wanted;
            sample.world_from_hand = Pose::from_parts(wanted.translation_m(), wanted.rotation() * turn);
        }
        let summary = summarize(&log, &plan);
        assert!((summary.tracking_orientation_deg.unwrap().rms - 0.35_f64.to_degrees()).abs() < 1e-6);
        assert!(summary.tracking_tilt_deg.unwrap().max < 1e-4);
    }

    #[test]
    fn an_empty_log_has_no_figures() {
        let (_, plan) = late_hand();
        let summary = summarize(&RunLog::default(), &plan);
        assert!(summary.channels.is_empty() && summary.tracking_position_mm.is_none() && summary.frames == 0);
    }
}
