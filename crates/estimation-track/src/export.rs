//! Export of the recovered surface.

use nalgebra::{Point3, Unit, Vector3};
use pb3dp_estimation_core::method::SurfacePoint;
use pb3dp_estimation_views::colour_planes::OPPONENT_FROM_RGB;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::kernels::{SurfaceGroup, ViewGroup};

/// A surface point of one lane, with its colour in the first view. `sigma_inverse`: standard deviation of its inverse depth there.
pub(super) fn surface_point(
    group: &SurfaceGroup,
    view: &ViewGroup,
    lane: usize,
    first_from_model: &Pose<CamLeft, Model>,
    sigma_inverse: f64,
) -> SurfacePoint {
    let base = |k: usize| Vector3::from_fn(|axis, _| f64::from(group.base[3 * k + axis].0[lane]));
    // Columns and rows of the first image run right and down, so their cross product points away from the camera.
    let away = Unit::try_new(base(0).cross(&base(1)), 0.0).map_or_else(Vector3::z, Unit::into_inner);
    let value = view.value.map(|v| v.0[lane]);
    let rgb = std::array::from_fn(|c| {
        let sum: f32 = OPPONENT_FROM_RGB.iter().zip(value).map(|(row, value)| row[c] * value).sum();
        sum.round().clamp(0.0, 255.0) as u8
    });
    let position_in_model_m = Point3::from(group.point.map(|x| f64::from(x.0[lane])));
    let in_first = first_from_model.transform_point(&position_in_model_m);
    SurfacePoint {
        position_in_model_m,
        normal_in_model: -away,
        sigma_m: in_first.z * in_first.coords.norm() * sigma_inverse,
        rgb,
    }
}
