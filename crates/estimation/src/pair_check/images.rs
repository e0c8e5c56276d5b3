//! Reduced luminance images, normalised windows of them, and the scores of a window of the left image along its epipolar curve in
//! the right image.

use nalgebra::{Point3, Vector2};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_geometry::StereoRig;

/// Columns and rows of a window.
pub const WINDOW: usize = 8;
/// Pixels of a window.
const AREA: usize = WINDOW * WINDOW;
/// Scale of the luminance: it is stored in eighths of a grey level, so that means of blocks keep their fraction.
pub const SCALE: f64 = 8.0;
/// Vector norm of a normalised window; the products of its elements with those of a plane stay within 31 bits.
const LENGTH: f64 = 4096.0;
/// Windows with a smaller standard deviation match nothing, grey levels.
const DEVIATION_MIN: f64 = 2.0;

/// Largest disparity searched, on both sides of infinity, as a share of the width.
const DISPARITY_MAX_SHARE: f64 = 0.45;
/// Score of a position outside the image.
pub const OUTSIDE: f32 = -1.0;

/// Luminance of an image; each sample is the mean of a square block of pixels.
pub struct Plane {
    pub width: usize,
    pub height: usize,
    samples: Vec<i16>,
}

impl Plane {
    /// The luminance in blocks of `factor` by `factor` pixels; an incomplete last column or row is dropped.
    pub fn of(image: ImageView<'_>, factor: usize) -> Self {
        let (full_width, full_height) = (image.width() as usize, image.height() as usize);
        let (width, height) = (full_width / factor, full_height / factor);
        let mut sums = vec![0_u32; width * height];
        let mut converted = Vec::new();
        for v in 0..height * factor {
            let row = image.row(v as u32, &mut converted);
            let line = &mut sums[v / factor * width..][..width];
            for (sum, block) in line.iter_mut().zip(row.chunks_exact(3 * factor)) {
                *sum += block.chunks_exact(3).map(luminance_256).sum::<u32>();
            }
        }
        let scale = SCALE / (256.0 * (factor * factor) as f64);
        let samples = sums.iter().map(|&sum| (f64::from(sum) * scale).round() as i16).collect();
        Self { width, height, samples }
    }

    /// Whether a window with this upper left corner is inside the plane.
    pub fn holds(&self, x: isize, y: isize) -> bool {
        x >= 0 && y >= 0 && x as usize + WINDOW <= self.width && y as usize + WINDOW <= self.height
    }

    pub fn at(&self, x: usize, y: usize) -> i32 {
        i32::from(self.samples[y * self.width + x])
    }

    fn row(&self, x: usize, y: usize) -> &[i16] {
        &self.samples[y * self.width + x..][..WINDOW]
    }

    /// The window at a corner, normalised; `None` if its contrast is too low.
    pub fn window(&self, x: usize, y: usize) -> Option<Window> {
        let moments = self.moments(x, y);
        if moments.inverse_length <= 0.0 {
            return None;
        }
        let mean = f64::from(moments.sum) / AREA as f64;
        let scale = LENGTH * f64::from(moments.inverse_length);
        let samples: [i16; AREA] = std::array::from_fn(|k| {
            ((f64::from(self.at(x + k % WINDOW, y + k / WINDOW)) - mean) * scale).round() as i16
        });
        Some(Window { samples, sum: samples.iter().map(|&sample| i32::from(sample)).sum() })
    }

    fn moments(&self, x: usize, y: usize) -> Moments {
        let (mut sum, mut squares) = (0_i32, 0_i32);
        for dy in 0..WINDOW {
            for &sample in self.row(x, y + dy) {
                sum += i32::from(sample);
                squares += i32::from(sample) * i32::from(sample);
            }
        }
        let variance = f64::from(squares) - f64::from(sum) * f64::from(sum) / AREA as f64;
        let least = (SCALE * DEVIATION_MIN).powi(2) * AREA as f64;
        let inverse_length = if variance < least { 0.0 } else { (1.0 / variance.sqrt()) as f32 };
        Moments { sum, inverse_length }
    }

    /// The moments of all windows, by corner; rows have the length of the plane's rows.
    pub fn all_moments(&self) -> Vec<Moments> {
        let mut all = vec![Moments::default(); self.width * self.height];
        for y in 0..(self.height + 1).saturating_sub(WINDOW) {
            for x in 0..(self.width + 1).saturating_sub(WINDOW) {
                all[y * self.width + x] = self.moments(x, y);
            }
        }
        all
    }

    /// Same as [`Self::correlation`], for a window whose moments are not precomputed; -1 outside the plane.
    pub fn correlation_at(&self, window: &Window, x: isize, y: isize) -> f32 {
        if !self.holds(x, y) {
            return OUTSIDE;
        }
        let (x, y) = (x as usize, y as usize);
        self.correlation(window, &self.moments(x, y), x, y)
    }

