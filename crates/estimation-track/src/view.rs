//! Stored views: appearance of the surface from one pose.

use pb3dp_estimation_core::wide::LANES;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::images::{CameraImages, LEVELS, texel_at};
use super::kernels::{CHANNELS, ResidualGroup, SampledGroup, ViewGroup};

/// The surface's channels in the left image of one frame.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub(super) cam_left_from_model: Pose<CamLeft, Model>,
    pub(super) levels: [Vec<ViewGroup>; LEVELS],
    /// Variance of a value by noise, squared grey levels: what the smoothest quarter of the points shows.
    pub(super) noise_variance: [f32; CHANNELS],
    /// Last frame in which the view was used.
    pub(super) last_used: u64,
}

/// Number and width of the classes of differences from the mean of the four neighbours, grey levels. Chosen by hand, not varied: finer than
/// the steps of the sensor.
const BEND_BINS: usize = 512;
const BEND_STEP: f32 = 0.02;
/// Lower quartile of the absolute value of a normal variable, standard deviations.
const QUARTILE: f32 = 0.3186;
/// Variance of such a difference by noise, relative to that of a value. Derived: cubic B-splines with the weights 1/6, 4/6 and 1/6 make the
/// products of values i columns and j rows apart r(i) r(j) with r = 1/2, 2/9, 1/36; the difference has
/// r00 - 2 r10 + (4 r00 + 4 r20 + 8 r11) / 16.
const BEND_VARIANCE: f32 = 0.474;

impl View {
    /// Allocates a view for a surface with these numbers of groups per level.
    pub(super) fn empty(groups: [usize; LEVELS]) -> Self {
        Self {
            cam_left_from_model: Pose::coincident(),
            levels: groups.map(|count| vec![ViewGroup::default(); count]),
            noise_variance: [0.0; CHANNELS],
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
        let mut bends = [[0_u32; BEND_BINS]; CHANNELS];
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
                for (c, bends) in bends.iter_mut().enumerate() {
                    let bend = centre[c] - 0.25 * (left[c] + right[c] + up[c] + down[c]);
                    bends[((bend.abs() / BEND_STEP) as usize).min(BEND_BINS - 1)] += 1;
                    view.value[c].0[i] = centre[c];
                    let by_u = (right[c] - left[c]) * (0.5 / step);
                    let by_v = (down[c] - up[c]) * (0.5 / step);
                    view.gradient[c][0].0[i] = by_u * warp[0] + by_v * warp[2];
                    view.gradient[c][1].0[i] = by_u * warp[1] + by_v * warp[3];
                }
            }
        }
        if level == 0 {
            self.noise_variance = bends.map(|bends| noise_variance(&bends));
        }
    }
}

/// Variance of a value, given how often which differences from the mean of the four neighbours occur.
fn noise_variance(bends: &[u32; BEND_BINS]) -> f32 {
    let count = bends.iter().sum::<u32>();
    if bends[0] == count {
        // A channel that a grey camera does not have.
        return 0.0;
    }
    let quarter = count / 4;
    let mut below = 0;
    let bin = bends.iter().position(|count| {
        below += count;
        below > quarter
    });
    let sigma = (bin.unwrap_or(0) as f32 + 0.5) * BEND_STEP / QUARTILE;
    sigma * sigma / BEND_VARIANCE
}

fn inverse_2x2([a, b, c, d]: [f32; 4]) -> [f32; 4] {
    let inverse = 1.0 / (a * d - b * c);
    [d * inverse, -b * inverse, -c * inverse, a * inverse]
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_core::rng::SplitMix64;

    use super::*;

    /// Differences from the mean of four neighbours that noise of this variance and edges make.
    fn bends(variance: f64, edges: usize) -> [u32; BEND_BINS] {
        let mut random = SplitMix64::new(5);
        let mut bends = [0; BEND_BINS];
        for i in 0..9000 {
            let edge = if i < edges { 60.0 * random.unit() - 30.0 } else { 0.0 };
            // By twelve uniform numbers: a normal one.
            let normal = (0..12).map(|_| random.unit()).sum::<f64>() - 6.0;
            let bend = edge + normal * (variance * f64::from(BEND_VARIANCE)).sqrt();
            bends[((bend.abs() / f64::from(BEND_STEP)) as usize).min(BEND_BINS - 1)] += 1;
        }
        bends
    }

    #[test]
    fn the_noise_of_a_view_is_that_of_its_smooth_part() {
        for variance in [1.0, 4.0, 25.0] {
            let share = |edges| f64::from(noise_variance(&bends(variance, edges))) / variance;
            assert!((share(0) - 1.0).abs() < 0.15, "{variance}: {}", share(0));
            // A third of the points is on sharp edges: the quarter is then three eighths of the others.
            assert!((0.8..2.5).contains(&share(3000)), "{variance}: {}", share(3000));
        }
    }

    #[test]
    fn a_channel_that_a_camera_does_not_have_has_no_noise() {
        assert!(noise_variance(&bends(0.0, 0)) == 0.0 && noise_variance(&[0; BEND_BINS]) == 0.0);
    }
}
