//! Hand-eye calibration: where the cameras sit on the arm that carries them, and where the board is.
//!
//! The corners of the board in both cameras and the poses that the robot states are adjusted together. A robot's pose is a
//! measurement with noise of its own: each stop's flange pose gets a correction, held by a prior. The stereo calibration is
//! known; what its errors do to the result is added to the covariance ([`CalibrationCovariance`]).
//!
//! The board is at rest in the room, or on the flange of the other arm; then the other arm's base and the board's pose on its
//! flange are unknowns, too. In the names here `base` and `flange` are those of the arm with the cameras (`vs`), `tc_base` and
//! `tc_flange` those of the other one.
//!
//! The robot knows metres. So the size of the squares, which images cannot tell, and the baseline are estimated as well,
//! to be judged: [`Scales`].

mod adjust;
pub mod gates;
mod model;
mod outliers;
pub mod propose;
mod start;
mod uncertain;

use nalgebra::{DMatrix, Isometry3, Point3, Vector6};
use pb3dp_geometry::frames::{Base, Board, CamLeft, Flange, TcBase, TcFlange};
use pb3dp_geometry::{Pose, StereoRig, se3};
use pb3dp_record::calibration_files::BoardPlace;

use crate::board::{Chessboard, Sighting};
use crate::start::board_pose;

use adjust::{Adjusted, adjust};
use model::{Corners, POSE, Place, SCALES, Seen, Setting, State};
pub use start::STOPS_MIN;
use start::{Poses, rests, rotation_spread_deg};
pub use uncertain::CalibrationCovariance;
use uncertain::Direction;

/// A corner is not known better than this, px: keeps weights finite where corners are exact.
const CORNER_SIGMA_MIN_PX: f64 = 1e-3;

/// One stop: what was seen, and where the arms said they were.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeStop {
    /// What it is called, for instance the name of its left image.
    pub name: String,
    /// What the left and the right camera saw.
    pub sightings: [Sighting; 2],
    /// The flange of the arm with the cameras, by its joints.
    pub base_from_flange: Pose<Base, Flange>,
    /// The flange of the other arm, by its joints, if there is one.
    pub tc_base_from_tc_flange: Option<Pose<TcBase, TcFlange>>,
}

/// How well an arm knows its flange: standard deviations of each of three directions and axes, from stop to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotSigma {
    /// Metres.
    pub translation_m: f64,
    /// Radians.
    pub rotation_rad: f64,
}

impl Default for RobotSigma {
    /// 0.1 mm, the repeatability of a PA-10, and 0.02 degrees.
    fn default() -> Self {
        Self { translation_m: 1e-4, rotation_rad: 0.02_f64.to_radians() }
    }
}

/// What a hand-eye calibration is made from.
#[derive(Clone, Copy, Debug)]
pub struct Given<'a> {
    /// The stereo head.
    pub rig: &'a StereoRig,
    /// What is known of the errors of the stereo head.
    pub rig_covariance: Option<&'a CalibrationCovariance>,
    /// The board.
    pub board: &'a Chessboard,
    /// The noise of the arms.
    pub robot: RobotSigma,
}

