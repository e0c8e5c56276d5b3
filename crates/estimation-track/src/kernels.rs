//! The inner loops: projection of points into both images, residuals, weights, normal equations.

use pb3dp_estimation_core::wide::{LANES, wide};

use super::clipped::{any_clipped, leave_out, leave_out_of_values, one_colour, unclipped};
pub(super) use super::correlation::{Correlation, MomentSums, Moments};
pub(super) use super::images::CHANNELS;
use super::images::CameraImages;
use super::lanes::{Lanes, each_lane, repeated};

/// Unknowns without the gains: the motion `[rho; phi]` of the model in its own frame (metres, radians), the row offset of the
/// right image (pixels), the change of the inverse-depth plane of the surface (1/m).
pub(super) const UNKNOWNS: usize = 10;
/// Writes an expression once per unknown, see [`repeated`].
macro_rules! each_unknown {
    ($i:ident => $body:expr) => {
        repeated!($i in [0, 1, 2, 3, 4, 5, 6, 7, 8, 9] => $body)
    };
}
const _: () = assert!(UNKNOWNS == 10, "each_unknown names them all");

/// Index of the row offset.
pub(super) const ROW: usize = 6;
/// Index of the first of the three unknowns of the surface's plane.
pub(super) const SHAPE: usize = 7;
/// Number of entries of the upper triangle.
pub(super) const TRIANGLE: usize = UNKNOWNS * (UNKNOWNS + 1) / 2;
/// Residuals per point and channel: stored view against left, stored view against right, left against right.
pub(super) const TERMS: usize = 3;
/// Gain and offset of the left and the right image: indices in a group of four.
const GAIN: usize = 0;
const OFFSET: usize = 1;
const LEFT: usize = 0;
const RIGHT: usize = 2;
/// Products of a patch's offset: with every unknown, with gain and offset of both images, with itself, and with the residual.
pub(super) const PATCH: usize = UNKNOWNS + 6;
/// Index of the first of the four products with gains and offsets, of the product with itself, and of that with the residual.
pub(super) const PATCH_GAINS: usize = UNKNOWNS;
pub(super) const PATCH_OWN: usize = UNKNOWNS + 4;
pub(super) const PATCH_RESIDUAL: usize = UNKNOWNS + 5;

/// A group of surface points, in `model`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SurfaceGroup {
    /// Position, metres.
    pub(super) point: [Lanes; 3],
    /// Derivative of the position with respect to the raw left pixel (u, v) of the first view, metres per pixel: x, y, z by u,
    /// then by v.
    pub(super) base: [Lanes; 6],
    /// Derivative of the position with respect to the inverse depth in the first view.
    pub(super) slide: [Lanes; 3],
    /// Ray (x, y) in the first view; its third component is 1.
    pub(super) ray: [Lanes; 2],
    /// 1 for a point, 0 for an empty lane.
    pub(super) mask: Lanes,
}

/// A lens, linearised at the expected position of each point: normalised (x, y), its pixel (u, v), and the derivative of the
/// pixel (u by x, u by y, v by x, v by y).
pub(super) type LensGroup = [Lanes; 8];

/// A group of points in a stored view.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ViewGroup {
    /// The channels.
    pub(super) value: [Lanes; CHANNELS],
    /// Their derivatives with respect to the raw left pixel of the first view, along the surface.
    pub(super) gradient: [[Lanes; 2]; CHANNELS],
    /// 1 if the point is visible in the view.
    pub(super) valid: Lanes,
}

/// A group of points in one image of the current pair.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SampledGroup {
    /// Raw pixel.
    pub(super) pixel: [Lanes; 2],
    /// Derivative of the pixel (u, then v) with respect to the position in `model`.
    pub(super) by_point: [Lanes; 6],
    /// Derivative of the first view's pixel with respect to this pixel: inverse of the local warp, row-major.
    pub(super) unwarp: [Lanes; 4],
    /// The channels at the pixel.
    pub(super) value: [Lanes; CHANNELS],
    /// 1 if the point is visible in the image.
    pub(super) valid: Lanes,
    /// The saturated colour of a visible point (`images::CLIPPED`), or 0.
    pub(super) clipped: Lanes,
}

