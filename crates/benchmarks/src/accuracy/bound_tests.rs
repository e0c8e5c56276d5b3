//! Compares the bound with an estimator that reaches it, and with numerical derivatives.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;
use pb3dp_sim::targets::Paint;

use super::super::cell::{Cell, RigKind};
use super::super::measure::{Rendered, Worker};
use super::super::random::Random;
use super::super::scenes::rigs;
use super::*;

/// A small textured scene on a rectified pair: the left grey level at a pixel.
fn texture(u: f64, v: f64) -> f64 {
    120.0 + 40.0 * (0.7 * u + 0.2 * v).sin() + 25.0 * (0.35 * u - 0.6 * v + 1.0).cos()
}

/// Normal random numbers with variance 1.
fn normal(random: &mut Random) -> f64 {
    (0..12).map(|_| random.between(-0.5, 0.5)).sum()
}

/// The disparities of a plane `a u + b v + c`, by least squares over plane, gain and offset: the maximum likelihood
/// estimate for normal noise. The right image is sampled at the target of each left pixel; its own noise is one number
/// per pixel.
fn most_likely(left: &[f64], right: impl Fn(usize, f64) -> f64, pixels: &[(f64, f64)]) -> DVector<f64> {
    let mut found = DVector::from_vec(vec![0.0, 0.0, 0.0, 1.0, 0.0]);
    for _ in 0..8 {
        let residual = |x: &DVector<f64>, i: usize| {
            let (u, v) = pixels[i];
            right(i, u - (x[0] * u + x[1] * v + x[2])) - x[3] * left[i] - x[4]
        };
        let mut slopes = DMatrix::zeros(pixels.len(), 5);
        for column in 0..5 {
            let step = [1e-4, 1e-4, 1e-3, 1e-4, 1e-2][column];
            let (mut below, mut above) = (found.clone(), found.clone());
            below[column] -= step;
            above[column] += step;
            for i in 0..pixels.len() {
                slopes[(i, column)] = (residual(&above, i) - residual(&below, i)) / (2.0 * step);
            }
        }
        let residuals = DVector::from_fn(pixels.len(), |i, _| residual(&found, i));
        let step = slopes.clone().svd(true, true).solve(&residuals, 1e-12).unwrap();
        found -= step;
    }
    found
}

#[test]
fn the_most_likely_plane_spreads_as_the_bound_says() {
    const NOISE: f64 = 2.0;
    const GAIN: f64 = 1.2;
    let pixels: Vec<(f64, f64)> =
        (0..9).flat_map(|v| (0..14).map(move |u| (f64::from(u) - 6.5, f64::from(v) - 4.0))).collect();
    let truth = [0.03, -0.02, 0.4];
    let disparity = |u: f64, v: f64| truth[0] * u + truth[1] * v + truth[2];
    let mut squares = Matrix3::zeros();
    let trials = 600;
    for trial in 0..trials {
        let mut random = Random::of(1, "bound", trial);
        let left: Vec<f64> = pixels.iter().map(|&(u, v)| texture(u, v) + NOISE * normal(&mut random)).collect();
        let noise: Vec<f64> = pixels.iter().map(|_| NOISE * normal(&mut random)).collect();
        let right = |i: usize, column: f64| {
            // The texture at the left pixel that the true plane maps to this column: u - d(u, v) = column.
            let v = pixels[i].1;
            let u = (column + truth[1] * v + truth[2]) / (1.0 - truth[0]);
            GAIN * texture(u, v) + 5.0 + noise[i]
        };
        let found = most_likely(&left, right, &pixels);
        let error = Vector3::new(found[0] - truth[0], found[1] - truth[1], found[2] - truth[2]);
        squares += error * error.transpose() / trials as f64;
    }
    let samples: Vec<Sample> = pixels
        .iter()
        .map(|&(u, v)| {
            let gradient = (texture(u + 1e-5, v) - texture(u - 1e-5, v)) / 2e-5;
            // One more pixel of disparity moves the left pixel of a fixed right pixel by 1 / (1 - a).
            Sample { grey: texture(u, v), slope: Vector3::new(u, v, 1.0) * (gradient / (1.0 - truth[0])) }
        })
        .collect();
    assert!(disparity(1.0, 1.0) > 0.0);
    let bound = channel_information(&samples, GAIN, NOISE * NOISE).try_inverse().unwrap();
    for i in 0..3 {
        let ratio = (squares[(i, i)] / bound[(i, i)]).sqrt();
        assert!((0.92..1.12).contains(&ratio), "parameter {i} has {ratio} times the spread of the bound");
    }
}

