//! The runs: the experiment of Fig. 7, sinusoids, steps.

use std::time::Instant;

use anyhow::{Context, Result};
use pb3dp_cell::channels::ChannelSummary;
use pb3dp_cell::experiment;
use pb3dp_cell::journal::Outcome;
use pb3dp_cell::log::RunLog;
use pb3dp_cell::summary::{RunSummary, summarize};
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::{Channel, MotionConfig};
use pb3dp_wiring::wire;

use crate::demands::{Demand, demands, shortest_step};
use crate::ideal::{HandNoise, Ideal, MeasuredTarget, hand_noise};
use crate::setups::{DELAYS_MILLIS, Fig7Case, TARGETS, Who, geometric, sinusoid, step};

/// Time after a move by which the hand should have settled, seconds.
const SETTLE_S: f64 = 1.0;
/// Share of the step that counts as settled: 1 mm of 50, and 0.3 degrees of 15.
const STEP_WITHIN_SHARE: f64 = 0.02;

/// A run with its log.
pub struct Ran {
    /// The log.
    pub log: RunLog,
    /// Its figures.
    pub summary: RunSummary,
    /// Simulated seconds per second of this machine, including the setup.
    pub times_real_time: f64,
}

/// Builds a setup and runs it to its end, or to `stop_after_s`.
///
/// # Errors
/// Errors of the parts.
pub fn run(setup: &Setup, stop_after_s: Option<f64>) -> Result<Ran> {
    let started = Instant::now();
    let parts = wire(setup)?;
    let Outcome { log, plan, .. } = experiment::run(setup, parts, stop_after_s, None)?;
    let wall_s = started.elapsed().as_secs_f64();
    let summary = summarize(&log, &plan);
    Ok(Ran { times_real_time: summary.duration_s / wall_s, log, summary })
}

/// One run of the experiment of Fig. 7.
pub struct Fig7 {
    /// Method and law that controlled the hand.
    pub who: &'static str,
    /// The target, or the reason why there was none.
    pub target: String,
    /// Total delay, milliseconds.
    pub delay_millis: f64,
    /// Seed of everything random.
    pub seed: u64,
    /// Its figures.
    pub summary: RunSummary,
    /// Error of the ideal filter, over all channels.
    pub ideal: IdealPhases,
    /// The same for each channel.
    pub channel_ideals: Vec<IdealPhases>,
    /// White noise of the estimates at the hand: mm along x, y, z, degrees about them.
    pub noise: Option<[f64; 6]>,
    /// Whole error of the estimates relative to the initial lock, rms at the hand: mm and degrees.
    pub estimates: Option<[f64; 2]>,
    /// The log, for the figure.
    pub log: RunLog,
}

/// Error of the ideal filter while the target moves, and while it is stationary.
#[derive(Clone, Copy, Default)]
pub struct IdealPhases {
    /// In motion.
    pub moving: Option<Ideal>,
    /// From a second after the move.
    pub hold: Option<Ideal>,
}

/// The experiment of Fig. 7 with images.
///
/// # Errors
/// Errors of the parts.
pub fn fig7(case: &Fig7Case, seed: Option<u64>, stop_after_s: Option<f64>) -> Result<Fig7> {
    fig7_of(&case.setup(seed)?, case, TARGETS[case.target].0, stop_after_s)
}

/// The experiment of Fig. 7 of a setup.
///
/// # Errors
/// Errors of the parts.
pub fn fig7_of(setup: &Setup, case: &Fig7Case, target_name: &str, stop_after_s: Option<f64>) -> Result<Fig7> {
    let Ran { log, summary, .. } = run(setup, stop_after_s)?;
    let first = log.control.first().context("the run has no steps")?;
    let target = setup.experiment.motion.begin_at(first.world_from_target)?;
    let measured = hand_noise(&log, &setup.controller.model_from_hand_desired);
    let (ideal, channel_ideals) = match (&measured, &log.lock) {
        (Some((noise, _)), Some(lock)) => {
            let target_from_hand = lock.target_from_model_found * setup.controller.model_from_hand_desired;
            let (delay_s, frame_s) = (case.delay_millis * 1e-3, setup.rig.frames.period.as_secs_f64());
            let measured_target =
                MeasuredTarget { target: &*target, target_from_hand, noise: *noise, delay_s, frame_s };
            ideals(setup, &measured_target, summary.channels.len())
        }
        _ => (IdealPhases::default(), vec![IdealPhases::default(); summary.channels.len()]),
    };
    Ok(Fig7 {
        who: case.who.name(),
        target: target_name.to_owned(),
        delay_millis: case.delay_millis,
        seed: setup.seed,
        ideal,
        channel_ideals,
        noise: measured.map(|(noise, _)| in_mm_and_degrees(&noise)),
        estimates: measured.map(|(_, [m, rad])| [m * 1e3, rad.to_degrees()]),
        summary,
        log,
    })
}

