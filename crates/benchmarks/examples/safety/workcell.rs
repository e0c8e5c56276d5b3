//! What differs between the workcells of the runs: wire format, dialect and speeds, and drives that differ from their model.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_servo::LawConfig;
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::setup::{Leader, Pace, Setup, read_layers};
use system_tests::repository;
use system_tests::safety::rules::Rules;

use crate::scenario::Dice;

/// Length of the history; disabling both arms takes less.
const HISTORY: Duration = Duration::from_secs(5);
/// Share of the drives' speeds in `configs/sim.toml`, to which the rules refer.
const SPEED_SCALE: f64 = 0.6;

/// The settings of a workcell that a setup states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Settings {
    /// Wire format of both controllers.
    pub wire_format: &'static str,
    /// Dialect of both gateways.
    pub dialect: &'static str,
    /// Share of the drives' speeds, percent.
    pub speed_percent: u32,
}

/// The workcell of a run.
#[derive(Clone, Debug)]
pub struct Workcell {
    /// Its settings.
    pub settings: Settings,
    /// Time constant of the drives of each arm, as a share of that of the model.
    pub lag: [f64; 2],
    /// Delay of the arm in the model of the controller, as a share of the true one.
    pub model_delay: f64,
}

impl Default for Workcell {
    /// The workcell of `configs/hil.toml`, exactly known.
    fn default() -> Self {
        let settings = Settings { wire_format: "B", dialect: "gateway-v1", speed_percent: 60 };
        Self { settings, lag: [1.0; 2], model_delay: 1.0 }
    }
}

impl Workcell {
    /// Draws a workcell; half of the runs have exactly known drives.
    pub fn draw(dice: &mut Dice) -> Self {
        /// Drives and their model differ by at most this factor.
        const FACTOR: f64 = 2.0;
        let settings = Settings {
            wire_format: dice.pick(&["B", "A"]),
            dialect: dice.pick(&["gateway-v1", "transparent"]),
            speed_percent: dice.pick(&[60, 60, 60, 25, 10]),
        };
        let is_known = dice.unit() < 0.5;
        let mut factor = || FACTOR.powf(dice.within(-1.0, 1.0));
        let factors = [factor(), factor(), factor()];
        let [first, second, model_delay] = if is_known { [1.0; 3] } else { factors };
        Self { settings, lag: [first, second], model_delay }
    }

    /// The limits that hold in this workcell.
    pub fn rules(&self) -> Rules {
        let mut rules = Rules::of_the_rig();
        let speed = f64::from(self.settings.speed_percent) / 100.0 / SPEED_SCALE;
        for (arm, lag) in rules.arms.iter_mut().zip(self.lag) {
            arm.lag_s *= lag;
            arm.speed_rad_per_s = arm.speed_rad_per_s.map(|limit| limit * speed);
        }
        rules
    }

    /// Changes the drives of a setup, and its model of them.
    pub fn apply(&self, setup: &mut Setup) {
        for (arm, lag) in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc].into_iter().zip(self.lag) {
            arm.plant.velocity_time_constant = arm.plant.velocity_time_constant.mul_f64(lag);
        }
        if let LawConfig::FeedForward(law) = &mut setup.controller.law {
            law.arm.delay_s *= self.model_delay;
        }
    }
}

/// The setups of all settings, each read once.
#[derive(Default)]
pub struct Setups(Mutex<BTreeMap<(Settings, bool), Arc<Setup>>>);

impl Setups {
    /// The setup of `configs/hil.toml` with these settings, in simulated time, with or without images.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn get(&self, settings: Settings, rendered: bool) -> Result<Arc<Setup>> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(setup) = known.get(&(settings, rendered)) {
            return Ok(Arc::clone(setup));
        }
        let setup = Arc::new(read(settings, rendered)?);
        known.insert((settings, rendered), Arc::clone(&setup));
        Ok(setup)
    }
}

fn read(settings: Settings, rendered: bool) -> Result<Setup> {
    let Settings { wire_format, dialect, speed_percent } = settings;
    let of_arm = |arm: &str| {
        let gateway = format!("arms.{arm}.gateway");
        [format!("{gateway}.wire_format=\"{wire_format}\""), format!("{gateway}.dialect=\"{dialect}\"")]
    };
    let speed = format!("arms.speed_scale={}", f64::from(speed_percent) / 100.0);
    let set = [of_arm("vs"), of_arm("tc")].concat().into_iter().chain([speed]).collect();
    let args = SetupArgs { configs: vec![repository().join("configs/hil.toml")], set, ..SetupArgs::default() };
    let mut setup = read_layers(&args).with_context(|| format!("configs/hil.toml with {settings:?}"))?;
    setup.pace = Pace::Fast;
    setup.compared.clear();
    if !rendered {
        setup.leader = Leader::Geometric(setup.geometric.context("configs/hil.toml has no table estimator.geometric")?);
    }
    for arm in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc] {
        arm.plant.history = HISTORY;
    }
    Ok(setup)
}
