//! The inner loop: each kernel sums what single points give, and reads nothing outside the planes.

use pb3dp_estimation_core::cpu::Kernels;

use super::sums::{ChannelSums, SingleSums};
use super::*;

const WIDTH: usize = 90;

/// Whole numbers without a pattern, centred at zero.
fn value(i: usize, seed: usize) -> f32 {
    let mixed = (i * 7919 + seed * 104_729 + 12_345).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
    (mixed % 161) as f32 - 80.0
}

/// 3 x 128 points in 60 rows: the last ones of no weight, some of them unusable or outside the right planes.
fn points() -> PointSet {
    let count = 3 * SHARING;
    let list = |f: &dyn Fn(usize) -> f32| (0..count).map(f).collect::<Vec<f32>>();
    PointSet {
        x: list(&|i| (i * 37 % 81) as f32 - 40.5),
        y: list(&|i| (i / 8) as f32 - 24.0),
        unit: list(&|i| f32::from(u8::from(i < count - 21))),
        inner: list(&|i| f32::from(u8::from(i % 3 == 0))),
        at: vec![0; count],
        row_start: (0..count).map(|i| (i / 8 * WIDTH) as u32).collect(),
        value: std::array::from_fn(|c| list(&|i| if i % 29 == c { UNUSABLE } else { value(i, c) })),
        gradient_x: std::array::from_fn(|c| list(&|i| 0.2 * value(i, 10 + c))),
        gradient_y: std::array::from_fn(|c| list(&|i| 0.1 * value(i, 20 + c))),
        curvature: std::array::from_fn(|c| list(&|i| 0.05 * value(i, 30 + c))),
    }
}

fn planes() -> [Vec<f32>; CHANNELS_MAX] {
    std::array::from_fn(|c| {
        (0..WIDTH * 48).map(|i| if i % 101 == 7 * c { UNUSABLE } else { value(i, 40 + c) }).collect()
    })
}

fn warp(channels: usize) -> Warp {
    let shade =
        |c: f32| Shade { right: 1.1 - 0.1 * c, left: 0.9 + 0.1 * c, offset: 2.0 - c, variance: 900.0 + 50.0 * c };
    Warp {
        column: 43.3,
        per_x: 1.04,
        per_y: -0.03,
        row: 0.07,
        width: WIDTH,
        channels,
        shades: [shade(0.0), shade(1.0), shade(2.0)],
        place_variance: 0.5,
        limit: 30.0,
    }
}

/// One point in one channel: residual, gradient, right gradient, row gradient, mean, 1 / variance, second derivatives.
struct Single {
    r: f64,
    g: f64,
    s: f64,
    h: f64,
    m: f64,
    certainty: f64,
    bend: f64,
    curvature: f64,
}

