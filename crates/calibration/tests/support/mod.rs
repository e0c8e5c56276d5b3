//! Simulated stereo rigs with exact ground truth.

use nalgebra::{Isometry3, Vector2, Vector3, Vector6};
use pb3dp_calibration::board::{BoardCorner, Chessboard, Sighting};
use pb3dp_calibration::fit::View;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig, se3, so3};
use pb3dp_record::metrics::percentile;
use pb3dp_sim::noise::{hash, unit};

pub const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

/// A deterministic random number generator.
pub struct Random {
    seed: u32,
    count: u32,
}

impl Random {
    pub fn new(seed: u32) -> Self {
        Self { seed, count: 0 }
    }

    /// Uniform between two numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        self.count += 1;
        low + (high - low) * unit(hash(&[self.seed, self.count]))
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.between(1e-9, 1.0).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.between(0.0, 1.0)).cos()
    }
}

/// Median and 95th percentile of a list.
pub fn median_and_p95(values: &[f64]) -> [f64; 2] {
    [50.0, 95.0].map(|percent| percentile(values, percent).expect("values"))
}

/// The defects of a simulated session.
#[derive(Clone, Copy, Debug)]
pub struct Session {
    pub views: usize,
    /// Standard deviation of a corner, px.
    pub corner_sigma_px: f64,
    /// Relative increase of the right camera's focal length from the middle of the session on.
    pub refocused: f64,
    /// Displacement of the board between the two exposures, m, in a different direction in each view.
    pub moved_between_cameras_m: f64,
    /// Bow and twist of the board: distance between the two planes that enclose its corners, m.
    pub flatness_m: f64,
    /// Motion blur: the longest streak, px, in a different direction in each view.
    pub streak_max_px: f64,
    /// The largest tilt of the board, radians; 0.7 if this is 0.
    pub tilt_max_rad: f64,
}

impl Session {
    /// A careful session with a flat board, corners accurate to 0.1 px.
    pub const GOOD: Self = Self {
        views: 15,
        corner_sigma_px: 0.1,
        refocused: 0.0,
        moved_between_cameras_m: 0.0,
        flatness_m: 0.0,
        streak_max_px: 0.0,
        tilt_max_rad: 0.0,
    };
}

/// A board that is not flat.
struct Shape {
    bow_m: f64,
    twist_m: f64,
    /// True side of a square divided by the stated one.
    squares: f64,
}

/// Effect of a moving board on the corners of one image.
struct Streak {
    direction: Vector2<f64>,
    sigma_px: f64,
    shift_px: f64,
}

pub fn board() -> Chessboard {
    Chessboard::new(9, 6, 0.025).expect("a board")
}

/// A stereo rig with two different cameras, slightly rotated relative to each other.
pub fn rig(random: &mut Random) -> StereoRig {
    let focal = random.between(500.0, 900.0);
    let mut camera = || {
        let fx = focal * random.between(0.98, 1.02);
        let pinhole = Pinhole {
            fx,
            fy: fx * random.between(0.995, 1.005),
            cx: random.between(300.0, 340.0),
            cy: random.between(220.0, 260.0),
        };
        let coefficients = [
            random.between(-0.35, 0.05),
            random.between(-0.05, 0.15),
            random.between(-0.001, 0.001),
            random.between(-0.001, 0.001),
            0.0,
        ];
        Camera::new(SIZE, pinhole, Distortion::BrownConrady5 { coefficients }).expect("a camera")
    };
    let (left, right) = (camera(), camera());
    let mut angle = |degrees: f64| random.between(-degrees, degrees).to_radians();
    let turn = Vector3::new(angle(1.5), angle(1.0) + 0.05, angle(1.5));
    let baseline_m = random.between(0.06, 0.14);
    let shift = Vector3::new(-baseline_m, random.between(-0.003, 0.003), random.between(-0.004, 0.004));
    StereoRig::new(left, right, Pose::from_parts(shift, so3::exp(&turn))).expect("a head")
}

