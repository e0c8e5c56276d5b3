//! Images as cameras store them: inside larger images, grey or colour, with 8 to 16 bits.

use image::RgbImage;
use pb3dp_estimation_core::image_view::{ImageView, Pixels};
use pb3dp_geometry::ValueRange;

/// How an image is stored.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    /// One channel, the green one.
    pub is_grey: bool,
    /// 16 bits with this range.
    pub range: Option<ValueRange>,
    /// Pixels of the larger image on the left, on the right, above and below.
    pub margins: [u32; 4],
}

/// The memory of a camera with one image in it. All values around the image are white.
pub struct Memory {
    form: Form,
    size: (u32, u32),
    bytes: Vec<u8>,
    deep: Vec<u16>,
}

impl Form {
    /// Without a larger image, 8-bit colour.
    pub const PLAIN: Self = Self { is_grey: false, range: None, margins: [0; 4] };

    /// The image in one piece of 8-bit colour, with the values that this form can store.
    pub fn plain(&self, image: &RgbImage) -> RgbImage {
        let mut image = image.clone();
        let table = self.range.map(ValueRange::table);
        for pixel in image.pixels_mut() {
            if self.is_grey {
                pixel.0 = [pixel.0[1]; 3];
            }
            if let (Some(range), Some(table)) = (self.range, &table) {
                pixel.0 = pixel.0.map(|byte| table[usize::from(deep(byte, range))]);
            }
        }
        image
    }

    /// The image in this form.
    pub fn store(self, image: &RgbImage) -> Memory {
        let [left, right, above, below] = self.margins;
        let (width, height) = (left + image.width() + right, above + image.height() + below);
        let channels = if self.is_grey { 1 } else { 3 };
        let mut bytes = vec![u8::MAX; width as usize * height as usize * channels];
        for (x, y, pixel) in image.enumerate_pixels() {
            let at = ((y + above) as usize * width as usize + (x + left) as usize) * channels;
            let values = if self.is_grey { &pixel.0[1..2] } else { &pixel.0 };
            bytes[at..at + channels].copy_from_slice(values);
        }
        let mut memory = Memory { form: self, size: image.dimensions(), bytes, deep: Vec::new() };
        if let Some(range) = self.range {
            memory.deep = memory.bytes.iter().map(|byte| deep(*byte, range)).collect();
            memory.bytes.clear();
        }
        memory
    }
}

/// The deep value of a byte.
fn deep(byte: u8, range: ValueRange) -> u16 {
    let span = u32::from(range.high() - range.low());
    range.low() + ((u32::from(byte) * span + 127) / 255) as u16
}

impl Memory {
    /// The image in the larger one.
    pub fn view(&self) -> ImageView<'_> {
        let [left, right, above, below] = self.form.margins;
        let (width, height) = (left + self.size.0 + right, above + self.size.1 + below);
        let (pixels, channels) = match (self.form.is_grey, self.form.range) {
            (false, None) => (Pixels::Rgb(&self.bytes), 3),
            (true, None) => (Pixels::Grey(&self.bytes), 1),
            (false, Some(range)) => (Pixels::DeepRgb(&self.deep, range), 3),
            (true, Some(range)) => (Pixels::DeepGrey(&self.deep, range), 1),
        };
        let whole = ImageView::new(width, height, width as usize * channels, pixels).expect("memory of the image");
        whole.part(left..left + self.size.0, above..above + self.size.1).expect("a part")
    }
}
