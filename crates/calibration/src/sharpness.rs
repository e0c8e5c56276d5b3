//! Blur of a board in an image, and its motion between two images.

use image::GrayImage;
use nalgebra::Vector2;
use pb3dp_record::metrics::median;

use crate::board::Sighting;

/// Positions along an edge whose profiles are averaged, as shares of its length.
const ALONG: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.7];
/// Half the length of a profile, as a share of the shorter side of a square; then the maximum, px.
const REACH: f64 = 0.3;
const REACH_MAX_PX: f64 = 8.0;
/// Distance of two samples of a profile, px.
const STEP_PX: f64 = 0.25;
/// Minimum contrast of an edge, grey levels.
const CONTRAST_MIN: f64 = 16.0;
/// Minimum number of usable edges in each direction.
const EDGES_MIN: usize = 4;

/// Standard deviation of the blur of the edges between squares, px: the larger value of the two board directions, so that motion
/// along one of them counts. A perfect image has about 0.6, because of the pixel area. `None` if too few edges are usable.
pub fn blur_px(image: &GrayImage, sighting: &Sighting) -> Option<f64> {
    let mut across = Vec::new();
    let mut down = Vec::new();
    for corner in sighting.corners() {
        let right = sighting.at(corner.column + 1, corner.row).map(|other| other.pixel - corner.pixel);
        let below = sighting.at(corner.column, corner.row + 1).map(|other| other.pixel - corner.pixel);
        let (Some(right), Some(below)) = (right, below) else { continue };
        let reach_px = (REACH * right.norm().min(below.norm())).min(REACH_MAX_PX);
        across.extend(edge_blur_px(image, corner.pixel, right, reach_px));
        down.extend(edge_blur_px(image, corner.pixel, below, reach_px));
    }
    let of_enough = |edges: &[f64]| (edges.len() >= EDGES_MIN).then(|| median(edges)).flatten();
    Some(of_enough(&across)?.max(of_enough(&down)?))
}

/// Blur of the edge that runs from a corner along `edge`: contrast divided by the steepest slope, which is `s * sqrt(2 pi)` for a
/// Gaussian of standard deviation s.
fn edge_blur_px(image: &GrayImage, from: Vector2<f64>, edge: Vector2<f64>, reach_px: f64) -> Option<f64> {
    let normal = Vector2::new(-edge.y, edge.x).normalize();
    let count = (2.0 * reach_px / STEP_PX).round() as usize + 1;
    let mut profile = Vec::with_capacity(count);
    for index in 0..count {
        let aside = normal * (index as f64 * STEP_PX - reach_px);
        let mut sum = 0.0;
        for share in ALONG {
            sum += sample(image, from + edge * share + aside)?;
        }
        profile.push(sum / ALONG.len() as f64);
    }
    let end = count / 6;
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    let (first, last) = (profile.get(..end)?, profile.get(count - end..)?);
    let contrast = (mean(last) - mean(first)).abs();
    // The slope is taken over one pixel, so that noise does not make an edge steep.
    let over = (1.0 / STEP_PX) as usize;
    let slope = profile.windows(over + 1).map(|part| (part[over] - part[0]).abs()).fold(0.0, f64::max);
    (end > 0 && contrast >= CONTRAST_MIN).then(|| contrast / (slope * std::f64::consts::TAU.sqrt()))
}

/// Interpolated image value; `None` outside.
fn sample(image: &GrayImage, at: Vector2<f64>) -> Option<f64> {
    let (x, y) = (at.x.floor(), at.y.floor());
    if !(x >= 0.0 && y >= 0.0 && x + 1.0 < f64::from(image.width()) && y + 1.0 < f64::from(image.height())) {
        return None;
    }
    let grey = |dx: u32, dy: u32| f64::from(image.get_pixel(x as u32 + dx, y as u32 + dy).0[0]);
    let (a, b) = (at.x - x, at.y - y);
    Some((1.0 - b) * ((1.0 - a) * grey(0, 0) + a * grey(1, 0)) + b * ((1.0 - a) * grey(0, 1) + a * grey(1, 1)))
}

