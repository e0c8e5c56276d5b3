//! Detects the corners of a board in an image.
//!
//! `calib-targets-chessboard` detects the corners and grid of chessboards, `calib-targets-charuco` those of ChArUco boards. This
//! module compares a chessboard grid with the expected board, determines the first corner, and assigns corners to the tags of an
//! AprilGrid.

mod april_grid;
mod charuco;
mod refine;

use calib_targets_chessboard::{
    ChessboardDetection, ChessboardDetector, ChessboardParams, DetectorConfig, GrayImageView, default_chess_config,
    detect_corners,
};
use calib_targets_core::ImageRefiner;
use image::GrayImage;
use nalgebra::Vector2;

use crate::board::{Board, BoardCorner, Chessboard, Pattern, Sighting};

/// Why no usable board was detected in an image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoBoard {
    /// No chessboard was detected.
    #[error("no chessboard detected; check light and sharpness, and that the whole board is in the image")]
    None,
    /// A grid of another size.
    #[error(
        "a grid of {covered_columns} x {covered_rows} corners was detected, the board has {columns} x {rows}; show the whole board, or correct its numbers of inner corners"
    )]
    Size {
        /// Corners along the longer side of the detected grid.
        covered_columns: u32,
        /// Corners along the other side.
        covered_rows: u32,
        /// Columns of the board.
        columns: u32,
        /// Rows of the board.
        rows: u32,
    },
    /// No readable marker.
    #[error(
        "no readable marker; check light, sharpness and glare, move the board nearer, and compare it with --board (dictionary and size)"
    )]
    Markers,
    /// Too little of a board with markers is visible.
    #[error(
        "only {detected} of the board's {all} corners have readable markers, at least {least} in 3 columns and 3 rows are needed; show more of the board, or move it nearer"
    )]
    Few {
        /// Detected corners.
        detected: usize,
        /// Corners of the board.
        all: usize,
        /// The smallest number.
        least: usize,
    },
    /// The grid has holes.
    #[error("only {detected} of the board's {all} corners were detected; uncover the board, or avoid glare on it")]
    Gaps {
        /// Detected corners.
        detected: usize,
        /// Corners of the board.
        all: usize,
    },
}

/// Smaller images are rejected; the corner detector panics on empty images (chess-corners-core 2.1.0).
const SIDE_MIN_PX: u32 = 32;
/// Minimum share of a chessboard's corners that must be detected.
const DETECTED_SHARE_MIN: f64 = 0.8;

/// Minimum number of corners for a board with markers.
const CODED_MIN: usize = 12;

/// How the sub-pixel position of a corner is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Localizer {
    /// The centre of mass of the detector's response; only for comparison.
    CentreOfMass,
    /// The saddle point of a quadratic surface that is fitted to 5 x 5 pixels and centred on the corner. If the fit fails, the
    /// corner keeps its centre of mass.
    #[default]
    SaddlePoint,
}

impl Localizer {
    fn detector(self) -> DetectorConfig {
        match self {
            Self::CentreOfMass => default_chess_config(),
            Self::SaddlePoint => default_chess_config().with_refiner(ImageRefiner::saddle_point()),
        }
    }
}

/// Detects a board of any type in an image. Chessboards must be completely visible; boards with markers may be partly visible.
///
/// # Errors
/// No grid, a grid whose size differs from the board, or a grid with gaps; for boards with markers, no readable marker or too few corners.
pub fn find_board(image: &GrayImage, board: &Board) -> Result<Sighting, NoBoard> {
    find_board_by(image, board, Localizer::default())
}

/// As [`find_board`], with a given localizer of the corners.
///
/// # Errors
/// As [`find_board`].
pub fn find_board_by(image: &GrayImage, board: &Board, localizer: Localizer) -> Result<Sighting, NoBoard> {
    if image.width().min(image.height()) < SIDE_MIN_PX {
        return Err(NoBoard::None);
    }
    match *board.pattern() {
        Pattern::Chessboard { .. } => find_chessboard(image, board, localizer),
        Pattern::Charuco { square_m, marker_m, markers } => {
            charuco::find(image, board, (marker_m / square_m, markers), localizer)
        }
        Pattern::AprilGrid { .. } => april_grid::find(image, board, localizer),
    }
}

/// An image in the format of the detectors.
fn gray_view(image: &GrayImage) -> GrayImageView<'_> {
    GrayImageView { width: image.width() as usize, height: image.height() as usize, data: image.as_raw().as_slice() }
}

/// The detected corners of a board with markers, if there are enough to compute its pose.
fn enough(corners: Vec<BoardCorner>, board: &Board) -> Result<Sighting, NoBoard> {
    let sighting = Sighting::new(corners);
    let different = |of: fn(&BoardCorner) -> u32| {
        let mut all: Vec<u32> = sighting.corners().iter().map(of).collect();
        all.sort_unstable();
        all.dedup();
        all.len()
    };
    let (detected, least) = (sighting.corners().len(), CODED_MIN.min(board.corner_count()));
    if detected < least || different(|corner| corner.column) < 3 || different(|corner| corner.row) < 3 {
        return Err(NoBoard::Few { detected, all: board.corner_count(), least });
    }
    Ok(sighting)
}

