//! Overlay images of every frame, and one animated image of all.

use std::path::PathBuf;

use anyhow::Result;
use pb3dp_cell::annotation::{Annotation, annotate, polygon_px};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::FramePair;
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_record::overlay::{Animation, AnimationLimits};

use super::super::overlay_folder::{make_overlay_folder, report_overlay_folder};
use super::walk::{Outcome, TargetResult};
use crate::arguments::MethodArgs;

/// Overlay images per frame and one animated image, if requested.
pub struct Overlays {
    wanted: Option<(PathBuf, Animation)>,
    written: usize,
}

impl Overlays {
    /// Creates the folder.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn open(args: &MethodArgs) -> Result<Self> {
        let Some(folder) = &args.overlay else { return Ok(Self { wanted: None, written: 0 }) };
        make_overlay_folder(folder)?;
        let animation = Animation::new(AnimationLimits::default());
        Ok(Self { wanted: Some((folder.clone(), animation)), written: 0 })
    }

    /// Draws all targets of a frame.
    ///
    /// # Errors
    /// If the image cannot be written.
    pub fn add(
        &mut self,
        frame: usize,
        t_s: f64,
        pair: &FramePair,
        rig: &StereoRig,
        targets: &[TargetResult],
    ) -> Result<()> {
        let Some((folder, animation)) = &mut self.wanted else { return Ok(()) };
        let annotation = |found: &TargetResult| {
            let target = found.target.map_or(String::new(), |target| format!("target {target}  "));
            let Outcome::Estimate { estimate, .. } = &found.outcome else {
                let label = format!("frame {frame}  {t_s:.3} s  {target}error");
                return Annotation { outline_px: Vec::new(), cam_left_from_model: None, label, status: Status::Error };
            };
            let fitness = estimate.fitness.map_or(String::new(), |fitness| format!("  fitness {fitness:.3}"));
            Annotation {
                outline_px: polygon_px(&estimate.outline_px),
                cam_left_from_model: estimate.cam_left_from_model,
                label: format!("frame {frame}  {t_s:.3} s  {target}{}{fitness}", estimate.status),
                status: estimate.status,
            }
        };
        let annotations: Vec<Annotation> = targets.iter().map(annotation).collect();
        let image = annotate(&pair.left, &pair.right, rig, &annotations);
        save(&image, &folder.join(format!("frame_{frame:04}.png")), StoredFormat::Png)?;
        self.written += 1;
        animation.push(t_s, &image);
        Ok(())
    }

    /// Writes the animated image.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn close(self) -> Result<()> {
        let Some((folder, animation)) = self.wanted else { return Ok(()) };
        if animation.frames() > 0 {
            animation.write(&folder.join("sequence.png"))?;
        }
        // The animation leaves frames out of a long sequence; the folder has all.
        report_overlay_folder(&folder, self.written);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose};

    use super::*;

    #[test]
    fn every_written_image_is_counted_although_the_animation_leaves_some_out() {
        let size = ImageSize { width: 32, height: 24 };
        let pinhole = Pinhole { fx: 30.0, fy: 30.0, cx: 16.0, cy: 12.0 };
        let camera = || Camera::new(size, pinhole, Distortion::None).unwrap();
        let right_from_left = Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0));
        let rig = StereoRig::new(camera(), camera(), right_from_left).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let animation = Animation::new(AnimationLimits { width_max_px: 64, frames_max: 2 });
        let mut overlays = Overlays { wanted: Some((folder.path().to_owned(), animation)), written: 0 };
        for frame in 0..5 {
            overlays.add(frame, 0.1 * frame as f64, &FramePair::black(size), &rig, &[]).unwrap();
        }
        assert!(overlays.wanted.as_ref().unwrap().1.frames() < 5);
        assert_eq!((overlays.written, std::fs::read_dir(folder.path()).unwrap().count()), (5, 5));
    }
}
