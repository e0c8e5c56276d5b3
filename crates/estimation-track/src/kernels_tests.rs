//! Derivatives compared with finite differences, with arbitrary cameras, poses and surfaces.

use nalgebra::{Isometry3, Point3, Vector2, Vector3, Vector6};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::wide::LANES;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, se3};

use super::*;

fn camera() -> Camera {
    let pinhole = Pinhole { fx: 741.0, fy: 735.0, cx: 322.0, cy: 236.0 };
    let distortion = Distortion::BrownConrady5 { coefficients: [-0.12, 0.08, 0.0007, -0.0005, 0.01] };
    Camera::new(ImageSize { width: 640, height: 480 }, pinhole, distortion).unwrap()
}

fn pose() -> Isometry3<f64> {
    se3::exp(&Vector6::new(0.03, -0.05, 0.5, 0.3, -0.2, 0.4))
}

/// Points on a curved surface in `model`, as functions of three parameters of a plane in a first camera.
struct Scene {
    first_from_model: Isometry3<f64>,
    rays: Vec<Vector3<f64>>,
}

impl Scene {
    fn new() -> Self {
        let rays = (0..LANES).map(|i| {
            let i = i as f64;
            Vector3::new(0.10 * (1.7 * i).sin() + 0.02, 0.09 * (2.3 * i + 1.0).cos() - 0.03, 1.0)
        });
        Self { first_from_model: se3::exp(&Vector6::new(0.01, 0.02, 0.48, -0.1, 0.15, 0.05)), rays: rays.collect() }
    }

    fn inverse_depth(&self, i: usize, plane: &Vector3<f64>) -> f64 {
        plane.dot(&self.rays[i]) + 0.03 * (i as f64).sin()
    }

    fn point(&self, i: usize, plane: &Vector3<f64>) -> Point3<f64> {
        self.first_from_model.inverse() * Point3::from(self.rays[i] / self.inverse_depth(i, plane))
    }

    fn group(&self, plane: &Vector3<f64>) -> SurfaceGroup {
        let mut group = SurfaceGroup { mask: Lanes::splat(1.0), ..SurfaceGroup::default() };
        for i in 0..LANES {
            let (point, inverse_depth) = (self.point(i, plane), self.inverse_depth(i, plane));
            let slide = self.first_from_model.rotation.inverse() * (self.rays[i] / -inverse_depth.powi(2));
            for axis in 0..3 {
                group.point[axis].0[i] = point[axis] as f32;
                group.slide[axis].0[i] = slide[axis] as f32;
                // Any two directions that span the surface are suitable.
                group.base[axis].0[i] = [6.6e-4, 1e-5, 2e-4][axis];
                group.base[3 + axis].0[i] = [-3e-5, 6.8e-4, -1e-4][axis];
            }
            (group.ray[0].0[i], group.ray[1].0[i]) = (self.rays[i].x as f32, self.rays[i].y as f32);
        }
        group
    }
}

fn lens_at(camera: &Camera, points: impl Iterator<Item = Point3<f64>>) -> LensGroup {
    let mut lens: LensGroup = [Lanes::ZERO; 8];
    for (i, point) in points.enumerate() {
        let xy = Vector2::new(point.x / point.z, point.y / point.z);
        let (distorted, by) = camera.distortion().distort_with_jacobian(&xy);
        let (k, px) = (camera.pinhole(), camera.pinhole().pixel_from_normalized(&distorted));
        let by = [k.fx * by[(0, 0)], k.fx * by[(0, 1)], k.fy * by[(1, 0)], k.fy * by[(1, 1)]];
        for (lane, number) in lens.iter_mut().zip([xy.x, xy.y, px.x, px.y].into_iter().chain(by)) {
            lane.0[i] = number as f32;
        }
    }
    lens
}

fn rows(pose: &Isometry3<f64>) -> CameraRows {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|i| matrix[(i / 4, i % 4)] as f32)
}