/// Residuals and weights of a group.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ResidualGroup {
    /// Left and right image minus the stored view.
    pub(super) residual: [[Lanes; CHANNELS]; 2],
    /// Robust weight of each term, 0 to 1.
    pub(super) weight: [Lanes; TERMS],
}

/// Gains, offsets and variances for the weighting of residuals.
#[derive(Clone, Copy, Debug)]
pub(super) struct Photometry {
    /// Gain and offset by camera and channel.
    pub(super) gain: [[f32; CHANNELS]; 2],
    pub(super) offset: [[f32; CHANNELS]; 2],
    /// Variance of each term and channel, squared grey levels.
    pub(super) variance: [[f32; CHANNELS]; TERMS],
}

/// Sums of the residuals.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ResidualSums {
    /// Weighted squares by term and channel.
    pub(super) squares: [[f32; CHANNELS]; TERMS],
    /// Weights by term.
    pub(super) weights: [f32; TERMS],
    /// Number of visible points by term.
    pub(super) points: [f32; TERMS],
}

/// A camera: rotation (row-major) and translation of `cam_from_model`.
pub(super) type CameraRows = [f32; 12];

wide! {
    /// Projects groups into one image.
    pub(super) fn project(surface: &[SurfaceGroup], lens: &[LensGroup], camera: &CameraRows, row_offset: f32, sampled: &mut [[SampledGroup; 2]], side: usize) = project_kernel;
}

wide! {
    /// Samples the channels at the projected points.
    pub(super) fn sample(images: &CameraImages, level: usize, sampled: &mut [[SampledGroup; 2]], side: usize) = sample_kernel;
}

wide! {
    /// Computes residuals relative to a stored view, and their robust weights.
    pub(super) fn weigh(sampled: &[[SampledGroup; 2]], view: &[ViewGroup], photometry: &Photometry, out: &mut [ResidualGroup]) -> ResidualSums = weigh_kernel;
}

wide! {
    /// Adds the normal equations of groups to `sums`; the terms of each group's own offset are written to `patches`.
    pub(super) fn accumulate(surface: &[SurfaceGroup], sampled: &[[SampledGroup; 2]], view: &[ViewGroup], residuals: &[ResidualGroup], weights: &PairWeights, sums: &mut NormalSums, patches: &mut [[f32; PATCH]]) = accumulate_kernel;
}

wide! {
    /// Sums for the correlation of a view with both images: over all visible points, or weighted.
    pub(super) fn correlate(sampled: &[[SampledGroup; 2]], view: &[ViewGroup], residuals: Option<&[ResidualGroup]>) -> [Correlation; 2] = correlate_kernel;
}

wide! {
    /// The right-hand side of each group, and its second derivatives with respect to its inverse depth.
    pub(super) fn score(surface: &[SurfaceGroup], sampled: &[[SampledGroup; 2]], view: &[ViewGroup], residuals: &[ResidualGroup], weights: &PairWeights, scores: &mut [GroupScore]) = score_kernel;
}

/// The right-hand side of a group.
#[derive(Clone, Copy, Debug)]
pub(super) struct GroupScore {
    /// Derivative times residual.
    pub(super) slope: [f32; UNKNOWNS],
    /// By channel: product of the residual with (gain left, offset left, gain right, offset right).
    pub(super) gain_slope: [[f32; 4]; CHANNELS],
    /// Second derivatives with respect to the inverse depth of the group and each unknown; the last one is with respect to the
    /// inverse depth twice.
    pub(super) by_depth: [f32; UNKNOWNS],
    /// By channel: second derivatives with respect to the inverse depth and each gain and offset, with the opposite sign.
    pub(super) gain_by_depth: [[f32; 4]; CHANNELS],
}

