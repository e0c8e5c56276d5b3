//! Hand-eye calibration: the pose of the cameras on the arm that carries them, and the pose of the board.
//!
//! The board corners in both cameras and the reported robot poses are adjusted together. A robot pose is a noisy measurement: the
//! flange pose of each stop gets a correction, constrained by a prior. The stereo calibration is fixed; the effect of its errors
//! is added to the covariance ([`CalibrationCovariance`]).
//!
//! The board is either stationary in the room or mounted on the flange of the other arm. In the second case the base pose of the
//! other arm and the board pose on its flange are unknowns as well. In names, `base` and `flange` belong to the arm with the
//! cameras (`vs`), `tc_base` and `tc_flange` to the other arm.
//!
//! The robot provides absolute lengths. The size of the squares, which images cannot reveal, and the baseline are therefore
//! estimated as well and judged: [`Scales`].

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
use model::{BoardMount, Corners, POSE, SCALES, Setting, State, StopObservation};
pub use start::STOPS_MIN;
use start::{Poses, rests, rotation_spread_deg};
pub use uncertain::CalibrationCovariance;
use uncertain::Direction;

/// Lower limit of the corner noise, px; keeps weights finite if corners are exact.
const CORNER_SIGMA_MIN_PX: f64 = 1e-3;

/// One stop: the detected boards and the reported arm poses.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeStop {
    /// Name of the stop, for example the name of its left image.
    pub name: String,
    /// Detected corners in the left and right camera.
    pub sightings: [Sighting; 2],
    /// Flange pose of the arm with the cameras, from its joint positions.
    pub base_from_flange: Pose<Base, Flange>,
    /// Flange pose of the other arm, from its joint positions, if there is one.
    pub tc_base_from_tc_flange: Option<Pose<TcBase, TcFlange>>,
}

/// Noise of the flange pose from stop to stop: standard deviations per direction and per axis.
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

/// The inputs of a hand-eye calibration.
#[derive(Clone, Copy, Debug)]
pub struct Given<'a> {
    /// The stereo rig.
    pub rig: &'a StereoRig,
    /// Covariance of the stereo calibration, if known.
    pub rig_covariance: Option<&'a CalibrationCovariance>,
    /// The board.
    pub board: &'a Chessboard,
    /// The noise of the arms.
    pub robot: RobotSigma,
}

