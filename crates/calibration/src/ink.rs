//! The black areas of a printed board.

use crate::board::{APRIL_TAGS, Board, Pattern};
use calib_targets_aruco::resolve_dictionary;
use image::GrayImage;
use nalgebra::Vector2;
use std::fmt::Write;

/// A black rectangle in the frame `board`, metres: x along the rows, y down the columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Left side.
    pub x_m: f64,
    /// Top side.
    pub y_m: f64,
    /// Width along the rows.
    pub width_m: f64,
    /// Height down the columns.
    pub height_m: f64,
}

/// Width of a tag's border, in bits, as Kalibr prints it.
const TAG_BORDER_BITS: u32 = 2;

/// All black rectangles of a board; the rest is white. Corner (0, 0) is the origin.
pub fn ink(board: &Board) -> Vec<Rectangle> {
    let mut ink = Vec::new();
    match *board.pattern() {
        Pattern::Chessboard { square_m } => squares(board, square_m, &mut ink),
        Pattern::Charuco { square_m, marker_m, markers } => {
            squares(board, square_m, &mut ink);
            let codes = markers.0.codes();
            let white = places(board).filter(|(x, y)| (x + y) % 2 != 0);
            for ((x, y), code) in white.zip(codes) {
                let inset_m = 0.5 * (square_m - marker_m);
                let at = [f64::from(x) * square_m - square_m + inset_m, f64::from(y) * square_m - square_m + inset_m];
                let cells = Cells { bits: markers.0.marker_size() as u32, border: 1, side_m: marker_m };
                cells.draw(at, |x, y| code >> (y * cells.bits + x) & 1 == 1, &mut ink);
            }
        }
        Pattern::AprilGrid { tag_m, spacing } => tags(board, tag_m, spacing, &mut ink),
    }
    ink
}

/// The squares of a board by column and row, row by row, starting at the upper left.
fn places(board: &Board) -> impl Iterator<Item = (u32, u32)> {
    let (columns, rows) = (board.columns() + 1, board.rows() + 1);
    (0..rows).flat_map(move |y| (0..columns).map(move |x| (x, y)))
}

/// Black squares; the upper left one is black.
fn squares(board: &Board, square_m: f64, ink: &mut Vec<Rectangle>) {
    ink.extend(places(board).filter(|(x, y)| (x + y) % 2 == 0).map(|(x, y)| Rectangle {
        x_m: (f64::from(x) - 1.0) * square_m,
        y_m: (f64::from(y) - 1.0) * square_m,
        width_m: square_m,
        height_m: square_m,
    }));
}

/// The tags of an AprilGrid, counted from the lower left, and the squares at their corners.
fn tags(board: &Board, tag_m: f64, spacing: f64, ink: &mut Vec<Rectangle>) {
    let (across, down) = (board.columns() / 2, board.rows() / 2);
    let (pitch_m, gap_m) = (tag_m * (1.0 + spacing), tag_m * spacing);
    for (y, x) in (0..=down).flat_map(|y| (0..=across).map(move |x| (y, x))) {
        let corner = |n: u32| f64::from(n) * pitch_m - gap_m;
        ink.push(Rectangle { x_m: corner(x), y_m: corner(y), width_m: gap_m, height_m: gap_m });
    }
    let codes = resolve_dictionary(APRIL_TAGS).map_or(&[][..], |dictionary| dictionary.codes());
    let places = (0..down).rev().flat_map(|y| (0..across).map(move |x| (x, y)));
    for ((x, y), code) in places.zip(codes) {
        let cells = Cells { bits: 6, border: TAG_BORDER_BITS, side_m: tag_m };
        // The upright orientation of AprilTag is OpenCV's turned by half a turn.
        let is_black = |x: u32, y: u32| code >> (35 - (y * cells.bits + x)) & 1 == 1;
        cells.draw([f64::from(x) * pitch_m, f64::from(y) * pitch_m], is_black, ink);
    }
}

/// The cells of a marker.
struct Cells {
    bits: u32,
    border: u32,
    side_m: f64,
}

