//! Corner refinement for boards with markers, to a hundredth of a pixel.

use image::GrayImage;
use nalgebra::{Matrix2, Vector2};

/// Half size of the refinement window, px, and the standard deviation of its weights.
const WINDOW_PX: (i32, f64) = (3, 2.0);
/// Maximum number of refinement iterations.
const STEPS_MAX: usize = 10;
/// Maximum displacement during refinement, px; a corner that moves farther keeps its original position.
const MOVE_MAX_PX: f64 = 1.5;

/// The point where the surrounding edges intersect (Foerstner and Guelch, Intercommission Conference on Fast Processing of
/// Photogrammetric Data, 1987). The chessboard detector uses a larger neighbourhood, which would include the markers.
pub(super) fn refined(image: &GrayImage, start: &Vector2<f64>) -> Vector2<f64> {
    let mut at = *start;
    for _ in 0..STEPS_MAX {
        let Some(next) = edges_meet(image, &at).filter(|next| (next - start).norm() <= MOVE_MAX_PX) else {
            return *start;
        };
        let step = (next - at).norm();
        at = next;
        if step < 1e-3 {
            break;
        }
    }
    at
}

/// The point nearest to all edges in a window; `None` at the image border, or if all edges have the same direction.
fn edges_meet(image: &GrayImage, at: &Vector2<f64>) -> Option<Vector2<f64>> {
    let (half, deviation) = WINDOW_PX;
    let (mut squares, mut places) = (Matrix2::zeros(), Vector2::zeros());
    for (y, x) in (-half..=half).flat_map(|y| (-half..=half).map(move |x| (y, x))) {
        let from_middle = Vector2::new(f64::from(x), f64::from(y));
        let place = at + from_middle;
        let slope = |way: Vector2<f64>| Some(0.5 * (value(image, &(place + way))? - value(image, &(place - way))?));
        let gradient = Vector2::new(slope(Vector2::x())?, slope(Vector2::y())?);
        let weight = (-0.5 * from_middle.norm_squared() / (deviation * deviation)).exp();
        let square = gradient * gradient.transpose() * weight;
        squares += square;
        places += square * place;
    }
    Some(squares.try_inverse()? * places).filter(|point| point.iter().all(|value| value.is_finite()))
}

/// Interpolated image value.
fn value(image: &GrayImage, at: &Vector2<f64>) -> Option<f64> {
    let (x, y) = (at.x.floor(), at.y.floor());
    if x < 0.0 || y < 0.0 {
        return None;
    }
    let (right, down) = (at.x - x, at.y - y);
    let pixel = |dx: u32, dy: u32| Some(f64::from(image.get_pixel_checked(x as u32 + dx, y as u32 + dy)?.0[0]));
    let above = pixel(0, 0)? * (1.0 - right) + pixel(1, 0)? * right;
    let below = pixel(0, 1)? * (1.0 - right) + pixel(1, 1)? * right;
    Some(above * (1.0 - down) + below * down)
}