#[test]
fn every_unknown_moves_the_pixel_as_its_derivative_says() {
    let (camera, scene, plane) = (camera(), Scene::new(), Vector3::new(0.3, -0.2, 2.1));
    let group = scene.group(&plane);
    let lens = lens_at(&camera, (0..LANES).map(|i| pose() * scene.point(i, &plane)));
    let mut sampled = vec![[SampledGroup::default(); 2]];
    project(Kernels::best(), &[group], &[lens], &rows(&pose()), 0.0, &mut sampled, 1);
    assert_eq!(sampled[0][1].valid.sum(), LANES as f32);
    for i in 0..LANES {
        let pixel_at = |unknown: usize, by: f64| {
            let (mut xi, mut plane, mut row) = (Vector6::zeros(), plane, 0.0);
            match unknown {
                ROW => row = by,
                u if u < ROW => xi[u] = by,
                u => plane[u - SHAPE] += by,
            }
            let point = pose() * se3::exp(&xi) * scene.point(i, &plane);
            camera.project(&point).unwrap() + Vector2::new(0.0, row)
        };
        let centre = pixel_at(0, 0.0);
        assert!((f64::from(sampled[0][1].pixel[0].0[i]) - centre.x).abs() < 2e-3);
        assert!((f64::from(sampled[0][1].pixel[1].0[i]) - centre.y).abs() < 2e-3);
        for axis in 0..2 {
            // The gradient along the surface of an image whose value is this coordinate of the pixel.
            let by = &sampled[0][1].by_point[3 * axis..3 * axis + 3];
            let gradient = [0, 1]
                .map(|k| by[0] * group.base[3 * k] + by[1] * group.base[3 * k + 1] + by[2] * group.base[3 * k + 2]);
            let derivative = derivatives(&group, &sampled[0][1], &gradient, 1);
            for (unknown, derivative) in derivative.iter().enumerate() {
                const STEP: f64 = 1e-6;
                let numeric = (pixel_at(unknown, STEP) - pixel_at(unknown, -STEP))[axis] / (2.0 * STEP);
                let scale = numeric.abs().max(1.0);
                let error = (f64::from(derivative.0[i]) - numeric).abs() / scale;
                assert!(error < 3e-3, "lane {i}, axis {axis}, unknown {unknown}: {} {numeric}", derivative.0[i]);
            }
        }
    }
}

/// Views and images of noise, so that no term is zero.
fn noisy_groups(count: usize) -> (Vec<SurfaceGroup>, Vec<[SampledGroup; 2]>, Vec<ViewGroup>) {
    let value = |seed: usize| {
        Lanes(std::array::from_fn(|i| SplitMix64::new((seed * LANES + i) as u64).between(-100.0, 100.0) as f32))
    };
    let (scene, plane) = (Scene::new(), Vector3::new(0.3, -0.2, 2.1));
    let surface = vec![scene.group(&plane); count];
    let lens = vec![lens_at(&camera(), (0..LANES).map(|i| pose() * scene.point(i, &plane))); count];
    let mut sampled = vec![[SampledGroup::default(); 2]; count];
    for side in 0..2 {
        project(Kernels::best(), &surface, &lens, &rows(&pose()), 0.3, &mut sampled, side);
    }
    let mut view = vec![ViewGroup { valid: Lanes::splat(1.0), ..ViewGroup::default() }; count];
    for (g, (sampled, view)) in sampled.iter_mut().zip(&mut view).enumerate() {
        for c in 0..CHANNELS {
            view.value[c] = value(97 * g + c);
            view.gradient[c] = [value(97 * g + 10 + c).scale(0.1), value(97 * g + 20 + c).scale(0.1)];
            for (side, sampled) in sampled.iter_mut().enumerate() {
                sampled.value[c] = view.value[c] + value(97 * g + 30 + 5 * side + c).scale(0.05);
            }
        }
    }
    (surface, sampled, view)
}