/// The point `i` in every channel, and its weight; `None` if it is outside the right planes.
fn single(points: &PointSet, planes: &[Vec<f32>; CHANNELS_MAX], warp: &Warp, i: usize) -> Option<(Vec<Single>, f64)> {
    let wide = f64::from;
    let column = warp.column + warp.per_x * points.x[i] + warp.per_y * points.y[i];
    if points.unit[i] == 0.0 || column < 1.0 || column >= WIDTH as f32 - 3.0 {
        return None;
    }
    let (whole, t) = (column.floor() as usize, wide(column - column.floor()));
    let mut channels = Vec::new();
    for c in 0..warp.channels {
        let shade = warp.shades[c];
        let p: Vec<f64> = (0..4).map(|k| wide(planes[c][points.row_start[i] as usize + whole + k - 1])).collect();
        let usable = p.iter().all(|p| *p < wide(TOUCHED)) && points.value[c][i] < TOUCHED;
        // The basis of the uniform cubic B-spline, and its derivatives.
        let u = 1.0 - t;
        let b = [u.powi(3), 3.0 * t.powi(3) - 6.0 * t * t + 4.0, 3.0 * u.powi(3) - 6.0 * u * u + 4.0, t.powi(3)];
        let b1 = [-u * u, 3.0 * t * t - 4.0 * t, -3.0 * u * u + 4.0 * u, t * t];
        let b2 = [u, 3.0 * t - 2.0, 3.0 * u - 2.0, t];
        let mix = |b: [f64; 4], by: f64| wide(shade.right) * by * b.iter().zip(&p).map(|(b, p)| b * p).sum::<f64>();
        let own = wide(shade.left) * wide(points.value[c][i]);
        let (g, h) = (wide(shade.left * points.gradient_x[c][i]), wide(shade.left * points.gradient_y[c][i]));
        let shown = mix(b, 1.0 / 6.0);
        channels.push(Single {
            r: shown - own + wide(shade.offset) + wide(warp.row) * h,
            g,
            s: mix(b1, 0.5),
            h,
            m: 0.5 * (shown + own),
            certainty: f64::from(u8::from(usable)) / (wide(shade.variance) + wide(warp.place_variance) * g * g),
            bend: mix(b2, 1.0),
            curvature: wide(shade.left * points.curvature[c][i]),
        });
    }
    let distance: f64 = channels.iter().map(|c| c.r * c.r * c.certainty).sum();
    let any = channels.iter().any(|c| c.certainty > 0.0);
    let weight = if any { (1.0 - distance / wide(warp.limit)).max(0.0).powi(2) } else { 0.0 };
    any.then_some((channels, weight))
}

/// Sums of a channel over some points, with a common offset eliminated.
fn plain_sums(found: &[(Vec<Single>, f64, f64, f64)], c: usize) -> ChannelSums {
    let mut out = ChannelSums::default();
    let mean = |f: &dyn Fn(&Single, f64, f64) -> f64| {
        let (sum, all) = found.iter().fold((0.0, 0.0), |(sum, all), (channels, weight, x, y)| {
            let w = weight * channels[c].certainty;
            (sum + w * f(&channels[c], *x, *y), all + w)
        });
        sum / all.max(1e-300)
    };
    let means = [
        mean(&|s, _, _| s.g),
        mean(&|s, x, _| s.g * x),
        mean(&|s, _, y| s.g * y),
        mean(&|s, _, _| s.h),
        mean(&|s, _, _| s.m),
        mean(&|s, _, _| s.r),
    ];
    for (channels, weight, x, y) in found {
        let s = &channels[c];
        let w = weight * s.certainty;
        let own = [s.g, s.g * x, s.g * y, s.h, s.m, s.r];
        let [g, g_x, g_y, h, m, r]: [f64; 6] = std::array::from_fn(|k| own[k] - means[k]);
        let sums = &mut out.products;
        sums.gg += w * (g * g);
        sums.gg_x += w * (g * g_x);
        sums.gg_y += w * (g * g_y);
        sums.gg_xx += w * (g_x * g_x);
        sums.gg_xy += w * (g_x * g_y);
        sums.gg_yy += w * (g_y * g_y);
        sums.gr += w * (g * r);
        sums.gr_x += w * (g_x * r);
        sums.gr_y += w * (g_y * r);
        sums.gm += w * (g * m);
        sums.gm_x += w * (g_x * m);
        sums.gm_y += w * (g_y * m);
        sums.mm += w * (m * m);
        sums.mr += w * (m * r);
        sums.gs += w * (s.g * s.s - means[0] * means[0]);
        sums.gh += w * (h * g);
        sums.gh_x += w * (h * g_x);
        sums.gh_y += w * (h * g_y);
        sums.hh += w * (h * h);
        sums.hm += w * (h * m);
        sums.hr += w * (h * r);
        sums.rr += w * (s.r * s.r);
        sums.usable += weight * f64::from(u8::from(s.certainty > 0.0));
        // Without elimination.
        let [g, g_x, g_y, h, m, r] = own.map(|factor| w * factor);
        out.singles += SingleSums { g, g_x, g_y, h, m, r, w };
    }
    out
}