impl Cells {
    fn draw(&self, [x_m, y_m]: [f64; 2], is_black: impl Fn(u32, u32) -> bool, ink: &mut Vec<Rectangle>) {
        let all = self.bits + 2 * self.border;
        let cell_m = self.side_m / f64::from(all);
        for y in 0..all {
            let mut x = 0;
            while x < all {
                let inner = |x: u32| x.checked_sub(self.border).filter(|x| *x < self.bits);
                let black = |x: u32| match (inner(x), inner(y)) {
                    (Some(x), Some(y)) => is_black(x, y),
                    _ => true,
                };
                // Adjacent cells are merged, so that no line shows between them.
                let run = (x..all).take_while(|x| black(*x)).count() as u32;
                if run > 0 {
                    ink.push(Rectangle {
                        x_m: x_m + f64::from(x) * cell_m,
                        y_m: y_m + f64::from(y) * cell_m,
                        width_m: f64::from(run) * cell_m,
                        height_m: cell_m,
                    });
                }
                x += run.max(1);
            }
        }
    }
}

/// Bounding box `[left, top, right, bottom]` of all black areas, metres.
pub fn extent_m(ink: &[Rectangle]) -> [f64; 4] {
    ink.iter().fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |extent, rectangle| {
        let [left, top, right, bottom] = extent;
        [
            left.min(rectangle.x_m),
            top.min(rectangle.y_m),
            right.max(rectangle.x_m + rectangle.width_m),
            bottom.max(rectangle.y_m + rectangle.height_m),
        ]
    })
}

/// A board drawn as an image.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The image; the darkness of a pixel is the share of its area that is printed.
    pub image: GrayImage,
    /// Upper left corner of the image in the frame `board`, metres.
    pub origin_m: Vector2<f64>,
}

/// Draws a board with a white margin.
pub fn draw(ink: &[Rectangle], px_per_m: f64, margin_m: f64) -> Drawn {
    let [left, top, right, bottom] = extent_m(ink);
    let origin_m = Vector2::new(left - margin_m, top - margin_m);
    let pixels = |length_m: f64| ((length_m + 2.0 * margin_m) * px_per_m).ceil().max(1.0) as u32;
    let (width, height) = (pixels(right - left), pixels(bottom - top));
    let mut black = vec![0.0_f32; width as usize * height as usize];
    for rectangle in ink {
        let across = shares((rectangle.x_m - origin_m.x) * px_per_m, rectangle.width_m * px_per_m, width);
        let down: Vec<_> =
            shares((rectangle.y_m - origin_m.y) * px_per_m, rectangle.height_m * px_per_m, height).collect();
        for (x, of_column) in across {
            for (y, of_row) in &down {
                if let Some(pixel) = black.get_mut((y * width + x) as usize) {
                    *pixel += (of_column * of_row) as f32;
                }
            }
        }
    }
    let image = GrayImage::from_fn(width, height, |x, y| {
        let black = black.get((y * width + x) as usize).copied().unwrap_or(0.0);
        image::Luma([(255.0 * (1.0 - black)).round().clamp(0.0, 255.0) as u8])
    });
    Drawn { image, origin_m }
}

/// The pixels of a row covered by an interval, with the covered share of each pixel.
fn shares(start: f64, length: f64, all: u32) -> impl Iterator<Item = (u32, f64)> {
    let end = start + length;
    let (first, last) = (start.floor().max(0.0) as u32, (end.ceil().max(0.0) as u32).min(all));
    (first..last).map(move |n| (n, (end.min(f64::from(n) + 1.0) - start.max(f64::from(n))).clamp(0.0, 1.0)))
}

/// A board as SVG in true size, with a white margin.
pub fn svg(ink: &[Rectangle], margin_m: f64) -> String {
    let [left, top, right, bottom] = extent_m(ink).map(|at| at * 1e3);
    let margin = margin_m * 1e3;
    let (width, height) = (right - left + 2.0 * margin, bottom - top + 2.0 * margin);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.4}mm\" height=\"{height:.4}mm\" viewBox=\"0 0 {width:.4} {height:.4}\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for rectangle in ink {
        let (x, y) = (rectangle.x_m * 1e3 - left + margin, rectangle.y_m * 1e3 - top + margin);
        let (width, height) = (rectangle.width_m * 1e3, rectangle.height_m * 1e3);
        // Writing to a `String` does not fail.
        let _ = writeln!(text, "<rect x=\"{x:.4}\" y=\"{y:.4}\" width=\"{width:.4}\" height=\"{height:.4}\"/>");
    }
    text.push_str("</svg>\n");
    text
}
