//! Position and orientation of the board relative to the cameras in a view: image position, tilt, distance. Used to judge what a
//! view adds to others, before any calibration.

use nalgebra::{Vector2, Vector3};
use pb3dp_geometry::{Camera, ImageSize};

use crate::board::{Chessboard, Sighting};
use crate::fit::View;
use crate::start::{board_pose, first_camera};

/// Number of image cells, horizontally and vertically.
pub const CELLS: [u32; 2] = [8, 6];
/// Maximum number of views used to guess the focal length.
const GUESSED_FROM: usize = 12;

/// The image cell of a pixel: column and row.
pub fn cell_of(pixel: &Vector2<f64>, size: ImageSize) -> [u32; 2] {
    let cell = |at: f64, length: u32, cells: u32| {
        ((at + 0.5) / f64::from(length) * f64::from(cells)).clamp(0.0, f64::from(cells - 1)) as u32
    };
    [cell(pixel.x, size.width, CELLS[0]), cell(pixel.y, size.height, CELLS[1])]
}

/// A set of image cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cells(u64);

impl Cells {
    /// The cells that contain detected corners.
    pub fn of(sighting: &Sighting, size: ImageSize) -> Self {
        sighting.corners().iter().map(|corner| cell_of(&corner.pixel, size)).collect()
    }

    /// The union of both sets.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The cells that are not in the other set.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Number of cells.
    pub fn count(self) -> u32 {
        self.0.count_ones()
    }

    /// Share of the image.
    pub fn share(self) -> f64 {
        f64::from(self.count()) / f64::from(CELLS[0] * CELLS[1])
    }

    /// Whether the set contains a cell.
    pub fn has(self, [column, row]: [u32; 2]) -> bool {
        column < CELLS[0] && row < CELLS[1] && self.0 >> (row * CELLS[0] + column) & 1 == 1
    }
}

impl FromIterator<[u32; 2]> for Cells {
    fn from_iter<List: IntoIterator<Item = [u32; 2]>>(cells: List) -> Self {
        Self(cells.into_iter().fold(0, |all, [column, row]| all | 1 << (row * CELLS[0] + column)))
    }
}

/// Position and orientation of the board in a view.
#[derive(Clone, Debug, PartialEq)]
pub struct Stand {
    /// Cells of each image that contain corners, the left image first.
    pub cells: Vec<Cells>,
    /// Centre of the detected corners, as shares of image width and height, 0 to 1; the mean of all images.
    pub centre: Vector2<f64>,
    /// Apparent size: side of a square with the board's area in the first image, as a share of the image width.
    pub size: f64,
    /// Tilt of the board relative to the ray from the first camera, degrees: x if its right side is farther away, y if its lower
    /// side is.
    pub tilt_deg: Vector2<f64>,
    /// Rotation of its rows in the image, degrees, from -90 to 90.
    pub roll_deg: f64,
}

impl Stand {
    /// Magnitude of the tilt, degrees.
    pub fn tilt_angle_deg(&self) -> f64 {
        self.tilt_deg.norm()
    }

    /// Difference of two views: 1 corresponds to half an image of shift, 40 degrees of tilt, 60 degrees of rotation, or twice the
    /// size.
    pub fn apart(&self, other: &Self) -> f64 {
        let aside = (self.centre - other.centre).norm_squared() / 0.25;
        let tilt = (self.tilt_deg - other.tilt_deg).norm_squared() / 1600.0;
        let roll = (self.roll_deg - other.roll_deg).abs();
        let roll = (roll.min(180.0 - roll) / 60.0).powi(2);
        let size = (self.size / other.size).log2().powi(2);
        (aside + tilt + roll + size).sqrt()
    }
}

/// Estimates board poses with a guessed camera; accurate to some degrees and percent.
#[derive(Clone, Debug)]
pub struct Judge {
    camera: Camera,
    size: ImageSize,
}

impl Judge {
    /// Guesses the first camera from views of the board; `None` if no focal length fits them.
    pub fn new<const N: usize>(views: &[View<N>], board: &Chessboard, size: ImageSize) -> Option<Self> {
        let every = views.len().div_ceil(GUESSED_FROM).max(1);
        let sightings: Vec<&Sighting> = views.iter().step_by(every).filter_map(|view| view.sightings.first()).collect();
        if sightings.is_empty() {
            return None;
        }
        Some(Self { camera: first_camera(&sightings, board, size)?, size })
    }

    /// Uses a known camera.
    pub fn of_camera(camera: Camera) -> Self {
        Self { size: camera.size(), camera }
    }

    /// The board pose in a view; `None` if its corners do not determine it.
    pub fn stand<const N: usize>(&self, view: &View<N>, board: &Chessboard) -> Option<Stand> {
        let first = view.sightings.first()?;
        let pose = board_pose(&self.camera, first, board)?;
        let middle = middle_px(first);
        let middles = view.sightings.iter().map(middle_px).sum::<Vector2<f64>>() / N as f64;
        let (width, height) = (f64::from(self.size.width), f64::from(self.size.height));
        let ray = self.camera.unproject(&middle).ok()?.normalize();
        let normal = pose.rotation * Vector3::z();
        // Shortest rotation from the ray to the normal.
        let (right, down) = (Vector3::y().cross(&ray).normalize(), ray.cross(&Vector3::x()).normalize());
        let angle = normal.dot(&ray).clamp(-1.0, 1.0).acos().to_degrees();
        let aside = Vector2::new(normal.dot(&right), normal.dot(&down));
        let across = pose.rotation * Vector3::x();
        Some(Stand {
            cells: view.sightings.iter().map(|sighting| Cells::of(sighting, self.size)).collect(),
            centre: Vector2::new((middles.x + 0.5) / width, (middles.y + 0.5) / height),
            size: area_px(first).sqrt() / width,
            tilt_deg: aside.try_normalize(1e-9).map_or_else(Vector2::zeros, |way| -way * angle),
            roll_deg: (across.y / across.x).atan().to_degrees(),
        })
    }
}

/// Centre of the detected corners, px.
fn middle_px(sighting: &Sighting) -> Vector2<f64> {
    let count = sighting.corners().len().max(1) as f64;
    sighting.corners().iter().map(|corner| corner.pixel).sum::<Vector2<f64>>() / count
}

/// Area spanned by the board corners in the image, px^2, from their variances.
fn area_px(sighting: &Sighting) -> f64 {
    let (count, mean) = (sighting.corners().len().max(1) as f64, middle_px(sighting));
    let mut spread = nalgebra::Matrix2::zeros();
    for corner in sighting.corners() {
        let aside = corner.pixel - mean;
        spread += aside * aside.transpose() / count;
    }
    // Uniformly filled rectangles with sides a and b have variances of a^2 / 12 and b^2 / 12.
    12.0 * spread.determinant().max(0.0).sqrt()
}
