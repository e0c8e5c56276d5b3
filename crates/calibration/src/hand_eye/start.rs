//! Initial values of the hand-eye adjustment: closed-form solutions, and the consensus of most pairs of stops.
//!
//! Between two stops the flange moves by `A` and the board in the camera by `B`, and `A X = X B` for the camera pose `X` on the
//! flange. The rotation is solved first, from the rotation vectors (`alpha = R beta`: Park and Martin, IEEE Trans. Robotics and
//! Automation 10 (1994), section IV), as the best-fitting rotation. The translation then follows from a linear system.

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use pb3dp_geometry::so3;

use super::HandEyeError;
use super::model::{BoardMount, State};

/// Largest usable rotation; near half a turn a rotation vector and its opposite cannot be distinguished.
const TURN_MAX_RAD: f64 = 2.8;
/// Rotations about a second axis below this value count as none, degrees rms.
const SECOND_AXIS_MIN_DEG: f64 = 0.5;
/// Maximum flange displacement (translation, rotation) of an arm that counts as stationary.
const AT_REST: (f64, f64) = (1e-3, 2e-3);
/// Number of start hypotheses tested.
const TRIED_MAX: usize = 500;
/// Share of all pairs that a start must explain; the share of pairs without outliers is smaller than the share of stops.
const CONSENSUS: f64 = 0.35;
/// Weight of translation: radians per metre.
const RAD_PER_M: f64 = 2.0;

/// Minimum number of stops for a calibration attempt.
pub const STOPS_MIN: usize = 4;

/// The poses of one stop: flange poses and the board in the left camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Poses {
    pub vs: Isometry3<f64>,
    pub tc: Option<Isometry3<f64>>,
    pub cam_from_board: Isometry3<f64>,
}

/// The motions between two stops, `A X = X B`.
#[derive(Clone, Copy)]
struct Motions {
    a: Isometry3<f64>,
    b: Isometry3<f64>,
    alpha: Vector3<f64>,
    beta: Vector3<f64>,
}

impl Motions {
    /// `None` if the rotation is near half a turn.
    fn new(a: Isometry3<f64>, b: Isometry3<f64>) -> Option<Self> {
        let (alpha, beta) = (so3::log(&a.rotation), so3::log(&b.rotation));
        (alpha.norm().max(beta.norm()) < TURN_MAX_RAD).then_some(Self { a, b, alpha, beta })
    }

    /// The residual of `x`.
    fn misfit(&self, x: &Isometry3<f64>) -> f64 {
        let (ax, xb) = (self.a * x, x * self.b);
        ax.rotation.angle_to(&xb.rotation) + RAD_PER_M * (ax.translation.vector - xb.translation.vector).norm()
    }
}

/// Whether an arm is stationary between two flange poses.
pub(super) fn rests(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
    let apart = a.inverse() * b;
    apart.translation.vector.norm() < AT_REST.0 && apart.rotation.angle() < AT_REST.1
}

/// Root mean square of the rotations between stops about the second axis of rotation, degrees.
pub(super) fn rotation_spread_deg(flanges: &[Isometry3<f64>]) -> f64 {
    let mut sum = Matrix3::zeros();
    let mut count = 0.0_f64;
    for (i, a) in flanges.iter().enumerate() {
        for b in &flanges[i + 1..] {
            let turn = so3::log(&(a.rotation.inverse() * b.rotation));
            sum += turn * turn.transpose();
            count += 1.0;
        }
    }
    second_axis_deg(sum / count.max(1.0))
}

/// Root mean square of rotations about their second axis, degrees, from the mean of the squared rotation vectors.
fn second_axis_deg(mean_square: Matrix3<f64>) -> f64 {
    let mut squares: Vec<f64> = mean_square.symmetric_eigenvalues().iter().copied().collect();
    squares.sort_by(|a, b| b.total_cmp(a));
    squares.get(1).copied().unwrap_or(0.0).max(0.0).sqrt().to_degrees()
}

/// The initial state of the adjustment.
///
/// # Errors
/// An arm has not rotated about two axes, or never moved while the other one was stationary.
pub(super) fn start(stops: &[Poses]) -> Result<State, HandEyeError> {
    let carried = stops.iter().all(|stop| stop.tc.is_some());
    let tc = |stop: &Poses| stop.tc.unwrap_or_default();
    let (mut of_camera, mut of_board) = (Vec::new(), Vec::new());
    for (i, first) in stops.iter().enumerate() {
        for second in &stops[i + 1..] {
            if !carried || rests(&tc(first), &tc(second)) {
                let b = second.cam_from_board * first.cam_from_board.inverse();
                of_camera.extend(Motions::new(second.vs.inverse() * first.vs, b));
            } else if rests(&first.vs, &second.vs) {
                let b = second.cam_from_board.inverse() * first.cam_from_board;
                of_board.extend(Motions::new(tc(second).inverse() * tc(first), b));
            }
        }
    }
    let flange_from_cam = consensus(&of_camera, "vs", carried)?;
    let place = if carried {
        let tc_flange_from_board = consensus(&of_board, "tc", carried)?;
        let bases = stops
            .iter()
            .map(|stop| stop.vs * flange_from_cam * stop.cam_from_board * (tc(stop) * tc_flange_from_board).inverse());
        BoardMount::Carried { vs_base_from_tc_base: middle(&bases.collect::<Vec<_>>()), tc_flange_from_board }
    } else {
        let boards = stops.iter().map(|stop| stop.vs * flange_from_cam * stop.cam_from_board);
        BoardMount::Room { base_from_board: middle(&boards.collect::<Vec<_>>()) }
    };
    let arms = stops.iter().map(|stop| [Some(stop.vs), stop.tc].into_iter().flatten().collect()).collect();
    Ok(State { flange_from_cam, place, scales: [1.0; 2], arms })
}

