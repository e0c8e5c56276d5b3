//! From a hypothesis to the numbers that the kernel uses: the map of model points into the right image.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, PlaneHypothesis, SearchRange};

use crate::photo_model::{ModelPoint, PhotoModel};

/// Number of fraction bits of fixed-point shifts: resolution 1/131072 of a pixel.
pub(super) const FRACTION_BITS: u32 = 17;

/// Largest shift that fixed-point numbers support, pixels.
const SHIFT_MAX_PX: f64 = 8000.0;

/// The map of a point (du, dv), relative to the origin, into the right image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Projection {
    /// Rectified pairs: the point stays in its row and moves by `slope_u du + slope_v dv + offset` columns, in fixed point, plus
    /// half a pixel.
    Shift([i32; 3]),
    /// General pairs: a homography of (du, dv, 1), row by row, without the lower right element, which is 1.
    Homography([f32; 8]),
}

/// Data shared by all hypotheses of a frame.
#[derive(Clone, Debug)]
pub(super) struct Projector {
    range: SearchRange,
    pair: PinholePair,
    centre_ray: Vector3<f64>,
    /// Origin of point coordinates: the pixel next to the model's centre.
    origin: (i32, i32),
    /// The corners of the points' bounding box, (du, dv).
    corners: [(f64, f64); 4],
    /// Homography of the plane at infinity, of (du, dv, 1).
    infinite: Matrix3<f64>,
}

impl Projector {
    pub fn new(pair: &PinholePair, model: &PhotoModel, range: SearchRange) -> Self {
        let centre_px = model.centre_px();
        let origin = (centre_px.x.round() as i32, centre_px.y.round() as i32);
        let mut infinite = pair.infinite_homography();
        let third = infinite * Vector3::new(f64::from(origin.0), f64::from(origin.1), 1.0);
        infinite.set_column(2, &third);
        let corners = corners(model.inner().iter().chain(model.outer()), origin);
        Self { range, pair: *pair, centre_ray: pair.left_ray(&centre_px), origin, corners, infinite }
    }

    pub fn origin(&self) -> (i32, i32) {
        self.origin
    }

    /// The map of a hypothesis; `None` if it is outside the range, or if a point is behind a camera.
    pub fn projection(&self, psi: &PlaneHypothesis) -> Option<Projection> {
        if !self.range.contains(psi) {
            return None;
        }
        // Inverse depth as a linear function of (du, dv, 1).
        let mut plane = self.pair.pixel_plane(&psi.inverse_depth_plane(&self.centre_ray)?);
        plane.z += plane.x * f64::from(self.origin.0) + plane.y * f64::from(self.origin.1);
        let is_in_front = self.corners.iter().all(|&(u, v)| plane.x * u + plane.y * v + plane.z > 0.0);
        if !is_in_front {
            return None;
        }
        if self.pair.is_rectified() { self.shift(&plane) } else { self.homography(&plane) }
    }

    fn shift(&self, plane: &Vector3<f64>) -> Option<Projection> {
        let [u, v, offset] = (plane * self.pair.epipole().x).into();
        let offset = offset + (self.pair.right().cx - self.pair.left().cx);
        let held = |shift_px: f64| shift_px.abs() < SHIFT_MAX_PX;
        let all_held = self.corners.iter().all(|&(du, dv)| held(u * du + v * dv + offset));
        let fixed = |value: f64| (value * f64::from(1 << FRACTION_BITS)).round() as i32;
        let half = 1 << (FRACTION_BITS - 1);
        (all_held && held(u) && held(v) && held(offset))
            .then(|| Projection::Shift([fixed(u), fixed(v), fixed(offset) + half]))
    }

    /// `A + b planeT`, divided by its lower right element.
    fn homography(&self, plane: &Vector3<f64>) -> Option<Projection> {
        let h = self.infinite + self.pair.epipole() * plane.transpose();
        let behind = |&(u, v): &(f64, f64)| h[(2, 0)] * u + h[(2, 1)] * v + h[(2, 2)] <= 0.0;
        if h[(2, 2)] <= 0.0 || self.corners.iter().any(behind) {
            return None;
        }
        let h = (h / h[(2, 2)]).map(|x| x as f32);
        let row = |i: usize| [h[(i, 0)], h[(i, 1)], h[(i, 2)]];
        let ([a, b, c], [d, e, f], [g, i, _]) = (row(0), row(1), row(2));
        Some(Projection::Homography([a, b, c, d, e, f, g, i]))
    }
}

fn corners<'a>(points: impl Iterator<Item = &'a ModelPoint>, origin: (i32, i32)) -> [(f64, f64); 4] {
    let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    for point in points {
        let (u, v) = (f64::from(point.u - origin.0), f64::from(point.v - origin.1));
        low = (low.0.min(u), low.1.min(v));
        high = (high.0.max(u), high.1.max(v));
    }
    [low, (high.0, low.1), (low.0, high.1), high]
}
