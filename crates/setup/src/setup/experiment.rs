//! The table `[experiment]`: motion of the target.

use pb3dp_sim::trajectory::{Channel, ExperimentAxes, Mark, MotionConfig, SineConfig, StepExperimentConfig};
use serde::Deserialize;

use super::super::load::{Checker, whole};

/// Motion of the target and its carrier.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// The motion.
    pub motion: MotionConfig,
    /// The carrier.
    pub carrier: Carrier,
}

/// Carrier of the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// The second arm, within its limits.
    Arm,
    /// None: the simulated target follows its motion, and the second arm stands still.
    Nothing,
    /// None: the simulated target rests until a person pushes it, and the second arm stands still.
    Person,
}

impl Experiment {
    /// The numbers of moves out and back; `None` for another motion.
    pub fn steps(&self) -> Option<&StepExperimentConfig> {
        match &self.motion {
            MotionConfig::Steps(steps) => Some(steps),
            MotionConfig::Sine(_) => None,
        }
    }

    /// Mutable access to [`Self::steps`].
    pub fn steps_mut(&mut self) -> Option<&mut StepExperimentConfig> {
        match &mut self.motion {
            MotionConfig::Steps(steps) => Some(steps),
            MotionConfig::Sine(_) => None,
        }
    }

    /// Times at which a report shows images, seconds, in order, with a description.
    pub fn moments(&self, marks: &[Mark]) -> Vec<(f64, String)> {
        // Moves have two marks each, out and back. One second after the move out the hand should have settled.
        let (every, after_s) = self.steps().map_or((1, 0.0), |steps| (2, steps.move_s + 1.0));
        let begin = (0.0, "the target is taken".to_owned());
        let later = marks.iter().step_by(every).map(|mark| (mark.at_s + after_s, mark.label.clone()));
        std::iter::once(begin).chain(later).collect()
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExperimentSection {
    #[serde(default)]
    kind: KindName,
    #[serde(default)]
    target: TargetName,
    channels: Vec<String>,
    translation_mm: f64,
    rotation_deg: f64,
    move_s: Option<f64>,
    hold_s: Option<f64>,
    period_s: Option<f64>,
    periods: Option<i64>,
    lead_in_s: f64,
    axes: AxesName,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum KindName {
    #[default]
    Steps,
    Sine,
}

impl KindName {
    fn name(self) -> &'static str {
        match self {
            Self::Steps => "steps",
            Self::Sine => "sine",
        }
    }
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum TargetName {
    #[default]
    Carried,
    Free,
    Pushed,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum AxesName {
    World,
    TargetAtStart,
}

impl ExperimentSection {
    /// The experiment; `None` if a key of this kind of motion is missing.
    pub(super) fn build(&self, check: &mut Checker) -> Option<Experiment> {
        check.number("experiment.translation_mm", self.translation_mm, -1000.0..=1000.0);
        check.number("experiment.rotation_deg", self.rotation_deg, -179.0..=179.0);
        check.number("experiment.lead_in_s", self.lead_in_s, 0.0..=600.0);
        let channels = self.channels(check);
        let carrier = match self.target {
            TargetName::Carried => Carrier::Arm,
            TargetName::Free => Carrier::Nothing,
            TargetName::Pushed => Carrier::Person,
        };
        let motion = match self.kind {
            KindName::Steps => MotionConfig::Steps(self.steps(channels, carrier, check)?),
            KindName::Sine => MotionConfig::Sine(self.sine(&channels, check)?),
        };
        Some(Experiment { motion, carrier })
    }

    fn steps(&self, channels: Vec<Channel>, carrier: Carrier, check: &mut Checker) -> Option<StepExperimentConfig> {
        self.refuse_unused([("period_s", self.period_s.is_some()), ("periods", self.periods.is_some())], check);
        let count = i64::try_from(self.channels.len()).unwrap_or(i64::MAX);
        check.count("experiment.channels (their number)", count, 1..=100);
        let (move_s, hold_s) = (self.needed("move_s", self.move_s, check), self.needed("hold_s", self.hold_s, check));
        let (move_s, hold_s) = (move_s?, hold_s?);
        // No arm can move its payload instantly.
        let is_sudden = carrier == Carrier::Nothing && move_s == 0.0;
        if !is_sudden {
            check.number("experiment.move_s", move_s, 0.05..=600.0);
        }
        check.number("experiment.hold_s", hold_s, if is_sudden { 0.05 } else { 0.0 }..=600.0);
        Some(StepExperimentConfig {
            channels,
            translation_m: self.translation_mm * 1e-3,
            rotation_rad: self.rotation_deg.to_radians(),
            move_s,
            hold_s,
            lead_in_s: self.lead_in_s,
            axes: self.axes(),
        })
    }

    fn sine(&self, channels: &[Channel], check: &mut Checker) -> Option<SineConfig> {
        self.refuse_unused([("move_s", self.move_s.is_some()), ("hold_s", self.hold_s.is_some())], check);
        let (period_s, periods) =
            (self.needed("period_s", self.period_s, check), self.needed("periods", self.periods, check));
        check.number("experiment.period_s", period_s?, 0.1..=600.0);
        check.count("experiment.periods", periods?, 1..=1000);
        let [channel] = *channels else {
            let count = self.channels.len();
            check.refuse(format!("experiment.channels: {count} are named; kind = \"sine\" moves exactly one"));
            return None;
        };
        let amplitude = if channel.is_rotation() { self.rotation_deg.to_radians() } else { self.translation_mm * 1e-3 };
        Some(SineConfig {
            channel,
            amplitude,
            period_s: period_s?,
            periods: whole(periods?),
            lead_in_s: self.lead_in_s,
            axes: self.axes(),
        })
    }

    fn channels(&self, check: &mut Checker) -> Vec<Channel> {
        let mut channels = Vec::new();
        for name in &self.channels {
            match Channel::from_name(name) {
                Some(channel) => channels.push(channel),
                None => check.refuse(format!("experiment.channels: {name:?} is none of x, y, z, rx, ry, rz")),
            }
        }
        channels
    }

    fn axes(&self) -> ExperimentAxes {
        match self.axes {
            AxesName::World => ExperimentAxes::World,
            AxesName::TargetAtStart => ExperimentAxes::TargetAtStart,
        }
    }

    /// A key that this kind of motion requires.
    fn needed<T>(&self, key: &str, value: Option<T>, check: &mut Checker) -> Option<T> {
        if value.is_none() {
            let kind = self.kind.name();
            check.refuse(format!("experiment.{key}: missing; kind = \"{kind}\" needs it"));
        }
        value
    }

    /// Keys of another kind of motion, and whether they are present.
    fn refuse_unused(&self, keys: [(&str, bool); 2], check: &mut Checker) {
        for (key, _) in keys.into_iter().filter(|(_, is_there)| *is_there) {
            let kind = self.kind.name();
            check.refuse(format!("experiment.{key}: kind = \"{kind}\" does not use it; remove it"));
        }
    }
}
