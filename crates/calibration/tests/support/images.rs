//! Images of a chessboard through simulated cameras.

use image::{GrayImage, Luma};
use nalgebra::{Isometry3, Vector2, Vector3};
use pb3dp_calibration::board::Chessboard;
use pb3dp_geometry::Camera;

use crate::support::{Random, SIZE};

/// Rays per pixel along each side; the pixel is their mean.
const RAYS: u32 = 3;

/// A camera with the rays of its pixels.
pub struct Painter {
    rays: Vec<Vector3<f64>>,
}

impl Painter {
    pub fn new(camera: &Camera) -> Self {
        let at = |n: u32| (f64::from(n) + 0.5) / f64::from(RAYS) - 0.5;
        let mut rays = Vec::new();
        for (y, x) in (0..SIZE.height * RAYS).flat_map(|y| (0..SIZE.width * RAYS).map(move |x| (y, x))) {
            let pixel = Vector2::new(f64::from(x / RAYS) + at(x % RAYS), f64::from(y / RAYS) + at(y % RAYS));
            rays.push(camera.unproject(&pixel).unwrap_or_else(|_| Vector3::z()));
        }
        Self { rays }
    }

    /// The board in front of a grey wall, with a white border, and some noise.
    pub fn image(&self, cam_from_board: &Isometry3<f64>, board: &Chessboard, random: &mut Random) -> GrayImage {
        let board_from_cam = cam_from_board.inverse();
        let origin = board_from_cam.translation.vector / board.square_m();
        let turn = board_from_cam.rotation.to_rotation_matrix();
        let mut sums = vec![0.0_f64; (SIZE.width * SIZE.height) as usize];
        for (index, ray) in self.rays.iter().enumerate() {
            let (x, y) = (index as u32 % (SIZE.width * RAYS) / RAYS, index as u32 / (SIZE.width * RAYS) / RAYS);
            let way = turn * ray;
            let at = origin - way * (origin.z / way.z);
            sums[(y * SIZE.width + x) as usize] += grey(at.x, at.y, board);
        }
        GrayImage::from_fn(SIZE.width, SIZE.height, |x, y| {
            let mean = sums[(y * SIZE.width + x) as usize] / f64::from(RAYS * RAYS);
            Luma([(mean + random.normal()).clamp(0.0, 255.0) as u8])
        })
    }
}

/// Grey level of a point on the board plane, in squares from its first inner corner.
fn grey(x: f64, y: f64, board: &Chessboard) -> f64 {
    let (columns, rows) = (f64::from(board.columns()), f64::from(board.rows()));
    let within =
        |margin: f64| (-1.0 - margin..columns + margin).contains(&x) && (-1.0 - margin..rows + margin).contains(&y);
    match (within(0.0), within(0.7)) {
        (true, _) if (x.floor() + y.floor()) as i64 % 2 == 0 => 35.0,
        (_, true) => 225.0,
        _ => 120.0,
    }
}
