//! Which views of the board a calibration wants: the board whole in both images, everywhere in them, tilted and turned.
//!
//! From a first look at the board each wanted view is a motion `M` of the board as the left camera sees it. Whoever carries it
//! out knows the camera's pose on the arm only roughly: with an error `E` of that pose the board moves by `E M E^-1` instead.
//! So the views are tried with such errors, and with a wrong focal length, before they are proposed.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use pb3dp_geometry::frames::{Board, CamLeft};
use pb3dp_geometry::{Camera, Pinhole, Pose, StereoRig, so3};

use crate::board::{Chessboard, Sighting};
use crate::stand::{CELLS, cell_of};
use crate::start::board_pose;

/// The distances that are tried, as shares of the wanted one.
const DISTANCES: [f64; 4] = [0.8, 1.0, 1.25, 1.5];
/// Tilts of the board against the axis of the camera, degrees, and how many directions of tilt there are.
const TILTS_DEG: [f64; 4] = [0.0, 15.0, 22.0, 30.0];
const TILT_DIRECTIONS: u32 = 8;
/// Turns about the viewing axis, degrees.
const TURNS_DEG: [f64; 5] = [0.0, -15.0, 15.0, -30.0, 30.0];
/// Places of the board's middle in the left image.
const PLACES: [u32; 2] = [7, 5];
/// The board's border stays so far inside of the images, px.
const MARGIN_PX: f64 = 5.0;
/// Orientations that differ by more are as good as new ones, radians.
const NEW_ORIENTATION_RAD: f64 = 0.35;
/// What an orientation that is new is worth, in cells of the images.
const NEW_ORIENTATION_CELLS: f64 = 6.0;
/// A turn by a radian is as far as so many metres.
const WAY_M_PER_RAD: f64 = 0.5;

/// What is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish {
    /// Views.
    pub count: usize,
    /// From the left camera to the board's middle, metres.
    pub distance_m: f64,
    /// How wrong the pose of the camera on the arm may be: metres, in any direction.
    pub guess_error_m: f64,
    /// The same, radians, about any axis.
    pub guess_error_rad: f64,
    /// How wrong the focal length may be, as a share.
    pub focal_error: f64,
}

/// Views that were chosen.
#[derive(Clone, Debug)]
pub struct Views {
    /// The board as the left camera is to see it, in the order of a short way that begins at the first look.
    pub cam_left_from_board: Vec<Pose<CamLeft, Board>>,
    /// Share of the cells of the left and of the right image in which a corner will be seen.
    pub coverage: [f64; 2],
}

/// Why no views could be proposed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProposeError {
    /// Too few views in which the board is whole.
    #[error(
        "only {found} views {distance_mm:.0} mm away keep the board whole in both images, {wanted} are wanted: name a larger --distance, or take a smaller board"
    )]
    TooFew {
        /// Views that were found.
        found: usize,
        /// Views that are wanted.
        wanted: usize,
        /// The distance, millimetres.
        distance_mm: f64,
    },
}

/// A view that may be chosen.
struct Candidate {
    cam_from_board: Isometry3<f64>,
    /// Cells of both images in which corners are seen.
    cells: Vec<usize>,
}

/// Chooses views of a board from a first look at it.
///
/// # Errors
/// Fewer views than wanted that keep the board whole.
pub fn propose(
    rig: &StereoRig,
    board: &Chessboard,
    first_look: &Pose<CamLeft, Board>,
    wish: &Wish,
) -> Result<Views, ProposeError> {
    let first = first_look.isometry();
    let worlds = worlds(rig, first, wish);
    let candidates: Vec<Candidate> = poses(rig, board, wish.distance_m)
        .into_iter()
        .filter(|pose| worlds.iter().all(|world| world.shows(board, &(pose * first.inverse()))))
        .filter_map(|pose| candidate(rig, board, pose))
        .collect();
    let chosen = choose(&candidates, wish.count);
    if chosen.len() < wish.count {
        let distance_mm = wish.distance_m * 1e3;
        return Err(ProposeError::TooFew { found: chosen.len(), wanted: wish.count, distance_mm });
    }
    let mut seen: Vec<usize> = chosen.iter().flat_map(|index| candidates[*index].cells.iter().copied()).collect();
    seen.sort_unstable();
    seen.dedup();
    let cells = CELLS[0] * CELLS[1];
    let share =
        |of_eye: &dyn Fn(&usize) -> bool| seen.iter().filter(|cell| of_eye(cell)).count() as f64 / f64::from(cells);
    let coverage = [share(&|index| *index < cells as usize), share(&|index| *index >= cells as usize)];
    let poses = chosen.iter().map(|index| candidates[*index].cam_from_board).collect();
    // Views of the board as the left camera sees it.
    let cam_left_from_board = tour(first, poses).into_iter().map(Pose::from_isometry).collect();
    Ok(Views { cam_left_from_board, coverage })
}

