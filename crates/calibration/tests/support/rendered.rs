//! Rendered images of a chessboard whose edges lie where they should: adaptive samples, a Gaussian lens blur, image noise.
//!
//! A pixel whose four corners have the same grey level is uniform; every other pixel is the mean of 8 x 8 samples. The position of
//! an edge is then exact to about 0.002 px; with 3 x 3 samples it is exact to 0.02 px only.

use image::{GrayImage, Luma};
use nalgebra::{Isometry3, Vector2, Vector3};
use pb3dp_calibration::board::{BoardCorner, Chessboard};
use pb3dp_geometry::Camera;

use crate::support::Random;

/// Samples per pixel along each side, where the grey level is not uniform.
const SAMPLES: u32 = 8;
/// Grey levels of the board: dark and bright squares; then the wall.
pub const GREYS: [f64; 2] = [35.0, 225.0];
const WALL_GREY: f64 = 120.0;

/// Blur and noise of an image.
#[derive(Clone, Copy, Debug)]
pub struct Imaging {
    /// Standard deviation of the Gaussian blur of the lens, px; the area of a pixel adds to it.
    pub blur_px: f64,
    /// Standard deviation of the image noise, grey levels.
    pub noise_grey: f64,
    /// Contrast as a share of the full one.
    pub contrast: f64,
}

/// A camera with the rays of the corners of its pixels.
pub struct Renderer {
    camera: Camera,
    rays: Vec<Vector3<f64>>,
}

impl Renderer {
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.size().width, camera.size().height);
        let mut rays = Vec::with_capacity(((width + 1) * (height + 1)) as usize);
        for (y, x) in (0..=height).flat_map(|y| (0..=width).map(move |x| (y, x))) {
            let ray = camera.unproject(&Vector2::new(f64::from(x) - 0.5, f64::from(y) - 0.5));
            rays.push(ray.map_or_else(|_| Vector3::z(), |ray| ray / ray.z));
        }
        Self { camera: *camera, rays }
    }

    /// The light on each pixel, without blur and noise, row by row.
    pub fn light(&self, cam_from_board: &Isometry3<f64>, board: &Chessboard) -> Vec<f64> {
        let (width, height) = (self.camera.size().width, self.camera.size().height);
        let board_from_cam = cam_from_board.inverse();
        let origin = board_from_cam.translation.vector / board.square_m();
        let turn = board_from_cam.rotation.to_rotation_matrix();
        let grey_of = |ray: &Vector3<f64>| {
            let way = turn * ray;
            let at = origin - way * (origin.z / way.z);
            grey(at.x, at.y, board)
        };
        let at_corners: Vec<f64> = self.rays.iter().map(grey_of).collect();
        let mut light = Vec::with_capacity((width * height) as usize);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let first = (y * (width + 1) + x) as usize;
            let corners = [first, first + 1, first + width as usize + 1, first + width as usize + 2];
            let greys = corners.map(|index| at_corners[index]);
            if greys.iter().all(|grey| *grey == greys[0]) {
                light.push(greys[0]);
                continue;
            }
            let [a, b, c, d] = corners.map(|index| self.rays[index]);
            let share = |n: u32| (f64::from(n) + 0.5) / f64::from(SAMPLES);
            let samples = (0..SAMPLES).flat_map(|v| (0..SAMPLES).map(move |u| (share(u), share(v))));
            let sum: f64 = samples.map(|(u, v)| grey_of(&(a.lerp(&b, u).lerp(&c.lerp(&d, u), v)))).sum();
            light.push(sum / f64::from(SAMPLES * SAMPLES));
        }
        light
    }

    /// The image of this light.
    pub fn image(&self, light: &[f64], imaging: Imaging, random: &mut Random) -> GrayImage {
        let (width, height) = (self.camera.size().width as usize, self.camera.size().height as usize);
        let blurred = blurred(light, width, height, imaging.blur_px);
        GrayImage::from_fn(width as u32, height as u32, |x, y| {
            let light = WALL_GREY + imaging.contrast * (blurred[y as usize * width + x as usize] - WALL_GREY);
            Luma([(light + imaging.noise_grey * random.normal()).round().clamp(0.0, 255.0) as u8])
        })
    }

    /// A corner of the board in the image, and the directions of the edges that meet there, along its row and its column.
    #[allow(dead_code, reason = "only the benchmark computes a bound")]
    pub fn edges(
        &self,
        cam_from_board: &Isometry3<f64>,
        board: &Chessboard,
        corner: &BoardCorner,
    ) -> [Vector2<f64>; 3] {
        let at = board.corner_in_board(corner.column, corner.row);
        let pixel = |along: Vector3<f64>| {
            self.camera.project(&(cam_from_board * (at + along * (0.01 * board.square_m())))).unwrap_or_default()
        };
        let middle = pixel(Vector3::zeros());
        [middle, (pixel(Vector3::x()) - middle).normalize(), (pixel(Vector3::y()) - middle).normalize()]
    }
}

/// Grey level of a point on the board plane, in squares from its first inner corner.
fn grey(x: f64, y: f64, board: &Chessboard) -> f64 {
    let (columns, rows) = (f64::from(board.columns()), f64::from(board.rows()));
    let within =
        |margin: f64| (-1.0 - margin..columns + margin).contains(&x) && (-1.0 - margin..rows + margin).contains(&y);
    match (within(0.0), within(0.7)) {
        (true, _) if (x.floor() + y.floor()) as i64 % 2 == 0 => GREYS[0],
        (_, true) => GREYS[1],
        _ => WALL_GREY,
    }
}

fn blurred(light: &[f64], width: usize, height: usize, sigma_px: f64) -> Vec<f64> {
    if sigma_px <= 0.0 {
        return light.to_vec();
    }
    let reach = (4.0 * sigma_px).ceil() as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|n| (-0.5 * (n as f64 / sigma_px).powi(2)).exp()).collect();
    let all: f64 = weights.iter().sum();
    let along = |from: &[f64], step: usize, length: usize, lines: usize, line_step: usize| {
        let mut to = vec![0.0; from.len()];
        for line in 0..lines {
            for at in 0..length {
                let of =
                    |n: isize| from[line * line_step + step * (at as isize + n).clamp(0, length as isize - 1) as usize];
                let sum: f64 = (-reach..=reach).zip(&weights).map(|(n, weight)| weight * of(n)).sum();
                to[line * line_step + step * at] = sum / all;
            }
        }
        to
    };
    let rows = along(light, 1, width, height, width);
    along(&rows, width, height, width, 1)
}
