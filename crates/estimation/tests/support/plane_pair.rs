//! Ray-traced pairs of a textured plane: reference images for the direct method.
//!
//! Every pixel is a mean over rays, intersected with the planes of the scene. The texture is a periodic sum of waves on the
//! plane. Nothing here uses disparity or a homography.
#![allow(dead_code, reason = "not every test uses every part")]

use image::RgbImage;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_geometry::frames::{CamLeft, CamRight};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

pub const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const GRID: usize = 1024;
/// Millimetres after which a texture repeats.
const PERIOD_MM: f64 = 154.0;

/// Random numbers of a seed that the few poses of these tests depend on. A mean over so few poses leaves room for chance.
pub fn random(seed: u64) -> SplitMix64 {
    SplitMix64::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paint {
    /// Hues all around the circle.
    Colour,
    /// Orange with dark spots.
    Crab,
    /// Grey of strong contrast.
    Grey,
    /// Grey with a standard deviation of 3 grey levels.
    Faint,
    /// One colour.
    Plain,
    /// Sand: a background.
    Sand,
    /// Green and blue of one luminance.
    EqualLuminance,
}

/// Colours on a periodic grid.
pub struct Texture(Vec<[f32; 3]>);

impl Texture {
    pub fn new(paint: Paint, seed: u64) -> Self {
        let mut random = random(seed);
        let count = match paint {
            Paint::Plain => 0,
            Paint::Grey | Paint::Faint | Paint::EqualLuminance => 1,
            Paint::Sand => 2,
            Paint::Colour | Paint::Crab => 3,
        };
        let fields: Vec<Vec<f32>> = (0..count).map(|_| field(&mut random, 2.6, 25.0)).collect();
        let colour = |i: usize| {
            let f: [f32; 3] = std::array::from_fn(|k| fields.get(k).map_or(0.0, |field| field[i]));
            let rgb = match paint {
                Paint::Colour => hsv(0.5 + 0.35 * f[0], 0.65 + 0.1 * f[1], 0.62 + 0.1 * f[2]),
                Paint::Crab => {
                    let dark = 1.0 / (1.0 + (-4.0 * (f[2] - 1.0)).exp());
                    hsv(14.0 / 360.0 + 0.012 * f[0], 0.75 + 0.06 * f[1], (0.62 + 0.09 * f[1]) * (1.0 - 0.5 * dark))
                }
                Paint::Grey => [115.0 + 30.0 * f[0]; 3],
                Paint::Faint => [120.0 + 3.0 * f[0]; 3],
                Paint::Plain => [180.0, 70.0, 40.0],
                Paint::Sand => [170.0 + 14.0 * f[0], 150.0 + 14.0 * f[0] + 3.0 * f[1], 110.0 + 12.0 * f[0]],
                Paint::EqualLuminance => [90.0, 110.0 + 22.0 * f[0], 110.0 - 22.0 * f[0]],
            };
            rgb.map(|c| c.clamp(0.0, 255.0))
        };
        Self((0..GRID * GRID).map(colour).collect())
    }

    /// The colour at a place.
    pub fn at(&self, x_mm: f64, y_mm: f64) -> [f32; 3] {
        let place = |mm: f64| {
            let at = (mm / PERIOD_MM).rem_euclid(1.0) * GRID as f64;
            let cell = at as usize;
            ((cell % GRID), (cell + 1) % GRID, (at - cell as f64) as f32)
        };
        let ((x0, x1, a), (y0, y1, b)) = (place(x_mm), place(y_mm));
        let cell = |x: usize, y: usize| self.0[y * GRID + x];
        let (p, q, r, s) = (cell(x0, y0), cell(x1, y0), cell(x0, y1), cell(x1, y1));
        std::array::from_fn(|c| (p[c] * (1.0 - a) + q[c] * a) * (1.0 - b) + (r[c] * (1.0 - a) + s[c] * a) * b)
    }
}

/// A periodic sum of waves with wavelengths between two limits, with mean 0 and variance 1.
fn field(random: &mut SplitMix64, shortest_mm: f64, longest_mm: f64) -> Vec<f32> {
    const WAVES: usize = 32;
    let mut values = vec![0.0_f32; GRID * GRID];
    for _ in 0..WAVES {
        let wavelength = shortest_mm * (longest_mm / shortest_mm).powf(random.between(0.0, 1.0));
        let angle = random.between(0.0, std::f64::consts::TAU);
        let cycles = |part: f64| (PERIOD_MM / wavelength * part).round();
        let (kx, ky, phase) = (cycles(angle.cos()), cycles(angle.sin()), random.between(0.0, std::f64::consts::TAU));
        let wave = |k: f64, phase: f64| -> Vec<(f32, f32)> {
            let angle = |i: usize| k * std::f64::consts::TAU * i as f64 / GRID as f64 + phase;
            (0..GRID).map(|i| (angle(i).cos() as f32, angle(i).sin() as f32)).collect()
        };
        let (columns, rows) = (wave(kx, 0.0), wave(ky, phase));
        for (row, line) in rows.iter().zip(values.chunks_exact_mut(GRID)) {
            for (column, value) in columns.iter().zip(line) {
                *value += column.0 * row.0 - column.1 * row.1;
            }
        }
    }
    let scale = (2.0 / WAVES as f32).sqrt();
    values.iter_mut().for_each(|value| *value *= scale);
    values
}

fn hsv(hue: f32, saturation: f32, value: f32) -> [f32; 3] {
    let (s, v) = (saturation.clamp(0.0, 1.0), value.clamp(0.0, 1.0));
    [5.0_f32, 3.0, 1.0].map(|n| {
        let k = (n + hue.rem_euclid(1.0) * 6.0) % 6.0;
        255.0 * (v - v * s * k.min(4.0 - k).clamp(0.0, 1.0))
    })
}

/// A plane in the left camera, metres; texture axes are in the plane.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    pub point: Vector3<f64>,
    /// Away from the cameras.
    pub normal: Vector3<f64>,
}

