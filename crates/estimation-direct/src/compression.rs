//! A region whose texture is that of the compression of its image.
//!
//! JPEG quantises blocks of 8 by 8 pixels (ITU-T T.81, A.3.1). Where a surface has less contrast than a step of the quantiser, only the borders of
//! these blocks are left: a pattern that stays with the pixels of both images, whatever the surface does.

use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::region::RegionMask;

/// Side of a block, pixels.
const BLOCK_PX: usize = 8;
/// A texture is that of the compression if the mean squared difference of neighbours across borders of blocks is this many times that of the
/// others, along rows and along columns: the borders have most of all differences then. Measured: at most 4.6 in 219 windows of images of quality 100,
/// 73 on a surface of which quality 10 leaves nothing.
const AT_BORDERS_MIN: f64 = 8.0;
/// Mean squared difference across the borders below which there is no texture at all, squared grey levels. Chosen by hand, not varied.
const TEXTURE_MIN: f64 = 0.05;

/// Sum of the squared differences of neighbours, and their number.
#[derive(Clone, Copy, Default)]
struct Differences {
    squares: f64,
    count: f64,
}

impl Differences {
    fn add(&mut self, a: f64, b: f64) {
        self.squares += (a - b).powi(2);
        self.count += 1.0;
    }

    fn mean(&self) -> f64 {
        self.squares / self.count.max(1.0)
    }
}

/// Two rows of an image; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct RowPair {
    above: Vec<f64>,
    row: Vec<f64>,
    bytes: Vec<u8>,
}

/// Whether the region of an image shows little else than borders of blocks.
pub(super) fn is_of_blocks(image: ImageView<'_>, region: &RegionMask, buffers: &mut RowPair) -> bool {
    let Some(bounds) = region.bbox() else { return false };
    let (first, width) = (bounds.x as usize, bounds.width as usize);
    // Along rows and along columns: across borders of blocks, and inside.
    let mut differences = [[Differences::default(); 2]; 2];
    let RowPair { above, row, bytes } = buffers;
    above.resize(width, 0.0);
    row.resize(width, 0.0);
    for y in bounds.y as usize..(bounds.y + bounds.height) as usize {
        std::mem::swap(above, row);
        let pixels = image.rgb(first..first + width, y..y + 1, bytes);
        for (grey, rgb) in row.iter_mut().zip(pixels.row(0).chunks_exact(3)) {
            *grey = rgb.iter().copied().map(f64::from).sum::<f64>() / 3.0;
        }
        let is_inside = |column: usize, y: usize| region.contains((first + column) as i32, y as i32);
        for column in (0..width).filter(|&column| is_inside(column, y)) {
            if column > 0 && is_inside(column - 1, y) {
                differences[0][usize::from((first + column) % BLOCK_PX != 0)].add(row[column], row[column - 1]);
            }
            if y > bounds.y as usize && is_inside(column, y - 1) {
                differences[1][usize::from(y % BLOCK_PX != 0)].add(row[column], above[column]);
            }
        }
    }
    differences.iter().all(|[across, inside]| {
        across.mean() >= TEXTURE_MIN && across.mean() >= AT_BORDERS_MIN * inside.mean() && inside.count > 0.0
    })
}

#[cfg(test)]
mod tests {
    use image::codecs::jpeg::JpegEncoder;
    use image::{GrayImage, Luma};
    use pb3dp_geometry::ImageSize;

    use super::*;

    /// A smooth texture of a contrast, through a JPEG file.
    fn compressed(contrast: f64, quality: u8) -> image::RgbImage {
        let wave = |x: u32, y: u32| (f64::from(x) / 12.3).sin() + (f64::from(y) / 15.1 + f64::from(x) / 43.0).cos();
        let image = GrayImage::from_fn(160, 120, |x, y| Luma([(120.0 + contrast * wave(x, y)).round() as u8]));
        let mut file = Vec::new();
        JpegEncoder::new_with_quality(&mut file, quality).encode_image(&image).expect("encodes");
        image::load_from_memory(&file).expect("decodes").to_rgb8()
    }

    #[test]
    fn compression_residues_of_a_faint_texture_are_distinguished_from_texture() {
        let region =
            RegionMask::from_fn(ImageSize { width: 160, height: 120 }, |x, y| x > 20 && x < 137 && y > 13 && y < 101);
        let visible =
            |contrast, quality| is_of_blocks((&compressed(contrast, quality)).into(), &region, &mut RowPair::default());
        assert!(visible(8.0, 8), "only the borders of blocks are left");
        assert!(!visible(2.5, 95), "faint, but there");
        assert!(!visible(40.0, 25), "coarse, but there");
        assert!(!visible(0.0, 8), "nothing at all is not compression");
    }
}