/// Why no hand-eye calibration came of the stops.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HandEyeError {
    /// Too few stops.
    #[error(
        "{seen} stops at which both cameras see the board, at least {STOPS_MIN} are needed, 15 are good: visit more poses"
    )]
    Stops {
        /// Stops that can be used.
        seen: usize,
    },
    /// A board that is taken for itself turned by half a turn.
    #[error(
        "a board of {columns} x {rows} corners looks the same after half a turn, so its pose cannot be told from stop to stop: use one with one odd and one even number of corners"
    )]
    Board {
        /// Inner corners along a row.
        columns: u32,
        /// Inner corners along a column.
        rows: u32,
    },
    /// A noise of the robot that cannot be.
    #[error(
        "the noise of the robot is given as {translation_mm} mm and {rotation_deg} degrees: both must be above zero"
    )]
    Robot {
        /// Millimetres.
        translation_mm: f64,
        /// Degrees.
        rotation_deg: f64,
    },
    /// A stop without the pose of the other arm, which has moved.
    #[error(
        "stop {stop:?} does not say where the arm tc was, and others say that it has moved: record all stops with both arms"
    )]
    NoTc {
        /// The stop.
        stop: String,
    },
    /// A board that a stop's cameras cannot place.
    #[error(
        "stop {stop:?}: no pose of the board explains its corners: does the stereo calibration belong to these cameras?"
    )]
    Unplaced {
        /// The stop.
        stop: String,
    },
    /// An arm that has turned about one axis only.
    #[error(
        "the arm {arm} has turned by {second_deg:.2} degrees rms about the axis that it used second most: its rotations must be about two axes at least, by 15 to 30 degrees each; let `pb3dp calibrate propose` choose the poses"
    )]
    Axes {
        /// Which arm.
        arm: &'static str,
        /// Rotations between stops about the second axis, root mean square, degrees.
        second_deg: f64,
    },
    /// Arms that always moved together.
    #[error(
        "there are fewer than three pairs of stops between which the arm {arm} has moved and the other one has not: visit some poses of each arm while the other one rests"
    )]
    OneAtATime {
        /// Which arm.
        arm: &'static str,
    },
    /// The stops leave something open.
    #[error(
        "the stops do not determine {parameter}: visit poses that differ in rotations about two axes, by 15 to 30 degrees, and in distance"
    )]
    Undetermined {
        /// The parameter that is least known.
        parameter: String,
    },
    /// A corner that should not be in sight.
    #[error(
        "a corner would lie behind a camera: the poses of the arm do not fit the images; do both belong to the same recording, and the stereo calibration to these cameras?"
    )]
    NotVisible,
    /// No end within the steps allowed.
    #[error("the adjustment did not settle within {steps} steps: visit more poses, with rotations about two axes")]
    NotSettled {
        /// Steps made.
        steps: usize,
    },
    /// No majority of stops agrees.
    #[error(
        "only {agree} of {all} stops agree with each other: was the board or a camera moved between the stops, or the arm recorded while it moved?"
    )]
    Contradiction {
        /// Stops that agree.
        agree: usize,
        /// All stops.
        all: usize,
    },
    /// A covariance of other numbers.
    #[error(
        "the covariance of the stereo calibration speaks of {found} and not of {expected}: calibrate the head anew with this version"
    )]
    RigCovariance {
        /// What it speaks of.
        found: String,
        /// What it should.
        expected: String,
    },
}

/// A factor of lengths, as the robot's metres have it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// True over stated length.
    pub factor: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// What the robot says of lengths that the cameras were told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Of the side of a square.
    pub squares: Scale,
    /// Of the baseline of the stereo calibration.
    pub baseline: Scale,
}

/// What one stop says of the others' calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct StopCheck {
    /// The stop.
    pub name: String,
    /// Whether it was used; if not, it disagrees with all others.
    pub used: bool,
    /// Where its cameras see the board, against where the calibration by all other stops says it is: distance of the board's middle, mm.
    pub left_out_mm: f64,
    /// The same, angle, degrees.
    pub left_out_deg: f64,
    /// The same in standard deviations of that difference, all six numbers together (Mahalanobis distance).
    pub left_out_sigmas: f64,
    /// Distance between predicted and seen corners, root mean square, px; none for a stop that was not used.
    pub corner_rms_px: Option<f64>,
}

/// A hand-eye calibration, with what is known about its errors.
#[derive(Clone, Debug)]
pub struct HandEyeFit {
    state: State,
    rig: StereoRig,
    /// The covariance without the errors of the head, and these.
    by_stops: DMatrix<f64>,
    by_head: Vec<Direction>,
    /// Names of the parameters: `flange_from_cam_left.x_m`; metres and radians. Each pose moves by `exp([x y z rx ry rz])` on its
    /// right side, in the frame it comes from.
    pub names: Vec<String>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Each stop.
    pub stops: Vec<StopCheck>,
    /// Standard deviation of a corner in a row or column, px, by each stop's corners alone.
    pub corner_sigma_px: f64,
    /// Distance between predicted and seen corners, root mean square over all stops that were used, px.
    pub corner_rms_px: f64,
    /// Noise of the arms as the stops show it, over the one that was stated.
    pub robot_noise_ratio: f64,
    /// What the robot says of lengths.
    pub scales: Scales,
    /// Rotations between stops about the axis that is used second most, root mean square, degrees: of the arm that turned least.
    pub rotation_spread_deg: f64,
}

