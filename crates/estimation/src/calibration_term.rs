//! The share of an uncertain calibration in the covariance of a pose.
//!
//! The images stay as they are, and the calibration changes: by how much does the answer? [`CalibrationTerm`] follows the answer through
//! both steps of the method. In the first pair the points of the target are triangulated, and a plane through them defines the frame
//! `model`; in a later pair these points are fitted to both images, with a free row offset. The derivatives of both with respect to
//! every stated number of the calibration give `G`, and the covariance is `G C G^T`.
//!
//! The covariance of an estimate contains the noise of the images and never this term: the errors of a calibration are the same in
//! every frame and do not average out. The absolute pose needs both. Of the motion since the first pair only a small share
//! depends on the calibration, see [`CalibrationShare::motion`].

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Matrix6, Point3, SMatrix, SVector, Vector2, Vector3, Vector6};
use pb3dp_estimation_core::estimate::CalibrationShare;
use pb3dp_estimation_core::model_frame::model_frame_on_plane;
use pb3dp_geometry::frames::{CamLeft, CamRight, Model};
use pb3dp_geometry::{Camera, Distortion, Pinhole, Pose, StereoRig, se3};

/// Step of the numerical derivatives, in standard deviations of a number. Chosen: as in the calibration's own figures; the effect is linear
/// over several standard deviations of a usable calibration.
const STEP_SIGMAS: f64 = 0.1;
/// Step of the derivatives with respect to the pose, metres and radians. Chosen: the second-order error is below 1e-6 of the derivative.
const STEP: f64 = 1e-6;
/// Radii at which the outline stands for the inside of the target, as shares: the middles of three rings of equal area, sqrt(k / 3 + 1 / 6).
const RINGS: [f64; 3] = [0.408_248, std::f64::consts::FRAC_1_SQRT_2, 0.912_871];
/// The six numbers of a motion and the row offset of the right image.
const UNKNOWNS: usize = 7;

/// Why a covariance of a calibration was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CalibrationTermError {
    /// A name that no number of the rig has.
    #[error("the covariance of the calibration names {name:?}, which this rig does not have: calibrate again")]
    Name {
        /// The name.
        name: String,
    },
    /// Rows and names differ in number, or a variance is negative or not finite.
    #[error(
        "the covariance of the calibration has {rows} rows for {names} names, or a variance that is negative: calibrate again"
    )]
    Shape {
        /// Number of rows.
        rows: usize,
        /// Number of names.
        names: usize,
    },
    /// A number whose step of a tenth of a standard deviation gives no possible rig.
    #[error("{name} of the calibration is so uncertain that its errors cannot be propagated: calibrate again")]
    Uncertain {
        /// The number.
        name: String,
    },
}

/// A rig with the covariance of its numbers.
#[derive(Clone, Debug)]
pub struct CalibrationTerm {
    rig: StereoRig,
    covariance: DMatrix<f64>,
    /// Per number: the rigs one step above and below, and the step.
    moved: Vec<([StereoRig; 2], f64)>,
}

/// A target in its first pair: the pose of its frame, and points on its plane.
#[derive(Clone, Debug, PartialEq)]
pub struct FirstPair {
    cam_left_from_model: Pose<CamLeft, Model>,
    points: Vec<Point3<f64>>,
}

