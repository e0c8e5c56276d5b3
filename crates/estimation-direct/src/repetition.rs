//! Detects whether a region's texture repeats along its rows.
//!
//! A repetitive target fits the right image almost as well one period away from the correct position. If the correct position
//! is in the depth range, the search compares both. If it is not, only the left image can reveal the repetition: if the region
//! looks like a copy of itself, moved along the rows, the estimate is one of several possible positions.
//!
//! On a tilted target the period is longer where the target is nearer. The copy is therefore moved in proportion to the
//! disparity (plus the offset to infinity), which again gives a plane.

use pb3dp_estimation_views::colour_planes::ColourPlanes;
use pb3dp_estimation_views::region_pyramid::{LevelPlane, RegionLevel, is_visible};

use super::search::NOISE_GREY;
use crate::surface_choice::SurfaceChoice;

/// Largest number of points compared. Chosen by hand, not varied: a mean of 400 correlations is accurate to 5 % (1 /
/// sqrt(400)); time grows with the number.
const POINTS_MAX: usize = 400;
/// Finds periods; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Repetition {
    points: Vec<(usize, usize)>,
    /// Per point: its neighbourhood, its correlation with itself, and its disparity relative to infinity.
    own: Vec<(Neighbourhood, f32, f64)>,
    /// Neighbourhood of every region pixel in a row with points.
    table: Vec<Neighbourhood>,
    /// Start of each window row in the table.
    starts: Vec<usize>,
}

/// Where a period is sought, pixels of the level.
#[derive(Clone, Copy, Debug)]
pub struct PeriodSearch {
    /// Disparity of the plane in the middle of the region.
    pub middle_px: f64,
    /// Added to disparities so that they are zero at infinity.
    pub infinity_px: f64,
    /// Shortest period of interest.
    pub shortest_px: f64,
}

impl Repetition {
    /// The shortest period of the region's texture along the rows, pixels of the level. `None` if the texture does not repeat
    /// within half of the region's width.
    pub fn period_px(
        &mut self,
        level: &RegionLevel,
        plane: &LevelPlane,
        sought: PeriodSearch,
        choice: &SurfaceChoice,
    ) -> Option<f64> {
        let (repeats_min, valley_max) = (choice.repeats_min as f32, choice.valley_max as f32);
        let PeriodSearch { middle_px, infinity_px, shortest_px } = sought;
        let longest = self.take(level, plane, infinity_px) / 2;
        let all: f32 = self.own.iter().map(|own| own.1).sum();
        if shortest_px > longest as f64 || all.is_nan() || all < choice.repeats_textured_min as f32 {
            return None;
        }
        self.describe_rows(level);
        // If the texture is inverted half a period away (dark for bright), this is the valley.
        let (mut valley, mut summit) = (f32::MAX, None::<(usize, f32)>);
        for shift in (0.5 * shortest_px).max(1.0) as usize..=longest {
            let value =
                self.resemblance(level, all, shift as f64 / (middle_px + infinity_px), choice.partners_min as f32);
            match summit {
                Some((at, best)) if value < best && shift > at + 1 => return Some(at as f64),
                Some((_, best)) if value < best => {}
                _ if value >= repeats_min && valley < valley_max * value && shift as f64 >= shortest_px => {
                    summit = Some((shift, value));
                }
                _ => valley = valley.min(value),
            }
        }
        None
    }

    /// Selects the points, and returns the number of columns that they cover.
    fn take(&mut self, level: &RegionLevel, plane: &LevelPlane, infinity_px: f64) -> usize {
        let (width, height) = (level.left.window.width, level.left.window.height);
        let step = level.area_px.div_ceil(POINTS_MAX).max(1);
        let is_whole = |&(x, y): &(usize, usize)| {
            let i = y * width + x;
            let within = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
            within && level.region[i] != 0 && is_visible(level.left.flags[i])
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        self.points.clear();
        self.points.extend(pixels.filter(is_whole).step_by(step));
        self.own.clear();
        let at_origin = plane.c + f64::from(level.column_shift()) + infinity_px;
        self.own.extend(self.points.iter().map(|&(x, y)| {
            let own = neighbourhood(&rows_around(&level.left, y), x);
            (own, own.agreement(&own), at_origin + plane.a * x as f64 + plane.b * y as f64)
        }));
        let (low, high) =
            self.points.iter().fold((width, 0), |(low, high), point| (low.min(point.0), high.max(point.0)));
        high.saturating_sub(low)
    }

    /// Computes the neighbourhoods of all region pixels in the rows that have points.
    fn describe_rows(&mut self, level: &RegionLevel) {
        let width = level.left.window.width;
        self.table.clear();
        self.starts.clear();
        for &(_, y) in &self.points {
            if y < self.starts.len() {
                continue;
            }
            self.starts.resize(y + 1, self.table.len());
            let rows = rows_around(&level.left, y);
            let inside = &level.region[y * width..(y + 1) * width];
            self.table.extend(inside.iter().enumerate().map(|(x, &inside)| {
                match inside != 0 && x > 0 && x + 1 < width {
                    true => neighbourhood(&rows, x),
                    false => Neighbourhood::default(),
                }
            }));
        }
    }

    /// Mean correlation of the points with the pixels farther right by `shift` times their disparity relative to infinity,
    /// divided by their correlation with themselves; 0 if too few of these pixels are in the region.
    fn resemblance(&self, level: &RegionLevel, all: f32, shift: f64, partners_min: f32) -> f32 {
        let width = level.left.window.width;
        let (mut sum, mut own) = (0.0, 0.0);
        for (&(x, y), (here, agreement, disparity_px)) in self.points.iter().zip(&self.own) {
            let at = x as f64 + shift * disparity_px;
            let column = (at + 0.5) as usize;
            if at >= 1.0 && column + 1 < width && level.region[y * width + column] != 0 {
                sum += here.agreement(&self.table[self.starts[y] + column]);
                own += agreement;
            }
        }
        if own >= partners_min * all { sum / own } else { 0.0 }
    }
}

/// A neighbourhood of 3 x 3 pixels minus its mean, with a norm of nearly one if it has texture.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Neighbourhood([f32; 9]);

impl Neighbourhood {
    pub(super) fn agreement(&self, other: &Self) -> f32 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }
}

