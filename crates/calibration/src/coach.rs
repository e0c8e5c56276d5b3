//! Suggests the next view of the board, and decides when there are enough.
//!
//! The decision uses the board poses in the views so far ([`Stand`]), so it needs no calibration. The requested views follow the
//! gates: image cells without corners, tilts in all four directions, close-up views, and a minimum number of views.

use std::fmt;

use nalgebra::Vector2;

use crate::gates::{COVERAGE, Limits, VIEWS};
use crate::selection::covered;
use crate::stand::{CELLS, Cells, Stand};

/// This number of views is enough if everything else is covered.
const VIEWS_ENOUGH: usize = 15;
/// With this number of views, more coverage is not worth the time.
pub const VIEWS_MAX: usize = 25;
/// Minimum tilt that counts as tilted in a direction; the requested tilt is larger.
const TILTED_DEG: f64 = 18.0;
const TILT_ASKED_DEG: f64 = 30.0;
/// Views required in each direction of tilt.
const TILTED_EACH: usize = 2;
/// Size from which the board counts as near: side of a square with the board's area, as a share of the image width. If both
/// cameras never see the whole board that large, a share of the largest size counts. Then the requested size and number.
const NEAR: f64 = 0.36;
const NEAR_OF_LARGEST: f64 = 0.85;
const NEAR_ASKED: f64 = 0.42;
const NEAR_VIEWS: usize = 4;
/// Requested size of other views, so that the board fits into the image corners.
const MIDDLE_ASKED: f64 = 0.3;
/// Parts of the image, horizontally and vertically.
const PARTS: u32 = 3;
/// Coverage added to the gate's limit, because corners at a cell border may fall into the next cell.
const COVERAGE_MORE: f64 = 0.04;

/// Direction of board tilt, named by the side that is farther away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Farther {
    /// Its right side.
    Right,
    /// Its left side.
    Left,
    /// Its lower side.
    Lower,
    /// Its upper side.
    Upper,
}

impl Farther {
    /// All directions, in the order in which they are requested.
    pub const ALL: [Self; 4] = [Self::Right, Self::Lower, Self::Left, Self::Upper];

    /// The direction in [`Stand::tilt_deg`].
    pub fn direction(self) -> Vector2<f64> {
        match self {
            Self::Right => Vector2::x(),
            Self::Left => -Vector2::x(),
            Self::Lower => Vector2::y(),
            Self::Upper => -Vector2::y(),
        }
    }

    /// Display name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Left => "left",
            Self::Lower => "lower",
            Self::Upper => "upper",
        }
    }
}

/// A requested view of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewRequest {
    /// Part of the image: column and row, each 0 to 2.
    pub part: [u32; 2],
    /// The side that should be farther away; `None` for a board facing the cameras.
    pub farther: Option<Farther>,
    /// Requested tilt, degrees.
    pub tilt_deg: f64,
    /// Side of a square with the board's area, as a share of the image's width.
    pub size: f64,
}

impl fmt::Display for ViewRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = match self.part {
            [0, 0] => "in the upper left corner",
            [1, 0] => "at the upper edge",
            [2, 0] => "in the upper right corner",
            [0, 1] => "at the left edge",
            [2, 1] => "at the right edge",
            [0, 2] => "in the lower left corner",
            [1, 2] => "at the lower edge",
            [2, 2] => "in the lower right corner",
            _ => "in the middle",
        };
        write!(f, "hold the board {place} of the images")?;
        if self.part != [1, 1] {
            write!(f, ", as far out as possible with the whole board in both images")?;
        }
        match self.farther {
            Some(side) => write!(f, ", its {} side {:.0} degrees farther away", side.name(), self.tilt_deg)?,
            None => write!(f, ", facing the cameras")?,
        }
        write!(f, ", {}", if self.size >= NEAR { "near: as large as fits" } else { "a third of the image wide" })
    }
}

/// The views so far, summarised.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Views.
    pub views: usize,
    /// Cells of each image in which corners were detected.
    pub cells: Vec<Cells>,
    /// Views in which each side was farther away, in the order of [`Farther::ALL`].
    pub tilted: [usize; 4],
    /// Views with the board near the cameras.
    pub near: usize,
}

impl Progress {
    /// Coverage of the worst camera, as the gate computes it.
    pub fn coverage(&self) -> f64 {
        self.cells.iter().map(|cells| cells.share()).fold(1.0, f64::min)
    }
}