impl FirstPair {
    /// By the outline in the first left image, raw pixels. `None` without three points in front of the camera.
    pub fn of_outline(
        rig: &StereoRig,
        cam_left_from_model: &Pose<CamLeft, Model>,
        outline_px: &[Vector2<f64>],
    ) -> Option<Self> {
        let normal = cam_left_from_model.transform_vector(&Vector3::z());
        let q = normal / normal.dot(&cam_left_from_model.translation_m());
        let model_from_cam_left = cam_left_from_model.inverse();
        let on_plane = |px: &Vector2<f64>| {
            let ray = rig.left().unproject(px).ok()?;
            let inverse_depth = q.dot(&ray);
            (inverse_depth > 0.0).then(|| model_from_cam_left.transform_point(&Point3::from(ray / inverse_depth)))
        };
        let outline: Vec<Point3<f64>> = outline_px.iter().filter_map(on_plane).collect();
        let centre = outline.iter().map(|p| p.coords).sum::<Vector3<f64>>() / outline.len().max(1) as f64;
        let ring = |share: f64| outline.iter().map(move |p| Point3::from(centre + (p.coords - centre) * share));
        let points = RINGS.into_iter().flat_map(ring).collect();
        (outline.len() >= 3).then_some(Self { cam_left_from_model: *cam_left_from_model, points })
    }
}

impl CalibrationTerm {
    /// By the names and the covariance that `pb3dp calibrate` writes: `left.fx`, `right.k1` (pixels), and
    /// `cam_right_from_cam_left.x_m` to `rz_rad`, the vector `xi` in `exp(xi) * cam_right_from_cam_left`. Numbers that are not named are
    /// exact.
    ///
    /// # Errors
    /// Names that the rig does not have, or a matrix of another size.
    pub fn new(rig: &StereoRig, names: &[String], rows: &[Vec<f64>]) -> Result<Self, CalibrationTermError> {
        let count = names.len();
        let is_valid = |(index, row): (usize, &Vec<f64>)| {
            row.len() == count && row.iter().all(|x| x.is_finite()) && row.get(index).is_some_and(|x| *x >= 0.0)
        };
        if rows.len() != count || !rows.iter().enumerate().all(is_valid) {
            return Err(CalibrationTermError::Shape { rows: rows.len(), names: count });
        }
        let covariance = DMatrix::from_fn(count, count, |row, column| rows[row][column]);
        let moved = names.iter().enumerate().map(|(index, name)| {
            let step = STEP_SIGMAS * covariance[(index, index)].sqrt();
            let number = Number::of(rig, name).ok_or_else(|| CalibrationTermError::Name { name: name.clone() })?;
            let at =
                |by: f64| number.moved(rig, by).ok_or_else(|| CalibrationTermError::Uncertain { name: name.clone() });
            Ok(([at(step)?, at(-step)?], step))
        });
        let moved = moved.collect::<Result<_, _>>()?;
        Ok(Self { rig: *rig, covariance, moved })
    }

    /// The share of the calibration in the first pose of a target. `None` as for [`Self::share`].
    pub fn share_of_first(&self, first: &FirstPair) -> Option<Matrix6<f64>> {
        Some(self.share(first, &first.cam_left_from_model)?.pose)
    }

    /// The shares of the calibration in a later pose of a target, or in the first one. `None` if the target is not in front of both
    /// cameras.
    pub fn share(&self, first: &FirstPair, now: &Pose<CamLeft, Model>) -> Option<CalibrationShare> {
        let in_first = Observed::of(&self.rig, &first.cam_left_from_model, &first.points)?;
        let in_now = Observed::of(&self.rig, now, &first.points)?;
        let origin_px = self.rig.left().project(&Point3::from(first.cam_left_from_model.translation_m()))?;
        let fit = Fit::at(&self.rig, now, &first.points)?;
        let (is_first, count) = (*now == first.cam_left_from_model, self.moved.len());
        let (mut of_pose, mut of_motion) = (SixRows::zeros(count), SixRows::zeros(count));
        for (column, (rigs, step)) in self.moved.iter().enumerate().filter(|(_, (_, step))| *step > 0.0) {
            let answer = |rig: &StereoRig| -> Option<[Vector6<f64>; 2]> {
                let model = Answered::of(rig, &in_first, &origin_px)?;
                let pose = match is_first {
                    true => model.cam_left_from_model,
                    false => now.perturbed_in_from(&fit.step(rig, now, &model.points, &in_now)?),
                };
                let back = pose.inverse() * *now;
                let redefined = first.cam_left_from_model.inverse() * model.cam_left_from_model;
                Some([back.log(), (back * redefined).log()])
            };
            let ([pose_above, motion_above], [pose_below, motion_below]) = (answer(&rigs[0])?, answer(&rigs[1])?);
            of_pose.set_column(column, &((pose_above - pose_below) / (2.0 * step)));
            of_motion.set_column(column, &((motion_above - motion_below) / (2.0 * step)));
        }
        let spread =
            |g: &SixRows| -> Matrix6<f64> { (g * &self.covariance * g.transpose()).fixed_view::<6, 6>(0, 0).into() };
        Some(CalibrationShare { pose: spread(&of_pose), motion: spread(&of_motion) })
    }
}

