//! Conversion of hypotheses into the numbers that the kernels use.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, PlaneHypothesis, SearchRange};

use crate::photo_model::{ModelPoint, PhotoModel};

/// Number of hypotheses scored together.
pub(super) const BATCH: usize = 64;

/// Number of fraction bits of fixed-point shifts: resolution 1/131072 of a pixel.
pub(super) const FRACTION_BITS: u32 = 17;

/// Largest shift that fixed-point addresses support in addition to a window of the largest image, pixels.
const SHIFT_MAX_PX: f64 = 8000.0;

/// Matches of each hypothesis of a batch.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct Counts {
    pub inner: [i32; BATCH],
    pub outer: [i32; BATCH],
}

impl Default for Counts {
    fn default() -> Self {
        Self { inner: [0; BATCH], outer: [0; BATCH] }
    }
}

/// Affine shifts for rectified pairs: a point (du, dv) moves by `slope_u du + slope_v dv + offset` columns, relative to the
/// window's first shift, in fixed point, plus half a pixel.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct Batch {
    /// Number of lanes in use.
    pub len: usize,
    pub slope_u: [i32; BATCH],
    pub slope_v: [i32; BATCH],
    pub offset: [i32; BATCH],
    /// Homographies for general pairs, of (du, dv, 1), row by row, without the lower right element, which is 1.
    pub homographies: [[f32; 8]; BATCH],
    /// Lanes with a rejected hypothesis; their numbers are zero.
    pub refused: [bool; BATCH],
}

/// Data shared by all hypotheses of a frame.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    range: SearchRange,
    centre_ray: Vector3<f64>,
    /// Origin of point coordinates: the pixel next to the model's centre.
    origin: (i32, i32),
    /// Smallest and largest (du, dv) of the points.
    bounds: [(f64, f64); 2],
    pair: PinholePair,
    /// Homography of the plane at infinity and image of the baseline, for (du, dv, 1).
    infinite: Matrix3<f64>,
    epipole: Vector3<f64>,
}

impl Frame {
    pub fn new(pair: &PinholePair, model: &PhotoModel, range: SearchRange) -> Self {
        let centre_px = model.centre_px();
        let origin = (centre_px.x.round() as i32, centre_px.y.round() as i32);
        let mut infinite = pair.infinite_homography();
        let third = infinite * Vector3::new(f64::from(origin.0), f64::from(origin.1), 1.0);
        infinite.set_column(2, &third);
        Self {
            range,
            centre_ray: pair.left_ray(&centre_px),
            origin,
            bounds: bounds(model.inner().iter().chain(model.outer()), origin),
            pair: *pair,
            infinite,
            epipole: pair.epipole(),
        }
    }

    pub fn origin(&self) -> (i32, i32) {
        self.origin
    }

    pub fn pair(&self) -> &PinholePair {
        &self.pair
    }

    pub fn range(&self) -> &SearchRange {
        &self.range
    }

    pub fn centre_ray(&self) -> &Vector3<f64> {
        &self.centre_ray
    }

    /// The corners of the points' bounding box, (du, dv).
    pub fn corners(&self) -> [(f64, f64); 4] {
        let [(u0, v0), (u1, v1)] = self.bounds;
        [(u0, v0), (u1, v0), (u0, v1), (u1, v1)]
    }

    /// Prepares up to [`BATCH`] hypotheses.
    pub fn batch(&self, hypotheses: &[PlaneHypothesis], first_shift: Option<i32>) -> Batch {
        let mut batch = Batch {
            len: hypotheses.len().min(BATCH),
            slope_u: [0; BATCH],
            slope_v: [0; BATCH],
            offset: [0; BATCH],
            homographies: [[0.0; 8]; BATCH],
            refused: [true; BATCH],
        };
        for (lane, psi) in hypotheses.iter().take(BATCH).enumerate() {
            let Some(plane) = self.accepted_plane(psi) else { continue };
            match first_shift {
                Some(first_shift) => {
                    let Some([slope_u, slope_v, offset]) = self.fixed_shift(&plane, first_shift) else { continue };
                    batch.slope_u[lane] = slope_u;
                    batch.slope_v[lane] = slope_v;
                    batch.offset[lane] = offset;
                }
                None => {
                    let Some(homography) = self.homography(&plane) else { continue };
                    batch.homographies[lane] = homography;
                }
            }
            batch.refused[lane] = false;
        }
        batch
    }