impl Default for GroupScore {
    fn default() -> Self {
        let gains = [[0.0; 4]; CHANNELS];
        Self { slope: [0.0; UNKNOWNS], gain_slope: gains, by_depth: [0.0; UNKNOWNS], gain_by_depth: gains }
    }
}

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "cameras and channels index several arrays")]
fn correlate_kernel(
    sampled: &[[SampledGroup; 2]],
    view: &[ViewGroup],
    residuals: Option<&[ResidualGroup]>,
) -> [Correlation; 2] {
    let mut sums = [[MomentSums::<Lanes>::default(); CHANNELS]; 2];
    let mut counts = [Lanes::ZERO; 2];
    for (index, (sampled, view)) in sampled.iter().zip(view).enumerate() {
        for side in 0..2 {
            let weight = match residuals {
                Some(residuals) => residuals[index].weight[side],
                None => sampled[side].valid * view.valid,
            };
            counts[side] += weight;
            let (mut of_view, mut of_image) = (view.value, sampled[side].value);
            if any_clipped(clipped(sampled)) {
                leave_out_of_values(&sampled[side].clipped, &mut of_view, &mut of_image);
            }
            for c in 0..CHANNELS {
                let (a, b) = (of_view[c], of_image[c]);
                let (wa, wb) = (weight * a, weight * b);
                let sums = &mut sums[side][c];
                sums.view += wa;
                sums.image += wb;
                sums.view_squared = sums.view_squared.plus(wa, a);
                sums.image_squared = sums.image_squared.plus(wb, b);
                sums.product = sums.product.plus(wa, b);
            }
        }
    }
    std::array::from_fn(|side| Correlation {
        count: f64::from(counts[side].sum()),
        sums: sums[side].map(|sums| sums.folded()),
    })
}

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "channels index several arrays")]
fn score_kernel(
    surface: &[SurfaceGroup],
    sampled: &[[SampledGroup; 2]],
    view: &[ViewGroup],
    residuals: &[ResidualGroup],
    weights: &PairWeights,
    scores: &mut [GroupScore],
) {
    let groups = surface.iter().zip(sampled).zip(view).zip(residuals).zip(scores);
    for ((((surface, sampled), view), residual), score) in groups {
        let mut slope = [Lanes::ZERO; UNKNOWNS];
        let mut by_depth = [Lanes::ZERO; UNKNOWNS];
        let gradient = unclipped(clipped(sampled), &view.gradient);
        for c in 0..CHANNELS {
            let [left, right, pair] = pair_weights(residual, weights, c);
            let in_left = derivatives(surface, &sampled[0], &gradient[c], 0);
            let in_right = derivatives(surface, &sampled[1], &gradient[c], 1);
            let (r_left, r_right) = (residual.residual[0][c], residual.residual[1][c]);
            let to_left = (left + pair) * r_left - pair * r_right;
            let to_right = (right + pair) * r_right - pair * r_left;
            let (a, b) = (in_left[UNKNOWNS - 1], in_right[UNKNOWNS - 1]);
            let depth = [(left + pair) * a - pair * b, (right + pair) * b - pair * a];
            each_unknown!(i => {
                slope[i] = slope[i].plus(in_left[i], to_left).plus(in_right[i], to_right);
                by_depth[i] = by_depth[i].plus(in_left[i], depth[0]).plus(in_right[i], depth[1]);
            });
            score.gain_slope[c] =
                [(to_left * view.value[c]).sum(), to_left.sum(), (to_right * view.value[c]).sum(), to_right.sum()];
            let value = view.value[c];
            score.gain_by_depth[c] =
                [(depth[0] * value).sum(), depth[0].sum(), (depth[1] * value).sum(), depth[1].sum()];
        }
        each_unknown!(i => (score.slope[i], score.by_depth[i]) = (slope[i].sum(), by_depth[i].sum()));
    }
}