type SixRows = nalgebra::OMatrix<f64, nalgebra::U6, nalgebra::Dyn>;

/// Pixels of the points in both images.
struct Observed(Vec<[Vector2<f64>; 2]>);

impl Observed {
    fn of(rig: &StereoRig, pose: &Pose<CamLeft, Model>, points: &[Point3<f64>]) -> Option<Self> {
        points.iter().map(|point| pixels(rig, &pose.transform_point(point))).collect::<Option<_>>().map(Self)
    }
}

fn pixels(rig: &StereoRig, in_left: &Point3<f64>) -> Option<[Vector2<f64>; 2]> {
    let in_right = rig.cam_right_from_cam_left().transform_point(in_left);
    Some([rig.left().project(in_left)?, rig.right().project(&in_right)?])
}

/// The first pair as another calibration sees it.
struct Answered {
    cam_left_from_model: Pose<CamLeft, Model>,
    points: Vec<Point3<f64>>,
}

impl Answered {
    /// The plane of least squares through the inverse depths of the triangulated points, and the points of the left image on it.
    fn of(rig: &StereoRig, observed: &Observed, origin_px: &Vector2<f64>) -> Option<Self> {
        let (mut matrix, mut rhs) = (Matrix3::zeros(), Vector3::zeros());
        let mut rays = Vec::with_capacity(observed.0.len());
        for [left, right] in &observed.0 {
            let ray = rig.left().unproject(left).ok()?;
            matrix += ray * ray.transpose();
            rhs += ray / depth_on_ray(rig, &ray, right)?;
            rays.push(ray);
        }
        let q = matrix.cholesky()?.solve(&rhs);
        let origin_ray = rig.left().unproject(origin_px).ok()?;
        let cam_left_from_model = model_frame_on_plane(origin_ray / q.dot(&origin_ray), &-q.normalize())?;
        let model_from_cam_left = cam_left_from_model.inverse();
        let on_plane = |ray: &Vector3<f64>| model_from_cam_left.transform_point(&Point3::from(ray / q.dot(ray)));
        Some(Self { cam_left_from_model, points: rays.iter().map(on_plane).collect() })
    }
}

/// Depth of the point on a ray of the left camera whose right pixel is nearest to the given one along the epipolar line: an offset across
/// the line does not change it. Newton's steps in the inverse depth, in which a pixel is nearly linear.
fn depth_on_ray(rig: &StereoRig, ray: &Vector3<f64>, right_px: &Vector2<f64>) -> Option<f64> {
    let right_of = |inverse_depth: f64| {
        rig.right().project(&rig.cam_right_from_cam_left().transform_point(&Point3::from(ray / inverse_depth)))
    };
    let mut inverse_depth = 1.0 / nearest_depth(rig, ray, right_px)?;
    for _ in 0..3 {
        let step = STEP * inverse_depth;
        let along = (right_of(inverse_depth + step)? - right_of(inverse_depth - step)?) / (2.0 * step);
        inverse_depth += along.dot(&(right_px - right_of(inverse_depth)?)) / along.norm_squared();
    }
    (inverse_depth > 0.0 && inverse_depth.is_finite()).then(|| 1.0 / inverse_depth)
}