fn photometry() -> Photometry {
    Photometry {
        gain: [[1.02, 0.97, 1.01], [0.95, 1.05, 0.99]],
        offset: [[1.0, -2.0, 0.5], [-1.5, 0.2, 0.8]],
        variance: [[30.0, 25.0, 28.0], [33.0, 29.0, 26.0], [21.0, 22.0, 23.0]],
    }
}

#[test]
fn every_kernel_set_gives_the_same_bits() {
    let (surface, sampled, view) = noisy_groups(3);
    let outcome = |kernels: Kernels| {
        let mut residuals = vec![ResidualGroup::default(); 3];
        let sums = weigh(kernels, &sampled, &view, &photometry(), &mut residuals);
        let weights = PairWeights::of(&photometry().variance);
        let (mut normal, mut patches) = (NormalSums::default(), vec![[0.0; PATCH]; 3]);
        accumulate(kernels, &surface, &sampled, &view, &residuals, &weights, &mut normal, &mut patches);
        let mut scores = vec![GroupScore::default(); 3];
        score(kernels, &surface, &sampled, &view, &residuals, &weights, &mut scores);
        format!("{sums:?} {normal:?} {patches:?} {scores:?}")
    };
    let plain = outcome(Kernels::of(pb3dp_estimation_core::cpu::KernelSet::Scalar).unwrap());
    for kernels in pb3dp_estimation_test_support::every_kernel() {
        assert!(outcome(kernels) == plain, "{}", kernels.set().name());
    }
}

/// The sums of all groups equal the sum over each group.
#[test]
fn scores_of_groups_add_up_to_the_normal_equations() {
    let (surface, sampled, view) = noisy_groups(4);
    let kernels = Kernels::best();
    let mut residuals = vec![ResidualGroup::default(); 4];
    let sums = weigh(kernels, &sampled, &view, &photometry(), &mut residuals);
    assert!(sums.weights[0] > 10.0 && sums.weights[2] > 10.0, "{sums:?}");
    let weights = PairWeights::of(&photometry().variance);
    let (mut normal, mut patches) = (NormalSums::default(), vec![[0.0; PATCH]; 4]);
    accumulate(kernels, &surface, &sampled, &view, &residuals, &weights, &mut normal, &mut patches);
    let mut scores = vec![GroupScore::default(); 4];
    score(kernels, &surface, &sampled, &view, &residuals, &weights, &mut scores);
    let close = |a: f32, b: f32| (a - b).abs() <= 2e-3 * a.abs().max(b.abs()).max(1.0);
    for i in 0..UNKNOWNS {
        let whole = normal.slope[i].sum();
        assert!(close(whole, scores.iter().map(|s| s.slope[i]).sum()), "slope {i}: {whole}");
    }
    let entry = TRIANGLE - 1;
    let whole = normal.hessian[entry].sum();
    assert!(close(whole, scores.iter().map(|s| s.by_depth[UNKNOWNS - 1]).sum()), "depth: {whole}");
    for c in 0..CHANNELS {
        for k in 0..4 {
            let whole = normal.gain_slope[c][k].sum();
            assert!(close(whole, scores.iter().map(|s| s.gain_slope[c][k]).sum()), "gain {c} {k}: {whole}");
        }
    }
}

/// The weights of the three differences equal the inverse covariance of two residuals that share a noise.
#[test]
fn pair_weights_are_the_inverse_of_the_joint_covariance() {
    let (kept, left, right) = (7.0_f32, 11.0_f32, 5.0_f32);
    let variance = [[kept + left; CHANNELS], [kept + right; CHANNELS], [left + right; CHANNELS]];
    let by_term = PairWeights::of(&variance).by_term;
    let joint = nalgebra::Matrix2::new(kept + left, kept, kept, kept + right).try_inverse().unwrap();
    for ((l, r), p) in by_term[0].into_iter().zip(by_term[1]).zip(by_term[2]) {
        assert!((l + p - joint[(0, 0)]).abs() < 1e-6 && (r + p - joint[(1, 1)]).abs() < 1e-6);
        assert!((-p - joint[(0, 1)]).abs() < 1e-6);
    }
}
