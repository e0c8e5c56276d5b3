//! Images of any size and form from arbitrary bytes: the same answers as for the image in one piece of 8-bit colour.

use nalgebra::Vector3;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, FramePrior, Method, Tracker};
use pb3dp_estimation::pair_check::check_pair;
use pb3dp_estimation_core::image_view::{ImageView, Pixels};
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig, ValueRange};

use super::camera_memory::{Form, Memory};
use super::{Choices, paint, range, region};

/// Largest number of pixels of an image: a fuzzer tries some inputs in a second.
const PIXELS_MAX: u32 = 1 << 16;

/// Estimates and tracks with a pair in any form, and in one piece of 8-bit colour.
///
/// # Panics
/// If the answers differ, or a method panics.
pub fn images_in_any_form_survive(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let c = &mut choices;
    check_memory(c);
    let size = any_size(c);
    let method = c.of(&Method::ALL);
    let Some(rig) = rig(c, size) else { return };
    let form = form(c);
    let pattern = c.byte();
    let shift = i32::from(c.byte() % 24);
    let pairs = [0, 1].map(|frame| [paint(size, pattern, 0, frame), paint(size, pattern, shift, frame)]);
    let region = region(c, size);
    let range = range(c);
    let plain = pairs.each_ref().map(|pair| pair.each_ref().map(|image| form.plain(image)));
    let stored = pairs.each_ref().map(|pair| pair.each_ref().map(|image| form.store(image)));
    let answers = |pairs: [[ImageView<'_>; 2]; 2]| {
        let [[left, right], next] = pairs;
        let mut answers = vec![format!("{:?}", check_pair(&rig, left, right))];
        let target = || EstimateRequest::new_target(left, right, &region, &range);
        if let Ok(mut estimator) = Estimator::new(method, &rig, &EstimatorConfig::default()) {
            answers.push(format!("{:?}", estimator.look(left, right)));
            answers.push(format!("{:?}", estimator.estimate(target())));
        }
        if let Ok(mut tracker) = Tracker::new(method, &rig, &EstimatorConfig::default()) {
            answers.push(format!("{:?}", tracker.estimate(target())));
            let next = EstimateRequest::next_frame(next[0], next[1], &FramePrior::default());
            answers.push(format!("{:?}", tracker.estimate(next)));
        }
        answers
    };
    let expected = answers(plain.each_ref().map(|pair| pair.each_ref().map(ImageView::from)));
    let found = answers(stored.each_ref().map(|pair| pair.each_ref().map(Memory::view)));
    assert_eq!(found, expected, "{method}, {form:?}, {size:?}");
}

/// Any numbers for a small memory: an image that can be read, or none.
fn check_memory(c: &mut Choices<'_>) {
    let number = |c: &mut Choices<'_>| {
        let small = u32::from(c.byte() % 9);
        c.mostly(small, &[63, 64, 65, 1 << 16, i32::MAX as u32, u32::MAX])
    };
    let (bytes, deep) = ([7_u8; 64], [7_u16; 64]);
    let range = any_range(c);
    let pixels = c.of(&[
        Pixels::Rgb(&bytes),
        Pixels::Grey(&bytes),
        Pixels::DeepRgb(&deep, range),
        Pixels::DeepGrey(&deep, range),
    ]);
    let stride = number(c) as usize;
    let Some(image) = ImageView::new(number(c), number(c), c.mostly(stride, &[usize::MAX]), pixels) else { return };
    let (columns, rows) = (number(c)..number(c), number(c)..number(c));
    let mut buffer = Vec::new();
    for image in [Some(image), image.part(columns, rows)].into_iter().flatten() {
        // An image without columns may have any number of rows.
        for y in 0..image.height().min(64) {
            assert_eq!(image.row(y, &mut buffer).len(), 3 * image.width() as usize);
        }
    }
}

/// From one pixel to 8192 pixels in a row or column.
fn any_size(c: &mut Choices<'_>) -> ImageSize {
    let usual = 24 + u32::from(c.byte() % 100);
    let long = c.mostly(usual, &[1, 2, 3, 4, 5, 7, 8, 15, 16, 17, 127, 128, 129, 640, 4095, 4096, 8191, 8192]);
    let short = 1 + u32::from(c.byte()) % 128;
    let short = short.min((PIXELS_MAX / long).max(1));
    if c.byte() < 128 { ImageSize { width: long, height: short } } else { ImageSize { width: short, height: long } }
}

/// A rig whose focal length is about the longer side; mostly with lenses.
fn rig(c: &mut Choices<'_>, size: ImageSize) -> Option<StereoRig> {
    let focal = f64::from(size.width.max(size.height)) * (0.4 + c.share());
    let camera = |c: &mut Choices<'_>| {
        let centre = |length: u32| 0.5 * f64::from(length);
        let pinhole = Pinhole { fx: focal, fy: focal, cx: centre(size.width), cy: centre(size.height) };
        let distortion = match c.byte() % 4 {
            0 | 1 => Distortion::None,
            2 => Distortion::BrownConrady5 { coefficients: [c.share() - 0.7, 0.05, 0.001, -0.001, 0.0] },
            _ => Distortion::Equidistant { coefficients: [0.1 * c.share(), -0.02, 0.0, 0.0] },
        };
        Camera::new(size, pinhole, distortion).ok()
    };
    let (left, right) = (camera(c)?, camera(c)?);
    let turn = Vector3::new(c.share(), c.share(), c.share()).add_scalar(-0.5) * c.of(&[0.0, 0.02, 0.3]);
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(turn);
    StereoRig::new(left, right, Pose::from_parts(Vector3::new(-0.1, 0.0, 0.0), turn)).ok()
}

fn form(c: &mut Choices<'_>) -> Form {
    let is_grey = c.byte() % 2 == 1;
    let range = (c.byte() % 2 == 1).then(|| any_range(c));
    let margin = |c: &mut Choices<'_>| c.of(&[0, 0, 1, 2, 3, 5, 16, 31]);
    Form { is_grey, range, margins: [margin(c), margin(c), margin(c), margin(c)] }
}

fn any_range(c: &mut Choices<'_>) -> ValueRange {
    let low = c.of(&[0, 1, 64, 1000, u16::MAX - 1]);
    let span = c.of(&[1, 2, 100, 255, 510, 4031, u16::MAX]);
    ValueRange::new(low, low.saturating_add(span)).unwrap_or(ValueRange::FULL)
}
