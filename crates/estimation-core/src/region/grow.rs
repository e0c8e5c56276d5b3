//! Region growing from a seed pixel, and connected components of a mask.

use crate::image_view::ImageView;
use pb3dp_geometry::ImageSize;

use super::{RegionConfig, RegionMask};

/// Colour class of a seed pixel, which decides the criterion for region growing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Seed {
    /// Coloured: pixels join by hue, degrees.
    Hue(f64),
    /// Grey: pixels join by luminance, grey levels.
    Luminance(f64),
}

/// Colour of a pixel after a 3x3 mean.
#[derive(Clone, Copy, Debug)]
pub(super) struct SmoothColour {
    /// Hue of the HSV hexagon, degrees, 0 to 360; meaningless for small chroma.
    pub hue_deg: f64,
    /// Largest minus smallest channel, grey levels.
    pub chroma: f64,
    /// (R + G + B) / 3, grey levels.
    pub luminance: f64,
}

/// Mean colour of the 3x3 pixels around (x, y), clipped to the image.
pub(super) fn smooth_colour(image: ImageView<'_>, x: u32, y: u32) -> SmoothColour {
    let (first, end) = (x.saturating_sub(1), (x + 2).min(image.width()));
    let (mut sum, mut count) = ([0_u32; 3], 0_u32);
    for v in y.saturating_sub(1)..(y + 2).min(image.height()) {
        let mut row = [[0; 3]; 3];
        let pixels = &mut row[..(end - first) as usize];
        image.copy_row(first as usize, v as usize, pixels.as_flattened_mut());
        for pixel in pixels {
            (0..3).for_each(|c| sum[c] += u32::from(pixel[c]));
            count += 1;
        }
    }
    let [r, g, b] = sum.map(|s| f64::from(s) / f64::from(count.max(1)));
    let (high, low) = (r.max(g).max(b), r.min(g).min(b));
    let chroma = high - low;
    let sector = if chroma <= 0.0 {
        0.0
    } else if high == r {
        (g - b) / chroma
    } else if high == g {
        (b - r) / chroma + 2.0
    } else {
        (r - g) / chroma + 4.0
    };
    SmoothColour { hue_deg: (60.0 * sector).rem_euclid(360.0), chroma, luminance: (r + g + b) / 3.0 }
}

/// Grows the region of similar pixels connected to the seed (4-connected) and fills its holes; also returns the kind of the
/// seed.
pub(super) fn from_seed(image: ImageView<'_>, x: u32, y: u32, config: &RegionConfig) -> (Seed, RegionMask) {
    let colour = smooth_colour(image, x, y);
    let seed = if colour.chroma >= config.click_chroma_min {
        Seed::Hue(colour.hue_deg)
    } else {
        Seed::Luminance(colour.luminance)
    };
    let size = ImageSize { width: image.width(), height: image.height() };
    let alike = |u: u32, v: u32| {
        let other = smooth_colour(image, u, v);
        let coloured = other.chroma >= config.click_chroma_min;
        match seed {
            Seed::Hue(hue) => coloured && hue_distance_deg(hue, other.hue_deg) <= config.click_hue_tolerance_deg,
            Seed::Luminance(level) => !coloured && (level - other.luminance).abs() <= config.click_luminance_tolerance,
        }
    };
    (seed, fill_holes(&flood(size, [(x, y)], alike)))
}

/// Shortest angular distance between two hues, degrees, 0 to 180.
pub(super) fn hue_distance_deg(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(360.0);
    d.min(360.0 - d)
}

/// Pixels connected to `seeds` (4-connected) for which `alike` holds.
fn flood(
    size: ImageSize,
    seeds: impl IntoIterator<Item = (u32, u32)>,
    mut alike: impl FnMut(u32, u32) -> bool,
) -> RegionMask {
    let mut reached = RegionMask::empty(size);
    let mut refused = RegionMask::empty(size);
    let mut open: Vec<(u32, u32)> = Vec::new();
    let mut visit = |x: u32, y: u32, open: &mut Vec<(u32, u32)>| {
        if reached.contains(x as i32, y as i32) || refused.contains(x as i32, y as i32) {
            return;
        }
        if alike(x, y) {
            reached.insert(x, y);
            open.push((x, y));
        } else {
            refused.insert(x, y);
        }
    };
    seeds.into_iter().for_each(|(x, y)| visit(x, y, &mut open));
    while let Some((x, y)) = open.pop() {
        if x > 0 {
            visit(x - 1, y, &mut open);
        }
        if y > 0 {
            visit(x, y - 1, &mut open);
        }
        if x + 1 < size.width {
            visit(x + 1, y, &mut open);
        }
        if y + 1 < size.height {
            visit(x, y + 1, &mut open);
        }
    }
    reached
}

/// Fills the holes of a mask: adds every pixel that cannot reach the image border without crossing the mask.
fn fill_holes(mask: &RegionMask) -> RegionMask {
    let size = mask.size();
    let border = (0..size.width)
        .flat_map(|x| [(x, 0), (x, size.height - 1)])
        .chain((0..size.height).flat_map(|y| [(0, y), (size.width - 1, y)]));
    let outside = flood(size, border, |x, y| !mask.contains(x as i32, y as i32));
    RegionMask::from_fn(size, |x, y| !outside.contains(x as i32, y as i32))
}

/// The largest connected component (4-connected); among equal ones, the first in reading order.
pub(super) fn largest_part(mask: &RegionMask) -> RegionMask {
    let mut best = RegionMask::empty(mask.size());
    let mut best_area = 0;
    let mut visited = RegionMask::empty(mask.size());
    mask.for_each_run(|y, first, last| {
        if visited.contains(first as i32, y as i32) {
            return;
        }
        let part = flood(mask.size(), [(first, y)], |u, v| mask.contains(u as i32, v as i32));
        part.for_each_run(|row, a, b| visited.insert_span(i64::from(row), i64::from(a), i64::from(b)));
        debug_assert!(visited.contains(last as i32, y as i32));
        let area = part.area_px();
        if area > best_area {
            (best, best_area) = (part, area);
        }
    });
    best
}