impl HandEyeFit {
    /// Calibrates from stops with images of the board.
    ///
    /// # Errors
    /// Too few stops, stops that leave something open, or of which no majority agrees.
    pub fn new(stops: &[HandEyeStop], given: &Given<'_>) -> Result<Self, HandEyeError> {
        let RobotSigma { translation_m, rotation_rad } = given.robot;
        if !(translation_m > 0.0 && rotation_rad > 0.0 && translation_m.is_finite() && rotation_rad.is_finite()) {
            let (translation_mm, rotation_deg) = (translation_m * 1e3, rotation_rad.to_degrees());
            return Err(HandEyeError::Robot { translation_mm, rotation_deg });
        }
        let board = given.board;
        if !board.is_told_from_its_half_turn() {
            return Err(HandEyeError::Board { columns: board.columns(), rows: board.rows() });
        }
        if stops.len() < STOPS_MIN {
            return Err(HandEyeError::Stops { seen: stops.len() });
        }
        let seen = seen(stops)?;
        let robot_information = {
            let (t, r) = (translation_m.powi(-2), rotation_rad.powi(-2));
            nalgebra::Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r))
        };
        let setting = Setting { rig: given.rig, board, corner_sigma_px: 1.0, robot_information, scales_free: true };
        let alone = seen.iter().zip(stops).map(|(seen, stop)| alone(seen, stop, &setting));
        let alone = alone.collect::<Result<Vec<_>, _>>()?;
        let setting = Setting { corner_sigma_px: corner_sigma_px(alone.iter().map(|(_, corners)| corners)), ..setting };
        let checked = outliers::settle(&seen, &alone, &setting)?;
        let all = All { stops, seen: &seen, alone: &alone };
        Self::of(&all, checked, &setting, given.rig_covariance)
    }

    /// With the lengths taken as they were stated, from the stops that agree when lengths are free.
    fn of(
        all: &All<'_>,
        checked: outliers::Settled,
        setting: &Setting<'_>,
        rig_covariance: Option<&CalibrationCovariance>,
    ) -> Result<Self, HandEyeError> {
        let used: Vec<usize> = (0..all.seen.len()).filter(|index| checked.used[*index]).collect();
        let seen: Vec<Seen<'_>> = used.iter().map(|index| all.seen[*index].clone()).collect();
        let scales = scales(&checked.adjusted, checked.variance_factor, setting)?;
        let fixed = Setting { scales_free: false, ..setting.clone() };
        let start = State { scales: [1.0; SCALES], ..checked.adjusted.state };
        let adjusted = adjust(start, &seen, &fixed)?;
        let squares_alone: f64 = used.iter().map(|index| all.alone[*index].1.squares).sum();
        let factor = outliers::variance_factor(&adjusted, squares_alone, &fixed);
        let by_stops = adjusted.covariance_without(None, &fixed)? * factor;
        let by_rest = uncertain::rest_directions(&adjusted.state, &seen, &fixed, factor)?;
        let by_stops = by_rest.iter().fold(by_stops, |sum, step| sum + step * step.transpose());
        let by_head =
            rig_covariance.map(|covariance| uncertain::directions(&adjusted.state, &seen, &fixed, covariance));
        let by_head = by_head.transpose()?.unwrap_or_default();
        let steps = by_head.iter().map(Direction::step);
        let covariance = steps.fold(by_stops.clone(), |sum, step| sum + &step * step.transpose());
        let checks = outliers::checks(all.seen, all.alone, &checked.used, &adjusted, &fixed)?;
        let state = adjusted.state;
        let mut reports = Vec::with_capacity(all.stops.len());
        let (mut squares, mut count) = (0.0, 0_usize);
        for (index, (stop, check)) in all.stops.iter().zip(&checks).enumerate() {
            let at = used.iter().position(|used| *used == index);
            let of_stop = at.map(|at| {
                let cam_from_board = state.cam_from_board(&state.arms[at]);
                (all.seen[index].squares(&fixed, &cam_from_board, state.scales), all.alone[index].1.count)
            });
            squares += of_stop.map_or(0.0, |(squares, _)| squares);
            count += of_stop.map_or(0, |(_, count)| count);
            reports.push(StopCheck {
                name: stop.name.clone(),
                used: at.is_some(),
                left_out_mm: check.distance_m(setting.board) * 1e3,
                left_out_deg: check.angle_rad().to_degrees(),
                left_out_sigmas: check.squared_sigmas.sqrt(),
                corner_rms_px: of_stop.map(|(squares, count)| (squares / count.max(1) as f64).sqrt()),
            });
        }
        Ok(Self {
            names: state.shared_names(&fixed),
            covariance,
            rig: *setting.rig,
            by_stops,
            by_head,
            stops: reports,
            corner_sigma_px: setting.corner_sigma_px,
            corner_rms_px: (squares / count.max(1) as f64).sqrt(),
            robot_noise_ratio: factor.sqrt(),
            scales,
            rotation_spread_deg: spread_deg(&seen),
            state,
        })
    }

    /// The left camera on the flange.
    pub fn flange_from_cam_left(&self) -> Pose<Flange, CamLeft> {
        // Claimed by the chain of poses in `model`.
        Pose::from_isometry(self.state.flange_from_cam)
    }

    /// Where the board is.
    pub fn board(&self) -> BoardPlace {
        match self.state.place {
            Place::Room { base_from_board } => {
                BoardPlace::Room { base_from_board: Pose::from_isometry(base_from_board) }
            }
            Place::Carried { vs_base_from_tc_base, tc_flange_from_board } => BoardPlace::Carried {
                vs_base_from_tc_base: Pose::from_isometry(vs_base_from_tc_base),
                tc_flange_from_board: Pose::from_isometry(tc_flange_from_board),
            },
        }
    }

    /// Standard deviation of a parameter, metres or radians.
    pub fn sigma(&self, name: &str) -> Option<f64> {
        let index = self.names.iter().position(|other| other == name)?;
        Some(self.covariance[(index, index)].max(0.0).sqrt())
    }

    /// How far a point straight ahead of the left camera is expected to be from where the flange thinks it is, metres: one standard
    /// deviation in space (root of the three variances' sum). Its images in both cameras are taken as exact; an error of the head
    /// that the camera's pose on the flange makes good does not count.
    pub fn hand_error_m(&self, distance_m: f64) -> f64 {
        let point = Point3::new(0.0, 0.0, distance_m);
        let by = crate::adjust::point_by_motion(&point, &nalgebra::Matrix3::identity());
        let by_stops = (by * self.by_stops.fixed_view::<POSE, POSE>(0, 0) * by.transpose()).trace();
        let in_right = self.rig.cam_right_from_cam_left().transform_point(&point);
        let pixels = self.rig.left().project(&point).zip(self.rig.right().project(&in_right));
        let Some((left, right)) = pixels else { return f64::INFINITY };
        let by_head = self.by_head.iter().map(|direction| direction.point_step_m(&[left, right]).powi(2));
        (by_stops.max(0.0) + by_head.sum::<f64>()).sqrt()
    }

    /// Stops that were used.
    pub fn used(&self) -> impl Iterator<Item = &StopCheck> {
        self.stops.iter().filter(|stop| stop.used)
    }

    /// Stops that were not used because they disagree with all others.
    pub fn rejected(&self) -> impl Iterator<Item = &StopCheck> {
        self.stops.iter().filter(|stop| !stop.used)
    }
}

