//! Selects views of the board for a calibration: the whole board in both images, spread over the image area, tilted and rotated.
//!
//! Starting from one view of the board, each requested view is a motion `M` of the board in the left camera frame. The arm that
//! executes it knows its camera pose only roughly: with an error `E` of that pose the board moves by `E M E^-1` instead.
//! Candidate views are therefore tested with such errors, and with a wrong focal length.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use pb3dp_geometry::frames::{Board, CamLeft};
use pb3dp_geometry::{Camera, Pinhole, Pose, StereoRig, so3};

use crate::board::{Chessboard, Sighting};
use crate::stand::{Cells, cell_of};
use crate::start::board_pose;

/// Candidate distances, as shares of the requested one.
const DISTANCES: [f64; 4] = [0.8, 1.0, 1.25, 1.5];
/// Candidate tilts of the board against the camera axis, degrees, and the number of tilt directions.
const TILTS_DEG: [f64; 4] = [0.0, 15.0, 22.0, 30.0];
const TILT_DIRECTIONS: u32 = 8;
/// Candidate rotations about the camera axis, degrees.
const TURNS_DEG: [f64; 5] = [0.0, -15.0, 15.0, -30.0, 30.0];
/// Candidate positions of the board centre in the left image.
const PLACES: [u32; 2] = [7, 5];
/// Minimum distance between the board border and the image border, px.
const MARGIN_PX: f64 = 5.0;
/// Orientations that differ by more than this count as new, radians.
const NEW_ORIENTATION_RAD: f64 = 0.35;
/// Value of a new orientation, in image cells.
const NEW_ORIENTATION_CELLS: f64 = 6.0;
/// Path length equivalent of a rotation, metres per radian.
const WAY_M_PER_RAD: f64 = 0.5;

/// The requested views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProposalRequest {
    /// Number of views.
    pub count: usize,
    /// Distance from the left camera to the board centre, metres.
    pub distance_m: f64,
    /// Position error of the assumed camera pose on the arm, metres, in any direction.
    pub guess_error_m: f64,
    /// Orientation error of the assumed camera pose, radians, about any axis.
    pub guess_error_rad: f64,
    /// Relative error of the focal length.
    pub focal_error: f64,
}

/// The selected views.
#[derive(Clone, Debug)]
pub struct Views {
    /// Board poses in the left camera, in the order of a short path that begins at the first view.
    pub cam_left_from_board: Vec<Pose<CamLeft, Board>>,
    /// Share of the cells of the left and right image that corners will cover.
    pub coverage: [f64; 2],
}

/// Why no views could be proposed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProposeError {
    /// Too few views show the whole board.
    #[error(
        "only {found} views at {distance_mm:.0} mm show the whole board in both images, {wanted} are needed; use a larger --distance or a smaller board"
    )]
    TooFew {
        /// Views found.
        found: usize,
        /// Views requested.
        wanted: usize,
        /// The distance, millimetres.
        distance_mm: f64,
    },
}

/// A candidate view.
struct Candidate {
    cam_from_board: Isometry3<f64>,
    /// Cells of both images that contain corners.
    cells: [Cells; 2],
}

/// Selects views of a board, starting from one view of it.
///
/// # Errors
/// Fewer views than requested show the whole board.
pub fn propose(
    rig: &StereoRig,
    board: &Chessboard,
    first_look: &Pose<CamLeft, Board>,
    request: &ProposalRequest,
) -> Result<Views, ProposeError> {
    let first = first_look.isometry();
    let worlds = worlds(rig, first, request);
    let candidates: Vec<Candidate> = poses(rig, board, request.distance_m)
        .into_iter()
        .filter(|pose| worlds.iter().all(|world| world.shows(board, &(pose * first.inverse()))))
        .filter_map(|pose| candidate(rig, board, pose))
        .collect();
    let chosen = choose(&candidates, request.count);
    if chosen.len() < request.count {
        let distance_mm = request.distance_m * 1e3;
        return Err(ProposeError::TooFew { found: chosen.len(), wanted: request.count, distance_mm });
    }
    let covered =
        |side: usize| chosen.iter().map(|index| candidates[*index].cells[side]).fold(Cells::default(), Cells::with);
    let coverage = [0, 1].map(|side| covered(side).share());
    let poses = chosen.iter().map(|index| candidates[*index].cam_from_board).collect();
    // Board poses in the left camera frame.
    let cam_left_from_board = tour(first, poses).into_iter().map(Pose::from_isometry).collect();
    Ok(Views { cam_left_from_board, coverage })
}

