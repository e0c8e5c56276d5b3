//! Comparison of two calibrations of the same stereo rig: parameter by parameter in standard deviations of both, and in
//! millimetres over the image.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Vector2, Vector6};
use pb3dp_geometry::{Camera, StereoRig, se3};

use super::triangulate;
use crate::adjust::POSE_NUMBERS;
use crate::stand::CELLS;

/// A calibration with its covariance.
#[derive(Clone, Debug)]
pub struct Known {
    /// The stereo rig.
    pub rig: StereoRig,
    /// Names of the parameters, as in [`crate::fit::Covariance`]; empty if there is no covariance.
    pub names: Vec<String>,
    /// Covariance of the parameters.
    pub covariance: DMatrix<f64>,
}

/// The difference of one parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Name; pixels, metres, radians.
    pub name: String,
    /// Second minus first; for the pose `log(second * first^-1)`, as in the covariance.
    pub difference: f64,
    /// Standard deviation of the difference, from both calibrations.
    pub sigma: f64,
}

impl Difference {
    /// The difference in standard deviations.
    pub fn sigmas(&self) -> f64 {
        self.difference / self.sigma
    }
}

/// Displacement of a point at the working distance between the first and the second calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// Pixel in the left image.
    pub left_px: Vector2<f64>,
    /// Second depth minus first, metres.
    pub depth_m: f64,
    /// Lateral displacement, metres.
    pub lateral_m: Vector2<f64>,
}

/// The comparison of two calibrations.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The parameters estimated by both.
    pub parameters: Vec<Difference>,
    /// Root mean squared difference of all parameters together, in standard deviations (Mahalanobis); 1 is expected by chance.
    /// `None` if one calibration has no covariance or the parameters differ.
    pub sigmas: Option<f64>,
    /// Over the left image, where the right camera sees the points as well; row by row.
    pub displacements: Vec<Displacement>,
}

/// Compares two calibrations at a working distance.
pub fn compare(first: &Known, second: &Known, depth_m: f64) -> Comparison {
    let values = [&first.rig, &second.rig].map(values);
    let xi = motion(&first.rig, &second.rig);
    let common: Vec<(usize, usize, &String)> = first
        .names
        .iter()
        .enumerate()
        .filter_map(|(at, name)| Some((at, second.names.iter().position(|other| other == name)?, name)))
        .collect();
    let differences = common.iter().filter_map(|(a, b, name)| {
        let difference = match xi.iter().find(|(other, _)| other == *name) {
            Some((_, difference)) => *difference,
            None => values[1].get(*name)? - values[0].get(*name)?,
        };
        let variance = first.covariance.get((*a, *a))? + second.covariance.get((*b, *b))?;
        Some(Difference { name: (*name).clone(), difference, sigma: variance.max(0.0).sqrt() })
    });
    let parameters: Vec<Difference> = differences.collect();
    let is_same = common.len() == first.names.len() && common.len() == second.names.len();
    let sigmas = (is_same && !common.is_empty() && parameters.len() == common.len())
        .then(|| {
            let joint = DMatrix::from_fn(common.len(), common.len(), |row, column| {
                let ((a, b, _), (c, d, _)) = (common[row], common[column]);
                first.covariance[(a, c)] + second.covariance[(b, d)]
            });
            mahalanobis(&parameters, &joint)
        })
        .flatten();
    Comparison { parameters, sigmas, displacements: displacements(&first.rig, &second.rig, depth_m) }
}

/// Root mean square in units of a covariance.
fn mahalanobis(differences: &[Difference], joint: &DMatrix<f64>) -> Option<f64> {
    // Scaled first: the variances of a coefficient and of a focal length differ by ten orders of magnitude.
    let scale = joint.diagonal().map(|variance| 1.0 / variance.sqrt());
    let scaled =
        DMatrix::from_fn(joint.nrows(), joint.ncols(), |row, column| joint[(row, column)] * scale[row] * scale[column]);
    let whitened = DVector::from_fn(differences.len(), |at, _| differences[at].difference * scale[at]);
    let square = whitened.dot(&scaled.cholesky()?.solve(&whitened));
    Some((square / differences.len() as f64).sqrt())
}

/// `log(second * first^-1)` of the pose between the cameras, by name.
fn motion(first: &StereoRig, second: &StereoRig) -> Vec<(String, f64)> {
    let [first, second] = [first, second].map(|rig| *rig.cam_right_from_cam_left().isometry());
    let xi: Vector6<f64> = se3::log(&(second * first.inverse()));
    POSE_NUMBERS
        .iter()
        .zip(xi.iter())
        .map(|(name, value)| (format!("cam_right_from_cam_left.{name}"), *value))
        .collect()
}

/// Camera parameters by name.
fn values(rig: &StereoRig) -> BTreeMap<String, f64> {
    let of = |side: &'static str, camera: &Camera| {
        let p = *camera.pinhole();
        let pinhole = [("fx", p.fx), ("fy", p.fy), ("cx", p.cx), ("cy", p.cy)];
        let lens: Vec<(&str, f64)> = camera.distortion().named_coefficients().collect();
        pinhole.into_iter().chain(lens).map(move |(name, value)| (format!("{side}.{name}"), value)).collect::<Vec<_>>()
    };
    of("left", rig.left()).into_iter().chain(of("right", rig.right())).collect()
}

/// Displacement, by the second calibration, of points at the cell centres of the left image.
fn displacements(first: &StereoRig, second: &StereoRig, depth_m: f64) -> Vec<Displacement> {
    let size = first.left().size();
    let [across, down] = CELLS.map(f64::from);
    let mut all = Vec::new();
    for (column, row) in (0..CELLS[1]).flat_map(|row| (0..CELLS[0]).map(move |column| (column, row))) {
        let share = Vector2::new((f64::from(column) + 0.5) / across, (f64::from(row) + 0.5) / down);
        let left_px = Vector2::new(share.x * f64::from(size.width) - 0.5, share.y * f64::from(size.height) - 0.5);
        let Ok(ray) = first.left().unproject(&left_px) else { continue };
        let point = nalgebra::Point3::from(ray * (depth_m / ray.z));
        let in_right = first.cam_right_from_cam_left().transform_point(&point);
        let Some(right_px) = first.right().project(&in_right).filter(|pixel| is_inside(first.right(), pixel)) else {
            continue;
        };
        let Some(other) = triangulate(second, &left_px, &right_px) else { continue };
        let way = other - point;
        all.push(Displacement { left_px, depth_m: way.z, lateral_m: way.xy() });
    }
    all
}

fn is_inside(camera: &Camera, pixel: &Vector2<f64>) -> bool {
    let size = camera.size();
    (-0.5..f64::from(size.width) - 0.5).contains(&pixel.x) && (-0.5..f64::from(size.height) - 0.5).contains(&pixel.y)
}

impl Comparison {
    /// 95th percentiles of the displacements: depth, lateral, and both together, metres; NaN if there are none.
    pub fn p95_m(&self) -> [f64; 3] {
        let of = |length: &dyn Fn(&Displacement) -> f64| {
            let mut lengths: Vec<f64> = self.displacements.iter().map(length).collect();
            lengths.sort_by(f64::total_cmp);
            lengths.get((lengths.len() * 95 / 100).min(lengths.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
        };
        [of(&|d| d.depth_m.abs()), of(&|d| d.lateral_m.norm()), of(&|d| d.lateral_m.norm().hypot(d.depth_m))]
    }
}