/// Views of the board by both cameras of a rig, spread over the image, tilted and rotated; boards that leave an image are
/// skipped.
pub fn views(rig: &StereoRig, session: &Session, random: &mut Random) -> Vec<View<2>> {
    views_of(&board(), rig, session, 1.0, random)
}

/// The same for any board, with at least a given share of it visible to both cameras.
pub fn views_of(
    board: &Chessboard,
    rig: &StereoRig,
    session: &Session,
    share_min: f64,
    random: &mut Random,
) -> Vec<View<2>> {
    let outside_max = ((1.0 - share_min) * board.corner_count() as f64) as usize;
    let (share, signs) = (random.between(0.0, 1.0), [random.between(-1.0, 1.0), random.between(-1.0, 1.0)]);
    let shape = Shape {
        bow_m: session.flatness_m * share.copysign(signs[0]),
        twist_m: 0.5 * session.flatness_m * (1.0 - share).copysign(signs[1]),
        squares: 1.0,
    };
    let mut views = Vec::with_capacity(session.views);
    while views.len() < session.views {
        let late = views.len() >= session.views / 2;
        let right = if late { with_focal(rig.right(), 1.0 + session.refocused) } else { *rig.right() };
        let cam_left_from_board = placed(rig, board, session, random);
        let moved = Vector3::from_fn(|_, _| random.normal()).normalize() * session.moved_between_cameras_m;
        let cam_right_from_board = rig.cam_right_from_cam_left().isometry()
            * Isometry3::translation(moved.x, moved.y, moved.z)
            * cam_left_from_board;
        let (way, length_px) =
            (random.between(0.0, std::f64::consts::TAU), session.streak_max_px * random.between(0.4, 1.0));
        // The detected edge position of a streak varies with its length, differently in the two cameras.
        let mut streak = || Streak {
            direction: Vector2::new(way.cos(), way.sin()),
            sigma_px: 0.15 * length_px,
            shift_px: 0.05 * length_px * random.normal(),
        };
        let streaks = [streak(), streak()];
        let mut project_board = |camera: &Camera, pose: &Isometry3<f64>, streak: &Streak| {
            sighting(
                camera,
                pose,
                (board, outside_max),
                &shape,
                |random| {
                    let noise = Vector2::new(random.normal(), random.normal()) * session.corner_sigma_px;
                    noise + streak.direction * (streak.shift_px + streak.sigma_px * random.normal())
                },
                random,
            )
        };
        let project_board = [
            project_board(rig.left(), &cam_left_from_board, &streaks[0]),
            project_board(&right, &cam_right_from_board, &streaks[1]),
        ];
        if let [Some(left), Some(right)] = project_board {
            views.push(View { name: format!("{:02}", views.len()), sightings: [left, right] });
        }
    }
    views
}

/// The detections of a flat board by both cameras, with the standard deviation of a corner and the true side of a square divided by the
/// stated one; `None` if it leaves an image.
pub fn detected_by_both(
    rig: &StereoRig,
    cam_left_from_board: &Isometry3<f64>,
    (corner_sigma_px, squares): (f64, f64),
    random: &mut Random,
) -> Option<[Sighting; 2]> {
    let board = board();
    let cam_right_from_board = rig.cam_right_from_cam_left().isometry() * cam_left_from_board;
    let flat = Shape { bow_m: 0.0, twist_m: 0.0, squares };
    let noise = |random: &mut Random| Vector2::new(random.normal(), random.normal()) * corner_sigma_px;
    let left = sighting(rig.left(), cam_left_from_board, (&board, 0), &flat, noise, random)?;
    Some([left, sighting(rig.right(), &cam_right_from_board, (&board, 0), &flat, noise, random)?])
}

/// The camera with another focal length.
pub fn with_focal(camera: &Camera, factor: f64) -> Camera {
    let p = camera.pinhole();
    let pinhole = Pinhole { fx: p.fx * factor, fy: p.fy * factor, ..*p };
    Camera::new(camera.size(), pinhole, *camera.distortion()).expect("a camera")
}

