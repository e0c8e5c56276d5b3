//! Velocities of rigid bodies.

use std::marker::PhantomData;

use nalgebra::{Vector3, Vector6};

use crate::frames::Frame;
use crate::pose::Pose;

/// A twist in the axes of frame `In`: linear velocity (m/s) of the origin of the moving frame, and angular velocity (rad/s). The type
/// does not name the moving frame; the name of the variable does. Vector order is always `[linear; angular]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist<In: Frame> {
    /// Linear velocity, m/s.
    pub linear_m_per_s: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular_rad_per_s: Vector3<f64>,
    frame: PhantomData<In>,
}

impl<In: Frame> Twist<In> {
    /// Creates a twist; both velocities must be expressed in `In`.
    pub fn new(linear_m_per_s: Vector3<f64>, angular_rad_per_s: Vector3<f64>) -> Self {
        Self { linear_m_per_s, angular_rad_per_s, frame: PhantomData }
    }

    /// No motion.
    pub fn zero() -> Self {
        Self::new(Vector3::zeros(), Vector3::zeros())
    }

    /// `[linear; angular]`.
    pub fn to_vector(&self) -> Vector6<f64> {
        let (v, w) = (&self.linear_m_per_s, &self.angular_rad_per_s);
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }

    /// From `[linear; angular]`.
    pub fn from_vector(vector: &Vector6<f64>) -> Self {
        Self::new(vector.fixed_rows::<3>(0).into_owned(), vector.fixed_rows::<3>(3).into_owned())
    }

    /// The same velocities of the same point, expressed in another frame (both parts are rotated; the reference point does not
    /// change).
    pub fn expressed_in<To: Frame>(&self, to_from_in: &Pose<To, In>) -> Twist<To> {
        Twist::new(
            to_from_in.transform_vector(&self.linear_m_per_s),
            to_from_in.transform_vector(&self.angular_rad_per_s),
        )
    }
}