impl Plane {
    pub fn new(point: Vector3<f64>, tilt_x_rad: f64, tilt_y_rad: f64) -> Self {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt_y_rad)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt_x_rad);
        Self { point, normal: turn * Vector3::z() }
    }

    /// What the rays from one place have in common.
    pub fn from(&self, origin: &Vector3<f64>) -> RenderedPlane {
        let x_axis = (Vector3::x() - self.normal * self.normal.x).normalize();
        let axes = [self.normal, x_axis, self.normal.cross(&x_axis)];
        RenderedPlane { axes, place: axes.map(|axis| axis.dot(&(self.point - origin))) }
    }
}

/// A plane from one place: its normal and its two axes, and how far along them its point lies from there, metres.
#[derive(Clone, Copy, Debug)]
pub struct RenderedPlane {
    axes: [Vector3<f64>; 3],
    place: [f64; 3],
}

impl RenderedPlane {
    /// Where a ray meets the plane: coordinates in it, millimetres.
    pub fn cut(&self, ray: &Vector3<f64>) -> (f64, f64) {
        let [along, x, y] = self.axes.map(|axis| axis.dot(ray));
        let t = self.place[0] / along;
        (1e3 * (t * x - self.place[1]), 1e3 * (t * y - self.place[2]))
    }
}

/// The parameters that tests vary.
#[derive(Clone, Debug)]
pub struct Setup {
    pub baseline_m: f64,
    pub z_m: f64,
    pub tilt_x_rad: f64,
    pub tilt_y_rad: f64,
    pub centre_px: Vector2<f64>,
    pub noise_sigma: f64,
    pub gain: [f64; 3],
    pub bias: [f64; 3],
    /// Standard deviation of the right camera's additional blur, pixels.
    pub right_blur_px: f64,
    /// Vertical offset of the right image, pixels; positive is lower.
    pub row_offset_px: f64,
    /// Background behind the target, metres.
    pub background_m: f64,
    /// Share of the target's width that a nearer plane occludes.
    pub occluded: f64,
    /// Radius of the target, metres.
    pub radius_m: f64,
    /// The region is a box around the target instead of its outline.
    pub boxed: bool,
    pub seed: u64,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            baseline_m: 0.1,
            z_m: 0.5,
            tilt_x_rad: 0.0,
            tilt_y_rad: 0.0,
            centre_px: Vector2::new(330.0, 230.0),
            noise_sigma: 3.0,
            gain: [1.06, 0.98, 0.93],
            bias: [3.0, 0.0, -2.0],
            right_blur_px: 0.0,
            row_offset_px: 0.0,
            background_m: 0.03,
            occluded: 0.0,
            radius_m: 0.045,
            boxed: false,
            seed: 1,
        }
    }
}

