//! Rigid transforms with their frames encoded in the type.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra::{
    Isometry3, Matrix3, Matrix4, Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6,
};

use crate::frames::Frame;
use crate::se3;

/// A rigid transform from frame `From` to frame `To`: maps coordinates in `From` to coordinates in `To`; equivalently, the pose of
/// `From` in `To`.
///
/// Only transforms with a common frame can be composed: `Pose<A, B> * Pose<B, C>` is a `Pose<A, C>`.
/// Translation in metres.
pub struct Pose<To: Frame, From: Frame> {
    isometry: Isometry3<f64>,
    frames: PhantomData<fn(From) -> To>,
}

impl<To: Frame, From: Frame> Pose<To, From> {
    /// Creates a pose from an isometry that maps coordinates in `From` to coordinates in `To`.
    pub fn from_isometry(isometry: Isometry3<f64>) -> Self {
        Self { isometry, frames: PhantomData }
    }

    /// Creates a pose from the origin of `From` in `To`, and the rotation of the axes of `From` in `To`.
    pub fn from_parts(translation_m: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Self {
        Self::from_isometry(Isometry3::from_parts(Translation3::from(translation_m), rotation))
    }

    /// A pure translation, metres.
    pub fn from_translation(translation_m: Vector3<f64>) -> Self {
        Self::from_parts(translation_m, UnitQuaternion::identity())
    }

    /// The identity: the two frames coincide.
    pub fn coincident() -> Self {
        Self::from_isometry(Isometry3::identity())
    }

    /// Creates a pose from a rotation matrix and a translation in metres; the matrix is re-orthonormalised to the nearest
    /// rotation.
    ///
    /// For matrices that are rotations apart from rounding, or that were written with few digits. A caller that reads a matrix from
    /// outside must check first that it is nearly a rotation. A matrix that is singular, not finite or contains a reflection gives a
    /// meaningless pose, but never a panic.
    pub fn from_rotation_matrix(rotation: &Matrix3<f64>, translation_m: Vector3<f64>) -> Self {
        let rotation = Rotation3::from_matrix_unchecked(nearest_orthogonal(rotation));
        Self::from_parts(translation_m, UnitQuaternion::new_normalize(*UnitQuaternion::from_rotation_matrix(&rotation)))
    }

    /// The transform without its frames, for functions that compute with plain numbers.
    pub fn isometry(&self) -> &Isometry3<f64> {
        &self.isometry
    }

    /// Origin of `From` in `To`, metres.
    pub fn translation_m(&self) -> Vector3<f64> {
        self.isometry.translation.vector
    }

    /// The rotation: it maps directions in `From` to directions in `To`.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        self.isometry.rotation
    }

    /// The same rotation as a matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.isometry.rotation.to_rotation_matrix().into_inner()
    }

    /// The 4x4 homogeneous matrix, translation in metres.
    pub fn to_homogeneous(&self) -> Matrix4<f64> {
        self.isometry.to_homogeneous()
    }

    /// The inverse: maps coordinates in `To` to coordinates in `From`.
    pub fn inverse(&self) -> Pose<From, To> {
        Pose::from_isometry(self.isometry.inverse())
    }

    /// Coordinates in `To` of a point given in `From`, metres.
    pub fn transform_point(&self, point_in_from: &Point3<f64>) -> Point3<f64> {
        self.isometry.transform_point(point_in_from)
    }

    /// Coordinates in `To` of a free vector given in `From`.
    pub fn transform_vector(&self, vector_in_from: &Vector3<f64>) -> Vector3<f64> {
        self.isometry.transform_vector(vector_in_from)
    }

    /// Angle of the rotation, radians, 0 to pi.
    pub fn rotation_angle_rad(&self) -> f64 {
        self.isometry.rotation.angle()
    }

    /// Exponential map: the pose `exp(xi)` that maps coordinates in `From` to coordinates in `To`; `xi` is `[rho; phi]`, metres
    /// and radians.
    pub fn exp(xi: &Vector6<f64>) -> Self {
        Self::from_isometry(se3::exp(xi))
    }

    /// The tangent vector `[rho; phi]` (metres, radians) whose exponential is this transform.
    pub fn log(&self) -> Vector6<f64> {
        se3::log(&self.isometry)
    }

    /// Maps tangent vectors `[rho; phi]` at `From` to tangent vectors at `To`; see [`se3::adjoint`].
    pub fn adjoint(&self) -> Matrix6<f64> {
        se3::adjoint(&self.isometry)
    }

    /// `exp(xi) * self`: a small motion `xi = [rho; phi]` expressed in `To`.
    pub fn perturbed_in_to(&self, xi: &Vector6<f64>) -> Self {
        Pose::<To, To>::exp(xi) * *self
    }

    /// `self * exp(xi)`: a small motion `xi = [rho; phi]` expressed in `From`.
    pub fn perturbed_in_from(&self, xi: &Vector6<f64>) -> Self {
        *self * Pose::<From, From>::exp(xi)
    }

    /// Interpolates a fraction `s` of the way to `end`, along the connecting screw motion; see [`se3::interpolate`].
    pub fn interpolate(&self, end: &Self, s: f64) -> Self {
        Self::from_isometry(se3::interpolate(&self.isometry, &end.isometry, s))
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.isometry.translation.vector.iter().chain(self.isometry.rotation.coords.iter()).all(|x| x.is_finite())
    }

    /// The same numbers under other frame names, for frames that are the same by definition. For example, the base of the target arm is
    /// [`Base`](crate::frames::Base) in code for one arm, and [`TcBase`](crate::frames::TcBase) in code that deals with both.
    pub fn relabel<To2: Frame, From2: Frame>(&self) -> Pose<To2, From2> {
        Pose::from_isometry(self.isometry)
    }
}

/// The orthogonal factor of the polar decomposition, by Newton's iteration (Higham 1986): each step averages the matrix
/// with its inverse transpose. Converges quadratically; from a matrix with four good digits it takes three steps.
fn nearest_orthogonal(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    const STEPS: usize = 20;
    let mut nearest = *matrix;
    for _ in 0..STEPS {
        let Some(inverse) = nearest.try_inverse() else {
            break;
        };
        let next = (nearest + inverse.transpose()) * 0.5;
        let change = (next - nearest).amax();
        nearest = next;
        if change <= f64::EPSILON {
            break;
        }
    }
    nearest
}

impl<A: Frame, B: Frame, C: Frame> Mul<Pose<B, C>> for Pose<A, B> {
    type Output = Pose<A, C>;
    fn mul(self, rhs: Pose<B, C>) -> Pose<A, C> {
        let mut isometry = self.isometry * rhs.isometry;
        isometry.rotation.renormalize_fast();
        Pose::from_isometry(isometry)
    }
}

impl<To: Frame, From: Frame> Clone for Pose<To, From> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<To: Frame, From: Frame> Copy for Pose<To, From> {}

impl<To: Frame, From: Frame> PartialEq for Pose<To, From> {
    fn eq(&self, other: &Self) -> bool {
        self.isometry == other.isometry
    }
}

impl<To: Frame, From: Frame> fmt::Debug for Pose<To, From> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let t = self.isometry.translation.vector;
        let r = self.isometry.rotation.scaled_axis();
        write!(
            f,
            "{}_from_{} {{ translation_m: [{}, {}, {}], rotation_vector_rad: [{}, {}, {}] }}",
            To::NAME,
            From::NAME,
            t.x,
            t.y,
            t.z,
            r.x,
            r.y,
            r.z
        )
    }
}
