//! Periods of a target's texture: displacements in the plane of the model after which the first image looks like the target again.
//!
//! The autocorrelation of the region is sought on every level of the pyramid, over shifts of up to 24 pixels of the level. A shift counts
//! if the autocorrelation has a maximum there and has fallen in between: a smooth texture, and a shift along stripes, have no period.

use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Pose};

use super::images::{CameraImages, LEVELS, texel_at};
use super::kernels::Correlation;

/// Largest number of periods. A lattice has two shortest ones, their sum and their difference.
const PERIODS_MAX: usize = 4;
/// Largest shift on a level, pixels of the level. Chosen: with half, periods between two levels are at the border of both; with twice,
/// the search takes four times as long.
const SHIFT_MAX: i32 = 24;
/// Smallest shift on a level, pixels of the level: a period of fewer is not resolved there.
const SHIFT_MIN: f64 = 3.5;
/// Number of pixels that are compared. By chance half of 192 pixels correlate by 0.1; the largest of 5000 such values is 0.4.
const SAMPLES: usize = 192;
/// Smallest correlation with whole pixels. Chosen: a period that is half a pixel off, at five pixels, still reaches 0.6.
const ROUGHLY_ALIKE: f32 = 0.45;
/// Smallest correlation at the exact shift. Chosen: with 0.75, the diagonal of a small board with a white border is missed (0.60 to 0.63);
/// with less, textures that merely resemble waves are compared needlessly.
const ALIKE: f64 = 0.58;
/// Between a target and its copy the correlation falls below this share. Chosen: chessboards fall to 0, grids of dots to about 0.3.
const VALLEY: f32 = 0.6;
/// Smallest share of the pixels whose copies lie inside the region, or anywhere in the image. Chosen: with less, a corner of the region
/// decides.
const INSIDE_MIN: f32 = 0.5;
const IN_IMAGE_MIN: f32 = 0.7;
/// A shift is a multiple of another one, or the same, if it differs by less than this share.
const SAME: f64 = 0.2;

/// A pixel of the region.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Its point in `cam_left`, metres.
    in_cam: Vector3<f64>,
    /// Pixel minus its pinhole projection: the distortion there.
    distortion_px: Vector2<f64>,
    pixel: [f32; 2],
}

/// Input of the search.
pub(super) struct PeriodSearch<'a> {
    /// The whole first left image.
    pub(super) left: &'a CameraImages,
    /// Pixels of the target.
    pub(super) region: &'a RegionMask,
    pub(super) camera: &'a Camera,
    pub(super) cam_left_from_model: &'a Pose<CamLeft, Model>,
}

/// The shortest periods, metres along x and y of `model`, without their opposites and multiples.
pub(super) fn find(search: &PeriodSearch<'_>) -> Vec<Vector2<f64>> {
    let samples = search.samples();
    let mut found = Vec::new();
    let (Some(bounds), false) = (search.region.bbox(), samples.len() < SAMPLES / 2) else { return found };
    let extent_px = f64::from(bounds.width).hypot(f64::from(bounds.height));
    for level in 0..LEVELS {
        let side_px = f64::from(1_u32 << level);
        if extent_px < SHIFT_MIN * side_px {
            break;
        }
        for rough in search.maxima(&samples, level, extent_px / side_px) {
            if found.len() >= PERIODS_MAX {
                return found;
            }
            if is_new(&found, &rough) {
                let (shift, value) = search.refined(&samples, level, rough);
                if value >= ALIKE && is_new(&found, &shift) && !search.is_along(&samples, level, &found, &shift) {
                    found.push(shift);
                }
            }
        }
    }
    found
}

/// Whether a shift is no multiple of one that is known.
fn is_new(found: &[Vector2<f64>], shift: &Vector2<f64>) -> bool {
    found.iter().all(|known| {
        let times = (shift.dot(known) / known.norm_squared()).round();
        times == 0.0 || (shift - known * times).norm() > SAME * known.norm()
    })
}