/// Depth of the point on a ray of the left camera that is nearest to the ray of a right pixel.
fn nearest_depth(rig: &StereoRig, ray: &Vector3<f64>, right_px: &Vector2<f64>) -> Option<f64> {
    let cam_left_from_cam_right: Pose<CamLeft, CamRight> = rig.cam_right_from_cam_left().inverse();
    let other = cam_left_from_cam_right.transform_vector(&rig.right().unproject(right_px).ok()?);
    let origin = cam_left_from_cam_right.translation_m();
    let (aa, ab, bb) = (ray.dot(ray), ray.dot(&other), other.dot(&other));
    let depth = (bb * ray.dot(&origin) - ab * other.dot(&origin)) / (aa * bb - ab * ab);
    (depth > 0.0 && depth.is_finite()).then_some(depth)
}

/// The least-squares fit of the points to both images, linear at a pose.
struct Fit {
    /// Maps residuals to the unknowns.
    inverse: nalgebra::OMatrix<f64, nalgebra::Const<UNKNOWNS>, nalgebra::Dyn>,
}

impl Fit {
    fn at(rig: &StereoRig, pose: &Pose<CamLeft, Model>, points: &[Point3<f64>]) -> Option<Self> {
        let residuals = |by: f64, axis: usize| -> Option<DVector<f64>> {
            let xi = Vector6::from_fn(|i, _| if i == axis { by } else { 0.0 });
            Some(stacked(&Observed::of(rig, &pose.perturbed_in_from(&xi), points)?))
        };
        let mut jacobian = DMatrix::zeros(4 * points.len(), UNKNOWNS);
        for axis in 0..6 {
            jacobian.set_column(axis, &((residuals(STEP, axis)? - residuals(-STEP, axis)?) / (2.0 * STEP)));
        }
        // Rows of the right image.
        for k in 0..points.len() {
            (jacobian[(4 * k + 1, 6)], jacobian[(4 * k + 3, 6)]) = (DIFFERENCE, SUM);
        }
        let normal: SMatrix<f64, UNKNOWNS, UNKNOWNS> =
            (jacobian.transpose() * &jacobian).fixed_view::<7, 7>(0, 0).into();
        Some(Self { inverse: normal.cholesky()?.inverse() * jacobian.transpose() })
    }

    /// The motion from a pose to the one at which a rig shows the points at the observed pixels.
    fn step(
        &self,
        rig: &StereoRig,
        pose: &Pose<CamLeft, Model>,
        points: &[Point3<f64>],
        observed: &Observed,
    ) -> Option<Vector6<f64>> {
        let residual = stacked(observed) - stacked(&Observed::of(rig, pose, points)?);
        let step: SVector<f64, UNKNOWNS> = &self.inverse * residual;
        Some(step.fixed_rows::<6>(0).into())
    }
}

/// Weights of the difference and of the sum of the pixels of both images. The tracker compares each image with a stored view, and all three
/// have equal noise: differences from the view have the covariance (2, 1; 1, 2), with the variances 1 of their difference and 3 of
/// their sum, over the square root of 2 each.
const DIFFERENCE: f64 = std::f64::consts::FRAC_1_SQRT_2;
const SUM: f64 = 0.408_248_290_463_863;

/// Pixels of all points, weighted: differences and sums of both images.
fn stacked(observed: &Observed) -> DVector<f64> {
    let weighted = |[left, right]: &[Vector2<f64>; 2]| {
        let (difference, sum) = ((right - left) * DIFFERENCE, (right + left) * SUM);
        [difference.x, difference.y, sum.x, sum.y]
    };
    DVector::from_iterator(4 * observed.0.len(), observed.0.iter().flat_map(weighted))
}

/// A number of a rig.
#[derive(Clone, Copy, Debug)]
enum Number {
    /// Of the left (0) or right (1) camera: 0 to 3 are fx, fy, cx, cy, larger ones the coefficients of the lens.
    OfCamera { side: usize, index: usize },
    /// Of the pose between the cameras.
    OfPose { axis: usize },
}