/// Why a hand-eye calibration failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HandEyeError {
    /// Too few stops.
    #[error(
        "only {observations} stops at which both cameras see the board, at least {STOPS_MIN} are needed, 15 are good; visit more poses"
    )]
    Stops {
        /// Usable stops.
        observations: usize,
    },
    /// A board that is symmetric under a half turn.
    #[error(
        "a board of {columns} x {rows} corners looks the same after half a turn, so its orientation is ambiguous; use a board with one odd and one even number of corners"
    )]
    Board {
        /// Inner corners along a row.
        columns: u32,
        /// Inner corners along a column.
        rows: u32,
    },
    /// A robot noise out of range.
    #[error("robot noise of {translation_mm} mm and {rotation_deg} degrees: both must be above zero")]
    Robot {
        /// Millimetres.
        translation_mm: f64,
        /// Degrees.
        rotation_deg: f64,
    },
    /// A stop without the pose of the other arm, although that arm has moved.
    #[error(
        "stop {stop:?} has no pose of the arm tc, although tc has moved between other stops; record all stops with both arms"
    )]
    NoTc {
        /// The stop.
        stop: String,
    },
    /// A stop at which no board pose fits the corners.
    #[error(
        "stop {stop:?}: no board pose fits the corners; check that the stereo calibration belongs to these cameras"
    )]
    Unplaced {
        /// The stop.
        stop: String,
    },
    /// An arm that has rotated about one axis only.
    #[error(
        "the arm {arm} has rotated by only {second_deg:.2} degrees rms about its second axis of rotation; rotate about at least two axes, by 15 to 30 degrees each; `pb3dp calibrate propose` chooses such poses"
    )]
    Axes {
        /// Which arm.
        arm: &'static str,
        /// Rotations between stops about the second axis of rotation, root mean square, degrees.
        second_deg: f64,
    },
    /// Arms that always moved together.
    #[error(
        "fewer than three pairs of stops between which only the arm {arm} has moved; visit some poses of each arm while the other arm is stationary"
    )]
    OneAtATime {
        /// Which arm.
        arm: &'static str,
    },
    /// The stops do not determine a parameter.
    #[error(
        "the stops do not determine {parameter}: visit poses that differ in rotations about two axes, by 15 to 30 degrees, and in distance"
    )]
    Undetermined {
        /// The least determined parameter.
        parameter: String,
    },
    /// A corner outside the field of view.
    #[error(
        "a corner lies behind a camera: the arm poses do not match the images; check that both belong to the same recording, and that the stereo calibration belongs to these cameras"
    )]
    NotVisible,
    /// No convergence within the allowed iterations.
    #[error("the adjustment did not converge within {steps} steps; visit more poses, with rotations about two axes")]
    NotSettled {
        /// Number of iterations.
        steps: usize,
    },
    /// No majority of stops agrees.
    #[error(
        "only {agree} of {all} stops agree with each other; check that board and cameras were not moved between the stops, and that the arm was stationary at each stop"
    )]
    Contradiction {
        /// Stops that agree.
        agree: usize,
        /// All stops.
        all: usize,
    },
    /// A covariance of other parameters.
    #[error(
        "the stereo calibration has the covariance parameters {found}, expected are {expected}; calibrate the stereo rig again with this version"
    )]
    RigCovariance {
        /// The parameters found.
        found: String,
        /// The expected parameters.
        expected: String,
    },
}

/// A length factor, with the robot as reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// True length divided by stated length.
    pub factor: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Factors of the lengths given to the cameras, with the robot as reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Factor of the side of a square.
    pub squares: Scale,
    /// Factor of the baseline of the stereo calibration.
    pub baseline: Scale,
}

/// One stop compared with the calibration from the other stops.
#[derive(Clone, Debug, PartialEq)]
pub struct StopCheck {
    /// The stop.
    pub name: String,
    /// Whether the stop was used; an unused stop disagrees with all others.
    pub used: bool,
    /// Distance between the board centre seen at this stop and the one predicted by the calibration from all other stops, mm.
    pub left_out_mm: f64,
    /// The same for the angle, degrees.
    pub left_out_deg: f64,
    /// The same in standard deviations of the difference, all six parameters together (Mahalanobis distance).
    pub left_out_sigmas: f64,
    /// Distance between predicted and detected corners, root mean square, px; none for an unused stop.
    pub corner_rms_px: Option<f64>,
}

/// A hand-eye calibration with its covariance.
#[derive(Clone, Debug)]
pub struct HandEyeFit {
    state: State,
    rig: StereoRig,
    /// The covariance without the errors of the stereo calibration, and these errors.
    by_stops: DMatrix<f64>,
    by_head: Vec<Direction>,
    /// Parameter names: `flange_from_cam_left.x_m`; metres and radians. Each pose is perturbed by `exp([x y z rx ry rz])` on its
    /// right side, in its source frame.
    pub names: Vec<String>,
    /// Covariance of the parameters.
    pub covariance: DMatrix<f64>,
    /// The results of each stop.
    pub stops: Vec<StopCheck>,
    /// Standard deviation of a corner in a row or column, px, from independent fits of each stop.
    pub corner_sigma_px: f64,
    /// Distance between predicted and detected corners, root mean square over all used stops, px.
    pub corner_rms_px: f64,
    /// Noise of the arms estimated from the stops, divided by the stated noise.
    pub robot_noise_ratio: f64,
    /// Length factors with the robot as reference.
    pub scales: Scales,
    /// Rotations between stops about the second axis of rotation, root mean square, degrees: of the arm that rotated least.
    pub rotation_spread_deg: f64,
}

