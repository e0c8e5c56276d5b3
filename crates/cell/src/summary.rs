//! Figures of a run: tracking errors, estimation errors and latencies.
//!
//! Tracking errors are against the desired hand pose in front of the true target. A second set is against the desired pose by the initial
//! lock: the initial pose error stays for the whole run and is not a servo error. With real cameras there is no true pose and none of these
//! figures.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use pb3dp_record::metrics::percentile;
use serde::Serialize;

use super::channels::{self, ChannelSummary, LockedErrors, Plan};
use super::commands::CommandSummary;
use super::compared::NO_TARGET;
use super::cycles::CycleSummary;
use super::drift::DriftSummary;
use super::log::{ControlSample, Lock, RunLog};
use super::methods::{self, MethodSummary};
use super::supervision::Supervision;
use crate::figures::{MedianP95, RmsMax, TrackingError};

/// The figures of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunSummary {
    /// Failure that ended the run early; none if nothing failed.
    pub ended_by: Option<String>,
    /// Duration of the experiment, seconds.
    pub duration_s: f64,
    /// Distance of the hand from its desired pose, mm.
    pub tracking_position_mm: Option<RmsMax>,
    /// Angle of the hand to its desired pose, degrees.
    pub tracking_orientation_deg: Option<RmsMax>,
    /// The same angle without the rotation about the model's normal, degrees.
    pub tracking_tilt_deg: Option<RmsMax>,
    /// Errors against the desired pose by the initial lock, over all channels.
    pub locked: LockedErrors,
    /// Initial pose error; none without an initial lock.
    pub lock: Option<LockSummary>,
    /// Median lag over the channels that the hand follows, seconds.
    pub lag_s: Option<f64>,
    /// Each channel by itself.
    pub channels: Vec<ChannelSummary>,
    /// Absolute depth error of the estimates, mm.
    pub estimation_depth_mm: Option<MedianP95>,
    /// Normal error of the estimates, degrees.
    pub estimation_normal_deg: Option<MedianP95>,
    /// Whether there is no true pose: errors of hand and estimates are unknown.
    pub without_truth: bool,
    /// Whether no image was rendered: the estimates are the true pose with noise.
    #[serde(rename = "without_pictures")]
    pub without_images: bool,
    /// The leading method and the compared methods.
    pub methods: Vec<MethodSummary>,
    /// Frames processed.
    pub frames: usize,
    /// Frames without a pose.
    pub frames_without_pose: usize,
    /// Number of frames with each status.
    pub frames_by_status: BTreeMap<String, usize>,
    /// Whether the method measured the rotation about the model's normal.
    pub rotation_about_normal_observed: bool,
    /// Pairs that the camera could not deliver.
    pub pairs_lost: u64,
    /// Camera drift since calibration, if it was measured.
    pub drift: Vec<DriftSummary>,
    /// Median wall time from the pair in memory to the estimate, milliseconds.
    pub latency_p50_millis: Option<f64>,
    /// 99th percentile of the same time, milliseconds.
    pub latency_p99_millis: Option<f64>,
    /// Share of the control steps in each mode of the controller, 0 to 1.
    pub share_by_mode: BTreeMap<String, f64>,
    /// Supervisor decisions.
    pub supervisor: Supervision,
    /// Smallest singular value of the Jacobian during the run.
    pub smallest_singular_value: Option<f64>,
    /// Velocity command counts of each arm.
    pub commands: Vec<CommandSummary>,
    /// Timing of the cycles; only in a real-time run.
    pub cycles: Vec<CycleSummary>,
}

/// Initial pose error: constant for the whole run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LockSummary {
    /// Distance between the desired hand poses by the true plane and by the estimate, mm.
    pub hand_mm: f64,
    /// Angle between the true normal and the estimated one, degrees.
    pub tilt_deg: f64,
    /// Standard deviation of that angle about one axis as stated by the estimate (rms of both axes), degrees; none if not stated.
    pub tilt_sigma_deg: Option<f64>,
    /// Resulting displacement of the hand: its distance times the standard deviation, mm.
    pub hand_by_tilt_sigma_mm: Option<f64>,
}

impl LockSummary {
    fn of(lock: &Lock, sample: &ControlSample) -> Self {
        let tilt_sigma_rad = lock.covariance.map(|covariance| (0.5 * (covariance[(3, 3)] + covariance[(4, 4)])).sqrt());
        let normals =
            [lock.target_from_model, lock.target_from_model_found].map(|pose| pose.transform_vector(&Vector3::z()));
        let (wanted, locked) = (&sample.world_from_hand_wanted, &sample.world_from_hand_locked);
        let model_from_hand = (sample.world_from_target * lock.target_from_model).inverse() * *wanted;
        Self {
            hand_mm: (wanted.translation_m() - locked.translation_m()).norm() * 1e3,
            tilt_deg: normals[0].angle(&normals[1]).to_degrees(),
            tilt_sigma_deg: tilt_sigma_rad.map(f64::to_degrees),
            hand_by_tilt_sigma_mm: tilt_sigma_rad.map(|sigma| model_from_hand.translation_m().norm() * sigma * 1e3),
        }
    }
}

