//! Resampled windows: parts of the whole image, means of the raw one, and places that the lens gives.

use image::RgbImage;
use nalgebra::{Vector2, Vector3};
use pb3dp_estimation_test_support::every_kernel;
use pb3dp_geometry::frames::{CamLeft, CamLeftRect};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, so3};

use super::super::colour_planes::SATURATED_FROM;
use super::cells::DEVIATION_MAX_PX;
use super::*;

const SOURCE: ImageSize = ImageSize { width: 331, height: 247 };
const DESTINATION: ImageSize = ImageSize { width: 357, height: 261 };

/// A map between cameras of different size with unequal focal lengths, rotated about all axes.
fn map(distortion: Distortion, focal_px: f64, turn_rad: [f64; 3]) -> PixelMap {
    let pinhole = Pinhole { fx: focal_px, fy: 0.97 * focal_px, cx: 171.3, cy: 118.2 };
    let source = Camera::new(SOURCE, pinhole, distortion).unwrap();
    let pinhole = Pinhole { fx: 1.02 * focal_px, fy: 0.99 * focal_px, cx: 162.7, cy: 133.9 };
    let destination = Camera::new(DESTINATION, pinhole, Distortion::None).unwrap();
    let turn: Pose<CamLeftRect, CamLeft> = Pose::from_parts(Vector3::zeros(), so3::exp(&Vector3::from(turn_rad)));
    PixelMap::rotate(&source, &destination, &turn)
}

/// Lenses from mild to absurd, some of which image a part of the destination only.
fn maps() -> Vec<(&'static str, PixelMap)> {
    let brown = Distortion::BrownConrady5 { coefficients: [-0.28, 0.09, 0.0011, -0.0007, 0.004] };
    let rational = Distortion::BrownConrady8 { coefficients: [0.4, -0.2, 0.001, -0.002, 0.05, 0.7, -0.1, 0.02] };
    let fisheye = Distortion::Equidistant { coefficients: [-0.012, 0.0043, -0.0021, 0.0004] };
    let folding = Distortion::BrownConrady5 { coefficients: [-1.3, 0.0, 0.01, 0.02, 0.0] };
    let quarter = std::f64::consts::FRAC_PI_2;
    vec![
        ("pinhole", map(Distortion::None, 340.0, [0.03, -0.09, 0.05])),
        ("radial", map(brown, 340.0, [0.03, -0.09, 0.05])),
        ("rational", map(rational, 240.0, [-0.06, 0.04, -0.2])),
        ("fisheye", map(fisheye, 190.0, [0.02, 0.05, -0.03])),
        ("fisheye to the edge of the field", map(fisheye, 95.0, [0.5, -0.4, 0.1])),
        ("folding lens", map(folding, 300.0, [0.1, -0.1, 0.02])),
        ("vertical baseline", map(brown, 340.0, [0.01, 0.02, quarter])),
        ("upside down", map(brown, 340.0, [0.01, 0.02, 2.0 * quarter])),
        ("diagonal baseline", map(brown, 340.0, [0.01, -0.02, 0.6])),
        ("very short focal length", map(fisheye, 12.0, [0.1, 0.0, 0.3])),
        ("nothing in view", map(brown, 340.0, [3.0, 0.0, 0.0])),
    ]
}

fn image(saturated: bool) -> RgbImage {
    RgbImage::from_fn(SOURCE.width, SOURCE.height, |x, y| {
        let wave =
            |k: f64| 118.0 + 90.0 * ((0.11 + 0.02 * k) * f64::from(x) + k).sin() * (0.13 * f64::from(y) - k).cos();
        let bright = saturated && (x / 23 + y / 17) % 5 == 0;
        image::Rgb([0.0, 1.0, 2.0].map(|k| if bright && k == 1.0 { 255 } else { wave(k).round() as u8 }))
    })
}

/// Reference: the whole image by its table, pixel by pixel in double precision. `None` without a source.
fn plain(map: &PixelMap, raw: &RgbImage) -> Vec<Option<([f64; 3], u8)>> {
    let table = map.table();
    let pixels = (0..DESTINATION.height).flat_map(|v| (0..DESTINATION.width).map(move |u| (u, v)));
    pixels.map(|(u, v)| cubic(raw, &table.source(u, v)?)).collect()
}

fn cubic(raw: &RgbImage, at: &Vector2<f64>) -> Option<([f64; 3], u8)> {
    let (x, y) = (at.x.floor(), at.y.floor());
    let last = (f64::from(raw.width()) - 3.0, f64::from(raw.height()) - 3.0);
    if !(x >= 1.0 && y >= 1.0 && x <= last.0 && y <= last.1) {
        return None;
    }
    let weights = |t: f64| {
        let (t2, t3) = (t * t, t * t * t);
        [0.5 * (2.0 * t2 - t - t3), 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * (t + 4.0 * t2 - 3.0 * t3), 0.5 * (t3 - t2)]
    };
    let (columns, rows) = (weights(at.x - x), weights(at.y - y));
    let (mut sum, mut highest) = ([0.0; 3], 0);
    for (j, i) in (0..4).flat_map(|j| (0..4).map(move |i| (j, i))) {
        let pixel = raw.get_pixel(x as u32 + i as u32 - 1, y as u32 + j as u32 - 1).0;
        for (sum, &value) in sum.iter_mut().zip(&pixel) {
            *sum += columns[i] * rows[j] * f64::from(value);
            highest = highest.max(value);
        }
    }
    Some((sum, if highest >= SATURATED_FROM { SATURATED } else { 0 }))
}

