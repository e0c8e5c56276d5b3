//! The steady-state frame loop (conversion, model, preparation, search) does not allocate.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, SearchRange};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_published::fitness::{FitnessConfig, HueFitness, Unseen};
use pb3dp_estimation_published::hue::{HueConfig, HuePlane};
use pb3dp_estimation_published::photo_model::{PhotoModel, PhotoModelConfig, PhotoModelScratch};
use pb3dp_estimation_published::search::exhaustive;
use pb3dp_estimation_published::search::rmga::{Population, RmGa, RmGaConfig};
use pb3dp_estimation_test_support::scene::{self, Scene};
use pb3dp_geometry::{ImageSize, StereoRig};

const SIZE: ImageSize = ImageSize { width: 320, height: 240 };

fn check(rig: &StereoRig, unseen: Unseen) {
    let scene =
        Scene { centre_px: Vector2::new(170.0, 120.0), z_m: 0.5, theta_x_rad: 0.1, theta_y_rad: -0.2, noise: 3.0 };
    let (left_rgb, right_rgb) = scene.render(rig);
    let region = RegionMask::from_fn(SIZE, |u, v| scene.sees_disc(rig, u, v));
    let pair = PinholePair::from_rig(rig).expect("pair");
    let range = SearchRange::new(0.4, 0.6, 0.5).expect("range");
    let (hue_config, ga_config) = (HueConfig::default(), RmGaConfig::default());
    for kernels in Kernels::available() {
        let (mut left, mut right) = (HuePlane::default(), HuePlane::default());
        let (mut model, mut scratch) = (PhotoModel::default(), PhotoModelScratch::default());
        let config = FitnessConfig { unseen, ..FitnessConfig::default() };
        let mut fitness = HueFitness::new(config, kernels).expect("config");
        let mut search = RmGa::new(ga_config, range).expect("config");
        let mut population = Population::random(&ga_config);
        let mut frame = || {
            left.update_from_rgb(&left_rgb, &hue_config, kernels);
            right.update_from_rgb(&right_rgb, &hue_config, kernels);
            model.resample(&left, &region, &PhotoModelConfig::default(), &mut scratch);
            let prepared = fitness.prepare(&pair, &model, &right, &range).expect("frame");
            let best = search.evolve(&mut population, &prepared);
            exhaustive::optimum_in(&prepared, search.codec(), 500..502);
            best
        };
        frame();
        let before = pb3dp_allocation_count::requests();
        assert!(frame().is_scored());
        frame();
        assert_eq!(pb3dp_allocation_count::requests() - before, 0, "{}", kernels.set().name());
    }
}

#[test]
fn a_rectified_frame_does_not_allocate() {
    check(&scene::rectified_rig(SIZE), Unseen::Mismatch);
    check(&scene::rectified_rig(SIZE), Unseen::Abstain);
}

#[test]
fn a_general_frame_does_not_allocate() {
    check(&scene::general_rig(SIZE), Unseen::Mismatch);
    check(&scene::general_rig(SIZE), Unseen::Abstain);
}