impl PeriodSearch<'_> {
    /// Whether a shift differs from a known period, or its multiple, by a shift along stripes only.
    fn is_along(&self, samples: &[Sample], level: usize, found: &[Vector2<f64>], shift: &Vector2<f64>) -> bool {
        let is_alike_all_along = |beside: Vector2<f64>| {
            // A part that leads out of the image tells nothing.
            let alike =
                |part: f64| self.comparable(samples, level, &(beside * part)).is_none_or(|value| value >= ALIKE);
            [0.25, 0.5, 0.75, 1.0].into_iter().all(alike)
        };
        found.iter().any(|known| {
            // The known period may itself contain a shift along the stripes, so the nearest multiple may be a neighbouring one.
            let times = (shift.dot(known) / known.norm_squared()).round();
            [-1.0, 0.0, 1.0].into_iter().any(|more| is_alike_all_along(shift - known * (times + more)))
        })
    }

    /// Pixels spread over the region.
    fn samples(&self) -> Vec<Sample> {
        let mut pixels = Vec::new();
        self.region.for_each(|x, y| pixels.push([x, y]));
        let pinhole = self.camera.pinhole();
        let model_from_cam = self.cam_left_from_model.inverse();
        let origin = model_from_cam.transform_point(&Point3::origin());
        let sample = |index: usize| {
            let [x, y] = pixels[index].map(f64::from);
            let ray = self.camera.unproject(&Vector2::new(x, y)).ok()?;
            let direction = model_from_cam.transform_vector(&ray);
            let along = -origin.z / direction.z;
            let in_cam = ray * along;
            let projected = Vector2::new(
                pinhole.fx * in_cam.x / in_cam.z + pinhole.cx,
                pinhole.fy * in_cam.y / in_cam.z + pinhole.cy,
            );
            let distortion_px = Vector2::new(x, y) - projected;
            (along > 0.0).then_some(Sample { in_cam, distortion_px, pixel: [x as f32, y as f32] })
        };
        // Fractions of the golden ratio: without them, pixels of some regions would lie in one column.
        let spread = |k: usize| (k as f64 + (k as f64 * 0.618_034).fract()) / SAMPLES as f64;
        let index = |k: usize| ((spread(k) * pixels.len() as f64) as usize).min(pixels.len().saturating_sub(1));
        if pixels.is_empty() { Vec::new() } else { (0..SAMPLES).map(index).filter_map(sample).collect() }
    }

    /// Metres in the plane per pixel of the left image.
    fn metres_per_px(&self) -> f64 {
        self.cam_left_from_model.translation_m().z / self.camera.pinhole().fx
    }

    /// Local maxima of the autocorrelation on a level, shortest first, metres.
    fn maxima(&self, samples: &[Sample], level: usize, extent: f64) -> Vec<Vector2<f64>> {
        let step_m = self.metres_per_px() * f64::from(1_u32 << level);
        let most = SHIFT_MAX.min(extent.ceil() as i32);
        let (width, height) = ((2 * most + 1) as usize, (most + 1) as usize);
        let own: Vec<f32> = samples
            .iter()
            .map(|sample| texel_at(self.left, level, sample.pixel).map_or(f32::NAN, |texel| texel[0]))
            .collect();
        let mut values = vec![0.0_f32; width * height];
        for (index, value) in values.iter_mut().enumerate() {
            let at = Vector2::new(f64::from((index % width) as i32 - most), (index / width) as f64);
            *value = self.rough(samples, &own, level, &(at * step_m));
        }
        // A shift and its opposite show nearly the same.
        let value = |x: i32, y: i32| {
            let (x, y) = if y < 0 { (-x, -y) } else { (x, y) };
            let inside = x.abs() <= most && y <= most;
            if inside { values[y as usize * width + (x + most) as usize] } else { -1.0 }
        };
        let is_maximum = |x: i32, y: i32| {
            let own = value(x, y);
            own >= ROUGHLY_ALIKE
                && (-1..=1).all(|dy| (-1..=1).all(|dx| value(x + dx, y + dy) <= own))
                && (1..16).any(|k| {
                    let part = |whole: i32| (f64::from(whole * k) / 16.0).round() as i32;
                    value(part(x), part(y)) < VALLEY * own
                })
        };
        let half_plane = (0..most).flat_map(|y| (1 - most..most).map(move |x| (x, y)));
        let mut maxima: Vec<(i32, i32)> = half_plane
            .filter(|&(x, y)| y > 0 || x > 0)
            .filter(|&(x, y)| (SHIFT_MIN..=extent).contains(&f64::from(x).hypot(f64::from(y))))
            .filter(|&(x, y)| is_maximum(x, y))
            .collect();
        maxima.sort_by_key(|&(x, y)| x * x + y * y);
        maxima.into_iter().map(|(x, y)| Vector2::new(f64::from(x), f64::from(y)) * step_m).collect()
    }

    /// Raw pixel of a sample after a shift in the plane of the model.
    fn shifted_px(&self, sample: &Sample, by: &Vector3<f64>) -> [f64; 2] {
        let (at, pinhole) = (sample.in_cam + by, self.camera.pinhole());
        let inverse = 1.0 / at.z.max(1e-3);
        [
            pinhole.fx * at.x * inverse + pinhole.cx + sample.distortion_px.x,
            pinhole.fy * at.y * inverse + pinhole.cy + sample.distortion_px.y,
        ]
    }

    fn in_cam(&self, shift: &Vector2<f64>) -> Vector3<f64> {
        self.cam_left_from_model.transform_vector(&Vector3::new(shift.x, shift.y, 0.0))
    }

    /// Correlation of the samples' brightness with whole pixels after a shift.
    fn rough(&self, samples: &[Sample], own: &[f32], level: usize, shift: &Vector2<f64>) -> f32 {
        let by = self.in_cam(shift);
        let factor = 1.0 / f64::from(1_u32 << level);
        let (width, height) = self.left.size(level);
        let (width, height) = (width as i32, height as i32);
        let mut parts = [Brightness::default(); 2];
        for (sample, own) in samples.iter().zip(own).filter(|(_, own)| own.is_finite()) {
            let px = self.shifted_px(sample, &by);
            let inside = self.region.contains(nearest_px(px[0]), nearest_px(px[1]));
            // Rounded: (px - origin + 0.5) / side - 0.5.
            let x = floor_px((px[0] - f64::from(self.left.window.x) + 0.5) * factor);
            let y = floor_px((px[1] - f64::from(self.left.window.y) + 0.5) * factor);
            if (0..width).contains(&x) && (0..height).contains(&y) {
                let other = self.left.texel(level, x as usize, y as usize)[0];
                parts[usize::from(inside)].add(*own, other);
            }
        }
        let all = parts[0].plus(&parts[1]);
        let count = samples.len() as f32;
        let inside = if parts[1].count >= INSIDE_MIN * count { parts[1].correlation() } else { 0.0 };
        let anywhere = if all.count >= IN_IMAGE_MIN * count { all.correlation() } else { 0.0 };
        inside.max(anywhere)
    }

    /// The exact shift near a maximum, and the correlation there.
    fn refined(&self, samples: &[Sample], level: usize, rough: Vector2<f64>) -> (Vector2<f64>, f64) {
        let step_m = self.metres_per_px() * f64::from(1_u32 << level);
        let mut best = (rough, self.exact(samples, level, &rough));
        for halvings in 1..=3 {
            let step = step_m / f64::from(1 << halvings);
            for _ in 0..3 {
                let sides = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
                let tried = sides.map(|(x, y)| best.0 + Vector2::new(x, y) * step);
                let before = best.1;
                for shift in tried {
                    let value = self.exact(samples, level, &shift);
                    if value > best.1 {
                        best = (shift, value);
                    }
                }
                if best.1 <= before {
                    break;
                }
            }
        }
        best
    }

    /// As [`Self::rough`], between pixels and with all channels; 0 if too few pixels can be compared.
    fn exact(&self, samples: &[Sample], level: usize, shift: &Vector2<f64>) -> f64 {
        self.comparable(samples, level, shift).unwrap_or(0.0)
    }

    /// The same; `None` if too few pixels can be compared.
    fn comparable(&self, samples: &[Sample], level: usize, shift: &Vector2<f64>) -> Option<f64> {
        let by = self.in_cam(shift);
        let (mut inside, mut all) = (Correlation::default(), Correlation::default());
        for sample in samples {
            let px = self.shifted_px(sample, &by);
            let pair = (texel_at(self.left, level, sample.pixel), texel_at(self.left, level, px.map(|x| x as f32)));
            let (Some([a0, a1, a2, _]), Some([b0, b1, b2, _])) = pair else { continue };
            all.add(1.0, [a0, a1, a2], [b0, b1, b2]);
            if self.region.contains(nearest_px(px[0]), nearest_px(px[1])) {
                inside.add(1.0, [a0, a1, a2], [b0, b1, b2]);
            }
        }
        let enough = |sums: &Correlation, share: f32| {
            (sums.count() >= f64::from(share) * samples.len() as f64).then(|| sums.value())
        };
        let (inside, all) = (enough(&inside, INSIDE_MIN), enough(&all, IN_IMAGE_MIN));
        inside.zip(all).map(|(inside, all)| inside.max(all)).or(inside).or(all)
    }
}