/// A head of which only a drawing is known, with its right camera where one look at the board shows it: of cameras that are screwed on by
/// hand nobody knows the angles to each other. `None` if the corners do not determine the board's pose in either image.
pub fn head_of_look(drawn: &StereoRig, board: &Chessboard, sightings: &[Sighting; 2]) -> Option<StereoRig> {
    let [left, right] = sightings;
    let cam_left_from_board = board_pose(drawn.left(), left, board)?;
    let cam_right_from_board = board_pose(drawn.right(), right, board)?;
    let cam_right_from_cam_left = Pose::from_isometry(cam_right_from_board * cam_left_from_board.inverse());
    StereoRig::new(*drawn.left(), *drawn.right(), cam_right_from_cam_left).ok()
}

/// How everything may really be: the cameras, the first look, and the error of the camera's pose on the arm.
struct World {
    cameras: [Camera; 2],
    right_from_left: Isometry3<f64>,
    first: Isometry3<f64>,
    error: Isometry3<f64>,
}

impl World {
    /// Whether the board is whole in both images after a motion that was wanted to be `motion`.
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

/// Corners and middles of the sides of the printed squares, which reach one square farther than the inner corners.
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

/// As it is thought to be, and with each kind of error.
fn worlds(rig: &StereoRig, first: &Isometry3<f64>, wish: &Wish) -> Vec<World> {
    let world = |focal: f64, error: Isometry3<f64>| {
        let camera = |camera: &Camera| {
            let p = camera.pinhole();
            let pinhole = Pinhole { fx: p.fx * focal, fy: p.fy * focal, ..*p };
            // A focal length a little longer is as possible as the one it comes from.
            Camera::new(camera.size(), pinhole, *camera.distortion()).unwrap_or(*camera)
        };
        let mut first = *first;
        first.translation.vector *= focal;
        let right_from_left = *rig.cam_right_from_cam_left().isometry();
        World { cameras: [camera(rig.left()), camera(rig.right())], right_from_left, first, error }
    };
    let error = |turn: Vector3<f64>, shift: Vector3<f64>| {
        Isometry3::from_parts((shift * wish.guess_error_m).into(), so3::exp(&(turn * wish.guess_error_rad)))
    };
    let mut errors = vec![Isometry3::identity()];
    for sign in [1.0, -1.0] {
        for axis in 0..3 {
            // Each turn with a shift across it to either side.
            let (turn, across) = (Vector3::ith(axis, sign), (axis + 1) % 3);
            errors.push(error(turn, Vector3::ith(across, 1.0)));
            errors.push(error(turn, Vector3::ith(across, -1.0)));
        }
    }
    let focals = [1.0 - wish.focal_error, 1.0 + wish.focal_error];
    errors.iter().flat_map(|error| focals.map(|focal| world(focal, *error))).collect()
}

/// All views that are considered.
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
    let mut cells = Vec::new();
    let per_image = (CELLS[0] * CELLS[1]) as usize;
    let right = rig.cam_right_from_cam_left().isometry() * cam_from_board;
    for (eye, (camera, pose)) in [(rig.left(), cam_from_board), (rig.right(), right)].into_iter().enumerate() {
        for (row, column) in (0..board.rows()).flat_map(|row| (0..board.columns()).map(move |column| (row, column))) {
            let pixel = camera.project(&(pose * board.corner_in_board(column, row)))?;
            let [across, down] = cell_of(&pixel, camera.size());
            cells.push(eye * per_image + (down * CELLS[0] + across) as usize);
        }
    }
    cells.sort_unstable();
    cells.dedup();
    Some(Candidate { cam_from_board, cells })
}

/// One after the other, what is newest: cells of the images, and orientations.
fn choose(candidates: &[Candidate], count: usize) -> Vec<usize> {
    let cells = 2 * (CELLS[0] * CELLS[1]) as usize;
    let mut seen = vec![false; cells];
    let mut nearest = vec![f64::INFINITY; candidates.len()];
    let mut chosen: Vec<usize> = Vec::new();
    while chosen.len() < count.min(candidates.len()) {
        let worth = |index: usize| {
            let new = candidates[index].cells.iter().filter(|cell| !seen[**cell]).count() as f64;
            let orientation = (nearest[index] / NEW_ORIENTATION_RAD).min(1.0);
            new + NEW_ORIENTATION_CELLS * orientation
        };
        let left = (0..candidates.len()).filter(|index| !chosen.contains(index));
        let Some(best) = left.max_by(|a, b| worth(*a).total_cmp(&worth(*b))) else { break };
        for cell in &candidates[best].cells {
            seen[*cell] = true;
        }
        for (nearest, candidate) in nearest.iter_mut().zip(candidates) {
            let rotation = candidate.cam_from_board.rotation;
            *nearest = nearest.min(rotation.angle_to(&candidates[best].cam_from_board.rotation));
        }
        chosen.push(best);
    }
    chosen
}

/// A short way through all views that begins at the first look: always to the nearest one, then with detours taken out (2-opt).
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