/// The progress and the next requested view.
#[derive(Clone, Debug, PartialEq)]
pub struct Advice {
    /// Progress so far.
    pub progress: Progress,
    /// The next view; `None` if there are enough.
    pub request: Option<ViewRequest>,
}

/// Suggests the next view. `limits` are the limits of the gates that will judge the calibration.
pub fn advice(stands: &[Stand], limits: &Limits) -> Advice {
    let cameras = stands.iter().map(|stand| stand.cells.len()).max().unwrap_or(1);
    let tilted = Farther::ALL
        .map(|side| stands.iter().filter(|stand| stand.tilt_deg.dot(&side.direction()) >= TILTED_DEG).count());
    let largest = stands.iter().map(|stand| stand.size).fold(0.0, f64::max);
    let near = NEAR.min(NEAR_OF_LARGEST * largest);
    let progress = Progress {
        views: stands.len(),
        cells: (0..cameras).map(|camera| covered(stands.iter(), camera)).collect(),
        tilted,
        near: stands.iter().filter(|stand| stand.size >= near).count(),
    };
    let is_covered = progress.coverage() >= (limits.of(COVERAGE).good / 100.0 + COVERAGE_MORE).min(1.0);
    let is_tilted = tilted.iter().all(|count| *count >= TILTED_EACH);
    let views_enough = VIEWS_ENOUGH.max(limits.of(VIEWS).good.ceil() as usize);
    let is_all = is_covered && is_tilted && progress.near >= NEAR_VIEWS && stands.len() >= views_enough;
    if is_all || stands.len() >= VIEWS_MAX.max(views_enough) {
        return Advice { progress, request: None };
    }
    let request = if stands.is_empty() {
        ViewRequest { part: [1, 1], farther: None, tilt_deg: 0.0, size: NEAR_ASKED }
    } else {
        next(stands, &progress, is_covered)
    };
    Advice { progress, request: Some(request) }
}

/// The image part with the most uncovered cells, with the rarest tilt; every third view is near the cameras, in the middle.
fn next(stands: &[Stand], progress: &Progress, is_covered: bool) -> ViewRequest {
    let rarest = Farther::ALL.into_iter().zip(progress.tilted).min_by_key(|(_, count)| *count).map(|(side, _)| side);
    // Additional near views are interleaved with the others, so that different sides of the board are tilted away.
    let is_near = progress.near < NEAR_VIEWS && (is_covered || 4 * progress.near < stands.len());
    if is_near {
        return ViewRequest { part: [1, 1], farther: rarest, tilt_deg: TILT_ASKED_DEG, size: NEAR_ASKED };
    }
    let parts = (0..PARTS).flat_map(|row| (0..PARTS).map(move |column| [column, row]));
    // The middle is covered by the other views. A part that was requested and stays empty is one where not both cameras see the
    // board.
    let outer = parts.filter(|part| *part != [1, 1]);
    let gain = |part: &[u32; 2]| {
        let visits = stands.iter().filter(|stand| part_of(&stand.centre) == *part).count();
        f64::from(empty_cells(progress, *part)).max(0.1) / (1.0 + visits as f64)
    };
    let part = outer.max_by(|a, b| gain(a).total_cmp(&gain(b))).unwrap_or([1, 1]);
    ViewRequest { part, farther: rarest, tilt_deg: TILT_ASKED_DEG, size: MIDDLE_ASKED }
}

/// The image part for a board centre; the outer parts begin where a board of a third of the image width ends.
fn part_of(centre: &Vector2<f64>) -> [u32; 2] {
    [centre.x, centre.y].map(|share| {
        if share < 0.42 {
            0
        } else if share > 0.58 {
            2
        } else {
            1
        }
    })
}

/// Cells of a part without corners, summed over all images.
fn empty_cells(progress: &Progress, part: [u32; 2]) -> u32 {
    let cells = (0..CELLS[1]).flat_map(|row| (0..CELLS[0]).map(move |column| [column, row]));
    let in_part = |[column, row]: &[u32; 2]| [PARTS * column / CELLS[0], PARTS * row / CELLS[1]] == part;
    let is_empty = |cell: &[u32; 2]| progress.cells.iter().filter(|cells| !cells.has(*cell)).count() as u32;
    cells.filter(in_part).map(|cell| is_empty(&cell)).sum()
}
