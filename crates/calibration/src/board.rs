//! Calibration boards: pattern, size and corner positions.

use calib_targets_aruco::{Dictionary, resolve_dictionary};
use nalgebra::Point3;

/// A planar calibration board, described by its detectable corners: points where four squares meet, or the corners of tags.
///
/// Corners have a column and a row. For chessboards and ChArUco boards these count the inner corners; for AprilGrids each tag has
/// two columns and two rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    columns: u32,
    rows: u32,
    pattern: Pattern,
}

/// A board created by [`Board::new`].
pub type Chessboard = Board;

/// The printed pattern of a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Pattern {
    /// Squares.
    Chessboard { square_m: f64 },
    /// Squares with markers in the white squares, as OpenCV prints them since 4.6: the first square is black.
    Charuco { square_m: f64, marker_m: f64, markers: Markers },
    /// Tags 36h11 with black squares between their corners, as Kalibr prints them: tag 0 is at the lower left.
    AprilGrid { tag_m: f64, spacing: f64 },
}

/// A marker dictionary.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Markers(pub Dictionary);

impl PartialEq for Markers {
    fn eq(&self, other: &Self) -> bool {
        self.0.name() == other.0.name()
    }
}

/// Why a board was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BoardError {
    /// Too few or too many corners.
    #[error(
        "a board of {columns} x {rows} inner corners: each number must be between 3 and 100; count the points where four squares meet, one fewer than squares per side"
    )]
    Corners {
        /// Inner corners along a row.
        columns: u32,
        /// Inner corners along a column.
        rows: u32,
    },
    /// Too few or too many squares or tags.
    #[error("a board of {columns} x {rows} {what}: each number must be between {least} and 50")]
    Size {
        /// Along a row.
        columns: u32,
        /// Along a column.
        rows: u32,
        /// Squares or tags.
        what: &'static str,
        /// The smallest number.
        least: u32,
    },
    /// A board that is symmetric under a quarter turn.
    #[error(
        "a board of {corners} x {corners} inner corners looks the same after a quarter turn, so its first corner is ambiguous; use unequal numbers, best one odd and one even, for example 9 x 6"
    )]
    Equal {
        /// Inner corners along both sides.
        corners: u32,
    },
    /// Square or tag size out of range.
    #[error("{what} of {side_mm} mm: must be between 1 and 1000 mm; measure ten with a ruler and divide")]
    Side {
        /// Squares or tags.
        what: &'static str,
        /// The side, millimetres.
        side_mm: f64,
    },
    /// Markers that do not fit into their squares.
    #[error("markers of {marker_mm} mm in squares of {square_mm} mm: the ratio must be between 0.3 and 0.95")]
    Marker {
        /// The side of a marker, millimetres.
        marker_mm: f64,
        /// The side of a square, millimetres.
        square_mm: f64,
    },
    /// Gap between tags out of range.
    #[error("tag spacing {spacing} (gap divided by the side of a tag): must be between 0.1 and 1")]
    Spacing {
        /// The gap between two tags divided by the side of a tag.
        spacing: f64,
    },
    /// Unknown marker dictionary.
    #[error(
        "unknown marker dictionary {name:?}; use an OpenCV name: DICT_4X4_50 to DICT_7X7_1000, DICT_APRILTAG_36h11"
    )]
    Dictionary {
        /// The given name.
        name: String,
    },
    /// More markers than the dictionary has.
    #[error("the board needs {needed} markers, {name} has only {there}; use a larger dictionary")]
    Markers {
        /// Markers of the board.
        needed: usize,
        /// Markers of the dictionary.
        there: usize,
        /// The dictionary.
        name: &'static str,
    },
}

/// The dictionary of the AprilGrid tags, by its OpenCV name.
pub(crate) const APRIL_TAGS: &str = "DICT_APRILTAG_36h11";

/// A side in metres.
fn side(what: &'static str, side_m: f64) -> Result<(), BoardError> {
    if (1e-3..=1.0).contains(&side_m) { Ok(()) } else { Err(BoardError::Side { what, side_mm: side_m * 1e3 }) }
}

fn dictionary(name: &str) -> Result<Dictionary, BoardError> {
    resolve_dictionary(name).ok_or_else(|| BoardError::Dictionary { name: name.to_owned() })
}