/// Root mean square displacement of the corners common to both detections, px; `None` if there are none.
pub fn moved_px(first: &Sighting, second: &Sighting) -> Option<f64> {
    let ways = first.corners().iter().filter_map(|corner| {
        let other = second.at(corner.column, corner.row)?;
        Some((other.pixel - corner.pixel).norm_squared())
    });
    let (sum, count) = ways.fold((0.0, 0_usize), |(sum, count), square| (sum + square, count + 1));
    (count > 0).then(|| (sum / count as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::BoardCorner;

    const SIDE: f64 = 24.0;

    /// A rotated board of 6 x 5 corners whose edges are blurred by a Gaussian, and then along x by motion.
    fn drawn(sigma_px: f64, motion_px: f64) -> (GrayImage, Sighting) {
        let (sin, cos) = 0.2_f64.sin_cos();
        let place = |c: f64, r: f64| Vector2::new(50.0 + SIDE * (cos * c - sin * r), 40.0 + SIDE * (sin * c + cos * r));
        let sharp = image::ImageBuffer::from_fn(4 * 220, 4 * 200, |x, y| {
            let at = Vector2::new(f64::from(x) / 4.0 - 0.375, f64::from(y) / 4.0 - 0.375) - place(0.0, 0.0);
            let (c, r) = ((cos * at.x + sin * at.y) / SIDE, (cos * at.y - sin * at.x) / SIDE);
            image::Luma([if (c.floor() + r.floor()).rem_euclid(2.0) < 0.5 { 40.0_f32 } else { 210.0 }])
        });
        let blurred = if sigma_px > 0.0 { image::imageops::blur(&sharp, 4.0 * sigma_px as f32) } else { sharp };
        let reach = (2.0 * motion_px) as i64;
        let image = GrayImage::from_fn(220, 200, |u, v| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (dx, dy) in (-reach..4 + reach).flat_map(|dx| (0..4).map(move |dy| (dx, dy))) {
                let x = (i64::from(4 * u) + dx).clamp(0, 4 * 220 - 1) as u32;
                sum += blurred.get_pixel(x, 4 * v + dy).0[0];
                count += 1.0;
            }
            image::Luma([(sum / count).round() as u8])
        });
        let corner = |c: u32, r: u32| BoardCorner { column: c, row: r, pixel: place(f64::from(c), f64::from(r)) };
        (image, Sighting::new((0..5).flat_map(|r| (0..6).map(move |c| corner(c, r))).collect()))
    }

    #[test]
    fn the_blur_of_edges_is_measured() {
        let blur = |sigma_px, motion_px| {
            let (image, sighting) = drawn(sigma_px, motion_px);
            blur_px(&image, &sighting).expect("edges")
        };
        let measured = [0.0, 1.0, 1.5, 2.0].map(|sigma| (sigma, blur(sigma, 0.0)));
        println!("blur and what was measured, px: {measured:?}; moved by 6 px: {}", blur(0.7, 6.0));
        assert!(measured[0].1 < 0.7, "{measured:?}");
        for (sigma, measured_slope) in &measured[1..] {
            // The pixel area adds to the blur.
            assert!((measured_slope - (sigma * sigma + 0.2_f64).sqrt()).abs() < 0.15 * sigma, "{measured:?}");
        }
        assert!(blur(0.7, 6.0) > 1.8);
    }

    #[test]
    fn what_can_not_be_judged_is_nothing() {
        let (image, sighting) = drawn(0.5, 0.0);
        assert_eq!(blur_px(&GrayImage::new(220, 200), &sighting), None);
        assert_eq!(blur_px(&GrayImage::new(10, 10), &sighting), None);
        assert_eq!(blur_px(&image, &Sighting::default()), None);
    }

    #[test]
    fn motion_is_that_of_the_corners_that_both_have() {
        let (_, sighting) = drawn(0.0, 0.0);
        let moved = sighting.corners()[3..]
            .iter()
            .map(|corner| BoardCorner { pixel: corner.pixel + Vector2::new(3.0, -4.0), ..*corner });
        let apart = moved_px(&sighting, &Sighting::new(moved.collect())).expect("corners");
        assert!((apart - 5.0).abs() < 1e-9);
        assert_eq!(moved_px(&sighting, &Sighting::default()), None);
    }
}