    /// Inverse depth as a linear function of (du, dv, 1), if the hypothesis is within the range and every point is in front of
    /// the left camera.
    fn accepted_plane(&self, psi: &PlaneHypothesis) -> Option<Vector3<f64>> {
        if !self.range.contains(psi) {
            return None;
        }
        let plane = self.shifted_plane(&psi.inverse_depth_plane(&self.centre_ray)?);
        self.corners().iter().all(|&(u, v)| plane.x * u + plane.y * v + plane.z > 0.0).then_some(plane)
    }

    /// `K_L^-T q` for coordinates relative to the origin.
    fn shifted_plane(&self, q: &Vector3<f64>) -> Vector3<f64> {
        let plane = self.pair.pixel_plane(q);
        let at_origin = plane.x * f64::from(self.origin.0) + plane.y * f64::from(self.origin.1) + plane.z;
        Vector3::new(plane.x, plane.y, at_origin)
    }

    /// Column shift of a point of inverse depth 0, and the additional shift per 1/m.
    pub fn shift_of_inverse_depth(&self) -> (f64, f64) {
        (self.pair.right().cx - self.pair.left().cx, self.epipole.x)
    }

    fn fixed_shift(&self, plane: &Vector3<f64>, first_shift: i32) -> Option<[i32; 3]> {
        let (constant_px, px_per_inverse_m) = self.shift_of_inverse_depth();
        let (u, v) = (plane.x * px_per_inverse_m, plane.y * px_per_inverse_m);
        let offset = plane.z * px_per_inverse_m + constant_px;
        let held = |shift_px: f64| shift_px.abs() < SHIFT_MAX_PX;
        let all_held = self.corners().iter().all(|&(du, dv)| held(u * du + v * dv + offset));
        if !(all_held && held(u) && held(v) && held(offset)) {
            return None;
        }
        let fixed = |value: f64| (value * f64::from(1 << FRACTION_BITS)).round() as i32;
        let half = 1 << (FRACTION_BITS - 1);
        Some([fixed(u), fixed(v), fixed(offset - f64::from(first_shift)).wrapping_add(half)])
    }

    /// `A + b planeT`, divided by its lower right element; `None` if a point is behind the right camera.
    fn homography(&self, plane: &Vector3<f64>) -> Option<[f32; 8]> {
        let h = self.infinite + self.epipole * plane.transpose();
        let behind = |&(u, v): &(f64, f64)| h[(2, 0)] * u + h[(2, 1)] * v + h[(2, 2)] <= 0.0;
        if h[(2, 2)] <= 0.0 || self.corners().iter().any(behind) {
            return None;
        }
        let h = h / h[(2, 2)];
        Some([h[(0, 0)], h[(0, 1)], h[(0, 2)], h[(1, 0)], h[(1, 1)], h[(1, 2)], h[(2, 0)], h[(2, 1)]].map(|x| x as f32))
    }
}

fn bounds<'a>(points: impl Iterator<Item = &'a ModelPoint>, origin: (i32, i32)) -> [(f64, f64); 2] {
    let mut low = (f64::INFINITY, f64::INFINITY);
    let mut high = (f64::NEG_INFINITY, f64::NEG_INFINITY);
    for point in points {
        let (u, v) = (f64::from(point.u - origin.0), f64::from(point.v - origin.1));
        low = (low.0.min(u), low.1.min(v));
        high = (high.0.max(u), high.1.max(v));
    }
    [low, high]
}
