//! The smallest error of any linear filter that predicts the desired hand pose: the bound shown next to the errors.
//!
//! The filter knows the desired hand pose at a time t from the estimates of frames that are at least the total delay T
//! old, one every frame period, each with white noise. It is a weighted sum of the last of these estimates, with weights
//! that add to one (the origin of the axes must not matter). The filter with the least mean square error over the given
//! times follows in closed form, for each axis separately and for each age of the newest frame (T to T plus a frame
//! period): for a true signal s, noise of standard deviation sigma and weights w the error is the mean of
//! (s(t) - sum w_k s(t_k))^2 plus sigma^2 sum w_k^2.
//!
//! The filter knows the noise and the very motion on which it is judged; it is linear, constant, and has finite memory.

use nalgebra::{DMatrix, DVector, Vector6};
use pb3dp_cell::log::RunLog;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, Target, World};
use pb3dp_record::metrics::rms;
use pb3dp_sim::trajectory::Trajectory;

/// Number of frames in the filter's memory.
pub const TAPS: usize = 60;
/// Ages of the newest frame beyond the delay, as shares of the frame period: midpoints of equal parts.
const AGES: [f64; 3] = [1.0 / 6.0, 0.5, 5.0 / 6.0];
/// Times over which the error is averaged, seconds.
const STEP_S: f64 = 0.02;

/// White noise of the desired hand pose from an estimate, along and about the target's axes: metres, then radians.
pub type HandNoise = Vector6<f64>;

/// The noise of the estimates of a run: second differences over consecutive frames, over sqrt(6), which removes slow
/// changes. Also the rms of the whole error of the estimates relative to the initial lock: metres and radians.
pub fn hand_noise(
    log: &RunLog,
    model_from_hand: &Pose<pb3dp_geometry::frames::Model, Hand>,
) -> Option<(HandNoise, [f64; 2])> {
    let lock = log.lock?;
    let locked = lock.target_from_model_found * *model_from_hand;
    let errors: Vec<Option<Vector6<f64>>> = log
        .leading
        .estimated
        .iter()
        .zip(&log.leading.truth)
        .map(|(estimated, truth)| {
            let cam_left_from_target = truth.relabel::<_, Target>();
            let hand = cam_left_from_target.inverse() * (*estimated)? * *model_from_hand;
            let turned = (hand.rotation() * locked.rotation().inverse()).scaled_axis();
            Some(pb3dp_geometry::se3::join(&(hand.translation_m() - locked.translation_m()), &turned))
        })
        .collect();
    let differences: Vec<Vector6<f64>> = errors
        .windows(3)
        .filter_map(|w| match w {
            [Some(a), Some(b), Some(c)] => Some(a - 2.0 * b + c),
            _ => None,
        })
        .collect();
    let sigma = |row: usize| Some(rms(&differences.iter().map(|d| d[row]).collect::<Vec<_>>())? / 6_f64.sqrt());
    let mut noise = HandNoise::zeros();
    for row in 0..6 {
        noise[row] = sigma(row)?;
    }
    let whole = |first: usize| -> Option<f64> {
        rms(&errors.iter().flatten().map(|e| e.fixed_rows::<3>(first).norm()).collect::<Vec<_>>())
    };
    Some((noise, [whole(0)?, whole(3)?]))
}

/// Error of the ideal filter over some times: rms of distance and angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ideal {
    /// Millimetres.
    pub mm: f64,
    /// Degrees.
    pub deg: f64,
}

/// The desired motion of the hand, and its measurement.
pub struct MeasuredTarget<'a> {
    /// The target's motion.
    pub target: &'a dyn Trajectory,
    /// Desired hand pose relative to the target.
    pub target_from_hand: Pose<Target, Hand>,
    /// Noise of each estimate.
    pub noise: HandNoise,
    /// From the middle of an exposure to the resulting motion, seconds.
    pub delay_s: f64,
    /// Frame period, seconds.
    pub frame_s: f64,
}

impl MeasuredTarget<'_> {
    /// The least error over these times (seconds, start and end); `None` if they are empty.
    pub fn ideal(&self, times_s: &[(f64, f64)]) -> Option<Ideal> {
        let times: Vec<f64> = times_s.iter().flat_map(|&(from, until)| steps(from, until)).collect();
        let mut squares = Vector6::<f64>::zeros();
        for age in AGES {
            let oldest_s = self.delay_s + age * self.frame_s;
            let rows: Vec<Vec<Vector6<f64>>> = times.iter().map(|t_s| self.past(*t_s, oldest_s)).collect();
            for axis in 0..6 {
                squares[axis] += least_square(&rows, axis, self.noise[axis])? / AGES.len() as f64;
            }
        }
        let root = |first: usize| squares.fixed_rows::<3>(first).sum().max(0.0).sqrt();
        Some(Ideal { mm: root(0) * 1e3, deg: root(3).to_degrees() })
    }

    /// The desired hand pose at `t_s`, then as the frames have shown it, the newest first.
    fn past(&self, t_s: f64, newest_s: f64) -> Vec<Vector6<f64>> {
        let start = self.target.pose_at(0.0);
        let frames = (0..TAPS).map(|k| t_s - newest_s - k as f64 * self.frame_s);
        std::iter::once(t_s).chain(frames).map(|at_s| self.place(&start, at_s)).collect()
    }

    /// Displacement and rotation of the desired hand pose since the start, in the target's axes at the start.
    fn place(&self, start: &Pose<World, Target>, at_s: f64) -> Vector6<f64> {
        let (was, is) = (*start * self.target_from_hand, self.target.pose_at(at_s) * self.target_from_hand);
        let axes = start.rotation().inverse();
        let turned = (is.rotation() * was.rotation().inverse()).scaled_axis();
        pb3dp_geometry::se3::join(&(axes * (is.translation_m() - was.translation_m())), &(axes * turned))
    }
}