#[inline(always)]
fn project_kernel(
    surface: &[SurfaceGroup],
    lens: &[LensGroup],
    camera: &CameraRows,
    row_offset: f32,
    sampled: &mut [[SampledGroup; 2]],
    side: usize,
) {
    let row =
        |i: usize| [Lanes::splat(camera[4 * i]), Lanes::splat(camera[4 * i + 1]), Lanes::splat(camera[4 * i + 2])];
    let (r0, r1, r2) = (row(0), row(1), row(2));
    for ((group, lens), sampled) in surface.iter().zip(lens).zip(sampled) {
        let z = Lanes::splat(camera[11]) + dot(&r2, &group.point);
        let inverse_z = z.max(1e-3).reciprocal();
        let x = (Lanes::splat(camera[3]) + dot(&r0, &group.point)) * inverse_z;
        let y = (Lanes::splat(camera[7]) + dot(&r1, &group.point)) * inverse_z;
        let [x0, y0, u, v, u_by_x, u_by_y, v_by_x, v_by_y] = *lens;
        let (dx, dy) = (x - x0, y - y0);
        let out = &mut sampled[side];
        out.pixel =
            [u.plus(u_by_x, dx).plus(u_by_y, dy), (v + Lanes::splat(row_offset)).plus(v_by_x, dx).plus(v_by_y, dy)];
        repeated!(i in [0, 1, 2] => {
            let (by_x, by_y) = ((r0[i] - x * r2[i]) * inverse_z, (r1[i] - y * r2[i]) * inverse_z);
            out.by_point[i] = u_by_x * by_x + u_by_y * by_y;
            out.by_point[3 + i] = v_by_x * by_x + v_by_y * by_y;
        });
        let [u0, u1, u2, v0, v1, v2] = out.by_point;
        let [x0, x1, x2, y0, y1, y2] = group.base;
        let (by_u, by_v, along_x, along_y) = ([u0, u1, u2], [v0, v1, v2], [x0, x1, x2], [y0, y1, y2]);
        let (a, b) = (dot(&by_u, &along_x), dot(&by_u, &along_y));
        let (c, d) = (dot(&by_v, &along_x), dot(&by_v, &along_y));
        let determinant = a * d - b * c;
        let inverse = determinant.max(EDGE_ON).reciprocal();
        out.unwarp = [d * inverse, -b * inverse, -c * inverse, a * inverse];
        out.valid = each_lane!(i => if z.0[i] > 2e-3 && determinant.0[i] > EDGE_ON { group.mask.0[i] } else { 0.0 });
    }
}

/// The saturated colours of both images.
#[inline(always)]
fn clipped(sampled: &[SampledGroup; 2]) -> [&Lanes; 2] {
    [&sampled[0].clipped, &sampled[1].clipped]
}

#[inline(always)]
fn dot(a: &[Lanes; 3], b: &[Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Smallest ratio of a surface patch's area to its area in the first view; patches seen more edge-on are not used. Chosen
/// by hand, not varied: for a patch that faced the camera, 85 degrees.
const EDGE_ON: f32 = 0.08;
/// Largest share of saturated pixels in a sample of three colours. Chosen by hand, not varied: with more, clipped values count.
const SATURATED_MAX: f32 = 0.15;

#[inline(always)]
fn sample_kernel(images: &CameraImages, level: usize, sampled: &mut [[SampledGroup; 2]], side: usize) {
    let origin_px = images.origin_px();
    let factor = 1.0 / (1_u32 << level) as f32;
    for sampled in sampled {
        let sampled = &mut sampled[side];
        sampled.clipped = Lanes::ZERO;
        for i in 0..LANES {
            if sampled.valid.0[i] == 0.0 {
                continue;
            }
            let x = (sampled.pixel[0].0[i] - origin_px[0] + 0.5) * factor - 0.5;
            let y = (sampled.pixel[1].0[i] - origin_px[1] + 0.5) * factor - 0.5;
            match images.sample(level, x, y) {
                Some(texel) => {
                    (0..CHANNELS).for_each(|c| sampled.value[c].0[i] = texel[c]);
                    let is_clipped = texel[3] >= SATURATED_MAX;
                    match one_colour(texel, level) {
                        Some(colour) if is_clipped => sampled.clipped.0[i] = f32::from(colour),
                        None if is_clipped => sampled.valid.0[i] = 0.0,
                        _ => {}
                    }
                }
                None => sampled.valid.0[i] = 0.0,
            }
        }
    }
}

/// Residual limit in standard deviations (root mean square over the channels); larger residuals have no weight. Chosen by
/// hand, not varied: 6 of a million normal residuals are larger (chi-squared of three above 27).
const TUKEY: f32 = 3.0;

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "cameras and channels index several arrays")]
fn weigh_kernel(
    sampled: &[[SampledGroup; 2]],
    view: &[ViewGroup],
    photometry: &Photometry,
    out: &mut [ResidualGroup],
) -> ResidualSums {
    let inverse: [[f32; CHANNELS]; TERMS] =
        photometry.variance.map(|term| term.map(|v| 1.0 / (v * (CHANNELS as f32) * TUKEY * TUKEY)));
    let mut squares = [[Lanes::ZERO; CHANNELS]; TERMS];
    let mut weights = [Lanes::ZERO; TERMS];
    let mut points = [Lanes::ZERO; TERMS];
    for ((sampled, view), out) in sampled.iter().zip(view).zip(out) {
        for side in 0..2 {
            for c in 0..CHANNELS {
                let (gain, offset) = (photometry.gain[side][c], photometry.offset[side][c]);
                out.residual[side][c] = sampled[side].value[c] - view.value[c].scale(gain) - Lanes::splat(offset);
            }
        }
        let valid = [sampled[0].valid * view.valid, sampled[1].valid * view.valid];
        let valid = [valid[0], valid[1], valid[0] * valid[1]];
        let clipped = clipped(sampled);
        let scale = if any_clipped(clipped) { leave_out(clipped, &mut out.residual) } else { Lanes::splat(1.0) };
        for term in 0..TERMS {
            let mut square = [Lanes::ZERO; CHANNELS];
            let mut distance = Lanes::ZERO;
            for c in 0..CHANNELS {
                let r = match term {
                    0 | 1 => out.residual[term][c],
                    _ => out.residual[1][c] - out.residual[0][c],
                };
                square[c] = r * r * scale;
                distance += square[c].scale(inverse[term][c]);
            }
            let near = (Lanes::splat(1.0) - distance).max(0.0);
            let weight = near * near * valid[term];
            out.weight[term] = weight;
            weights[term] += weight;
            points[term] += valid[term];
            for c in 0..CHANNELS {
                squares[term][c] = squares[term][c].plus(weight, square[c]);
            }
        }
    }
    ResidualSums {
        squares: squares.map(|term| term.map(|lanes| lanes.sum())),
        weights: weights.map(|lanes| lanes.sum()),
        points: points.map(|lanes| lanes.sum()),
    }
}

