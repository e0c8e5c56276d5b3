//! Rectified pairs: a point stays in its row and moves by a shift that is affine in its pixel.
//!
//! All shifts in the search range form one window, common to all points. Once per frame each point gets a row of bits, one per
//! shift of the window: set if the pixel there has the point's hue. Every hypothesis then looks up its bit; the inner loop
//! reads no image and compares no hue.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::trig;

use super::batch::{Batch, Counts, Frame};
use super::kernels::{BITS_PER_WORD, TableView, compare, count_rectified};
use super::points::PointSet;

use crate::hue::{HuePlane, PAD};

/// The shifts (right column minus left column, rounded) that hypotheses of the search range can have for points inside the
/// right image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Window {
    first_shift: i32,
    shifts: usize,
}

impl Window {
    /// Computes the window of a frame.
    ///
    /// The inverse depth at a pixel is `(n . d) / (z n . d_c)`. With n = (p, r, 1) up to scale it is linear-fractional in (p,
    /// r) and linear in the pixel, so over a box with a positive denominator its extremes are at corners.
    pub fn of(frame: &Frame, right_width: usize) -> Self {
        let (low, high) = inverse_depth_bounds(frame);
        let (constant_px, px_per_inverse_m) = frame.shift_of_inverse_depth();
        let ends = [low, high].map(|inverse_depth| constant_px + px_per_inverse_m * inverse_depth);
        let columns = frame.corners().map(|(du, _)| f64::from(frame.origin().0) + du);
        let (left, right) = (columns[0], columns[1]);
        // Shifts beyond these move every point out of the image; one more on either side for rounding.
        let first = ends[0].min(ends[1]).floor().max(-right) - 1.0;
        let last = ends[0].max(ends[1]).ceil().min(right_width as f64 - 1.0 - left) + 1.0;
        Self { first_shift: first as i32, shifts: (last - first + 1.0).max(1.0) as usize }
    }

    /// The shift of bit 0.
    pub fn first_shift(&self) -> i32 {
        self.first_shift
    }

    /// Number of words per point: one bit for every shift, and one that is always zero; at least 8.
    fn words(&self) -> usize {
        (self.shifts + 1).div_ceil(BITS_PER_WORD).max(8)
    }
}

/// Smallest and largest inverse depth of a point in the search range, 1/m; infinite if the range includes the horizon.
fn inverse_depth_bounds(frame: &Frame) -> (f64, f64) {
    let range = frame.range();
    let (tan, (_, cos)) = (trig::tan(range.tilt_max_rad), trig::sin_cos(range.tilt_max_rad));
    let (p_max, r_max) = (tan, tan / cos);
    let centre = frame.centre_ray();
    let (mut low, mut high) = (f64::INFINITY, 0.0_f64);
    for (du, dv) in frame.corners() {
        let (u, v) = (f64::from(frame.origin().0) + du, f64::from(frame.origin().1) + dv);
        let ray = frame.pair().left_ray(&nalgebra::Vector2::new(u, v));
        for (p, r) in [(-p_max, -r_max), (-p_max, r_max), (p_max, -r_max), (p_max, r_max)] {
            let denominator = p * centre.x + r * centre.y + 1.0;
            if denominator <= 1e-9 {
                return (0.0, f64::INFINITY);
            }
            let ratio = ((p * ray.x + r * ray.y + 1.0) / denominator).max(0.0);
            low = low.min(ratio / range.z_max_m);
            high = high.max(ratio / range.z_min_m);
        }
    }
    (low, high)
}

/// One bit per point and shift: set if the pixel there has a hue within a tolerance of the point's.
#[derive(Clone, Debug, Default)]
pub(super) struct MatchTable {
    /// Number of usable bits per point.
    shifts: u32,
    words_per_point: usize,
    /// Inner points, then outer points.
    words: Vec<u32>,
    inner: usize,
}

impl MatchTable {
    /// Compares every point with every pixel of its row in the window.
    pub fn build(&mut self, kernels: Kernels, window: &Window, right: &HuePlane, tolerance: u16, sets: [&PointSet; 2]) {
        self.shifts = window.shifts as u32;
        self.words_per_point = window.words();
        self.inner = sets[0].len();
        self.words.clear();
        self.words.resize((sets[0].len() + sets[1].len()) * self.words_per_point, 0);
        let mut rows = self.words.chunks_exact_mut(self.words_per_point);
        for set in sets {
            for ((&(u, v), &hue), words) in set.pixels.iter().zip(&set.hue).zip(&mut rows) {
                fill_row(kernels, window, right, tolerance, (u, v, hue), words);
            }
        }
    }

    /// The table in the form that a kernel uses, for the inner or the outer points.
    fn view<'a>(&'a self, points: &'a PointSet, outer: bool) -> TableView<'a> {
        let start = if outer { self.inner * self.words_per_point } else { 0 };
        let words = &self.words[start..start + points.len() * self.words_per_point];
        TableView { shifts: self.shifts, words_per_point: self.words_per_point, words, points }
    }
}

/// The bits of one point. Bit k belongs to column `u + first_shift + k`.
fn fill_row(
    kernels: Kernels,
    window: &Window,
    right: &HuePlane,
    tolerance: u16,
    point: (i32, i32, u16),
    words: &mut [u32],
) {
    let (u, v, hue) = point;
    let Ok(v) = usize::try_from(v) else { return };
    if v >= right.height() {
        return;
    }
    let first_column = i64::from(u) + i64::from(window.first_shift);
    // Bits of columns inside the image: low..high.
    let low = (-first_column).clamp(0, window.shifts as i64) as usize;
    let high = (right.width() as i64 - first_column).clamp(0, window.shifts as i64) as usize;
    if low >= high {
        return;
    }
    let (first_word, last_word) = (low / BITS_PER_WORD, (high - 1) / BITS_PER_WORD);
    // The first step starts at most 31 pixels before the row, the last ends at most 31 after it: padding covers both.
    let start = (PAD + v * right.width()) as i64 + first_column + (first_word * BITS_PER_WORD) as i64;
    let pixels = &right.padded()[start as usize..][..(last_word - first_word + 1) * BITS_PER_WORD];
    compare(kernels, pixels, hue, tolerance, &mut words[first_word..=last_word]);
    words[first_word] &= u32::MAX << (low % BITS_PER_WORD);
    words[last_word] &= u32::MAX >> (BITS_PER_WORD - 1 - (high - 1) % BITS_PER_WORD);
}

/// Counts the matches of every hypothesis of a batch.
pub(super) fn count(kernels: Kernels, table: &MatchTable, sets: [&PointSet; 2], batch: &Batch, counts: &mut Counts) {
    let [inner, outer] = sets;
    for (view, counts) in [(table.view(inner, false), &mut counts.inner), (table.view(outer, true), &mut counts.outer)]
    {
        count_rectified(kernels, &view, batch, counts);
    }
}
