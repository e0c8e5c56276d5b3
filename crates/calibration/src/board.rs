//! The calibration target: what is known of it before it is seen.

use nalgebra::Point3;

/// A plane chessboard, described by its inner corners: the points where four squares meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chessboard {
    columns: u32,
    rows: u32,
    square_m: f64,
}

/// Why a board was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BoardError {
    /// Too few or too many corners.
    #[error(
        "a board of {columns} x {rows} inner corners: each number must be between 3 and 100; inner corners are the points where four squares meet, one fewer than squares"
    )]
    Corners {
        /// Inner corners along a row.
        columns: u32,
        /// Inner corners along a column.
        rows: u32,
    },
    /// A board that looks the same after a quarter turn.
    #[error(
        "a board of {corners} x {corners} inner corners looks the same after a quarter turn, so two cameras may disagree about its first corner: use one with unequal numbers, best one odd and one even as 9 x 6"
    )]
    Equal {
        /// Inner corners along both sides.
        corners: u32,
    },
    /// A square of impossible size.
    #[error("squares of {square_mm} mm: must be between 1 and 1000 mm; measure ten squares with a ruler and divide")]
    Square {
        /// The side of a square, millimetres.
        square_mm: f64,
    },
}

impl Chessboard {
    /// A board of `columns` x `rows` inner corners whose squares have sides of `square_m` metres.
    ///
    /// # Errors
    /// Fewer than 3 or more than 100 corners in a direction, as many in both, squares below 1 mm or above 1 m.
    pub fn new(columns: u32, rows: u32, square_m: f64) -> Result<Self, BoardError> {
        if !(3..=100).contains(&columns) || !(3..=100).contains(&rows) {
            return Err(BoardError::Corners { columns, rows });
        }
        if columns == rows {
            return Err(BoardError::Equal { corners: columns });
        }
        if !(1e-3..=1.0).contains(&square_m) {
            return Err(BoardError::Square { square_mm: square_m * 1e3 });
        }
        Ok(Self { columns, rows, square_m })
    }

    /// Inner corners along a row.
    pub fn columns(&self) -> u32 {
        self.columns
    }

    /// Inner corners along a column.
    pub fn rows(&self) -> u32 {
        self.rows
    }

    /// Side of a square, metres.
    pub fn square_m(&self) -> f64 {
        self.square_m
    }

    /// How many inner corners there are.
    pub fn corner_count(&self) -> usize {
        (self.columns * self.rows) as usize
    }

    /// A corner in the frame `board`, metres: origin at corner (0, 0), x along the row, y down the column, z into the board.
    pub fn corner_in_board(&self, column: u32, row: u32) -> Point3<f64> {
        Point3::new(f64::from(column) * self.square_m, f64::from(row) * self.square_m, 0.0)
    }

    /// The surfaces of second order of which a board that is not flat is made, at a corner: bowed along the rows, bowed along the
    /// columns, twisted. The first two are 1 in the middle and 0 at the board's borders, the last one is 1 at corner (0, 0).
    pub(crate) fn surfaces(&self, column: u32, row: u32) -> [f64; 3] {
        let along = |at: u32, all: u32| 2.0 * f64::from(at) / f64::from(all - 1) - 1.0;
        let (u, v) = (along(column, self.columns), along(row, self.rows));
        [1.0 - u * u, 1.0 - v * v, u * v]
    }

    /// Whether the colours of the squares tell the board from itself turned by half a turn: if one number of corners is odd and
    /// the other one even.
    pub fn is_told_from_its_half_turn(&self) -> bool {
        (self.columns + self.rows) % 2 == 1
    }
}

/// One corner of the board in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardCorner {
    /// Its column on the board.
    pub column: u32,
    /// Its row on the board.
    pub row: u32,
    /// Where it was seen; whole numbers are pixel centres.
    pub pixel: nalgebra::Vector2<f64>,
}

/// The corners of a board in one picture, by row, then column; no two are the same.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Sighting {
    corners: Vec<BoardCorner>,
}

impl Sighting {
    /// A sighting of the given corners, put in order; of two with the same place on the board the first one is kept.
    pub fn new(mut corners: Vec<BoardCorner>) -> Self {
        corners.sort_by_key(|corner| (corner.row, corner.column));
        corners.dedup_by_key(|corner| (corner.row, corner.column));
        Self { corners }
    }

    /// The corners, by row, then column.
    pub fn corners(&self) -> &[BoardCorner] {
        &self.corners
    }

    /// The same pixels on the board turned by half a turn about its normal.
    pub(crate) fn half_turned(&self, board: &Chessboard) -> Self {
        let turn = |corner: &BoardCorner| BoardCorner {
            column: board.columns() - 1 - corner.column,
            row: board.rows() - 1 - corner.row,
            pixel: corner.pixel,
        };
        Self::new(self.corners.iter().map(turn).collect())
    }

    /// The corner at a place of the board, if it was seen.
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
        assert!(board.is_told_from_its_half_turn());
        assert!(!Chessboard::new(6, 4, 0.03).expect("a board").is_told_from_its_half_turn());
    }
}