/// Inverse variances of the three terms by channel, for residuals that share the noise of the stored view.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PairWeights {
    pub(super) by_term: [[f32; CHANNELS]; TERMS],
}

/// Sums of the normal equations, lane by lane.
#[derive(Clone, Debug)]
pub(super) struct NormalSums {
    /// Upper triangle over the unknowns, row by row.
    pub(super) hessian: [Lanes; TRIANGLE],
    /// Derivative times residual.
    pub(super) slope: [Lanes; UNKNOWNS],
    /// By channel: product of each unknown with (gain left, offset left, gain right, offset right).
    pub(super) cross: [[[Lanes; 4]; UNKNOWNS]; CHANNELS],
    /// By channel: for left-left, left-right, right-right.
    pub(super) gains: [[GainSums; 3]; CHANNELS],
    /// By channel: product of the residual with (gain left, offset left, gain right, offset right).
    pub(super) gain_slope: [[Lanes; 4]; CHANNELS],
}

/// Weighted sums over the stored view's values: products of gains and offsets with each other.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GainSums {
    pub(super) value_squared: Lanes,
    pub(super) value: Lanes,
    pub(super) one: Lanes,
}

impl Default for NormalSums {
    fn default() -> Self {
        Self {
            hessian: [Lanes::ZERO; TRIANGLE],
            slope: [Lanes::ZERO; UNKNOWNS],
            cross: [[[Lanes::ZERO; 4]; UNKNOWNS]; CHANNELS],
            gains: Default::default(),
            gain_slope: [[Lanes::ZERO; 4]; CHANNELS],
        }
    }
}

/// Weights of the three differences of a channel.
#[inline(always)]
fn pair_weights(residual: &ResidualGroup, weights: &PairWeights, channel: usize) -> [Lanes; TERMS] {
    let ([left, right, pair], by_term) = (&residual.weight, &weights.by_term);
    [left.scale(by_term[0][channel]), right.scale(by_term[1][channel]), pair.scale(by_term[2][channel])]
}

