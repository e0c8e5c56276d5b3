//! The filter on synthetic frames: the disparity of each node is known, with noise.

use pb3dp_estimation_core::rng::SplitMix64;

use super::*;

const SIDE: usize = 8;
/// Information of a frame about a node, 1/px^2.
const KNOWN: f64 = 100.0;

fn grid() -> Grid {
    let nodes = SIDE * SIDE;
    let place = |node: usize| ((node % SIDE) as f64, (node / SIDE) as f64);
    let edges = (0..nodes).flat_map(|i| {
        let right = (i % SIDE + 1 < SIDE).then_some((i, i + 1, 1.0));
        let below = (i + SIDE < nodes).then_some((i, i + SIDE, 1.0));
        right.into_iter().chain(below)
    });
    Grid {
        shares: (0..nodes).map(|node| vec![(node, 1.0)]).collect(),
        edges: edges.collect(),
        plane: (0..nodes).map(|node| Vector3::new(place(node).0, place(node).1, 10.0) * 0.1).collect(),
    }
}

/// Normally distributed numbers from a seed.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut random = SplitMix64::new(seed);
    (0..count).map(|_| random.normal()).collect()
}

/// Reads a frame that measures `truth` (pixels, by node), each node independently.
fn show(shape: &mut Shape, truth: &[f64], seed: u64) {
    let n = shape.count();
    shape.frame.information.fill(0.0);
    shape.frame.scaled.fill(0.0);
    for (i, noise) in noise(n, seed).into_iter().enumerate() {
        shape.frame.information[i * n + i] = KNOWN;
        shape.frame.pull[i] = KNOWN * (truth[i] + noise / KNOWN.sqrt() - shape.mean[i]);
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|x| x * x).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

fn bumps() -> Vec<f64> {
    (0..SIDE * SIDE).map(|i| 0.2 * ((i % SIDE) as f64).sin() + 0.2 * ((i / SIDE) as f64 * 0.8).cos()).collect()
}

#[test]
fn a_plane_stays_a_plane_whatever_the_noise() {
    for seed in 1..20 {
        let mut shape = Shape::over(grid(), 1.5);
        let tilt = Vector3::new(0.3, -0.2, 0.1);
        let truth: Vec<f64> = shape.grid.plane.iter().map(|plane| plane.dot(&tilt)).collect();
        show(&mut shape, &truth, seed);
        assert!(shape.learn_all());
        let plane = shape.common_plane();
        let relief = rms((0..shape.count()).map(|node| shape.beyond(node, &plane)));
        assert!(relief < 1e-3, "seed {seed}: relief {relief} px");
        let wrong = rms(shape.mean.iter().zip(&truth).map(|(mean, truth)| mean - truth));
        // Three parameters from 64 noisy values.
        assert!(wrong < 0.1 * 3.0 * (3.0_f64 / 64.0).sqrt(), "seed {seed}: {wrong} px");
    }
}

#[test]
fn a_relief_is_found_and_gets_better_with_every_frame() {
    let mut shape = Shape::over(grid(), 1.5);
    let truth = bumps();
    let mut errors = Vec::new();
    for seed in 1..=16 {
        show(&mut shape, &truth, seed);
        assert!(shape.learn_all());
        errors.push(rms(shape.mean.iter().zip(&truth).map(|(mean, truth)| mean - truth)));
    }
    // Noise of 0.1 px per frame, reduced by the information from neighbours.
    assert!(errors[0] < 0.1 && errors[15] < 0.5 * errors[0], "{errors:?}");
}

#[test]
fn a_frame_that_may_say_nothing_of_the_plane_says_all_of_the_relief() {
    let mut shape = Shape::over(grid(), 1.5);
    let truth = bumps();
    show(&mut shape, &truth, 3);
    assert!(shape.learn_all());
    let plane = shape.common_plane();
    let lifted: Vec<f64> = truth.iter().zip(&shape.grid.plane).map(|(x, p)| x + p.dot(&Vector3::repeat(0.4))).collect();
    for seed in 4..12 {
        show(&mut shape, &lifted, seed);
        assert!(shape.learn(&Shares { relief: 1.0, plane: 0.0, plane_in_all: 2.0 }));
    }
    assert!((shape.common_plane() - plane).norm() < 0.02, "{} {}", shape.common_plane(), plane);
    let before = rms((0..shape.count()).map(|node| shape.mean[node] - truth[node]));
    assert!(before < 0.06, "{before}");
}

#[test]
fn however_many_frames_repeat_it_the_plane_moves_no_further_than_two_of_them_would_move_it() {
    let shares = Shares { relief: 0.5, plane: 0.15, plane_in_all: 2.0 };
    let flat = vec![0.0; SIDE * SIDE];
    let lifted: Vec<f64> = grid().plane.iter().map(|p| p.dot(&Vector3::new(0.3, -0.2, 0.4))).collect();
    let mut shape = Shape::over(grid(), 1.5);
    // The initialisation has the information of ten frames.
    for seed in 1..=10 {
        show(&mut shape, &flat, seed);
        assert!(shape.learn_all());
    }
    let at_start = shape.common_plane();
    let moved_px = |shape: &Shape| {
        let by = shape.common_plane() - at_start;
        rms(shape.grid.plane.iter().map(|plane| plane.dot(&by)))
    };
    let all_px = rms(lifted.iter().copied());
    // More than INFORMATION_MAX allows.
    for seed in 11..1000 {
        show(&mut shape, &lifted, seed);
        assert!(shape.learn(&shares));
    }
    let share = moved_px(&shape) / all_px;
    assert!((share - 2.0 / 12.0).abs() < 0.03, "{share}");
    // A frame with ten times the information has an effect again.
    for seed in 1000..1020 {
        show(&mut shape, &lifted, seed);
        shape.frame.information.iter_mut().chain(&mut shape.frame.pull).for_each(|x| *x *= 10.0);
        assert!(shape.learn(&shares));
    }
    let share = moved_px(&shape) / all_px;
    assert!((share - 20.0 / 30.0).abs() < 0.03, "{share}");
}

#[test]
fn a_frame_that_rounding_has_spoilt_counts_no_more_than_others() {
    let mut shape = Shape::over(grid(), 1.5);
    show(&mut shape, &bumps(), 7);
    shape.frame.information.iter_mut().for_each(|x| *x = -*x);
    shape.weigh_frame(&Shares { relief: 0.5, plane: 0.15, plane_in_all: 2.0 });
    assert!((shape.frame.information[0] + 0.5 * KNOWN).abs() < 1e-9, "{}", shape.frame.information[0]);
}

#[test]
fn what_the_pose_may_explain_is_not_learnt() {
    // One unknown of the pose moves all nodes equally, so a frame has no information about their mean.
    let mut shape = Shape::over(grid(), 1.5);
    let n = shape.count();
    let truth = bumps();
    show(&mut shape, &truth, 5);
    assert!(shape.learn_all());
    let mean = |shape: &Shape| shape.mean.iter().sum::<f64>() / n as f64;
    let before = mean(&shape);
    let lifted: Vec<f64> = truth.iter().map(|x| x + 0.2).collect();
    show(&mut shape, &lifted, 6);
    let total: f64 = shape.frame.pull.iter().sum();
    for i in 0..n {
        shape.frame.scaled[i * ALL] = 1.0 / n as f64;
        shape.frame.pull[i] -= total / n as f64;
        for j in 0..n {
            shape.frame.information[i * n + j] -= KNOWN / n as f64;
        }
    }
    assert!(shape.learn_all());
    assert!((mean(&shape) - before).abs() < 1e-6, "{before} {}", mean(&shape));
    let (step, open) = shape.pose();
    assert!(step[0].abs() < 1e-6);
    // The uncertainty of the mean is that after one frame.
    assert!((open[(0, 0)] * KNOWN * n as f64 - 1.0).abs() < 0.1, "{}", open[(0, 0)]);
}
