//! The chain of poses from the board to the cameras, the information of each stop about it, and its derivatives.
//!
//! At a stop the board is seen at `cam_left_from_board = X^-1 F^-1 Y`: `X` is the camera on the flange, `F` the flange in the
//! base, `Y` the board in the base. For a board on the other arm `Y` is `Z G W` (its base, its flange, the board on it). All
//! poses are perturbed by `exp(xi)` on their right side, `xi` = [translation; rotation]. Each of them therefore moves the board
//! in its own frame, and the corner information about that motion is summed once per stop.

use nalgebra::{DMatrix, DVector, Isometry3, Matrix6, Point3, SMatrix, SVector, Vector2, Vector3, Vector6};
use pb3dp_geometry::{Camera, StereoRig, se3};

use crate::adjust::{POSE_NUMBERS, point_by_motion};
use crate::board::{Chessboard, Sighting};

/// Number of pose parameters.
pub(super) const POSE: usize = 6;
/// Local parameters observed by the corners of a stop: board motion in its own frame, factors of squares and baseline.
pub(super) const LOCAL: usize = POSE + SCALES;
/// Number of length factors: squares and baseline.
pub(super) const SCALES: usize = 2;

/// The observations of one stop.
#[derive(Clone)]
pub(super) struct StopObservation<'a> {
    /// Detected corners of the left and the right camera.
    pub sightings: [&'a Sighting; 2],
    /// Flange pose in the base of the arm that carries the cameras.
    pub vs: Isometry3<f64>,
    /// Flange pose of the arm that carries the board, if one does.
    pub tc: Option<Isometry3<f64>>,
    /// For each arm, the number of its pose if several stops share it; the arm then reports the same pose with the same error.
    pub rests: [Option<usize>; 2],
}

/// Factor on the information of a stationary arm: it has no noise from stop to stop except rounding of its joint angles.
const AT_REST: f64 = 1e4;

/// The known quantities shared by all stops.
#[derive(Clone)]
pub(super) struct Setting<'a> {
    pub rig: &'a StereoRig,
    pub board: &'a Chessboard,
    /// Standard deviation of a corner in a row or column, px.
    pub corner_sigma_px: f64,
    /// Information of an arm pose correction: the inverse of its prior covariance.
    pub robot_information: Matrix6<f64>,
    /// Whether the factors of squares and baseline are estimated.
    pub scales_free: bool,
}

/// Where the board is mounted.
#[derive(Clone, Copy, Debug)]
pub(super) enum BoardMount {
    Room { base_from_board: Isometry3<f64> },
    Carried { vs_base_from_tc_base: Isometry3<f64>, tc_flange_from_board: Isometry3<f64> },
}

/// All estimated parameters.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub flange_from_cam: Isometry3<f64>,
    pub place: BoardMount,
    /// Factors of squares and baseline.
    pub scales: [f64; SCALES],
    /// Corrected flange poses of each stop: of the arm with the cameras and, if it carries the board, of the other arm.
    pub arms: Vec<Vec<Isometry3<f64>>>,
}

/// Information from the corners of one stop, per px^2 of noise.
pub(super) struct Corners {
    pub information: SMatrix<f64, LOCAL, LOCAL>,
    pub gradient: SVector<f64, LOCAL>,
    /// Sum of the squared errors, px^2.
    pub squares: f64,
    /// Number of corners of both cameras.
    pub count: usize,
}

/// Derivatives of the board motion in its own frame with respect to the unknowns.
pub(super) struct Links {
    /// With respect to the poses shared by all stops.
    pub shared: DMatrix<f64>,
    /// With respect to the arm corrections of this stop.
    pub arms: DMatrix<f64>,
}

impl BoardMount {
    /// Number of arms that move.
    pub(super) fn arm_count(&self) -> usize {
        match self {
            Self::Room { .. } => 1,
            Self::Carried { .. } => 2,
        }
    }

    /// Number of parameters of the poses shared by all stops, including the camera pose.
    pub(super) fn shared_pose_numbers(&self) -> usize {
        POSE * (1 + self.arm_count())
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        let exp = |at: usize| se3::exp(&step.fixed_rows::<POSE>(at).into_owned());
        match self {
            Self::Room { base_from_board } => Self::Room { base_from_board: base_from_board * exp(POSE) },
            Self::Carried { vs_base_from_tc_base, tc_flange_from_board } => Self::Carried {
                vs_base_from_tc_base: vs_base_from_tc_base * exp(POSE),
                tc_flange_from_board: tc_flange_from_board * exp(2 * POSE),
            },
        }
    }
}

