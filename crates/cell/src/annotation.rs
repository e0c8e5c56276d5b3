//! Annotated images: region and pose axes in the left image, the reprojected model in the right one.

use image::{Rgb, RgbImage, imageops};
use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_record::overlay::{self, Stroke, TextStyle, colors};

/// Annotation of one target in a stereo pair.
#[derive(Clone, Debug)]
pub struct Annotation {
    /// Outline of the region in the raw left image, pixels.
    pub outline_px: Vec<[f64; 2]>,
    /// The estimated plane, if there is one: pose of a frame in it, z along its normal away from the camera.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// One line of text: status and figures.
    pub label: String,
    /// Status in the label; each status has its own colour.
    pub status: Status,
}

/// The colour of a status. Red and green also differ in brightness.
fn color_of(status: Status) -> Rgb<u8> {
    match status {
        Status::Ok => colors::ESTIMATE,
        Status::WeakTilt | Status::PartlyObserved => colors::WEAK,
        Status::WeakDepth | Status::Ambiguous => colors::AMBIGUOUS,
        Status::NotObservable | Status::Miscalibrated | Status::Lost | Status::Error => colors::BAD,
    }
}

/// Corners for drawing.
pub fn polygon_px(corners_px: &[Vector2<f64>]) -> Vec<[f64; 2]> {
    corners_px.iter().map(|p| [p.x, p.y]).collect()
}

/// Left and right image side by side with all targets drawn in, below a strip with one line of text per target.
pub fn annotate(left: &RgbImage, right: &RgbImage, rig: &StereoRig, targets: &[Annotation]) -> RgbImage {
    let (mut left, mut right) = (left.clone(), right.clone());
    for what in targets {
        overlay::polygon(&mut left, &what.outline_px, Stroke::of(colors::REGION));
        if let Some(pose) = &what.cam_left_from_model {
            let outline_right = reprojected(&what.outline_px, rig, pose);
            if let Some(outline_right) = outline_right {
                overlay::polygon(&mut right, &outline_right, Stroke::of(color_of(what.status)));
            }
            let axis_m = 0.12 * pose.translation_m().z;
            overlay::pose_axes(&mut left, rig.left(), pose, axis_m);
            let cam_right_from_model = *rig.cam_right_from_cam_left() * *pose;
            overlay::pose_axes(&mut right, rig.right(), &cam_right_from_model, axis_m);
        }
    }
    below_labels(&overlay::side_by_side(&left, &right), targets)
}

/// Space around the labels, pixels.
const LABEL_MARGIN_PX: u32 = 6;

/// The image below its labels; the letters are as large as the width allows.
fn below_labels(image: &RgbImage, targets: &[Annotation]) -> RgbImage {
    let width_px = |scale| targets.iter().map(|what| overlay::text_size(&what.label, scale).0).max().unwrap_or(0);
    let scale = if width_px(2) + 2 * LABEL_MARGIN_PX <= image.width() { 2 } else { 1 };
    let line_px = |what: &Annotation| overlay::text_size(&what.label, scale).1 + LABEL_MARGIN_PX;
    let strip_px = LABEL_MARGIN_PX + targets.iter().map(line_px).sum::<u32>();
    let mut both = RgbImage::new(image.width(), strip_px + image.height());
    imageops::replace(&mut both, image, 0, i64::from(strip_px));
    let mut top_px = LABEL_MARGIN_PX;
    for what in targets {
        let style = TextStyle { scale, background: None, ..TextStyle::of(color_of(what.status)) };
        overlay::text(&mut both, [f64::from(LABEL_MARGIN_PX), f64::from(top_px)], &what.label, style);
        top_px += line_px(what);
    }
    both
}

/// The outline transferred to the right image by the plane of `pose`; `None` if a vertex is not visible there.
fn reprojected(outline_px: &[[f64; 2]], rig: &StereoRig, pose: &Pose<CamLeft, Model>) -> Option<Vec<[f64; 2]>> {
    let normal = pose.transform_vector(&Vector3::z());
    let origin = pose.translation_m();
    outline_px
        .iter()
        .map(|&[u, v]| {
            let ray = rig.left().unproject(&Vector2::new(u, v)).ok()?;
            let depth_m = normal.dot(&origin) / normal.dot(&ray);
            let point_in_cam_left = Point3::from(ray * depth_m);
            let point_in_cam_right = rig.cam_right_from_cam_left().transform_point(&point_in_cam_left);
            let pixel = (depth_m > 0.0).then(|| rig.right().project(&point_in_cam_right)).flatten()?;
            Some([pixel.x, pixel.y])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_stand_above_the_image_and_are_whole() {
        let image = RgbImage::from_pixel(402, 50, image::Rgb([9, 99, 200]));
        let label = |text: &str| Annotation {
            outline_px: Vec::new(),
            cam_left_from_model: None,
            label: text.to_owned(),
            status: Status::Ok,
        };
        let lit = |both: &RgbImage, rows: u32| {
            let is_lit = |&(u, v): &(u32, u32)| *both.get_pixel(u, v) != image::Rgb([0, 0, 0]);
            (0..rows).flat_map(|v| (0..both.width()).map(move |u| (u, v))).filter(is_lit).map(|(u, _)| u).max()
        };
        for (text, scale) in [("short HH", 2), ("a label of more letters than fit HH", 1)] {
            let both = below_labels(&image, &[label(text), label("b")]);
            let strip_px = both.height() - image.height();
            assert_eq!(strip_px, 3 * LABEL_MARGIN_PX + 2 * 10 * scale);
            assert_eq!(imageops::crop_imm(&both, 0, strip_px, 402, 50).to_image(), image, "nothing is hidden");
            let last_px = lit(&both, strip_px).unwrap();
            let end_px = LABEL_MARGIN_PX + overlay::text_size(text, scale).0;
            assert!(last_px < end_px && last_px + 3 * scale >= end_px, "{text}: ends at {last_px} of {end_px}");
        }
    }
}