fn bits(planes: &ColourPlanes) -> Vec<u32> {
    planes.planes.iter().flat_map(|plane| plane.values().iter().map(|value| value.to_bits())).collect()
}

const WHOLE: PixelWindow =
    PixelWindow { x: 0, y: 0, width: DESTINATION.width as usize, height: DESTINATION.height as usize };

#[test]
fn windows_agree_with_the_plain_path_of_the_whole_image() {
    for ((name, map), saturated) in maps().into_iter().flat_map(|map| [(map, false), (map, true)]) {
        let raw = image(saturated);
        let reference = plain(&map, &raw);
        let mut out = ColourPlanes::default();
        resample(&map, (&raw).into(), WHOLE, Wanted::Rgb, Kernels::best(), &mut out);
        let (mut visible, mut other) = (0, 0);
        for (i, expected) in reference.iter().enumerate() {
            let flags = out.flags[i];
            match expected {
                Some((rgb, expected)) if flags & UNSEEN == 0 => {
                    visible += 1;
                    other += usize::from(flags != *expected);
                    // The table rounds to 1/256 px; saturated edges are steep.
                    let limit = if saturated { 2.5 } else { 0.3 };
                    for (plane, expected) in out.planes.iter().zip(rgb) {
                        let gap = (f64::from(plane.values()[i]) - expected).abs();
                        assert!(gap < limit, "{name}: pixel {i} is off by {gap}");
                    }
                }
                None if flags & UNSEEN != 0 => {}
                // Rounding at the border of the source.
                _ => other += 1,
            }
        }
        assert!(other <= 8 + reference.len() / 500, "{name}: {other} of {} pixels", reference.len());
        assert_eq!(visible > 1000, name != "nothing in view", "{name}: {visible}");
    }
}

#[test]
fn any_window_is_a_part_of_the_whole_image_with_every_kernel() {
    let raw = image(true);
    for (name, map) in maps() {
        for wanted in [Wanted::Rgb, Wanted::Colour, Wanted::Luminance] {
            let mut whole = ColourPlanes::default();
            resample(&map, (&raw).into(), WHOLE, wanted, Kernels::best(), &mut whole);
            let mut first: Option<ColourPlanes> = None;
            for kernels in every_kernel() {
                let mut part = ColourPlanes::default();
                let window = PixelWindow { x: 37, y: 151, width: 141, height: 500 };
                resample(&map, (&raw).into(), window, wanted, kernels, &mut part);
                let (x, y) = (part.window.x as usize, part.window.y as usize);
                assert_eq!((part.window.width, part.window.height), (141, 110));
                let mut worst = 0.0_f32;
                for (plane, whole) in part.planes.iter().zip(&whole.planes).take(wanted.planes()) {
                    for row in 0..part.window.height {
                        for (a, b) in plane.row(row).iter().zip(&whole.row(y + row)[x..]) {
                            worst = worst.max((a - b).abs());
                        }
                    }
                }
                // Cells of both windows have different corners; at the border of the source, rounding decides.
                let is_folded = name == "folding lens" || name.contains("short") || name.contains("edge");
                assert!(worst < 1.0 || is_folded, "{name}: {worst}");
                let first = first.get_or_insert_with(|| part.clone());
                assert!(bits(first) == bits(&part) && first.flags == part.flags, "{name} {}", kernels.set().name());
            }
        }
    }
}

/// Means over squares of pixels, and whether one of a square is saturated.
fn reduced_values(raw: &RgbImage, scale: u32) -> (ImageSize, Vec<([f64; 3], bool)>) {
    let size = ImageSize { width: raw.width() / scale, height: raw.height() / scale };
    let pixels = (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y)));
    let square = |(x, y)| {
        let (mut sum, mut highest) = ([0.0; 3], 0);
        for (i, j) in (0..scale).flat_map(|j| (0..scale).map(move |i| (i, j))) {
            let pixel = raw.get_pixel(x * scale + i, y * scale + j).0;
            sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += f64::from(value));
            highest = pixel.into_iter().fold(highest, u8::max);
        }
        (sum.map(|sum| sum / f64::from(scale * scale)), highest >= SATURATED_FROM)
    };
    (size, pixels.map(square).collect())
}