impl HandEyeFit {
    /// Calibrates from stops with images of the board.
    ///
    /// # Errors
    /// Too few stops, a parameter that the stops do not determine, or no majority of agreeing stops.
    pub fn new(stops: &[HandEyeStop], given: &Given<'_>) -> Result<Self, HandEyeError> {
        let RobotSigma { translation_m, rotation_rad } = given.robot;
        if !(translation_m > 0.0 && rotation_rad > 0.0 && translation_m.is_finite() && rotation_rad.is_finite()) {
            let (translation_mm, rotation_deg) = (translation_m * 1e3, rotation_rad.to_degrees());
            return Err(HandEyeError::Robot { translation_mm, rotation_deg });
        }
        let board = given.board;
        if !board.has_unique_orientation() {
            return Err(HandEyeError::Board { columns: board.columns(), rows: board.rows() });
        }
        if stops.len() < STOPS_MIN {
            return Err(HandEyeError::Stops { observations: stops.len() });
        }
        let observations = observations(stops)?;
        let robot_information = {
            let (t, r) = (translation_m.powi(-2), rotation_rad.powi(-2));
            nalgebra::Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r))
        };
        let setting = Setting { rig: given.rig, board, corner_sigma_px: 1.0, robot_information, scales_free: true };
        let alone = observations.iter().zip(stops).map(|(observations, stop)| alone(observations, stop, &setting));
        let alone = alone.collect::<Result<Vec<_>, _>>()?;
        let setting = Setting { corner_sigma_px: corner_sigma_px(alone.iter().map(|(_, corners)| corners)), ..setting };
        let checked = outliers::settle(&observations, &alone, &setting)?;
        let all = All { stops, observations: &observations, alone: &alone };
        Self::of(&all, checked, &setting, given.rig_covariance)
    }

    /// Uses the stated lengths, with the stops that agree when the lengths are estimated.
    fn of(
        all: &All<'_>,
        checked: outliers::Settled,
        setting: &Setting<'_>,
        rig_covariance: Option<&CalibrationCovariance>,
    ) -> Result<Self, HandEyeError> {
        let used: Vec<usize> = (0..all.observations.len()).filter(|index| checked.used[*index]).collect();
        let observations: Vec<StopObservation<'_>> =
            used.iter().map(|index| all.observations[*index].clone()).collect();
        let scales = scales(&checked.adjusted, checked.variance_factor, setting)?;
        let fixed = Setting { scales_free: false, ..setting.clone() };
        let start = State { scales: [1.0; SCALES], ..checked.adjusted.state };
        let adjusted = adjust(start, &observations, &fixed)?;
        let squares_alone: f64 = used.iter().map(|index| all.alone[*index].1.squares).sum();
        let factor = outliers::variance_factor(&adjusted, squares_alone, &fixed);
        let by_stops = adjusted.covariance_without(None, &fixed)? * factor;
        let by_rest = uncertain::rest_directions(&adjusted.state, &observations, &fixed, factor)?;
        let by_stops = by_rest.iter().fold(by_stops, |sum, step| sum + step * step.transpose());
        let by_head =
            rig_covariance.map(|covariance| uncertain::directions(&adjusted.state, &observations, &fixed, covariance));
        let by_head = by_head.transpose()?.unwrap_or_default();
        let steps = by_head.iter().map(Direction::step);
        let covariance = steps.fold(by_stops.clone(), |sum, step| sum + &step * step.transpose());
        let checks = outliers::checks(all.observations, all.alone, &checked.used, &adjusted, &fixed)?;
        let state = adjusted.state;
        let mut reports = Vec::with_capacity(all.stops.len());
        let (mut squares, mut count) = (0.0, 0_usize);
        for (index, (stop, check)) in all.stops.iter().zip(&checks).enumerate() {
            let at = used.iter().position(|used| *used == index);
            let of_stop = at.map(|at| {
                let cam_from_board = state.cam_from_board(&state.arms[at]);
                (all.observations[index].squares(&fixed, &cam_from_board, state.scales), all.alone[index].1.count)
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
            rotation_spread_deg: spread_deg(&observations),
            state,
        })
    }

    /// Pose of the left camera on the flange.
    pub fn flange_from_cam_left(&self) -> Pose<Flange, CamLeft> {
        // The frames follow from the chain of poses in `model`.
        Pose::from_isometry(self.state.flange_from_cam)
    }

    /// Pose of the board.
    pub fn board(&self) -> BoardPlace {
        match self.state.place {
            BoardMount::Room { base_from_board } => {
                BoardPlace::Room { base_from_board: Pose::from_isometry(base_from_board) }
            }
            BoardMount::Carried { vs_base_from_tc_base, tc_flange_from_board } => BoardPlace::Carried {
                vs_base_from_tc_base: Pose::from_isometry(vs_base_from_tc_base),
                tc_flange_from_board: Pose::from_isometry(tc_flange_from_board),
            },
        }
    }

    /// All estimated poses by name: that of the cameras, then those of the board.
    pub fn poses(&self) -> Vec<(&'static str, Isometry3<f64>)> {
        self.state.poses()
    }

    /// Standard deviation of a parameter, metres or radians.
    pub fn sigma(&self, name: &str) -> Option<f64> {
        let index = self.names.iter().position(|other| other == name)?;
        Some(self.covariance[(index, index)].max(0.0).sqrt())
    }

    /// Expected position error on the flange of a point straight ahead of the left camera, metres: one standard deviation in
    /// space (root of the sum of the three variances). The image points in both cameras are assumed exact. An error of the stereo
    /// calibration that the camera pose on the flange compensates does not count.
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

    /// The used stops.
    pub fn used(&self) -> impl Iterator<Item = &StopCheck> {
        self.stops.iter().filter(|stop| stop.used)
    }

    /// The stops rejected because they disagree with all others.
    pub fn rejected(&self) -> impl Iterator<Item = &StopCheck> {
        self.stops.iter().filter(|stop| !stop.used)
    }
}