impl Number {
    fn of(rig: &StereoRig, name: &str) -> Option<Self> {
        const POSE: [&str; 6] = ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"];
        let (part, key) = name.split_once('.')?;
        let side = match part {
            "left" => 0,
            "right" => 1,
            "cam_right_from_cam_left" => {
                return POSE.iter().position(|name| *name == key).map(|axis| Self::OfPose { axis });
            }
            _ => return None,
        };
        let lens = [rig.left(), rig.right()][side].distortion().named_coefficients().map(|(name, _)| name);
        let index = ["fx", "fy", "cx", "cy"].into_iter().chain(lens).position(|name| name == key)?;
        Some(Self::OfCamera { side, index })
    }

    fn moved(self, rig: &StereoRig, by: f64) -> Option<StereoRig> {
        let (mut cameras, mut right_from_left) = ([*rig.left(), *rig.right()], *rig.cam_right_from_cam_left());
        match self {
            Self::OfCamera { side, index } => cameras[side] = moved_camera(&cameras[side], index, by)?,
            Self::OfPose { axis } => {
                let step: Isometry3<f64> = se3::exp(&Vector6::from_fn(|i, _| if i == axis { by } else { 0.0 }));
                let moved = step * right_from_left.isometry();
                right_from_left = Pose::from_parts(moved.translation.vector, moved.rotation);
            }
        }
        StereoRig::new(cameras[0], cameras[1], right_from_left).ok()
    }
}

