//! The setups under test: those of the repository, under the conditions of the requirements.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use pb3dp_servo::supervisor::{Action, Condition};
use pb3dp_servo::{ArmResponse, LawConfig};
use pb3dp_setup::setup::{Carrier, Leader, Setup, read_setup};
use pb3dp_sim::targets::TargetConfig;
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig, StepExperimentConfig};
use system_tests::repository;

/// Standard deviation of the image noise, grey levels.
pub const NOISE_GREY: f64 = 3.0;
/// Lag of the arm's drives, part of the total delay.
pub const ARM_LAG: Duration = Duration::from_millis(30);
/// Total delays from the middle of an exposure to the resulting motion, milliseconds.
pub const DELAYS_MILLIS: [f64; 2] = [66.0, 100.0];
/// Latency of the estimate at the first of these delays; for the others it is longer by the difference.
const LATENCY_MILLIS: f64 = 20.0;

/// Method and law that control the hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Who {
    /// The setup of configs/sim.toml: the direct method and the default law.
    Ours,
    /// The setup of configs/published.toml: the published method and the published law.
    Published,
}

impl Who {
    /// Both setups.
    pub const ALL: [Self; 2] = [Self::Ours, Self::Published];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ours => "direct",
            Self::Published => "published",
        }
    }

    /// The setup with the image noise and the arm's lag of the requirements, and this total delay.
    ///
    /// # Errors
    /// If the file cannot be read, or the delay is too short.
    pub fn setup(self, delay_millis: f64) -> Result<Setup> {
        let file = match self {
            Self::Ours => "configs/sim.toml",
            Self::Published => "configs/published.toml",
        };
        let mut setup = read_setup(&repository().join(file))?;
        setup.compared.clear();
        if let Some(world) = setup.world.as_mut() {
            (world.sensor.read_noise_grey, world.sensor.shot_noise_grey) = (NOISE_GREY, 0.0);
        }
        set_delay(&mut setup, delay_millis).with_context(|| format!("{file}: a delay of {delay_millis} ms"))?;
        Ok(setup)
    }
}

/// The targets of the experiment of Fig. 7.
pub const TARGETS: [(&str, TargetConfig); 4] = [
    ("colourful card", TargetConfig::card()),
    ("crab-like card", TargetConfig::crab(0.0)),
    ("crab, relief 25 mm", TargetConfig::crab(0.025)),
    ("grey box", TargetConfig::grey_box()),
];

/// One run of the experiment of Fig. 7 with images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fig7Case {
    /// Method and law that control the hand.
    pub who: Who,
    /// Index of [`TARGETS`].
    pub target: usize,
    /// Total delay, milliseconds.
    pub delay_millis: f64,
}

impl Fig7Case {
    /// All cases: the required ones, and those for comparison.
    pub fn all() -> Vec<Self> {
        let ours = |delay: usize, target: usize| Self { who: Who::Ours, target, delay_millis: DELAYS_MILLIS[delay] };
        let cards = [ours(0, 0), ours(0, 1), ours(1, 0), ours(1, 1)];
        let published = [0, 1].map(|target| Self { who: Who::Published, ..ours(0, target) });
        cards.into_iter().chain(published).chain([ours(0, 2), ours(0, 3)]).collect()
    }

    /// Name in tables and for the option `--only`.
    pub fn name(&self) -> String {
        format!("{}/{}/{} ms", self.who.name(), TARGETS[self.target].0, self.delay_millis)
    }

    /// The setup of the run; `seed` replaces that of the file.
    ///
    /// # Errors
    /// Those of [`Who::setup`].
    pub fn setup(&self, seed: Option<u64>) -> Result<Setup> {
        let mut setup = self.who.setup(self.delay_millis)?;
        if let Some(world) = setup.world.as_mut() {
            world.scene.target = TARGETS[self.target].1;
        }
        if let Some(seed) = seed {
            setup.reseed(seed);
        }
        Ok(setup)
    }
}

