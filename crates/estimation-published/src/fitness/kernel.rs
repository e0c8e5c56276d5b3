//! The votes of a set of model points under one hypothesis: one source for every vector width.

use pb3dp_estimation_core::wide::wide;

use super::projection::{FRACTION_BITS, Projection};
use crate::hue::{HuePlane, PAD};
use crate::photo_model::ModelPoint;

/// Number of points that take each step together. Every step is a loop of its own, which compiles to vector instructions; only
/// the look-up of pixels is one by one.
const BLOCK: usize = 512;

/// 3 * 2^22: at this value adjacent floats differ by one, so adding it rounds to an integer, stored in the lowest bits.
const ROUNDER: f32 = 12_582_912.0;

/// The inner or the outer points, relative to an origin pixel.
#[derive(Clone, Debug, Default)]
pub(super) struct Points {
    origin: (i32, i32),
    du: Vec<i32>,
    dv: Vec<i32>,
    /// Stored hues.
    hues: Vec<u16>,
}

impl Points {
    /// Copies a list of points into the existing memory.
    pub fn assign(&mut self, points: &[ModelPoint], origin: (i32, i32)) {
        self.origin = origin;
        self.du.clear();
        self.du.extend(points.iter().map(|p| p.u - origin.0));
        self.dv.clear();
        self.dv.extend(points.iter().map(|p| p.v - origin.1));
        self.hues.clear();
        self.hues.extend(points.iter().map(|p| p.hue.bits()));
    }

    pub fn len(&self) -> usize {
        self.hues.len()
    }
}

wide! {
    /// The number of points that find their hue in the right image within `tolerance` (stored steps), and the number of points
    /// on a pixel with a hue.
    pub(super) fn count(right: &HuePlane, tolerance: u16, points: &Points, projection: &Projection) -> [u32; 2] = count_kernel;
}

/// The order of the floating-point operations is part of the definition: products before sums, left to right, not fused. Sums of
/// integers are written as wrapping ones, because a check of each would prevent vectors; none of them wraps.
#[inline(always)]
fn count_kernel(right: &HuePlane, tolerance: u16, points: &Points, projection: &Projection) -> [u32; 2] {
    let pixels = right.padded();
    let (width, height) = (right.width() as i32, right.height() as i32);
    // Place 0 is padding, without hue: it stands for everything outside the image.
    let place = |u: i32, v: i32, inside: bool| {
        let place = v.wrapping_mul(width).wrapping_add(u).wrapping_add(PAD as i32);
        if inside { place } else { 0 }
    };
    let (mut places, mut found) = ([0; BLOCK], [0; BLOCK]);
    let (mut matches, mut visible) = (0_u32, 0_u32);
    for ((du, dv), hues) in points.du.chunks(BLOCK).zip(points.dv.chunks(BLOCK)).zip(points.hues.chunks(BLOCK)) {
        let relative = du.iter().zip(dv).zip(&mut places);
        match *projection {
            Projection::Shift([slope_u, slope_v, offset]) => {
                for ((du, dv), slot) in relative {
                    let shift = slope_u.wrapping_mul(*du).wrapping_add(slope_v.wrapping_mul(*dv)).wrapping_add(offset);
                    let u = points.origin.0.wrapping_add(*du).wrapping_add(shift >> FRACTION_BITS);
                    let v = points.origin.1.wrapping_add(*dv);
                    *slot = place(u, v, (0 <= u) & (u < width) & (0 <= v) & (v < height));
                }
            }
            Projection::Homography([h00, h01, h02, h10, h11, h12, h20, h21]) => {
                // A NaN is not inside.
                let inside = |x: f32, size: i32| (x - ROUNDER >= 0.0) & (x - ROUNDER < size as f32);
                let whole = |x: f32| (x.to_bits() & 0xFFFF).cast_signed();
                for ((du, dv), slot) in relative {
                    let (du, dv) = (*du as f32, *dv as f32);
                    let inverse = 1.0 / (h20 * du + h21 * dv + 1.0);
                    let u = (h00 * du + h01 * dv + h02) * inverse + ROUNDER;
                    let v = (h10 * du + h11 * dv + h12) * inverse + ROUNDER;
                    *slot = place(whole(u), whole(v), inside(u, width) & inside(v, height));
                }
            }
        }
        for (pixel, place) in found.iter_mut().zip(&places).take(hues.len()) {
            *pixel = pixels[*place as usize];
        }
        for (pixel, hue) in found.iter().zip(hues) {
            // The lowest bit of a stored hue states that there is one.
            let valid = u32::from(pixel & hue & 1);
            let is_near = pixel.wrapping_sub(*hue).cast_signed().unsigned_abs() <= tolerance;
            matches = matches.wrapping_add(valid & u32::from(is_near));
            visible = visible.wrapping_add(valid);
        }
    }
    [matches, visible]
}