fn moved_camera(camera: &Camera, index: usize, by: f64) -> Option<Camera> {
    let Pinhole { fx, fy, cx, cy } = *camera.pinhole();
    let mut numbers = [fx, fy, cx, cy];
    let mut distortion = *camera.distortion();
    match (numbers.get_mut(index), &mut distortion) {
        (Some(number), _) => *number += by,
        (None, Distortion::None) => return None,
        (None, Distortion::BrownConrady5 { coefficients }) => *coefficients.get_mut(index - 4)? += by,
        (None, Distortion::BrownConrady8 { coefficients }) => *coefficients.get_mut(index - 4)? += by,
        (None, Distortion::Equidistant { coefficients }) => *coefficients.get_mut(index - 4)? += by,
    }
    let [fx, fy, cx, cy] = numbers;
    Camera::new(camera.size(), Pinhole { fx, fy, cx, cy }, distortion).ok()
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use pb3dp_geometry::ImageSize;

    use super::*;

    fn rig() -> StereoRig {
        let pinhole = Pinhole { fx: 740.0, fy: 740.0, cx: 319.5, cy: 239.5 };
        let camera = Camera::new(ImageSize { width: 640, height: 480 }, pinhole, Distortion::None).unwrap();
        StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap()
    }

    /// A target of 110 mm, 500 mm in front of the left camera, parallel to the images.
    fn first(rig: &StereoRig) -> FirstPair {
        let pose = Pose::from_translation(Vector3::new(0.0, 0.0, 0.5));
        let half = 740.0 * 0.055 / 0.5;
        let corners =
            [(-1.0, -1.0), (0.0, -1.0), (1.0, -1.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (-1.0, 1.0), (-1.0, 0.0)];
        let outline = corners.map(|(x, y)| Vector2::new(319.5 + half * x, 239.5 + half * y));
        FirstPair::of_outline(rig, &pose, &outline).unwrap()
    }

    /// Standard deviations of the first pose with one uncertain number: millimetres and degrees.
    fn sigmas(name: &str, sigma: f64) -> Vector6<f64> {
        let rig = rig();
        let term = CalibrationTerm::new(&rig, &[name.to_owned()], &[vec![sigma * sigma]]).unwrap();
        let first = first(&rig);
        let share = term.share(&first, &first.cam_left_from_model).unwrap();
        assert!(share.motion.norm() < 1e-20, "the first pose is the definition: {}", share.motion);
        let sigma = share.pose.diagonal().map(|variance| variance.max(0.0).sqrt());
        Vector6::from_fn(|i, _| if i < 3 { 1e3 * sigma[i] } else { sigma[i].to_degrees() })
    }

    /// The figures of "Where it fails" in docs/method.md, which follow from `z = f b / (d + c)` by hand.
    #[test]
    fn one_uncertain_number_has_the_effect_of_the_formula() {
        let z_mm = |name: &str, sigma: f64| sigmas(name, sigma).z;
        // z^2 / (f b) times 0.1 px, for a shift of a principal point.
        assert!((z_mm("right.cx", 0.1) - 0.338).abs() < 0.002);
        // f times 0.01 degrees = 0.129 px on the axis, and more by the squared tangent of the angle from it: the target is 0.2 to the left
        // of the right camera's axis, and extends over 0.11 to either side.
        let off_axis = 1.0 + 0.2f64.powi(2) + 0.11f64.powi(2) / 3.0;
        let turned = z_mm("cam_right_from_cam_left.ry_rad", 0.01f64.to_radians());
        assert!((turned - 0.436 * off_axis).abs() < 0.005, "{turned}");
        assert!((z_mm("cam_right_from_cam_left.x_m", 1e-4) - 0.5).abs() < 0.002);
        // Rolled cameras: disparity changes down the rows, by z / b in the tangent of the tilt.
        let roll = sigmas("cam_right_from_cam_left.rz_rad", 0.05f64.to_radians());
        assert!((roll[3] - 0.25).abs() < 0.005 && roll[4] < 0.01, "{roll}");
        // A shift of rows is no disparity.
        assert!(sigmas("right.cy", 0.5).norm() < 1e-6);
        // The left principal point moves the ray of the origin: z / f times 0.1 px.
        assert!((sigmas("left.cx", 0.1).x - 0.068).abs() < 0.002);
        assert!((sigmas("left.cy", 0.1).y - 0.068).abs() < 0.002);
    }

    /// A baseline that is wrong by 1 in 1000 scales all lengths: a motion of 50 mm is wrong by 0.05 mm, the pose by 0.5 mm.
    #[test]
    fn the_motion_has_a_small_share_of_the_errors() {
        let rig = rig();
        let names = ["cam_right_from_cam_left.x_m".to_owned()];
        let term = CalibrationTerm::new(&rig, &names, &[vec![1e-8]]).unwrap();
        let first = first(&rig);
        let now = Pose::from_parts(Vector3::new(0.0, 0.0, 0.55), UnitQuaternion::identity());
        let share = term.share(&first, &now).unwrap();
        assert!((share.pose[(2, 2)].sqrt() - 0.55e-3).abs() < 5e-6, "{}", share.pose);
        assert!((share.motion[(2, 2)].sqrt() - 0.05e-3).abs() < 2e-6, "{}", share.motion);
    }

    #[test]
    fn a_calibration_without_uncertain_numbers_has_no_share() {
        let rig = rig();
        let first = first(&rig);
        let none = CalibrationTerm::new(&rig, &[], &[]).unwrap().share(&first, &first.cam_left_from_model).unwrap();
        assert_eq!((none.pose, none.motion), (Matrix6::zeros(), Matrix6::zeros()));
        let wrong = |name: &str, rows: &[Vec<f64>]| CalibrationTerm::new(&rig, &[name.to_owned()], rows).unwrap_err();
        assert_eq!(wrong("left.k1", &[vec![1.0]]), CalibrationTermError::Name { name: "left.k1".into() });
        assert_eq!(wrong("left.fx", &[]), CalibrationTermError::Shape { rows: 0, names: 1 });
        assert_eq!(wrong("left.fx", &[vec![-1.0]]), CalibrationTermError::Shape { rows: 1, names: 1 });
        assert!(matches!(wrong("cam_right_from_cam_left.x_m", &[vec![25.0]]), CalibrationTermError::Uncertain { .. }));
    }
}