fn steps(from: f64, until: f64) -> impl Iterator<Item = f64> {
    (0..).map(move |k| from + STEP_S * f64::from(k)).take_while(move |t| *t < until)
}

/// Mean square error of the best weights along one axis. The weight of the newest frame is one less the others; with d_k = s_k - s_0
/// they minimise the mean of (s - s_0 - sum w_k d_k)^2 plus sigma^2 ((1 - sum w_k)^2 + sum w_k^2).
fn least_square(rows: &[Vec<Vector6<f64>>], axis: usize, sigma: f64) -> Option<f64> {
    if rows.is_empty() {
        return None;
    }
    let (variance, count) = (sigma.max(1e-9).powi(2), rows.len() as f64);
    let mut normal =
        DMatrix::from_element(TAPS - 1, TAPS - 1, variance) + DMatrix::identity(TAPS - 1, TAPS - 1) * variance;
    let mut right = DVector::from_element(TAPS - 1, variance);
    let mut square = variance;
    for row in rows {
        let newest = row[1][axis];
        let missing = row[0][axis] - newest;
        let older = DVector::from_fn(TAPS - 1, |k, _| row[k + 2][axis] - newest);
        normal.ger(1.0 / count, &older, &older, 1.0);
        right.axpy(missing / count, &older, 1.0);
        square += missing * missing / count;
    }
    let weights = normal.cholesky()?.solve(&right);
    Some(square - weights.dot(&right))
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use pb3dp_geometry::Twist;
    use pb3dp_sim::trajectory::{Mark, StepExperimentConfig};

    use super::*;

    /// Moves along x by this function of time.
    struct Along(fn(f64) -> f64);

    impl Trajectory for Along {
        fn pose_at(&self, t_s: f64) -> Pose<World, Target> {
            Pose::from_parts(Vector3::new((self.0)(t_s), 0.3, -0.2), UnitQuaternion::identity())
        }
        fn twist_at(&self, _: f64) -> Twist<World> {
            Twist::new(Vector3::zeros(), Vector3::zeros())
        }
        fn marks(&self) -> &[Mark] {
            &[]
        }
        fn duration_s(&self) -> f64 {
            10.0
        }
    }

    fn measured_target(target: &dyn Trajectory, sigma_m: f64, delay_s: f64) -> MeasuredTarget<'_> {
        let target_from_hand = Pose::from_translation(Vector3::new(0.0, 0.0, -0.5));
        let noise = HandNoise::new(sigma_m, 0.0, 0.0, 0.0, 0.0, 0.0);
        MeasuredTarget { target, target_from_hand, noise, delay_s, frame_s: 1.0 / 30.0 }
    }

    #[test]
    fn at_rest_the_mean_of_all_frames_is_best() {
        let rest = Along(|_| 0.1);
        let found = measured_target(&rest, 2e-3, 0.1).ideal(&[(3.0, 5.0)]).unwrap();
        assert!((found.mm - 2.0 / (TAPS as f64).sqrt()).abs() < 1e-4, "{found:?}");
        assert_eq!(measured_target(&rest, 2e-3, 0.1).ideal(&[]), None);
    }

    /// A straight line of unknown slope through n points with noise, extrapolated: variance sigma^2 (1/n + (a - mean)^2 / sum (t -
    /// mean)^2). The filter knows the slope's size, and can only be better; where the motion is large, not by much.
    #[test]
    fn of_a_steady_motion_it_is_the_error_of_a_line_through_the_frames() {
        let line = Along(|t| 50.0 * t);
        let (sigma_m, delay_s) = (1e-3, 0.1);
        let found = measured_target(&line, sigma_m, delay_s).ideal(&[(4.0, 6.0)]).unwrap();
        let n = TAPS as f64;
        let spread: f64 = (0..TAPS).map(|k| (k as f64 - (n - 1.0) / 2.0).powi(2)).sum();
        let variance =
            AGES.iter().map(|age| 1.0 / n + (delay_s * 30.0 + age + (n - 1.0) / 2.0).powi(2) / spread).sum::<f64>();
        let expected_mm = 1e3 * sigma_m * (variance / AGES.len() as f64).sqrt();
        assert!((found.mm / expected_mm - 1.0).abs() < 1e-3, "{found:?}, {expected_mm}");
    }

    #[test]
    fn more_delay_and_more_noise_leave_more() {
        let motion = pb3dp_sim::trajectory::MotionConfig::Steps(StepExperimentConfig::default());
        let start = Pose::from_parts(Vector3::new(0.9, 0.1, 1.1), UnitQuaternion::from_euler_angles(0.4, -0.7, 1.2));
        let target = motion.begin_at(start).unwrap();
        let error = |sigma_m: f64, delay_s: f64| {
            measured_target(&*target, sigma_m, delay_s).ideal(&[(3.0, 5.0), (8.0, 10.0)]).unwrap().mm
        };
        let base = error(1e-3, 0.066);
        assert!(base > 0.1 && base < 2.0, "{base}");
        assert!(error(1e-3, 0.1) > 1.05 * base && error(2e-3, 0.066) > 1.2 * base);
    }
}
