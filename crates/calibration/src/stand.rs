//! How the board stands before the cameras in a view: where in the images, how tilted, how far. What a view adds to others is
//! judged by it, before anything is calibrated.

use nalgebra::{Vector2, Vector3};
use pb3dp_geometry::{Camera, ImageSize};

use crate::board::{Chessboard, Sighting};
use crate::fit::View;
use crate::start::{board_pose, first_camera};

/// Cells into which an image is divided, across and down.
pub const CELLS: [u32; 2] = [8, 6];
/// Views from which the focal length is guessed.
const GUESSED_FROM: usize = 12;

/// The cell of an image in which a pixel lies: column and row.
pub fn cell_of(pixel: &Vector2<f64>, size: ImageSize) -> [u32; 2] {
    let cell = |at: f64, length: u32, cells: u32| {
        ((at + 0.5) / f64::from(length) * f64::from(cells)).clamp(0.0, f64::from(cells - 1)) as u32
    };
    [cell(pixel.x, size.width, CELLS[0]), cell(pixel.y, size.height, CELLS[1])]
}

/// A set of cells of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cells(u64);

impl Cells {
    /// The cells in which corners were seen.
    pub fn of(sighting: &Sighting, size: ImageSize) -> Self {
        let mut cells = Self::default();
        for corner in sighting.corners() {
            let [column, row] = cell_of(&corner.pixel, size);
            cells.0 |= 1 << (row * CELLS[0] + column);
        }
        cells
    }

    /// Both sets together.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// What the other set does not have.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// How many there are.
    pub fn count(self) -> u32 {
        self.0.count_ones()
    }

    /// Their share of the image.
    pub fn share(self) -> f64 {
        f64::from(self.count()) / f64::from(CELLS[0] * CELLS[1])
    }

    /// Whether a cell is among them.
    pub fn has(self, [column, row]: [u32; 2]) -> bool {
        column < CELLS[0] && row < CELLS[1] && self.0 >> (row * CELLS[0] + column) & 1 == 1
    }
}

/// How the board stands in a view.
#[derive(Clone, Debug, PartialEq)]
pub struct Stand {
    /// Cells of each image in which corners were seen, the left one first.
    pub cells: Vec<Cells>,
    /// Middle of the seen corners, as shares of an image's width and height, 0 to 1; the mean of all images.
    pub centre: Vector2<f64>,
    /// Side of a square with the area that the board has in the first image, as a share of the image's width.
    pub size: f64,
    /// How the board is turned away from facing the first camera along the ray to it, degrees: x where its right side is
    /// farther away, y where its lower side is.
    pub tilt_deg: Vector2<f64>,
    /// How its rows are turned in the image, degrees, from -90 to 90.
    pub roll_deg: f64,
}

impl Stand {
    /// The tilt without its direction, degrees.
    pub fn tilt_angle_deg(&self) -> f64 {
        self.tilt_deg.norm()
    }

    /// How different two stands are: 1 is half the image aside, 40 degrees of tilt, 60 degrees of turn, or twice as large.
    pub fn apart(&self, other: &Self) -> f64 {
        let aside = (self.centre - other.centre).norm_squared() / 0.25;
        let tilt = (self.tilt_deg - other.tilt_deg).norm_squared() / 1600.0;
        let roll = (self.roll_deg - other.roll_deg).abs();
        let roll = (roll.min(180.0 - roll) / 60.0).powi(2);
        let size = (self.size / other.size).log2().powi(2);
        (aside + tilt + roll + size).sqrt()
    }
}

/// Judges stands by a guessed camera; good to some degrees and percent.
#[derive(Clone, Debug)]
pub struct Judge {
    camera: Camera,
    size: ImageSize,
}

impl Judge {
    /// Guesses the first camera from views of the board; `None` if no focal length explains them.
    pub fn new<const N: usize>(views: &[View<N>], board: &Chessboard, size: ImageSize) -> Option<Self> {
        let every = views.len().div_ceil(GUESSED_FROM).max(1);
        let sightings: Vec<&Sighting> = views.iter().step_by(every).filter_map(|view| view.sightings.first()).collect();
        if sightings.is_empty() {
            return None;
        }
        Some(Self { camera: first_camera(&sightings, board, size)?, size })
    }

    /// By a camera that is known.
    pub fn of_camera(camera: Camera) -> Self {
        Self { size: camera.size(), camera }
    }

    /// The stand of the board in a view; `None` if its corners do not determine it.
    pub fn stand<const N: usize>(&self, view: &View<N>, board: &Chessboard) -> Option<Stand> {
        let first = view.sightings.first()?;
        let pose = board_pose(&self.camera, first, board)?;
        let middle = middle_px(first);
        let middles = view.sightings.iter().map(middle_px).sum::<Vector2<f64>>() / N as f64;
        let (width, height) = (f64::from(self.size.width), f64::from(self.size.height));
        let ray = self.camera.unproject(&middle).ok()?.normalize();
        let normal = pose.rotation * Vector3::z();
        // From the ray to the normal, along the shortest way.
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

/// The middle of the corners that were seen, px.
fn middle_px(sighting: &Sighting) -> Vector2<f64> {
    let count = sighting.corners().len().max(1) as f64;
    sighting.corners().iter().map(|corner| corner.pixel).sum::<Vector2<f64>>() / count
}

/// The area that the board's corners span in the image, px^2, from their spread.
fn area_px(sighting: &Sighting) -> f64 {
    let (count, mean) = (sighting.corners().len().max(1) as f64, middle_px(sighting));
    let mut spread = nalgebra::Matrix2::zeros();
    for corner in sighting.corners() {
        let aside = corner.pixel - mean;
        spread += aside * aside.transpose() / count;
    }
    // Evenly filled rectangles with sides a and b have variances of a^2 / 12 and b^2 / 12.
    12.0 * spread.determinant().max(0.0).sqrt()
}
