//! Pixel masks: a set of pixels of one image.

use nalgebra::Vector2;
use pb3dp_geometry::ImageSize;

use super::outline;

/// Bounding box of a set of pixels: columns `x..x + width`, rows `y..y + height`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelBox {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

/// How much of a set of pixels is in a mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// No pixel.
    None,
    /// Some pixels, but not all.
    Some,
    /// All pixels.
    All,
}

/// A binary mask: the pixels of one image that belong to a region, one bit per pixel.
///
/// Pixel (x, y) is column x, row y; integer coordinates are pixel centres.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RegionMask {
    size: ImageSize,
    words_per_row: usize,
    bits: Vec<u64>,
}

impl RegionMask {
    /// An empty mask for an image of `size`.
    pub fn empty(size: ImageSize) -> Self {
        let words_per_row = (size.width as usize).div_ceil(64);
        Self { size, words_per_row, bits: vec![0; words_per_row * size.height as usize] }
    }

    /// The mask of all pixels for which `inside(x, y)` holds.
    pub fn from_fn(size: ImageSize, mut inside: impl FnMut(u32, u32) -> bool) -> Self {
        let mut mask = Self::empty(size);
        for y in 0..size.height {
            for x in 0..size.width {
                if inside(x, y) {
                    mask.insert(x, y);
                }
            }
        }
        mask
    }

    /// Size of the image that the mask belongs to.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Clears the mask and sets a new size; keeps the allocated memory.
    pub fn reset(&mut self, size: ImageSize) {
        self.size = size;
        self.words_per_row = (size.width as usize).div_ceil(64);
        self.bits.clear();
        self.bits.resize(self.words_per_row * size.height as usize, 0);
    }

    /// Whether pixel (x, y) is in the mask; `false` outside the image.
    #[inline]
    pub fn contains(&self, x: i32, y: i32) -> bool {
        if x < 0 || y < 0 || x >= self.size.width as i32 || y >= self.size.height as i32 {
            return false;
        }
        let (x, y) = (x as usize, y as usize);
        self.bits[y * self.words_per_row + x / 64] >> (x % 64) & 1 == 1
    }

    /// Adds pixel (x, y); does nothing outside the image.
    pub fn insert(&mut self, x: u32, y: u32) {
        self.insert_span(i64::from(y), i64::from(x), i64::from(x));
    }

    /// Adds the pixels `first..=last` of row `y`, clipped to the image.
    pub fn insert_span(&mut self, y: i64, first: i64, last: i64) {
        let first = first.max(0);
        let last = last.min(i64::from(self.size.width) - 1);
        if y < 0 || y >= i64::from(self.size.height) || first > last {
            return;
        }
        let row = y as usize * self.words_per_row;
        set_bits(&mut self.bits[row..row + self.words_per_row], first as usize, last as usize);
    }

    /// How much of a box of pixels is in the mask: columns `x.0..=x.1`, rows `y.0..=y.1`; pixels outside the image are not.
    pub fn coverage(&self, x: (i32, i32), y: (i32, i32)) -> Coverage {
        let (width, height) = (self.size.width as i32, self.size.height as i32);
        let clipped = ((x.0.max(0), x.1.min(width - 1)), (y.0.max(0), y.1.min(height - 1)));
        let ((first, last), (top, bottom)) = clipped;
        if first > last || top > bottom {
            return Coverage::None;
        }
        let (mut any, mut all) = (false, clipped == (x, y));
        for row in top..=bottom {
            let bits = &self.bits[row as usize * self.words_per_row..][..self.words_per_row];
            for (word, mask) in span_masks(first as usize, last as usize) {
                any |= bits[word] & mask != 0;
                all &= bits[word] & mask == mask;
            }
            if any && !all {
                return Coverage::Some;
            }
        }
        if all { Coverage::All } else { Coverage::None }
    }

    /// Whether the mask has no pixels.
    pub fn is_empty(&self) -> bool {
        self.bits.iter().all(|word| *word == 0)
    }

