//! Renderer properties other than geometry: reproducibility, ground truth, motion blur, colours, refusals.
#![allow(clippy::unwrap_used, clippy::panic)] // clippy allows them in #[test] functions only, not in their helpers.

use image::RgbImage;
use nalgebra::{Vector2, Vector3};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_sim::raster::{RenderError, StereoRenderer};
use pb3dp_sim::scene::{Highlight, Lighting, Scene, SceneConfig};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::TargetConfig;
use pb3dp_sim::targets::part::SceneObject;

use crate::support::{distorted_rig, poses, rectified_rig, square_scene, turned};

fn crab_renderer(sensor: &SensorConfig, seed: u32) -> StereoRenderer {
    let scene = Scene::build(&SceneConfig::new(TargetConfig::crab(0.015))).unwrap();
    StereoRenderer::new(scene, rectified_rig(), sensor, seed).unwrap()
}

fn pair(renderer: &mut StereoRenderer, frame_index: u64, x_m: f64) -> [RgbImage; 2] {
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    let poses = poses(turned([x_m, 0.01, 0.5], [0.05, -0.08, 0.02]));
    renderer.render_pair(&poses, frame_index, &mut left, &mut right);
    [left, right]
}

/// FNV-1a of the bytes of some images.
fn fingerprint(images: &[RgbImage]) -> u64 {
    let bytes = images.iter().flat_map(|image| image.as_raw());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[test]
fn images_of_a_seed_are_the_same_bytes_everywhere() {
    let mut renderer = crab_renderer(&SensorConfig::default(), 5);
    // Recorded from the first rendering; update the value after an intentional change of an image.
    assert_eq!(format!("{:016x}", fingerprint(&pair(&mut renderer, 3, 0.05))), "373aa3745d4e9f3e");
}

#[test]
fn images_depend_on_seed_and_frame_but_not_on_the_order() {
    let mut renderer = crab_renderer(&SensorConfig::default(), 5);
    let third = pair(&mut renderer, 3, 0.05);
    let fourth = pair(&mut renderer, 4, 0.06);
    assert_eq!(third, pair(&mut renderer, 3, 0.05));
    assert_eq!(fourth, pair(&mut renderer.clone(), 4, 0.06));
    assert_ne!(third, pair(&mut renderer, 4, 0.05));
    assert_ne!(third, pair(&mut crab_renderer(&SensorConfig::default(), 6), 3, 0.05));
}

#[test]
fn ground_truth_is_the_depth_on_every_ray() {
    let cam_left_from_target = turned([0.03, -0.02, 0.55], [0.06, -0.09, 0.13]);
    let scene = square_scene(0.2, 3, |_, _| [100.0; 3]);
    let rig = distorted_rig();
    let mut renderer = StereoRenderer::new(scene, rig, &SensorConfig::IDEAL, 1).unwrap();
    let truth = renderer.ground_truth(&poses(cam_left_from_target));
    let normal = cam_left_from_target.transform_vector(&Vector3::z());
    let distance = normal.dot(&cam_left_from_target.translation_m());
    let mut on_target = 0;
    for row in (0..480).step_by(7) {
        for column in (0..640).step_by(7) {
            let ray = rig.left().unproject(&Vector2::new(f64::from(column), f64::from(row))).unwrap();
            let z = distance / normal.dot(&ray);
            let place = cam_left_from_target.inverse().transform_point(&(ray * z).into());
            let at = (row * 640 + column) as usize;
            if place.x.abs().max(place.y.abs()) < 0.0999 {
                assert!((f64::from(truth.depth_m[at]) / z - 1.0).abs() < 1e-6, "{column}, {row}");
                assert_eq!(truth.object[at], SceneObject::Target);
                on_target += 1;
            } else if place.x.abs().max(place.y.abs()) > 0.1001 {
                assert_eq!((truth.depth_m[at], truth.object[at]), (0.0, SceneObject::Nothing));
            }
        }
    }
    assert!(on_target > 1000, "{on_target}");
}

#[test]
fn the_crab_has_its_hue_and_nothing_is_black() {
    let mut renderer = crab_renderer(&SensorConfig::IDEAL, 1);
    let here = poses(turned([0.05, 0.0, 0.5], [0.0; 3]));
    let truth = renderer.ground_truth(&here);
    let (mut image, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    renderer.render_pair(&here, 0, &mut image, &mut right);
    assert!(image.pixels().filter(|p| p.0.iter().all(|&channel| channel < 12)).count() < 50);
    let (mut crab, mut in_range, mut backdrop) = (0u32, 0u32, 0u32);
    for (pixel, object) in image.pixels().zip(&truth.object) {
        let [r, g, b] = pixel.0.map(f64::from);
        match object {
            SceneObject::Target if r - b > 25.0 => {
                // In this sextant (red largest, blue smallest) hue = 60 (g - b) / (r - b) degrees.
                let hue = 60.0 * (g - b) / (r - b);
                crab += 1;
                in_range += u32::from((4.0..=24.0).contains(&hue));
            }
            SceneObject::Backdrop => backdrop += 1,
            _ => {}
        }
    }
    assert!(crab > 5000 && backdrop > 100_000, "{crab} px of crab, {backdrop} px of backdrop");
    assert!(f64::from(in_range) > 0.95 * f64::from(crab), "{in_range} of {crab}");
}

/// Area of a polygon in pixels, and the range of its columns and rows.
fn area_and_range(polygon: &[Vector2<f64>]) -> (f64, [f64; 4]) {
    let area: f64 = polygon.iter().zip(polygon.iter().cycle().skip(1)).map(|(p, q)| p.perp(q) / 2.0).sum();
    let fold = |start: f64, pick: fn(f64, f64) -> f64, axis: usize| polygon.iter().map(|p| p[axis]).fold(start, pick);
    let range = [(f64::MAX, f64::min as fn(f64, f64) -> f64), (f64::MIN, f64::max)]
        .map(|(start, pick)| [fold(start, pick, 0), fold(start, pick, 1)]);
    (area.abs(), [range[0][0], range[0][1], range[1][0], range[1][1]])
}

#[test]
fn outlines_frame_the_targets_in_the_image() {
    let targets = [
        TargetConfig::crab(0.0),
        TargetConfig::crab(0.02),
        TargetConfig::card(),
        TargetConfig::grey_box(),
        TargetConfig::potato(),
    ];
    let here = poses(turned([0.01, -0.005, 0.5], [0.0, 0.0, 0.1]));
    for target in targets {
        let scene = Scene::build(&SceneConfig::new(target)).unwrap();
        let mut renderer = StereoRenderer::new(scene, distorted_rig(), &SensorConfig::IDEAL, 1).unwrap();
        let truth = renderer.ground_truth(&here);
        let checked: Vec<_> = (0..640 * 480)
            .filter(|&i| truth.object[i] == SceneObject::Target)
            .map(|i| Vector2::new((i % 640) as f64, (i / 640) as f64))
            .collect();
        let (area, range) = area_and_range(&renderer.target_outline_px(&here).unwrap());
        let visible_range = area_and_range(&checked).1;
        for (outline, pixels) in range.iter().zip(visible_range) {
            assert!((outline - pixels).abs() < 1.5, "{}: outline {range:?}, pixels {visible_range:?}", target.name());
        }
        let share = checked.len() as f64 / area;
        assert!((0.97..1.03).contains(&share), "{}: {} px in an outline of {area} px", target.name(), checked.len());
    }
}

/// Sum of the differences between neighbouring columns.
fn sharpness(image: &RgbImage) -> f64 {
    let row = |r: u32| (1..640).map(move |c| (c, r));
    (0..480)
        .flat_map(row)
        .map(|(c, r)| (f64::from(image.get_pixel(c, r)[0]) - f64::from(image.get_pixel(c - 1, r)[0])).abs())
        .sum()
}

#[test]
fn motion_blur_is_the_mean_over_the_exposure() {
    let mut renderer = crab_renderer(&SensorConfig::IDEAL, 1);
    let at = |x: f64| poses(turned([x, 0.0, 0.5], [0.0; 3]));
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    let mut expose = |moments: &[f64]| {
        let moments: Vec<_> = moments.iter().map(|&x| at(x)).collect();
        renderer.render_exposure(&moments, 0, &mut left, &mut right).map(|()| left.clone())
    };
    let (first, second) = (expose(&[0.050]).unwrap(), expose(&[0.054]).unwrap());
    assert_eq!(first, expose(&[0.050, 0.050]).unwrap());
    let both = expose(&[0.050, 0.054]).unwrap();
    for ((mean, a), b) in both.iter().zip(first.iter()).zip(second.iter()) {
        assert!((f64::from(*mean) - (f64::from(*a) + f64::from(*b)) / 2.0).abs() <= 1.01);
    }
    let swept = expose(&[0.050, 0.051, 0.052, 0.053, 0.054]).unwrap();
    assert!(sharpness(&swept) < 0.8 * sharpness(&first));
    assert_eq!(expose(&[]), Err(RenderError::NoPoses));
}

#[test]
fn unusable_rigs_and_sensors_are_refused_by_name() {
    let scene = || square_scene(0.1, 2, |_, _| [9.0; 3]);
    let sensor = SensorConfig { read_noise_grey: -1.0, ..SensorConfig::IDEAL };
    let error = StereoRenderer::new(scene(), rectified_rig(), &sensor, 1).unwrap_err();
    assert!(error.to_string().contains("read_noise_grey is -1"), "{error}");
    let pinhole = Pinhole { fx: 300.0, fy: 300.0, cx: 150.0, cy: 100.0 };
    let small = Camera::new(ImageSize { width: 320, height: 240 }, pinhole, Distortion::None).unwrap();
    let rig =
        StereoRig::new(*rectified_rig().left(), small, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap();
    let error = StereoRenderer::new(scene(), rig, &SensorConfig::IDEAL, 1).unwrap_err();
    assert!(error.to_string().contains("640x480") && error.to_string().contains("320x240"), "{error}");
}

#[test]
fn only_the_camera_that_is_out_of_focus_is_blurred() {
    let sharp = pair(&mut crab_renderer(&SensorConfig::IDEAL, 5), 0, 0.05);
    let renderer = crab_renderer(&SensorConfig::IDEAL, 5);
    let blurred = pair(&mut renderer.clone().with_defocus_px(0.0, 1.5).unwrap(), 0, 0.05);
    assert_eq!(sharp[0], blurred[0]);
    let contrast = |image: &RgbImage| {
        let greens: Vec<f64> = image.pixels().map(|pixel| f64::from(pixel[1])).collect();
        greens.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>()
    };
    assert!(contrast(&blurred[1]) < 0.5 * contrast(&sharp[1]));
    let error = renderer.with_defocus_px(0.0, 5.0).unwrap_err().to_string();
    assert_eq!(error, "sensor parameter defocus_px is 5; set it between 0 and 4");
}

#[test]
fn the_ideal_image_is_the_image_of_an_ideal_sensor() {
    let mut renderer = crab_renderer(&SensorConfig { lens_blur_px: 0.6, ..SensorConfig::IDEAL }, 5);
    let [left, _] = pair(&mut renderer, 0, 0.05);
    let mut ideal = Vec::new();
    renderer.ideal_left(&poses(turned([0.05, 0.01, 0.5], [0.05, -0.08, 0.02])), &mut ideal);
    assert!(left.as_raw().iter().zip(&ideal).all(|(&grey, &ideal)| (f32::from(grey) - ideal).abs() <= 0.501));
}

#[test]
fn a_reflection_lies_where_the_mirror_would_show_the_lamp() {
    // In `cam_left` the target faces the camera; in `world` that is a normal along -x.
    let in_cam = Vector3::new(0.03, 0.02, -1.0);
    let lamp = |highlight| Lighting {
        highlight,
        towards_lamp_in_world: Vector3::new(in_cam.z, -in_cam.x, -in_cam.y),
        ..Lighting::EVEN
    };
    let ideal = |lighting| {
        let config = SceneConfig { lighting, ..SceneConfig::new(TargetConfig::crab(0.0)) };
        let scene = Scene::build(&config).unwrap();
        let mut renderer = StereoRenderer::new(scene, rectified_rig(), &SensorConfig::IDEAL, 5).unwrap();
        let mut ideal = Vec::new();
        renderer.ideal_left(&poses(turned([0.0, 0.0, 0.5], [0.0; 3])), &mut ideal);
        ideal
    };
    let (matt, glossy) = (ideal(lamp(None)), ideal(lamp(Some(Highlight { strength_grey: 60.0, exponent: 200 }))));
    let (mut sum, mut weights) = (Vector2::zeros(), 0.0);
    for (pixel, (matt, glossy)) in matt.chunks_exact(3).zip(glossy.chunks_exact(3)).enumerate() {
        let added = f64::from(glossy[0] - matt[0]);
        // The centre of the target, which lies on the shell.
        if added > 45.0 {
            sum += Vector2::new((pixel % 640) as f64, (pixel / 640) as f64) * added;
            weights += added;
        }
    }
    // The camera sees the lamp mirrored where its ray is (0.03, 0.02, 1).
    let expected = Vector2::new(319.5 + 740.0 * 0.03, 239.5 + 740.0 * 0.02);
    let found = sum / weights;
    assert!((found - expected).norm() < 4.0, "{found} instead of {expected}");
}

#[test]
fn fine_sampling_shows_the_same_places_with_fewer_false_patterns() {
    // Soft stripes of 1.6 px: the fine images must show hardly any aliasing, the plain ones show beats.
    let stripes = |x: f64, _: f64| [130.0 + 90.0 * (x / 0.00108 * std::f64::consts::TAU).sin(); 3];
    let scene = square_scene(0.25, 11, stripes);
    let poses = poses(turned([0.0, 0.0, 0.5], [0.01, -0.02, 0.0]));
    let sensor = SensorConfig { lens_blur_px: 0.6, ..SensorConfig::IDEAL };
    let plain = StereoRenderer::new(scene, rectified_rig(), &sensor, 1).unwrap();
    let contrast = |mut renderer: StereoRenderer| {
        let mut ideal = Vec::new();
        renderer.ideal_left(&poses, &mut ideal);
        let inner: Vec<f64> = (200..280)
            .flat_map(|row| (220..420).map(move |column| 3 * (640 * row + column)))
            .map(|at| f64::from(ideal[at]))
            .collect();
        let mean = inner.iter().sum::<f64>() / inner.len() as f64;
        (inner.iter().map(|grey| (grey - mean).powi(2)).sum::<f64>() / inner.len() as f64).sqrt()
    };
    let (coarse, fine) = (contrast(plain.clone()), contrast(plain.with_fine_sampling().unwrap()));
    assert!(fine < 0.3 * coarse && fine < 4.0, "{fine} {coarse}");

    let images = |fine: bool| {
        let renderer = crab_renderer(&sensor, 5);
        let mut renderer = if fine { renderer.with_fine_sampling().unwrap() } else { renderer };
        pair(&mut renderer, 0, 0.05)
    };
    let (coarse, fine) = (images(false), images(true));
    for (a, b) in coarse.iter().zip(&fine) {
        let difference = |a: &RgbImage, b: &RgbImage, shift: u32| {
            let row = 3 * 640 * 240..3 * 640 * 300;
            let (a, b) = (&a.as_raw()[row.clone()], &b.as_raw()[row]);
            let pairs = a.iter().zip(&b[3 * shift as usize..]);
            pairs.map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>()
        };
        // A shift by half a pixel would make it as different as its neighbours are.
        assert!(difference(a, b, 0) < 0.15 * difference(a, b, 1), "{} {}", difference(a, b, 0), difference(a, b, 1));
    }
}
