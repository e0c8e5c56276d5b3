//! Stored views: appearance of the surface from one pose.

use pb3dp_estimation_core::wide::LANES;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::images::{CameraImages, LEVELS, texel_at};
use super::kernels::{ResidualGroup, SampledGroup, ViewGroup};

/// The surface's channels in the left image of one frame.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub(super) cam_left_from_model: Pose<CamLeft, Model>,
    pub(super) levels: [Vec<ViewGroup>; LEVELS],
    /// Last frame in which the view was used.
    pub(super) last_used: u64,
}

impl View {
    /// Allocates a view for a surface with these numbers of groups per level.
    pub(super) fn empty(groups: [usize; LEVELS]) -> Self {
        Self {
            cam_left_from_model: Pose::coincident(),
            levels: groups.map(|count| vec![ViewGroup::default(); count]),
            last_used: 0,
        }
    }

    /// Distance of the view from a pose: rotation over `turn_rad`, plus scale over `scale`. Rotation about the line of sight
    /// counts half, because it hides nothing.
    pub(super) fn distance(&self, pose: &Pose<CamLeft, Model>, turn_rad: f64, scale: f64) -> f64 {
        let turn = pose.rotation() * self.cam_left_from_model.rotation().inverse();
        let axis = turn.scaled_axis();
        let turned = nalgebra::Vector3::new(axis.x, axis.y, 0.5 * axis.z).norm() / turn_rad;
        let (here, there) = (pose.translation_m().z, self.cam_left_from_model.translation_m().z);
        let scaled = (here / there).abs().max(1e-6).ln().abs() / scale.ln();
        turned.hypot(scaled)
    }

    /// Stores one level from the left image; `sampled` are the groups projected with this view's pose. Points that do not fit (if
    /// residuals are given) are occluded, possibly by the target itself, and excluded.
    pub(super) fn take_level(
        &mut self,
        level: usize,
        left: &CameraImages,
        sampled: &[[SampledGroup; 2]],
        residuals: Option<&[ResidualGroup]>,
    ) {
        let step = (1_u32 << level) as f32;
        for (index, (view, sampled)) in self.levels[level].iter_mut().zip(sampled).enumerate() {
            *view = ViewGroup::default();
            let fits = |i: usize| residuals.is_none_or(|groups| groups[index].weight[0].0[i] > 0.0);
            for i in (0..LANES).filter(|&i| sampled[0].valid.0[i] > 0.0 && fits(i)) {
                let pixel = sampled[0].pixel.map(|x| x.0[i]);
                let at = |du: f32, dv: f32| texel_at(left, level, [pixel[0] + du, pixel[1] + dv]);
                let samples = [at(0.0, 0.0), at(step, 0.0), at(-step, 0.0), at(0.0, step), at(0.0, -step)];
                let [Some(centre), Some(right), Some(left), Some(down), Some(up)] = samples else { continue };
                if centre[3] + left[3] + right[3] + up[3] + down[3] > 0.3 {
                    continue;
                }
                view.valid.0[i] = 1.0;
                let warp = inverse_2x2(sampled[0].unwarp.map(|x| x.0[i]));
                for c in 0..view.value.len() {
                    view.value[c].0[i] = centre[c];
                    let by_u = (right[c] - left[c]) * (0.5 / step);
                    let by_v = (down[c] - up[c]) * (0.5 / step);
                    view.gradient[c][0].0[i] = by_u * warp[0] + by_v * warp[2];
                    view.gradient[c][1].0[i] = by_u * warp[1] + by_v * warp[3];
                }
            }
        }
    }
}

fn inverse_2x2([a, b, c, d]: [f32; 4]) -> [f32; 4] {
    let inverse = 1.0 / (a * d - b * c);
    [d * inverse, -b * inverse, -c * inverse, a * inverse]
}