/// The stops in all three forms.
struct All<'a> {
    stops: &'a [HandEyeStop],
    seen: &'a [Seen<'a>],
    alone: &'a [(Poses, Corners)],
}

/// The board in the left camera by the corners in both images; `None` if no pose explains them.
pub fn place_board(rig: &StereoRig, board: &Chessboard, sightings: &[Sighting; 2]) -> Option<Pose<CamLeft, Board>> {
    let [left, right] = sightings;
    let seen = Seen { sightings: [left, right], vs: Isometry3::identity(), tc: None, rests: [None; 2] };
    let setting = Setting {
        rig,
        board,
        corner_sigma_px: 1.0,
        robot_information: nalgebra::Matrix6::identity(),
        scales_free: false,
    };
    let (cam_from_board, _) = seen.by_itself(&setting, board_pose(rig.left(), left, board)?, [1.0; SCALES])?;
    // What the corners are projected from.
    Some(Pose::from_isometry(cam_from_board))
}

/// Whether the other arm has moved between the stops, so that it is the one that carries the board.
pub fn tc_has_moved(stops: &[HandEyeStop]) -> bool {
    let mut poses = stops.iter().filter_map(|stop| stop.tc_base_from_tc_flange);
    let Some(first) = poses.next() else { return false };
    poses.any(|pose| !rests(first.isometry(), pose.isometry()))
}

