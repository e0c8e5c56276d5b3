//! All views in the images of one device.

use image::RgbImage;
use pb3dp_camera_settings::{PixelFormat, ValueRange};

use super::{Converter, Layout, PixelError, View, resize};

/// Converts all views of each image of a device. Views are read where the driver has written them; only a JPEG with several views is
/// decoded once as a whole, and its parts are copied.
#[derive(Debug)]
pub struct ViewsConverter {
    layout: Layout,
    views: Vec<Converter>,
}

impl ViewsConverter {
    /// A converter for these views of images of this layout. `values` become black and white in formats with more than 8 bits; `None`:
    /// all values of the format.
    ///
    /// # Errors
    /// As [`Converter::of_view`].
    pub fn new(layout: Layout, views: &[View], values: Option<ValueRange>) -> Result<Self, PixelError> {
        let of_view = |view: &View| Ok(Converter::of_view(layout, *view)?.with_values(values));
        Ok(Self { layout, views: views.iter().map(of_view).collect::<Result<_, _>>()? })
    }

    /// Memory layout of the images of the device.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Converts one image into a target per view, in the order of the views.
    ///
    /// # Errors
    /// As [`Converter::convert`].
    pub fn convert(&mut self, bytes: &[u8], targets: &mut [&mut RgbImage]) -> Result<(), PixelError> {
        match &mut *self.views {
            [first, .., last] if self.layout.format == PixelFormat::Mjpg => {
                first.check_length(bytes)?;
                let mut whole = std::mem::take(&mut last.whole);
                resize(&mut whole, self.layout.size);
                let decoded = first.jpeg.decode(bytes, &mut whole);
                for (view, target) in self.views.iter().zip(targets) {
                    view.copy_part(&whole, target);
                }
                if let Some(last) = self.views.last_mut() {
                    last.whole = whole;
                }
                decoded
            }
            views => views.iter_mut().zip(targets).try_for_each(|(view, target)| view.convert(bytes, target)),
        }
    }

    /// Copies a view as [`Converter::copy_delivered`]; nothing for a view that does not exist.
    pub fn copy_delivered(&self, view: usize, bytes: &[u8], copy: &mut Vec<u8>) -> &'static str {
        copy.clear();
        self.views.get(view).map_or("", |view| view.copy_delivered(bytes, copy))
    }
}