/// The stops in all three representations.
struct All<'a> {
    stops: &'a [HandEyeStop],
    observations: &'a [StopObservation<'a>],
    alone: &'a [(Poses, Corners)],
}

/// The board pose in the left camera from the corners in both images; `None` if no pose fits them.
pub fn place_board(rig: &StereoRig, board: &Chessboard, sightings: &[Sighting; 2]) -> Option<Pose<CamLeft, Board>> {
    let [left, right] = sightings;
    let observations =
        StopObservation { sightings: [left, right], vs: Isometry3::identity(), tc: None, rests: [None; 2] };
    let setting = Setting {
        rig,
        board,
        corner_sigma_px: 1.0,
        robot_information: nalgebra::Matrix6::identity(),
        scales_free: false,
    };
    let (cam_from_board, _) = observations.by_itself(&setting, board_pose(rig.left(), left, board)?, [1.0; SCALES])?;
    // Initial pose for the projection of the corners.
    Some(Pose::from_isometry(cam_from_board))
}

/// Whether the other arm has moved between the stops, which means that it carries the board.
pub fn tc_has_moved(stops: &[HandEyeStop]) -> bool {
    let mut poses = stops.iter().filter_map(|stop| stop.tc_base_from_tc_flange);
    let Some(first) = poses.next() else { return false };
    poses.any(|pose| !rests(first.isometry(), pose.isometry()))
}

fn observations(stops: &[HandEyeStop]) -> Result<Vec<StopObservation<'_>>, HandEyeError> {
    let carried = tc_has_moved(stops);
    let mut observations = Vec::with_capacity(stops.len());
    for stop in stops {
        let tc = match (carried, stop.tc_base_from_tc_flange) {
            (true, None) => return Err(HandEyeError::NoTc { stop: stop.name.clone() }),
            (true, Some(pose)) => Some(*pose.isometry()),
            (false, _) => None,
        };
        let [left, right] = &stop.sightings;
        observations.push(StopObservation {
            sightings: [left, right],
            vs: *stop.base_from_flange.isometry(),
            tc,
            rests: [None; 2],
        });
    }
    let places = [
        places(&observations, |observations| Some(observations.vs)),
        places(&observations, |observations| observations.tc),
    ];
    for (index, observations) in observations.iter_mut().enumerate() {
        observations.rests = [0, 1].map(|arm| places[arm][index]);
    }
    Ok(observations)
}

