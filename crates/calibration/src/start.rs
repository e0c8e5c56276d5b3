//! Initial values: board poses from homographies, the focal length from a scan.

use nalgebra::{
    Isometry3, Matrix3, Point2, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3,
};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole};

use crate::board::{Chessboard, Sighting};

/// Scanned focal lengths, in image widths: from wide-angle to telephoto lens.
const FOCAL_RANGE: [f64; 2] = [0.3, 12.0];
/// Number of scanned focal lengths, in equal ratios.
const FOCAL_STEPS: i32 = 40;

/// The board pose in a camera frame (`cam_from_board`), from one detection; `None` if its corners do not determine it.
pub(crate) fn board_pose(camera: &Camera, sighting: &Sighting, board: &Chessboard) -> Option<Isometry3<f64>> {
    let mut pairs = Vec::with_capacity(sighting.corners().len());
    for corner in sighting.corners() {
        let on_board = board.corner_in_board(corner.column, corner.row);
        let ray = camera.unproject(&corner.pixel).ok()?;
        pairs.push((Point2::new(on_board.x, on_board.y), Vector2::new(ray.x, ray.y)));
    }
    pose_of(&homography(&pairs)?)
}

/// A camera without distortion with the best-fitting focal length, and the principal point at the image centre.
pub(crate) fn first_camera(sightings: &[&Sighting], board: &Chessboard, size: ImageSize) -> Option<Camera> {
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    let ratio = (FOCAL_RANGE[1] / FOCAL_RANGE[0]).powf(1.0 / f64::from(FOCAL_STEPS));
    let from_board: Vec<Matrix3<f64>> = sightings
        .iter()
        .map(|sighting| {
            let pairs = sighting
                .corners()
                .iter()
                .map(|corner| (board.corner_in_board(corner.column, corner.row).xy(), corner.pixel));
            homography(&pairs.collect::<Vec<_>>())
        })
        .collect::<Option<_>>()?;
    let tried = (0..=FOCAL_STEPS).filter_map(|step| {
        let focal = width * FOCAL_RANGE[0] * ratio.powi(step);
        let pinhole = Pinhole { fx: focal, fy: focal, cx: 0.5 * (width - 1.0), cy: 0.5 * (height - 1.0) };
        let camera = Camera::new(size, pinhole, Distortion::None).ok()?;
        let ray_from_pixel = pinhole.matrix().try_inverse()?;
        let squares = sightings.iter().zip(&from_board).map(|(sighting, pixel_from_board)| {
            misfit(&camera, &pose_of(&(ray_from_pixel * pixel_from_board))?, sighting, board)
        });
        // The median over the views: one outlier view must not decide the focal length.
        let mut squares = squares.collect::<Option<Vec<f64>>>()?;
        squares.sort_by(f64::total_cmp);
        Some((squares.iter().take(squares.len().div_ceil(2)).sum::<f64>(), camera))
    });
    tried.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, camera)| camera)
}

/// Mean squared error of the corners of one view at a pose, px^2.
fn misfit(camera: &Camera, cam_from_board: &Isometry3<f64>, sighting: &Sighting, board: &Chessboard) -> Option<f64> {
    let mut sum = 0.0;
    for corner in sighting.corners() {
        let in_cam = cam_from_board * board.corner_in_board(corner.column, corner.row);
        sum += (camera.project(&in_cam)? - corner.pixel).norm_squared();
    }
    Some(sum / sighting.corners().len().max(1) as f64)
}

/// The homography from the first points to the second ones: normalised direct linear transform (Hartley and Zisserman,
/// Multiple View Geometry, 2nd ed., algorithm 4.2).
fn homography(pairs: &[(Point2<f64>, Vector2<f64>)]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 {
        return None;
    }
    let from = normalisation(pairs.iter().map(|(from, _)| from.coords))?;
    let to = normalisation(pairs.iter().map(|(_, to)| *to))?;
    let mut squares = SMatrix::<f64, 9, 9>::zeros();
    for (a, b) in pairs {
        let (a, b) = (from * a.coords.push(1.0), to * b.push(1.0));
        let rows = [
            SVector::<f64, 9>::from_column_slice(&[0.0, 0.0, 0.0, -a.x, -a.y, -1.0, b.y * a.x, b.y * a.y, b.y]),
            SVector::<f64, 9>::from_column_slice(&[a.x, a.y, 1.0, 0.0, 0.0, 0.0, -b.x * a.x, -b.x * a.y, -b.x]),
        ];
        for row in rows {
            squares += row * row.transpose();
        }
    }
    let eigen = squares.symmetric_eigen();
    let smallest = eigen.eigenvalues.imin();
    let h = eigen.eigenvectors.column(smallest);
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    Some(to.try_inverse()? * h * from)
}

/// Translates points to their centroid and scales them to a mean distance of the square root of 2.
fn normalisation(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let count = points.clone().count() as f64;
    let centre = points.clone().sum::<Vector2<f64>>() / count;
    let distance = points.map(|point| (point - centre).norm()).sum::<f64>() / count;
    let scale = std::f64::consts::SQRT_2 / distance;
    scale.is_finite().then(|| Matrix3::new(scale, 0.0, -scale * centre.x, 0.0, scale, -scale * centre.y, 0.0, 0.0, 1.0))
}

/// The pose whose plane has this homography in normalised coordinates (Zhang, TPAMI 22 (2000), section 3.1).
fn pose_of(h: &Matrix3<f64>) -> Option<Isometry3<f64>> {
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    // The board is in front of the camera.
    let scale = if h[(2, 2)] < 0.0 { -scale } else { scale };
    let (x, y, translation) = (h.column(0) * scale, h.column(1) * scale, h.column(2) * scale);
    let svd = Matrix3::from_columns(&[x, y, x.cross(&y)]).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    if !(rotation.iter().all(|value| value.is_finite()) && translation.iter().all(|value| value.is_finite())) {
        return None;
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Some(Isometry3::from_parts(Translation3::from(Vector3::from(translation)), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::BoardCorner;

    #[test]
    fn pose_and_focal_length_of_a_pinhole_come_back() {
        let board = Chessboard::new(8, 5, 0.03).expect("a board");
        let size = ImageSize { width: 640, height: 480 };
        let pinhole = Pinhole { fx: 700.0, fy: 700.0, cx: 319.5, cy: 239.5 };
        let camera = Camera::new(size, pinhole, Distortion::None).expect("a camera");
        let poses = [[0.4, -0.3, 0.1], [-0.5, 0.2, 0.3], [0.1, 0.6, -0.2]]
            .map(|turn| Isometry3::new(Vector3::new(-0.1, -0.05, 0.6), Vector3::from(turn)));
        let sightings = poses.map(|pose| {
            let corners = (0..5).flat_map(|row| (0..8).map(move |column| (column, row))).map(|(column, row)| {
                let pixel = camera.project(&(pose * board.corner_in_board(column, row))).expect("in front");
                BoardCorner { column, row, pixel }
            });
            Sighting::new(corners.collect())
        });
        for (pose, sighting) in poses.iter().zip(&sightings) {
            let found = board_pose(&camera, sighting, &board).expect("a pose");
            assert!((found.to_homogeneous() - pose.to_homogeneous()).amax() < 1e-9, "{found}, {pose}");
        }
        let all: Vec<_> = sightings.iter().collect();
        let first = first_camera(&all, &board, size).expect("a camera");
        assert!((first.pinhole().fx / 700.0 - 1.0).abs() < 0.1, "{}", first.pinhole().fx);
    }
}
