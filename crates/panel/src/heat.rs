//! Heat overlay: where the right image differs from what the estimated plane predicts from the left one.
//!
//! The residual is that of the plane of the model, also where the tracker has recovered a curved surface: such a surface glows at its
//! edges. Brightness and contrast of the two images are matched first.

use axum::body::Bytes;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, Rgba, RgbaImage};
use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation_core::region::{PixelBox, Region, RegionConfig};
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::FramePair;

use crate::encoded_pair::{ImageHead, PNG_OVERLAY};
use crate::spectator::NewestEstimate;

/// Samples of one overlay: with 0.5 us each, 2 ms.
const SAMPLES_MAX: usize = 4000;
/// Residual that is drawn opaque, grey levels; sensor noise is below a tenth of it.
const FULL_GREY: f64 = 40.0;
/// Colour of a residual, distinct from the colours of the status also for colour-blind people.
const COLOR: [u8; 3] = [213, 94, 0];
const ALPHA_MAX: f64 = 220.0;

/// A sample: its place in the overlay, and both grey values.
struct Sample {
    column: u32,
    row: u32,
    left: f64,
    right: f64,
}

/// The overlay as a message; `None` without a pose or a usable outline.
pub fn message(pair: &FramePair, newest: &NewestEstimate, rig: &StereoRig) -> Option<Bytes> {
    let pose = newest.estimate.cam_left_from_model.filter(|_| newest.sequence == pair.sequence)?;
    let region = Region::Polygon { vertices_px: newest.estimate.outline_px.clone() };
    let mask = region.rasterize(&pair.left, &RegionConfig::default()).ok()?;
    let PixelBox { x: x0, y: y0, width, height } = mask.bbox()?;
    let step = (mask.area_px().div_ceil(SAMPLES_MAX) as f64).sqrt().ceil().max(1.0) as u32;
    let (normal, origin) = (pose.transform_vector(&Vector3::z()), pose.translation_m());
    let sample = |column: u32, row: u32| {
        let (u, v) = (x0 + column * step, y0 + row * step);
        if !mask.contains(i32::try_from(u).ok()?, i32::try_from(v).ok()?) {
            return None;
        }
        let ray = rig.left().unproject(&Vector2::new(f64::from(u), f64::from(v))).ok()?;
        let depth_m = normal.dot(&origin) / normal.dot(&ray);
        let point_in_cam_right = rig.cam_right_from_cam_left().transform_point(&Point3::from(ray * depth_m));
        let in_right = (depth_m > 0.0).then(|| rig.right().project(&point_in_cam_right)).flatten()?;
        let left = grey(pair.left.get_pixel(u, v).0);
        Some(Sample { column, row, left, right: grey_at(&pair.right, in_right)? })
    };
    let (columns, rows) = (width.div_ceil(step), height.div_ceil(step));
    let places = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
    let samples: Vec<Sample> = places.filter_map(|(column, row)| sample(column, row)).collect();
    let overlay = drawn(&samples, columns, rows)?;
    let head = ImageHead { pair, side: 0, kind: PNG_OVERLAY, flags: 0, place: [columns * step, rows * step, x0, y0] };
    let mut bytes = head.to_bytes(overlay.as_raw().len() / 2)?;
    PngEncoder::new(&mut bytes).write_image(overlay.as_raw(), columns, rows, ExtendedColorType::Rgba8).ok()?;
    Some(bytes.into())
}

/// The residuals as colours; transparent without one.
fn drawn(samples: &[Sample], columns: u32, rows: u32) -> Option<RgbaImage> {
    let count = samples.len() as f64;
    let mean = |of: fn(&Sample) -> f64| samples.iter().map(of).sum::<f64>() / count;
    let (left_mean, right_mean) = (mean(|sample| sample.left), mean(|sample| sample.right));
    let spread = |of: fn(&Sample) -> f64, mean: f64| {
        (samples.iter().map(|sample| (of(sample) - mean).powi(2)).sum::<f64>() / count).sqrt()
    };
    let (left_spread, right_spread) =
        (spread(|sample| sample.left, left_mean), spread(|sample| sample.right, right_mean));
    if samples.is_empty() {
        return None;
    }
    // Without contrast there is nothing to match.
    let gain = if right_spread > 1.0 { (left_spread / right_spread).clamp(0.5, 2.0) } else { 1.0 };
    let mut overlay = RgbaImage::new(columns, rows);
    for sample in samples {
        let residual = (sample.right - right_mean) * gain - (sample.left - left_mean);
        let alpha = (residual.abs() / FULL_GREY).min(1.0) * ALPHA_MAX;
        let [red, green, blue] = COLOR;
        overlay.put_pixel(sample.column, sample.row, Rgba([red, green, blue, alpha as u8]));
    }
    Some(overlay)
}

/// Luminance.
fn grey([red, green, blue]: [u8; 3]) -> f64 {
    0.299 * f64::from(red) + 0.587 * f64::from(green) + 0.114 * f64::from(blue)
}

/// Luminance between four pixels; `None` outside.
fn grey_at(image: &image::RgbImage, pixel: Vector2<f64>) -> Option<f64> {
    let (u, v) = (pixel.x.floor(), pixel.y.floor());
    let is_inside = u >= 0.0 && v >= 0.0 && u + 1.0 < f64::from(image.width()) && v + 1.0 < f64::from(image.height());
    if !is_inside {
        return None;
    }
    let (column, row, right, down) = (u as u32, v as u32, pixel.x - u, pixel.y - v);
    let at = |dx: u32, dy: u32| grey(image.get_pixel(column + dx, row + dy).0);
    let (upper, lower) = (at(0, 0) * (1.0 - right) + at(1, 0) * right, at(0, 1) * (1.0 - right) + at(1, 1) * right);
    Some(upper * (1.0 - down) + lower * down)
}