/// Detects a chessboard in an image that is large enough.
///
/// If the square colours make the orientation unique, corner (0, 0) is the one whose square towards (1, 1) is dark. For other
/// boards it is one of the corners from which rows run to the right or columns downwards, and [`agree`] makes two images use the
/// same one.
///
/// # Errors
/// No grid, a grid whose size differs from the board, or a grid with gaps.
fn find_chessboard(image: &GrayImage, board: &Chessboard, localizer: Localizer) -> Result<Sighting, NoBoard> {
    let corners = detect_corners(&gray_view(image), &localizer.detector());
    let grids = ChessboardParams::sweep_default().into_iter().filter_map(|params| {
        // The parameters are the library defaults, which it does not refuse.
        ChessboardDetector::new(params).ok()?.detect(&corners)
    });
    let grid = grids.max_by_key(|grid| grid.corners.len()).ok_or(NoBoard::None)?;
    let sighting = placed(&grid, board)?;
    if board.has_unique_orientation() && !first_square_is_dark(image, &sighting) {
        return Ok(sighting.half_turned(board));
    }
    Ok(sighting)
}

/// The detected grid assigned to the board, turned by a quarter turn if its sides are exchanged.
///
/// If the border of the board or its background added corners, the grid is larger than the board. The board is then the only part
/// of the grid that contains all corners of the board.
fn placed(grid: &ChessboardDetection, board: &Chessboard) -> Result<Sighting, NoBoard> {
    let (columns, rows) = (board.columns() as i32, board.rows() as i32);
    let coordinates = || grid.corners.iter().map(|corner| (corner.grid.u, corner.grid.v));
    let (u_min, v_min) = coordinates().fold((i32::MAX, i32::MAX), |low, (u, v)| (low.0.min(u), low.1.min(v)));
    let (u_max, v_max) = coordinates().fold((i32::MIN, i32::MIN), |high, (u, v)| (high.0.max(u), high.1.max(v)));
    let (across, down) = (u_max - u_min + 1, v_max - v_min + 1);
    let mut parts = Vec::new();
    for (turned, (width, height)) in [(false, (columns, rows)), (true, (rows, columns))] {
        for (u, v) in (v_min..=v_max - height + 1).flat_map(|v| (u_min..=u_max - width + 1).map(move |u| (u, v))) {
            let part = Part { u, v, width, height, turned };
            parts.push((coordinates().filter(|at| part.holds(*at)).count(), part));
        }
    }
    parts.sort_by_key(|(detected, _)| std::cmp::Reverse(*detected));
    let all = board.corner_count();
    let (detected, part) = match parts.as_slice() {
        [(detected, part)] => (*detected, part),
        // Exactly one of several candidate parts must be complete.
        [(detected, part), (next, _), ..] if *detected == all && *next < all => (*detected, part),
        _ => {
            let (covered_columns, covered_rows) = (across.max(down).unsigned_abs(), across.min(down).unsigned_abs());
            return Err(NoBoard::Size { covered_columns, covered_rows, columns: board.columns(), rows: board.rows() });
        }
    };
    if (detected as f64) < DETECTED_SHARE_MIN * all as f64 {
        return Err(NoBoard::Gaps { detected, all });
    }
    let inside = grid.corners.iter().filter(|corner| part.holds((corner.grid.u, corner.grid.v)));
    let corners = inside.map(|corner| {
        let (column, row) = part.on_board((corner.grid.u, corner.grid.v));
        BoardCorner { column, row, pixel: Vector2::new(f64::from(corner.position.x), f64::from(corner.position.y)) }
    });
    Ok(Sighting::new(corners.collect()))
}

/// A rectangle of a grid that may be the board.
struct Part {
    u: i32,
    v: i32,
    width: i32,
    height: i32,
    /// The board's columns run down the grid.
    turned: bool,
}

impl Part {
    fn holds(&self, (u, v): (i32, i32)) -> bool {
        (self.u..self.u + self.width).contains(&u) && (self.v..self.v + self.height).contains(&v)
    }

    /// Column and row on the board for a grid position. A quarter turn, not a transposition: the board keeps its handedness.
    fn on_board(&self, (u, v): (i32, i32)) -> (u32, u32) {
        let (right, down) = ((u - self.u).unsigned_abs(), (v - self.v).unsigned_abs());
        if self.turned { (down, self.width.unsigned_abs() - 1 - right) } else { (right, down) }
    }
}

/// Whether the squares with the colour of the first square are darker than the others, judged at their centres.
fn first_square_is_dark(image: &GrayImage, sighting: &Sighting) -> bool {
    let (mut sums, mut counts) = ([0.0_f64; 2], [0_u32; 2]);
    for corner in sighting.corners() {
        let others = [(1, 0), (0, 1), (1, 1)].map(|(c, r)| sighting.at(corner.column + c, corner.row + r));
        let [Some(a), Some(b), Some(c)] = others else { continue };
        let middle = (corner.pixel + a.pixel + b.pixel + c.pixel) / 4.0;
        let (x, y) = (middle.x.round().max(0.0) as u32, middle.y.round().max(0.0) as u32);
        let Some(pixel) = image.get_pixel_checked(x, y) else { continue };
        let colour = ((corner.column + corner.row) % 2) as usize;
        sums[colour] += f64::from(pixel.0[0]);
        counts[colour] += 1;
    }
    let mean = |colour: usize| sums[colour] / f64::from(counts[colour].max(1));
    mean(0) < mean(1)
}