    /// Correlation of a normalised window with the window at a corner, -1 to 1; 0 if the contrast there is too low.
    pub fn correlation(&self, window: &Window, moments: &Moments, x: usize, y: usize) -> f32 {
        // Pairs of products in four lanes: compilers turn this form into one instruction per row.
        let mut lanes = [0_i32; WINDOW / 2];
        for (dy, line) in window.samples.chunks_exact(WINDOW).enumerate() {
            let row = self.row(x, y + dy);
            for (k, lane) in lanes.iter_mut().enumerate() {
                let product = |k: usize| i32::from(line[k]) * i32::from(row[k]);
                *lane += product(2 * k) + product(2 * k + 1);
            }
        }
        let product: i32 = lanes.iter().sum();
        let without_mean = product - window.sum * moments.sum / AREA as i32;
        without_mean as f32 * moments.inverse_length * (1.0 / LENGTH as f32)
    }
}

/// A window with its mean removed, scaled to a vector norm of 4096.
pub struct Window {
    samples: [i16; AREA],
    /// Remainder of the mean due to rounding, times 64.
    sum: i32,
}

/// Normalisation of a window.
#[derive(Clone, Copy, Default)]
pub struct Moments {
    sum: i32,
    /// 1 / norm of the window with its mean removed; 0 if the contrast is too low.
    inverse_length: f32,
}

/// A pair at the reduced size for the search, and at full size for sub-pixel refinement.
pub struct Images {
    factor: usize,
    /// The left image at the reduced size.
    pub left: Plane,
    /// The right image at the reduced size.
    pub right: Plane,
    right_moments: Vec<Moments>,
    full: Option<[Plane; 2]>,
}

/// The epipolar curve of a patch: positions of its centre with increasing inverse depth.
pub struct Curve {
    /// Positions of the centre, pixels of the right image; about one working sample apart.
    places_px: Vec<Vector2<f64>>,
    /// Index of the position of a point at infinity.
    infinity: usize,
}

impl Images {
    /// The pair with both images reduced by an integer factor.
    pub fn new(left: ImageView<'_>, right: ImageView<'_>, factor: usize) -> Self {
        let working_right = Plane::of(right, factor);
        let full = (factor > 1).then(|| [Plane::of(left, 1), Plane::of(right, 1)]);
        Self {
            factor,
            left: Plane::of(left, factor),
            right_moments: working_right.all_moments(),
            right: working_right,
            full,
        }
    }

    /// Full-size pixel of the centre of the window at a working corner; `corner` is the inverse.
    fn centre_px(&self, corner: f64) -> f64 {
        (corner + 0.5 * WINDOW as f64) * self.factor as f64 - 0.5
    }

    /// The epipolar curve of the window at a corner of the left plane, see [`Curve::of`].
    pub fn curve(&self, rig: &StereoRig, corner: [usize; 2]) -> Option<Curve> {
        let [x, y] = corner.map(|value| self.centre_px(value as f64));
        Curve::of(rig, &Vector2::new(x, y), self.left.width)
    }

    /// A distance in pixels as working samples, rounded up.
    pub fn samples(&self, distance_px: f64) -> isize {
        (distance_px / self.factor as f64).ceil() as isize
    }

    fn corner(&self, centre_px: f64) -> f64 {
        (centre_px + 0.5) / self.factor as f64 - 0.5 * WINDOW as f64
    }

    /// The working corners at a position of the curve, and up to `reach` samples above and below it.
    fn corners_at(&self, curve: &Curve, step: usize, reach: isize) -> impl Iterator<Item = [isize; 2]> {
        let place = curve.places_px[step].map(|px| self.corner(px));
        let across = curve.across(step);
        (-reach..=reach).map(move |offset| beside(&place, &across, offset))
    }

    /// Correlations at all positions of the curve and in the band around it; within a position, from one side to the other.
    pub fn scores(&self, window: &Window, curve: &Curve, reach: isize) -> Vec<f32> {
        let mut scores = Vec::with_capacity(curve.places_px.len() * (2 * reach + 1) as usize);
        for step in 0..curve.places_px.len() {
            for [x, y] in self.corners_at(curve, step, reach) {
                scores.push(if self.right.holds(x, y) {
                    let (x, y) = (x as usize, y as usize);
                    self.right.correlation(window, &self.right_moments[y * self.right.width + x], x, y)
                } else {
                    OUTSIDE
                });
            }
        }
        scores
    }

    /// Disparity and offset, see [`Curve::coordinates`], of the patch in the right image that corresponds to a working corner of
    /// the left image. The search starts at a position of the curve, `offset` samples beside it.
    pub fn refined(&self, left_corner: [isize; 2], (curve, step): (&Curve, usize), offset: isize) -> (f64, f64) {
        let place = curve.places_px[step].map(|px| self.corner(px));
        let right_corner = beside(&place, &curve.across(step), offset);
        curve.coordinates(step, &self.refined_px(left_corner, right_corner))
    }