/// A rendered pair with its ground truth.
pub struct Pair {
    pub rig: StereoRig,
    pub left: RgbImage,
    pub right: RgbImage,
    /// Left image without noise and rounding, RGB.
    pub clean_left: Vec<[f32; 3]>,
    pub plane: Plane,
    /// Pixels of the left image that show the target.
    pub target: Vec<bool>,
    /// The region that the operator would mark.
    pub region: Vec<bool>,
    pub setup: Setup,
}

pub fn rig(baseline_m: f64) -> StereoRig {
    let camera = |cx| Camera::new(SIZE, Pinhole { fx: 740.0, fy: 740.0, cx, cy: 238.0 }, Distortion::None).unwrap();
    let pose: Pose<CamRight, CamLeft> =
        Pose::from_parts(Vector3::new(-baseline_m, 0.0, 0.0), UnitQuaternion::identity());
    StereoRig::new(camera(322.0), camera(315.0), pose).unwrap()
}

/// Within a lobed outline.
fn outline(setup: &Setup, x_mm: f64, y_mm: f64) -> bool {
    let distance = (x_mm * x_mm + y_mm * y_mm).sqrt() / (1e3 * setup.radius_m);
    if !(0.82..1.18).contains(&distance) {
        return distance < 1.0;
    }
    let angle = y_mm.atan2(x_mm);
    let radius = 1.0 + 0.12 * (5.0 * angle + 0.4).sin() + 0.06 * (2.0 * angle).cos();
    distance < radius
}

pub fn render(setup: &Setup, target: &Texture, background: &Texture) -> Pair {
    let rig = rig(setup.baseline_m);
    let ray_of = |camera: &Camera, at: &Vector2<f64>| {
        let p = camera.pinhole();
        Vector3::new((at.x - p.cx) / p.fx, (at.y - p.cy) / p.fy, 1.0)
    };
    let centre_ray = ray_of(rig.left(), &setup.centre_px);
    let plane = Plane::new(centre_ray * setup.z_m, setup.tilt_x_rad, setup.tilt_y_rad);
    let behind = Plane::new(centre_ray * (setup.z_m + setup.background_m), 0.0, 0.0);
    let before = Plane::new(centre_ray * (setup.z_m - 0.06), 0.05, -0.1);
    let shade = |[plane, behind, before]: &[RenderedPlane; 3], ray: &Vector3<f64>| -> ([f32; 3], bool, bool) {
        let (x, y) = plane.cut(ray);
        let on_target = outline(setup, x, y);
        if setup.occluded > 0.0 {
            let (u, v) = before.cut(ray);
            let edge = 1e3 * setup.radius_m * (1.0 - 2.0 * setup.occluded);
            if u + 0.2 * v > edge {
                return (background.at(v + 31.0, 1.7 * u), on_target, true);
            }
        }
        if on_target {
            (target.at(x, y), true, false)
        } else {
            let (x, y) = behind.cut(ray);
            (background.at(x, y), false, false)
        }
    };
    let (pinhole, z) = (*rig.left().pinhole(), setup.z_m);
    let reach = (1.6 * setup.radius_m * pinhole.fx / z) as i32 + 16;
    let draw = |camera: &Camera, origin: Vector3<f64>, centre: Vector2<f64>, row: f64| {
        let planes = [plane, behind, before].map(|plane| plane.from(&origin));
        let mut rgb = vec![[60.0_f32; 3]; (SIZE.width * SIZE.height) as usize];
        let (mut target, mut hidden) = (vec![false; rgb.len()], vec![false; rgb.len()]);
        for v in (centre.y as i32 - reach).max(0)..(centre.y as i32 + reach).min(SIZE.height as i32) {
            for u in (centre.x as i32 - reach).max(0)..(centre.x as i32 + reach).min(SIZE.width as i32) {
                let mut sum = [0.0_f32; 3];
                let mut on_target = 0;
                for (a, b) in [-0.33, 0.0, 0.33].iter().flat_map(|a| [-0.33, 0.0, 0.33].map(|b| (*a, b))) {
                    let at = Vector2::new(f64::from(u) + a, f64::from(v) + b - row);
                    let (colour, on, cover) = shade(&planes, &ray_of(camera, &at));
                    (0..3).for_each(|c| sum[c] += colour[c] / 9.0);
                    on_target += usize::from(on);
                    hidden[(v as u32 * SIZE.width + u as u32) as usize] |= cover;
                }
                let i = (v as u32 * SIZE.width + u as u32) as usize;
                (rgb[i], target[i]) = (sum, on_target >= 5);
            }
        }
        (rgb, target, hidden)
    };
    let disparity = pinhole.fx * setup.baseline_m / z + 7.0;
    let (clean_left, target_mask, hidden) = draw(rig.left(), Vector3::zeros(), setup.centre_px, 0.0);
    let right_centre = setup.centre_px - Vector2::new(disparity, 0.0);
    let right = draw(rig.right(), Vector3::new(setup.baseline_m, 0.0, 0.0), right_centre, setup.row_offset_px).0;
    let lens = |image: &[[f32; 3]], centre: Vector2<f64>, extra: f64| {
        blurred(image, (0.6_f64.powi(2) + extra * extra).sqrt(), centre, reach)
    };
    let clean_left = lens(&clean_left, setup.centre_px, 0.0);
    let mut random = random(setup.seed ^ 0x5EED);
    let (noise, right) = (setup.noise_sigma, lens(&right, right_centre, setup.right_blur_px));
    let left = develop(&clean_left, [1.0; 3], [0.0; 3], noise, &mut random);
    let right = develop(&right, setup.gain, setup.bias, noise, &mut random);
    let region = if setup.boxed { boxed(&target_mask) } else { target_mask.clone() };
    let target = target_mask.iter().zip(&hidden).map(|(on, hidden)| *on && !hidden).collect();
    Pair { rig, left, right, clean_left, plane, target, region, setup: setup.clone() }
}