fn in_mm_and_degrees(noise: &HandNoise) -> [f64; 6] {
    std::array::from_fn(|row| if row < 3 { noise[row] * 1e3 } else { noise[row].to_degrees() })
}

/// The ideal filter over the whole experiment, and over each channel that the run reached.
fn ideals(setup: &Setup, measured_target: &MeasuredTarget<'_>, channels: usize) -> (IdealPhases, Vec<IdealPhases>) {
    let Some(steps) = setup.experiment.steps() else { return (IdealPhases::default(), Vec::new()) };
    let moves: Vec<f64> = measured_target.target.marks().iter().map(|mark| mark.at_s).take(2 * channels).collect();
    let moving: Vec<(f64, f64)> = moves.iter().map(|at_s| (*at_s, at_s + steps.move_s)).collect();
    let hold: Vec<(f64, f64)> =
        moves.iter().map(|at_s| (at_s + steps.move_s + SETTLE_S, at_s + steps.move_s + steps.hold_s)).collect();
    let phases = |moving: &[(f64, f64)], hold: &[(f64, f64)]| IdealPhases {
        moving: measured_target.ideal(moving),
        hold: measured_target.ideal(hold),
    };
    let of_channels = moving.chunks(2).zip(hold.chunks(2)).map(|(moving, hold)| phases(moving, hold)).collect();
    (phases(&moving, &hold), of_channels)
}

/// Response of the hand to one sinusoid.
pub struct Response {
    /// The control law; no image was rendered.
    pub who: &'static str,
    /// `x` to `rz`.
    pub channel: &'static str,
    /// Period, seconds.
    pub period_s: f64,
    /// Demands on the arm, the largest first; none if the motion leads out of the arm's range.
    pub demands: Option<Vec<Demand>>,
    /// Why there are no demands.
    pub refusal: Option<String>,
    /// Gain, dB.
    pub gain_db: Option<f64>,
    /// Phase, degrees; negative if the hand lags.
    pub phase_deg: Option<f64>,
}

impl Response {
    /// Whether the arm could follow without lag.
    pub fn is_possible(&self) -> bool {
        self.demands.as_ref().and_then(|demands| demands.first()).is_some_and(|demand| demand.share < 1.0)
    }
}

/// Response to a sinusoid, without images.
///
/// # Errors
/// Errors of the parts.
pub fn response(who: Who, channel: Channel, period_s: f64) -> Result<Response> {
    let setup = geometric(who.setup(DELAYS_MILLIS[0])?, sinusoid(channel, period_s))?;
    let demanded = demands(&setup, &setup.experiment.motion);
    let refusal = demanded.as_ref().err().map(|error| format!("{error:#}"));
    let found = match &demanded {
        Ok(_) => run(&setup, None)?.summary.channels.pop(),
        Err(_) => None,
    };
    Ok(Response {
        who: who.name(),
        channel: channel.name(),
        period_s,
        demands: demanded.ok(),
        refusal,
        gain_db: found.as_ref().and_then(|found| found.gain_db),
        phase_deg: found.as_ref().and_then(|found| found.phase_deg),
    })
}

/// Response of the hand to a step.
pub struct Step {
    /// The control law; no image was rendered.
    pub who: &'static str,
    /// The figures of its channel.
    pub summary: ChannelSummary,
    /// Lower bound of the settling time, seconds.
    pub shortest_s: f64,
    /// What determines the bound.
    pub set_by: String,
}

/// Response to a step, without images.
///
/// # Errors
/// Errors of the parts.
pub fn step_response(who: Who, channel: Channel) -> Result<Step> {
    let steps = step(channel);
    let setup = geometric(who.setup(DELAYS_MILLIS[0])?, MotionConfig::Steps(steps.clone()))?;
    let (shortest_s, set_by) = shortest_step(&setup, &steps, DELAYS_MILLIS[0] * 1e-3, STEP_WITHIN_SHARE)?;
    let summary = run(&setup, None)?.summary.channels.pop().context("the run has no channel")?;
    Ok(Step { who: who.name(), summary, shortest_s, set_by })
}