fn seen(stops: &[HandEyeStop]) -> Result<Vec<Seen<'_>>, HandEyeError> {
    let carried = tc_has_moved(stops);
    let mut seen = Vec::with_capacity(stops.len());
    for stop in stops {
        let tc = match (carried, stop.tc_base_from_tc_flange) {
            (true, None) => return Err(HandEyeError::NoTc { stop: stop.name.clone() }),
            (true, Some(pose)) => Some(*pose.isometry()),
            (false, _) => None,
        };
        let [left, right] = &stop.sightings;
        seen.push(Seen { sightings: [left, right], vs: *stop.base_from_flange.isometry(), tc, rests: [None; 2] });
    }
    let places = [places(&seen, |seen| Some(seen.vs)), places(&seen, |seen| seen.tc)];
    for (index, seen) in seen.iter_mut().enumerate() {
        seen.rests = [0, 1].map(|arm| places[arm][index]);
    }
    Ok(seen)
}

/// Of each stop the number of the first one at which an arm was in the same place, if there are several such stops.
fn places(seen: &[Seen<'_>], pose: impl Fn(&Seen<'_>) -> Option<Isometry3<f64>>) -> Vec<Option<usize>> {
    let first = |stop: &Seen<'_>| {
        let here = pose(stop)?;
        seen.iter().position(|other| pose(other).is_some_and(|there| rests(&here, &there)))
    };
    let firsts: Vec<Option<usize>> = seen.iter().map(first).collect();
    let several = |place: &Option<usize>| firsts.iter().filter(|other| *other == place).count() > 1;
    firsts.iter().map(|place| place.filter(|_| several(place))).collect()
}

/// The board by the corners of one stop alone.
fn alone(seen: &Seen<'_>, stop: &HandEyeStop, setting: &Setting<'_>) -> Result<(Poses, Corners), HandEyeError> {
    let unplaced = || HandEyeError::Unplaced { stop: stop.name.clone() };
    let guess = board_pose(setting.rig.left(), seen.sightings[0], setting.board).ok_or_else(unplaced)?;
    let (cam_from_board, corners) = seen.by_itself(setting, guess, [1.0; SCALES]).ok_or_else(unplaced)?;
    Ok((Poses { vs: seen.vs, tc: seen.tc, cam_from_board }, corners))
}

/// Standard deviation of a corner by the stops' own fits, px.
fn corner_sigma_px<'a>(alone: impl Iterator<Item = &'a Corners>) -> f64 {
    let (squares, free) = alone.fold((0.0, 0_usize), |(squares, free), corners| {
        (squares + corners.squares, free + (2 * corners.count).saturating_sub(POSE))
    });
    (squares / free.max(1) as f64).sqrt().max(CORNER_SIGMA_MIN_PX)
}

/// The factors of squares and baseline, of an adjustment in which they are free.
fn scales(adjusted: &Adjusted, factor: f64, setting: &Setting<'_>) -> Result<Scales, HandEyeError> {
    let covariance = adjusted.covariance_without(None, setting)? * factor;
    let first = covariance.nrows() - SCALES;
    let scale = |index: usize| Scale {
        factor: adjusted.state.scales[index],
        sigma: covariance[(first + index, first + index)].max(0.0).sqrt(),
    };
    Ok(Scales { squares: scale(0), baseline: scale(1) })
}

/// Rotations about the second axis, of the arm that turned least.
fn spread_deg(seen: &[Seen<'_>]) -> f64 {
    let vs: Vec<Isometry3<f64>> = seen.iter().map(|seen| seen.vs).collect();
    let tc: Vec<Isometry3<f64>> = seen.iter().filter_map(|seen| seen.tc).collect();
    let of_vs = rotation_spread_deg(&vs);
    if tc.is_empty() { of_vs } else { of_vs.min(rotation_spread_deg(&tc)) }
}

/// The difference of two poses of the board, in its own frame.
#[derive(Clone, Copy, Debug)]
struct Difference {
    /// `expected * exp(by)` is what was seen.
    by: Vector6<f64>,
    /// Over its covariance: squared Mahalanobis distance.
    squared_sigmas: f64,
}

impl Difference {
    /// Of the board's middle, metres.
    fn distance_m(&self, board: &Chessboard) -> f64 {
        let middle = board.corner_in_board(board.columns() - 1, board.rows() - 1) * 0.5;
        (se3::exp(&self.by) * middle - middle).norm()
    }

    /// Radians.
    fn angle_rad(&self) -> f64 {
        self.by.fixed_rows::<3>(3).norm()
    }
}
