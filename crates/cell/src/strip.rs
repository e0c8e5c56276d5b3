//! The strip of annotated stereo images in a run report: the first frame, and one in each hold after a move out.

use image::RgbImage;
use image::imageops::{FilterType, resize};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::FramePair;

use crate::annotation::{Annotation, annotate, polygon_px};

/// Width of a stored image, pixels.
const WIDTH_PX: u32 = 800;

/// Images with their captions.
#[derive(Default)]
pub struct Strip {
    /// Requested times, seconds, in order, each with the event at that time.
    wanted: Vec<(f64, String)>,
    /// Images taken so far, with captions.
    pub images: Vec<(RgbImage, String)>,
}

impl Strip {
    /// A strip of images at these times, seconds, in order, each with the event at that time.
    pub fn of(moments: Vec<(f64, String)>) -> Self {
        Self { wanted: moments, images: Vec::new() }
    }

    /// Takes this frame if a requested time has come.
    pub fn offer(&mut self, t_s: f64, pair: &FramePair, rig: &StereoRig, estimate: &TrackEstimate) {
        if self.wanted.first().is_none_or(|(at_s, _)| t_s < *at_s) {
            return;
        }
        let (_, what) = self.wanted.remove(0);
        let annotation = Annotation {
            outline_px: polygon_px(&estimate.outline_px),
            cam_left_from_model: estimate.cam_left_from_model,
            label: format!("{t_s:.1} s  {}", estimate.status),
            status: estimate.status,
        };
        let image = annotate(&pair.left, &pair.right, rig, &[annotation]);
        let height = WIDTH_PX * image.height() / image.width().max(1);
        let fitness = estimate.fitness.map_or(String::new(), |fitness| format!(", fitness {fitness:.2}"));
        let caption = format!("{t_s:.1} s, {what}: {}{fitness}", estimate.status);
        self.images.push((resize(&image, WIDTH_PX, height.max(1), FilterType::Triangle), caption));
    }
}
