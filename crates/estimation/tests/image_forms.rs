//! Images as cameras store them give the same bits as the same images in one piece of 8-bit colour.

use image::RgbImage;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, FramePrior, Method, Tracker};
use pb3dp_estimation::pair_check::check_pair;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::{StereoRig, ValueRange};
use pb3dp_test_support::sweep;

use crate::abuse::camera_memory::{Form, Memory};
use crate::moving_plane::{Shot, general_rig, moving, rectified_rig, region, render};

/// Frames of a sequence, the first of which starts the tracker.
const FRAMES: u32 = 3;

/// Bytes are stored in 12 bits without loss.
fn forms(is_grey: bool) -> [Form; 4] {
    let twelve_bits = ValueRange::new(64, 4000);
    let (right_half, inside) = ([320, 0, 0, 0], [7, 9, 5, 3]);
    [(None, [0; 4]), (None, right_half), (None, inside), (twelve_bits, inside)].map(|(range, margins)| Form {
        is_grey,
        range,
        margins,
    })
}

fn sequence(rig: &StereoRig, brightness: f64) -> Vec<[RgbImage; 2]> {
    let pose = |frame: u32| moving(f64::from(frame) / 30.0);
    let frames = (0..FRAMES).map(|frame| {
        let (mut left, mut right) =
            render(rig, &Shot { cam_left_from_target: Some(pose(frame)), frame, right_gain: 0.9 });
        for image in [&mut left, &mut right] {
            image.iter_mut().for_each(|byte| *byte = (f64::from(*byte) * brightness).min(255.0) as u8);
        }
        [left, right]
    });
    frames.collect()
}

/// All that the estimators answer to a sequence, in full precision.
fn answers(rig: &StereoRig, region: &Region, pairs: &[[ImageView<'_>; 2]]) -> Vec<String> {
    let range = SearchRange::new(0.3, 0.8, 0.8).unwrap();
    let [left, right] = pairs[0];
    let mut answers = vec![format!("{:?}", check_pair(rig, left, right))];
    for method in Method::ALL {
        let mut estimator = Estimator::new(method, rig, &EstimatorConfig::default()).unwrap();
        answers.push(format!("{method} {:?}", estimator.look(left, right)));
        answers.push(format!("{:?}", estimator.estimate(EstimateRequest::new_target(left, right, region, &range))));
        let mut tracker = Tracker::new(method, rig, &EstimatorConfig::default()).unwrap();
        answers.push(format!("{:?}", tracker.estimate(EstimateRequest::new_target(left, right, region, &range))));
        for [left, right] in &pairs[1..] {
            let prior = FramePrior { dt_s: Some(1.0 / 30.0), ..FramePrior::default() };
            answers.push(format!("{:?}", tracker.estimate(EstimateRequest::next_frame(*left, *right, &prior))));
        }
        // An image that is repeated, beside a new one.
        let stuck = EstimateRequest::next_frame(pairs[1][0], pairs[FRAMES as usize - 1][1], &FramePrior::default());
        answers.push(format!("{:?}", tracker.estimate(stuck)));
    }
    answers
}

fn check(rig: &StereoRig, region: &Region, brightness: f64) {
    let pairs = sequence(rig, brightness);
    for is_grey in [false, true] {
        let plain = Form { is_grey, ..Form::PLAIN };
        let plain: Vec<_> = pairs.iter().map(|pair| pair.each_ref().map(|image| plain.plain(image))).collect();
        let views: Vec<_> = plain.iter().map(|pair| pair.each_ref().map(ImageView::from)).collect();
        let expected = answers(rig, region, &views);
        // Two frames that are followed by the direct method, the first in the list.
        let followed = expected.iter().filter(|answer| answer.contains("status: Ok")).count();
        assert!(followed >= 3, "{expected:?}");
        // Colour in one piece is what the others are compared with.
        for form in forms(is_grey).into_iter().skip(usize::from(!is_grey)) {
            let stored: Vec<_> = plain.iter().map(|pair| pair.each_ref().map(|image| form.store(image))).collect();
            let views: Vec<_> = stored.iter().map(|pair| pair.each_ref().map(Memory::view)).collect();
            assert_eq!(answers(rig, region, &views), expected, "{form:?}");
        }
    }
}

#[test]
fn images_of_rectified_rigs_give_the_same_bits_in_every_form() {
    let rig = rectified_rig();
    check(&rig, &region(&rig, &moving(0.0)), 1.0);
}

#[test]
fn images_of_raw_rigs_give_the_same_bits_in_every_form() {
    let rig = general_rig();
    check(&rig, &region(&rig, &moving(0.0)), 1.0);
}

/// Saturated pixels, which the methods treat apart; those of a rectified rig in the long tier.
#[test]
fn bright_images_give_the_same_bits_in_every_form() {
    let rigs = [general_rig(), rectified_rig()];
    for rig in &rigs[..sweep(1, 2)] {
        check(rig, &region(rig, &moving(0.0)), 1.6);
    }
}
