//! Sharpness difference between the two images.
//!
//! A Gaussian blur of variance `v` reduces the squared gradients `(dI/dx)^2` by `v |grad (dI/dx)|^2`, to first order in `v`. In
//! an isotropic texture `(d2I/dxdy)^2` is a third of `(d2I/dx2)^2`, so `v` is the difference of the squared gradients of both
//! images divided by `4/3` of the squared second derivatives. These are computed as products of both images, which noise does
//! not bias. Noise adds to the squared gradients of both images, equally if both are equally smoothed.

use super::kernel::SharpnessSums;

/// Ratio of second-order squared gradients in all directions to those along columns. In an isotropic texture the mean of cos^4
/// is 3/8 and that of cos^2 sin^2 is 1/8, and (3/8 + 1/8) / (3/8) = 4/3.
const ISOTROPY: f64 = 4.0 / 3.0;
/// Smallest significant sum of second derivatives, in standard deviations of its noise. Chosen by hand, not varied: noise
/// alone makes a difference of [`BELIEVED_PX2`] in 1.2 % of the cases at this limit (normal errors).
const SURE: f64 = 2.5;
/// Largest change accepted at once, squared pixels. Chosen by hand, not varied: a larger difference takes several passes;
/// the estimate is linear.
const CHANGE_MAX_PX2: f64 = 4.0;

/// Standard deviations of the smoothing of both images, pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sharpness {
    pub left_px: f64,
    pub right_px: f64,
}

impl Sharpness {
    /// Blur variance of the smoothed right image minus that of the smoothed left image, squared pixels; 0 if the texture does
    /// not determine it.
    pub fn difference_px2(&self, sums: &SharpnessSums) -> f64 {
        // Of white noise of variance 1 a Gaussian leaves the variance 1 / (4 pi s^2), and squared gradients 1 / (8 pi s^4).
        let value = |s: f64| 1.0 / (4.0 * std::f64::consts::PI * s * s);
        let slope = |s: f64| 1.0 / (8.0 * std::f64::consts::PI * s.powi(4));
        let noise = value(self.left_px) + value(self.right_px);
        let excess = sums.excess - sums.weight * (slope(self.right_px) - slope(self.left_px)) / noise;
        // The squared gradients of noise have a standard deviation equal to their mean; neighbours within the smoothing are
        // correlated.
        let per_point = (slope(self.left_px) + slope(self.right_px)) / noise;
        let shared = (4.0 * std::f64::consts::PI * self.left_px * self.right_px).max(1.0);
        let scatter = per_point * (2.0 * shared * sums.weight).sqrt();
        if sums.curvature * BELIEVED_PX2 < SURE * scatter || sums.weight <= 0.0 {
            return 0.0;
        }
        (-excess / (ISOTROPY * sums.curvature)).clamp(-CHANGE_MAX_PX2, CHANGE_MAX_PX2)
    }
}

/// The smallest difference that must exceed the noise, squared pixels. Chosen by hand, not varied: with more, weak textures
/// are evened by noise; with less, few regions are evened at all.
const BELIEVED_PX2: f64 = 0.5;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_blur_is_what_waves_lose() {
        // Waves of many directions, sharp in the left image and blurred with variance v in the right image.
        let (v, mut sums) = (0.2_f64, SharpnessSums { weight: 5000.0, ..SharpnessSums::default() });
        for i in 0..360 {
            let angle = f64::from(i).to_radians();
            let k2 = 0.25;
            let (kx2, kept) = (k2 * angle.cos().powi(2), (-0.5 * v * k2).exp());
            sums.excess += 1e4 * kx2 * (kept * kept - 1.0);
            sums.curvature += 1e4 * kx2 * kx2 * kept;
        }
        let equal = Sharpness { left_px: 0.5, right_px: 0.5 };
        assert!((equal.difference_px2(&sums) - v).abs() < 0.02 * v, "{}", equal.difference_px2(&sums));
        let blank = SharpnessSums { curvature: 10.0, ..sums };
        assert_eq!(equal.difference_px2(&blank), 0.0);
    }
}