/// The largest whole number at most `px`; far outside of any image it stays far outside. `f64::floor` is a call of a library on processors
/// without SSE4.1, for which the program is compiled.
fn floor_px(px: f64) -> i32 {
    const FAR: i32 = 1 << 20;
    ((px + f64::from(FAR)) as i32).saturating_sub(FAR)
}

fn nearest_px(px: f64) -> i32 {
    floor_px(px + 0.5)
}

/// Sums for a correlation of brightness.
#[derive(Clone, Copy, Debug, Default)]
struct Brightness {
    count: f32,
    a: f32,
    b: f32,
    aa: f32,
    bb: f32,
    ab: f32,
}

impl Brightness {
    fn add(&mut self, a: f32, b: f32) {
        // Near the mean grey, sums of squares lose no digits.
        let (a, b) = (a - 128.0, b - 128.0);
        self.count += 1.0;
        self.a += a;
        self.b += b;
        self.aa += a * a;
        self.bb += b * b;
        self.ab += a * b;
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            a: self.a + other.a,
            b: self.b + other.b,
            aa: self.aa + other.aa,
            bb: self.bb + other.bb,
            ab: self.ab + other.ab,
        }
    }

    /// 0 if one of both hardly varies (a standard deviation of a grey level).
    fn correlation(&self) -> f32 {
        let n = self.count.max(1.0);
        let (aa, bb) = (self.aa / n - self.a * self.a / (n * n), self.bb / n - self.b * self.b / (n * n));
        let ab = self.ab / n - self.a * self.b / (n * n);
        if aa > 1.0 && bb > 1.0 { ab / (aa * bb).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use pb3dp_estimation_core::cpu::Kernels;
    use pb3dp_estimation_views::image_plane::PixelWindow;
    use pb3dp_geometry::{Distortion, ImageSize, Pinhole};

    use super::*;

    const SIZE: ImageSize = ImageSize { width: 320, height: 240 };

    /// Periods in pixels of a painted plane that faces the camera, in a region of 160 x 120 pixels.
    fn periods_px(paint: impl Fn(f64, f64) -> f64) -> Vec<[f64; 2]> {
        let pinhole = Pinhole { fx: 400.0, fy: 400.0, cx: 160.0, cy: 120.0 };
        let camera = Camera::new(SIZE, pinhole, Distortion::None).unwrap();
        let image =
            RgbImage::from_fn(SIZE.width, SIZE.height, |x, y| Rgb([paint(f64::from(x), f64::from(y)) as u8; 3]));
        let mut left = CameraImages::default();
        left.update((&image).into(), PixelWindow { x: 0, y: 0, width: 320, height: 240 }, Kernels::best());
        let region = RegionMask::from_fn(SIZE, |x, y| (80..240).contains(&x) && (60..180).contains(&y));
        let pose = Pose::from_translation(Vector3::new(0.0, 0.0, 0.5));
        let search = PeriodSearch { left: &left, region: &region, camera: &camera, cam_left_from_model: &pose };
        find(&search).iter().map(|shift| [shift.x * 800.0, shift.y * 800.0]).collect()
    }

    fn wave(at: f64, period: f64) -> f64 {
        (std::f64::consts::TAU * at / period).sin()
    }

    /// Whether a period was found, or its opposite, to half a pixel.
    fn has(found: &[[f64; 2]], period: [f64; 2]) -> bool {
        let near = |a: &[f64; 2], sign: f64| (a[0] - sign * period[0]).hypot(a[1] - sign * period[1]) < 0.5;
        found.iter().any(|found| near(found, 1.0) || near(found, -1.0))
    }

    #[test]
    fn a_pixel_is_rounded_down_on_both_sides_of_the_border() {
        let rounded = [-1.0, -0.75, -0.0, 0.5, 1.0, 639.999].map(floor_px);
        assert_eq!(rounded, [-1, -1, 0, 0, 1, 639]);
        assert_eq!([-0.6, -0.4, 0.4, 0.6].map(nearest_px), [-1, 0, 0, 1]);
        for far in [-1e300, -3e6, f64::NAN] {
            assert!(floor_px(far) <= -(1 << 20), "{far}");
        }
        assert!(floor_px(1e300) > 1 << 20);
    }

    #[test]
    fn a_lattice_has_its_two_shortest_periods() {
        for side in [3.0, 7.5, 13.0, 31.0] {
            let square = |x: f64, y: f64| ((x / side).floor() + (y / side).floor()).rem_euclid(2.0);
            let board = periods_px(|x, y| 60.0 + 140.0 * square(x, y));
            assert!(has(&board, [side, side]) && has(&board, [side, -side]), "{side}: {board:?}");
        }
        let grid = periods_px(|x, y| 128.0 + 40.0 * wave(x, 20.0) + 40.0 * wave(y, 12.0));
        assert!(has(&grid, [20.0, 0.0]) && has(&grid, [0.0, 12.0]), "{grid:?}");
    }

    #[test]
    fn stripes_have_a_period_across_and_none_along() {
        let found = periods_px(|x, _| 128.0 + 60.0 * wave(x, 18.0));
        assert!(found.len() == 1 && (found[0][0].abs() - 18.0).abs() < 0.5, "{found:?}");
    }

    #[test]
    fn a_texture_a_ramp_and_a_blank_plane_have_none() {
        let hash = |x: f64, y: f64| ((x * 12.9898 + y * 78.233).sin() * 43758.5453).fract().abs();
        for side in [2.0, 5.0, 11.0, 23.0] {
            let found = periods_px(|x, y| 60.0 + 140.0 * hash((x / side).floor(), (y / side).floor()));
            assert_eq!(found, Vec::<[f64; 2]>::new(), "{side}");
        }
        assert!(periods_px(|x, y| 0.4 * x + 0.3 * y).is_empty());
        assert!(periods_px(|_, _| 90.0).is_empty());
        assert!(
            periods_px(|x, y| 128.0 + 60.0 * (-((x - 160.0).powi(2) + (y - 120.0).powi(2)) / 900.0).exp()).is_empty()
        );
    }
}
