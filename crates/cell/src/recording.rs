//! Records the pairs of a run as a sequence folder for `pb3dp track`, with the true poses if there are any.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use nalgebra::Vector2;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_hal_api::FramePair;
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter, WrittenFrame};
use pb3dp_record::images::StoredFormat;
use pb3dp_setup::setup::Setup;

use crate::annotation::polygon_px;

/// A recording; its folder is created with the first pair, when the target's region is known.
pub struct Recording {
    folder: PathBuf,
    rig: StereoRig,
    search: SearchRange,
    writer: Option<SequenceWriter>,
}

impl Recording {
    /// A recording into `folder`, which must not contain one already.
    pub fn new(folder: &Path, setup: &Setup) -> Self {
        let range = &setup.range;
        let search = SearchRange { z_min_m: range.z_min_m, z_max_m: range.z_max_m, tilt_max_rad: range.tilt_max_rad };
        Self { folder: folder.to_path_buf(), rig: setup.rig.stereo, search, writer: None }
    }

    /// Whether the first pair was written.
    pub fn is_open(&self) -> bool {
        self.writer.is_some()
    }

    /// Records a pair with its true pose, if there is one. `outline_px` is the target's region in the left image, needed for the first
    /// pair.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn push(
        &mut self,
        pair: &FramePair,
        cam_left_from_target: Option<&Pose<CamLeft, Target>>,
        outline_px: Option<Vec<Vector2<f64>>>,
    ) -> Result<()> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            None => {
                let region_polygon_left_px = polygon_px(&outline_px.unwrap_or_default());
                let draft = SequenceDraft { region_polygon_left_px, search: self.search, images: StoredFormat::Png };
                self.writer.insert(SequenceWriter::create(&self.folder, &self.rig, draft).context("--record")?)
            }
        };
        let frame = WrittenFrame {
            left: &pair.left,
            right: &pair.right,
            exposed_at: pair.exposed_at,
            skew_nanos: pair.skew_nanos,
            // Both frames are fixed to the target; the true pose of a sequence may refer to any such frame.
            cam_left_from_model: cam_left_from_target.map(Pose::relabel),
        };
        writer.push(frame).context("--record")?;
        Ok(())
    }

    /// Finishes the recording.
    ///
    /// # Errors
    /// If its description cannot be written.
    pub fn finish(self) -> Result<()> {
        let Some(writer) = self.writer else { return Ok(()) };
        let summary = writer.finish().context("--record")?;
        tracing::info!("{} frames recorded: {}", summary.frames, summary.file.display());
        Ok(())
    }
}