/// A nominal stereo rig whose right camera pose is replaced by the one measured in one view of the board: the angles between
/// cameras that were mounted by hand are unknown. `None` if the corners do not determine the board pose in either image.
pub fn head_of_look(drawn: &StereoRig, board: &Chessboard, sightings: &[Sighting; 2]) -> Option<StereoRig> {
    let [left, right] = sightings;
    let cam_left_from_board = board_pose(drawn.left(), left, board)?;
    let cam_right_from_board = board_pose(drawn.right(), right, board)?;
    let cam_right_from_cam_left = Pose::from_isometry(cam_right_from_board * cam_left_from_board.inverse());
    StereoRig::new(*drawn.left(), *drawn.right(), cam_right_from_cam_left).ok()
}

/// One hypothesis of the real setup: the cameras, the first view, and the error of the camera pose on the arm.
struct World {
    cameras: [Camera; 2],
    right_from_left: Isometry3<f64>,
    first: Isometry3<f64>,
    error: Isometry3<f64>,
}

impl World {
    /// Whether the whole board is visible in both images after the requested motion `motion`.
    fn shows(&self, board: &Chessboard, motion: &Isometry3<f64>) -> bool {
        let cam_from_board = self.error * motion * self.error.inverse() * self.first;
        let poses = [cam_from_board, self.right_from_left * cam_from_board];
        self.cameras.iter().zip(poses).all(|(camera, pose)| {
            outline(board).into_iter().all(|point| {
                let pixel = camera.project(&(pose * point));
                pixel.is_some_and(|pixel| is_inside(camera, &pixel))
            })
        })
    }
}

fn is_inside(camera: &Camera, pixel: &Vector2<f64>) -> bool {
    let (width, height) = (f64::from(camera.size().width), f64::from(camera.size().height));
    let inside = |at: f64, length: f64| (MARGIN_PX..=length - 1.0 - MARGIN_PX).contains(&at);
    inside(pixel.x, width) && inside(pixel.y, height)
}

/// Corners and edge midpoints of the printed squares, which extend one square beyond the inner corners.
fn outline(board: &Chessboard) -> [Point3<f64>; 8] {
    let square = board.square_m();
    let (right, bottom) = (f64::from(board.columns()) * square, f64::from(board.rows()) * square);
    let (x, y) = (0.5 * (right - square), 0.5 * (bottom - square));
    let at = |x: f64, y: f64| Point3::new(x, y, 0.0);
    [
        at(-square, -square),
        at(right, -square),
        at(right, bottom),
        at(-square, bottom),
        at(x, -square),
        at(right, y),
        at(x, bottom),
        at(-square, y),
    ]
}

/// The nominal setup, and one with each kind of error.
fn worlds(rig: &StereoRig, first: &Isometry3<f64>, request: &ProposalRequest) -> Vec<World> {
    let world = |focal: f64, error: Isometry3<f64>| {
        let camera = |camera: &Camera| {
            let p = camera.pinhole();
            let pinhole = Pinhole { fx: p.fx * focal, fy: p.fy * focal, ..*p };
            // A camera with a slightly different focal length is as valid as the original one.
            Camera::new(camera.size(), pinhole, *camera.distortion()).unwrap_or(*camera)
        };
        let mut first = *first;
        first.translation.vector *= focal;
        let right_from_left = *rig.cam_right_from_cam_left().isometry();
        World { cameras: [camera(rig.left()), camera(rig.right())], right_from_left, first, error }
    };
    let error = |turn: Vector3<f64>, shift: Vector3<f64>| {
        Isometry3::from_parts((shift * request.guess_error_m).into(), so3::exp(&(turn * request.guess_error_rad)))
    };
    let mut errors = vec![Isometry3::identity()];
    for sign in [1.0, -1.0] {
        for axis in 0..3 {
            // Each rotation with a lateral shift to either side.
            let (turn, across) = (Vector3::ith(axis, sign), (axis + 1) % 3);
            errors.push(error(turn, Vector3::ith(across, 1.0)));
            errors.push(error(turn, Vector3::ith(across, -1.0)));
        }
    }
    let focals = [1.0 - request.focal_error, 1.0 + request.focal_error];
    errors.iter().flat_map(|error| focals.map(|focal| world(focal, *error))).collect()
}