/// An image blurred by (1 2 1) / 4 along rows and columns, twice: without blur the fit prefers subpixel positions,
/// where interpolation smooths the noise.
fn blurred(image: &image::RgbImage) -> Vec<f64> {
    let mut values: Vec<f64> = image.as_raw().iter().map(|&grey| f64::from(grey)).collect();
    for step in [3, 3 * image.width() as usize, 3, 3 * image.width() as usize] {
        let source = values.clone();
        for at in step..values.len() - step {
            values[at] = 0.25 * (source[at - step] + 2.0 * source[at] + source[at + step]);
        }
    }
    values
}

/// Cubic interpolation along a row, and its slope.
fn cubic(image: &[f64], u: f64, row: u32, channel: usize) -> (f64, f64) {
    let (first, t) = (u.floor(), u - u.floor());
    let at = |k: i64| image[3 * (row as usize * 640 + (first as i64 + k) as usize) + channel];
    let [a, b, c, d] = [at(-1), at(0), at(1), at(2)];
    let (p, q, r) = (0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c));
    (b + t * (p + t * (q + t * r)), p + t * (2.0 * q + 3.0 * t * r))
}

/// Plane, gains and offsets by least squares over every pixel of the target, started at the truth: the result of an
/// estimator without search and without outlier rejection.
fn best_fit(pair: &Rendered, rig: &StereoRig) -> Vector3<f64> {
    let (pinhole, focal_baseline) = (*rig.left().pinhole(), rig.left().pinhole().fx * rig.baseline_m());
    let (left, right) = (blurred(&pair.left), blurred(&pair.right));
    let mut plane = pair.trial.plane;
    let mut response = [1.0, 0.0, 1.0, 0.0, 1.0, 0.0];
    for _ in 0..6 {
        let (mut matrix, mut side) = (SMatrix::<f64, 9, 9>::zeros(), SVector::<f64, 9>::zeros());
        for index in inner_pixels(&pair.trial.ground_truth) {
            let (column, row) = ((index % 640) as u32, (index / 640) as u32);
            let ray = pinhole.normalized_from_pixel(&Vector2::new(f64::from(column), f64::from(row))).push(1.0);
            let u = f64::from(column) - focal_baseline * plane.dot(&ray);
            for channel in 0..3 {
                let (there, slope) = cubic(&right, u, row, channel);
                let here = left[3 * index + channel];
                let residual = there - response[2 * channel] * here - response[2 * channel + 1];
                let mut gradient = SVector::<f64, 9>::zeros();
                gradient.fixed_rows_mut::<3>(0).copy_from(&(ray * (-focal_baseline * slope)));
                (gradient[3 + 2 * channel], gradient[4 + 2 * channel]) = (-here, -1.0);
                matrix += gradient * gradient.transpose();
                side += gradient * residual;
            }
        }
        let step = matrix.cholesky().unwrap().solve(&side);
        plane -= step.fixed_rows::<3>(0);
        response.iter_mut().enumerate().for_each(|(k, value)| *value -= step[3 + k]);
    }
    plane
}

#[test]
fn a_fit_of_every_pixel_comes_near_the_bound_and_not_below() {
    for paint in [Paint::Crab, Paint::Grey] {
        let setup = Setup { paint, ..Setup::default() };
        let cell = Cell { setup, ..super::super::cells::all().remove(0) };
        let scene = super::super::scenes::SceneStore::default().scene(&setup).unwrap();
        let mut worker = Worker::new(&cell, &scene, 1, &[]).unwrap();
        let rig = *worker.stated_rig();
        let mut maker = BoundMaker::new(&setup, &scene, &rig).unwrap();
        let (mut squares, poses) = ([0.0; 2], 12);
        for index in 0..poses {
            let pair = worker.render(index).unwrap();
            let ray = Vector3::new(0.1, 0.0, 1.0);
            let bound = maker.bound(&pair.trial.poses, &pair.trial.ground_truth, &pair.trial.plane, &ray).unwrap();
            let errors = super::super::trial::plane_errors(&best_fit(&pair, &rig), &pair.trial.plane, &ray).unwrap();
            squares[0] += errors.z_m.powi(2) / bound[(0, 0)] / poses as f64;
            squares[1] += errors.tilt_rad.norm_squared() / (bound[(1, 1)] + bound[(2, 2)]) / poses as f64;
        }
        let [z, angle] = squares.map(f64::sqrt);
        assert!((0.6..1.9).contains(&z) && (0.6..1.9).contains(&angle), "{}: {z}, {angle}", paint.name());
    }
}