/// Sensor model: gain, bias, noise and rounding of an image.
fn develop(image: &[[f32; 3]], gain: [f64; 3], bias: [f64; 3], noise: f64, random: &mut SplitMix64) -> RgbImage {
    let mut raw = Vec::with_capacity(image.len() * 3);
    for rgb in image {
        for c in 0..3 {
            let value = f64::from(rgb[c]) * gain[c] + bias[c] + noise * random.normal();
            raw.push(value.round().clamp(0.0, 255.0) as u8);
        }
    }
    RgbImage::from_raw(SIZE.width, SIZE.height, raw).unwrap()
}

fn boxed(mask: &[bool]) -> Vec<bool> {
    let at = |i: usize| (i % SIZE.width as usize, i / SIZE.width as usize);
    let inside: Vec<_> = (0..mask.len()).filter(|&i| mask[i]).map(at).collect();
    let (x0, x1) = (inside.iter().map(|p| p.0).min().unwrap(), inside.iter().map(|p| p.0).max().unwrap());
    let (y0, y1) = (inside.iter().map(|p| p.1).min().unwrap(), inside.iter().map(|p| p.1).max().unwrap());
    (0..mask.len()).map(|i| (x0..=x1).contains(&at(i).0) && (y0..=y1).contains(&at(i).1)).collect()
}

/// Blurs a square around a pixel; the rest has one colour.
fn blurred(image: &[[f32; 3]], sigma_px: f64, centre: Vector2<f64>, reach: i32) -> Vec<[f32; 3]> {
    let radius = (3.0 * sigma_px).ceil() as i32;
    let weights: Vec<f32> =
        (-radius..=radius).map(|i| (-0.5 * (f64::from(i) / sigma_px).powi(2)).exp() as f32).collect();
    let sum: f32 = weights.iter().sum();
    let (width, height) = (SIZE.width as i32, SIZE.height as i32);
    let (x0, y0) = ((centre.x as i32 - reach - 8).max(0), (centre.y as i32 - reach - 8).max(0));
    let (x1, y1) = ((centre.x as i32 + reach + 8).min(width), (centre.y as i32 + reach + 8).min(height));
    let pass = |source: &[[f32; 3]], step: (i32, i32)| -> Vec<[f32; 3]> {
        let mut blurred = source.to_vec();
        for (y, x) in (y0..y1).flat_map(|y| (x0..x1).map(move |x| (y, x))) {
            let mut out = [0.0_f32; 3];
            for (j, weight) in weights.iter().enumerate() {
                let by = j as i32 - radius;
                let (u, v) = ((x + by * step.0).clamp(0, width - 1), (y + by * step.1).clamp(0, height - 1));
                let rgb = source[(v * width + u) as usize];
                (0..3).for_each(|c| out[c] += weight / sum * rgb[c]);
            }
            blurred[(y * width + x) as usize] = out;
        }
        blurred
    };
    pass(&pass(image, (1, 0)), (0, 1))
}
