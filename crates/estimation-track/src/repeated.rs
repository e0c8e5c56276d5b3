//! Detects a camera that repeats its last image while the other camera delivers a new one.

use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_views::image_plane::PixelWindow;

/// Mean absolute difference of a new image of the other camera, grey levels: in a real camera noise alone exceeds this.
/// Chosen by hand, not varied.
const NEW_FROM_GREY: f64 = 0.5;

/// The part of an image that contained the target.
#[derive(Clone, Debug, Default)]
pub(super) struct Remembered {
    /// Position within the image.
    window: PixelWindow,
    bytes: Vec<u8>,
    /// A row of an image that is not 8-bit colour.
    converted: Vec<u8>,
}

impl Remembered {
    /// Allocates memory for whole images.
    pub(super) fn reserve(&mut self, pixels: usize) {
        self.bytes.reserve(3 * pixels);
    }

    /// Stores a part of an image.
    pub(super) fn keep(&mut self, image: ImageView<'_>, window: &PixelWindow) {
        self.window = window.clipped(image.width(), image.height());
        let row = 3 * self.window.width;
        self.bytes.resize(row * self.window.height, 0);
        for (y, row) in self.window.rows().zip(self.bytes.chunks_exact_mut(row.max(1))) {
            image.copy_row(self.window.x as usize, y, row);
        }
    }

    /// Whether an image is bit-identical in this part.
    fn is_repeated(&mut self, image: ImageView<'_>) -> bool {
        let Self { window, bytes, converted } = self;
        let mut rows = window.rows().zip(bytes.chunks_exact((3 * window.width).max(1)));
        !bytes.is_empty() && rows.all(|(y, known)| image.rgb(window.columns(), y..y + 1, converted).row(0) == known)
    }

    /// Mean absolute difference from an image, grey levels.
    fn difference_grey(&mut self, image: ImageView<'_>) -> f64 {
        let Self { window, bytes, converted } = self;
        let rows = window.rows().zip(bytes.chunks_exact((3 * window.width).max(1)));
        let differences = rows.map(|(y, known)| {
            let now = image.rgb(window.columns(), y..y + 1, converted).row(0);
            now.iter().zip(known).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>()
        });
        differences.sum::<u64>() as f64 / bytes.len().max(1) as f64
    }
}

/// Index of the camera (0 left, 1 right) that repeats its last image while the other camera delivers a new one.
pub(super) fn stuck_camera(remembered: &mut [Remembered; 2], images: [ImageView<'_>; 2]) -> Option<usize> {
    [0, 1].into_iter().find(|&side| {
        let other = 1 - side;
        remembered[side].is_repeated(images[side]) && remembered[other].difference_grey(images[other]) >= NEW_FROM_GREY
    })
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};

    use super::*;

    fn image(seed: u32) -> RgbImage {
        RgbImage::from_fn(40, 30, |x, y| Rgb([(x * 7 + y * 13 + seed * (x + 3 * y)) as u8, (x * y) as u8, 9]))
    }

    #[test]
    fn the_eye_that_repeats_itself_is_named_only_if_the_other_one_sees_something_new() {
        let window = PixelWindow { x: -3, y: 4, width: 20, height: 50 };
        let mut remembered: [Remembered; 2] = Default::default();
        assert_eq!(
            stuck_camera(&mut remembered, [(&image(1)).into(), (&image(2)).into()]),
            None,
            "nothing is known yet"
        );
        remembered[0].keep((&image(1)).into(), &window);
        remembered[1].keep((&image(2)).into(), &window);
        assert_eq!(
            stuck_camera(&mut remembered, [(&image(1)).into(), (&image(2)).into()]),
            None,
            "a scene at rest without noise"
        );
        assert_eq!(stuck_camera(&mut remembered, [(&image(3)).into(), (&image(2)).into()]), Some(1));
        assert_eq!(stuck_camera(&mut remembered, [(&image(1)).into(), (&image(3)).into()]), Some(0));
        assert_eq!(stuck_camera(&mut remembered, [(&image(3)).into(), (&image(4)).into()]), None);
        let mut nearly = image(1);
        nearly.get_pixel_mut(5, 6).0[0] ^= 1;
        assert_eq!(
            stuck_camera(&mut remembered, [(&nearly).into(), (&image(2)).into()]),
            None,
            "hardly anything is new"
        );
        let mut elsewhere = image(2);
        elsewhere.get_pixel_mut(30, 20).0[0] ^= 1;
        assert_eq!(
            stuck_camera(&mut remembered, [(&image(3)).into(), (&elsewhere).into()]),
            Some(1),
            "only where the target was"
        );
        remembered[1].keep((&image(2)).into(), &PixelWindow { x: 90, ..window });
        assert_eq!(stuck_camera(&mut remembered, [(&image(3)).into(), (&image(2)).into()]), None, "out of sight");
    }
}
