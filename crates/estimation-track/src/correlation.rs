//! Correlations between a stored view and an image.

use super::images::CHANNELS;
use super::lanes::Lanes;

/// Sums for a correlation between a view and an image.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Correlation {
    pub(super) count: f64,
    pub(super) sums: [MomentSums<f64>; CHANNELS],
}

/// Weighted sums of the values of a view and of an image.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MomentSums<T> {
    pub(super) view: T,
    pub(super) image: T,
    pub(super) view_squared: T,
    pub(super) image_squared: T,
    pub(super) product: T,
}

impl MomentSums<Lanes> {
    #[inline(always)]
    pub(super) fn folded(&self) -> MomentSums<f64> {
        let Self { view, image, view_squared, image_squared, product } = self;
        MomentSums {
            view: f64::from(view.sum()),
            image: f64::from(image.sum()),
            view_squared: f64::from(view_squared.sum()),
            image_squared: f64::from(image_squared.sum()),
            product: f64::from(product.sum()),
        }
    }
}

/// Variances of view and image and their covariance, summed over the channels, squared grey levels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    pub(super) view: f64,
    pub(super) image: f64,
    pub(super) covariance: f64,
}

impl Correlation {
    /// Adds a point with a weight.
    pub(super) fn add(&mut self, weight: f64, view: [f32; CHANNELS], image: [f32; CHANNELS]) {
        self.count += weight;
        for ((sums, a), b) in self.sums.iter_mut().zip(view).zip(image) {
            let (a, b) = (f64::from(a), f64::from(b));
            sums.view += weight * a;
            sums.image += weight * b;
            sums.view_squared += weight * (a * a);
            sums.image_squared += weight * (b * b);
            sums.product += weight * (a * b);
        }
    }

    /// The weighted number of points.
    pub(super) fn count(&self) -> f64 {
        self.count
    }

    pub(super) fn moments(&self) -> Moments {
        let n = self.count.max(1e-9);
        let mut moments = Moments::default();
        for MomentSums { view, image, view_squared, image_squared, product } in self.sums {
            moments.view += view_squared / n - view * view / (n * n);
            moments.image += image_squared / n - image * image / (n * n);
            moments.covariance += product / n - view * image / (n * n);
        }
        moments
    }

    /// Normalised cross-correlation over all channels, -1 to 1; 0 if there is no variation.
    pub(super) fn value(&self) -> f64 {
        let Moments { view, image, covariance } = self.moments();
        if view > 1e-9 && image > 1e-9 { (covariance / (view * image).sqrt()).clamp(-1.0, 1.0) } else { 0.0 }
    }

    /// Negative log likelihood of the image given the view, for unknown gain, offset and noise.
    pub(super) fn cost(&self) -> f64 {
        let value = self.value().max(0.0);
        0.5 * self.count * (1.0 - value * value + 0.01).ln()
    }
}