impl RunSummary {
    /// Why there is no initial lock.
    pub fn why_no_lock(&self) -> &'static str {
        match self.frames_by_status.get(NO_TARGET) {
            Some(frames) if *frames == self.frames => "No target was selected: the hand had nothing to follow.",
            _ => "There was no initial lock.",
        }
    }
}

/// The figures of `log`.
pub fn summarize(log: &RunLog, plan: &Plan) -> RunSummary {
    let errors: Vec<TrackingError> = log.judged().iter().map(TrackingError::of).collect();
    let column = |pick: fn(&TrackingError) -> f64| errors.iter().map(pick).collect::<Vec<f64>>();
    let (channels, locked) = channels::summaries(log, plan);
    let lags: Vec<f64> = channels.iter().filter_map(|c| c.lag_s).collect();
    let leading = MethodSummary::leading(log);
    RunSummary {
        ended_by: None,
        duration_s: log.control.last().map_or(0.0, |sample| sample.t_s),
        tracking_position_mm: RmsMax::of(&column(|e| e.position_m * 1e3)),
        tracking_orientation_deg: RmsMax::of(&column(|e| e.orientation_rad.to_degrees())),
        tracking_tilt_deg: RmsMax::of(&column(|e| e.tilt_rad.to_degrees())),
        locked,
        lock: log.lock.as_ref().zip(log.control.last()).map(|(lock, sample)| LockSummary::of(lock, sample)),
        lag_s: percentile(&lags, 50.0),
        channels,
        estimation_depth_mm: leading.depth_mm,
        estimation_normal_deg: leading.normal_deg,
        without_truth: log.without_truth,
        without_images: log.without_images,
        frames: log.leading.frames.len(),
        frames_without_pose: log.leading.estimated.iter().filter(|pose| pose.is_none()).count(),
        frames_by_status: leading.frames_by_status.clone(),
        rotation_about_normal_observed: leading.rotation_about_normal_observed,
        pairs_lost: log.pairs_lost,
        drift: log.drift.clone(),
        latency_p50_millis: leading.latency_p50_millis,
        latency_p99_millis: leading.latency_p99_millis,
        methods: methods::summaries(log, leading),
        supervisor: log.supervision.summary(),
        share_by_mode: shares(log.control.iter().map(ControlSample::mode_name)),
        smallest_singular_value: log.control.iter().map(|s| s.smallest_singular_value).reduce(f64::min),
        commands: log.commands.clone(),
        cycles: log.cycles.clone(),
    }
}

