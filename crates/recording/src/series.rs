//! A recorded run as series of numbers: its estimates and its control steps, without images.

use std::path::Path;

use anyhow::{Context, Result, bail};
use nalgebra::Matrix6;
use pb3dp_bag::pairs::decoded;
use pb3dp_bag::reader::{Bag, RawMessage};
use pb3dp_bag::run_messages::{ControlStep, PairResult, RunBegin};
use pb3dp_bag::topics::ours;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, CamLeft, Hand, Model, Target, World};

use crate::exact::{covariance, pose_if_any, signed};

/// A recorded run. Times are nanoseconds since its first control step; estimates may be older than it.
#[derive(Clone, Debug, Default)]
pub struct RunSeries {
    /// Estimates in the order of the file.
    pub estimates: Vec<EstimateEntry>,
    /// Control steps in the order of the file.
    pub steps: Vec<StepEntry>,
}

/// The estimate of a pair.
#[derive(Clone, Debug)]
pub struct EstimateEntry {
    /// Number of the pair.
    pub sequence: u64,
    /// Middle of the left exposure.
    pub at_nanos: i64,
    /// Status word.
    pub status: String,
    /// Its reason.
    pub reason: String,
    /// The pose, if there is one.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// Its covariance since the first pose, metres and radians.
    pub covariance: Option<Matrix6<f64>>,
    /// Its covariance, that of the first pose included; `None` in recordings of versions that did not state it.
    pub pose_covariance: Option<Matrix6<f64>>,
    /// The true pose, in simulation.
    pub cam_left_from_target: Option<Pose<CamLeft, Target>>,
}

/// A control step.
#[derive(Clone, Debug)]
pub struct StepEntry {
    /// Number of the step.
    pub number: u64,
    /// Its begin.
    pub at_nanos: i64,
    /// State of the supervisor; empty in a step that a failure has ended.
    pub state: String,
    /// Mode of the controller, likewise.
    pub mode: String,
    /// Pose of the target by the filter of the controller.
    pub base_from_model: Option<Pose<Base, Model>>,
    /// True pose of the hand; without a simulation that from the measured joints.
    pub world_from_hand: Option<Pose<World, Hand>>,
    /// The same of the target.
    pub world_from_target: Option<Pose<World, Target>>,
    /// The last measured joint angles of the arm with the cameras and of the arm with the target in this step, radians; empty without a
    /// measurement.
    pub joints_rad: [Vec<f64>; 2],
}

impl RunSeries {
    /// Reads a recording; also one that was broken off.
    ///
    /// # Errors
    /// A file that is no recording of a run, or is damaged.
    pub fn read(file: &Path) -> Result<Self> {
        let bag = Bag::open(file)?;
        let (mut series, mut begin_nanos) = (Self::default(), None);
        for message in bag.messages_on(&[ours::BEGIN, ours::PAIRS, ours::STEPS])? {
            let taken =
                message.map_err(anyhow::Error::from).and_then(|message| series.take(&message, &mut begin_nanos));
            taken.with_context(|| format!("{}: a message cannot be used", file.display()))?;
        }
        let (Some(begin_nanos), false) = (begin_nanos, series.steps.is_empty()) else {
            bail!("{}: is no recording of a run: record one with pb3dp run --record FILE.mcap", file.display());
        };
        series.estimates.iter_mut().for_each(|estimate| estimate.at_nanos -= begin_nanos);
        series.steps.iter_mut().for_each(|step| step.at_nanos -= begin_nanos);
        Ok(series)
    }

    fn take(&mut self, message: &RawMessage, begin_nanos: &mut Option<i64>) -> Result<()> {
        match message.channel.topic.as_str() {
            ours::BEGIN => *begin_nanos = Some(signed(decoded::<RunBegin>(message)?.begin_nanos)),
            ours::PAIRS => self.estimates.push(estimate(decoded(message)?)?),
            ours::STEPS => self.steps.push(step(decoded(message)?)?),
            _ => {}
        }
        Ok(())
    }
}

fn estimate(result: PairResult) -> Result<EstimateEntry> {
    Ok(EstimateEntry {
        sequence: result.sequence,
        at_nanos: signed(result.exposed_at_nanos),
        cam_left_from_model: pose_if_any("cam_left_from_model", &result.cam_left_from_model)?,
        covariance: covariance("covariance", &result.covariance)?,
        pose_covariance: covariance("pose_covariance", &result.pose_covariance.0)?,
        cam_left_from_target: pose_if_any("cam_left_from_target", &result.cam_left_from_target)?,
        status: result.status,
        reason: result.reason,
    })
}

fn step(mut step: ControlStep) -> Result<StepEntry> {
    let mut joints_rad = [Vec::new(), Vec::new()];
    for call in &mut step.calls {
        if let (Some(last), false) = (joints_rad.get_mut(usize::from(call.arm)), call.position_rad.is_empty()) {
            *last = std::mem::take(&mut call.position_rad);
        }
    }
    Ok(StepEntry {
        number: step.number,
        at_nanos: signed(step.at_nanos),
        base_from_model: pose_if_any("base_from_model", &step.base_from_model)?,
        world_from_hand: pose_if_any("world_from_hand", &step.world_from_hand)?,
        world_from_target: pose_if_any("world_from_target", &step.world_from_target)?,
        state: step.state,
        mode: step.mode,
        joints_rad,
    })
}