/// Checks that the dictionary has enough markers.
fn enough(dictionary: &Dictionary, needed: usize) -> Result<(), BoardError> {
    let there = dictionary.codes().len();
    if needed <= there { Ok(()) } else { Err(BoardError::Markers { needed, there, name: dictionary.name() }) }
}

impl Board {
    /// A chessboard of `columns` x `rows` inner corners whose squares have sides of `square_m` metres.
    ///
    /// # Errors
    /// Fewer than 3 or more than 100 corners in a direction, equal numbers in both directions, squares below 1 mm or above 1 m.
    pub fn new(columns: u32, rows: u32, square_m: f64) -> Result<Self, BoardError> {
        if !(3..=100).contains(&columns) || !(3..=100).contains(&rows) {
            return Err(BoardError::Corners { columns, rows });
        }
        if columns == rows {
            return Err(BoardError::Equal { corners: columns });
        }
        side("squares", square_m)?;
        Ok(Self { columns, rows, pattern: Pattern::Chessboard { square_m } })
    }

    /// A ChArUco board of `squares_x` x `squares_y` squares with sides of `square_m` metres, with markers of `marker_m` metres
    /// from an OpenCV dictionary in the white squares. The square at the upper left is black (OpenCV's pattern since 4.6).
    ///
    /// # Errors
    /// Fewer than 3 or more than 50 squares in a direction, sizes out of range, an unknown dictionary or one with too few
    /// markers.
    pub fn charuco(
        [squares_x, squares_y]: [u32; 2],
        square_m: f64,
        marker_m: f64,
        dictionary_name: &str,
    ) -> Result<Self, BoardError> {
        if !(3..=50).contains(&squares_x) || !(3..=50).contains(&squares_y) {
            return Err(BoardError::Size { columns: squares_x, rows: squares_y, what: "squares", least: 3 });
        }
        side("squares", square_m)?;
        if !(0.3..=0.95).contains(&(marker_m / square_m)) {
            return Err(BoardError::Marker { marker_mm: marker_m * 1e3, square_mm: square_m * 1e3 });
        }
        let dictionary = dictionary(dictionary_name)?;
        enough(&dictionary, (squares_x * squares_y / 2) as usize)?;
        let pattern = Pattern::Charuco { square_m, marker_m, markers: Markers(dictionary) };
        Ok(Self { columns: squares_x - 1, rows: squares_y - 1, pattern })
    }

    /// An AprilGrid of `tags_x` x `tags_y` tags of the family 36h11 with sides of `tag_m` metres and gaps of `spacing * tag_m`,
    /// as Kalibr prints it: black squares in the gaps touch the corners of the tags.
    ///
    /// # Errors
    /// Fewer than 2 or more than 50 tags in a direction or more than the family has, sizes out of range.
    pub fn april_grid([tags_x, tags_y]: [u32; 2], tag_m: f64, spacing: f64) -> Result<Self, BoardError> {
        if !(2..=50).contains(&tags_x) || !(2..=50).contains(&tags_y) {
            return Err(BoardError::Size { columns: tags_x, rows: tags_y, what: "tags", least: 2 });
        }
        side("tags", tag_m)?;
        if !(0.1..=1.0).contains(&spacing) {
            return Err(BoardError::Spacing { spacing });
        }
        enough(&dictionary(APRIL_TAGS)?, (tags_x * tags_y) as usize)?;
        Ok(Self { columns: 2 * tags_x, rows: 2 * tags_y, pattern: Pattern::AprilGrid { tag_m, spacing } })
    }

    /// Corners along a row.
    pub fn columns(&self) -> u32 {
        self.columns
    }

    /// Corners along a column.
    pub fn rows(&self) -> u32 {
        self.rows
    }

