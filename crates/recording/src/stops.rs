//! Records the visit of an arm in one file: the pair and the joints of each stop, for a calibration, and the way of both arms.

use std::path::Path;

use anyhow::{Context, Result};
use pb3dp_bag::messages::Transforms;
use pb3dp_bag::run_messages::Stop;
use pb3dp_bag::sinks::Sinks;
use pb3dp_bag::stops::of_stand;
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::FramePair;
use pb3dp_kinematics::{Chain, JointVector};
use pb3dp_record::calibration_files::CameraIdentity;
use pb3dp_record::stops::ArmStand;

use crate::pairs::{About, BASES, JOINTS, PairRecording, joint_names};

/// Frames of the flanges of both arms.
const FLANGES: [&str; 2] = ["vs_flange", "tc_flange"];

/// A visit that is being recorded.
pub struct StopsRecording {
    pairs: PairRecording,
    chains: [Chain; 2],
    joint_names: [Vec<String>; 2],
}

impl StopsRecording {
    /// Creates the file. `chains` are those of the arm with the cameras and of the arm with the target.
    ///
    /// # Errors
    /// A file that exists already or cannot be written.
    pub fn create(
        file: &Path,
        about: &About,
        cameras: Option<&[CameraIdentity; 2]>,
        chains: [&Chain; 2],
    ) -> Result<Self> {
        let writer = BagWriter::create(file, WhenFull::Wait)?;
        let mut pairs = PairRecording::new(about, None, Sinks::new(Some(writer), None, None));
        pairs.cameras(cameras);
        Ok(Self { pairs, chains: chains.map(Clone::clone), joint_names: chains.map(joint_names) })
    }

    /// Records a control step: the joints of both arms.
    pub fn step(&mut self, at: MonotonicTime, joints_rad: [&JointVector; 2]) {
        let mut transforms = Vec::with_capacity(2);
        for (side, joints_rad) in joints_rad.into_iter().enumerate() {
            self.pairs.joint_state(JOINTS[side], at, &self.joint_names[side], [Some(joints_rad), None]);
            let base_from_flange = self.chains[side].forward(joints_rad);
            transforms.push(self.pairs.transform(at, BASES[side], FLANGES[side], &base_from_flange));
        }
        self.pairs.push(ours::TF, at, &Transforms { transforms });
    }

    /// Records a stop.
    pub fn stop(&mut self, pair: &FramePair, [vs, tc]: [&ArmStand; 2]) {
        self.pairs.images(pair);
        let stamp = self.pairs.stamp(pair.exposed_at);
        self.pairs.push(ours::STOPS, pair.exposed_at, &Stop { stamp, vs: of_stand(vs), tc: vec![of_stand(tc)] });
    }

    /// Finishes the file.
    ///
    /// # Errors
    /// If it could not be written, up to here or before.
    pub fn finish(self) -> Result<()> {
        self.pairs.finish().written.transpose().context("--record")?;
        Ok(())
    }
}
