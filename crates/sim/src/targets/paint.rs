//! Paints for targets of one shape, from all hues to no texture.

use super::texture::{Colour, Texture, colour_from_hsv, mix_colours};
use super::{card, crab};
use crate::noise::{ValueNoise, hash, smooth_step};

/// A texture of a target, by the information it offers an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Paint {
    /// Patches of every hue.
    Colourful,
    /// Mostly one hue (14 degrees +- 8), with dark spots.
    Crab,
    /// As the crab, with hue 0 +- 8 degrees, which wraps around.
    Red,
    /// Strong texture without hue: saturation 0.04.
    Grey,
    /// Luminance varies by 3 grey levels (standard deviation), on a dull brown.
    Faint,
    /// Soft squares that repeat every 6 mm.
    Repetitive,
    /// One colour.
    Uniform,
}

impl Paint {
    /// All paints.
    pub const ALL: [Self; 7] =
        [Self::Colourful, Self::Crab, Self::Red, Self::Grey, Self::Faint, Self::Repetitive, Self::Uniform];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Colourful => "colourful",
            Self::Crab => "crab",
            Self::Red => "red",
            Self::Grey => "grey",
            Self::Faint => "faint",
            Self::Repetitive => "repetitive",
            Self::Uniform => "uniform",
        }
    }

    /// The texture for the crab's shape; features have their size in millimetres.
    pub fn texture(self, seed: u32) -> Texture {
        let noise = |k: u32| ValueNoise::new(hash(&[seed, 0xFA17, k]));
        let (coarse, fine) = (noise(1), noise(2));
        match self {
            Self::Crab => crab::paint(seed, crab::HUE_DEG),
            Self::Red => crab::paint(seed, 0.0),
            Self::Colourful => {
                let colours = card::colours(seed);
                on_places(move |x, y| colours(0.5 + x / 120.0, 0.5 + y / 90.0).map(|channel| 0.85 * channel))
            }
            Self::Grey => on_places(move |x, y| {
                let value =
                    0.10 + 0.62 * coarse.fractal(x / 9.0, y / 9.0, 4) + 0.22 * (fine.at(x / 1.6, y / 1.6) - 0.5);
                colour_from_hsv(40.0, 0.04, value)
            }),
            Self::Faint => on_places(move |x, y| {
                let value = 0.45 + FAINT_CONTRAST * (coarse.fractal(x / 8.0, y / 8.0, 4) - 0.5);
                colour_from_hsv(30.0, 0.25, value)
            }),
            Self::Repetitive => on_places(squares),
            Self::Uniform => Texture::from_fn(4, 4, |_, _| colour_from_hsv(crab::HUE_DEG, 0.7, 0.6)),
        }
    }
}

/// Contrast of the faint paint relative to white: gives a standard deviation of the luminance of 3 grey levels.
const FAINT_CONTRAST: f64 = 0.103;

/// A texture from colours by position, millimetres.
fn on_places(colour: impl Fn(f64, f64) -> Colour) -> Texture {
    Texture::from_fn(9, 9, |u, v| {
        let place = crab::place_mm(u, v);
        colour(place.x, place.y)
    })
}

/// A board of dark and light squares with a period of 6 mm and soft edges.
fn squares(x_mm: f64, y_mm: f64) -> Colour {
    let wave = |place: f64| {
        let phase = place / 6.0 - (place / 6.0).floor();
        smooth_step(0.12, 0.38, phase) - smooth_step(0.62, 0.88, phase)
    };
    let (across, down) = (wave(x_mm), wave(y_mm));
    let light = across + down - 2.0 * across * down;
    mix_colours(&colour_from_hsv(18.0, 0.75, 0.35), &colour_from_hsv(40.0, 0.45, 0.80), light)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and standard deviation of the luminance, and mean saturation, at positions all over the crab.
    fn look(paint: Paint) -> (f64, f64, f64) {
        let texture = paint.texture(3);
        let level = &texture.levels()[0];
        let colours: Vec<[f64; 3]> =
            level.texels.iter().map(|texel| [0, 21, 42].map(|shift| ((texel >> shift) & 0x1f_ffff) as f64)).collect();
        let n = colours.len() as f64;
        let luminance = |c: &[f64; 3]| c.iter().sum::<f64>() / 3.0;
        let mean = colours.iter().map(luminance).sum::<f64>() / n;
        let variance = colours.iter().map(|c| (luminance(c) - mean).powi(2)).sum::<f64>() / n;
        let saturation = |c: &[f64; 3]| {
            let (low, high) = c.iter().fold((f64::MAX, 1.0f64), |(low, high), &x| (low.min(x), high.max(x)));
            1.0 - low / high
        };
        (mean, variance.sqrt(), colours.iter().map(saturation).sum::<f64>() / n)
    }

    #[test]
    fn paints_have_the_contrast_and_colour_of_their_names() {
        for paint in Paint::ALL {
            let (mean, deviation, saturation) = look(paint);
            assert!((50.0..200.0).contains(&mean), "{paint:?}: {mean}");
            let (contrast, colour) = match paint {
                Paint::Colourful => (15.0..80.0, 0.4..0.9),
                Paint::Crab | Paint::Red => (15.0..80.0, 0.5..0.95),
                Paint::Grey => (15.0..50.0, 0.01..0.08),
                Paint::Faint => (2.7..3.3, 0.2..0.3),
                Paint::Repetitive => (20.0..60.0, 0.4..0.8),
                Paint::Uniform => (0.0..0.01, 0.6..0.8),
            };
            assert!(contrast.contains(&deviation), "{paint:?}: luminance varies by {deviation}");
            assert!(colour.contains(&saturation), "{paint:?}: saturation {saturation}");
        }
    }

    #[test]
    fn squares_repeat_and_alternate() {
        let check = |x: f64, y: f64, expected: f64| {
            let [red, ..] = squares(x, y);
            assert!((red - 255.0 * expected).abs() < 1e-9, "{x} {y}: {red}");
        };
        check(3.0, 3.0, 0.35);
        check(3.0, 6.0, 0.80);
        check(-9.0, 0.0, 0.80);
        check(12.0, -6.0, 0.35);
    }
}