/// All candidate views.
fn poses(rig: &StereoRig, board: &Chessboard, distance_m: f64) -> Vec<Isometry3<f64>> {
    let camera = rig.left();
    let size = camera.size();
    let middle = board.corner_in_board(board.columns() - 1, board.rows() - 1).coords * 0.5;
    let mut tilts = Vec::new();
    for tilt_deg in TILTS_DEG {
        let directions = if tilt_deg == 0.0 { 1 } else { TILT_DIRECTIONS };
        for direction in 0..directions {
            let way = std::f64::consts::TAU * f64::from(direction) / f64::from(TILT_DIRECTIONS);
            let tilt = tilt_deg.to_radians();
            tilts.push(so3::exp(&Vector3::new(tilt * way.cos(), tilt * way.sin(), 0.0)));
        }
    }
    let mut poses = Vec::new();
    for (row, column) in (0..PLACES[1]).flat_map(|row| (0..PLACES[0]).map(move |column| (row, column))) {
        let at = |index: u32, count: u32, length: u32| f64::from(length) * (f64::from(index) + 0.5) / f64::from(count);
        let pixel = Vector2::new(at(column, PLACES[0], size.width), at(row, PLACES[1], size.height));
        let Ok(ray) = camera.unproject(&pixel) else { continue };
        for distance in DISTANCES {
            for tilt in &tilts {
                for turn_deg in TURNS_DEG {
                    let turn = so3::exp(&Vector3::new(0.0, 0.0, turn_deg.to_radians()));
                    let to_middle = Isometry3::from_parts((ray * (distance * distance_m)).into(), tilt * turn);
                    poses.push(to_middle * Isometry3::translation(-middle.x, -middle.y, 0.0));
                }
            }
        }
    }
    poses
}

fn candidate(rig: &StereoRig, board: &Chessboard, cam_from_board: Isometry3<f64>) -> Option<Candidate> {
    let right = rig.cam_right_from_cam_left().isometry() * cam_from_board;
    let cells = |camera: &Camera, pose: &Isometry3<f64>| -> Option<Cells> {
        let places = (0..board.rows()).flat_map(|row| (0..board.columns()).map(move |column| (column, row)));
        let pixels = places.map(|(column, row)| camera.project(&(pose * board.corner_in_board(column, row))));
        pixels.map(|pixel| Some(cell_of(&pixel?, camera.size()))).collect()
    };
    let cells = [cells(rig.left(), &cam_from_board)?, cells(rig.right(), &right)?];
    Some(Candidate { cam_from_board, cells })
}

/// Greedy selection by new image cells and new orientations.
fn choose(candidates: &[Candidate], count: usize) -> Vec<usize> {
    let mut covered = [Cells::default(); 2];
    let mut nearest = vec![f64::INFINITY; candidates.len()];
    let mut chosen: Vec<usize> = Vec::new();
    while chosen.len() < count.min(candidates.len()) {
        let worth = |index: usize| {
            let new: u32 = candidates[index].cells.iter().zip(covered).map(|(own, all)| own.without(all).count()).sum();
            let orientation = (nearest[index] / NEW_ORIENTATION_RAD).min(1.0);
            f64::from(new) + NEW_ORIENTATION_CELLS * orientation
        };
        let left = (0..candidates.len()).filter(|index| !chosen.contains(index));
        let Some(best) = left.max_by(|a, b| worth(*a).total_cmp(&worth(*b))) else { break };
        for (covered, own) in covered.iter_mut().zip(candidates[best].cells) {
            *covered = covered.with(own);
        }
        for (nearest, candidate) in nearest.iter_mut().zip(candidates) {
            let rotation = candidate.cam_from_board.rotation;
            *nearest = nearest.min(rotation.angle_to(&candidates[best].cam_from_board.rotation));
        }
        chosen.push(best);
    }
    chosen
}

/// A short path through all views that begins at the first view: nearest neighbour, then improved by 2-opt.
fn tour(first: &Isometry3<f64>, mut poses: Vec<Isometry3<f64>>) -> Vec<Isometry3<f64>> {
    let way = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let apart = a * b.inverse();
        (a.translation.vector - b.translation.vector).norm() + WAY_M_PER_RAD * apart.rotation.angle()
    };
    let mut ordered = vec![*first];
    while !poses.is_empty() {
        let last = ordered[ordered.len() - 1];
        let nearest = (0..poses.len()).min_by(|a, b| way(&last, &poses[*a]).total_cmp(&way(&last, &poses[*b])));
        ordered.push(poses.swap_remove(nearest.unwrap_or(0)));
    }
    let mut is_shorter = true;
    while is_shorter {
        is_shorter = false;
        for from in 1..ordered.len() {
            for to in from + 1..ordered.len() {
                let end = |next: &Isometry3<f64>| ordered.get(to + 1).map_or(0.0, |after| way(next, after));
                let now = way(&ordered[from - 1], &ordered[from]) + end(&ordered[to]);
                let turned = way(&ordered[from - 1], &ordered[to]) + end(&ordered[from]);
                if turned < now - 1e-12 {
                    ordered[from..=to].reverse();
                    is_shorter = true;
                }
            }
        }
    }
    ordered.split_off(1)
}