/// For each stop, the number of the first stop with the same arm pose, if several stops share the pose.
fn places(
    observations: &[StopObservation<'_>],
    pose: impl Fn(&StopObservation<'_>) -> Option<Isometry3<f64>>,
) -> Vec<Option<usize>> {
    let first = |stop: &StopObservation<'_>| {
        let here = pose(stop)?;
        observations.iter().position(|other| pose(other).is_some_and(|there| rests(&here, &there)))
    };
    let firsts: Vec<Option<usize>> = observations.iter().map(first).collect();
    let several = |place: &Option<usize>| firsts.iter().filter(|other| *other == place).count() > 1;
    firsts.iter().map(|place| place.filter(|_| several(place))).collect()
}

/// The board pose from the corners of one stop only.
fn alone(
    observations: &StopObservation<'_>,
    stop: &HandEyeStop,
    setting: &Setting<'_>,
) -> Result<(Poses, Corners), HandEyeError> {
    let unplaced = || HandEyeError::Unplaced { stop: stop.name.clone() };
    let guess = board_pose(setting.rig.left(), observations.sightings[0], setting.board).ok_or_else(unplaced)?;
    let (cam_from_board, corners) = observations.by_itself(setting, guess, [1.0; SCALES]).ok_or_else(unplaced)?;
    Ok((Poses { vs: observations.vs, tc: observations.tc, cam_from_board }, corners))
}

/// Standard deviation of a corner from independent fits of each stop, px.
fn corner_sigma_px<'a>(alone: impl Iterator<Item = &'a Corners>) -> f64 {
    let (squares, free) = alone.fold((0.0, 0_usize), |(squares, free), corners| {
        (squares + corners.squares, free + (2 * corners.count).saturating_sub(POSE))
    });
    (squares / free.max(1) as f64).sqrt().max(CORNER_SIGMA_MIN_PX)
}

/// The factors of squares and baseline, from an adjustment that estimates them.
fn scales(adjusted: &Adjusted, factor: f64, setting: &Setting<'_>) -> Result<Scales, HandEyeError> {
    let covariance = adjusted.covariance_without(None, setting)? * factor;
    let first = covariance.nrows() - SCALES;
    let scale = |index: usize| Scale {
        factor: adjusted.state.scales[index],
        sigma: covariance[(first + index, first + index)].max(0.0).sqrt(),
    };
    Ok(Scales { squares: scale(0), baseline: scale(1) })
}

/// Rotations about the second axis, of the arm that rotated least.
fn spread_deg(observations: &[StopObservation<'_>]) -> f64 {
    let vs: Vec<Isometry3<f64>> = observations.iter().map(|observations| observations.vs).collect();
    let tc: Vec<Isometry3<f64>> = observations.iter().filter_map(|observations| observations.tc).collect();
    let of_vs = rotation_spread_deg(&vs);
    if tc.is_empty() { of_vs } else { of_vs.min(rotation_spread_deg(&tc)) }
}

/// The difference of two board poses, in the board frame.
#[derive(Clone, Copy, Debug)]
struct Difference {
    /// `expected * exp(by)` is the observed pose.
    by: Vector6<f64>,
    /// Squared Mahalanobis distance.
    squared_sigmas: f64,
}

impl Difference {
    /// Distance of the board centres, metres.
    fn distance_m(&self, board: &Chessboard) -> f64 {
        let middle = board.corner_in_board(board.columns() - 1, board.rows() - 1) * 0.5;
        (se3::exp(&self.by) * middle - middle).norm()
    }

    /// Radians.
    fn angle_rad(&self) -> f64 {
        self.by.fixed_rows::<3>(3).norm()
    }
}