#[test]
fn displacements_are_the_slopes_of_the_map() {
    for kind in [RigKind::Parallel { baseline_m: 0.06 }, RigKind::Unequal] {
        let rig = rigs(&Setup { rig: kind, ..Setup::default() }).unwrap().stated;
        let psi = PlaneHypothesis { z_m: 0.52, theta_x_rad: 0.3, theta_y_rad: -0.25 };
        let plane = psi.inverse_depth_plane(&Vector3::new(0.1, 0.0, 1.0)).unwrap();
        let in_right = |pixel: &Vector2<f64>, plane: &Vector3<f64>| {
            let ray = rig.left().unproject(pixel).unwrap();
            let point = rig.cam_right_from_cam_left().transform_point(&(ray / plane.dot(&ray)).into());
            rig.right().project(&point).unwrap()
        };
        let pixel = Vector2::new(371.0, 262.0);
        let found = PlaneMap { rig: &rig, plane }.left_displacement(&pixel).unwrap();
        for column in 0..3 {
            let mut changed = plane;
            changed[column] += 1e-4;
            // The left pixel moves back by the displacement and corresponds to the same right pixel as before.
            let back = pixel - found.column(column) * 1e-4;
            let moved = in_right(&back, &changed) - in_right(&pixel, &plane);
            assert!(moved.norm() < 1e-6, "{kind:?}, column {column}: {moved}");
            assert!((in_right(&pixel, &changed) - in_right(&pixel, &plane)).norm() > 5e-5, "column {column}");
        }
    }
}

#[test]
fn errors_have_the_covariance_of_the_plane() {
    let ray = Vector3::new(0.12, -0.07, 1.0);
    let psi = PlaneHypothesis { z_m: 0.6, theta_x_rad: -0.2, theta_y_rad: 0.35 };
    let plane = psi.inverse_depth_plane(&ray).unwrap();
    let step = Vector3::new(3e-5, -2e-5, 4e-5);
    let errors = super::super::trial::plane_errors(&(plane + step), &plane, &ray).unwrap();
    let errors = Vector3::new(errors.z_m, errors.tilt_rad.x, errors.tilt_rad.y);
    let expected = errors * errors.transpose();
    let found = covariance_of_errors(&plane, &(step * step.transpose()), &ray);
    assert!((found - expected).norm() < 1e-3 * expected.norm(), "{found} {expected}");
}

#[test]
fn the_bound_grows_with_noise_and_falls_with_the_baseline() {
    let mut scenes = super::super::scenes::SceneStore::default();
    let mut sigma_mm = |baseline_m: f64, noise_grey: f64| {
        let setup = Setup { rig: RigKind::Parallel { baseline_m }, noise_grey, ..Setup::default() };
        let rig = rigs(&setup).unwrap().stated;
        let mut maker = BoundMaker::new(&setup, &scenes.scene(&setup).unwrap(), &rig).unwrap();
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.1, 0.4));
        let cam_left_from_target = pb3dp_geometry::Pose::from_parts(Vector3::new(0.05, 0.0, 0.5), turn);
        let poses = ScenePoses {
            world_from_cam_left: pb3dp_geometry::Pose::coincident(),
            world_from_target:
                pb3dp_geometry::Pose::<pb3dp_geometry::frames::World, pb3dp_geometry::frames::CamLeft>::coincident()
                    * cam_left_from_target,
        };
        let ground_truth = maker.moved[0].ground_truth(&poses);
        let plane = super::super::trial::plane_of(&cam_left_from_target);
        let covariance = maker.bound(&poses, &ground_truth, &plane, &Vector3::new(0.1, 0.0, 1.0)).unwrap();
        covariance[(0, 0)].sqrt() * 1e3
    };
    let nominal = sigma_mm(0.1, 3.0);
    // The bound of a prototype for such a target was 0.025 mm (rms over poses from 420 to 650 mm).
    assert!((0.004..0.05).contains(&nominal), "{nominal} mm");
    let noisy = sigma_mm(0.1, 6.0) / nominal;
    assert!((noisy - f64::sqrt((36.0 + 1.0 / 12.0) / (9.0 + 1.0 / 12.0))).abs() < 1e-9, "{noisy}");
    let wide = sigma_mm(0.15, 3.0) / nominal;
    assert!((0.6..0.75).contains(&wide), "{wide}");
}