impl State {
    /// Number of parameters shared by all stops.
    pub(super) fn shared_count(&self, setting: &Setting<'_>) -> usize {
        self.place.shared_pose_numbers() + if setting.scales_free { SCALES } else { 0 }
    }

    /// The poses shared by all stops by name, in the order of their parameters.
    pub(super) fn poses(&self) -> Vec<(&'static str, Isometry3<f64>)> {
        let mut poses = vec![("flange_from_cam_left", self.flange_from_cam)];
        match self.place {
            BoardMount::Room { base_from_board } => poses.push(("base_from_board", base_from_board)),
            BoardMount::Carried { vs_base_from_tc_base, tc_flange_from_board } => poses.extend([
                ("vs_base_from_tc_base", vs_base_from_tc_base),
                ("tc_flange_from_board", tc_flange_from_board),
            ]),
        }
        poses
    }

    /// Names of the shared parameters, in order.
    pub(super) fn shared_names(&self, setting: &Setting<'_>) -> Vec<String> {
        let poses = self.poses().into_iter();
        let mut names: Vec<String> =
            poses.flat_map(|(pose, _)| POSE_NUMBERS.map(|number| format!("{pose}.{number}"))).collect();
        if setting.scales_free {
            names.extend(["scale.squares", "scale.baseline"].map(str::to_owned));
        }
        names
    }

    /// The state after a step of the shared parameters; the arm corrections stay unchanged.
    pub(super) fn moved(&self, shared: &DVector<f64>) -> Self {
        let mut next = self.clone();
        next.flange_from_cam *= se3::exp(&shared.fixed_rows::<POSE>(0).into_owned());
        next.place = self.place.moved(shared);
        for (scale, step) in next.scales.iter_mut().zip(shared.iter().skip(self.place.shared_pose_numbers())) {
            *scale += step;
        }
        next
    }

    /// Updates the arm corrections of one stop.
    pub(super) fn correct(&mut self, stop: usize, step: &DVector<f64>) {
        for (arm, pose) in self.arms[stop].iter_mut().enumerate() {
            *pose *= se3::exp(&step.fixed_rows::<POSE>(POSE * arm).into_owned());
        }
    }

    /// The board in the base of the arm with the cameras, for given arm poses.
    pub(super) fn base_from_board(&self, arms: &[Isometry3<f64>]) -> Isometry3<f64> {
        match self.place {
            BoardMount::Room { base_from_board } => base_from_board,
            BoardMount::Carried { vs_base_from_tc_base, tc_flange_from_board } => {
                vs_base_from_tc_base * arms.get(1).copied().unwrap_or_default() * tc_flange_from_board
            }
        }
    }

    /// The predicted board pose in the left camera, for given arm poses.
    pub(super) fn cam_from_board(&self, arms: &[Isometry3<f64>]) -> Isometry3<f64> {
        let base_from_flange = arms.first().copied().unwrap_or_default();
        (base_from_flange * self.flange_from_cam).inverse() * self.base_from_board(arms)
    }

    /// Derivatives of the board motion in its own frame with respect to the unknowns, at given arm poses.
    pub(super) fn links(&self, arms: &[Isometry3<f64>]) -> Links {
        let base_from_flange = arms.first().copied().unwrap_or_default();
        let flange_from_board = base_from_flange.inverse() * self.base_from_board(arms);
        let by_camera = -se3::adjoint(&self.cam_from_board(arms).inverse());
        let by_flange = -se3::adjoint(&flange_from_board.inverse());
        let (mut shared, mut by_arms) = (vec![by_camera], vec![by_flange]);
        if let BoardMount::Carried { tc_flange_from_board, .. } = self.place {
            let tc_base_from_board = arms.get(1).copied().unwrap_or_default() * tc_flange_from_board;
            shared.push(se3::adjoint(&tc_base_from_board.inverse()));
            by_arms.push(se3::adjoint(&tc_flange_from_board.inverse()));
        }
        shared.push(Matrix6::identity());
        Links { shared: side_by_side(&shared), arms: side_by_side(&by_arms) }
    }
}

fn side_by_side(blocks: &[Matrix6<f64>]) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(POSE, POSE * blocks.len());
    for (index, block) in blocks.iter().enumerate() {
        matrix.fixed_view_mut::<POSE, POSE>(0, POSE * index).copy_from(block);
    }
    matrix
}