    /// Number of pixels in the mask.
    pub fn area_px(&self) -> usize {
        self.bits.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Centroid of the mask, pixels; `None` if the mask is empty.
    pub fn centroid_px(&self) -> Option<Vector2<f64>> {
        let (mut count, mut sum_x, mut sum_y) = (0_u64, 0_u64, 0_u64);
        self.for_each_run(|y, first, last| {
            let length = u64::from(last - first + 1);
            count += length;
            sum_x += u64::from(first + last) * length;
            sum_y += u64::from(y) * length;
        });
        (count > 0).then(|| Vector2::new(sum_x as f64 / 2.0, sum_y as f64) / count as f64)
    }

    /// Bounding box of the mask; `None` if the mask is empty.
    pub fn bbox(&self) -> Option<PixelBox> {
        let (mut x0, mut x1, mut y0, mut y1) = (u32::MAX, 0, u32::MAX, 0);
        self.for_each_run(|y, first, last| {
            (x0, x1) = (x0.min(first), x1.max(last));
            (y0, y1) = (y0.min(y), y1.max(y));
        });
        (x0 != u32::MAX).then(|| PixelBox { x: x0, y: y0, width: x1 - x0 + 1, height: y1 - y0 + 1 })
    }

    /// Calls `visit(x, y)` for every pixel in the mask, row by row.
    pub fn for_each(&self, mut visit: impl FnMut(u32, u32)) {
        self.for_each_run(|y, first, last| (first..=last).for_each(|x| visit(x, y)));
    }

    /// Calls `visit(y, first, last)` for every run of pixels in the mask, row by row from left to right.
    pub fn for_each_run(&self, mut visit: impl FnMut(u32, u32, u32)) {
        for y in 0..self.size.height {
            let mut start = 0;
            while let Some((first, last)) = self.next_run(y, start) {
                visit(y, first, last);
                start = last + 1;
            }
        }
    }

    /// Dilation: all pixels within `radius_px` (Euclidean, centre to centre) of a pixel in the mask, clipped to the image.
    pub fn dilate(&self, radius_px: u32) -> Self {
        let mut grown = Self::empty(self.size);
        self.dilate_into(radius_px, &mut grown);
        grown
    }

    /// As [`Self::dilate`], into the memory of another mask.
    pub fn dilate_into(&self, radius_px: u32, grown: &mut Self) {
        grown.reset(self.size);
        let radius = i64::from(radius_px);
        self.for_each_run(|y, first, last| {
            for dy in -radius..=radius {
                let reach = half_width(radius, dy);
                grown.insert_span(i64::from(y) + dy, i64::from(first) - reach, i64::from(last) + reach);
            }
        });
    }

    /// Erosion: the pixels that are farther than `radius_px` (Euclidean, centre to centre) from every pixel outside the mask.
    /// Pixels beyond the image border count as outside.
    pub fn erode(&self, radius_px: u32) -> Self {
        let mut kept = self.clone();
        let (width, height) = (i64::from(self.size.width), i64::from(self.size.height));
        let radius = i64::from(radius_px);
        let mut cut = |y: i64, first: i64, last: i64| {
            for dy in -radius..=radius {
                let reach = half_width(radius, dy);
                kept.remove_span(y + dy, first - reach, last + reach);
            }
        };
        for y in -radius..height + radius {
            let mut start = 0_i64;
            if (0..height).contains(&y) {
                while let Some((first, last)) = self.next_run(y as u32, start as u32) {
                    cut(y, if start == 0 { -radius } else { start }, i64::from(first) - 1);
                    start = i64::from(last) + 1;
                }
            }
            cut(y, if start == 0 { -radius } else { start }, width - 1 + radius);
        }
        kept
    }

    /// The mask translated by whole pixels; pixels that leave the image are dropped.
    pub fn translate(&self, dx: i32, dy: i32) -> Self {
        let mut moved = Self::empty(self.size);
        let (dx, dy) = (i64::from(dx), i64::from(dy));
        self.for_each_run(|y, first, last| {
            moved.insert_span(i64::from(y) + dy, i64::from(first) + dx, i64::from(last) + dx);
        });
        moved
    }

    /// Outline of the largest connected component (4-connected) as a polygon along pixel edges, simplified to within 0.4 px,
    /// with holes closed. Empty if the mask is empty. Rasterising the outline reproduces the component except for a few edge
    /// pixels.
    pub fn outline_px(&self) -> Vec<Vector2<f64>> {
        outline::largest(self)
    }

    fn remove_span(&mut self, y: i64, first: i64, last: i64) {
        let first = first.max(0);
        let last = last.min(i64::from(self.size.width) - 1);
        if y < 0 || y >= i64::from(self.size.height) || first > last {
            return;
        }
        let row = &mut self.bits[y as usize * self.words_per_row..][..self.words_per_row];
        for (word, mask) in span_masks(first as usize, last as usize) {
            row[word] &= !mask;
        }
    }

    /// First run of mask pixels in row `y` that begins at column `start` or later.
    fn next_run(&self, y: u32, start: u32) -> Option<(u32, u32)> {
        let row = &self.bits[y as usize * self.words_per_row..][..self.words_per_row];
        let first = next_bit(row, start as usize, true)?;
        let end = next_bit(row, first, false).unwrap_or(self.size.width as usize).min(self.size.width as usize);
        Some((first as u32, end as u32 - 1))
    }
}

/// Half width of a disc of `radius` at vertical distance `dy` from its centre.
fn half_width(radius: i64, dy: i64) -> i64 {
    ((radius * radius - dy * dy) as f64).sqrt().floor() as i64
}

fn set_bits(row: &mut [u64], first: usize, last: usize) {
    for (word, mask) in span_masks(first, last) {
        row[word] |= mask;
    }
}

/// Word index and bit mask of every word that overlaps the bits `first..=last`.
fn span_masks(first: usize, last: usize) -> impl Iterator<Item = (usize, u64)> {
    (first / 64..=last / 64).map(move |word| {
        let low = if word == first / 64 { u64::MAX << (first % 64) } else { u64::MAX };
        let high = if word == last / 64 { u64::MAX >> (63 - last % 64) } else { u64::MAX };
        (word, low & high)
    })
}

/// Index of the first bit at `start` or later that equals `value`.
fn next_bit(row: &[u64], start: usize, value: bool) -> Option<usize> {
    let mut word = start / 64;
    let mut skip = start % 64;
    while word < row.len() {
        let bits = (if value { row[word] } else { !row[word] }) & (u64::MAX << skip);
        if bits != 0 {
            return Some(word * 64 + bits.trailing_zeros() as usize);
        }
        word += 1;
        skip = 0;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: ImageSize = ImageSize { width: 150, height: 40 };

    fn blob() -> RegionMask {
        // An L with a hole, across the 64-bit word boundaries and touching the right edge.
        RegionMask::from_fn(SIZE, |x, y| {
            (x >= 60 && (5..30).contains(&y) && !(70..=72).contains(&x)) || ((60..132).contains(&x) && y >= 28)
        })
    }

    fn near(mask: &RegionMask, inside: bool, x: i32, y: i32, radius: i32) -> bool {
        (-radius..=radius).any(|dy| {
            (-radius..=radius).any(|dx| dx * dx + dy * dy <= radius * radius && mask.contains(x + dx, y + dy) == inside)
        })
    }

    #[test]
    fn dilation_and_erosion_follow_their_definition() {
        for radius in [0, 1, 3, 6] {
            let (mask, r) = (blob(), radius as i32);
            let (grown, shrunk) = (mask.dilate(radius), mask.erode(radius));
            for y in 0..SIZE.height as i32 {
                for x in 0..SIZE.width as i32 {
                    assert_eq!(grown.contains(x, y), near(&mask, true, x, y, r), "dilate {radius} at ({x}, {y})");
                    assert_eq!(shrunk.contains(x, y), !near(&mask, false, x, y, r), "erode {radius} at ({x}, {y})");
                }
            }
        }
    }

    #[test]
    fn area_centroid_and_box_agree_with_a_plain_count() {
        let mask = blob();
        let (mut n, mut sx, mut sy) = (0, 0, 0);
        let (mut x0, mut x1, mut y0, mut y1) = (999, 0, 999, 0);
        for y in 0..40 {
            for x in 0..150 {
                if mask.contains(x, y) {
                    (n, sx, sy) = (n + 1, sx + x, sy + y);
                    (x0, x1, y0, y1) = (x0.min(x), x1.max(x), y0.min(y), y1.max(y));
                }
            }
        }
        assert_eq!(mask.area_px(), n as usize);
        let centroid = mask.centroid_px().expect("not empty");
        assert!((centroid.x - f64::from(sx) / f64::from(n)).abs() < 1e-12);
        assert!((centroid.y - f64::from(sy) / f64::from(n)).abs() < 1e-12);
        let expected =
            PixelBox { x: x0 as u32, y: y0 as u32, width: (x1 - x0 + 1) as u32, height: (y1 - y0 + 1) as u32 };
        assert_eq!(mask.bbox(), Some(expected));
    }

    #[test]
    fn coverage_agrees_with_every_pixel() {
        let mask = blob();
        for (x, width) in [(-9, 4), (-3, 30), (55, 5), (58, 4), (61, 8), (66, 9), (73, 20), (130, 30), (60, 0)] {
            for (y, height) in [(-5, 3), (-2, 9), (4, 1), (6, 12), (20, 12), (29, 8), (35, 20)] {
                let pixels = (y..=y + height).flat_map(|v| (x..=x + width).map(move |u| (u, v)));
                let inside: Vec<bool> = pixels.map(|(u, v)| mask.contains(u, v)).collect();
                let expected = match (inside.contains(&true), inside.contains(&false)) {
                    (true, true) => Coverage::Some,
                    (true, false) => Coverage::All,
                    _ => Coverage::None,
                };
                assert_eq!(mask.coverage((x, x + width), (y, y + height)), expected, "{x} {y} {width} {height}");
            }
        }
    }

    #[test]
    fn translation_moves_pixels_and_loses_those_that_leave() {
        let mask = blob();
        let moved = mask.translate(25, -7);
        for y in 0..40 {
            for x in 0..150 {
                assert_eq!(moved.contains(x, y), mask.contains(x - 25, y + 7), "({x}, {y})");
            }
        }
        assert!(mask.translate(150, 0).is_empty());
        assert_eq!(RegionMask::empty(SIZE).centroid_px(), None);
        assert_eq!(RegionMask::empty(SIZE).bbox(), None);
    }
}
