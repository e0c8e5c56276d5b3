//! The chessboard: flat, black and white, for calibrations.

use std::sync::Arc;

use nalgebra::{Point3, Vector2};

use super::Draft;
use super::card::whole_face;
use super::mesh::{Mesh, box_faces};
use super::texture::{Colour, Texture};

/// Thickness, metres.
const THICKNESS_M: f64 = 0.004;
/// Black and white as printed, grey levels.
const INK: f64 = 28.0;
const PAPER: f64 = 226.0;
/// Texels along a side, as a power of two.
const SIDE_LOG2: u32 = 11;

/// Builds the board from its inner corners in both directions and the side of a square. The white border is as wide as a square.
pub(super) fn build([columns, rows]: [u32; 2], square_m: f64) -> Draft {
    let paper = Arc::new(Texture::from_fn(0, 0, |_, _| [PAPER; 3]));
    build_with([columns, rows], square_m, Arc::new(paint([columns, rows])), paper)
}

/// The board's shape with any textures, for the front and for the other sides.
pub(super) fn build_with(corners: [u32; 2], square_m: f64, front: Arc<Texture>, paper: Arc<Texture>) -> Draft {
    let [half_x, half_y] = super::board_size_m(corners, square_m).map(|size| size / 2.0);
    let faces = box_faces(&Point3::new(-half_x, -half_y, 0.0), &Point3::new(half_x, half_y, THICKNESS_M));
    // The whole texture: it is white at all borders, so no colour bleeds in.
    let places = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| Vector2::new(u, v));
    let mut board = Mesh::default();
    board.add_quad(std::array::from_fn(|k| (faces[0][k], places[k])));
    let mut surfaces = vec![(board, front)];
    surfaces.extend(faces[1..].iter().map(|face| (whole_face(face), Arc::clone(&paper))));
    Draft { name: "chessboard", surfaces, outline_m: faces[0].to_vec() }
}

/// Each texel is the mean of the area it covers, so that edges and corners are accurate to a small fraction of a texel.
fn paint(corners: [u32; 2]) -> Texture {
    let [x, y] = corners.map(|corners| Stripes { squares: f64::from(corners + 1) });
    let texel = 1.0 / f64::from(1u32 << SIDE_LOG2);
    Texture::from_fn(SIDE_LOG2, SIDE_LOG2, move |u, v| {
        let [(in_x, sign_x), (in_y, sign_y)] = [(x, u), (y, v)].map(|(stripes, at)| stripes.means(at, texel));
        let black = 0.5 * (in_x * in_y + sign_x * sign_y);
        [PAPER + (INK - PAPER) * black; 3] as Colour
    })
}

/// One direction of the board: one white square, the printed squares, one white square.
#[derive(Clone, Copy)]
struct Stripes {
    squares: f64,
}

impl Stripes {
    /// Means over the texel around `at` (texture coordinate): the coverage by squares, and their sign. The first square is +1,
    /// the next one -1; where both directions have the same sign the board is black.
    fn means(self, at: f64, texel: f64) -> (f64, f64) {
        let places = self.squares + 2.0;
        let [from, to] = [at - 0.5 * texel, at + 0.5 * texel].map(|at| (at * places - 1.0).clamp(0.0, self.squares));
        let width = texel * places;
        ((to - from) / width, (signed(to) - signed(from)) / width)
    }
}

/// Integral of the sign from 0.
fn signed(x: f64) -> f64 {
    let phase = x.rem_euclid(2.0);
    if phase < 1.0 { phase } else { 2.0 - phase }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_alternate_and_their_edges_are_where_they_belong() {
        let stripes = Stripes { squares: 3.0 };
        // Five positions: white, three squares, white.
        let sign = |at: f64| stripes.means(at, 1e-6);
        for (place, expected) in
            [(0.5, (0.0, 0.0)), (1.5, (1.0, 1.0)), (2.5, (1.0, -1.0)), (3.5, (1.0, 1.0)), (4.5, (0.0, 0.0))]
        {
            let (inside, sign) = sign(place / 5.0);
            assert!((inside - expected.0).abs() < 1e-6 && (sign - expected.1).abs() < 1e-6, "{place}: {inside} {sign}");
        }
        // A texel of which a quarter lies before the edge.
        let (inside, sign) = stripes.means(0.2 + 0.25 * 0.01, 0.01);
        assert!((inside - 0.75).abs() < 1e-9 && (sign - 0.75).abs() < 1e-9, "{inside} {sign}");
        let (inside, sign) = stripes.means(0.4 + 0.25 * 0.01, 0.01);
        assert!((inside - 1.0).abs() < 1e-9 && (sign + 0.5).abs() < 1e-9, "{inside} {sign}");
    }
}