fn named(sums: &ChannelSums) -> impl Iterator<Item = (&'static str, f64)> {
    sums.products.into_iter().chain(sums.singles)
}

#[test]
fn sums_are_those_of_single_points_with_every_kernel() {
    let (points, planes) = (points(), planes());
    let right: [&[f32]; CHANNELS_MAX] = std::array::from_fn(|c| planes[c].as_slice());
    for (channels, step) in [(1, 1), (3, 1), (3, 2)] {
        let warp = warp(channels);
        let plain = accumulate(Kernels::available().next().unwrap(), &points, &right, &warp, Thinning { step });
        let mut expected = [ChannelSums::default(); CHANNELS_MAX];
        let (mut weight, mut visible, mut sharpness) = (0.0, 0.0, SharpnessSums::default());
        for group in (0..3).step_by(step) {
            let found: Vec<_> = (group * SHARING..(group + 1) * SHARING)
                .filter_map(|i| single(&points, &planes, &warp, i).map(|(s, w)| (i, s, w)))
                .map(|(i, s, w)| (s, w, f64::from(points.x[i]), f64::from(points.y[i])))
                .collect();
            visible += found.len() as f64;
            for (singles, w, _, _) in &found {
                weight += w;
                for s in singles {
                    sharpness.excess += w * s.certainty * (s.s * s.s - s.g * s.g);
                    sharpness.curvature += w * s.certainty * s.bend * s.curvature;
                    sharpness.weight += w * f64::from(u8::from(s.certainty > 0.0));
                }
            }
            for (c, expected) in expected.iter_mut().enumerate().take(channels) {
                let new = plain_sums(&found, c);
                expected.products += new.products;
                expected.singles += new.singles;
            }
        }
        assert!(visible > 150.0 && weight > 0.3 * visible, "{visible} {weight}");
        assert!((plain.weight - weight).abs() < 1e-3 * weight && plain.visible == visible);
        let near = |a: f64, b: f64, scale: f64| (a - b).abs() < 1e-3 * scale;
        assert!(near(plain.sharpness.excess, sharpness.excess, 50.0), "{:?} {sharpness:?}", plain.sharpness);
        assert!(near(plain.sharpness.curvature, sharpness.curvature, 20.0));
        assert!(near(plain.sharpness.weight, sharpness.weight, weight));
        for (c, expected) in expected.iter().enumerate() {
            for ((name, sum), (_, expected)) in named(&plain.channel[c]).zip(named(expected)) {
                let scale = expected.abs().max(1.0);
                assert!(near(sum, expected, scale), "channel {c}, sum {name}: {sum}, not {expected}");
            }
        }
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let sums = accumulate(kernels, &points, &right, &warp, Thinning { step });
            assert_eq!(sums, plain, "{}", kernels.set().name());
        }
    }
}

#[test]
fn scores_add_up_to_the_slope_with_every_kernel() {
    let (points, planes) = (points(), planes());
    let right: [&[f32]; CHANNELS_MAX] = std::array::from_fn(|c| planes[c].as_slice());
    let warp = warp(3);
    let projections =
        [(0.8, 0.01), (1.0, -0.02), (0.3, 0.0)].map(|(weight, m)| Projection { weight, mean: [m, 0.1, -0.2, m] });
    let run = |kernels| {
        let mut scores: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; points.x.len()]);
        let unmodelled = super::scores(kernels, &points, &right, &warp, &projections, &mut scores);
        (scores, unmodelled)
    };
    let (plain, unmodelled) = run(Kernels::available().next().unwrap());
    let sums = accumulate(Kernels::best(), &points, &right, &warp, Thinning::NONE);
    for k in 0..4 {
        let by_residual = |s: &ProductSums<f64>| [-s.gr, -s.gr_x, -s.gr_y, s.hr][k];
        let expected: f64 = (0..3)
            .map(|c| {
                let (s, p) = (&sums.channel[c].products, &projections[c]);
                f64::from(p.weight) * (by_residual(s) - f64::from(p.mean[k]) * s.mr)
            })
            .sum();
        let sum: f64 = plain[k].iter().map(|s| f64::from(*s)).sum();
        let size: f64 = plain[k].iter().map(|s| f64::from(s.abs())).sum();
        assert!((sum - expected).abs() < 1e-4 * size, "{k}: {sum}, not {expected}");
    }
    for kernels in pb3dp_estimation_test_support::every_kernel() {
        assert_eq!(run(kernels), (plain.clone(), unmodelled), "{}", kernels.set().name());
    }
}