    pub(crate) fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    /// Name of the board type in texts: a chessboard, a ChArUco board, an AprilGrid.
    pub fn kind(&self) -> &'static str {
        match self.pattern {
            Pattern::Chessboard { .. } => "a chessboard",
            Pattern::Charuco { .. } => "a ChArUco board",
            Pattern::AprilGrid { .. } => "an AprilGrid",
        }
    }

    /// Side of a square, or of a tag, metres.
    pub fn square_m(&self) -> f64 {
        match self.pattern {
            Pattern::Chessboard { square_m } | Pattern::Charuco { square_m, .. } => square_m,
            Pattern::AprilGrid { tag_m, .. } => tag_m,
        }
    }

    /// Number of corners.
    pub fn corner_count(&self) -> usize {
        (self.columns * self.rows) as usize
    }

    /// A corner in the frame `board`, metres: origin at corner (0, 0), x along the row, y down the column, z into the board.
    pub fn corner_in_board(&self, column: u32, row: u32) -> Point3<f64> {
        Point3::new(self.along(column), self.along(row), 0.0)
    }

    /// Distance of a column or row from the first one, metres.
    fn along(&self, index: u32) -> f64 {
        match self.pattern {
            Pattern::Chessboard { square_m } | Pattern::Charuco { square_m, .. } => f64::from(index) * square_m,
            Pattern::AprilGrid { tag_m, spacing } => {
                (f64::from(index / 2) * (1.0 + spacing) + f64::from(index % 2)) * tag_m
            }
        }
    }

    /// Second-order surfaces that describe a board that is not flat, evaluated at a corner: bow along the rows, bow along the
    /// columns, twist. The first two are 1 in the middle and 0 at the borders of the board, the last one is 1 at corner (0, 0).
    pub(crate) fn surfaces(&self, column: u32, row: u32) -> [f64; 3] {
        let place = |at: u32, all: u32| 2.0 * self.along(at) / self.along(all - 1) - 1.0;
        let (u, v) = (place(column, self.columns), place(row, self.rows));
        [1.0 - u * u, 1.0 - v * v, u * v]
    }

    /// Whether the orientation of the board is unique: by its markers, or by the colours of its squares if one number of corners
    /// is odd and the other even.
    pub fn has_unique_orientation(&self) -> bool {
        !matches!(self.pattern, Pattern::Chessboard { .. }) || (self.columns + self.rows) % 2 == 1
    }
}

/// One detected corner of the board in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardCorner {
    /// Column on the board.
    pub column: u32,
    /// Row on the board.
    pub row: u32,
    /// Detected pixel position; whole numbers are pixel centres.
    pub pixel: nalgebra::Vector2<f64>,
}

/// The detected corners of a board in one image, by row, then column, without duplicates.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Sighting {
    corners: Vec<BoardCorner>,
}

impl Sighting {
    /// Detected corners, sorted; of two corners with the same column and row the first one is kept.
    pub fn new(mut corners: Vec<BoardCorner>) -> Self {
        corners.sort_by_key(|corner| (corner.row, corner.column));
        corners.dedup_by_key(|corner| (corner.row, corner.column));
        Self { corners }
    }

    /// The corners, by row, then column.
    pub fn corners(&self) -> &[BoardCorner] {
        &self.corners
    }

    /// The same pixels, assigned to the board turned by half a turn about its normal.
    pub(crate) fn half_turned(&self, board: &Board) -> Self {
        let turn = |corner: &BoardCorner| BoardCorner {
            column: board.columns() - 1 - corner.column,
            row: board.rows() - 1 - corner.row,
            pixel: corner.pixel,
        };
        Self::new(self.corners.iter().map(turn).collect())
    }

    /// The corner with this column and row, if it was detected.
    pub fn at(&self, column: u32, row: u32) -> Option<&BoardCorner> {
        let key = (row, column);
        let index = self.corners.binary_search_by_key(&key, |corner| (corner.row, corner.column)).ok()?;
        self.corners.get(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_boards_are_refused_with_their_numbers() {
        let text =
            |columns, rows, square_m| Chessboard::new(columns, rows, square_m).map_err(|error| error.to_string());
        assert!(text(2, 6, 0.025).is_err_and(|text| text.contains("2 x 6")));
        assert!(text(9, 6, 25.0).is_err_and(|text| text.contains("25000 mm")));
        assert!(text(9, 6, f64::NAN).is_err());
        assert!(text(7, 7, 0.025).is_err_and(|text| text.contains("quarter turn")));
        let board = Chessboard::new(9, 6, 0.025).expect("a board");
        assert_eq!(board.corner_in_board(8, 5), Point3::new(0.2, 0.125, 0.0));
        assert!(board.has_unique_orientation());
        assert!(!Chessboard::new(6, 4, 0.03).expect("a board").has_unique_orientation());
    }
}