/// Derivatives of a channel of one image with respect to the unknowns.
#[inline(always)]
pub(super) fn derivatives(
    surface: &SurfaceGroup,
    sampled: &SampledGroup,
    gradient: &[Lanes; 2],
    side: usize,
) -> [Lanes; UNKNOWNS] {
    let by_u = gradient[0] * sampled.unwarp[0] + gradient[1] * sampled.unwarp[2];
    let by_v = gradient[0] * sampled.unwarp[1] + gradient[1] * sampled.unwarp[3];
    let by = &sampled.by_point;
    let m = [by_u * by[0] + by_v * by[3], by_u * by[1] + by_v * by[4], by_u * by[2] + by_v * by[5]];
    let p = &surface.point;
    let slide = m[0] * surface.slide[0] + m[1] * surface.slide[1] + m[2] * surface.slide[2];
    [
        m[0],
        m[1],
        m[2],
        p[1] * m[2] - p[2] * m[1],
        p[2] * m[0] - p[0] * m[2],
        p[0] * m[1] - p[1] * m[0],
        if side == 1 { by_v } else { Lanes::ZERO },
        slide * surface.ray[0],
        slide * surface.ray[1],
        slide,
    ]
}

#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "channels index several arrays")]
fn accumulate_kernel(
    surface: &[SurfaceGroup],
    sampled: &[[SampledGroup; 2]],
    view: &[ViewGroup],
    residuals: &[ResidualGroup],
    weights: &PairWeights,
    sums: &mut NormalSums,
    patches: &mut [[f32; PATCH]],
) {
    let groups = surface.iter().zip(sampled).zip(view).zip(residuals).zip(patches);
    for ((((surface, sampled), view), residual), patch) in groups {
        let gradient = unclipped(clipped(sampled), &view.gradient);
        for c in 0..CHANNELS {
            let [left, right, pair] = pair_weights(residual, weights, c);
            let (ll, rr) = (left + pair, right + pair);
            let in_left = derivatives(surface, &sampled[0], &gradient[c], 0);
            let in_right = derivatives(surface, &sampled[1], &gradient[c], 1);
            let (r_left, r_right) = (residual.residual[0][c], residual.residual[1][c]);
            let value = view.value[c];
            let weighted = [ll * r_left - pair * r_right, rr * r_right - pair * r_left];
            let mut common = [Lanes::ZERO; UNKNOWNS];
            let mut entry = 0;
            for i in 0..UNKNOWNS {
                let by_left = ll * in_left[i] - pair * in_right[i];
                let by_right = rr * in_right[i] - pair * in_left[i];
                for j in i..UNKNOWNS {
                    sums.hessian[entry] = sums.hessian[entry].plus(by_left, in_left[j]).plus(by_right, in_right[j]);
                    entry += 1;
                }
                sums.slope[i] = sums.slope[i].plus(by_left, r_left).plus(by_right, r_right);
                let cross = &mut sums.cross[c][i];
                cross[LEFT + GAIN] = cross[LEFT + GAIN].plus(by_left, value);
                cross[LEFT + OFFSET] += by_left;
                cross[RIGHT + GAIN] = cross[RIGHT + GAIN].plus(by_right, value);
                cross[RIGHT + OFFSET] += by_right;
                common[i] = by_left + by_right;
            }
            for (pair_sums, weight) in sums.gains[c].iter_mut().zip([ll, -pair, rr]) {
                let by_value = weight * value;
                pair_sums.value_squared = pair_sums.value_squared.plus(by_value, value);
                pair_sums.value += by_value;
                pair_sums.one += weight;
            }
            for (side, weighted) in [LEFT, RIGHT].into_iter().zip(weighted) {
                let slope = &mut sums.gain_slope[c];
                slope[side + GAIN] = slope[side + GAIN].plus(weighted, value);
                slope[side + OFFSET] += weighted;
            }
            if c == 0 {
                for i in 0..UNKNOWNS {
                    patch[i] = common[i].sum();
                }
                patch[PATCH_GAINS + LEFT + GAIN] = (left * value).sum();
                patch[PATCH_GAINS + LEFT + OFFSET] = left.sum();
                patch[PATCH_GAINS + RIGHT + GAIN] = (right * value).sum();
                patch[PATCH_GAINS + RIGHT + OFFSET] = right.sum();
                patch[PATCH_OWN] = (left + right).sum();
                patch[PATCH_RESIDUAL] = (left * r_left + right * r_right).sum();
            }
        }
    }
}

#[cfg(test)]
#[path = "kernels_tests.rs"]
mod tests;