/// The second detection of a board that is symmetric under a half turn, turned so that rows run the same way in both images. For
/// two cameras on one rig, whose images are rotated relative to each other by less than a quarter turn.
pub fn agree(first: &Sighting, second: Sighting, board: &Chessboard) -> Sighting {
    let along = |sighting: &Sighting| {
        let mean = |of: &dyn Fn(&BoardCorner) -> bool| {
            let pixels: Vec<_> =
                sighting.corners().iter().filter(|corner| of(corner)).map(|corner| corner.pixel).collect();
            pixels.iter().sum::<Vector2<f64>>() / (pixels.len().max(1) as f64)
        };
        let half = board.columns() / 2;
        mean(&|corner| corner.column >= board.columns() - half) - mean(&|corner| corner.column < half)
    };
    if along(first).dot(&along(&second)) < 0.0 { second.half_turned(board) } else { second }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drawn board of 5 x 4 inner corners, `side` pixels per square, whose upper left inner square is dark or not.
    fn drawn(side: u32, dark_first: bool) -> GrayImage {
        let (squares_across, squares_down, margin) = (6, 5, 2 * side);
        GrayImage::from_fn(squares_across * side + 2 * margin, squares_down * side + 2 * margin, |x, y| {
            let inside = |at: u32, squares: u32| at >= margin && at < margin + squares * side;
            if !inside(x, squares_across) || !inside(y, squares_down) {
                return image::Luma([200]);
            }
            let parity = ((x - margin) / side + (y - margin) / side) % 2;
            image::Luma([if (parity == 0) == dark_first { 30 } else { 220 }])
        })
    }

    #[test]
    fn corners_are_found_where_they_were_drawn() {
        let board = Chessboard::new(5, 4, 0.02).expect("a board");
        let sighting = find_board(&drawn(24, true), &board).expect("seen");
        assert_eq!(sighting.corners().len(), 20);
        for corner in sighting.corners() {
            // Edges lie between pixels: half a pixel before the first pixel of the next square.
            let expected =
                Vector2::new(f64::from(72 + 24 * corner.column), f64::from(72 + 24 * corner.row)).add_scalar(-0.5);
            assert!((corner.pixel - expected).norm() < 0.05, "{corner:?}, {expected}");
        }
    }

    #[test]
    fn the_first_corner_is_the_one_before_a_dark_square_whichever_way_up() {
        let board = Chessboard::new(5, 4, 0.02).expect("a board");
        for image in [drawn(24, true), drawn(24, false)] {
            for image in [image.clone(), image::imageops::rotate180(&image), image::imageops::rotate90(&image)] {
                let sighting = find_board(&image, &board).expect("seen");
                assert!(first_square_is_dark(&image, &sighting));
                // x to the right and y down have a positive cross product: z points into the image.
                let [o, x, y] = [(0, 0), (4, 0), (0, 3)].map(|(c, r)| sighting.at(c, r).expect("seen").pixel);
                assert!((x - o).perp(&(y - o)) > 0.0);
            }
        }
    }

    #[test]
    fn another_board_is_recognised_by_its_numbers() {
        let board = Chessboard::new(9, 6, 0.02).expect("a board");
        let refusal = find_board(&drawn(24, true), &board).expect_err("another board");
        assert_eq!(refusal, NoBoard::Size { covered_columns: 5, covered_rows: 4, columns: 9, rows: 6 });
        // A smaller board fits into a larger one at several positions.
        let smaller = Chessboard::new(4, 3, 0.02).expect("a board");
        let refusal = find_board(&drawn(24, true), &smaller).expect_err("a larger board");
        assert_eq!(refusal, NoBoard::Size { covered_columns: 5, covered_rows: 4, columns: 4, rows: 3 });
        assert_eq!(find_board(&GrayImage::new(320, 240), &board), Err(NoBoard::None));
        for (width, height) in [(0, 0), (1, 1), (32, 32), (4, 2000)] {
            assert_eq!(find_board(&GrayImage::new(width, height), &board), Err(NoBoard::None), "{width} x {height}");
        }
    }

    #[test]
    fn both_eyes_choose_the_same_corner_of_a_board_that_looks_the_same_upside_down() {
        let board = Chessboard::new(6, 4, 0.02).expect("a board");
        let at = |column: u32, row: u32| BoardCorner {
            column,
            row,
            pixel: Vector2::new(100.0 + 20.0 * f64::from(column), 80.0 + 20.0 * f64::from(row)),
        };
        let first = Sighting::new((0..4).flat_map(|row| (0..6).map(move |column| at(column, row))).collect());
        assert_eq!(agree(&first, first.half_turned(&board), &board), first);
        assert_eq!(agree(&first, first.clone(), &board), first);
    }
}
