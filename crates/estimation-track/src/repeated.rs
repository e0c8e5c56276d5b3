//! Whether one eye delivers the same picture again while the other one sees something new.

use image::RgbImage;
use pb3dp_estimation_direct::image_plane::PixelWindow;

/// What the other eye must see that is new, mean absolute difference in grey levels: noise alone makes more in a real camera. Chosen.
const NEW_FROM_GREY: f64 = 0.5;

/// The part of a picture that showed the target.
#[derive(Clone, Debug, Default)]
pub(super) struct Remembered {
    /// Within the picture.
    window: PixelWindow,
    bytes: Vec<u8>,
}

impl Remembered {
    /// Takes memory for whole pictures.
    pub(super) fn reserve(&mut self, pixels: usize) {
        self.bytes.reserve(3 * pixels);
    }

    /// Keeps a part of a picture.
    pub(super) fn keep(&mut self, picture: &RgbImage, window: &PixelWindow) {
        self.window = window.clipped(picture.width(), picture.height());
        self.bytes.clear();
        rows(picture, &self.window).for_each(|row| self.bytes.extend_from_slice(row));
    }

    /// Whether a picture is the same there, to the last bit.
    fn is_repeated(&self, picture: &RgbImage) -> bool {
        let known = self.bytes.chunks_exact((3 * self.window.width).max(1));
        !self.bytes.is_empty() && rows(picture, &self.window).eq(known)
    }

    /// Mean absolute difference to a picture, grey levels.
    fn difference_grey(&self, picture: &RgbImage) -> f64 {
        let now = rows(picture, &self.window).flatten();
        let sum: u64 = now.zip(&self.bytes).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        sum as f64 / self.bytes.len().max(1) as f64
    }
}

fn rows<'a>(picture: &'a RgbImage, window: &PixelWindow) -> impl Iterator<Item = &'a [u8]> + use<'a> {
    let (x, y, width) = (window.x as usize, window.y as usize, window.width);
    let stride = 3 * picture.width() as usize;
    picture
        .as_raw()
        .chunks_exact(stride.max(1))
        .skip(y)
        .take(window.height)
        .map(move |row| &row[3 * x..3 * (x + width)])
}

/// The eye, 0 or 1, whose picture is the last one again, although the other eye sees something new.
pub(super) fn stuck_eye(remembered: &[Remembered; 2], pictures: [&RgbImage; 2]) -> Option<usize> {
    [0, 1].into_iter().find(|&eye| {
        let other = 1 - eye;
        remembered[eye].is_repeated(pictures[eye])
            && remembered[other].difference_grey(pictures[other]) >= NEW_FROM_GREY
    })
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    fn picture(seed: u32) -> RgbImage {
        RgbImage::from_fn(40, 30, |x, y| Rgb([(x * 7 + y * 13 + seed * (x + 3 * y)) as u8, (x * y) as u8, 9]))
    }

    #[test]
    fn the_eye_that_repeats_itself_is_named_only_if_the_other_one_sees_something_new() {
        let window = PixelWindow { x: -3, y: 4, width: 20, height: 50 };
        let mut remembered: [Remembered; 2] = Default::default();
        assert_eq!(stuck_eye(&remembered, [&picture(1), &picture(2)]), None, "nothing is known yet");
        remembered[0].keep(&picture(1), &window);
        remembered[1].keep(&picture(2), &window);
        assert_eq!(stuck_eye(&remembered, [&picture(1), &picture(2)]), None, "a scene at rest without noise");
        assert_eq!(stuck_eye(&remembered, [&picture(3), &picture(2)]), Some(1));
        assert_eq!(stuck_eye(&remembered, [&picture(1), &picture(3)]), Some(0));
        assert_eq!(stuck_eye(&remembered, [&picture(3), &picture(4)]), None);
        let mut nearly = picture(1);
        nearly.get_pixel_mut(5, 6).0[0] ^= 1;
        assert_eq!(stuck_eye(&remembered, [&nearly, &picture(2)]), None, "hardly anything is new");
        let mut elsewhere = picture(2);
        elsewhere.get_pixel_mut(30, 20).0[0] ^= 1;
        assert_eq!(stuck_eye(&remembered, [&picture(3), &elsewhere]), Some(1), "only where the target was");
        remembered[1].keep(&picture(2), &PixelWindow { x: 90, ..window });
        assert_eq!(stuck_eye(&remembered, [&picture(3), &picture(2)]), None, "out of sight");
    }
}