/// Share of each word among all, 0 to 1.
fn shares<'a>(names: impl Iterator<Item = &'a str>) -> BTreeMap<String, f64> {
    let mut counts = BTreeMap::<String, f64>::new();
    names.for_each(|name| *counts.entry(name.to_owned()).or_default() += 1.0);
    let total: f64 = counts.values().sum();
    counts.values_mut().for_each(|count| *count /= total);
    counts
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix6, UnitQuaternion, Vector6};
    use pb3dp_geometry::Pose;
    use pb3dp_geometry::frames::{Hand, World};
    use pb3dp_geometry::frames::{Model, Target};
    use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig, StepExperimentConfig, Trajectory};

    use super::*;

    /// A hand that follows 300 ms late with a 2 mm offset; the target axes are rotated against the world.
    fn late_hand() -> (RunLog, Plan) {
        let start = start();
        let config = StepExperimentConfig { channels: vec![Channel::X, Channel::Ry], ..Default::default() };
        let (log, plan, _) = follows(MotionConfig::Steps(config), start, |t| (t - 0.3).max(0.0));
        (log, plan)
    }

    /// The hand pose: the desired one of another time, plus a 2 mm offset.
    fn follows(
        motion: MotionConfig,
        start: Pose<World, Target>,
        other: impl Fn(f64) -> f64,
    ) -> (RunLog, Plan, std::sync::Arc<dyn Trajectory>) {
        let experiment = motion.begin_at(start).unwrap();
        let plan = Plan::of(&motion, &*experiment);
        let wanted = |t: f64| -> Pose<World, Hand> {
            experiment.pose_at(t) * Pose::from_translation(Vector3::new(0.01, 0.02, -0.5))
        };
        let beside = start.transform_vector(&Vector3::new(0.002, 0.0, 0.0));
        let control = (0..)
            .map(|i| f64::from(i) * 0.01)
            .take_while(|&t| t <= experiment.duration_s())
            .map(|t| {
                let late = wanted(other(t));
                ControlSample {
                    t_s: t,
                    world_from_target: experiment.pose_at(t),
                    world_from_hand: Pose::from_parts(late.translation_m() + beside, late.rotation()),
                    world_from_hand_wanted: wanted(t),
                    world_from_hand_locked: wanted(t),
                    mode: "tracking".into(),
                    smallest_singular_value: 0.2,
                    arms: Default::default(),
                }
            })
            .collect();
        (RunLog { control, marks: experiment.marks().to_vec(), ..Default::default() }, plan, experiment)
    }

    fn start() -> Pose<World, Target> {
        Pose::from_parts(Vector3::new(0.9, -0.2, 1.1), UnitQuaternion::from_euler_angles(0.4, -0.7, 1.2))
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
        // At hold 2 mm offset along x; moving: 300 ms lag at up to 1.875 x 50 mm/s.
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
    fn a_sinusoid_has_gain_and_phase_and_no_rest() {
        // 0.3 s late of 5 s: 21.6 degrees; a turn by 0.35 rad about a fixed axis has the same phase.
        for (channel, amplitude) in [(Channel::Y, 0.1), (Channel::Rx, 0.35)] {
            let axes = ExperimentAxes::TargetAtStart;
            let sine = SineConfig { channel, amplitude, period_s: 5.0, periods: 2, lead_in_s: 1.0, axes };
            let (log, plan, _) = follows(MotionConfig::Sine(sine), start(), |t| t - 0.3);
            let summary = summarize(&log, &plan);
            let [found] = &summary.channels[..] else { panic!("one channel: {summary:?}") };
            assert!(found.gain_db.unwrap().abs() < 0.01, "{found:?}");
            assert!((found.phase_deg.unwrap() + 21.6).abs() < 0.1, "{found:?}");
            assert!((found.lag_s.unwrap() - 0.3).abs() < 0.02, "{found:?}");
            assert!(found.moving.is_some() && found.hold.is_none() && found.rise_delay_s.is_none(), "{found:?}");
            assert!(found.settled_after_s.is_none() && found.overshoot_percent.is_none());
        }
    }

    #[test]
    fn a_sudden_move_has_settling_and_overshoot_and_no_lag() {
        let steps = StepExperimentConfig {
            channels: vec![Channel::Z],
            move_s: 0.0,
            hold_s: 2.0,
            lead_in_s: 1.0,
            ..Default::default()
        };
        // The hand is 0.5 s late on the move out and 0.8 s on the move back; with a 2 mm offset it never settles.
        let late = |t: f64| if t < 3.0 { t - 0.5 } else { t - 0.8 };
        let (mut log, plan, _) = follows(MotionConfig::Steps(steps), start(), late);
        assert_eq!(summarize(&log, &plan).channels[0].settled_after_s, None);
        // Against the initial lock it reaches the desired pose, with 4 mm overshoot in between.
        let away = start().transform_vector(&Vector3::new(0.0, 0.0, 0.004));
        let beside = start().transform_vector(&Vector3::new(0.002, 0.0, 0.0));
        for sample in &mut log.control {
            let wanted = sample.world_from_hand_wanted;
            sample.world_from_hand_locked = Pose::from_parts(wanted.translation_m() + beside, wanted.rotation());
            if (1.6..1.7).contains(&sample.t_s) {
                let hand = sample.world_from_hand;
                sample.world_from_hand = Pose::from_parts(hand.translation_m() + away, hand.rotation());
            }
        }
        let found = &summarize(&log, &plan).channels[0];
        assert!((found.settled_after_s.unwrap() - 0.8).abs() < 0.011, "{found:?}");
        assert!((found.overshoot_percent.unwrap() - 4.0).abs() < 1e-6, "{found:?}");
        assert!(found.lag_s.is_none() && found.rise_delay_s.is_none() && found.moving.is_none(), "{found:?}");
    }

    #[test]
    fn the_error_of_the_lock_is_reported_separately() {
        let (mut log, plan) = late_hand();
        let target_from_model = Pose::<Target, Model>::from_translation(Vector3::new(0.01, 0.02, 0.0));
        let tilted = Pose::from_parts(Vector3::zeros(), UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.01, 0.0)));
        let model_from_hand = Pose::<Model, Hand>::from_translation(Vector3::new(0.0, 0.0, -0.5));
        let found = target_from_model * tilted;
        for sample in &mut log.control {
            sample.world_from_hand_locked = sample.world_from_target * found * model_from_hand;
        }
        let covariance = Some(Matrix6::from_diagonal(&Vector6::new(0.0, 0.0, 0.0, 9e-6, 1.6e-5, 1.0)));
        log.lock = Some(Lock { at_s: 0.0, target_from_model, target_from_model_found: found, covariance });
        let lock = summarize(&log, &plan).lock.unwrap();
        // 500 mm x 2 sin(0.005); sigma is the root of the mean of 9 and 16, in mrad.
        assert!((lock.hand_mm - 1000.0 * 0.005_f64.sin()).abs() < 1e-9, "{lock:?}");
        assert!((lock.tilt_deg - 0.01_f64.to_degrees()).abs() < 1e-9, "{lock:?}");
        assert!((lock.hand_by_tilt_sigma_mm.unwrap() - 500.0 * 12.5e-6_f64.sqrt()).abs() < 1e-6, "{lock:?}");
    }

    #[test]
    fn an_empty_log_has_no_figures() {
        let (_, plan) = late_hand();
        let summary = summarize(&RunLog::default(), &plan);
        assert!(summary.channels.is_empty() && summary.tracking_position_mm.is_none() && summary.frames == 0);
    }
}
