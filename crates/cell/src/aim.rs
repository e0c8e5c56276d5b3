//! The desired pose of the hand: that of the setup relative to the visible surface of the target, shifted by the operator.
//!
//! The surface becomes better known while the hand follows. What the hand does must not change by that, so it is used only where the hand
//! approaches: at `start`, `resume` and `re-align`.

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, Model, Surface};

use crate::percept::Percept;

/// See the module documentation.
#[derive(Clone, Debug)]
pub struct Aim {
    surface_from_hand_desired: Pose<Surface, Hand>,
    hand_from_hand_shifted: Pose<Hand, Hand>,
    /// The surface as it was seen last, with the number of its target.
    newest_surface: Option<(u64, Pose<Surface, Model>)>,
    model_from_surface: Pose<Model, Surface>,
}

impl Aim {
    /// The pose of the setup, relative to `model` until the surface is known.
    pub fn new(model_from_hand_desired: &Pose<Model, Hand>) -> Self {
        Self {
            surface_from_hand_desired: model_from_hand_desired.relabel(),
            hand_from_hand_shifted: Pose::coincident(),
            newest_surface: None,
            model_from_surface: Pose::coincident(),
        }
    }

    /// Stores what a pair shows of the surface.
    pub fn see(&mut self, percept: &Percept) {
        let target = percept.estimate.target;
        self.newest_surface = percept.surface_from_model.map(|surface| (target, surface)).or(self.newest_surface);
    }

    /// Shifts the pose; returns it if it changes.
    pub fn shift(&mut self, hand_from_hand_shifted: Pose<Hand, Hand>) -> Option<Pose<Model, Hand>> {
        let is_new = hand_from_hand_shifted.is_finite() && hand_from_hand_shifted != self.hand_from_hand_shifted;
        is_new.then(|| self.hand_from_hand_shifted = hand_from_hand_shifted)?;
        Some(self.model_from_hand_desired())
    }

    /// Takes the surface as it is known now; returns the pose if it changes. A target whose surface was not seen has none but `model`.
    pub fn align(&mut self, target: Option<u64>) -> Option<Pose<Model, Hand>> {
        let known = self.newest_surface.filter(|(of, surface)| Some(*of) == target && surface.is_finite());
        let model_from_surface = known.map_or_else(Pose::coincident, |(_, surface)| surface.inverse());
        let is_new = model_from_surface != self.model_from_surface;
        is_new.then(|| self.model_from_surface = model_from_surface)?;
        Some(self.model_from_hand_desired())
    }

    /// The surface for which the desired pose is meant now.
    pub fn model_from_surface(&self) -> Pose<Model, Surface> {
        self.model_from_surface
    }

    fn model_from_hand_desired(&self) -> Pose<Model, Hand> {
        self.model_from_surface * self.surface_from_hand_desired * self.hand_from_hand_shifted
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use pb3dp_estimation_core::estimate::{SurfaceEstimate, TrackEstimate};
    use pb3dp_estimation_core::status::Status;
    use pb3dp_geometry::MonotonicTime;
    use pb3dp_servo::supervisor::FrameInput;

    use super::*;

    fn pose<A: pb3dp_geometry::frames::Frame, B: pb3dp_geometry::frames::Frame>(x: f64, angle: f64) -> Pose<A, B> {
        Pose::from_parts(Vector3::new(x, -0.02, 0.1), nalgebra::UnitQuaternion::from_euler_angles(angle, 0.2, -0.3))
    }

    fn percept(target: u64, surface: Option<Pose<Surface, Model>>) -> Percept {
        let frame = FrameInput { sequence: 4, at: MonotonicTime::from_nanos(7), skew_s: 0.0 };
        let known = |surface_from_model| SurfaceEstimate {
            surface_from_model,
            covariance: nalgebra::Matrix6::identity(),
            version: 1,
        };
        let blank = TrackEstimate::without_pose(Status::Ok, String::new());
        Percept::new(frame, &TrackEstimate { surface: surface.map(known), ..blank }, target, None)
    }

    #[test]
    fn the_surface_counts_only_where_the_hand_approaches_and_only_for_its_target() {
        let desired: Pose<Model, Hand> = pose(0.3, 0.4);
        let mut aim = Aim::new(&desired);
        assert_eq!(aim.align(Some(1)), None, "nothing is known");
        let surface: Pose<Surface, Model> = pose(0.01, 0.05);
        aim.see(&percept(1, Some(surface)));
        aim.see(&percept(1, None));
        let shift: Pose<Hand, Hand> = pose(0.005, 0.0);
        assert_eq!(aim.shift(shift), Some(desired * shift), "the surface is not used yet");
        assert_eq!(aim.shift(shift), None);
        let aligned = aim.align(Some(1)).unwrap();
        // Relative to the surface, the hand is where the setup says, but for the shift.
        let surface_from_hand = surface * aligned;
        assert!((surface_from_hand.inverse() * desired.relabel() * shift).rotation_angle_rad() < 1e-12);
        assert!((surface_from_hand.translation_m() - (desired * shift).translation_m()).norm() < 1e-12);
        assert_eq!((aim.align(Some(1)), aim.model_from_surface()), (None, surface.inverse()));
        assert_eq!(aim.align(Some(2)), Some(desired * shift), "of another target");
    }
}
