//! Corners of ChArUco boards.

use calib_targets_charuco::{CharucoBoardSpec, CharucoDetection, CharucoDetector, CharucoParams};
use image::GrayImage;
use nalgebra::Vector2;

use super::refine::refined;
use super::{Localizer, NoBoard, enough, gray_view};
use crate::board::{Board, BoardCorner, Markers, Sighting};

/// Finds the corners identified by markers; a part of the board is enough.
pub(super) fn find(
    image: &GrayImage,
    board: &Board,
    (marker_share, Markers(dictionary)): (f64, Markers),
    localizer: Localizer,
) -> Result<Sighting, NoBoard> {
    // The frame and scale of the library are not used: corners have their column and row.
    let spec = CharucoBoardSpec::new(board.rows() + 1, board.columns() + 1, 1.0, marker_share as f32, dictionary);
    let view = gray_view(image);
    let detections = CharucoParams::sweep_for_board(&spec).into_iter().filter_map(|mut params| {
        params.chess = localizer.detector();
        // A board that the library refuses is one that `Board` refuses; a library error on an image means no corners.
        CharucoDetector::new(params).ok()?.detect(&view).ok()
    });
    let Some(best) = detections.max_by_key(|detection| detection.corners.len()) else { return Err(NoBoard::Markers) };
    enough(corners(image, &best, board), board)
}

/// The corners by column and row.
fn corners(image: &GrayImage, detection: &CharucoDetection, board: &Board) -> Vec<BoardCorner> {
    let corners = detection.corners.iter().map(|corner| BoardCorner {
        // OpenCV counts along the rows.
        column: corner.id % board.columns(),
        row: corner.id / board.columns(),
        pixel: refined(image, &Vector2::new(f64::from(corner.position.x), f64::from(corner.position.y))),
    });
    corners.filter(|corner| corner.row < board.rows()).collect()
}