/// The `X` that fits most of the pairs best.
fn consensus(pairs: &[Motions], arm: &'static str, carried: bool) -> Result<Isometry3<f64>, HandEyeError> {
    if pairs.len() < 3 {
        return Err(if carried {
            HandEyeError::OneAtATime { arm }
        } else {
            HandEyeError::Axes { arm, second_deg: 0.0 }
        });
    }
    let sum: Matrix3<f64> = pairs.iter().map(|pair| pair.alpha * pair.alpha.transpose()).sum();
    let second_deg = second_axis_deg(sum / pairs.len() as f64);
    let axes = || HandEyeError::Axes { arm, second_deg };
    if second_deg < SECOND_AXIS_MIN_DEG {
        return Err(axes());
    }
    let score = |x: &Isometry3<f64>| {
        let mut misfits: Vec<f64> = pairs.iter().map(|pair| pair.misfit(x)).collect();
        let at = ((CONSENSUS * misfits.len() as f64) as usize).min(misfits.len() - 1);
        *misfits.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let all = (0..pairs.len()).flat_map(|i| (i + 1..pairs.len()).map(move |j| (i, j)));
    // An even selection from all combinations; the stride shares no divisor with usual numbers of combinations.
    let every = (pairs.len() * (pairs.len() - 1) / 2).div_ceil(TRIED_MAX) | 1;
    let tried = all.step_by(every).filter_map(|(i, j)| solve(&[pairs[i], pairs[j]])).chain(solve(pairs));
    let (best, x) = tried.map(|x| (score(&x), x)).min_by(|a, b| a.0.total_cmp(&b.0)).ok_or_else(axes)?;
    let near: Vec<Motions> = pairs.iter().filter(|pair| pair.misfit(&x) <= 3.0 * best).copied().collect();
    match solve(&near) {
        Some(refined) if score(&refined) <= best => Ok(refined),
        _ => Ok(x),
    }
}

/// `X` of `A X = X B` by least squares; `None` if the axes are parallel.
fn solve(pairs: &[Motions]) -> Option<Isometry3<f64>> {
    let moment: Matrix3<f64> = pairs.iter().map(|pair| pair.alpha * pair.beta.transpose()).sum();
    let svd = moment.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sizes: Vec<f64> = svd.singular_values.iter().copied().collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    if sizes[1] <= 1e-4 * sizes[0] {
        return None;
    }
    // If the product is a reflection, the direction of the smallest singular value is flipped.
    let mut signs = Vector3::repeat(1.0);
    signs[svd.singular_values.imin()] = (u.determinant() * v_t.determinant()).signum();
    let rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let mut left = DMatrix::zeros(3 * pairs.len(), 3);
    let mut right = DVector::zeros(3 * pairs.len());
    for (n, pair) in pairs.iter().enumerate() {
        let turn = pair.a.rotation.to_rotation_matrix().into_inner() - Matrix3::identity();
        left.fixed_view_mut::<3, 3>(3 * n, 0).copy_from(&turn);
        right.fixed_rows_mut::<3>(3 * n).copy_from(&(rotation * pair.b.translation.vector - pair.a.translation.vector));
    }
    let normal: Matrix3<f64> = Matrix3::from_iterator((left.transpose() * &left).iter().copied());
    let moment = Vector3::from_iterator((left.transpose() * right).iter().copied());
    let translation = normal.cholesky()?.solve(&moment);
    let is_finite = translation.iter().chain(rotation.coords.iter()).all(|value| value.is_finite());
    is_finite.then(|| Isometry3::from_parts(Translation3::from(translation), rotation))
}

/// The pose nearest to all others.
fn middle(poses: &[Isometry3<f64>]) -> Isometry3<f64> {
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let apart = a.inverse() * b;
        apart.rotation.angle() + RAD_PER_M * (a.translation.vector - b.translation.vector).norm()
    };
    let sum = |pose: &Isometry3<f64>| poses.iter().map(|other| distance(pose, other)).sum::<f64>();
    poses.iter().min_by(|a, b| sum(a).total_cmp(&sum(b))).copied().unwrap_or_default()
}