/// Sets the total delay: half an exposure, the latency of the estimate, the mean wait for the next control step, the
/// arm's delay and its lag.
fn set_delay(setup: &mut Setup, delay_millis: f64) -> Result<()> {
    setup.estimate_latency =
        Duration::from_secs_f64((LATENCY_MILLIS + delay_millis - DELAYS_MILLIS[0]).max(0.0) * 1e-3);
    let rest_s = delay_millis * 1e-3 - ARM_LAG.as_secs_f64() - until_control_step_s(setup);
    ensure!((0.0..=0.02).contains(&rest_s), "the arm's own delay would be {:.1} ms, allowed are 0 to 20", rest_s * 1e3);
    for arm in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc] {
        arm.plant.velocity_time_constant = ARM_LAG;
        arm.plant.command_delay = Duration::from_secs_f64(rest_s);
        arm.limiter.reaction_time = setup.control_period + arm.plant.command_delay + ARM_LAG;
    }
    // The value that `pb3dp identify delay` would identify.
    if let LawConfig::FeedForward(law) = &mut setup.controller.law {
        law.arm = ArmResponse { delay_s: rest_s, lag_s: ARM_LAG.as_secs_f64() };
    }
    Ok(())
}

/// From the middle of an exposure to the control step that uses the frame, mean over many frames, seconds.
fn until_control_step_s(setup: &Setup) -> f64 {
    const FRAMES: u32 = 300;
    let step_s = setup.control_period.as_secs_f64();
    let camera = &setup.rig.frames;
    let wait_s = |frame: u32| {
        let begin_s = camera.period.as_secs_f64() * f64::from(frame);
        let arrives_s = begin_s + (camera.exposure + setup.estimate_latency).as_secs_f64();
        // A nanosecond early counts as in time: times are whole nanoseconds.
        let used_s = ((arrives_s - 1e-9) / step_s).ceil() * step_s;
        used_s - begin_s - 0.5 * camera.exposure.as_secs_f64()
    };
    (0..FRAMES).map(wait_s).sum::<f64>() / f64::from(FRAMES)
}

/// Without images, with a target that no arm carries.
///
/// # Errors
/// If the setup file has no configuration for runs without images.
pub fn geometric(mut setup: Setup, motion: MotionConfig) -> Result<Setup> {
    let config = setup.geometric.context("the table `estimator.geometric` is missing")?;
    setup.leader = Leader::Geometric(config);
    setup.experiment.carrier = Carrier::Nothing;
    if matches!(&motion, MotionConfig::Steps(steps) if steps.move_s == 0.0) {
        // The response to a jump of the target is measured, so the supervisor must not hold the hand because of it.
        for jump in [Condition::Outlier, Condition::PositionJump, Condition::OrientationJump] {
            setup.supervisor.policies.get_mut(jump).action = Action::Note;
        }
    }
    setup.experiment.motion = motion;
    Ok(setup)
}

/// A sinusoid with an amplitude of 100 mm or 20 degrees.
pub fn sinusoid(channel: Channel, period_s: f64) -> MotionConfig {
    let amplitude = if channel.is_rotation() { 20_f64.to_radians() } else { 0.1 };
    let periods = (8.0 / period_s).ceil().max(1.0) as u32;
    MotionConfig::Sine(SineConfig {
        channel,
        amplitude,
        period_s,
        periods,
        lead_in_s: 3.0,
        axes: ExperimentAxes::TargetAtStart,
    })
}

/// A step of 50 mm or 15 degrees, and back.
pub fn step(channel: Channel) -> StepExperimentConfig {
    StepExperimentConfig {
        channels: vec![channel],
        translation_m: 0.05,
        rotation_rad: 15_f64.to_radians(),
        move_s: 0.0,
        hold_s: 4.0,
        lead_in_s: 3.0,
        axes: ExperimentAxes::TargetAtStart,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The parts of the delay add up to the total, and the law compensates the arm's share.
    #[test]
    fn the_total_delay_is_made_of_its_parts_and_the_law_knows_the_arm() {
        for delay_millis in DELAYS_MILLIS {
            let setup = Who::Ours.setup(delay_millis).unwrap();
            let (plant, law) = (&setup.rig.arms.vs.plant, setup.controller.law);
            let LawConfig::FeedForward(law) = law else { panic!("{law:?}") };
            assert_eq!((law.arm.lag_s, plant.velocity_time_constant), (0.03, ARM_LAG));
            assert!((law.arm.delay_s - plant.command_delay.as_secs_f64()).abs() < 1e-9, "{:?}", law.arm);
            let total_s = until_control_step_s(&setup) + law.arm.delay_s + law.arm.lag_s;
            assert!((total_s * 1e3 - delay_millis).abs() < 1e-3, "{total_s} s instead of {delay_millis} ms");
        }
    }
}