impl StopObservation<'_> {
    /// The information of an arm pose correction.
    pub(super) fn robot_information(&self, arm: usize, setting: &Setting<'_>) -> Matrix6<f64> {
        let rests = self.rests.get(arm).is_some_and(Option::is_some);
        setting.robot_information * if rests { AT_REST } else { 1.0 }
    }

    /// The measured poses of the arms.
    pub(super) fn arms(&self) -> Vec<Isometry3<f64>> {
        [Some(self.vs), self.tc].into_iter().flatten().collect()
    }

    /// Information of the corners about a board at `cam_from_board`; `None` if a corner is not visible.
    pub(super) fn corners(
        &self,
        setting: &Setting<'_>,
        cam_from_board: &Isometry3<f64>,
        scales: [f64; SCALES],
    ) -> Option<Corners> {
        let [squares, baseline] = scales;
        let turn = cam_from_board.rotation.to_rotation_matrix();
        let right_from_left = setting.rig.cam_right_from_cam_left();
        let (right_turn, shift_m) = (right_from_left.rotation_matrix(), right_from_left.translation_m());
        let mut sum = Corners { information: SMatrix::zeros(), gradient: SVector::zeros(), squares: 0.0, count: 0 };
        for (side, sighting) in self.sightings.iter().enumerate() {
            for corner in sighting.corners() {
                let on_board = setting.board.corner_in_board(corner.column, corner.row);
                let in_board = on_board * squares;
                let in_left = cam_from_board * in_board;
                let mut by_local = SMatrix::<f64, 3, LOCAL>::zeros();
                by_local.fixed_columns_mut::<POSE>(0).copy_from(&point_by_motion(&in_board, turn.matrix()));
                by_local.set_column(POSE, &(turn * on_board.coords));
                let (camera, in_cam) = if side == 0 {
                    (setting.rig.left(), in_left)
                } else {
                    by_local = right_turn * by_local;
                    by_local.set_column(POSE + 1, &shift_m);
                    (setting.rig.right(), Point3::from(right_turn * in_left.coords + shift_m * baseline))
                };
                let (pixel, by_point) = camera.project_with_jacobian(&in_cam)?;
                let (error, row) = (pixel - corner.pixel, by_point * by_local);
                sum.information += row.transpose() * row;
                sum.gradient += row.transpose() * error;
                sum.squares += error.norm_squared();
                sum.count += 1;
            }
        }
        Some(sum)
    }

    /// Sum of the squared corner errors, px^2; infinite if a corner is not visible.
    pub(super) fn squares(
        &self,
        setting: &Setting<'_>,
        cam_from_board: &Isometry3<f64>,
        [squares, baseline]: [f64; SCALES],
    ) -> f64 {
        let right_from_left = setting.rig.cam_right_from_cam_left();
        let error = |camera: &Camera, in_cam: &Point3<f64>, pixel: Vector2<f64>| {
            camera.project(in_cam).map_or(f64::INFINITY, |projected| (projected - pixel).norm_squared())
        };
        let mut sum = 0.0;
        for (side, sighting) in self.sightings.iter().enumerate() {
            for corner in sighting.corners() {
                let in_left = cam_from_board * (setting.board.corner_in_board(corner.column, corner.row) * squares);
                sum += if side == 0 {
                    error(setting.rig.left(), &in_left, corner.pixel)
                } else {
                    let turned: Vector3<f64> = right_from_left.rotation() * in_left.coords;
                    let in_right = Point3::from(turned + right_from_left.translation_m() * baseline);
                    error(setting.rig.right(), &in_right, corner.pixel)
                };
            }
        }
        sum
    }

    /// The board pose in the left camera from the corners of this stop only, from an initial guess, with the corner information
    /// there.
    pub(super) fn by_itself(
        &self,
        setting: &Setting<'_>,
        guess: Isometry3<f64>,
        scales: [f64; SCALES],
    ) -> Option<(Isometry3<f64>, Corners)> {
        const STEPS_MAX: usize = 50;
        let mut cam_from_board = guess;
        for _ in 0..STEPS_MAX {
            let corners = self.corners(setting, &cam_from_board, scales)?;
            let information: Matrix6<f64> = corners.information.fixed_view::<POSE, POSE>(0, 0).into_owned();
            let gradient: Vector6<f64> = corners.gradient.fixed_rows::<POSE>(0).into_owned();
            let mut step = -information.cholesky()?.solve(&gradient);
            // The step is shortened while the cost rises; from a homography three full steps are enough.
            while self.squares(setting, &(cam_from_board * se3::exp(&step)), scales)
                > corners.squares * (1.0 + 1e-9) + 1e-12
                && step.amax() > 1e-12
            {
                step *= 0.5;
            }
            cam_from_board *= se3::exp(&step);
            if step.amax() < 1e-10 {
                return Some((cam_from_board, self.corners(setting, &cam_from_board, scales)?));
            }
        }
        None
    }
}