    /// Sub-pixel centre at full size of the patch in the right image that corresponds to a working corner of the left image.
    /// The search starts at a working corner of the right image.
    fn refined_px(&self, left_corner: [isize; 2], right_corner: [isize; 2]) -> Vector2<f64> {
        let [left, right] = self.full.as_ref().map_or([&self.left, &self.right], |[left, right]| [left, right]);
        let windows = quadrants(left_corner, self.factor)
            .map(|[x, y]| left.holds(x, y).then(|| left.window(x as usize, y as usize)).flatten());
        let around = quadrants(right_corner, self.factor);
        let score = |dx: isize, dy: isize| -> f64 {
            let pairs = windows.iter().zip(around).filter_map(|(window, at)| Some((window.as_ref()?, at)));
            pairs.map(|(window, [x, y])| f64::from(right.correlation_at(window, x + dx, y + dy))).sum()
        };
        let reach = self.factor as isize;
        let (mut best, mut at) = (f64::NEG_INFINITY, [0, 0]);
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let here = score(dx, dy);
                if here > best {
                    (best, at) = (here, [dx, dy]);
                }
            }
        }
        let [dx, dy] = at;
        let between = Vector2::new(
            summit(score(dx - 1, dy), best, score(dx + 1, dy)),
            summit(score(dx, dy - 1), best, score(dx, dy + 1)),
        );
        let coarse = Vector2::new(self.centre_px(right_corner[0] as f64), self.centre_px(right_corner[1] as f64));
        coarse + Vector2::new(dx as f64, dy as f64) + between
    }
}

/// The working corner `offset` samples beside a position.
fn beside(place: &Vector2<f64>, across: &Vector2<f64>, offset: isize) -> [isize; 2] {
    let at = place + across * offset as f64;
    // Truncation is the cheapest rounding; the added constant keeps the value positive.
    [at.x, at.y].map(|value| (value + 65536.5) as isize - 65536)
}

/// Corners, at full size, of the four windows around the centre of the window at a working corner.
fn quadrants(corner: [isize; 2], factor: usize) -> [[isize; 2]; 4] {
    let [x, y] = corner.map(|value| value * factor as isize + (factor as isize - 2) * (WINDOW as isize / 2));
    let side = WINDOW as isize;
    [[x, y], [x + side, y], [x, y + side], [x + side, y + side]]
}

/// Position of the maximum, between -0.5 and 0.5, of the parabola through three values at -1, 0 and 1.
fn summit(before: f64, at: f64, after: f64) -> f64 {
    let bend = before - 2.0 * at + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

impl Curve {
    /// The curve of a left pixel, from behind the cameras through infinity to the nearest points. `None` if the pixel has no
    /// ray or the right camera does not face its direction.
    fn of(rig: &StereoRig, left_px: &Vector2<f64>, working_width: usize) -> Option<Self> {
        let right_from_left = rig.cam_right_from_cam_left();
        let ray = rig.left().unproject(left_px).ok()?;
        let far = right_from_left.transform_vector(&ray);
        let translation_m = right_from_left.translation_m();
        let width = f64::from(rig.right().size().width);
        let rho_max = DISPARITY_MAX_SHARE * width / (rig.right().pinhole().fx * translation_m.norm());
        let steps = (DISPARITY_MAX_SHARE * working_width as f64).ceil() as isize;
        // A point X = ray / rho projects like rho X, on both sides of rho = 0.
        let place = |step: isize| {
            let rho = rho_max * step as f64 / steps as f64;
            rig.right().project(&Point3::from(far + translation_m * rho))
        };
        let infinity_px = place(0)?;
        let mut places_px: Vec<_> = (-steps..0).rev().map_while(place).collect();
        let infinity = places_px.len();
        places_px.reverse();
        places_px.push(infinity_px);
        places_px.extend((1..=steps).map_while(place));
        (places_px.len() > 2).then_some(Self { places_px, infinity })
    }

    /// Unit direction of increasing inverse depth.
    fn along(&self, step: usize) -> Vector2<f64> {
        let [before, after] = [step.saturating_sub(1), (step + 1).min(self.places_px.len() - 1)];
        let direction = self.places_px[after] - self.places_px[before];
        direction.try_normalize(1e-9).unwrap_or(-Vector2::x())
    }

    /// Unit direction perpendicular to the curve, downwards.
    fn across(&self, step: usize) -> Vector2<f64> {
        let along = self.along(step);
        let across = Vector2::new(-along.y, along.x);
        if across.y < 0.0 { -across } else { across }
    }

    /// Disparity and offset of a pixel near a position of the curve.
    fn coordinates(&self, step: usize, pixel: &Vector2<f64>) -> (f64, f64) {
        let from_infinity_px = self.places_px[step] - self.places_px[self.infinity];
        let along_px = if step < self.infinity { -from_infinity_px.norm() } else { from_infinity_px.norm() };
        let beside = pixel - self.places_px[step];
        (along_px + beside.dot(&self.along(step)), beside.dot(&self.across(step)))
    }
}

/// Luminance times 256, with the weights of Rec. 601.
fn luminance_256(pixel: &[u8]) -> u32 {
    77 * u32::from(pixel[0]) + 150 * u32::from(pixel[1]) + 29 * u32::from(pixel[2])
}