/// Changes one image slightly in each way and checks that the scores change as the kernel predicts. The only difference is the
/// mean of both values that the gain takes up, because it changes as well.
#[test]
fn what_is_not_modelled_pulls_as_if_it_were_in_the_images() {
    const PART: f32 = 0.01;
    let (points, planes) = (points(), planes());
    let right: [&[f32]; CHANNELS_MAX] = std::array::from_fn(|c| planes[c].as_slice());
    // A limit so large that all weights are 1, and a variance to which the gradients do not contribute.
    let warp = Warp { limit: 1e9, place_variance: 0.0, ..warp(3) };
    let projections = [(0.8, 0.01), (1.0, -0.02), (0.3, 0.0)].map(|(weight, m)| Projection { weight, mean: [m; 4] });
    let run = |points: &PointSet| {
        let mut scores: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; points.x.len()]);
        let unmodelled = super::scores(Kernels::best(), points, &right, &warp, &projections, &mut scores);
        (scores.map(|scores| scores.iter().map(|s| f64::from(*s)).sum::<f64>()), unmodelled)
    };
    let (before, Unmodelled { row_by_column, row_by_row, blur }) = run(&points);
    type Difference = fn(&PointSet, usize, usize) -> f32;
    let ways: [(&str, [f64; 4], Difference); 3] = [
        ("rows by column", row_by_column, |points, c, i| points.gradient_y[c][i] * points.x[i]),
        ("rows by row", row_by_row, |points, c, i| points.gradient_y[c][i] * points.y[i]),
        ("blur", blur, |points, c, i| 0.5 * points.curvature[c][i]),
    ];
    for (name, stated_scores, difference) in ways {
        let mut changed = points.clone();
        for (c, i) in (0..CHANNELS_MAX).flat_map(|c| (0..points.x.len()).map(move |i| (c, i))) {
            changed.value[c][i] -= PART * difference(&points, c, i);
        }
        let (after, _) = run(&changed);
        let largest = stated_scores.iter().fold(0.0_f64, |largest, score| largest.max(score.abs()));
        for k in 0..4 {
            let moved = (after[k] - before[k]) / f64::from(PART);
            assert!(
                (moved - stated_scores[k]).abs() < 0.05 * largest,
                "{name}, {k}: {moved}, not {}",
                stated_scores[k]
            );
        }
    }
}

#[test]
fn places_outside_the_right_planes_are_not_read() {
    let (mut points, planes) = (points(), planes());
    let right: [&[f32]; CHANNELS_MAX] = std::array::from_fn(|c| planes[c].as_slice());
    for row in points.row_start.iter_mut().skip(SHARING) {
        *row = u32::MAX - 2;
    }
    for (column, per_x) in
        [(43.3, 1.04), (f32::NAN, 1.0), (f32::INFINITY, 1.0), (-1e30, 1.0), (1e30, f32::NEG_INFINITY)]
    {
        let warp = Warp { column, per_x, ..warp(3) };
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let sums = accumulate(kernels, &points, &right, &warp, Thinning::NONE);
            assert!(
                sums.visible <= SHARING as f64 && sums.channel.iter().flat_map(named).all(|(_, sum)| sum.is_finite())
            );
        }
    }
}