/// The board centre on the ray of a random pixel, the board filling a fifth to three quarters of the image width.
pub fn placed(rig: &StereoRig, board: &Chessboard, session: &Session, random: &mut Random) -> Isometry3<f64> {
    let middle = board.corner_in_board(board.columns() - 1, board.rows() - 1).coords * 0.5;
    let distance_m = 2.0 * middle.x * rig.left().pinhole().fx / (random.between(0.3, 0.75) * f64::from(SIZE.width));
    let pixel = Vector2::new(random.between(60.0, 580.0), random.between(50.0, 430.0));
    let ray = rig.left().unproject(&pixel).expect("inside the image");
    let tilt_max_rad = if session.tilt_max_rad > 0.0 { session.tilt_max_rad } else { 0.7 };
    let (tilt, way) = (random.between(0.0, tilt_max_rad), random.between(0.0, std::f64::consts::TAU));
    let turn = so3::exp(&Vector3::new(tilt * way.cos(), tilt * way.sin(), random.between(-0.5, 0.5)));
    let to_middle = Isometry3::from_parts((ray * distance_m).into(), turn);
    to_middle * Isometry3::translation(-middle.x, -middle.y, 0.0)
}

fn sighting(
    camera: &Camera,
    cam_from_board: &Isometry3<f64>,
    (board, outside_max): (&Chessboard, usize),
    shape: &Shape,
    noise: impl Fn(&mut Random) -> Vector2<f64>,
    random: &mut Random,
) -> Option<Sighting> {
    let (mut corners, mut outside) = (Vec::with_capacity(board.corner_count()), 0);
    for (column, row) in (0..board.rows()).flat_map(|row| (0..board.columns()).map(move |column| (column, row))) {
        let mut in_board = board.corner_in_board(column, row) * shape.squares;
        let share = |at: u32, all: u32| 2.0 * f64::from(at) / f64::from(all - 1) - 1.0;
        let (u, v) = (share(column, board.columns()), share(row, board.rows()));
        in_board.z = shape.bow_m * (1.0 - u * u) * (1.0 - v * v) + shape.twist_m * u * v;
        let noise = noise(random);
        let inside = |pixel: &Vector2<f64>| (8.0..632.0).contains(&pixel.x) && (8.0..472.0).contains(&pixel.y);
        match camera.project(&(cam_from_board * in_board)).filter(inside) {
            Some(pixel) => corners.push(BoardCorner { column, row, pixel: pixel + noise }),
            None => outside += 1,
        }
        if outside > outside_max {
            return None;
        }
    }
    Some(Sighting::new(corners))
}

/// Error of every shared parameter in units of its stated standard deviation, in the order of the covariance.
pub fn normalised_errors(fit: &pb3dp_calibration::fit::Fit<2>, truth: &StereoRig) -> Vec<(String, f64)> {
    let rig = fit.rig().expect("a head");
    let mut errors = Vec::new();
    for (found, truth) in [(rig.left(), truth.left()), (rig.right(), truth.right())] {
        let (a, b) = (found.pinhole(), truth.pinhole());
        errors.extend([a.fx - b.fx, a.fy - b.fy, a.cx - b.cx, a.cy - b.cy]);
        let coefficients = found.distortion().coefficients().iter().zip(truth.distortion().coefficients());
        errors.extend(coefficients.take(fit.lens().coefficient_count()).map(|(a, b)| a - b));
    }
    // found = exp(xi) truth.
    let xi: Vector6<f64> =
        se3::log(&(rig.cam_right_from_cam_left().isometry() * truth.cam_right_from_cam_left().isometry().inverse()));
    errors.extend(xi.iter());
    let names = fit.covariance().names.iter();
    names
        .zip(errors)
        .map(|(name, error)| (name.clone(), error / fit.covariance().sigma(name).expect("named")))
        .collect()
}
