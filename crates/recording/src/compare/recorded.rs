//! A recorded run without its images, in the form in which runs are compared.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use pb3dp_bag::pairs::decoded;
use pb3dp_bag::reader::{Bag, RawMessage};
use pb3dp_bag::run_messages::{ControlStep, PairResult, SetupFile};
use pb3dp_bag::topics::ours;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, CamLeft, Model, Target};
use pb3dp_setup::recorded_settings::RecordedSettings;

use super::matching::Stamp;
use crate::exact::{pose_if_any, signed};
use crate::head::{self, Head};

/// Topics of a comparison besides the head. Images are not read.
const TOPICS: [&str; 2] = [ours::STEPS, ours::PAIRS];

/// A recorded run.
pub struct Recorded {
    /// The recording.
    pub file: PathBuf,
    /// Version of the program that has recorded it.
    pub version: String,
    /// All settings and the files that they name.
    pub settings: RecordedSettings,
    /// Estimates in the order of their exposures.
    pub estimates: Vec<Estimate>,
    /// Control steps in the order of their times.
    pub steps: Vec<Step>,
}

/// The estimate of a pair.
pub struct Estimate {
    /// Number of the pair, and middle of the left exposure.
    pub stamp: Stamp,
    /// The recorded message.
    pub result: PairResult,
    /// The pose, if there is one.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// The true pose, in simulation.
    pub cam_left_from_target: Option<Pose<CamLeft, Target>>,
}

/// A control step.
pub struct Step {
    /// Number and begin of the step.
    pub stamp: Stamp,
    /// Mode of the controller; empty in a step that a failure has ended.
    pub mode: Arc<str>,
    /// State of the supervisor; empty in a step that a failure has ended.
    pub state: Arc<str>,
    /// Reason of the supervisor.
    pub why: Arc<str>,
    /// Pose of the target by the filter.
    pub base_from_model: Option<Pose<Base, Model>>,
    /// Calls of the arms in order.
    pub calls: Vec<Call>,
}

/// A call of an arm.
pub struct Call {
    /// 0: the arm with the cameras; 1: the arm with the target.
    pub arm: u8,
    /// `move`, `hold` and others.
    pub call: Arc<str>,
    /// Commanded velocity of each joint, rad/s; empty if none is commanded.
    pub command_rad_per_s: Vec<f64>,
}

impl Recorded {
    /// Reads a recording; also one that was broken off.
    ///
    /// # Errors
    /// A file that is no recording of a run, is damaged, or has no control step.
    pub fn read(file: &Path) -> Result<Self> {
        let bag = Bag::open(file)?;
        let mut reading = Reading::default();
        for message in bag.messages_on(&[&head::TOPICS[..], &TOPICS].concat())? {
            reading.take(&message?).with_context(|| {
                let (name, version) = (file.display(), &reading.head.version);
                format!(
                    "{name}: recorded by {version}: a message cannot be used; record the run again with this version"
                )
            })?;
        }
        reading.finish(file)
    }

    /// Numbers and times of the estimates.
    pub fn estimate_stamps(&self) -> Vec<Stamp> {
        self.estimates.iter().map(|estimate| estimate.stamp).collect()
    }

    /// Numbers and times of the control steps.
    pub fn step_stamps(&self) -> Vec<Stamp> {
        self.steps.iter().map(|step| step.stamp).collect()
    }
}

/// What has been read so far.
#[derive(Default)]
struct Reading {
    head: Head,
    estimates: Vec<Estimate>,
    steps: Vec<Step>,
    why: Arc<str>,
    names: BTreeSet<Arc<str>>,
}

impl Reading {
    fn take(&mut self, message: &RawMessage) -> Result<()> {
        match message.channel.topic.as_str() {
            _ if self.head.take(message)? => {}
            ours::PAIRS => self.estimate(decoded(message)?)?,
            ours::STEPS => self.step(decoded(message)?)?,
            _ => {}
        }
        Ok(())
    }

    /// The begin is subtracted at the end: without it, the recording is refused.
    fn estimate(&mut self, mut result: PairResult) -> Result<()> {
        // Long, and not compared.
        result.outline_px = Vec::new();
        result.chosen = Vec::new();
        self.estimates.push(Estimate {
            stamp: stamp(result.sequence, result.exposed_at_nanos),
            cam_left_from_model: pose_if_any("cam_left_from_model", &result.cam_left_from_model)?,
            cam_left_from_target: pose_if_any("cam_left_from_target", &result.cam_left_from_target)?,
            result,
        });
        Ok(())
    }

    fn step(&mut self, step: ControlStep) -> Result<()> {
        if !step.why.is_empty() {
            self.why = self.text(&step.why);
        }
        // The measurement before the first step is no call.
        let calls = step.calls.into_iter().filter(|call| call.call != "enabled");
        let calls = calls
            .map(|call| Call { arm: call.arm, call: self.text(&call.call), command_rad_per_s: call.command_rad_per_s })
            .collect();
        let [mode, state] = [self.text(&step.mode), self.text(&step.state)];
        self.steps.push(Step {
            stamp: stamp(step.number, step.at_nanos),
            mode,
            state,
            why: Arc::clone(&self.why),
            base_from_model: pose_if_any("base_from_model", &step.base_from_model)?,
            calls,
        });
        Ok(())
    }

    /// The same words are stored once: a long run has many steps.
    fn text(&mut self, text: &str) -> Arc<str> {
        if let Some(known) = self.names.get(text) {
            return Arc::clone(known);
        }
        let new: Arc<str> = text.into();
        self.names.insert(Arc::clone(&new));
        new
    }

    fn finish(self, file: &Path) -> Result<Recorded> {
        let Self { mut head, mut estimates, mut steps, .. } = self;
        let (setup_text, begin) = head.run(file)?;
        let name = file.display();
        if steps.is_empty() {
            bail!("{name}: the run has no control step; record a run that lasts longer");
        }
        let files = head.files.into_iter().map(|SetupFile { path, data }| (path, data.0)).collect();
        let settings = RecordedSettings::new(&setup_text, files)
            .with_context(|| format!("{name}: the settings on {} are damaged; record the run again", ours::SETUP))?;
        let begin = signed(begin.begin_nanos);
        estimates.iter_mut().for_each(|estimate| estimate.stamp.nanos -= begin);
        steps.iter_mut().for_each(|step| step.stamp.nanos -= begin);
        estimates.sort_by_key(|estimate| estimate.stamp.nanos);
        steps.sort_by_key(|step| step.stamp.nanos);
        Ok(Recorded { file: file.to_path_buf(), version: head.version, settings, estimates, steps })
    }
}

fn stamp(number: u64, at_nanos: u64) -> Stamp {
    Stamp { number, nanos: signed(at_nanos) }
}
