//! The table `[experiment]`: how the target moves.

use pb3dp_sim::trajectory::{Channel, ExperimentAxes, StepExperimentConfig};
use serde::Deserialize;

use super::super::load::Checker;

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExperimentSection {
    channels: Vec<String>,
    translation_mm: f64,
    rotation_deg: f64,
    move_s: f64,
    hold_s: f64,
    lead_in_s: f64,
    axes: AxesName,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum AxesName {
    World,
    TargetAtStart,
}

impl ExperimentSection {
    pub(super) fn build(&self, check: &mut Checker) -> StepExperimentConfig {
        check.number("experiment.translation_mm", self.translation_mm, -1000.0..=1000.0);
        check.number("experiment.rotation_deg", self.rotation_deg, -179.0..=179.0);
        check.number("experiment.move_s", self.move_s, 0.05..=600.0);
        check.number("experiment.hold_s", self.hold_s, 0.0..=600.0);
        check.number("experiment.lead_in_s", self.lead_in_s, 0.0..=600.0);
        let channels = i64::try_from(self.channels.len()).unwrap_or(i64::MAX);
        check.count("experiment.channels (their number)", channels, 1..=100);
        let mut channels = Vec::new();
        for name in &self.channels {
            match Channel::from_name(name) {
                Some(channel) => channels.push(channel),
                None => check.refuse(format!("experiment.channels: {name:?} is none of x, y, z, rx, ry, rz")),
            }
        }
        StepExperimentConfig {
            channels,
            translation_m: self.translation_mm * 1e-3,
            rotation_rad: self.rotation_deg.to_radians(),
            move_s: self.move_s,
            hold_s: self.hold_s,
            lead_in_s: self.lead_in_s,
            axes: match self.axes {
                AxesName::World => ExperimentAxes::World,
                AxesName::TargetAtStart => ExperimentAxes::TargetAtStart,
            },
        }
    }
}