/// The three rows around an interior row of an image.
pub(super) fn rows_around(image: &ColourPlanes, y: usize) -> [&[f32]; 3] {
    let plane = image.luminance();
    std::array::from_fn(|j| plane.row(y + j - 1))
}

pub(super) fn neighbourhood(rows: &[&[f32]; 3], x: usize) -> Neighbourhood {
    let rows = rows.map(|row| &row[x - 1..x + 2]);
    let mut values: [f32; 9] = std::array::from_fn(|k| rows[k / 3][k % 3]);
    let mean = values.iter().sum::<f32>() / 9.0;
    for value in &mut values {
        *value -= mean;
    }
    let energy: f32 = values.iter().map(|value| value * value).sum();
    let length = (energy + 9.0 * NOISE_GREY * NOISE_GREY).sqrt();
    Neighbourhood(values.map(|value| value / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_estimation_views::colour_planes::Wanted;
    use pb3dp_estimation_views::image_plane::PixelWindow;

    const SIZE: usize = 90;

    /// A level whose left image shows `brightness`, with a region of 80 x 70 pixels.
    fn level(brightness: impl Fn(f64, f64) -> f64) -> RegionLevel {
        let mut level = RegionLevel { scale: 1, ..RegionLevel::default() };
        let window = PixelWindow { x: 0, y: 0, width: SIZE, height: SIZE };
        level.left.resize(window, Wanted::Luminance);
        level.right.resize(window, Wanted::Luminance);
        for y in 0..SIZE {
            for x in 0..SIZE {
                level.left.planes[0].row_mut(y)[x] = brightness(x as f64, y as f64) as f32;
            }
        }
        level.left.flags.fill(0);
        let inside = |x: usize, y: usize| (5..85).contains(&x) && (10..80).contains(&y);
        level.region = (0..SIZE * SIZE).map(|i| u8::from(inside(i % SIZE, i / SIZE))).collect();
        level.area_px = 80 * 70;
        level
    }

    fn period(level: &RegionLevel, slope: f64, shortest_px: f64) -> Option<f64> {
        let plane = LevelPlane { a: slope, b: 0.0, c: 60.0 - 45.0 * slope, row: 0 };
        Repetition::default().period_px(
            level,
            &plane,
            PeriodSearch { middle_px: 60.0, infinity_px: 20.0, shortest_px },
            &SurfaceChoice::default(),
        )
    }

    #[test]
    fn the_period_of_a_board_is_found_where_it_is_long_enough() {
        let board = level(|x, y| if ((x / 12.0) as i64 + (y / 11.0) as i64) % 2 == 0 { 200.0 } else { 60.0 });
        assert_eq!([5.0, 20.0, 24.0].map(|shortest| period(&board, 0.0, shortest)), [Some(24.0); 3]);
        assert_eq!(period(&board, 0.0, 41.0), None);
    }

    /// The period grows with the disparity: the repetitions are equidistant in the logarithm of the distance to infinity's
    /// position.
    #[test]
    fn the_period_of_a_tilted_board_is_that_in_the_middle() {
        let slope = 0.4;
        let relative = |x: f64| 1.0 + slope * (x - 45.0) / 80.0;
        let phase = |x: f64| (80.0 / slope) * relative(x).ln();
        let board =
            level(|x, y| if ((100.0 + phase(x)) / 12.0 + (y / 11.0).floor()) % 2.0 < 1.0 { 200.0 } else { 60.0 });
        let found = period(&board, slope, 10.0).unwrap();
        assert!((found - 24.0).abs() <= 2.0, "{found}");
    }

    #[test]
    fn what_has_no_period_has_none() {
        let hash = |x: f64, y: f64| ((x * 12.9898 + y * 78.233).sin() * 43758.5453).fract().abs();
        assert_eq!(period(&level(|x, y| 60.0 + 140.0 * hash((x / 3.0).floor(), (y / 3.0).floor())), 0.1, 4.0), None);
        assert_eq!(period(&level(|_, _| 90.0), 0.0, 4.0), None);
        assert_eq!(period(&level(|x, _| 2.0 * x), 0.0, 4.0), None);
    }
}
