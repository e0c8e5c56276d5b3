//! Textures with mip-maps, generated from a function.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Colour of a texel or a pixel: red, green, blue in grey levels, 0 to 255.
pub type Colour = [f64; 3];

/// A texture: repeats in both directions, sides are powers of two, with a chain of successively coarser levels.
///
/// Texel `i` covers `i` to `i + 1` in texel coordinates, so its centre is at `i + 0.5`. Every coarser level averages 2 x 2
/// texels, which preserves positions exactly.
#[derive(Clone, Debug)]
pub struct Texture {
    levels: Vec<Level>,
}

/// Width of a colour channel in a packed texel: leaves room for weights of up to 13 bits.
pub(crate) const LANE_BITS: u32 = 21;

/// Key of a texture: the name of its paint, and its seed and sizes as bits.
pub(crate) type PaintKey = (&'static str, [u64; 4]);

/// Number of cached textures; one takes 0.7 to 6 MB.
const KEPT: usize = 24;

/// The most recent textures of this process, newest first.
static NEWEST: Mutex<VecDeque<(PaintKey, Arc<Texture>)>> = Mutex::new(VecDeque::new());

/// The texture of a key, painted unless it is cached in the process.
///
/// A scene's textures take a third of a second to paint, and tests and benches build the same scene many times.
pub(crate) fn painted_once(key: PaintKey, paint: impl FnOnce() -> Texture) -> Arc<Texture> {
    let kept = || NEWEST.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, texture)) = kept().iter().find(|(other, _)| *other == key) {
        return Arc::clone(texture);
    }
    let texture = Arc::new(paint());
    let mut newest = kept();
    newest.push_front((key, Arc::clone(&texture)));
    newest.truncate(KEPT);
    texture
}

/// One mip-map level of a texture.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    pub(crate) width_log2: u32,
    pub(crate) height_log2: u32,
    /// Red, green, blue in 21-bit lanes, 0 to 255 each, lowest lane first; `2^(width_log2 + height_log2)` of them.
    pub(crate) texels: Vec<u64>,
}

impl Texture {
    /// A texture of `2^width_log2` x `2^height_log2` texels (exponents are limited to 12).
    ///
    /// `colour` gets texture coordinates of texel centres, 0 to 1.
    pub fn from_fn(width_log2: u32, height_log2: u32, mut colour: impl FnMut(f64, f64) -> Colour) -> Self {
        let (width_log2, height_log2) = (width_log2.min(12), height_log2.min(12));
        let (width, height) = (1usize << width_log2, 1usize << height_log2);
        let mut fine = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                fine.push(colour((column as f64 + 0.5) / width as f64, (row as f64 + 0.5) / height as f64));
            }
        }
        let mut levels = vec![Level::new(width_log2, height_log2, &fine)];
        let (mut w, mut h) = (width_log2, height_log2);
        while w > 0 && h > 0 {
            fine = halve(&fine, 1 << w);
            (w, h) = (w - 1, h - 1);
            levels.push(Level::new(w, h, &fine));
        }
        Self { levels }
    }

    /// Width of the finest level in texels.
    pub fn width(&self) -> u32 {
        1 << self.levels[0].width_log2
    }

    /// Height of the finest level in texels.
    pub fn height(&self) -> u32 {
        1 << self.levels[0].height_log2
    }

    /// The levels, finest first; at least one.
    pub(crate) fn levels(&self) -> &[Level] {
        &self.levels
    }
}

impl Level {
    fn new(width_log2: u32, height_log2: u32, colours: &[Colour]) -> Self {
        let lane = |value: f64| value.round().clamp(0.0, 255.0) as u64;
        let texels =
            colours.iter().map(|c| lane(c[0]) | lane(c[1]) << LANE_BITS | lane(c[2]) << (2 * LANE_BITS)).collect();
        Self { width_log2, height_log2, texels }
    }
}

fn halve(fine: &[Colour], width: usize) -> Vec<Colour> {
    fine.chunks_exact(2 * width)
        .flat_map(|rows| {
            let (upper, lower) = rows.split_at(width);
            upper.chunks_exact(2).zip(lower.chunks_exact(2)).map(|(u, l)| {
                let mean = |channel: usize| (u[0][channel] + u[1][channel] + l[0][channel] + l[1][channel]) / 4.0;
                [mean(0), mean(1), mean(2)]
            })
        })
        .collect()
}

/// Colour of a hue (degrees, any turn), saturation and value (0 to 1): the HSV hexagon.
pub fn colour_from_hsv(hue_deg: f64, saturation: f64, value: f64) -> Colour {
    let sextant = hue_deg / 60.0;
    let channel = |phase: f64| {
        let k = phase + sextant;
        let k = k - 6.0 * (k / 6.0).floor();
        255.0 * value.clamp(0.0, 1.0) * (1.0 - saturation.clamp(0.0, 1.0) * k.min(4.0 - k).clamp(0.0, 1.0))
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// Mixture of two colours: `a` at 0, `b` at 1.
pub fn mix_colours(a: &Colour, b: &Colour, share_of_b: f64) -> Colour {
    std::array::from_fn(|channel| a[channel] + (b[channel] - a[channel]) * share_of_b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarser_copies_keep_the_mean() {
        let texture = Texture::from_fn(4, 3, |u, v| [255.0 * u, 255.0 * v, 40.0]);
        assert_eq!((texture.width(), texture.height(), texture.levels().len()), (16, 8, 4));
        let last = &texture.levels()[3];
        assert_eq!((last.width_log2, last.height_log2), (1, 0));
        let red: u64 = last.texels.iter().map(|t| t & 0x1f_ffff).sum();
        assert_eq!(red, 64 + 191);
        assert_eq!(last.texels[0] >> 42, 40);
    }

    #[test]
    fn one_key_is_painted_once_and_another_again() {
        let key = |seed| ("texture::tests", [seed, 0, 0, 0]);
        let paint = |grey: f64| move || Texture::from_fn(1, 1, move |_, _| [grey; 3]);
        let first = painted_once(key(1), paint(10.0));
        assert!(Arc::ptr_eq(&first, &painted_once(key(1), paint(20.0))));
        assert_eq!(painted_once(key(2), paint(20.0)).levels()[0].texels[0] & 0x1f_ffff, 20);
        for seed in 0..2 * KEPT as u64 {
            painted_once(key(100 + seed), paint(30.0));
        }
        assert!(NEWEST.lock().unwrap_or_else(PoisonError::into_inner).len() <= KEPT);
    }

    #[test]
    fn hues_are_those_of_the_hexagon() {
        let check = |hue, rgb: Colour| assert_eq!(colour_from_hsv(hue, 1.0, 1.0), rgb);
        check(0.0, [255.0, 0.0, 0.0]);
        check(60.0, [255.0, 255.0, 0.0]);
        check(-120.0, [0.0, 0.0, 255.0]);
        check(480.0, [0.0, 255.0, 0.0]);
        assert_eq!(colour_from_hsv(200.0, 0.0, 0.5), [127.5; 3]);
    }
}