#[test]
fn reduced_windows_agree_with_means_of_the_raw_image_with_every_kernel() {
    let raw = image(true);
    for ((name, map), scale) in maps().into_iter().take(4).flat_map(|map| [2, 4, 8].map(|scale| (map, scale))) {
        let map = map.reduced(scale);
        let (size, values) = reduced_values(&raw, scale);
        let window = PixelWindow { x: 3, y: 2, width: 37, height: 500 };
        let mut first: Option<ColourPlanes> = None;
        for kernels in every_kernel() {
            let (mut reduced, mut out) = (ReducedImage::default(), ColourPlanes::default());
            resample_reduced(&map, (&raw).into(), window, scale as usize, Wanted::Rgb, kernels, &mut reduced, &mut out);
            let first = first.get_or_insert_with(|| out.clone());
            assert!(bits(first) == bits(&out) && first.flags == out.flags, "{name} {}", kernels.set().name());
        }
        let out = first.unwrap();
        let mut visible = 0;
        for i in 0..out.flags.len() {
            let (x, y) = (i % out.window.width + 3, i / out.window.width + 2);
            let at = map.source(&Vector2::new(x as f64, y as f64)).unwrap();
            let (column, row) = (at.x.floor(), at.y.floor());
            let is_inside = column >= 1.0 && row >= 1.0;
            let is_inside = is_inside && column + 3.0 < f64::from(size.width) && row + 3.0 < f64::from(size.height);
            if !is_inside || out.flags[i] & UNSEEN != 0 {
                continue;
            }
            let weights = |t: f64| keys(t as f32).map(f64::from);
            let (columns, rows) = (weights(at.x - column), weights(at.y - row));
            let (mut sum, mut is_saturated) = ([0.0; 3], false);
            for (j, k) in (0..4).flat_map(|j| (0..4).map(move |k| (j, k))) {
                let index = (row as usize + j - 1) * size.width as usize + column as usize + k - 1;
                let (value, is_high) = values[index];
                sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += rows[j] * columns[k] * value);
                is_saturated |= is_high;
            }
            for (plane, expected) in out.planes.iter().zip(sum) {
                let gap = (f64::from(plane.values()[i]) - expected).abs();
                assert!(gap < 0.3, "{name} by {scale}: pixel {i} is off by {gap}");
            }
            visible += usize::from((out.flags[i] == SATURATED) == is_saturated);
        }
        assert!(visible * 10 > 7 * out.flags.len(), "{name} by {scale}: {visible} of {}", out.flags.len());
    }
}

#[test]
fn interpolated_positions_are_those_of_the_lens() {
    for (name, map) in maps() {
        let (mut worst, mut count) = (0.0_f64, 0);
        for_each_cell(&map, &WHOLE, Kernels::best(), |(x, y), positions| {
            for (i, j) in (0..CELL).flat_map(|j| (0..CELL).map(move |i| (i, j))) {
                let source = map.source(&Vector2::new((x + i) as f64, (y + j) as f64));
                let inside = source.filter(|px| px.min() >= 0.0 && px.x < 331.0 && px.y < 247.0);
                let Some(expected) = inside else { continue };
                let positions = positions.expect("a cell with a source");
                let axis = |axis: usize| f64::from(positions.base[axis]) + f64::from(positions.at[axis][j][i]);
                worst = worst.max((Vector2::new(axis(0), axis(1)) - expected).amax());
                count += 1;
            }
        });
        assert!(
            worst < 2.0 * DEVIATION_MAX_PX && (count > 1000 || name == "nothing in view"),
            "{name}: {worst} {count}"
        );
    }
}

#[test]
fn tiny_images_have_no_pixel_with_all_neighbours() {
    let pinhole = Pinhole { fx: 30.0, fy: 30.0, cx: 0.0, cy: 0.0 };
    for (width, height) in [(1, 1), (3, 90), (90, 3), (4, 4), (5, 4)] {
        let camera = Camera::new(ImageSize { width, height }, pinhole, Distortion::None).unwrap();
        let map = PixelMap::rotate(&camera, &camera, &Pose::<CamLeftRect, CamLeft>::coincident());
        let raw = RgbImage::from_pixel(width, height, image::Rgb([90, 80, 70]));
        let mut out = ColourPlanes::default();
        resample(&map, (&raw).into(), WHOLE, Wanted::Rgb, Kernels::best(), &mut out);
        assert_eq!(out.flags.len(), (width * height) as usize);
        for (i, flag) in out.flags.iter().enumerate().filter(|(_, flag)| **flag == 0) {
            let (x, y) = (i as u32 % width, i as u32 / width);
            assert!(*flag == 0 && x >= 1 && x + 3 <= width && y >= 1 && y + 3 <= height, "{x} {y}");
            assert!((out.planes[0].values()[i] - 90.0).abs() < 1e-3);
        }
    }
}

#[test]
fn the_kernel_interpolates_and_keeps_parabolas() {
    for t in [0.0_f32, 0.3, 0.77] {
        let value: f32 = keys(t).iter().zip([-1.0_f32, 0.0, 1.0, 2.0]).map(|(w, x)| w * (x * x - x + 4.0)).sum();
        assert!((value - (t * t - t + 4.0)).abs() < 1e-5);
    }
}
